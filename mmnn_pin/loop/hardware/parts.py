"""What stands between a controller and an ideal robot, as arrays."""

from __future__ import annotations

from typing import NamedTuple

from ...signals import Array, IntArray


class Hardware(NamedTuple):
    """The imperfect part of one run, as arrays; the memories are views of one flat one.

    Attributes:
        exact: Whether the state is measured as it is.
        driven: Whether the motors are imperfect.
        supervised: Whether a supervisor stands before them.
        recorded: Whether the row has the signals applied, disturbance and safety.
        encoders, W, sensors, noise: Arguments of `measure`; noise of every measurement.
        motor_side: Whether encoders are on the motors.
        frozen: (k, 3) encoders that keep their reading: place in the position, start, end.
        E, E_inv: (p, motors) torque on nu from motor torques, and back.
        motors, supply: Arguments of `actuator.drive`.
        dead: (k, 3) motors without current: motor, start, end.
        limits: Settings of the supervisor.
        weights: (k, 2) places of the weights in the controller's memory.
        fates: (samples,) what becomes of every command.
        pushes, gusts: Arguments of `disturbance.push`.
        blocked: (k, 3) joints that are blocked: place in the position, start, end.
        pick: When a payload is picked up, inf for never [s].
        state: All that this remembers.
        sensor, states, guard, held, sent: Its parts: the sensors', the motors', the supervisor's, what frozen encoders
            read, the last torque that reached the motors.
        shift: The energy that came with a payload [J], and 1 once it did.
        position, nu, command, speed, is_dead, force, total, tau: Scratch.
    """

    exact: bool
    driven: bool
    supervised: bool
    recorded: bool
    encoders: IntArray
    W: Array
    sensors: Array
    noise: Array
    motor_side: bool
    frozen: Array
    E: Array
    E_inv: Array
    motors: Array
    supply: Array
    dead: Array
    limits: Array
    weights: IntArray
    fates: Array
    pushes: Array
    gusts: Array
    blocked: Array
    pick: float
    state: Array
    sensor: Array
    states: Array
    guard: Array
    held: Array
    sent: Array
    shift: Array
    position: Array
    nu: Array
    command: Array
    speed: Array
    is_dead: Array
    force: Array
    total: Array
    tau: Array

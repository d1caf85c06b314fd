"""The model of a robot's servos: a torque within limits, with a bandwidth and a delay.

Before a run it is that, or what the law of `servo` takes servos for, in the linearised loop that is judged.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from ..actuator import Drive
from ..by_address import by_address
from ..compiled import internal
from ..elementary.matrices import product, pseudo_inverse, solve
from ..model.robot import Robot
from ..model.tree.twin import Twin
from ..signals import Array
from .before_run import viscous_friction
from .servo import Servo, Split, interfaces_of, laws, movers

TUNED = 2.0  # times viscous friction that a servo's gain has beside its bandwidth


@by_address
class VelocityServo(NamedTuple):
    """Servos of motors in a simulation: `torque = gain (error + stiffness int error dt)`, `error = asked - speed`.

    The torque is within limits, and some steps of the plant late. The integral, which carries a weight, stands still
    while the torque is at its limit; with a stiffness of a quarter of the bandwidth the servo is critically damped.

    Attributes:
        dt: Step of the plant [s].
        on: (motors,) 1 for a motor with a servo.
        gain: (motors,) bandwidth times the inertia that the motor alone moves, and more against its viscous friction
            [N m s or N s/m].
        stiffness: (motors,) of the integral [1/s].
        limit: (motors,) largest torque [N m or N].
        E: (p, motors) speeds of the motors are E' nu.
        command: (p,) what is asked of nu, written by `ask`.
        ring: (slots + 1, motors) state: what was asked in the last steps, and the integrals [rad or m].
    """

    dt: float
    on: Array
    gain: Array
    stiffness: Array
    limit: Array
    E: Array
    command: Array
    ring: Array

    @internal
    def act(self, wire: Drive, k: int, time: float) -> None:
        """Put the servos' torques in place of what is commanded."""
        slots, n = self.ring.shape[0] - 1, int(time / self.dt + 0.5)
        for j in range(wire.torque.size):
            if self.on[j] > 0.0:
                asked = 0.0
                for i in range(self.command.size):
                    asked += self.E[i, j] * self.command[i]
                self.ring[n % slots, j] = asked
                error, integral = self.ring[(n + 1) % slots, j] - wire.joint[j], self.ring[slots, j]
                torque = self.gain[j] * (error + self.stiffness[j] * integral)
                wire.torque[j] = min(max(torque, -self.limit[j]), self.limit[j])
                if abs(torque) <= self.limit[j] or torque * error < 0.0:
                    self.ring[slots, j] = integral + self.dt * error


def velocity_servo(robot: Robot, servo: Servo, split: Split, dt: float, ring: Array) -> VelocityServo:
    """The simulated servos of a robot's servo rows.

    Args:
        robot: The robot.
        servo: Their settings.
        split: The rows.
        dt: Step of the plant [s].
        ring: (slots, motors) state, see `servo_slots`.
    """
    on, gain, stiffness = servo_motors(robot, split.on, split.numbers[0])
    limit = servo.strength * robot.effort_limits
    return VelocityServo(dt, on, gain, stiffness, limit, split.E, split.command, ring)


def servo_motors(robot: Robot, on: Array, bandwidth: Array) -> tuple[Array, Array, Array]:
    """Which motors have a servo, its gain and its stiffness, (motors,) each, of `VelocityServo`.

    Args:
        robot: The robot.
        on: (p,) which rows are servo rows.
        bandwidth: (p,) of them [1/s].
    """
    E = np.ascontiguousarray(robot.E_at(robot.rest))
    M = Twin(robot).mass_matrix(robot.neutral_position())
    inertia = 1.0 / np.diag(product(E.T, solve(M, E)))  # what a motor alone moves
    moves = movers(robot)
    b = np.array([bandwidth[rows].min() for rows in moves.T])
    back = pseudo_inverse(E)
    damping = np.diag(product(back, viscous_friction(robot), back.T))
    return (on @ moves > 0.0).astype(float), b * inertia + TUNED * damping, 0.25 * b


def servo_slots(servo: Servo, latency: float, dt: float) -> int:
    """Rows of a servo's state: a command per step of its way [s] and of the servo's own delay, one more, integrals."""
    return round((servo.delay + latency) / dt) + 2


class LinearServos(NamedTuple):
    """Servo rows in the linearised loop that is judged before a run.

    Attributes:
        law: As stated.
        on: (p,) 1 on s, 0 on e.
        numbers: (3, p) b, k, rate.
        E: (p, m) of the m motors with a servo.
        gain: (m,) as in `VelocityServo`.
        stiffness: (m,) likewise [1/s].
        simulated: Whether they are `VelocityServo`, else what the law takes them for, `nudot_s = b (u - nu_s)`.
    """

    law: Servo
    on: Array
    numbers: Array
    E: Array
    gain: Array
    stiffness: Array
    simulated: bool


def linear_servos(robot: Robot, given: Mapping[str, str] | None, law: Servo, simulated: bool) -> LinearServos | None:
    """The servo rows of a robot; None where all rows take effort.

    Errors as of `interfaces_of` and `split_of`.
    """
    _, on = interfaces_of(robot, given)
    return servos_on(robot, on, law, simulated) if on.any() else None


def servos_on(robot: Robot, on: Array, law: Servo, simulated: bool) -> LinearServos:
    """The servos of these rows, (p,); errors as of `split_of`."""
    numbers = laws(robot, law)
    motors, gain, stiffness = servo_motors(robot, on, numbers[0])
    there = motors > 0.0
    return LinearServos(law, on, numbers, robot.E_at(robot.rest)[:, there], gain[there], stiffness[there], simulated)

"""The hardware model: what stands between a controller and an ideal robot.

Every effect is one class of a block (`sensing`, `actuator`, `disturbance`), made of its numbers, views of its part of
the state and its function `act`; a list has them in the order in which the signal meets them:

    sample k:   sense ─▶ controller ─▶ send: the command's line, the supervisor ─▶ command of the motors
    plant step: act: the motors' effects and what the world does ─▶ torque on nu

Both engines call the same functions. A loop around a robot that is measured exactly and driven perfectly has no
`Hardware` (None), and compiled loops without one are compiled without all this. `new_hardware` makes one.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numba.extending import overload

from .. import safety
from ..actuator import Motors, MotorState
from ..by_address import by_address
from ..compiled import compiled, copy_to, entry, internal, linked
from ..compliance import Compliance
from ..disturbance import Forces
from ..model.base.rolling import Maps
from ..safety import Supervisor, SupervisorState
from ..sensing import Sensors, exact
from ..sensing.effects import COUNT, RECEIVED, Reading
from ..signals import EARLY, INDEX, Array, IntArray
from ..touch import Feeler
from .servo import Split

HAND_FORCE, HAND_WORK, OPENING = INDEX["hand_force"], INDEX["hand_work"], INDEX["opening"]
INJECTED = INDEX["injected"]
APPLIED, DISTURBANCE, SAFETY = INDEX["applied"], INDEX["disturbance"], INDEX["safety"]
TORQUE, PSI_HAT, POSE, SHAPE = INDEX["torque"], INDEX["psi_hat"], INDEX["pose"], INDEX["shape"]
PSI_APPLIED, NUDOT_REF = INDEX["psi_applied"], INDEX["nudot_ref"]
ARRIVES, IS_LOST, IS_BROKEN = 0.0, 1.0, 2.0  # what becomes of a command


@by_address
class SentTorque(NamedTuple):
    """A torque on its way from the controller to the motors: (p,) [N, N m], and whether it arrived (1,), 0 or 1."""

    torque: Array
    arrived: Array


@by_address
class CommandLine(NamedTuple):
    """Commands that are lost, so that the motors keep what they had, or that arrive as no numbers."""

    fates: Array  # (samples,) what becomes of every command
    sent: Array  # (p,) state: the last torque that reached the motors

    @internal
    def act(self, wire: SentTorque, k: int, time: float) -> None:
        """Let the command through, or not."""
        wire.arrived[0] = 0.0 if self.fates[k] == IS_LOST else 1.0
        if self.fates[k] == IS_BROKEN:
            wire.torque[:] = np.nan
        elif self.fates[k] == IS_LOST:
            copy_to(self.sent, wire.torque)


@by_address
class MotorSide(NamedTuple):
    """Encoders on the motors instead of the joints, from which backlash separates them."""

    geared: IntArray  # (k, 3) motor, its joint's place in the position, and in nu (negative for a wheel)
    states: MotorState  # state of the motors

    @internal
    def act(self, wire: Reading, k: int, time: float) -> None:
        """Put positions and speeds of the motors in place of those of their joints."""
        for i in range(self.geared.shape[0]):
            j = self.geared[i, 0]
            wire.position[self.geared[i, 1]] += self.states.ahead[j]
            if self.geared[i, 2] >= 0:
                wire.nu[self.geared[i, 2]] = self.states.rotor_speed[j]


@by_address
class World(NamedTuple):
    """The disturbances of the robot from outside."""

    pushes: bool  # whether anything does
    wire: Forces  # the force of a step
    effects: tuple[Any, ...]  # in the order in which they add up
    blocked: Array  # (k, 3) joints that are blocked: place in the position, start, end
    pick: float  # when a payload is picked up [s], inf for never
    drop: float  # when it is put down [s], inf for never
    shift: Array  # (2,) the energy that came and went with it [J], and 1 once it came, 2 once it went


@by_address
class Totals(NamedTuple):
    """The sums over a control period that are recorded."""

    imperfect: bool  # whether the motors are
    states: MotorState  # state of the motors, with the sum of what they gave
    command: Array  # (motors,) torques that reach the motors [N m or N]
    force: Array  # (p,) sum of what the world did
    hand: Array  # (3,) sum of the force at the frame that touches something, (0,) without one
    work: Array  # (2,) work of that force up to the period's beginning [J], and how many steps it has had
    done: Array  # (1,) its work up to now, (0,) without such a frame [J]
    door: Array  # (2,) angle and rate of the door, (0,) without one


@by_address
class Expected(NamedTuple):
    """The nu expected after a sample, for an observer on a model: the controller's own estimate is the model.

    Where Psi_hat is right, `M (nudot - nudot_ref) = tau - Psi_hat + C s`, so nothing but inertias has to be known, and
    of these no more than the gains were chosen by; what is wrong with them the observer learns.
    """

    inertia: Array  # (p,) effective inertias of the robot that the controller believes in [kg, kg m^2]
    follows: float  # 1 where Psi_hat answers for nudot_ref, 0 for a controller without one: then the torque is all
    acceleration: Array  # (p,) written: see `sensing.effects.Reading`; (0,) without such an observer


@by_address
class Way(NamedTuple):
    """The way of a torque from the controller to the motors, all that `send` needs: Python hands it over each time."""

    line: SentTorque  # the command under way
    lines: tuple[Any, ...]  # the effects that it meets
    supervisor: Supervisor  # what stands before the motors
    E_inv: Array  # (motors, p) motor torques from the torque on nu
    totals: Totals  # command of the motors, and what they and the world gave
    sent: Array  # (p,) the last torque that reached the motors, part of the hardware's state
    shorted: IntArray  # (1,) how many motors, from the first on, have their windings shorted
    expected: Expected  # for an observer on a model


@by_address
class Hardware(NamedTuple):
    """The hardware model of one run."""

    exact: bool  # whether the state is measured as it is
    sensors: Sensors  # the sensors
    way: Way  # from the controller to the motors
    motors: Motors  # the motors
    world: World  # the disturbances from outside
    E: Array  # (p, motors) torque on nu from motor torques
    tau: Array  # (p,) generalized torque of motors and world
    # state of all effects, flat: sensors, motors, supervisor, frozen encoders, the last torque sent, commands under
    # way, servo rows and their servos, what feels external torque
    state: Array
    split: Split | None  # the rows that take a velocity; None where all take effort
    touch: Feeler | None  # what feels external torque; None for nothing
    places: IntArray  # (motors,) of the motors' joints in the position, negative for a force on the base
    turning: IntArray  # (motors,) rows of T of the motors' joints where T changes; (0,) elsewhere
    task: Compliance | None  # a compliant hand, for `sample`; None without one


def pass_through(effects: tuple[Any, ...], wire: Any, k: int, time: float) -> None:
    """Let a signal pass effects, one after the other.

    Args:
        effects: Each with a function `act(wire, k, time)`.
        wire: The signal, which they change.
        k: Number of the sample or measurement.
        time: [s].
    """
    for effect in effects:
        effect.act(wire, k, time)


@overload(pass_through, strict=False)
def first_and_others(effects: Any, wire: Any, k: int, time: float) -> Any:
    """`pass_through` for compiled code: the first effect, whose type says which function it is, then the others."""
    if not effects.types:
        return lambda effects, wire, k, time: None
    act = effects.types[0].instance_class.act

    def through(effects: Any, wire: Any, k: int, time: float) -> None:
        act(effects[0], wire, k, time)
        pass_through(effects[1:], wire, k, time)

    return through


@linked
def sense(
    number: int, time: float, row: Array, at: IntArray, position: Array, nu: Array, places: IntArray, hardware: Hardware
) -> None:
    """Take the measurement of this number into the row.

    Args:
        number: Of the measurement.
        time: [s].
        row: (width,) row of signals.
        at: Offsets of the signals.
        position: (nv,) true position.
        nu: (p,) true velocity.
        places: (n + shape,) of the arm joints in the position, then of the pivots.
        hardware: The hardware model.
    """
    is_new, measured = True, time
    if hardware.exact:
        exact(row, at, position, nu, places)
    else:
        wire = hardware.sensors.wire
        copy_to(position, wire.position)
        copy_to(nu, wire.nu)
        before = wire.clock[RECEIVED] if wire.clock[COUNT] > 0.0 else -1.0
        pass_through(hardware.sensors.effects, wire, number, time)
        copy_to(wire.received, row[at[POSE] : at[SHAPE + 1]])
        is_new = wire.clock[RECEIVED] != before
        measured = wire.clock[RECEIVED] * hardware.sensors.period
    supervisor = hardware.way.supervisor
    if supervisor.on:
        safety.accept(row, at, measured, time, is_new, supervisor.door)


@compiled
def is_stopped(on: bool, state: SupervisorState) -> bool:
    """Whether a supervisor that is there does without the controller, by its state."""
    return on and not safety.may_learn(state)


@linked
def send(k: int, time: float, row: Array, at: IntArray, weights: Array, way: Way) -> None:
    """The torque of control sample k on its way to the motors: what is lost or broken, and what the supervisor does.

    Args:
        k: Number of the control sample.
        time: [s].
        row: (width,) row of signals; its torque becomes the one that reaches the motors.
        at: Offsets of the signals.
        weights: The controller's state.
        way: The way.
    """
    tau, supervisor, line = row[at[TORQUE] : at[TORQUE + 1]], way.supervisor, way.line
    if is_stopped(supervisor.on, supervisor.state):
        for i in range(at[PSI_HAT], at[TORQUE + 1]):  # the controller was not asked
            row[i] = 0.0
    copy_to(tau, line.torque)
    pass_through(way.lines, line, k, time)
    copy_to(line.torque, tau)
    if supervisor.on:
        safety.supervise(row, at, time, line.arrived[0] > 0.0, weights, supervisor)
        way.shorted[0] = shorted(row[at[SAFETY]], supervisor)
    copy_to(tau, way.sent)
    expect(row, at, way.expected)
    command, states = way.totals.command, way.totals.states
    for j in range(command.size):
        command[j] = entry(way.E_inv, j, tau)
        states.sum[j] = 0.0
    way.totals.force[:] = 0.0
    way.totals.hand[:] = 0.0
    way.totals.work[:] = 0.0


@compiled
def expect(row: Array, at: IntArray, expected: Expected) -> None:
    """How nu is expected to accelerate under the torque that is sent; 0 where that is no number."""
    said = at[PSI_APPLIED] if at[PSI_APPLIED + 1] > at[PSI_APPLIED] else at[PSI_HAT]
    for i in range(expected.acceleration.size):
        value = expected.follows * row[at[NUDOT_REF] + i] + (row[at[TORQUE] + i] - row[said + i]) / expected.inertia[i]
        expected.acceleration[i] = value if math.isfinite(value) else 0.0


@compiled
def shorted(doing: float, supervisor: Supervisor) -> int:
    """How many motors, from the first on, have their windings shorted by a supervisor that does this."""
    if doing < safety.STOPPING:
        return 0
    if doing == safety.RAMPING:
        return int(supervisor.torque.size)
    return int(supervisor.torque.size - supervisor.K.size) if supervisor.numbers.short > 0.0 else 0


@compiled
def rotate(nu: Array, E: Array, speeds: Array) -> None:
    """Speeds (motors,) of the motors of a robot whose wheels roll, `E' nu`."""
    for j in range(speeds.size):
        speeds[j] = 0.0
        for i in range(nu.size):
            speeds[j] += E[i, j] * nu[i]


@compiled
def turn_motors(hardware: Hardware, maps: Maps) -> None:
    """Write E, the effect on nu of the motors of a base that steers, from its maps where it stands."""
    E, rows = hardware.E, hardware.turning
    for j in range(rows.size):
        for i in range(E.shape[0]):
            E[i, j] = maps.T[rows[j], i]


@compiled
def look(hardware: Hardware, position: Array) -> None:
    """Write where the motors' joints stand, from the position (nv,), for those who act on it."""
    for j in range(hardware.places.size):
        if hardware.places[j] >= 0:
            hardware.motors.wire.angle[j] = position[hardware.places[j]]


@linked
def push(k: int, time: float, hardware: Hardware) -> None:
    """Torque on nu over one step of the plant of all but the servos, into `hardware.tau`: for their solve.

    Args:
        k: Number of the control sample.
        time: Start of the step [s].
        hardware: The hardware model; the world's forces become those of this step.
    """
    world, tau, command, split = hardware.world, hardware.tau, hardware.way.totals.command, hardware.split
    world.wire.force[:] = 0.0
    if world.pushes:
        pass_through(world.effects, world.wire, k, time)
    copy_to(world.wire.force, tau)
    if split is not None:
        for i in range(tau.size):
            for j in range(command.size):
                tau[i] += hardware.E[i, j] * command[j]


@linked
def see_world(position: Array, nu: Array, maps: Maps, world: World) -> None:
    """Show what a hand touches where the robot is (nv,), how it moves (p,), and by which maps, before `act`."""
    if world.wire.position.size:
        copy_to(position, world.wire.position)
        copy_to(nu, world.wire.nu)
        copy_to(maps.n, world.wire.n)


@linked
def act(k: int, time: float, row: Array, at: IntArray, hardware: Hardware) -> None:
    """Generalized torque over one step of the plant, of motors and world, into `hardware.tau`.

    Args:
        k: Number of the control sample.
        time: Start of the step [s].
        row: (width,) row of signals.
        at: Offsets of the signals.
        hardware: The hardware model; the speeds of its motors' joints are set, and the world's forces by `push`.
    """
    motors, world, tau = hardware.motors, hardware.world, hardware.tau
    copy_to(row[at[TORQUE] : at[TORQUE + 1]], tau)
    if motors.imperfect:
        copy_to(hardware.way.totals.command, motors.wire.torque)
        pass_through(motors.effects, motors.wire, k, time)
        for i in range(tau.size):
            tau[i] = 0.0
            for j in range(motors.wire.torque.size):
                tau[i] += hardware.E[i, j] * motors.wire.torque[j]
    if world.pushes:
        for i in range(tau.size):
            tau[i] += world.wire.force[i]
            hardware.way.totals.force[i] += world.wire.force[i]
        totals = hardware.way.totals
        if totals.done.size and totals.work[1] == 0.0:
            totals.work[0] = totals.done[0]
        totals.work[1] += 1.0
        for i in range(totals.hand.size):
            totals.hand[i] += world.wire.hand[3 + i]


@compiled
def load_at(time: float, world: World) -> float:
    """0 before the payload comes, 1 while the robot carries it, 2 once it went, at a time [s]."""
    if time + EARLY < world.pick:
        return 0.0
    return 1.0 if time + EARLY < world.drop else 2.0


@compiled
def shift_energy(load: float, gain: float, world: World) -> None:
    """Note the energy that the payload has [J] as it comes and as it goes: it is no error of the balance."""
    shift = world.shift
    shift[0] += gain if load == 1.0 else -gain if shift[1] == 1.0 else 0.0
    shift[1] = load


@linked
def note(steps: int, row: Array, at: IntArray, totals: Totals) -> None:
    """Write into the row of a control period, once it is over, the mean torque of motors and force of pushes."""
    for j in range(at[APPLIED + 1] - at[APPLIED]):
        mean = totals.states.sum[j] / steps if totals.imperfect else totals.command[j]
        row[at[APPLIED] + j] = mean if math.isfinite(mean) else 0.0  # the motion has just left all bounds
    for i in range(at[DISTURBANCE + 1] - at[DISTURBANCE]):
        row[at[DISTURBANCE] + i] = totals.force[i] / steps
    for i in range(at[HAND_FORCE + 1] - at[HAND_FORCE]):
        row[at[HAND_FORCE] + i] = totals.hand[i] / steps
    for i in range(min(totals.done.size, at[HAND_WORK + 1] - at[HAND_WORK])):
        row[at[HAND_WORK] + i] = totals.work[0]
    for i in range(at[INJECTED + 1] - at[INJECTED]):
        row[at[INJECTED] + i] -= totals.work[0]
    for i in range(min(totals.door.size, at[OPENING + 1] - at[OPENING])):
        row[at[OPENING] + i] = totals.door[i]

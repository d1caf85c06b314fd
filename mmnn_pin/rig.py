"""What stands between a controller and an ideal robot: sensors, supervisor, motors and disturbances of one run.

A loop around a robot that is measured exactly and driven perfectly has no `Rig` (None), and compiled loops without one
are compiled without all this. Both engines call the same functions.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from . import actuator as motor
from . import disturbance, safety
from .compiled import compiled, copy_to
from .errors import ConfigError
from .model.dynamics import Dynamics
from .model.robot import Robot
from .sensing import exact, measure
from .sensing.encoders import COUNT, DEPTH, PERIOD, RECEIVED
from .signals import INDEX, Array, IntArray
from .torque.controller import CompiledController, Memory

if TYPE_CHECKING:
    from .loop import Loop

APPLIED, DISTURBANCE, SAFETY = INDEX["applied"], INDEX["disturbance"], INDEX["safety"]
TORQUE, PSI_HAT = INDEX["torque"], INDEX["psi_hat"]
STOP_BANDWIDTH = 20.0  # of a stop under a controller whose gains are not known [1/s]


class Rig(NamedTuple):
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
        memory: All that this remembers.
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
    memory: Array
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


def new_rig(loop: Loop, nu: Array, memory: Memory | object, given: Array | None = None) -> Rig | None:
    """The rig of a loop; None where there is nothing but an ideal robot.

    Args:
        loop: The closed loop.
        nu: (p,) where it starts from.
        memory: The controller's memory.
        given: The rig's memory to start from, copied; None for a new one.

    Raises:
        ConfigError: Settings that do not fit the robot; a memory of wrong shape or not finite.
        UnknownName: A joint that does not exist.
    """
    robot, layout, timing, events = loop.robot, loop.robot.layout, loop.timing, loop.disturbances
    late, added = disturbance.lateness(events, timing), disturbance.corruption(events, timing)
    frozen = disturbance.windows(disturbance.Frozen, events, measured_joints(robot))
    motors = loop.actuator.motors(robot, timing.plant_step)
    motor_side = loop.sensor.side == "motor" and bool(motors[:, motor.GAP].any())
    is_exact = loop.sensor.exact and not (late.any() or added.any() or len(frozen) or motor_side)
    dead = disturbance.windows(disturbance.DeadMotor, events, robot.actuator_names)
    recorded = bool(layout.rig)
    if is_exact and not recorded:
        require_memory(given, 0)
        return None
    sensing = loop.sensor.on(robot, timing.measurement_period)
    sensing.numbers[DEPTH] += max(late.max(initial=0.0), 0.0)
    sensor_rng, gust_rng = loop.streams()
    noise = sensing.noise(0 if is_exact else timing.measurements, sensor_rng)
    if not is_exact:
        noise[:, -2], noise[:, -1] = late, added
    frozen[:, 0] = [robot.position_names.index(measured_joints(robot)[int(i)]) for i in frozen[:, 0]]
    blocked = disturbance.windows(disturbance.Block, events, robot.position_names[layout.pose :])
    blocked[:, 0] += layout.pose
    if len(blocked) and timing.integrator != "stick" and loop.plant == "ideal":
        why, fix = "only there is friction that holds", "use time.integrator = 'stick'"
        raise ConfigError("a blocked joint", why=why, fix=fix, key="time.integrator")
    _, load = disturbance.payload(events)
    limits = np.zeros(0)
    if loop.safety is not None:
        gains, K = stopping_gains(loop), loop.kinematic.arm_gains(layout)
        short = bool(layout.base) and bool(np.all(motors[: layout.motors - layout.arm, motor.BRAKE] > 0.0))
        limits = loop.safety.numbers(robot, timing.control_period, gains, K, short)
    p, m, nv = layout.dof, layout.motors, layout.full
    guard = safety.new_memory(layout)
    parts = (sensing.init(), np.zeros((m, motor.STATES + 1)), guard, np.zeros(len(frozen)), np.zeros(p))
    values, views = flat(parts)
    views[1][:, motor.ROTOR_SPEED] = robot.E.T @ nu
    values[:] = values if given is None else require_memory(given, values.size)
    return Rig(
        exact=is_exact,
        driven=not loop.actuator.perfect or len(dead) > 0,
        supervised=loop.safety is not None,
        recorded=recorded,
        encoders=sensing.encoders,
        W=sensing.W,
        sensors=sensing.numbers,
        noise=noise,
        motor_side=motor_side,
        frozen=frozen,
        E=np.ascontiguousarray(robot.E),
        E_inv=np.ascontiguousarray(np.linalg.pinv(robot.E)),
        motors=motors,
        supply=loop.actuator.supply(),
        dead=dead,
        limits=limits,
        weights=places_of_weights(loop, memory),
        fates=disturbance.commands(events, timing),
        pushes=disturbance.pushes(events, robot),
        gusts=disturbance.gusts(events, timing.samples, gust_rng),
        blocked=blocked,
        pick=np.inf if load is None else float(load.start),
        memory=values,
        sensor=views[0],
        states=views[1],
        guard=views[2],
        held=views[3],
        sent=views[4],
        shift=np.zeros(2),
        position=np.zeros(nv),
        nu=np.zeros(p),
        command=np.zeros(m),
        speed=np.zeros(m),
        is_dead=np.zeros(m),
        force=np.zeros(p),
        total=np.zeros(p),
        tau=np.zeros(p),
    )


def flat(parts: tuple[Array, ...]) -> tuple[Array, list[Array]]:
    """One flat array with the values of all parts, and views of their shapes into it."""
    values = np.concatenate([part.ravel() for part in parts])
    ends = np.cumsum([part.size for part in parts])
    return values, [values[e - part.size : e].reshape(part.shape) for e, part in zip(ends, parts, strict=True)]


def require_memory(given: Array | None, size: int) -> Array:
    """A rig's memory that fits.

    Raises:
        ConfigError: It has another size, or is not finite.
    """
    array = np.zeros(size) if given is None else np.array(given, float)
    if array.shape != (size,) or not np.isfinite(array).all():
        what = f"of shape {array.shape}" if array.shape != (size,) else "not finite"
        raise ConfigError(f"an array that is {what}", fix=f"give finite numbers of shape ({size},)", key="rig_memory")
    return array


def measured_joints(robot: Robot) -> tuple[str, ...]:
    """Joints with an encoder: drive wheels, then the arm."""
    wheels = [wheel.joint for wheel in robot.base.wheels] if robot.layout.base else []
    return (*wheels, *robot.joint_names)


def stopping_gains(loop: Loop) -> Array:
    """Gains on nu by which a supervisor brakes, (p,): the controller's feedback, or 20 1/s times the inertias."""
    if isinstance(loop.controller, CompiledController):
        return loop.controller.feedback_gain(loop.robot.layout)
    M = Dynamics(loop.nominal or loop.robot).mass_matrix(loop.robot.neutral_position())
    return min(STOP_BANDWIDTH, 0.5 / loop.timing.control_period) / np.diag(np.linalg.inv(M))


def places_of_weights(loop: Loop, memory: Memory | object) -> IntArray:
    """Start and stop of every array of weights in a controller's memory, (k, 2)."""
    if not isinstance(memory, Memory) or not isinstance(loop.controller, CompiledController):
        return np.zeros((0, 2), np.int64)
    names, ends = list(memory.shapes), np.cumsum([0, *(int(np.prod(shape)) for shape in memory.shapes.values())])
    found = [names.index(name) for name in loop.controller.weights(memory)]
    return np.array([(ends[i], ends[i + 1]) for i in found], np.int64).reshape(-1, 2)


@compiled
def sense(
    number: int, time: float, row: Array, at: IntArray, position: Array, nu: Array, arm: IntArray, rig: Rig
) -> None:
    """Take the measurement of this number into the row.

    Args:
        number: Of the measurement.
        time: [s].
        row: (width,) row of signals.
        at: Offsets of the signals.
        position: (nv,) true position.
        nu: (p,) true velocity.
        arm: (n,) places of the arm joints in the position.
        rig: The rig.
    """
    is_new, measured = True, time
    if rig.exact:
        exact(row, at, position, nu, arm)
    else:
        copy_to(position, rig.position)
        copy_to(nu, rig.nu)
        if rig.motor_side:
            lead(nu, rig)
        freeze(time, rig)
        before = rig.sensor[RECEIVED] if rig.sensor[COUNT] > 0.0 else -1.0
        measure(row, at, rig.position, rig.nu, rig.encoders, rig.W, rig.sensors, rig.noise[number], rig.sensor)
        is_new = rig.sensor[RECEIVED] != before
        measured = rig.sensor[RECEIVED] * rig.sensors[PERIOD]
    if rig.supervised:
        safety.accept(row, at, measured, time, is_new, rig.guard)


@compiled
def lead(nu: Array, rig: Rig) -> None:
    """Positions and speeds of the motors in place of those of their joints."""
    n = rig.encoders.size - rig.W.shape[1]
    for j in range(rig.motors.shape[0]):
        if rig.motors[j, motor.GAP] > 0.0:
            rig.position[int(rig.motors[j, motor.PLACE])] += rig.states[j, motor.AHEAD]
            i = j - (rig.motors.shape[0] - n)
            if i >= 0:
                rig.nu[nu.size - n + i] = rig.states[j, motor.ROTOR_SPEED]


@compiled
def freeze(time: float, rig: Rig) -> None:
    """Encoders that keep their reading, and what they kept."""
    n = rig.encoders.size - rig.W.shape[1]
    for k in range(rig.frozen.shape[0]):
        place = int(rig.frozen[k, 0])
        if rig.sensor[COUNT] == 0.0 or time + 5e-10 < rig.frozen[k, 1] or time + 5e-10 >= rig.frozen[k, 2]:
            rig.held[k] = rig.position[place]
            continue
        rig.position[place] = rig.held[k]
        for i in range(n):
            if rig.encoders[rig.W.shape[1] + i] == place:
                rig.nu[rig.nu.size - n + i] = 0.0


@compiled
def is_stopped(rig: Rig) -> bool:
    """Whether the supervisor does without the controller."""
    return rig.supervised and not safety.may_learn(rig.guard)


@compiled
def send(k: int, time: float, row: Array, at: IntArray, weights: Array, rig: Rig) -> None:
    """The torque of control sample k on its way to the motors: what is lost or broken, and what the supervisor does.

    Args:
        k: Number of the control sample.
        time: [s].
        row: (width,) row of signals; its torque becomes the one that reaches the motors.
        at: Offsets of the signals.
        weights: The controller's memory.
        rig: The rig.
    """
    tau, fate = row[at[TORQUE] : at[TORQUE + 1]], rig.fates[k]
    if rig.supervised and not safety.may_learn(rig.guard):
        for i in range(at[PSI_HAT], at[TORQUE + 1]):  # the controller was not asked
            row[i] = 0.0
    if fate == 2.0:
        tau[:] = np.nan
    elif fate == 1.0:
        copy_to(rig.sent, tau)
    if rig.supervised:
        safety.supervise(row, at, time, fate != 1.0, rig.E, rig.E_inv, rig.limits, rig.guard, rig.weights, weights)
    copy_to(tau, rig.sent)
    for j in range(rig.command.size):
        rig.command[j] = 0.0
        for i in range(tau.size):
            rig.command[j] += rig.E_inv[j, i] * tau[i]
        rig.states[j, motor.SUM] = 0.0
    rig.total[:] = 0.0


@compiled
def rotate(nu: Array, rig: Rig) -> None:
    """Speeds of the motors of a robot whose wheels roll, `E' nu`."""
    for j in range(rig.speed.size):
        rig.speed[j] = 0.0
        for i in range(nu.size):
            rig.speed[j] += rig.E[i, j] * nu[i]


@compiled
def act(k: int, time: float, dt: float, row: Array, at: IntArray, rig: Rig) -> None:
    """Generalized torque over one step of the plant, of motors and pushes, into `rig.tau`; `rig.speed` is set.

    Args:
        k: Number of the control sample.
        time: Start of the step [s].
        dt: Step [s].
        row: (width,) row of signals.
        at: Offsets of the signals.
        rig: The rig.
    """
    copy_to(row[at[TORQUE] : at[TORQUE + 1]], rig.tau)
    if rig.driven:
        disturbance.mark(time, rig.dead, rig.is_dead, 1.0)
        motor.drive(dt, rig.command, rig.speed, rig.is_dead, shorted(row, at, rig), rig.motors, rig.supply, rig.states)
        for i in range(rig.tau.size):
            rig.tau[i] = 0.0
            for j in range(rig.command.size):
                rig.tau[i] += rig.E[i, j] * rig.states[j, motor.STATES]
    if rig.pushes.shape[0]:
        gust = rig.gusts[k] if rig.gusts.shape[0] else rig.force
        disturbance.push(time, dt, rig.pushes, gust, rig.force)
        for i in range(rig.tau.size):
            rig.tau[i] += rig.force[i]
            rig.total[i] += rig.force[i]


@compiled
def shorted(row: Array, at: IntArray, rig: Rig) -> int:
    """How many motors, from the first on, have their windings shorted by the supervisor."""
    if not rig.supervised or row[at[SAFETY]] < safety.STOPPING:
        return 0
    n = rig.encoders.size - rig.W.shape[1]
    if row[at[SAFETY]] == safety.RAMPING:
        return int(rig.command.size)
    return int(rig.command.size - n) if rig.limits[safety.SHORT] > 0.0 else 0


@compiled
def note(steps: int, row: Array, at: IntArray, rig: Rig) -> None:
    """What motors and pushes gave on average over a control period, into its row, once it is over."""
    for j in range(at[APPLIED + 1] - at[APPLIED]):
        given = rig.states[j, motor.SUM] / steps if rig.driven else rig.command[j]
        row[at[APPLIED] + j] = given if np.isfinite(given) else 0.0
    for i in range(at[DISTURBANCE + 1] - at[DISTURBANCE]):
        row[at[DISTURBANCE] + i] = rig.total[i] / steps

"""The rig of a loop, from its settings."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from ... import actuator as motor
from ... import disturbance, safety
from ...errors import ConfigError
from ...model.dynamics import Dynamics
from ...model.robot import Robot
from ...sensing.encoders import DEPTH
from ...settings import given_array
from ...signals import Array, IntArray
from ...torque.controller import CompiledController, ControllerState
from ...torque.learning_law import LearningLaw
from .parts import Hardware

if TYPE_CHECKING:
    from ..loop import Loop

STOP_BANDWIDTH = 20.0  # of a stop under a controller whose gains are not known [1/s]


def new_hardware(loop: Loop, nu: Array, state: ControllerState | object, given: Array | None = None) -> Hardware | None:
    """The rig of a loop; None where there is nothing but an ideal robot.

    Args:
        loop: The closed loop.
        nu: (p,) where it starts from.
        state: The controller's memory.
        given: The rig's memory to start from, copied; None for a new one.

    Raises:
        ConfigError: Settings that do not fit the robot; a memory of wrong shape or not finite.
        UnknownName: A joint that does not exist.
    """
    robot, layout, timing, events = loop.robot, loop.layout, loop.timing, loop.disturbances
    disturbance.require_long_enough(events, timing.plant_step)
    late, added = disturbance.lateness(events, timing), disturbance.corruption(events, timing)
    frozen = disturbance.windows(disturbance.Frozen, events, measured_joints(robot))
    motors = loop.actuator.motors(robot, timing.plant_step)
    motor_side = loop.sensor.side == "motor" and bool(motors[:, motor.GAP].any())
    is_exact = loop.sensor.exact and not (late.any() or added.any() or len(frozen) or motor_side)
    require_read_encoders(loop)
    dead = disturbance.windows(disturbance.DeadMotor, events, robot.actuator_names)
    recorded = bool(layout.hardware)
    if is_exact and not recorded:
        if given is not None:
            given_array("hardware_state", given, (0,))
        return None
    sensing = loop.sensor.on(robot, timing.measurement_period)
    sensing.numbers[DEPTH] += max(late.max(initial=0.0), 0.0)
    sensor_rng, gust_rng = loop.streams()
    noise = sensing.noise(0 if is_exact else timing.measurements, sensor_rng)
    if not is_exact:
        noise[:, -2], noise[:, -1] = late, added
    frozen[:, 0] = [robot.position_names.index(measured_joints(robot)[int(i)]) for i in frozen[:, 0]]
    _, load = disturbance.payload(events)
    p, m, nv = layout.dof, layout.motors, layout.full
    guard = safety.new_state(layout)
    parts = (sensing.init(), np.zeros((m, motor.STATES + 1)), guard, np.zeros(len(frozen)), np.zeros(p))
    values, views = flat(parts)
    views[1][:, motor.ROTOR_SPEED] = robot.E.T @ nu
    if given is not None:  # messages of no numbers may be under way
        values[:] = given_array("hardware_state", given, values.shape, finite=not np.isnan(added).any())
    return Hardware(
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
        limits=supervisor_limits(loop, motors),
        weights=places_of_weights(loop, state),
        fates=disturbance.commands(events, timing),
        pushes=disturbance.pushes(events, robot),
        gusts=disturbance.gusts(events, timing.samples, gust_rng),
        blocked=blocked_joints(loop),
        pick=np.inf if load is None else float(load.start),
        state=values,
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


def blocked_joints(loop: Loop) -> Array:
    """Windows of the blocked joints, each with its place in a position, see `disturbance.windows`.

    Raises:
        ConfigError: There are some, and the integrator has no friction that holds them.
        UnknownName: A joint that does not exist.
    """
    first = loop.robot.layout.pose
    blocked = disturbance.windows(disturbance.Block, loop.disturbances, loop.robot.position_names[first:])
    blocked[:, 0] += first
    if len(blocked) and loop.timing.integrator != "stick" and loop.plant == "ideal":
        why, fix = "only there is friction that holds", "use time.integrator = 'stick'"
        raise ConfigError("a blocked joint", why=why, fix=fix, key="time.integrator")
    return blocked


def supervisor_limits(loop: Loop, motors: Array) -> Array:
    """The numbers of the supervisor for motors (m, ...), see `Safety.numbers`; empty without one."""
    layout, timing = loop.robot.layout, loop.timing
    if loop.safety is None:
        return np.zeros(0)
    gains, K = stopping_gains(loop), loop.kinematic.arm_gains(layout)
    short = bool(layout.base) and bool(np.all(motors[: layout.motors - layout.arm, motor.BRAKE] > 0.0))
    arrivals = max(timing.control_period, timing.measurement_period)
    limits = loop.safety.numbers(loop.robot, timing.control_period, gains, K, short, arrivals)
    if not motors[:, motor.BRAKE].any():  # nothing brakes but feedback
        limits[safety.SETTLE] = np.inf
    return limits


def flat(parts: tuple[Array, ...]) -> tuple[Array, list[Array]]:
    """One flat array with the values of all parts, and views of their shapes into it."""
    values = np.concatenate([part.ravel() for part in parts])
    ends = np.cumsum([part.size for part in parts])
    return values, [values[e - part.size : e].reshape(part.shape) for e, part in zip(ends, parts, strict=True)]


def measured_joints(robot: Robot) -> tuple[str, ...]:
    """Joints with an encoder: drive wheels, then the arm."""
    wheels = [wheel.joint for wheel in robot.base.wheels] if robot.layout.base else []
    return (*wheels, *robot.joint_names)


def require_read_encoders(loop: Loop) -> None:
    """A frozen encoder of a wheel is felt only where the sensors read the wheels.

    Raises:
        ConfigError: They do not.
    """
    if loop.sensor.velocity != "true" or loop.sensor.pose != "true":
        return
    for i, one in enumerate(loop.disturbances):
        if isinstance(one, disturbance.Frozen) and one.joint in [wheel.joint for wheel in loop.robot.base.wheels]:
            why = "pose and velocity of the base are measured as they are"
            fix = "use sensor.velocity = 'difference' or sensor.pose = 'odometry'"
            raise ConfigError(f"nobody reads the encoder of '{one.joint}'", why=why, fix=fix, key=f"disturbances.{i}")


def stopping_gains(loop: Loop) -> Array:
    """Gains on nu by which a supervisor brakes, (p,): the controller's feedback, or 20 1/s times the inertias.

    In the latter case `G M^-1` has no eigenvalue beyond half of what would be deadbeat in one control period.
    """
    if isinstance(loop.controller, CompiledController | LearningLaw):
        return loop.controller.feedback_gain(loop.robot.layout)
    M = Dynamics(loop.nominal or loop.robot).mass_matrix(loop.robot.neutral_position())
    fastest = float(np.linalg.eigvals(np.linalg.solve(M, np.diag(np.diag(M)))).real.max())
    return min(STOP_BANDWIDTH, 0.5 / (loop.timing.control_period * fastest)) * np.diag(M)


def places_of_weights(loop: Loop, state: ControllerState | object) -> IntArray:
    """Start and stop of every array of weights in a controller's memory, (k, 2)."""
    names, ends = list[str](), np.zeros(1, np.int64)
    if isinstance(state, ControllerState):
        names, ends = list(state.shapes), np.cumsum([0, *(int(np.prod(shape)) for shape in state.shapes.values())])
    found = loop.controller.weights(state)  # type: ignore[arg-type]
    if loop.safety is not None and loop.safety.weights is not None and not set(found) <= set(names):
        what = f"the weights of '{loop.controller.name}' cannot be bounded"
        why, fix = "they are not parts of a `ControllerState`", "let its init return one, or leave safety.weights out"
        raise ConfigError(what, why=why, fix=fix, key="safety.weights")
    places = [names.index(name) for name in found if name in names]
    return np.array([(ends[i], ends[i + 1]) for i in places], np.int64).reshape(-1, 2)

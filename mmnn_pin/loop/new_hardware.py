"""The hardware model of a loop, made from its settings: every list of effects is put together here or in its block."""

from __future__ import annotations

import math
from typing import Any

import msgspec
import numpy as np

from .. import actuator as motor
from .. import disturbance, safety
from ..actuator import Motors, MotorState
from ..compliance import Compliance, Held, compliance_of, compliance_size
from ..disturbance import Forces, Touched
from ..elementary.matrices import inverse, product, pseudo_inverse, svd
from ..errors import ConfigError
from ..kinematic import Steering
from ..model.robot import Robot, limits
from ..model.tree.twin import Twin
from ..safety import Supervisor
from ..sensing import FrozenEncoders, Sensor
from ..settings import given_array
from ..signals import Array, IntArray, Layout
from ..torque.controller import CompiledController, ControllerState
from ..torque.learning_law import LearningLaw
from ..touch import Feeler, Sending, new_feeler, new_state, touch_shapes
from .before_run import Start, viscous_friction
from .controller import regressor_of
from .hardware import CommandLine, Expected, Hardware, MotorSide, SentTorque, Totals, Way, World
from .latency import Transport
from .lead import leads
from .servo import Split, interfaces_of, laws, own_velocities, require_no_torque_regressor, split_of, state_size
from .servo_model import servo_slots, servos_of
from .setup import Setup, believed_by, freezes
from .suited import effective_inertia, postures

STOP_BANDWIDTH = 20.0  # of a stop under a controller whose gains are not known [1/s]


def new_hardware(
    loop: Setup,
    at: tuple[Array, Array],
    state: ControllerState | object,
    given: Array | None = None,
    steering: Steering | None = None,
) -> Hardware | None:
    """The hardware model of a loop; None where there is nothing but an ideal robot.

    Args:
        loop: The closed loop.
        at: Position (nv,) and velocity nu (p,) where it starts from.
        state: The controller's state.
        given: The hardware's state to start from, copied; None for a new one.
        steering: Of a base that steers, the one of the loop's plan; None for others.

    Raises:
        ConfigError: Settings that do not fit the robot; a state of wrong shape or not finite.
        UnknownName: A joint that does not exist.
    """
    robot, true, layout = loop.robot, loop.true, loop.layout
    position, nu = at
    timing, events = loop.timing, loop.disturbances
    if not layout.hardware and given is None and loop.sensor == Sensor():
        return None  # nothing to judge
    disturbance.require_long_enough(events, timing.plant_step)
    faults = np.column_stack((disturbance.lateness(events, timing), disturbance.corruption(events, timing)))
    frozen, geared = frozen_encoders(loop), geared_motors(loop)
    dead = disturbance.windows(disturbance.DeadMotor, events, robot.actuator_names)
    sensor = late(loop)
    is_exact = sensor.exact and not (faults.any() or len(frozen) or len(geared))
    at_start = np.zeros((layout.motors, motor.STATES))
    motor.motor_state(at_start).rotor_speed[:] = product(true.E_at(position).T, nu)
    sensed = sensor.init(robot, timing.measurement_period, faults)
    kinds, on = interfaces_of(robot, loop.interfaces)
    under_way = np.zeros((loop.latency.slots(timing), layout.motors))
    slots = servo_slots(loop.servo, loop.latency.command, timing.plant_step) if on.any() else 0
    parts: tuple[Array, ...]
    parts = (sensed, at_start, safety.new_state(layout), np.zeros(len(frozen)), np.zeros(layout.dof), under_way)
    places = layout.dof - own_velocities(robot)
    parts = (*parts, np.zeros(state_size(on, places)), np.zeros((slots, layout.motors)))
    parts = (*parts, np.zeros(disturbance.scene_size(events)), np.zeros(compliance_size(loop.impedance)))
    parts = (*parts, *touch_state(loop, state))
    values, (sensed, kept, guard, held, sent, under_way, rows, ring, seen, yielding, *felt) = flat(parts)
    frame = disturbance.touched_frame(events, robot)
    scene = disturbance.scene_of(events, true, timing.plant_step, position, seen, frame)
    states = motor.motor_state(kept)
    motors = loop.actuator.motors(true, timing.plant_step, dead, states)
    if true is not robot:
        motors = motors._replace(imperfect=True)
    require_read_encoders(loop)
    if is_exact and not layout.hardware:
        if given is not None:
            given_array("hardware_state", given, (0,))
        return None
    sensor_rng, gust_rng, delay_rng = loop.streams()
    split = split_of(robot, kinds, loop.servo, timing.control_period, rows, loop.known.total, steering)
    if split is not None:
        require_no_torque_regressor(loop.controller, loop.context())
        servos = servos_of(robot, kinds, loop.servo, loop.actuator, split, (states, ring), timing.plant_step)
        motors = motors._replace(imperfect=True, effects=(servos, *motors.effects))
    if len(under_way):  # of torques; what is asked of a servo is under way in its ring
        way = Transport(timing.plant_step, loop.latency.in_force(timing, delay_rng), under_way)
        motors = motors._replace(imperfect=True, effects=(way, *motors.effects))
    count = 0 if is_exact else timing.measurements
    sensors = sensor.on(robot, timing.measurement_period, count, sensor_rng, faults, sensed)
    before = (MotorSide(geared, states), FrozenEncoders(frozen, held))
    if given is not None:  # messages of no numbers may be under way; infinite is a time that never was
        numbers = not np.isnan(faults[:, 1]).any()
        values[:] = given_array("hardware_state", given, values.shape, finite=numbers, endless=True)
    return Hardware(
        exact=is_exact,
        sensors=sensors._replace(effects=(*before, *sensors.effects)),
        way=Way(
            line=SentTorque(np.zeros(layout.dof), np.zeros(1)),
            lines=(CommandLine(disturbance.commands(events, timing), sent),),
            supervisor=supervisor_of(loop, state, guard, steering, split),
            E_inv=pseudo_inverse(robot.E) if steering is None else steering.E_inv,
            totals=totals_of(motors, states, layout, scene),
            sent=sent,
            shorted=motors.wire.shorted,
            expected=expected_of(loop, sensors.wire.acceleration),
        ),
        motors=motors,
        world=world_of(loop, gust_rng, scene),
        E=np.array(true.E_at(position), order="C"),
        tau=np.zeros(layout.dof),
        state=values,
        split=split,
        touch=new_touch(loop, felt, kinds, steering),
        places=motor_rows(robot),
        turning=np.array([true.rows[name] for name in true.actuator_names] if true.steers else [], np.int64),
        task=task_of(loop, position, on, yielding),
    )


def task_of(loop: Setup, position: Array, on: Array, state: Array) -> Compliance | None:
    """The compliant hand of a loop from a position (nv,) on; None for one that is stiff.

    Args:
        loop: The closed loop.
        position: Where it starts.
        on: (p,) 1 for velocities that take no torque.
        state: What it remembers, written.

    Raises:
        ConfigError: An impedance that cannot be.
    """
    if loop.impedance is None:
        return None
    if not isinstance(loop.controller, CompiledController | LearningLaw):
        what, why = f"'{loop.controller.name}' under a compliant hand", "it tells no gain that the hand could replace"
        raise ConfigError(what, why=why, fix="use a controller of this package, or a `LearningLaw`", key="impedance")
    if loop.kinematic.guide == "trailer":
        what, why = "a compliant hand behind a guided trailer", "its setpoint is told from the base"
        raise ConfigError(what, why=why, fix='use kinematic.guide = "base"', key="kinematic.guide")
    layout = loop.layout
    felt = int(layout.where("external_wrench").start) if layout.touch else -1
    if loop.force is not None and loop.touch is not None and loop.force.gain > 0.25 * loop.touch.bandwidth:
        why, fix = f"what is felt lags by touch.bandwidth = {loop.touch.bandwidth:g} 1/s", "use at most"
        fix += f" {0.25 * loop.touch.bandwidth:g}"
        raise ConfigError(
            f"{loop.force.gain:g} 1/s", why=f"{why}, and the force would swing", fix=fix, key="force.gain"
        )
    held = Held(
        gains=stopping_gains(loop),
        rates=np.concatenate((np.zeros(layout.base), loop.kinematic.arm_gains(layout))),
        period=loop.timing.control_period,
        delay=loop.known.total + float(np.max(loop.lags, initial=0.0)),
        on=on,
        bandwidth=laws(loop.robot, loop.servo)[0],
        friction=viscous_friction(loop.robot),
    )
    return compliance_of(loop.impedance, loop.force, loop.robot, believed_by(loop), held, position, state, felt)


def touch_state(loop: Setup, state: ControllerState | object) -> list[Array]:
    """Room for the state of what feels external torque, nothing where nothing does."""
    if loop.touch is None:
        return []
    motion, timing = regressor_of(described_by(loop)), loop.timing
    saved = state.values.size if isinstance(state, ControllerState) and freezes(loop) else 0
    shapes = touch_shapes(motion, loop.robot.dimensions, touch_way(loop), timing.control_period, saved)
    return [np.zeros(shape) for shape in shapes]


def described_by(loop: Setup) -> Robot:
    """The robot that external torque is measured against: the nominal one, or as its file describes it."""
    return loop.nominal or loop.robot.described


def touch_way(loop: Setup) -> float:
    """Known time from the command of a torque to the measurement whose velocities show it [s]."""
    held = max(0.0, loop.timing.measurement_period - loop.timing.control_period)
    return loop.known.way(loop.timing) + max(0.0, loop.smoothing - held)


def new_touch(loop: Setup, parts: list[Array], kinds: tuple[str, ...], steering: Steering | None) -> Feeler | None:
    """The observer of external torque, with its state in some arrays; None for nothing.

    Raises:
        ConfigError: A controller without Psi_hat is to be the model; else as of `touch.new_feeler`.
        UnknownName: No such hand.
    """
    touch, robot, timing = loop.touch, loop.robot, loop.timing
    if touch is None:
        if loop.safety is not None and loop.safety.contact != "go on":
            why, fix = "nothing feels contact", "add the table [touch], or --set touch.model=both"
            raise ConfigError(f"'{loop.safety.contact}' at contact", why=why, fix=fix, key="safety.contact")
        return None
    if not leads(loop.controller):
        if touch.model == "learner":
            why, fix = f"'{loop.controller.name}' has none", "use touch.model = 'urdf'"
            raise ConfigError("Psi_hat of the controller as the model", why=why, fix=fix, key="touch.model")
        touch = msgspec.structs.replace(touch, model="urdf")
    described = described_by(loop)
    most = limits(loop.actuator.torque_limit, robot.effort_limits, "motor", "actuator.torque_limit")
    sending = Sending(
        period=timing.control_period,
        every=max(1, round(timing.measurement_period / timing.control_period)),
        way=touch_way(loop),
        lag=loop.lags,
        most=np.array(most, float),
        E=np.array(robot.E, order="C") if steering is None else steering.E,
        E_inv=pseudo_inverse(robot.E) if steering is None else steering.E_inv,
        felt=np.array([kind == "effort" for kind in kinds], float),
        gains=stopping_gains(loop),
        gives=loop.safety is not None and loop.safety.contact == "comply",
        eases=loop.impedance is None,
        loads=loop.force is None,
    )
    return new_feeler(touch, described, regressor_of(described), sending, new_state(parts))


def motor_rows(robot: Robot) -> IntArray:
    """Places of the motors' joints in the position, (motors,); negative for a base that forces drive."""
    names = robot.position_names
    return np.array([names.index(name) if name in names else -1 for name in robot.actuator_names], np.int64)


def expected_of(loop: Setup, acceleration: Array) -> Expected:
    """The expectation for an observer on a model, in an acceleration (p,) of its state; without one its size is 0.

    No velocity counts as lighter than its gain times the control period: what a sample answers to it would be expected
    to turn it round, and the expectation would swing by itself.
    """
    if not acceleration.size:
        return Expected(np.zeros(0), 0.0, acceleration)
    believed = believed_by(loop)
    places = (Start().state(believed, row)[0] for row in postures(believed))
    h = loop.timing.control_period
    inertia = np.maximum(effective_inertia(believed, places, h), h * stopping_gains(loop))
    return Expected(inertia, float(leads(loop.controller)), acceleration)


def late(loop: Setup) -> Sensor:
    """The sensors of a loop, their line as late as its latency says.

    Raises:
        ConfigError: That is no whole number of measurements.
    """
    delay = loop.latency.measurements(loop.timing)
    return msgspec.structs.replace(loop.sensor, delay=loop.sensor.delay + delay) if delay else loop.sensor


def flat(parts: tuple[Array, ...]) -> tuple[Array, list[Array]]:
    """One flat array with the values of all parts, and views of their shapes into it."""
    values = np.concatenate([part.ravel() for part in parts])
    pieces = np.split(values, np.cumsum([part.size for part in parts])[:-1])
    return values, [piece.reshape(part.shape) for piece, part in zip(pieces, parts, strict=True)]


def geared_motors(loop: Setup) -> IntArray:
    """Motors whose encoder backlash separates from the joint, (k, 3), see `MotorSide`."""
    layout, found = loop.robot.dimensions, []
    places = motor.motor_places(loop.robot)
    if loop.sensor.side == "motor":
        gaps = np.broadcast_to(loop.actuator.gap, layout.motors)
        first = layout.motors - layout.arm
        found = [(j, places[j], layout.base + j - first if j >= first else -1) for j in np.flatnonzero(gaps > 0)]
    return np.array(found, np.int64).reshape(-1, 3)


def frozen_encoders(loop: Setup) -> Array:
    """Windows of the frozen encoders, (k, 4), see `FrozenEncoders`.

    Raises:
        UnknownName: A joint that does not exist.
    """
    robot = loop.robot
    wheels = [*(wheel.joint for wheel in robot.base.wheels), *robot.base.shape] if robot.dimensions.base else []
    names = [*wheels, *robot.joint_names]
    windows = disturbance.windows(disturbance.FrozenEncoder, loop.disturbances, names)
    found = [
        (
            robot.position_names.index(names[int(i)]),
            start,
            end,
            robot.dimensions.base + i - len(wheels) if i >= len(wheels) else -1,
        )
        for i, start, end in windows
    ]
    return np.array(found, float).reshape(-1, 4)


def totals_of(motors: Motors, states: MotorState, layout: Layout, scene: Touched | None) -> Totals:
    """The sums over a control period, of a scene those of its forces, too."""
    hand, work = np.zeros(0 if scene is None else 3), np.zeros(2)
    done = np.zeros(0) if scene is None else scene.done[disturbance.WORK :]
    door = scene.state[-2:] if scene is not None and scene.door.size else np.zeros(0)
    return Totals(motors.imperfect, states, np.zeros(layout.motors), np.zeros(layout.dof), hand, work, done, door)


def world_of(loop: Setup, rng: np.random.Generator, scene: Touched | None) -> World:
    """The disturbances from outside in a run.

    Raises:
        ConfigError: Blocked joints, and the integrator has no friction that holds them; two payloads.
        UnknownName: A joint or velocity that does not exist.
    """
    robot, timing, first = loop.robot, loop.timing, loop.robot.dimensions.pose
    pushes = disturbance.pushes(loop.disturbances, robot, timing.plant_step, timing.samples, rng)
    blocked = disturbance.windows(disturbance.BlockedJoint, loop.disturbances, robot.position_names[first:])
    blocked[:, 0] += first
    if len(blocked) and timing.integrator != "stick" and loop.plant == "ideal":
        why, fix = "only there is friction that holds", "use time.integrator = 'stick'"
        raise ConfigError("a blocked joint", why=why, fix=fix, key="time.integrator")
    _, load = disturbance.payload(loop.disturbances)
    pick, drop = (math.inf, math.inf) if load is None else (float(load.start), float(load.end))
    d = robot.dimensions
    forces, effects = Forces(np.zeros(d.dof)), tuple[Any, ...]((pushes,))
    if scene is not None:
        forces = forces._replace(
            position=np.zeros(d.full), nu=np.zeros(d.dof), by_hand=np.zeros(d.dof), hand=np.zeros(6), n=np.zeros(3)
        )
        effects = (pushes, scene)
    return World(len(pushes.table) > 0 or scene is not None, forces, effects, blocked, pick, drop, np.zeros(2))


def supervisor_of(
    loop: Setup, state: ControllerState | object, values: Array, steering: Steering | None, split: Split | None
) -> Supervisor:
    """The supervisor of a loop with a state (see `safety.new_state`), the steering of its plan and its servo rows."""
    layout, timing, actuator = loop.robot.dimensions, loop.timing, loop.actuator
    weights = places_of_weights(loop, state)
    if loop.safety is None:
        return safety.no_supervisor(layout, values)
    brakes = np.broadcast_to(actuator.brake, layout.motors)
    stops_base = bool(layout.base) and bool(np.all(brakes[: layout.motors - layout.arm] > 0.0))
    has_model_alone = isinstance(loop.controller, CompiledController) and not (
        isinstance(state, ControllerState) and state.values.size
    )  # what remembers nothing learns nothing
    guard = msgspec.structs.replace(loop.safety, shaking="none") if has_model_alone else loop.safety
    return guard.supervisor(
        loop.robot,
        timing.control_period,
        stopping_gains(loop),
        loop.kinematic.arm_gains(layout),
        brakes="base" if stops_base else "some" if np.any(brakes > 0) else "none",
        arrivals=max(timing.control_period, timing.measurement_period),
        weights=weights,
        values=values,
        steering=steering,
        asked=None if split is None else split.asked,
    )


def require_read_encoders(loop: Setup) -> None:
    """A frozen encoder of a wheel is felt only where the sensors read the wheels.

    Raises:
        ConfigError: They do not.
    """
    if loop.sensor.velocity != "true" or loop.sensor.pose != "true":
        return
    wheels = [wheel.joint for wheel in loop.robot.base.wheels]
    for i, one in enumerate(loop.disturbances):
        if isinstance(one, disturbance.FrozenEncoder) and one.joint in wheels:
            why = "pose and velocity of the base are measured as they are"
            fix = "use sensor.velocity = 'difference' or sensor.pose = 'odometry'"
            raise ConfigError(f"nobody reads the encoder of '{one.joint}'", why=why, fix=fix, key=f"disturbances.{i}")


def stopping_gains(loop: Setup) -> Array:
    """Gains on nu by which a supervisor brakes, (p,): the controller's feedback, or 20 1/s times the inertias.

    In the latter case `G M^-1` has no eigenvalue beyond half of what would be deadbeat in one control period.
    """
    if isinstance(loop.controller, CompiledController | LearningLaw):
        return loop.controller.feedback_gain(loop.robot.dimensions)
    M = Twin(loop.nominal or loop.robot).mass_matrix(loop.robot.neutral_position())
    root = np.sqrt(np.diag(M))
    fastest = svd(root[:, None] * inverse(M) * root)[1][0]  # eigenvalue of diag(M) M^-1, which this is similar to
    return min(STOP_BANDWIDTH, 0.5 / (loop.timing.control_period * fastest)) * np.diag(M)


def places_of_weights(loop: Setup, state: ControllerState | object) -> IntArray:
    """Start and stop of every array of weights in a controller's state, (k, 2)."""
    names, ends = list[str](), np.zeros(1, np.int64)
    if isinstance(state, ControllerState):
        names, ends = list(state.shapes), np.cumsum([0, *(int(np.prod(shape)) for shape in state.shapes.values())])
    found = loop.controller.weights(state)
    if loop.safety is not None and loop.safety.weights is not None and not set(found) <= set(names):
        what = f"the weights of '{loop.controller.name}' cannot be bounded"
        why, fix = "they are not parts of a `ControllerState`", "let its init return one, or leave safety.weights out"
        raise ConfigError(what, why=why, fix=fix, key="safety.weights")
    places = [names.index(name) for name in found if name in names]
    return np.array([(ends[i], ends[i + 1]) for i in places], np.int64).reshape(-1, 2)

"""Limits of a supervisor as settings and for one robot, and what its state tells after a run."""

from __future__ import annotations

import math
from typing import Any, Literal, Protocol

import numpy as np

from ..elementary import exp, hypot
from ..elementary.matrices import inverse, pseudo_inverse
from ..errors import ConfigError
from ..model.base.rolling import Maps
from ..model.base.steered import SteeredBase
from ..model.robot import Robot, limits, revolute, speed_limits
from ..model.tree.twin import Twin
from ..settings import Numbers, Settings, require_numbers
from ..signals import Array, Dimensions, IntArray
from .supervisor import (
    BAD_WEIGHTS,
    BLIND,
    DEAF,
    JUMPED,
    LOST,
    MARKS,
    OFF_HEADING,
    OFF_JOINT,
    OFF_PATH,
    OVER_SPEED,
    OVER_TORQUE,
    OVER_TWIST,
    OVER_WHEEL,
    PRESSED,
    SHAKING,
    TOO_SLOW,
    TOUCHED,
    USUAL,
    Door,
    Supervisor,
    SupervisorNumbers,
    SupervisorState,
)

MAY_BE_ZERO = ("torque_time", "stop_time", "settle", "hold_rate", "ramp")
SHAKES, NYQUIST, LASTS = (
    10.0,
    0.125,
    1.0,
)  # of shaking: from what frequency on [Hz], at most that part of samples; for how long [s]
FRESH = 5.5  # measurements that fail to come before a stop does without
FASTEST, FASTEST_SLIDE = 10.0, 2.0  # speed that explains a joint's motion where no limit is known [rad/s, m/s]
BASE_CONTRADICTION = 0.05  # of pose and velocities of the base in a stop, on a robot [m, rad]
TIMEOUT = 0.5  # that of ros2_controllers [s]
AT_FIRST = 0.04  # how old values get before they are known [s]
REACH = (0.05, 0.2)  # that a length and an angle may change unseen [m, rad]
POSTURES = 8  # at which the robot is moved most easily
STEERING_JUMP = 0.1  # of a pivot, where jumps are judged [rad]
# What passed its limit: the signal, words, and the unit, that of a sliding joint where there are two.
SIGNAL = {OVER_TORQUE: "motor_torque", OFF_PATH: "pose_error", OFF_HEADING: "pose_error", OFF_JOINT: "e"}
SIGNAL |= {DEAF: "measurement", LOST: "command", BAD_WEIGHTS: "weights", PRESSED: "stop", BLIND: "measurement"}
SIGNAL |= {
    SHAKING: "motor_torque",
    TOUCHED: "contact",
    OVER_TWIST: "velocity",
    OVER_WHEEL: "velocity",
    JUMPED: "q",
    TOO_SLOW: "time",
}
WHAT = {OVER_TORQUE: "torque", OVER_SPEED: "speed", OFF_PATH: "position error", OFF_HEADING: "heading error"}
WHAT |= {OVER_TWIST: "speed", OVER_WHEEL: "speed", TOO_SLOW: "control period", JUMPED: "jump"}
WHAT |= {OFF_JOINT: "joint error", DEAF: "age of the measurement", LOST: "age of the command"}
UNIT = {OVER_TORQUE: " N m", OVER_SPEED: " rad/s", OFF_PATH: " m", OFF_HEADING: " rad", OFF_JOINT: " rad"}
UNIT |= {
    SHAKING: " N m",
    DEAF: " s",
    LOST: " s",
    OVER_TWIST: " rad/s",
    OVER_WHEEL: " rad/s",
    JUMPED: " rad",
    TOO_SLOW: " s",
}
SLIDING = {
    SHAKING: " N",
    OVER_TWIST: " m/s",
    OVER_TORQUE: " N",
    OVER_SPEED: " m/s",
    OFF_JOINT: " m",
    OVER_WHEEL: " m/s",
    JUMPED: " m",
}
UNIT[BLIND], SLIDING[BLIND] = " rad", " m"


class Standing(Protocol):
    """How a base that steers stands where it is measured, kept so by `kinematic.steer`: a `Steering` does."""

    @property
    def maps(self) -> Maps:
        """Its maps."""

    @property
    def E(self) -> Array:
        """(p, motors) torque on nu from motor torques."""

    @property
    def E_inv(self) -> Array:
        """(motors, p) and back."""


class Safety(Settings, frozen=True):
    """Limits of a run on hardware, and what happens when one is passed. None is no limit.

    On a robot (`Stepper`, `mmnn ros2`, `mmnn embed`) None is a limit by the URDF and the gains where `on_a_robot` says
    so, and "none" is no limit there.

    Args:
        torque: Largest motor torque, clipped; one number or one per motor [N m or N], "urdf" for the URDF's limits.
        torque_time: How long a motor may ask for more before that trips [s].
        speed: Largest speed of the base [m/s].
        yaw_rate: Largest yaw rate of the base [rad/s].
        joint_speed: Largest speed of an arm joint, one number or one per joint [rad/s or m/s], "urdf" for the URDF's.
        wheel_speed: Largest speed of a drive wheel by the measured velocity of the base, one number or one per wheel
            [rad/s], "urdf" for the URDF's.
        steering_rate: Largest rate of a joint by which a motor steers, one number or one per joint [rad/s].
        position_error: Largest distance of the base from its reference [m].
        heading_error: Largest heading error [rad].
        joint_error: Largest error of an arm joint, one number or one per joint [rad or m].
        jump: Largest change of a joint's measured position between two measurements beyond what its speed explains, one
            number or one per joint [rad or m].
        slowest: Longest control period on average over some 10 samples [s].
        shaking: Largest RMS over a second of the learned torque (Psi_hat and robust term) faster than 10 Hz, as a share
            of a motor's limit (`torque`, else the URDF's). A learner beyond it shakes the motor. Psi of a model alone
            does not count.
        contact: What is done on contact (`touch`): "stop" trips; "comply" gives way, carried by the model and damped,
            and goes back slowly; "go on" leaves it to the controller.
        weights: Largest Frobenius norm of every array of weights; larger ones are scaled back at every sample.
        timeout: Age of the measurement or of the command at which it trips [s]. None: at 0.5 s, and before a joint may
            have turned 0.2 rad or slid 0.05 m, or the base moved 0.05 m or turned 0.2 rad, since the last measurement.
            A position that stays the same to the last bit while its velocity or the reference's moves on is none.
        ramp: Time in which torque goes to zero: all of it without measurements, the last command without commands [s].
        stop_time: How long a tripped run goes on, to show the stop [s].
        settle: How long feedback may take to bring the robot to rest if motors can short their windings; the stop then
            goes on without feedback [s].
        rest: Measured speed that counts as rest in a stop [m/s, rad/s].
        hold_rate: Rate of the integral that holds the arm against gravity; slower if the feedback is too weak for it
            [1/s].

    Raises:
        ConfigError: A number that is negative or not finite, or a limit of 0, with the key path.
    """

    torque: Literal["urdf"] | Numbers | None = None
    torque_time: float = 0.5
    speed: float | None = None
    yaw_rate: float | None = None
    joint_speed: Literal["urdf", "none"] | Numbers | None = None
    wheel_speed: Literal["urdf", "none"] | Numbers | None = None
    steering_rate: Literal["urdf", "none"] | Numbers | None = None
    position_error: Literal["none"] | float | None = None
    heading_error: Literal["none"] | float | None = None
    joint_error: Literal["none"] | Numbers | None = None
    jump: Literal["none"] | Numbers | None = None
    slowest: Literal["none"] | float | None = None
    shaking: Literal["none"] | float | None = None
    contact: Literal["stop", "comply", "go on"] = "go on"
    weights: float | None = None
    timeout: float | None = None
    ramp: float = 0.25
    stop_time: float = 1.5
    settle: float = 0.5
    rest: float = 0.1
    hold_rate: float = 2.0

    def __post_init__(self) -> None:
        require_numbers(self, "safety", set(self.__struct_fields__) - set(MAY_BE_ZERO))

    def supervisor(  # noqa: PLR0913 - options, by keyword alone
        self,
        robot: Robot,
        period: float,
        gains: Array,
        K: Array,
        *,
        brakes: Literal["base", "some", "none"] = "some",
        arrivals: float = 0.0,
        weights: IntArray | None = None,
        values: Array | None = None,
        steering: Standing | None = None,
        asked: Array | None = None,
    ) -> Supervisor:
        """The supervisor of one robot.

        Args:
            robot: The robot.
            period: Control period [s].
            gains: (p,) feedback that brakes and holds, on the velocities.
            K: (n,) gain of the filtered arm error.
            brakes: What shorted windings brake: the base, some velocities, or none, and then only feedback brakes.
            arrivals: Time between two measurements [s]; 0 for the control period.
            weights: (k, 2) start and stop of every array of weights in the controller's state; None for none.
            values: State, from `new_state`; None for a new one.
            steering: Of a base that steers, brought up to the measurement before `supervise`; None for others.
            asked: (p,) velocities that servos are asked for; None without servos.

        Raises:
            ConfigError: Not one number per motor or per joint, or a base that steers without its `steering`.
        """
        layout, arm = robot.dimensions, robot.arm_index
        position, heading, bound = some(self.position_error), some(self.heading_error), some(self.weights)
        timeout = TIMEOUT if self.timeout is None else self.timeout
        numbers = [timeout, self.ramp, self.stop_time, self.torque_time, position, heading, bound]
        numbers += [self._calm_rate(robot, gains), period, math.inf if brakes == "none" else self.settle, self.rest]
        numbers += [float(brakes == "base"), FRESH * (arrivals or period), some(self.slowest)]
        numbers += [some(self.speed), some(self.yaw_rate), float(self.timeout is None)]
        numbers += [1.0 - exp(-math.tau * min(SHAKES * period, NYQUIST)), 1.0 - exp(-period / LASTS)]
        numbers += [float(self.contact == "stop")]
        wheels, turns, none = layout.motors - layout.arm, revolute(robot)[arm], np.full(layout.arm, np.inf)
        urdf, steered = speed_limits(robot), steering_motors(robot)
        turned = limits(self.steering_rate, urdf[wheels - steered : wheels], "steering joint", "safety.steering_rate")
        joint_speed = limits(self.joint_speed, urdf[wheels:], "joint", "safety.joint_speed")
        wheel_speed = limits(self.wheel_speed, urdf[: wheels - steered], "wheel", "safety.wheel_speed")
        base = self._base_speeds(robot, dict(zip(robot.actuator_names[wheels - steered :], turned, strict=False)))
        torque = limits(self.torque, robot.effort_limits, "motor", "safety.torque")
        error = limits(self.joint_error, none, "joint", "safety.joint_error")
        jump = limits(self.jump, none, "joint", "safety.jump")
        known = np.where(np.isfinite(joint_speed), joint_speed, urdf[wheels:])
        fastest = np.where(np.isfinite(known), known, np.where(turns, FASTEST, FASTEST_SLIDE))
        judged = self.jump not in (None, "none")
        contradiction = [*[BASE_CONTRADICTION if judged else math.inf] * layout.base, *jump]
        speed = np.array([*base, *joint_speed], float)
        arms = [math.tau * turns, robot.lower[arm], robot.upper[arm], fastest, jump, np.isinf(joint_speed)]
        measured = np.hstack((np.array(arms, float).reshape(6, -1), pivots_of(robot, judged)))
        rows = [contradiction, np.where(np.isfinite(contradiction), speed, np.inf)]
        arrays = [torque, speed, gains, error, K, [*wheel_speed, *turned]]
        fixed = [np.array(array, float, order="C") for array in arrays]
        standing, maps = standing_of(robot, steering)
        places = np.zeros((0, 2), np.int64) if weights is None else weights
        strength = np.where(np.isfinite(torque), torque, robot.effort_limits)
        share = some(self.shaking)
        shaken = share * strength if math.isfinite(share) else np.full(strength.size, math.inf)
        unseen = [reach_of(robot), mobility(robot), np.zeros(layout.dof) if asked is None else asked, shaken]
        *state, sense = views(new_state(layout) if values is None else values, layout)
        state[1].every[0] = state[1].every[0] or arrivals or period
        sense[USUAL] = np.where(sense[USUAL] > 0.0, sense[USUAL], max(arrivals, AT_FIRST))
        door = Door(measured, np.array(rows, float), state[2], state[1], sense, layout.sideways, *maps)
        return Supervisor._make(
            [True, SupervisorNumbers(*map(float, numbers)), *fixed, door, *standing, places, *unseen, *state]
        )

    def _base_speeds(self, robot: Robot, turned: dict[str, float]) -> list[float]:
        """Largest base velocities; of a base that steers its twist's, u = n' W eta, and those of steering joints."""
        base, speed, yaw_rate = robot.base, some(self.speed), some(self.yaw_rate)
        if not isinstance(base, SteeredBase):
            return base.per_velocity(speed, yaw_rate)
        own = base.per_velocity(speed, yaw_rate) if base.body else [hypot(speed, base.length * yaw_rate)]
        return own + [turned.get(base.pivots[k].joint, math.inf) for k in base.masters]

    def _calm_rate(self, robot: Robot, gains: Array) -> float:
        """`M qddot = g (K (e + I) - qdot)`, `Idot = rate e` is stable for `rate < g / M` (Routh); half at most."""
        nb = robot.dimensions.base
        inertias = np.diag(Twin(robot).mass_matrix(robot.neutral_position()))[nb:]
        return min(self.hold_rate, float(np.min(0.5 * gains[nb:] / inertias, initial=math.inf)))


def reach_of(robot: Robot) -> Array:
    """(p,) how far velocities may lead unseen, see `Safety.timeout` [m, rad]; of two that add up each its part."""
    slide, turn = REACH
    sideways, nb = robot.dimensions.sideways, robot.dimensions.base
    own = np.where([name in ("v", "vx", "vy", "u") for name in robot.velocity_names[:nb]], slide, turn)
    if sideways and not robot.steers:
        own[:2] /= math.sqrt(2.0)
    return np.concatenate((own, np.where(revolute(robot)[robot.arm_index], turn, slide)))


def mobility(robot: Robot) -> Array:
    """(p, p) largest |M^-1| over some postures of the arm."""
    twin, arm, rng = Twin(robot), robot.arm_index, np.random.default_rng(0)
    lower, upper = np.maximum(robot.lower[arm], -math.pi), np.minimum(robot.upper[arm], math.pi)
    position, found = robot.neutral_position(), np.zeros((robot.dimensions.dof,) * 2)
    for _ in range(POSTURES):
        found = np.maximum(found, np.abs(inverse(twin.mass_matrix(robot.follow(position)))))
        position[arm] = rng.uniform(lower, upper)
    return found


def steering_motors(robot: Robot) -> int:
    """How many motors turn pivots; they stand between drive wheels and arm."""
    return sum(pivot.motor for pivot in robot.base.pivots) if isinstance(robot.base, SteeredBase) else 0


def pivots_of(robot: Robot, judged: bool) -> Array:
    """(6, pivots) of `Door.joints`; what the floor turns may be as fast as it likes. `judged`: whether a jump trips."""
    pivots = robot.base.pivots if isinstance(robot.base, SteeredBase) else ()
    rates = [pivot.rate if math.isfinite(pivot.rate) or pivot.role == "passive" else FASTEST for pivot in pivots]
    jump = STEERING_JUMP if judged else math.inf
    rows = [(math.tau, p.lower, p.upper, rate, jump, 0.0) for p, rate in zip(pivots, rates, strict=True)]
    return np.array(rows, float).reshape(-1, 6).T


def standing_of(robot: Robot, steering: Standing | None) -> tuple[tuple[Array, Array], tuple[Any, ...]]:
    """E and its inverse, and the last fields of `Door`.

    Raises:
        ConfigError: A base that steers without its `steering`.
    """
    base = robot.base
    if not isinstance(base, SteeredBase):
        E = np.array(robot.E, float, order="C")
        return (E, pseudo_inverse(E)), (np.zeros(0), np.zeros((0, 0)), np.zeros(0, np.int64), 0.0)
    if steering is None:
        why, fix = "its motors work as its wheels stand", "give steering=Kinematic().steering_of(robot, period)"
        raise ConfigError(f"a supervisor of '{robot.name}', which steers", why=why, fix=fix, key="steering")
    maps = steering.maps
    return (steering.E, steering.E_inv), (maps.eta, maps.V[0], np.array(base.masters, np.int64), float(base.length))


def some(value: float | str | None) -> float:
    """A limit, or inf."""
    return math.inf if value is None or isinstance(value, str) else value


def no_supervisor(layout: Dimensions, values: Array) -> Supervisor:
    """The supervisor of a run without one: it is off, and has a state (`new_state`) all the same."""
    nothing, none = np.zeros(0), np.zeros((0, 0))
    *state, sense = views(values, layout)
    zeros = SupervisorNumbers(*[0.0] * len(SupervisorNumbers._fields))
    door = Door(none, none, state[2], state[1], sense, False, nothing, none, np.zeros(0, np.int64), 0.0)
    numbers: list[Any] = [False, zeros, *[nothing] * 6, door, none, none]
    return Supervisor._make([*numbers, np.zeros((0, 2), np.int64), nothing, none, nothing, nothing, *state])


def new_state(layout: Dimensions, start: float = 0.0) -> Array:
    """State of a supervisor before its first measurement at a time [s]."""
    message = layout.pose + layout.base + 2 * layout.arm + layout.shape
    values = np.zeros(MARKS + message + 14 * layout.dof + 4 * layout.motors + 2 * layout.arm + 7 * layout.shape)
    state = marks_of(values)
    state.heard[0] = state.commanded[0] = start
    state.since[0], state.waited[0], state.sampled[0], state.news[0] = -math.inf, math.inf, math.inf, 3.0
    return values


def views(values: Array, layout: Dimensions) -> list[Any]:
    """A supervisor's state and views of its parts, in the order of `Supervisor`, and the sense of its door."""
    message, p, n = layout.pose + layout.base + 2 * layout.arm + layout.shape, layout.dof, layout.arm
    m = layout.motors
    _, *parts, sight, shake, sense = np.split(values, np.cumsum([MARKS, message, p, m, n, n, p, 5 * p, 3 * m]))
    return [values, marks_of(values), *parts, sight.reshape(5, -1), shake.reshape(3, -1), sense.reshape(7, -1)]


def marks_of(values: Array) -> SupervisorState:
    """The single numbers at the beginning of a supervisor's state."""
    return SupervisorState._make(values[i : i + 1] for i in range(MARKS))


def trip_of(state: SupervisorState, robot: Robot) -> tuple[float, str, str]:
    """When a run tripped [s], the signal that passed its limit, and a line that says by how much.

    Args:
        state: Of the supervisor.
        robot: The robot.
    """
    code, i, time = int(state.code[0]), int(state.place[0]), float(state.time[0])
    if code == BAD_WEIGHTS:
        return time, f"weights[{i}]", f"tripped at t = {time:g} s: weights are not finite"
    if code == TOUCHED:
        return time, SIGNAL[code], f"tripped at t = {time:g} s: contact"
    if code == PRESSED:
        return time, SIGNAL[code], f"stopped from outside at t = {time:g} s"
    names = {OVER_TORQUE: robot.actuator_names, OVER_SPEED: robot.velocity_names, OFF_JOINT: robot.joint_names}
    names |= {
        SHAKING: robot.actuator_names,
        OVER_WHEEL: robot.actuator_names,
        JUMPED: (*robot.joint_names, *robot.base.shape),
        OVER_TWIST: ("v", "w"),
    }
    names |= {BLIND: robot.velocity_names}
    name = names[code][i] if code in names else ""
    unit = SLIDING[code] if name and slides(robot, name) else UNIT[code]
    value, limit, nb = state.value[0], state.limit[0], robot.dimensions.base
    if code == TOO_SLOW:
        what = f"the control period is {1e3 * value:.3g} ms, and it may be {1e3 * limit:.3g} ms"
        return time, SIGNAL[code], f"tripped at t = {time:g} s: {what}"
    if code == JUMPED:
        what = f"{name} jumps by {value:.3g}{unit} between two measurements, and its speed explains {limit:.3g}{unit}"
        return time, f"{SIGNAL[code]}[{i}]", f"tripped at t = {time:g} s: {what}"
    if code == BLIND:
        what = f"no new measurement says where {name} is, which may have gone {value:.3g}{unit}"
        return time, SIGNAL[code], f"tripped at t = {time:g} s: {what}"
    if code == SHAKING:
        what = f"what is learned shakes {name} with {value:.3g}{unit} RMS, over its limit of {limit:.4g}{unit}"
        return time, f"{SIGNAL[code]}[{i}]", f"tripped at t = {time:g} s: {what}"
    of, over = f" of {name}" if name else "", f"{value - limit:.3g}{unit} over its limit of {limit:.4g}{unit}"
    signal = f"{SIGNAL[code]}[{i}]" if code in SIGNAL else f"velocity[{i}]" if i < nb else f"qdot[{i - nb}]"
    return time, signal, f"tripped at t = {time:g} s: {WHAT[code]}{of} {value:.4g}{unit}, {over}"


def slides(robot: Robot, name: str) -> bool:
    """Whether a velocity or a joint is one along a line."""
    if not robot.model.existJointName(name):
        return name != "w"
    kind = robot.model.joints[robot.model.getJointId(name)].shortname()
    return str(kind).startswith(("JointModelP", "JointModelMimicP"))


def remarks(state: SupervisorState, robot: Robot, status: str) -> list[str]:
    """Lines on a run that ended with a status: what was refused, and that it had tripped before."""
    lines = [trip_of(state, robot)[2]] if state.tripped[0] and status != "tripped" else []
    for refused, kind in ((state.bad, "measurement"), (state.refused, "command")):
        if count := int(refused[0]):
            lines.append(f"refused {count} {kind}{'s' if count > 1 else ''} with numbers that are not finite")
    return lines

"""A supervisor between controller and motors: limits, timeouts, and a stop that holds the arm and brakes the base.

At every measurement it refuses what is not finite and keeps what it had. At every control sample it refuses a command
that is not finite, bounds the weights, clips the motor torques, and trips when a limit is passed. After a trip the
controller is no longer asked: the base is braked and the arm is held where it was by the experiment's own feedback,
with an integral against gravity. Without fresh measurements, or if feedback does not bring the robot to rest in time,
the torque ramps to zero and the windings of the motors are shorted (`actuator.brake`). Where the drive motors have
such a brake the base is braked by it at once, for which nothing has to be measured.
"""

from __future__ import annotations

import math
from typing import Literal

import numpy as np

from .compiled import compiled, copy_to
from .errors import ConfigError
from .model.limits import Numbers, each, limits, speed_limits
from .model.robot import Robot
from .settings import Settings, require_gain
from .signals import INDEX, Array, IntArray, Layout

POSE, VELOCITY, Q, QDOT, ALPHA = (INDEX[name] for name in ("pose", "velocity", "q", "qdot", "alpha"))
POSE_ERROR, JOINT_ERROR, STATE = INDEX["pose_error"], INDEX["e"], INDEX["safety"]
PSI_HAT, TORQUE = INDEX["psi_hat"], INDEX["torque"]

# What the signal `safety` says of a sample: nothing done, a torque clipped or a value held, stopping under feedback,
# ramping to zero torque without measurements.
RUNNING, STEPPED_IN, STOPPING, RAMPING = 0.0, 1.0, 2.0, 3.0
FRESH = 5.5  # control periods without a new measurement after which a stop does without
# Settings: numbers, then per motor the torque limit, per velocity the speed limit and the feedback gain, per joint the
# error limit and the gain K.
TIMEOUT, RAMP, STOP_TIME, TORQUE_TIME, POSITION, HEADING, WEIGHTS, HOLD_RATE, H, SETTLE, REST, SHORT, NUMBERS = range(
    13
)
# Memory: numbers, then the last good measurement, the last torque (p), per motor the time above its limit, per joint
# where it is held and the integral of its error.
HAS_TRIPPED, TIME, CODE, PLACE, VALUE, LIMIT, HEARD, COMMANDED, GOOD, BAD, REFUSED, ACTED = range(12)
ARRIVED, BLIND, GIVEN_UP, MEMORY = range(12, 16)
TRIPPED = -2  # what an engine's `advance` returns at the end of a tripped run

NOTHING, OVER_TORQUE, OVER_SPEED, OFF_PATH, OFF_HEADING, OFF_JOINT, DEAF, LOST, BAD_WEIGHTS = range(9)
REASONS = {
    OVER_TORQUE: ("motor_torque", "torque"),
    OVER_SPEED: ("speed", "speed"),
    OFF_PATH: ("pose_error", "position error"),
    OFF_HEADING: ("pose_error", "heading error"),
    OFF_JOINT: ("e", "joint error"),
    DEAF: ("measurement", "age of the measurement"),
    LOST: ("command", "age of the command"),
    BAD_WEIGHTS: ("weights", "weights"),
}


class Safety(Settings, frozen=True):
    """Limits of a run on hardware, and what happens when one is passed. None is no limit.

    Args:
        torque: Largest motor torque, clipped; one number or one per motor [N m or N], "urdf" for the URDF's limits.
        torque_time: How long a motor may ask for more before that trips [s].
        speed: Largest speed of the base [m/s].
        yaw_rate: Largest yaw rate of the base [rad/s].
        joint_speed: Largest speed of an arm joint, one number or one per joint [rad/s or m/s], "urdf" for the URDF's.
        position_error: Largest distance of the base from its reference [m].
        heading_error: Largest heading error [rad].
        joint_error: Largest error of an arm joint, one number or one per joint [rad or m].
        weights: Largest Frobenius norm of every array of weights; larger ones are scaled back at every sample.
        timeout: Age of the measurement or of the command at which it trips [s]; that of ros2_controllers by default.
        ramp: Time in which the torque goes to zero when there is no measurement [s].
        stop_time: How long a tripped run goes on, to show the stop [s].
        settle: Time in which feedback has to bring the robot to rest; after it the stop does without [s].
        rest: Measured speed that counts as rest then [m/s, rad/s].
        hold_rate: Rate of the integral that holds the arm against gravity [1/s].

    Raises:
        ConfigError: A number that is negative or not finite, or a limit of 0, with the key path.
    """

    torque: Literal["urdf"] | Numbers | None = None
    torque_time: float = 0.5
    speed: float | None = None
    yaw_rate: float | None = None
    joint_speed: Literal["urdf"] | Numbers | None = None
    position_error: float | None = None
    heading_error: float | None = None
    joint_error: Numbers | None = None
    weights: float | None = None
    timeout: float = 0.5
    ramp: float = 0.25
    stop_time: float = 1.5
    settle: float = 0.5
    rest: float = 0.1
    hold_rate: float = 2.0

    def __post_init__(self) -> None:
        for name in self.__struct_fields__:
            value = getattr(self, name)
            if value is None or isinstance(value, str):
                continue
            require_gain(value, f"safety.{name}")
            if name not in ("torque_time", "stop_time", "settle", "hold_rate", "ramp") and not np.all(
                np.asarray(value) > 0
            ):
                raise ConfigError(f"{value}", fix="use a number > 0", key=f"safety.{name}")

    def numbers(self, robot: Robot, period: float, gains: Array, K: Array, short: bool = False) -> Array:
        """Settings as numbers for one robot.

        Args:
            robot: The robot.
            period: Control period [s].
            gains: (p,) feedback that brakes and holds, on the velocities.
            K: (n,) gain of the filtered arm error.
            short: Whether shorted windings brake the base.

        Raises:
            ConfigError: Not one number per motor or per joint.
        """
        layout = robot.layout
        own = [self.timeout, self.ramp, self.stop_time, self.torque_time]
        own += [some(self.position_error), some(self.heading_error), some(self.weights), self.hold_rate, period]
        own += [self.settle, self.rest, float(short)]
        base = [some(self.speed)] * (layout.base - 1) + [some(self.yaw_rate)] if layout.base else []
        joint_speed = limits("safety.joint_speed", self.joint_speed, speed_limits(robot)[layout.motors - layout.arm :])
        torque = limits("safety.torque", self.torque, robot.effort_limits)
        error = each("safety.joint_error", math.inf if self.joint_error is None else self.joint_error, layout.arm)
        return np.concatenate((own, torque, base, joint_speed, gains, error, K)).astype(float)


def some(value: float | None) -> float:
    """A limit, or inf."""
    return math.inf if value is None else value


def new_memory(layout: Layout, start: float = 0.0) -> Array:
    """What the supervisor remembers, before its first measurement at a time [s]."""
    message = layout.pose + layout.base + 2 * layout.arm
    memory = np.zeros(MEMORY + message + layout.dof + layout.motors + 2 * layout.arm)
    memory[HEARD] = memory[COMMANDED] = start
    return memory


def trip_of(memory: Array, robot: Robot) -> tuple[float, str, str]:
    """When a run tripped [s], the signal that passed its limit, and a line that says by how much."""
    code, i = int(memory[CODE]), int(memory[PLACE])
    signal, what = REASONS[code]
    names = {OVER_TORQUE: robot.actuator_names, OVER_SPEED: robot.velocity_names, OFF_JOINT: robot.joint_names}
    of = f" of {names[code][i]}" if code in names else ""
    value, limit, time = memory[VALUE], memory[LIMIT], memory[TIME]
    if code == BAD_WEIGHTS:
        line = f"tripped at t = {time:g} s: weights are not finite"
    else:
        line = f"tripped at t = {time:g} s: {what}{of} {value:.4g}, {value - limit:.3g} over its limit of {limit:.4g}"
    refused = [
        f"{int(memory[n])} {kind} refused" for n, kind in ((BAD, "measurements"), (REFUSED, "commands")) if memory[n]
    ]
    return float(time), f"{signal}[{i}]", "; ".join((line, *refused))


@compiled
def accept(row: Array, at: IntArray, time: float, now: float, is_new: bool, memory: Array) -> None:
    """Take a measurement that came in; one that is not finite is refused, and the last good one stays.

    Args:
        row: (width,) row of signals with pose, velocity, q, qdot as received.
        at: Offsets of the signals.
        time: When it was measured [s].
        now: When it came [s].
        is_new: Whether it is another one than last time.
        memory: The supervisor's memory.
    """
    first, size, fine = at[POSE], at[QDOT + 1] - at[POSE], True
    for i in range(size):
        fine = fine and math.isfinite(row[first + i])
    if fine and is_new:
        copy_to(row[first : first + size], memory[MEMORY : MEMORY + size])
        memory[HEARD], memory[ARRIVED], memory[GOOD] = time, now, memory[GOOD] + 1.0
    elif not fine:
        memory[BAD] += is_new
        copy_to(memory[MEMORY : MEMORY + size], row[first : first + size])


@compiled
def has_ended(time: float, numbers: Array, memory: Array) -> bool:
    """Whether a tripped run has shown its stop for long enough."""
    return memory[HAS_TRIPPED] > 0.0 and time - memory[TIME] >= numbers[STOP_TIME] - 5e-10


@compiled
def may_learn(memory: Array) -> bool:
    """Whether the controller is to be asked: there is a measurement, and nothing has tripped."""
    return memory[HAS_TRIPPED] == 0.0 and memory[GOOD] > 0.0


@compiled
def trip(time: float, code: int, place: int, value: float, limit: float, memory: Array) -> None:
    """Stop, for the first reason that comes up."""
    if memory[HAS_TRIPPED] == 0.0:
        memory[HAS_TRIPPED], memory[TIME], memory[CODE], memory[PLACE] = 1.0, time, float(code), float(place)
        memory[VALUE], memory[LIMIT] = value, limit


@compiled
def supervise(
    row: Array,
    at: IntArray,
    time: float,
    arrived: bool,
    E: Array,
    E_inv: Array,
    numbers: Array,
    memory: Array,
    places: IntArray,
    weights: Array,
) -> None:
    """Check a sample and write the torque that goes to the motors into the row, and what was done as `safety`.

    Args:
        row: (width,) row of signals, the controller's torque in it.
        at: Offsets of the signals.
        time: Of the sample [s].
        arrived: Whether a command came.
        E: (p, motors) torque on nu from motor torques.
        E_inv: (motors, p) its inverse.
        numbers: Settings.
        memory: The supervisor's memory.
        places: (k, 2) start and stop of every array of weights.
        weights: The controller's memory.
    """
    p, motors = E.shape
    n, tau = at[JOINT_ERROR + 1] - at[JOINT_ERROR], row[at[TORQUE] : at[TORQUE + 1]]
    last = memory[MEMORY + at[QDOT + 1] - at[POSE] :]
    step_in = bound_weights(time, numbers, memory, places, weights)
    if memory[GOOD] > 0.0:
        check_motion(row, at, time, numbers, memory, motors)
    fine = arrived
    for i in range(p):
        fine = fine and math.isfinite(tau[i])
    if memory[HAS_TRIPPED] == 0.0:
        if fine:
            memory[COMMANDED] = time
        else:
            memory[REFUSED] += arrived
            step_in = True
            copy_to(last[:p], tau)
            for i in range(at[PSI_HAT], at[TORQUE]):  # what else it made of a broken command is no number either
                row[i] = row[i] if math.isfinite(row[i]) else 0.0
        if memory[GOOD] == 0.0:
            tau[:] = 0.0
        if time - memory[HEARD] > numbers[TIMEOUT]:
            trip(time, DEAF, 0, time - memory[HEARD], numbers[TIMEOUT], memory)
        elif time - memory[COMMANDED] > numbers[TIMEOUT]:
            trip(time, LOST, 0, time - memory[COMMANDED], numbers[TIMEOUT], memory)
    row[at[STATE]] = STEPPED_IN if step_in else RUNNING
    if memory[HAS_TRIPPED] > 0.0:
        stop(row, at, time, numbers, memory, n, motors)
    clipped = clip(time, tau, E, E_inv, numbers, memory, last[p : p + motors])
    if clipped and row[at[STATE]] == RUNNING:
        row[at[STATE]] = STEPPED_IN
    copy_to(tau, last[:p])


@compiled
def bound_weights(time: float, numbers: Array, memory: Array, places: IntArray, weights: Array) -> bool:
    """Scale weights back onto their bound; true if some were beyond it."""
    beyond = False
    for k in range(places.shape[0]):
        W, squares = weights[places[k, 0] : places[k, 1]], 0.0
        for i in range(W.size):
            squares += W[i] * W[i]
        if not math.isfinite(squares):
            trip(time, BAD_WEIGHTS, k, squares, numbers[WEIGHTS], memory)
        elif squares > numbers[WEIGHTS] * numbers[WEIGHTS]:
            beyond, scale = True, numbers[WEIGHTS] / math.sqrt(squares)
            for i in range(W.size):
                W[i] *= scale
    return beyond


@compiled
def check_motion(row: Array, at: IntArray, time: float, numbers: Array, memory: Array, motors: int) -> None:
    """Trip on measured speeds and tracking errors beyond their limits."""
    nb, n = at[ALPHA + 1] - at[ALPHA], at[JOINT_ERROR + 1] - at[JOINT_ERROR]
    speeds = numbers[NUMBERS + motors :]
    errors = speeds[2 * (nb + n) :]
    for i in range(nb + n):
        speed = abs(row[at[VELOCITY] + i] if i < nb else row[at[QDOT] + i - nb])
        if speed > speeds[i]:
            trip(time, OVER_SPEED, i, speed, speeds[i], memory)
    if at[POSE_ERROR + 1] > at[POSE_ERROR]:
        away = math.hypot(row[at[POSE_ERROR]], row[at[POSE_ERROR] + 1])
        turned = abs(row[at[POSE_ERROR] + 2])
        if away > numbers[POSITION]:
            trip(time, OFF_PATH, 0, away, numbers[POSITION], memory)
        if turned > numbers[HEADING]:
            trip(time, OFF_HEADING, 2, turned, numbers[HEADING], memory)
    for i in range(n):
        if abs(row[at[JOINT_ERROR] + i]) > errors[i]:
            trip(time, OFF_JOINT, i, abs(row[at[JOINT_ERROR] + i]), errors[i], memory)


@compiled
def stop(row: Array, at: IntArray, time: float, numbers: Array, memory: Array, n: int, motors: int) -> None:
    """Brake the base and hold the arm; blind, or where that does not help, let the torque go to zero."""
    p = at[TORQUE + 1] - at[TORQUE]
    tau, last = row[at[TORQUE] : at[TORQUE + 1]], memory[MEMORY + at[QDOT + 1] - at[POSE] :]
    gains = numbers[NUMBERS + motors + p :]
    K, hold = gains[p + n :], last[p + motors :]
    if memory[ACTED] == 0.0:
        memory[ACTED], memory[BLIND] = 1.0, -1.0
        for i in range(n):
            hold[i], hold[n + i] = row[at[Q] + i], 0.0
    if time - memory[TIME] > numbers[SETTLE] and moves(row, at, p, n, numbers[REST]):
        memory[GIVEN_UP] = 1.0
    if memory[GIVEN_UP] > 0.0 or memory[GOOD] == 0.0 or time - memory[ARRIVED] > FRESH * numbers[H]:
        if memory[BLIND] < 0.0:
            memory[BLIND] = time
        row[at[STATE]], left = RAMPING, numbers[RAMP] - (time - memory[BLIND])
        for i in range(p):  # these factors multiply to a straight line
            tau[i] = last[i] * left / (left + numbers[H]) if left > 0.0 else 0.0
        return
    memory[BLIND] = -1.0
    row[at[STATE]] = STOPPING
    for i in range(p - n):
        tau[i] = 0.0 if numbers[SHORT] > 0.0 else -gains[i] * row[at[VELOCITY] + i]
    for i in range(n):
        e = hold[i] - row[at[Q] + i]
        hold[n + i] += numbers[H] * numbers[HOLD_RATE] * e
        tau[p - n + i] = gains[p - n + i] * (K[i] * (e + hold[n + i]) - row[at[QDOT] + i])


@compiled
def moves(row: Array, at: IntArray, p: int, n: int, rest: float) -> bool:
    """Whether a measured velocity is not at rest."""
    fastest = 0.0
    for i in range(p):
        fastest = max(fastest, abs(row[at[VELOCITY] + i] if i < p - n else row[at[QDOT] + i - (p - n)]))
    return fastest > rest


@compiled
def clip(time: float, tau: Array, E: Array, E_inv: Array, numbers: Array, memory: Array, above: Array) -> bool:
    """Clip the motor torques, and trip when a motor has asked for too much for too long."""
    clipped, p = False, tau.size
    for j in range(above.size):
        u, limit = 0.0, numbers[NUMBERS + j]
        for i in range(p):
            u += E_inv[j, i] * tau[i]
        over = abs(u) > limit
        clipped = clipped or over
        above[j] = above[j] + numbers[H] if over else 0.0
        if above[j] > numbers[TORQUE_TIME]:
            trip(time, OVER_TORQUE, j, abs(u), limit, memory)
    if clipped:
        within(tau, E, E_inv, numbers)
    return clipped


@compiled
def within(tau: Array, E: Array, E_inv: Array, numbers: Array) -> None:
    """Tau (p,) with every motor within its limit; more motors than velocities are all scaled alike."""
    p, motors, scale = E.shape[0], E.shape[1], 1.0
    for j in range(motors):
        u, limit = 0.0, numbers[NUMBERS + j]
        for i in range(p):
            u += E_inv[j, i] * tau[i]
        if abs(u) > limit:
            scale = min(scale, limit / abs(u))
            if motors == p:
                for i in range(p):
                    tau[i] -= E[i, j] * (u - math.copysign(limit, u))
    if motors != p:
        for i in range(p):
            tau[i] *= scale

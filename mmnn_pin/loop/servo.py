"""Velocities that take a velocity command instead of a torque: nu split into effort rows e and servo rows s.

**On s** the robot's own servo closes a loop, here taken as `nudot_s = b (u - nu_s) + rest`. Its command is

    u = nu_ref + nudot_ref / b + k s + psi,    dpsi/dt = rate s,    s = nu_ref - nu

so that `ds/dt = -b (1 + k) s - b psi - rest`: the integral psi, in units of velocity, takes the rest.

**Limits.** u stays within the speeds of the joints, and of a base within those of its wheels, v and w scaled together:
the curvature stays. While u is limited psi does not grow in its direction, and it is never more than a share of
nu_ref and a little. A joint that takes positions is sent u, integrated, between the joint's ends and at most
`speed (1/b + latency + h)` ahead of where it is measured: there a servo that is as fast as it can be has it.

A base that steers has its own interface for every steering joint, whose rate is a velocity, and one for all motors that
drive. The rates are within those of the joints; in a stop they are 0, and u brakes along the curve as it is.

**On e** the torque law is what it was, for the robot whose servo rows move by themselves. The signals that it reads say
on s what the robot does, not what it should do: `nu_ref := nu_s` measured, `nudot_ref := b (u - psi - nu_s)` of the
servo's model with the rest that psi has found, and `s := 0`. So Psi_e contains `M_es nudot_s + C_es nu_s`, an error
of s enters no torque and teaches nothing, and as before, with `M_ee' - 2 C_ee` skew,

    V = 1/2 r' M_ee r,    dV/dt = -r' K r

**Torques through a position servo.** One whose stiffness Kp is known gives `Kp (q_sent - q) - Kd qdot`, so that a
torque tau of the law acts through it, as on an effort row, with the servo's own feedback beside:

    q_sent = int u dt + tau / Kp,    tau = K s + Psi_hat

Such a row is one of e for the law: it sees what is asked of it and the error, learns from it, and looks back at the
torque that the servo gives, as far as it is known. A reach that ends takes of tau / Kp first, and of the integral of u.

`ask` comes before the torque law, `answered` after it.

`servo_model` has what stands for the robot's servos in a simulation, and before a run.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..by_address import by_address
from ..compiled import compiled, copy_to, linked
from ..elementary import hypot
from ..errors import ConfigError, UnknownName
from ..kinematic import Steering
from ..model.base.rolling import STEERED
from ..model.base.steered import SteeredBase
from ..model.robot import Robot, speed_limits
from ..settings import Numbers, Settings, one_or_each, require_numbers
from ..signals import INDEX, Array, IntArray
from ..torque.controller import CompiledController, Context, TorqueController
from ..torque.law import KERNELS, nothing_to_keep

EFFORT, VELOCITY, POSITION = "effort", "velocity", "position"
NU_REF, NUDOT_REF, Z, R = (INDEX[name] for name in ("nu_ref", "nudot_ref", "z", "r"))
TIME, VELOCITY_REF, QDOT_REF = (INDEX[name] for name in ("time", "velocity_ref", "qdot_ref"))
STATE, LAST, SINCE, STOPS = 0, 1, 2, 2.0  # of a clock
LONGEST = 0.5  # time between two samples that counts [s]
MEASURED_BASE, MEASURED_ARM = INDEX["velocity"], INDEX["qdot"]
PSI_HAT, PSI_APPLIED, TORQUE = (INDEX[name] for name in ("psi_hat", "psi_applied", "torque"))
Q, SHAPE = INDEX["q"], INDEX["shape"]
BRAKING = 2.0  # of a stop, where no limit is known [m/s^2, rad/s^2]
SHARE = 0.3  # of nu_ref that psi may be
BASE_FLOOR, ARM_FLOOR = 0.02, 0.05  # that psi may be besides [m/s, rad/s], of a joint that share of its speed


class Servo(Settings, frozen=True):
    """The servos of velocity and position interfaces as far as they are known, and the law that commands them.

    Args:
        bandwidth: b, one number or one per velocity [1/s].
        gain: k of the error, one number or one per velocity.
        rate: Rate of the integral, one number or one per velocity [1/s].
        delay: Delay of the simulated servo, in addition to the latency [s].
        strength: Largest torque of the simulated servo over the URDF's effort limit; joints without one have no limit.
        stiffness: Kp of a position servo, one number or one per motor like all that follow [N m/rad or N/m]; a servo
            with 0 moves between the positions that it gets with its bandwidth.
        damping: Kd of a position servo on the joint's speed, back-EMF included [N m s/rad or N s/m].
        integral: Ki of a position servo [N m/(rad s) or N/(m s)].
        stall: Torque of a position servo at rest with full voltage, the most that its PID asks for; 0 for no such limit
            [N m or N].
        dead_band: Error to which a position servo does not react [rad or m].
        profile_speed: Largest speed at which a position servo moves its goal; 0 for no limit [rad/s or m/s].
        profile_acceleration: Largest acceleration of its goal; 0 for no limit [rad/s^2 or m/s^2].
        period: Period of a servo's own loop [s]; 0 for every step of the plant.

    Raises:
        ConfigError: A number that is negative or not finite, or a bandwidth of 0.
    """

    bandwidth: Numbers = 30.0
    gain: Numbers = 0.2
    rate: Numbers = 1.0
    delay: float = 0.0
    strength: float = 1.0
    stiffness: Numbers = 0.0
    damping: Numbers = 0.0
    integral: Numbers = 0.0
    stall: Numbers = 0.0
    dead_band: Numbers = 0.0
    profile_speed: Numbers = 0.0
    profile_acceleration: Numbers = 0.0
    period: Numbers = 0.0

    def __post_init__(self) -> None:
        require_numbers(self, "servo", {"bandwidth", "strength"})


class Command(NamedTuple):
    """Command of a sample to the robot: views that the next step overwrites, NaN where the other interface holds."""

    effort: Array  # (p,) on nu: forces on the base, torques of the joints [N, N m; N m or N]
    velocity: Array  # (p,) base velocity and rates of the joints [m/s, rad/s; rad/s or m/s]
    position: Array  # (p,) of joints that take nothing else: their velocity, integrated [rad or m]
    motor_effort: Array  # (motors,) the same at the motors, drive wheels from left to right, then the arm [N m or N]
    motor_velocity: Array  # (motors,) likewise [rad/s or m/s]
    # (motors,) likewise; a wheel that follows another's steering is asked for its angle [rad or m]
    motor_position: Array
    # (twist,) the base's velocity, for a controller of the robot's own [m/s, rad/s]: where the base steers, what its
    # wheels are steered for, and as fast as they are driven
    twist: Array


@by_address
class Split(NamedTuple):
    """The servo rows of one robot: numbers of their law and what it remembers."""

    on: Array  # (p,) 1 on s, 0 on e
    numbers: Array  # (3, p) b, k, rate
    h: float  # control period [s]
    E: Array  # (p, motors) speeds of the motors are E' nu; of a base that steers as it is measured
    wheel: Array  # (wheels,) speed limits of the base's motors, infinite of those that steer
    speed: Array  # (p,) speed limits of the commands
    braking: Array  # (p,) by which commands brake in a stop [m/s^2 or rad/s^2]
    floor: Array  # (p,) of psi's bound
    masters: IntArray  # (m,) places in `shape` of the pivots whose rates are the last base velocities
    length: float  # l of `base.rolling` where the first velocity is u, else 0 [m]
    # (2, n + m) between which positions are sent, of the arm and of masters, infinite for joints that take none [rad or
    # m]
    ends: Array
    ahead: Array  # (n + m,) how far a position may be ahead of the measured one, likewise
    growth: Array  # (p,) of psi in the last sample
    integral: Array  # (p,) psi
    command: Array  # (p,) u of the last sample
    asked: Array  # (p,) likewise, and of positions through which torques act how fast they went
    place: Array  # (n + m,) positions by integration of u, for joints that take nothing else
    # (3, p) 1 / Kp of a position servo through which torques act, 0 on other rows; its Kd; largest torque
    through: Array
    late: float  # from a measurement to the middle of the time for which a position stands [s]
    offset: Array  # (n + m,) the part tau / Kp of `place`, likewise
    kept: Array  # (p,) put back into the row for those who look at it: errors s, and torques that act through servos
    clock: Array  # (3,) 0 before it begins, 1, 2 in a stop; time of the last sample; time since then [s]


def interfaces_of(robot: Robot, given: Mapping[str, str] | None) -> tuple[tuple[str, ...], Array]:
    """The interface of every velocity, and (p,) which are servo rows.

    Args:
        robot: The robot.
        given: Interface of joints with a motor, by name; effort for those that are not named.

    Raises:
        UnknownName: A joint without a motor, or an interface that does not exist.
        ConfigError: Wheels of one base with different interfaces, or a wheel and what it follows.
    """
    names, given = robot.actuator_names, given or {}
    for joint, kind in given.items():
        if joint not in names:
            raise UnknownName("joint", joint, names, key="interfaces")
        if kind not in (EFFORT, VELOCITY, POSITION):
            raise UnknownName("interface", kind, (EFFORT, VELOCITY, POSITION), key=f"interfaces.{joint}")
    own, moved = own_velocities(robot), movers(robot)
    kinds = list[str]()
    for i, row in enumerate([moved[:own].any(axis=0)] * own + [*moved[own:]]):
        joints = [name for name, moves in zip(names, row, strict=True) if moves]
        found = {given.get(name, EFFORT) for name in joints}
        if len(found) > 1 or (i < own and POSITION in found):
            steers = own <= i < robot.dimensions.base
            why = "one of them follows the other" if steers else "one velocity of the base moves all wheels"
            fix = f"use one for {' and '.join(joints)}" if steers else "use effort, or velocity, for all of them"
            raise ConfigError(f"wheels by {' and '.join(sorted(found))}", why=why, fix=fix, key="interfaces")
        kinds.append(found.pop() if found else EFFORT)
    return tuple(kinds), np.array([float(kind != EFFORT) for kind in kinds])


def own_velocities(robot: Robot) -> int:
    """Number of base velocities but the rates of steering joints."""
    masters = len(robot.base.masters) if isinstance(robot.base, SteeredBase) else 0
    return robot.dimensions.base - masters


def movers(robot: Robot) -> NDArray[np.bool_]:
    """Which motors a velocity moves by its interface, (p, motors): a steering joint its own, and what follows it."""
    d, base = robot.dimensions, robot.base
    if not isinstance(base, SteeredBase):
        return np.asarray(robot.E != 0.0)
    found, own = np.zeros((d.dof, d.motors), bool), own_velocities(robot)
    pivots = {pivot.joint: k for k, pivot in enumerate(base.pivots)}
    for j, name in enumerate(robot.actuator_names):
        role = base.pivots[pivots[name]].role if name in pivots else "passive"
        if j >= d.motors - d.arm:
            found[d.base + j - (d.motors - d.arm), j] = True
        elif role == "passive":
            found[:own, j] = True
        else:
            found[own + (base.masters.index(pivots[name]) if role == "master" else 0), j] = True
    return found


def split_of(
    robot: Robot,
    kinds: tuple[str, ...],
    servo: Servo,
    period: float,
    state: Array,
    latency: float = 0.0,
    steering: Steering | None = None,
) -> Split | None:
    """The servo rows of a robot; None where all rows take effort.

    Args:
        robot: The robot.
        kinds: Interface of every velocity, of `interfaces_of`.
        servo: Their law.
        period: Control period [s].
        state: (size,) what it remembers, see `state_size`.
        latency: From the measurement to the servo [s].
        steering: Of a base that steers; None for others.

    Raises:
        ConfigError: Neither one number nor one per velocity.
    """
    on = np.array([float(kind != EFFORT) for kind in kinds])
    if not on.any():
        return None
    p, n, numbers, base, own = on.size, robot.dimensions.arm, laws(robot, servo), robot.base, own_velocities(robot)
    nb, urdf, masters = p - n, speed_limits(robot), base.masters if isinstance(base, SteeredBase) else []
    wheels, moved = urdf.size - n, movers(robot)
    rates = [base.pivots[k].rate for k in masters] if isinstance(base, SteeredBase) else []
    speed = np.concatenate((np.full(own, np.inf), rates, urdf[wheels:]))
    floor = [BASE_FLOOR] * own + [ARM_FLOOR * (limit if np.isfinite(limit) else 1.0) for limit in speed[own:]]
    placed = np.array([kind == POSITION for kind in (*kinds[nb:], *kinds[own:nb])], bool)
    at = [*robot.arm_index, *(robot.shape_index[k] for k in masters)]
    ends = np.array([np.where(placed, robot.lower[at], -np.inf), np.where(placed, robot.upper[at], np.inf)])
    places = n + len(masters)
    integral, command, place, offset, clock = np.split(state, (p, 2 * p, 2 * p + places, 2 * p + 2 * places))
    drives = moved[:own, :wheels].any(axis=0) & (on[:own] > 0.0).any() if own else np.zeros(wheels, bool)
    split = Split(
        on=on,
        numbers=numbers,
        h=period,
        E=np.array(robot.E, order="C") if steering is None else steering.E,
        wheel=np.where(drives, urdf[:wheels], np.inf),
        speed=speed,
        braking=np.full(p, BRAKING),
        floor=np.array(floor),
        masters=np.array(masters, np.int64),
        length=float(base.length) if isinstance(base, SteeredBase) and base.body == STEERED else 0.0,
        ends=ends,
        ahead=np.where(placed, 0.0, np.inf),
        growth=np.zeros(p),
        integral=integral,
        command=command,
        asked=np.zeros(p),
        place=place,
        through=through_servos(robot, kinds, servo),
        late=latency + 0.5 * period,
        offset=offset,
        kept=np.zeros(p),
        clock=clock,
    )
    limit_commands(split, speed, split.braking, latency)
    return split


def through_servos(robot: Robot, kinds: tuple[str, ...], servo: Servo) -> Array:
    """1 / Kp of an arm's position servos of known stiffness, 0 on other rows, their Kd and largest torques, (3, p)."""
    d, found = robot.dimensions, np.zeros((3, robot.dimensions.dof))
    for j in range(d.arm if d.motors else 0):
        motor, row = d.motors - d.arm + j, d.base + j
        Kp, Kd, stall = (
            one_or_each(getattr(servo, name), d.motors, "motor", f"servo.{name}")[motor]
            for name in ("stiffness", "damping", "stall")
        )
        if kinds[row] == POSITION and Kp > 0.0:
            most = servo.strength * robot.effort_limits[motor]
            found[:, row] = 1.0 / Kp, Kd, min(most, stall) if stall > 0.0 else most
    return found


def limit_commands(split: Split, speed: Array, braking: Array, latency: float) -> None:
    """Keep commands within further limits, in place.

    Args:
        split: The servo rows.
        speed: (p,) largest commands.
        braking: (p,) by which they brake in a stop [m/s^2 or rad/s^2].
        latency: From the measurement to the servo [s].
    """
    p, m = split.on.size, split.masters.size
    nb = p - (split.ahead.size - m)
    split.speed[:], split.braking[:] = np.minimum(split.speed, speed), braking
    rows = [*range(nb, p), *range(nb - m, nb)]
    reach = split.speed[rows] * (1.0 / split.numbers[0, rows] + latency + split.h)
    split.ahead[:] = np.where(np.isfinite(split.ahead), reach, np.inf)


def laws(robot: Robot, servo: Servo) -> Array:
    """b, k and rate of every velocity, (3, p); errors as of `split_of`."""
    p, names = robot.dimensions.dof, ("bandwidth", "gain", "rate")
    return np.array([one_or_each(getattr(servo, name), p, "velocity", f"servo.{name}") for name in names])


def state_size(on: Array, places: int) -> int:
    """How many numbers the servo rows remember, `places` of joints whose rates are velocities."""
    return 2 * on.size + 2 * places + 3 if on.any() else 0


def hidden_torques(robot: Robot, given: Mapping[str, str] | None, servo: Servo) -> Array | None:
    """Of which velocities servos hide the torque, (p,) of 0 and 1; None for none.

    A velocity servo tells none, a position servo one by its stiffness. Errors as of `interfaces_of` and `split_of`.
    """
    kinds, on = interfaces_of(robot, given)
    hidden = np.where(through_servos(robot, kinds, servo)[0] > 0.0, 0.0, on)
    return hidden if hidden.any() else None


def needs_torques(controller: CompiledController | TorqueController, context: Context) -> bool:
    """Whether a controller learns from torques that servos hide."""
    if context.hidden is None or not isinstance(controller, CompiledController):
        return False
    if controller.by_velocity and not context.hidden.all():
        return False
    learner = controller.law(context).learner
    return learner is not None and KERNELS[type(learner)].settle is not nothing_to_keep


def require_no_torque_regressor(controller: CompiledController | TorqueController, context: Context) -> None:
    """Refuse what `needs_torques` (`ConfigError`)."""
    if needs_torques(controller, context):
        some = context.hidden is not None and not context.hidden.all()
        why = "it needs the torque of every joint, and a servo of which no stiffness is known does not tell it"
        fix = f"use {'learned, feedforward, ' * some}pd, pd_gravity, computed_torque, two_layer, one_layer or adaptive"
        raise ConfigError(f"{controller.name} on a velocity interface", why=why, fix=fix, key="interfaces")


@linked
def ask(row: Array, at: IntArray, split: Split) -> None:
    """The servos' commands of a sample; what the torque law reads on s becomes what the robot does there."""
    nb = at[Z + 1] - at[Z]
    count_on(row[at[TIME]], split)
    h = split.clock[SINCE]
    for i in range(split.on.size):
        if split.on[i] > 0.0:
            error = at[Z] + i if i < nb else at[R] + i - nb
            nu = row[at[MEASURED_BASE] + i] if i < nb else row[at[MEASURED_ARM] + i - nb]
            b, k, rate, wanted = split.numbers[0, i], split.numbers[1, i], split.numbers[2, i], row[at[NU_REF] + i]
            s = wanted - nu
            before, most = split.integral[i], SHARE * abs(wanted) + split.floor[i]
            split.integral[i] = min(max(before + h * rate * s, -most), most)
            split.growth[i] = split.integral[i] - before
            split.command[i] = wanted + row[at[NUDOT_REF] + i] / b + k * s + split.integral[i]
            if split.through[0, i] == 0.0:
                split.kept[i], row[error] = row[error], 0.0
                row[at[NU_REF] + i] = nu
        elif i < nb and split.masters.size:  # what other rows' motors add to it
            split.command[i] = row[at[MEASURED_BASE] + i]
    share = share_of_base(nb, split)
    for i in range(split.on.size):
        if split.on[i] > 0.0:
            u, j = split.command[i], joint_of(i, nb, split)
            limited = limit_row(i, nb, share, split)
            if j >= 0:
                sent = split.place[j] + h * split.command[i]
                limited = limited or sent != within_reach(sent, angle_of(row, at, j, split), j, split)
            if limited and split.growth[i] * u > 0.0:
                split.integral[i] -= split.growth[i]
            if split.through[0, i] == 0.0:
                nu = row[at[NU_REF] + i]
                row[at[NUDOT_REF] + i] = split.numbers[0, i] * (split.command[i] - split.integral[i] - nu)


@compiled
def joint_of(i: int, nb: int, split: Split) -> int:
    """Which joint's rate velocity i is: of the arm, then of the masters; negative for others."""
    own = nb - split.masters.size
    return i - nb if i >= nb else split.on.size - nb + i - own if i >= own else -1


@compiled
def velocity_of(j: int, nb: int, split: Split) -> int:
    """The velocity that is the rate of joint j of `joint_of`."""
    n = split.on.size - nb
    return nb + j if j < n else nb - split.masters.size + j - n


@compiled
def angle_of(row: Array, at: IntArray, j: int, split: Split) -> float:
    """Measured angle of joint j of `joint_of`."""
    n = split.place.size - split.masters.size
    if split.masters.size and j >= n:
        return row[at[SHAPE] + split.masters[j - n]]
    return row[at[Q] + j]


@compiled
def limit_row(i: int, nb: int, share: float, split: Split) -> bool:
    """Keep a command within what its motors reach; whether it was not."""
    u, most = split.command[i], split.speed[i]
    if i < nb:
        split.command[i] = share * u
        return share < 1.0 or (i >= nb - split.masters.size and abs(u) >= most)
    split.command[i] = min(max(u, -most), most)
    return split.command[i] != u


@compiled
def share_of_base(nb: int, split: Split) -> float:
    """Largest share, up to 1, of the base's commands that the base and all of its wheels reach.

    Steering joints turn no faster than they can, in place; the share is of what is left.
    """
    share, own, any_on = 1.0, nb - split.masters.size, False
    for i in range(nb):
        any_on = any_on or split.on[i] > 0.0
        if i >= own and split.on[i] > 0.0:
            split.command[i] = min(max(split.command[i], -split.speed[i]), split.speed[i])
    if any_on:
        for i in range(own):
            if abs(split.command[i]) > split.speed[i]:
                share = min(share, split.speed[i] / abs(split.command[i]))
        for j in range(split.wheel.size):
            turning = 0.0
            for i in range(nb):
                turning += split.E[i, j] * split.command[i]
            if abs(turning) > split.wheel[j]:
                share = min(share, split.wheel[j] / abs(turning))
    return share


@compiled
def within_reach(sent: float, q: float, j: int, split: Split) -> float:
    """The position that joint j, measured at q, is sent: between its ends, and not too far ahead of q."""
    sent = min(max(sent, q - split.ahead[j]), q + split.ahead[j])
    return min(max(sent, split.ends[0, j]), split.ends[1, j])


@linked
def answered(row: Array, at: IntArray, stopped: bool, split: Split) -> None:
    """No torque on s but through servos, errors back in the row; without an answer the commands brake, too.

    A stop moves by no measurement here: it begins with what the reference did, whatever feedback had made of that. Base
    and arm come to rest along the line on which they move, but a position goes no farther out of reach.
    """
    nb = at[Z + 1] - at[Z]
    count_on(row[at[TIME]], split)
    for i in range(split.on.size):
        if split.on[i] > 0.0:
            answer_row(row, at, i, nb, stopped, split)
        elif stopped:
            split.command[i] = 0.0
    if stopped:
        brake(0, nb - split.masters.size, split)
        brake(nb, split.on.size, split)
    copy_to(split.command, split.asked)
    for j in range(split.place.size):
        place_joint(row, at, j, nb, stopped, split)
    split.clock[STATE] = STOPS if stopped else 1.0


@compiled
def answer_row(row: Array, at: IntArray, i: int, nb: int, stopped: bool, split: Split) -> None:
    """Torque and error of servo row i, and in a stop its command; arguments as of `answered`."""
    acts, torque = split.through[0, i] > 0.0, row[at[TORQUE] + i]
    row[at[TORQUE] + i] = 0.0
    if acts:
        split.kept[i] = torque
    if stopped or not acts:
        row[at[PSI_HAT] + i] = 0.0
        if at[PSI_APPLIED + 1] > at[PSI_APPLIED]:
            row[at[PSI_APPLIED] + i] = 0.0
    if stopped:
        split.integral[i] = 0.0
        if split.clock[STATE] < STOPS:
            low, high = referred(row, at, i, nb, split)
            split.command[i] = min(max(split.command[i], low), high)
    elif not acts:
        row[at[Z] + i if i < nb else at[R] + i - nb] = split.kept[i]


@compiled
def place_joint(row: Array, at: IntArray, j: int, nb: int, stopped: bool, split: Split) -> None:
    """The position that joint j is sent; arguments as of `answered`."""
    q, i, h = angle_of(row, at, j, split), velocity_of(j, nb, split), split.clock[SINCE]
    if split.clock[STATE] == 0.0:
        split.place[j] = q
    before, most = split.place[j], h * split.speed[i]
    sent = before + h * split.command[i]
    if stopped:  # a measurement holds it where it would get out of reach, and never moves it
        sent = min(max(sent, min(q - split.ahead[j], before)), max(q + split.ahead[j], before))
        sent = min(max(sent, split.ends[0, j]), split.ends[1, j])
        split.place[j] = min(max(sent, before - most), before + most)
        return
    path = within_reach(sent - split.offset[j], q, j, split)
    sent = path if split.through[0, i] == 0.0 else within_reach(path + split.through[0, i] * split.kept[i], q, j, split)
    split.place[j] = min(max(sent, before - most), before + most)
    if split.through[0, i] > 0.0:
        split.offset[j], split.asked[i] = split.place[j] - path, (split.place[j] - before) / h
        split.kept[i] = given_through(split.place[j], q, row[at[QDOT_REF] + i - nb], i, split)


@linked
def tell(row: Array, at: IntArray, stopped: bool, split: Split) -> None:
    """Write the torques that are taken to act through servos into the row, once what motors are sent is on its way."""
    for i in range(split.on.size):
        if split.through[0, i] > 0.0 and not stopped:
            row[at[TORQUE] + i] = split.kept[i]


@compiled
def given_through(sent: float, q: float, qdot: float, i: int, split: Split) -> float:
    """The torque that the servo of row i is taken to give while a position stands that is sent at a measured q."""
    torque = (sent - q - split.late * qdot) / split.through[0, i] - split.through[1, i] * qdot
    return min(max(torque, -split.through[2, i]), split.through[2, i])


@compiled
def referred(row: Array, at: IntArray, i: int, nb: int, split: Split) -> tuple[float, float]:
    """Between which commands a stop begins by the reference: from 0 to it; u of the size of its twist, none steers."""
    if i >= nb:
        asked = row[at[QDOT_REF] + i - nb]
    elif i >= nb - split.masters.size:
        asked = 0.0
    elif split.length > 0.0:
        twist = row[at[VELOCITY_REF] : at[VELOCITY_REF + 1]]
        asked = hypot(hypot(twist[0], twist[1] if twist.size == 3 else 0.0), split.length * twist[twist.size - 1])
        return -asked, asked
    else:
        asked = row[at[VELOCITY_REF] + i]
    return min(asked, 0.0), max(asked, 0.0)


@compiled
def count_on(time: float, split: Split) -> None:
    """The time since the last sample: the control period, or what it is where that is far from what was told."""
    if split.clock[STATE] == 0.0:
        split.clock[LAST], split.clock[SINCE] = time, split.h
    elif time > split.clock[LAST]:
        since = time - split.clock[LAST]
        near = 0.5 * split.h < since < 1.5 * split.h
        split.clock[LAST], split.clock[SINCE] = time, split.h if near else min(since, LONGEST)


@compiled
def brake(first: int, last: int, split: Split) -> None:
    """Commands first ... last - 1 go to zero together, none faster than it may brake."""
    left = 0.0  # time [s]
    for i in range(first, last):
        left = max(left, abs(split.command[i]) / split.braking[i])
    for i in range(first, last):
        split.command[i] *= max(0.0, 1.0 - split.clock[SINCE] / left) if left > 0.0 else 0.0

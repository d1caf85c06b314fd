"""Setpoints made while the robot runs, from wishes that come one by one: the reference goes on without a jump.

    wish of the base ─┐
    wish of the arm  ─┴─▶ [advance] ─▶ braking before the joints' ends ─▶ setpoint of this sample

Base and arm each follow a wish of a kind:

- `HOLD`: brake within the acceleration limits, then stand. A base that rolls keeps the sideways error that it has then.
- `VELOCITY` (base): a velocity within the limits. The reference pose is the measured pose: pose errors are zero.
- `SAMPLE`: full samples, as they are. One that does not come is made from the last by its own velocity.
- `PLANNED`: samples of a motion known ahead, joined to what the reference did before by a polynomial of degree five
  that fades: pose, velocities and the joints' accelerations do not jump.

A reference of a joint that could not stop before the joint's end brakes along `sqrt(2 a d)`, whatever is wished, and
catches up when the wish is back inside. All of it is compiled arithmetic on arrays; nothing is allocated.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from ..compiled import compiled, copy_to, spliced
from ..elementary import cos_sin
from ..errors import ConfigError
from ..model.base import BY_SIZE
from ..model.robot import Robot, speed_limits
from ..model.robot import limits as limits_of
from ..settings import Numbers, Settings, one_or_each, require_numbers
from ..signals import Array, Dimensions, IntArray

HOLD, VELOCITY, SAMPLE, PLANNED = range(4)
BASE, ARM = 0, 1  # parts
DURATION, ELAPSED = 0, 1  # of a part's blend [s]
# The fading polynomial from value 1, rate 1, half acceleration 1: coefficients of u^3, u^4, u^5.
FADE = ((-10.0, 15.0, -6.0), (-6.0, 8.0, -3.0), (-3.0, 3.0, -1.0))
PEAK_RATE, PEAK_ACCELERATION = 1.875, 5.7735  # of it, from value 1 [1/T, 1/T^2]


class Limits(Settings, frozen=True):
    """Limits of a reference that is made while the robot runs.

    Args:
        speed: Largest speed of the base [m/s].
        yaw_rate: Largest yaw rate [rad/s].
        acceleration: Of the base [m/s^2].
        yaw_acceleration: [rad/s^2].
        joint_speed: One number or one per joint [rad/s or m/s]; "urdf" for the velocity limits of the URDF, 1 where it
            states none.
        joint_acceleration: One number or one per joint [rad/s^2 or m/s^2].
        joint_jerk: Of motions to a goal, one number or one per joint [rad/s^3 or m/s^3].
        joint_margin: Distance from the joints' ends that is kept [rad or m].

    Raises:
        ConfigError: A number that is not positive and finite.
    """

    speed: float = 1.0
    yaw_rate: float = 1.5
    acceleration: float = 1.0
    yaw_acceleration: float = 2.0
    joint_speed: str | Numbers = "urdf"
    joint_acceleration: Numbers = 5.0
    joint_jerk: Numbers = 50.0
    joint_margin: float = 0.0

    def __post_init__(self) -> None:
        require_numbers(self, "limits", set(self.__struct_fields__) - {"joint_margin"})
        if isinstance(self.joint_speed, str) and self.joint_speed != "urdf":
            fix = 'give numbers, or "urdf"'
            raise ConfigError(f"'{self.joint_speed}'", fix=fix, key="limits.joint_speed")

    def of_base(self, dimensions: Dimensions) -> Array:
        """Speeds and accelerations of the base's velocities, (2, nb)."""
        per_velocity = BY_SIZE[dimensions.base].per_velocity
        return np.array(
            [per_velocity(self.speed, self.yaw_rate), per_velocity(self.acceleration, self.yaw_acceleration)], float
        ).reshape(2, dimensions.base)

    def of_arm(self, robot: Robot) -> Array:
        """Speed, acceleration and jerk of the joints, (3, n).

        Raises:
            ConfigError: Neither one number nor as many as joints.
        """
        n = robot.dimensions.arm
        urdf = speed_limits(robot)[robot.dimensions.motors - n :]
        speed = limits_of(self.joint_speed, np.where(np.isfinite(urdf), urdf, 1.0), "joint", "limits.joint_speed")  # type: ignore[arg-type]
        rest = [
            one_or_each(getattr(self, f"joint_{k}"), n, "joint", f"limits.joint_{k}") for k in ("acceleration", "jerk")
        ]
        return np.array([speed, *rest]).reshape(3, n)


class Guide(NamedTuple):
    """What makes setpoints: limits as numbers, the wishes, and the reference as it is.

    A setpoint is flat: pose, velocity, acceleration of the base, q, qdot, qddot of the arm side by side.

    Attributes:
        base: (2, nb) largest speeds and accelerations of the base.
        arm: (3, n) largest speeds, accelerations and jerks of the joints.
        ends: (2, n) where the joints' reference must stay [rad or m].
        kind: (2,) what base and arm follow.
        fresh: (2,) 1 where a full sample has just come.
        wanted: (w,) the wish: a full sample, or the velocity of the base.
        now: (w,) the reference.
        aim: (w,) the reference before the joints' braking.
        blend: (3 + nb + n, 6) fading polynomials over u in 0 ... 1 of pose, velocity and joints.
        clock: (2, 2) duration of the blends of base and arm, and the time since they began [s].
        held: (n,) 1 where a joint is kept from its end.
    """

    base: Array
    arm: Array
    ends: Array
    kind: IntArray
    fresh: IntArray
    wanted: Array
    now: Array
    aim: Array
    blend: Array
    clock: Array
    held: IntArray


def new_guide(robot: Robot, limits: Limits) -> Guide:
    """The guide of one robot, before its first measurement.

    Raises:
        ConfigError: Not one limit per joint; ends that leave a joint no room.
    """
    d = robot.dimensions
    width = d.pose + 2 * d.base + 3 * d.arm
    margin = limits.joint_margin
    ends = np.array([robot.lower[robot.arm_index] + margin, robot.upper[robot.arm_index] - margin]).reshape(2, d.arm)
    if not (ends[0] < ends[1]).all():
        fix = "use a smaller limits.joint_margin"
        raise ConfigError(f"{margin:g} from both ends leaves a joint no room", fix=fix, key="limits.joint_margin")
    return Guide(
        base=limits.of_base(d),
        arm=limits.of_arm(robot),
        ends=ends,
        kind=np.zeros(2, np.int64),
        fresh=np.zeros(2, np.int64),
        wanted=np.zeros(width),
        now=np.zeros(width),
        aim=np.zeros(width),
        blend=np.zeros((d.pose + d.base + d.arm, 6)),
        clock=np.zeros((2, 2)),
        held=np.zeros(d.arm, np.int64),
    )


@compiled
def stand(measured: Array, guide: Guide) -> None:
    """Put the reference where the robot is measured and let it brake from there.

    Args:
        measured: Pose, velocity, q, qdot side by side.
        guide: The guide.
    """
    nb, n, now = guide.base.shape[1], guide.arm.shape[1], guide.now
    pose, q = 3 if nb else 0, (3 if nb else 0) + 2 * nb
    now[:] = 0.0
    copy_to(measured[: pose + nb], now[: pose + nb])
    copy_to(measured[pose + nb :], now[q : q + 2 * n])
    copy_to(now, guide.aim)
    copy_to(now, guide.wanted)
    guide.kind[:], guide.fresh[:], guide.clock[:], guide.held[:] = HOLD, 0, 0.0, 0


@spliced
def roll(pose: Array, velocity: Array, dt: float) -> None:
    """Move a pose (3,) on by a velocity in its own frame, by the middle of the step."""
    w = velocity[velocity.size - 1]
    middle = pose[2] + 0.5 * w * dt
    c, s = cos_sin(middle)
    sideways = velocity[1] if velocity.size == 3 else 0.0
    pose[0] += (c * velocity[0] - s * sideways) * dt
    pose[1] += (s * velocity[0] + c * sideways) * dt
    pose[2] += w * dt


@spliced
def ramp(velocity: Array, goal: Array, most: Array, dt: float, acceleration: Array) -> None:
    """Move velocities towards a goal (k,) within accelerations (k,)."""
    for i in range(velocity.size):
        step = most[i] * dt
        a = min(max(goal[i] - velocity[i], -step), step)
        acceleration[i] = a / dt if dt > 0.0 else 0.0
        velocity[i] += a


@compiled
def coast(sample: Array, nb: int, n: int, dt: float) -> None:
    """Move a sample on by its own velocities; base and arm alike."""
    pose = 3 if nb else 0
    q = pose + 2 * nb
    if nb:
        roll(sample[:3], sample[3 : 3 + nb], dt)
        sample[3 + nb : q] = 0.0
    for i in range(n):
        sample[q + i] += sample[q + n + i] * dt
        sample[q + 2 * n + i] = 0.0


@compiled
def join(part: int, dt: float, least: float, guide: Guide) -> None:
    """Begin to follow the wanted samples of a part: what the reference is ahead of them now fades.

    It takes as long as keeps the fading within half of the limits; where nothing is ahead there is nothing to fade.

    Args:
        part: `BASE` or `ARM`.
        dt: Time since the reference was made [s].
        least: Shortest time of fading [s].
        guide: The guide; its `wanted` is the first sample.
    """
    nb, n = guide.base.shape[1], guide.arm.shape[1]
    pose, now, wanted, blend = 3 if nb else 0, guide.now, guide.wanted, guide.blend
    q, longest = pose + 2 * nb, 0.0
    if part == BASE and nb == 0:
        return
    if part == BASE:
        roll(now[:3], now[pose : pose + nb], dt)
        for i in range(3):
            shift = now[i] - wanted[i]
            if i == 2:
                shift = math.pi - (math.pi - shift) % (2.0 * math.pi)
            blend[i, 0] = shift
            speed, most = guide.base[0, nb - 1 if i == 2 else 0], guide.base[1, nb - 1 if i == 2 else 0]
            longest = max(longest, fading(shift, 0.0, speed, most))
        for i in range(nb):
            gap = now[pose + i] + now[pose + nb + i] * dt - wanted[pose + i]
            blend[3 + i, 0], blend[3 + i, 1] = gap, now[pose + nb + i] - wanted[pose + nb + i]
            longest = max(longest, 2.0 * PEAK_RATE * abs(gap) / guide.base[1, i])
        ahead(now, wanted, nb, blend)
    else:
        for i in range(n):
            at = pose + nb + i
            bends, rates = now[q + 2 * n + i], now[q + n + i]
            gap = now[q + i] + dt * (rates + 0.5 * dt * bends) - wanted[q + i]
            lead = rates + dt * bends - wanted[q + n + i]
            blend[at, 0], blend[at, 1], blend[at, 2] = gap, lead, 0.5 * (bends - wanted[q + 2 * n + i])
            longest = max(longest, fading(gap, lead, guide.arm[0, i], guide.arm[1, i]))
            longest = max(longest, 4.0 * abs(2.0 * blend[at, 2]) / guide.arm[2, i])
    T = max(longest, least) if longest > 0.0 else 0.0
    first, last = (0, pose + nb) if part == BASE else (pose + nb, pose + nb + n)
    for k in range(first, last):
        blend[k, 1] *= T
        blend[k, 2] *= T * T
        for j in range(3):
            blend[k, 3 + j] = blend[k, 0] * FADE[0][j] + blend[k, 1] * FADE[1][j] + blend[k, 2] * FADE[2][j]
    guide.clock[part, DURATION], guide.clock[part, ELAPSED] = T, 0.0


@spliced
def ahead(now: Array, wanted: Array, nb: int, blend: Array) -> None:
    """Rate of the pose in the world by which the reference is ahead of the wanted one, into the blend."""
    for i in range(3):
        blend[i, 1], blend[i, 2] = 0.0, 0.0
    for sign, sample in ((1.0, now), (-1.0, wanted)):
        c, s = cos_sin(sample[2])
        sideways = sample[4] if nb == 3 else 0.0
        blend[0, 1] += sign * (c * sample[3] - s * sideways)
        blend[1, 1] += sign * (s * sample[3] + c * sideways)
        blend[2, 1] += sign * sample[3 + nb - 1]
    for i in range(nb):
        blend[3 + i, 2] = 0.0


@spliced
def fading(gap: float, rate: float, speed: float, most: float) -> float:
    """Time in which a gap and its rate fade within half of a speed and an acceleration [s]."""
    by_speed = 2.0 * PEAK_RATE * abs(gap) / speed
    by_acceleration = math.sqrt(2.0 * PEAK_ACCELERATION * abs(gap) / most)
    return max(max(by_speed, by_acceleration), 8.0 * abs(rate) / most)


@compiled
def advance(measured: Array, dt: float, guide: Guide) -> None:
    """The reference of this sample, into `guide.now`.

    Args:
        measured: Pose, velocity, q, qdot side by side.
        dt: Time since the last sample [s].
        guide: The guide.
    """
    nb, n = guide.base.shape[1], guide.arm.shape[1]
    pose, aim, wanted = 3 if nb else 0, guide.aim, guide.wanted
    q = pose + 2 * nb
    for part in range(2):
        if guide.kind[part] == SAMPLE and guide.fresh[part] == 0:
            if part == BASE:
                coast(wanted[:q], nb, 0, dt)
            else:
                coast(wanted[q:], 0, n, dt)
        guide.fresh[part] = 0
    if nb:
        kind, velocity, acceleration = guide.kind[BASE], aim[pose : pose + nb], aim[pose + nb : q]
        if kind >= SAMPLE:
            copy_to(wanted[:q], aim[:q])
            faded(BASE, dt, guide)
        else:
            if kind != VELOCITY:
                wanted[pose : pose + nb] = 0.0
            ramp(velocity, wanted[pose : pose + nb], guide.base[1], dt, acceleration)
            if kind == VELOCITY:
                copy_to(measured[:3], aim[:3])
            else:
                roll(aim[:3], velocity, dt)
    if guide.kind[ARM] >= SAMPLE:
        copy_to(wanted[q:], aim[q:])
        faded(ARM, dt, guide)
    else:
        for i in range(n):
            before = aim[q + n + i]
            step = guide.arm[1, i] * dt
            after = before - min(max(before, -step), step)
            aim[q + 2 * n + i] = (after - before) / dt if dt > 0.0 else 0.0
            aim[q + n + i] = after
            aim[q + i] += 0.5 * (before + after) * dt
    copy_to(aim[:q], guide.now[:q])
    for i in range(n):
        keep_inside(i, q, dt, guide)


@spliced
def faded(part: int, dt: float, guide: Guide) -> None:
    """Add to a part of `guide.aim` what still fades."""
    T = guide.clock[part, DURATION]
    if T > 0.0:
        nb, n, aim = guide.base.shape[1], guide.arm.shape[1], guide.aim
        pose = 3 if nb else 0
        u = guide.clock[part, ELAPSED] / T
        guide.clock[part, ELAPSED] += dt
        if u >= 1.0:
            guide.clock[part, DURATION] = 0.0
        elif part == BASE:
            for i in range(3):
                aim[i] += value(guide.blend[i], u)
            for i in range(nb):
                aim[pose + i] += value(guide.blend[3 + i], u)
                aim[pose + nb + i] += rate(guide.blend[3 + i], u) / T
        else:
            for i in range(n):
                row, at = guide.blend[pose + nb + i], pose + 2 * nb + i
                aim[at] += value(row, u)
                aim[at + n] += rate(row, u) / T
                aim[at + 2 * n] += bend(row, u) / (T * T)


@spliced
def value(c: Array, u: float) -> float:
    """A polynomial of degree five, coefficients from the lowest."""
    return c[0] + u * (c[1] + u * (c[2] + u * (c[3] + u * (c[4] + u * c[5]))))


@spliced
def rate(c: Array, u: float) -> float:
    """Its derivative."""
    return c[1] + u * (2.0 * c[2] + u * (3.0 * c[3] + u * (4.0 * c[4] + u * 5.0 * c[5])))


@spliced
def bend(c: Array, u: float) -> float:
    """Its second derivative."""
    return 2.0 * c[2] + u * (6.0 * c[3] + u * (12.0 * c[4] + u * 20.0 * c[5]))


@compiled
def keep_inside(i: int, q: int, dt: float, guide: Guide) -> None:
    """The reference of a joint: the aim where it can stop before the joint's end, else braking, else catching up."""
    n, aim, now = guide.arm.shape[1], guide.aim, guide.now
    low, high, a = guide.ends[0, i], guide.ends[1, i], guide.arm[1, i]
    goal, speed, place, before = aim[q + i], aim[q + n + i], now[q + i], now[q + n + i]
    up = math.sqrt(2.0 * a * max(high - goal, 0.0))
    down = -math.sqrt(2.0 * a * max(goal - low, 0.0))
    fine = low <= goal <= high and down <= speed <= up
    gap = goal - place
    if fine and guide.held[i] == 1 and abs(gap) <= a * dt * dt and abs(speed - before) <= a * dt:
        guide.held[i] = 0
    if fine and guide.held[i] == 0:
        for k in range(3):
            now[q + k * n + i] = aim[q + k * n + i]
        return
    guide.held[i] = 1
    if dt <= 0.0:
        return
    wish = speed + math.copysign(min(abs(gap) / dt, math.sqrt(a * abs(gap))), gap)
    wish = min(max(wish, before - a * dt), before + a * dt)
    # the fastest from which it still stops: v dt + v^2 / (2 a) = distance
    up = a * (math.sqrt(dt * dt + 2.0 * max(high - place, 0.0) / a) - dt)
    down = -a * (math.sqrt(dt * dt + 2.0 * max(place - low, 0.0) / a) - dt)
    after = min(max(wish, down), up)
    now[q + i] = place + after * dt
    now[q + n + i] = after
    now[q + 2 * n + i] = (after - before) / dt

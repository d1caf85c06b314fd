"""Setpoints made while the robot runs, from wishes that come one by one: within limits, and where they were asked.

    wish of the base ─┐
    wish of the arm  ─┴─▶ [advance] ─▶ setpoint of this sample

Base and arm each follow a wish of a kind:

- `HOLD`: brake within the accelerations, then stand. A joint beyond its end is led back to it.
- `VELOCITY` (base): a velocity; (v, w) change together, so that a curvature stays one. The reference pose is the
  measured pose: pose errors are zero. A base that steers keeps within its curvature, which changes no faster than its
  pivots turn; asked to turn on the spot it stands.
- `SAMPLE`: full samples. One that does not come is made from the last by its own velocity.
- `PLANNED`: samples of a motion known ahead.

The last two are targets that move. A reference that has reached its target is the target, bit for bit (it is *home*),
until a sample jumps beyond what its own rates explain, or asks for more than the limits. Else it goes after it in the
shortest time within the limits: what it is beside it is brought to rest at 0 as if the target went on with its present
velocity, so that the reference is never pushed harder than its own limit. A joint brakes in time before it leaves its
ends, or the places of the motion that it follows by more than what braking needs.

All of it is compiled arithmetic on arrays (`braking` has the closed forms, exact for any time between two samples);
nothing is allocated.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from ..compiled import compiled, copy_to
from ..elementary import cos_sin, hypot, nearest_turn
from ..errors import ConfigError
from ..model.robot import Robot
from ..signals import Array, IntArray
from .braking import brought_home, in_one_step, led
from .limits import Limits, rims
from .steerable import bend_rate, curvatures

HOLD, VELOCITY, SAMPLE, PLANNED = range(4)
BASE, ARM = 0, 1  # parts
OWN = 1.5  # times the acceleration that a sample states: a change of its velocity within that is its own
ROUNDING = 1e-9
AT_REST = 1e-6  # rate of a target that stands [rad/s or m/s]
NEAR = 1e-6  # beyond a joint's end that is none [rad or m]


class Guide(NamedTuple):
    """The guide of a robot's reference: limits as numbers, the wishes, and the reference as it is.

    A setpoint is flat: pose, velocity, acceleration of the base, q, qdot, qddot of the arm side by side.
    """

    base: Array  # (3, twist) largest speeds and accelerations of the base, see `Limits.of_base`
    sideways: bool  # whether its velocities are `(vx, vy, w)`
    wheels: Array  # (m, twist) speeds of the wheels by those of the base, over their limits [s/m, s/rad]
    arm: Array  # (4, n) limits of the joints, see `Limits.of_arm`
    ends: Array  # (2, n) where the joints' reference must stay [rad or m]
    turn: IntArray  # (n,) 1 for a joint without ends, for which a whole turn is none
    exact: IntArray  # (1,) 1 where full samples are taken as they are
    kind: IntArray  # (2,) what base and arm follow
    fresh: IntArray  # (2,) 1 where a full sample has just come
    wanted: Array  # (w,) the wish: a full sample, or the velocity of the base
    now: Array  # (w,) the reference
    pace: Array  # (pose,) rate of the reference's pose in its own frame, across too [m/s, m/s, rad/s]
    home: IntArray  # (1 + n,) 1 where the base, and every joint, is on its target
    bend: Array  # (n,) largest acceleration with which a joint goes after its target
    span: Array  # (2, n) where it stays meanwhile: between its ends, and where the motion that it follows is
    curve: Array  # (4,) least and largest curvature [1/m], its largest rate [1/(m s)], and the present one


def new_guide(robot: Robot, limits: Limits) -> Guide:
    """The guide of one robot, before its first measurement.

    Raises:
        ConfigError: Not one limit per joint; ends that leave a joint no room.
    """
    d = robot.dimensions
    width = d.pose + 2 * d.twist + 3 * d.arm
    margin = limits.joint_margin
    ends = np.array([robot.lower[robot.arm_index] + margin, robot.upper[robot.arm_index] - margin]).reshape(2, d.arm)
    if not (ends[0] < ends[1]).all():
        fix = "use a smaller limits.joint_margin"
        raise ConfigError(f"{margin:g} from both ends leaves a joint no room", fix=fix, key="limits.joint_margin")
    (rows, speeds), arm = rims(robot), limits.of_arm(robot)
    return Guide(
        base=limits.of_base(d),
        sideways=d.sideways,
        wheels=np.ascontiguousarray((rows / speeds[:, None])[np.isfinite(speeds)]),
        arm=arm,
        ends=ends,
        turn=robot.is_continuous[robot.arm_index].astype(np.int64),
        exact=np.array([limits.samples == "exact"], np.int64),
        kind=np.zeros(2, np.int64),
        fresh=np.zeros(2, np.int64),
        wanted=np.zeros(width),
        now=np.zeros(width),
        pace=np.zeros(d.pose),
        home=np.zeros(1 + d.arm, np.int64),
        bend=arm[1].copy(),
        span=ends.copy(),
        curve=np.array([*curvatures(robot.base), bend_rate(robot.base), 0.0]),
    )


# -- what is followed from now on --------------------------------------------------------------------------------------


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
    copy_to(now, guide.wanted)
    guide.kind[:], guide.fresh[:], guide.home[:] = HOLD, 0, 0
    if nb:
        take_pace(now, nb, guide)


@compiled
def brake(part: int, measured: Array, guide: Guide) -> None:
    """Let a part brake and stand. A base does so from where it is measured and no faster than it moves.

    Wheels that did not do what was asked do not make up for it then.

    Args:
        part: `BASE` or `ARM`.
        measured: Pose, velocity, q, qdot side by side.
        guide: The guide.
    """
    nb, now, asked, done = guide.base.shape[1], guide.now, 0.0, 0.0
    holds = guide.kind[part] == HOLD
    guide.kind[part] = HOLD
    if part == BASE and nb > 0 and not holds:
        copy_to(measured[:3], now[:3])
        for i in range(nb):
            speed = now[3 + i] / guide.base[0, i]
            asked += speed * speed
            done += speed * measured[3 + i] / guide.base[0, i]
        share = min(max(done / asked, 0.0), 1.0) if asked > 0.0 else 0.0
        for i in range(nb):
            now[3 + i] *= share
        take_pace(now, nb, guide)


@compiled
def drive(velocity: Array, guide: Guide) -> None:
    """Let the base follow a velocity (twist,), scaled as a whole to what base and wheels can do."""
    wanted = guide.wanted[3 : 3 + velocity.size]
    copy_to(velocity, wanted)
    if guide.curve[1] < math.inf:
        last = wanted.size - 1
        wanted[last] = curvature_of(wanted[0], wanted[last], 0.0, guide) * wanted[0]
    share = within_reach(wanted, guide)
    for i in range(wanted.size):
        wanted[i] *= share
    guide.kind[BASE] = VELOCITY


@compiled
def curvature_of(v: float, w: float, standing: float, guide: Guide) -> float:
    """Curvature of a velocity within the guide's [1/m]; another one where it stands."""
    bend = w / v if abs(v) > AT_REST else standing
    return min(max(bend, guide.curve[0]), guide.curve[1])


@compiled
def steer(is_led: bool, dt: float, guide: Guide) -> float:
    """The curvature of this sample [1/m]: towards that of the wanted velocity, no faster than the pivots turn."""
    nb, now, wanted, curve = guide.base.shape[1], guide.now, guide.wanted, guide.curve
    bend = curvature_of(now[3], now[2 + nb], curve[3], guide)
    if is_led:
        ahead = curvature_of(wanted[3], wanted[2 + nb], bend, guide) - bend
        bend += min(max(ahead, -curve[2] * dt), curve[2] * dt)
    curve[3] = bend
    return bend


@compiled
def take_sample(sample: Array, guide: Guide) -> None:
    """Let base and arm follow full samples, of which this is one; the heading by the turn nearest to the reference."""
    nb, wanted = guide.base.shape[1], guide.wanted
    q = (3 if nb else 0) + 2 * nb
    copy_to(sample[:q], wanted[:q])
    if nb:
        wanted[2] = nearest_turn(wanted[2], guide.now[2])
    follow_samples(BASE, guide)
    take_joints(sample[q:], guide)


@compiled
def take_joints(sample: Array, guide: Guide) -> None:
    """Let the arm follow samples (q, qdot, qddot), of which this is one; angles by the nearest turn."""
    n, q = guide.arm.shape[1], guide.wanted.size - 3 * guide.arm.shape[1]
    wanted = guide.wanted[q:]
    copy_to(sample, wanted)
    for i in range(n):
        if guide.turn[i] > 0:
            wanted[i] = nearest_turn(wanted[i], guide.now[q + i])
    follow_samples(ARM, guide)


@compiled
def follow_samples(part: int, guide: Guide) -> None:
    """A part follows samples, of which one has just come."""
    if guide.kind[part] != SAMPLE:
        leave_home(part, guide)
    guide.kind[part], guide.fresh[part] = SAMPLE, 1


@compiled
def leave_home(part: int, guide: Guide) -> None:
    """The reference of a part has another target, which it goes after within the accelerations of what is made here."""
    n = guide.arm.shape[1]
    if part == BASE:
        guide.home[0] = 0
    else:
        guide.home[1:] = 0
        copy_to(guide.arm[1, :n], guide.bend)
        for i in range(2):
            copy_to(guide.ends[i], guide.span[i])


@compiled
def is_home(part: int, guide: Guide) -> bool:
    """Whether the reference of a part is its target."""
    if part == BASE:
        return guide.home[0] > 0
    away = 0
    for i in range(guide.arm.shape[1]):
        away += 1 - guide.home[1 + i]
    return away == 0


# -- the reference of a sample -----------------------------------------------------------------------------------------


@compiled
def advance(measured: Array, dt: float, guide: Guide) -> None:
    """The reference of this sample, into `guide.now`.

    Args:
        measured: Pose, velocity, q, qdot side by side.
        dt: Time since the last sample [s].
        guide: The guide.
    """
    nb, n = guide.base.shape[1], guide.arm.shape[1]
    if nb:
        if guide.kind[BASE] >= SAMPLE:
            follow_pose(dt, guide)
        else:
            ramp(measured, dt, guide)
    for i in range(n):
        if guide.kind[ARM] >= SAMPLE:
            follow_joint(i, dt, guide)
        else:
            brake_joint(i, dt, guide)
    guide.fresh[:] = 0


@compiled
def ramp(measured: Array, dt: float, guide: Guide) -> None:
    """Base velocities change together towards the wanted ones, 0 in `HOLD`, as fast as the accelerations allow."""
    nb, now, share = guide.base.shape[1], guide.now, 1.0
    velocity, is_led = now[3 : 3 + nb], guide.kind[BASE] == VELOCITY
    steers = guide.curve[1] < math.inf
    bend = steer(is_led, dt, guide) if steers else 0.0
    for i in range(nb):
        goal = guide.wanted[3 + i] if is_led else 0.0
        change = (bend * guide.wanted[3] if steers and is_led and i == nb - 1 else goal) - velocity[i]
        if abs(change) > guide.base[1, i] * dt:
            share = min(share, guide.base[1, i] * dt / abs(change))
    middle = now[3 : 3 + 2 * nb]
    for i in range(nb):
        goal, before = guide.wanted[3 + i] if is_led else 0.0, velocity[i]
        velocity[i] = goal if share >= 1.0 else before + share * (goal - before)
        if steers and i == nb - 1:
            velocity[i] = bend * velocity[0]
        middle[nb + i] = 0.5 * (before + velocity[i])  # rolled by, then it is the acceleration
    if is_led:
        copy_to(measured[:3], now[:3])
    else:
        roll(now[:3], middle[nb:], guide.sideways, dt)
    for i in range(nb):
        middle[nb + i] = 2.0 * (velocity[i] - middle[nb + i]) / dt if dt > 0.0 else 0.0
    take_pace(now, nb, guide)


@compiled
def roll(pose: Array, velocity: Array, sideways: bool, dt: float) -> None:
    """Move a pose (3,) on by a velocity in its own frame, by the middle of the step."""
    w = velocity[velocity.size - 1]
    middle = pose[2] + 0.5 * w * dt
    c, s = cos_sin(middle)
    aside = velocity[1] if sideways else 0.0
    pose[0] += (c * velocity[0] - s * aside) * dt
    pose[1] += (s * velocity[0] + c * aside) * dt
    pose[2] += w * dt


@compiled
def take_pace(sample: Array, nb: int, guide: Guide) -> None:
    """The rates of a pose (3,) that rolls as a sample says, in its own frame."""
    pace = guide.pace
    pace[0], pace[1], pace[2] = sample[3], sample[4] if guide.sideways else 0.0, sample[2 + nb]


@compiled
def within_reach(velocity: Array, guide: Guide) -> float:
    """By what a base velocity (twist,) has to be multiplied so that base and wheels reach it; at most 1."""
    nb, over = velocity.size, 1.0
    for i in range(nb):
        over = max(over, abs(velocity[i]) / guide.base[0, i])
    if guide.sideways:
        over = max(over, hypot(velocity[0], velocity[1]) / guide.base[0, 0])
    for j in range(guide.wheels.shape[0]):
        speed = 0.0
        for i in range(nb):
            speed += guide.wheels[j, i] * velocity[i]
        over = max(over, abs(speed))
    return 1.0 / over


@compiled
def brake_joint(i: int, dt: float, guide: Guide) -> None:
    """A joint that holds: to where it stops within its acceleration, inside its ends."""
    n, now = guide.arm.shape[1], guide.now
    q, a = now.size - 3 * n + i, guide.arm[1, i]
    place, rate = now[q], now[q + n]
    goal = min(max(place + 0.5 * rate * abs(rate) / a, guide.ends[0, i]), guide.ends[1, i])
    now[q], now[q + n] = led(place, rate, goal, guide.ends[0, i], guide.ends[1, i], a, guide.arm[0, i], dt)
    now[q + 2 * n] = (now[q + n] - rate) / dt if dt > 0.0 else 0.0


@compiled
def follow_joint(i: int, dt: float, guide: Guide) -> None:
    """A joint that follows samples or a motion: on its target where it can be, else after it."""
    n, now, wanted = guide.arm.shape[1], guide.now, guide.wanted
    q, low, high, fastest = now.size - 3 * n + i, guide.ends[0, i], guide.ends[1, i], guide.arm[0, i]
    sampled, fresh, a = guide.kind[ARM] == SAMPLE, guide.fresh[ARM] > 0, guide.bend[i]
    if sampled and not fresh:
        wanted[q] += wanted[q + n] * dt
        wanted[q + 2 * n] = 0.0
    to, speed, place, rate = wanted[q], wanted[q + n], now[q], now[q + n]
    most, stays = a, guide.home[1 + i] > 0
    if sampled:
        own = max(a, OWN * max(abs(wanted[q + 2 * n]), abs(now[q + 2 * n])))
        most = min(own, guide.arm[3, i]) if stays else a
        exact = guide.exact[0] > 0
        room = NEAR + (high - to if speed > 0.0 else to - low)
        fits = low - NEAR <= to <= high + NEAR and speed * speed <= 2.0 * guide.arm[1, i] * room
        fits = fits and (exact or abs(speed) <= fastest * (1.0 + 1e-9))
        stays = fits and (exact or (stays and not fresh) or in_one_step(place, rate, to, speed, most, dt))
    else:
        stays = stays or in_one_step(place, rate, to, speed, most, dt)
        stays = stays and min(low - NEAR, place) <= to <= max(high + NEAR, place)  # from outside it may come in
    if stays:
        guide.home[1 + i] = 1
        for k in range(3):
            now[q + k * n] = wanted[q + k * n]
        return
    guide.home[1 + i] = 0
    ahead, lead = place - (to - speed * dt), rate - speed
    free = fastest - (abs(speed) if ahead * speed < 0.0 else 0.0)
    ahead, lead = brought_home(ahead, lead, a, max(free, 0.0), dt)
    after, most = speed + lead, max(fastest, abs(rate) - a * dt)
    then = to + ahead
    if abs(after) > most:
        after = math.copysign(most, after)
        then = place + 0.5 * (rate + after) * dt
    low, high = guide.span[0, i], guide.span[1, i]
    if then > high or (after > 0.0 and after * after > 2.0 * a * (high - then)):
        then, after = led(place, rate, high, low, high, a, fastest, dt)
    elif then < low or (after < 0.0 and after * after > 2.0 * a * (then - low)):
        then, after = led(place, rate, low, low, high, a, fastest, dt)
    now[q], now[q + n] = then, after
    now[q + 2 * n] = (after - rate) / dt if dt > 0.0 else 0.0


@compiled
def follow_pose(dt: float, guide: Guide) -> None:
    """A base that follows samples or a motion: on its target where it can be, else beside it, coming nearer."""
    nb, now, wanted = guide.base.shape[1], guide.now, guide.wanted
    sampled, fresh = guide.kind[BASE] == SAMPLE, guide.fresh[BASE] > 0
    velocity, before = wanted[3 : 3 + nb], now[3 + nb : 3 + 2 * nb]
    if sampled and not fresh:
        roll(wanted[:3], velocity, guide.sideways, dt)
        wanted[3 + nb : 3 + 2 * nb] = 0.0
    stays, exact = guide.home[0] > 0, sampled and guide.exact[0] > 0
    if sampled:
        fits = exact or within_reach(velocity, guide) >= 1.0 - ROUNDING
        stays = fits and (exact or (stays and not fresh) or is_next(dt, guide))
    else:
        stays = stays or is_next(dt, guide)
    if not stays:
        stays = come_nearer(dt, guide)
    guide.home[0] = 1 if stays else 0
    if stays:
        copy_to(wanted[: 3 + 2 * nb], now[: 3 + 2 * nb])
        take_pace(wanted, nb, guide)
    else:
        for i in range(nb):
            before[i] = before[i] / dt if dt > 0.0 else 0.0


@compiled
def is_next(dt: float, guide: Guide) -> bool:
    """Whether the wanted base sample can follow on the reference within the accelerations that a sample may bring."""
    nb, now, wanted, is_one = guide.base.shape[1], guide.now, guide.wanted, True
    c, s = cos_sin(0.5 * (now[2] + wanted[2]))
    x, y = wanted[0] - now[0], wanted[1] - now[1]
    along, across, about = c * x + s * y, c * y - s * x, wanted[2] - now[2]
    for i in range(nb):
        here, then = now[3 + i], wanted[3 + i]
        own = max(guide.base[1, i], OWN * max(abs(wanted[3 + nb + i]), abs(now[3 + nb + i])))
        bend = min(own, guide.base[2, i]) if guide.home[0] > 0 else guide.base[1, i]
        moved = about if i == nb - 1 else along if i == 0 else across
        is_one = is_one and in_one_step(0.0, here, moved, then, bend, dt)
    return is_one and (guide.sideways or abs(across) <= 0.5 * guide.base[1, 0] * dt * dt + ROUNDING)


@compiled
def come_nearer(dt: float, guide: Guide) -> bool:
    """Bring what the reference's pose is beside the wanted one to rest at 0; true where it is there.

    The acceleration's place in the reference takes the change of the velocity.
    """
    nb, now, wanted, pace, is_there = guide.base.shape[1], guide.now, guide.wanted, guide.pace, True
    x, y, phi, w = now[0], now[1], now[2], wanted[2 + nb]
    c, s = cos_sin(wanted[2] - 0.5 * w * dt)  # the wanted pose came here by this heading
    cd, sd = cos_sin(now[2] - wanted[2] + w * dt)
    for i in range(3):  # along the wanted heading, across it, and about
        speed, ahead, rate, at = wanted[3], c * (x - wanted[0]) + s * (y - wanted[1]), cd * pace[0] - sd * pace[1], 0
        if i == 1:
            speed, ahead = wanted[4] if guide.sideways else 0.0, c * (y - wanted[1]) - s * (x - wanted[0])
            rate = sd * pace[0] + cd * pace[1]
        elif i == 2:
            speed, ahead, rate, at = w, phi - wanted[2], pace[2], nb - 1
        ahead += speed * dt
        free = guide.base[0, at] - (abs(speed) if ahead * speed < 0.0 else 0.0)
        ahead, lead = brought_home(ahead, rate - speed, guide.base[1, at], max(free, 0.0), dt)
        is_there = is_there and ahead == 0.0 and lead == 0.0
        if i == 0:
            along, faster = ahead, speed + lead
        elif i == 1:
            across, aside = ahead, speed + lead
        else:
            about, turning = ahead, speed + lead
    c, s = cos_sin(wanted[2])
    cd, sd = cos_sin(about)
    now[0], now[1], now[2] = wanted[0] + c * along - s * across, wanted[1] + s * along + c * across, wanted[2] + about
    pace[0], pace[1], pace[2] = cd * faster + sd * aside, cd * aside - sd * faster, turning
    change = now[3 + nb : 3 + 2 * nb]
    for i in range(nb):
        after = pace[2] if i == nb - 1 else pace[i]
        if i == nb - 1 and guide.curve[1] < math.inf:  # the pose may be led as it likes, the wheels may not
            after = curvature_of(now[3], after, guide.curve[3], guide) * now[3]
        change[i], now[3 + i] = after - now[3 + i], after
    share = within_reach(now[3 : 3 + nb], guide)
    if share < 1.0:  # no faster than it can: it stays behind
        for i in range(nb):
            change[i] -= (1.0 - share) * now[3 + i]
            now[3 + i] *= share
        now[0], now[1], now[2] = x, y, phi
        roll(now[:3], now[3 : 3 + nb], guide.sideways, dt)
        take_pace(now, nb, guide)
        return False
    return is_there

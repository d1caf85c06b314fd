"""A motion of the hand made ahead of a run: setpoints of base and arm that loop and compiled engine take unchanged.

    drive there (base alone, arm in its posture) ─▶ reach (hand to where the path begins) ─▶ follow ─▶ stay

The whole-body program runs on its own reference state, one solution per control sample. nudot is held between samples,
as torques are, and nu and the pose are its exact integrals, so the motion can be sampled at any time.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise

import numpy as np
from numpy.typing import ArrayLike

from ...elementary import atan2, cos_sin
from ...elementary.arrays import cos_sin as cos_sin_of
from ...elementary.matrices import length
from ...errors import ConfigError, TrajectoryError
from ...model.chain import SIZE, Hands, poses
from ...model.robot import Robot
from ...settings import given_array
from ...signals import Array, IntArray
from ..joint import JointProfile, JointSamples, MinimumJerk
from ..path import BasePath, BaseSamples, times
from ..trajectory import Trajectory
from .path import HandPath, placed
from .tasks import TARGET, P, R, Task
from .whole_body import WholeBody, manipulability

CLOSE = 0.01  # a stance that is nearer than this needs no drive [m]
TRIES, SPREAD = 64, 0.9  # postures looked at, and the share of half the joints' ranges that they spread over
COARSE, TRIED = 0.02, 16  # period in which a posture is tried [s], and how many are
FAR = 1e3  # ends beyond this are none [rad or m]
HALF_RANGE = np.pi / 2  # of a joint without ends, around 0 [rad]
REACH = 2.0  # least time in which the hand comes to where its path begins [s]


@dataclass(frozen=True, eq=False)
class Samples:
    """A motion with nudot held over every period."""

    period: float  # [s]
    pose: Array  # (N, 3), or (N, 0) for a fixed arm
    q: Array  # (N, n)
    nu: Array  # (N, p)
    nudot: Array  # (N, p)

    def at(self, t: ArrayLike) -> tuple[IntArray, Array]:
        """The sample before every time (N,), and the time since.

        Raises:
            TrajectoryError: A time after the end.
        """
        t, end = times(t), (len(self.nu) - 1) * self.period
        if t.size and t.max() > end + 1e-9:
            what = f"the motion of the hand ends at {end:g} s, but the run asks for t = {t.max():g} s"
            raise TrajectoryError(what, fix="shorten the run")
        k = np.minimum(np.floor(t / self.period + 1e-6), len(self.nu) - 1).astype(np.int64)
        return k, np.maximum(t - k * self.period, 0.0)


@dataclass(frozen=True, eq=False)
class SampledBase(BasePath):
    """The base of a motion made ahead."""

    samples: Samples
    sideways: bool = False
    followable = True

    def sample(self, t: ArrayLike) -> BaseSamples:
        """See `BasePath.sample`."""
        (k, s), data, nb = self.samples.at(t), self.samples, 2 + self.sideways
        nu, nudot, pose = data.nu[k, :nb], data.nudot[k, :nb], data.pose[k].copy()
        turned = pose[:, 2].copy()
        for share, part in ((1 / 6, 0.0), (4 / 6, 0.5), (1 / 6, 1.0)):  # as `tasks.advance`
            u = part * s
            c, sine = cos_sin_of(turned + u * nu[:, -1] + 0.5 * u * u * nudot[:, -1])
            vx = nu[:, 0] + u * nudot[:, 0]
            vy = nu[:, 1] + u * nudot[:, 1] if self.sideways else np.zeros_like(u)
            pose[:, 0] += share * s * (c * vx - sine * vy)
            pose[:, 1] += share * s * (sine * vx + c * vy)
        pose[:, 2] += s * nu[:, -1] + 0.5 * s * s * nudot[:, -1]
        return BaseSamples(times(t), pose, nu + s[:, None] * nudot, nudot)


@dataclass(frozen=True, eq=False)
class SampledJoint(JointProfile):
    """A joint of a motion made ahead."""

    samples: Samples
    joint: int

    def sample(self, t: ArrayLike) -> JointSamples:
        """See `JointProfile.sample`."""
        (k, s), data = self.samples.at(t), self.samples
        i = data.pose.shape[1] and data.nu.shape[1] - data.q.shape[1]
        qdot, qddot = data.nu[k, i + self.joint], data.nudot[k, i + self.joint]
        return JointSamples(data.q[k, self.joint] + s * qdot + 0.5 * s * s * qddot, qdot + s * qddot, qddot)


@dataclass(frozen=True, eq=False)
class HandMotion:
    """A motion of base and arm that takes frames along their paths.

    Attributes:
        samples: Of base and arm.
        frames: The frames with tasks.
        tasks: Their tasks.
        sideways: Whether the base velocities are `(vx, vy, w)`.
        targets: (N, tasks, 24) where they should be, see `tasks.TARGET`.
        reached: (N, tasks, 12) where the reference has them: rotation row by row, origin.
        begins: When the path begins, after driving and reaching [s].
        ends: When it ends [s].
        misses: Samples at which the program had no solution.
    """

    samples: Samples
    frames: tuple[str, ...]
    tasks: tuple[Task, ...]
    sideways: bool
    targets: Array
    reached: Array
    begins: float
    ends: float
    misses: int

    @cached_property
    def trajectory(self) -> Trajectory:
        """The setpoints."""
        nb = self.samples.nu.shape[1] - self.samples.q.shape[1]
        base = SampledBase(self.samples, self.sideways) if nb else None
        arm = tuple(SampledJoint(self.samples, i) for i in range(self.samples.q.shape[1]))
        last = {frame: i for i, frame in reversed([*enumerate(self.frames)]) if not self.tasks[i].looks}
        seen = sorted(last.values())
        places = np.concatenate((self.targets[:, seen, R : R + 9], self.targets[:, seen, P : P + 3]), axis=2)
        frames = {self.frames[i]: bool(self.tasks[i].weights[3:].any()) for i in seen}
        wanted = poses(places.reshape(-1, SIZE)).reshape(len(places), len(seen), -1)
        return Trajectory(base, arm, watched=Hands(frames, self.samples.period, wanted))

    @cached_property
    def gaps(self) -> Array:
        """(N, tasks) distance of the frames from where they should be [m]; 0 for those that may be elsewhere.

        These are frames that look, axes without a weight, and tasks that come after others.
        """
        first = min(task.priority for task in self.tasks)
        must = np.array([(t.weights[:3] > 0.0) * (t.priority == first) for t in self.tasks])
        away = (self.targets[:, :, P : P + 3] - self.reached[:, :, 9:]) * must
        return np.sqrt(np.sum(away * away, axis=2))

    @property
    def gap(self) -> Array:
        """(N,) largest distance of a frame from where it should be, see `gaps` [m]."""
        return self.gaps.max(axis=1)


def plan(
    body: WholeBody,
    paths: Sequence[HandPath | None],
    duration: float,
    *,
    start: Sequence[float] = (0.0, 0.0, 0.0),
    posture: ArrayLike | None = None,
    at: Sequence[float] | None = None,
    drive: tuple[float, float] = (0.3, 0.5),
    tolerance: float | None = 0.005,
) -> HandMotion:
    """Make a motion of the hand.

    Args:
        body: The robot's tasks and limits.
        paths: One per task; None keeps a frame where it is, relative to nothing.
        duration: Of the motion, which stays where the path ends [s].
        start: Pose of the base at the start.
        posture: (n,) joints at the start; None for `comfortable`.
        at: Where the first path begins in the world [m], in the world's axes; None where the path says so, else where
            the hand is, in the robot's axes.
        drive: Mean speed [m/s] and turning rate [rad/s] of driving there.
        tolerance: Largest distance from the path while it is followed [m]; None takes any.

    Raises:
        TrajectoryError: The hand cannot follow: where, when and by how much; or the run is too short.
        ConfigError: A posture outside the joints' ends, or not as many paths as tasks.
    """
    d = body.robot.dimensions
    if len(paths) != len(body.tasks):
        raise ConfigError(f"{len(paths)} paths for {len(body.tasks)} tasks", fix="give one each", key="reference.hand")

    def made(q: Array) -> HandMotion:
        return motion_from(body, paths, duration, np.array(start, float) if d.base else np.zeros(0), q, at, drive)

    if posture is None:
        motion = made(suited(body, made, tolerance))
    else:
        q = given_array("reference.hand.posture", posture, (d.arm,))
        require_within(body.robot, q, body.bounds.ends)
        motion = made(q)
    if motion.ends > duration + 1e-9:
        what = f"the path ends at {motion.ends:.3g} s, the run at {duration:g} s"
        raise TrajectoryError(what, fix=f"set time.duration={np.ceil(motion.ends):g}, or raise the path's speed")
    if tolerance is not None:
        require_followed(motion, body, tolerance)
    return motion


def suited(body: WholeBody, made: Callable[[Array], HandMotion], tolerance: float | None) -> Array:
    """The first of the `comfortable` postures from which the path can be followed, tried in coarse steps; (n,)."""
    postures, period = comfortable(body), body.period
    if tolerance is None:
        return postures[0]
    body.period = max(COARSE, period)
    try:
        gaps: list[float] = []
        for q in postures[:TRIED]:
            motion = made(q)
            gaps.append(float(motion.gap[round(motion.begins / body.period) :].max(initial=0.0)))
            if gaps[-1] < tolerance / 2:
                break
        return postures[int(np.argmin(gaps))]
    finally:
        body.period, body.misses = period, 0


def motion_from(
    body: WholeBody,
    paths: Sequence[HandPath | None],
    duration: float,
    pose: Array,
    q: Array,
    at: Sequence[float] | None,
    drive: tuple[float, float],
) -> HandMotion:
    """A motion from a posture (n,), whatever it reaches; arguments as of `plan`."""
    body.posture[:], body.given = q, True
    body.put(pose, q)
    first = next(path for path in paths if path is not None)
    begin, turned = (np.array(at, float), None) if at is not None else first.begin
    legs = () if begin is None or not pose.size else drive_there(body, begin, drive)
    require_drivable(body, legs)
    samples = [driving(leg, body, q) for leg in legs]
    if legs:
        body.put(np.array([profile.goal for profile in legs[-1]]), q)
    driven = sum(len(part.nu) for part in samples)
    targets = wanted(body, paths, begin, turned, duration - driven * body.period)
    return joined(body, [*samples, follow(body, targets.rows)], targets, driven)


def require_followed(motion: HandMotion, body: WholeBody, tolerance: float) -> None:
    """Refuse a motion that leaves its path (`TrajectoryError`)."""
    h, gap = body.period, motion.gap.copy()
    gap[: round(motion.begins / h)] = 0.0
    if gap.max() <= tolerance:
        return
    out, worst = int(np.argmax(gap > tolerance)), int(np.argmax(gap))
    which = int(np.argmax(motion.gaps[worst]))
    place = ", ".join(f"{x:.3g}" for x in motion.targets[worst, which, P : P + 3])
    joints = np.abs(motion.samples.q[worst] - body.bounds.ends).min(axis=0) < 1e-3
    ends = [name for name, near in zip(body.robot.joint_names, joints, strict=True) if near]
    why = f"there {', '.join(ends)} is at its end" if ends else "the arm is stretched out, or limits hold it back"
    far, when = f"{1e3 * gap[worst]:.3g} mm from ({place})", f"t = {worst * h:.3g} s"
    raise TrajectoryError(
        f"'{motion.frames[which]}' cannot follow its path: {far} at {when}, "
        f"off by more than {1e3 * tolerance:g} mm from t = {out * h:.3g} s on",
        why=why,
        fix="move the path, lower its speed, or free its orientation (orientation = 0)",
        key="reference.hand.path",
    )


def require_within(robot: Robot, q: Array, ends: Array) -> None:
    """Refuse a posture outside the joints' ends (`ConfigError`)."""
    outside = np.flatnonzero((q < ends[0]) | (q > ends[1]))
    if len(outside):
        i = int(outside[0])
        what, why = f"{robot.joint_names[i]} = {q[i]:.4g}", f"its ends are {ends[0, i]:.4g} and {ends[1, i]:.4g}"
        raise ConfigError(what, why=why, fix="choose a posture between them", key="reference.hand.posture")


def comfortable(body: WholeBody) -> list[Array]:
    """Postures (n,) near the middle of the joints' ranges, far from singular, the hand ahead of the robot; best first.

    Of some postures, the same ones always: those with the largest log sqrt det(J J'), less the square of how far the
    joints are from the middle.
    """
    rng, n = np.random.default_rng(0), body.q.size
    free, ends = ~np.isfinite(body.bounds.ends).all(axis=0), np.clip(body.bounds.ends, -FAR, FAR)
    middle = np.where(free, np.clip(0.0, ends[0], ends[1]), (ends[0] + ends[1]) / 2)
    half = np.minimum(np.where(free, HALF_RANGE, (ends[1] - ends[0]) / 2), HALF_RANGE)
    rows, nb = body.weights[0] > 0, body.robot.dimensions.twist
    scored: list[tuple[float, int, Array]] = []
    for share in (np.zeros(n), *rng.uniform(-SPREAD, SPREAD, (TRIES, n))):
        q = np.clip(middle + share * half, ends[0], ends[1])
        body.put(np.zeros(body.pose.size), q)
        ahead = body.places[0, 9] > 0.0 and body.places[0, 11] > 0.05
        score = manipulability(body.J[0][rows, nb:]) - 0.2 * float(np.sum(share * share)) / n - (0.0 if ahead else 10.0)
        scored.append((-score, len(scored), q))
    return [q for _, _, q in sorted(scored, key=lambda each: each[:2])]


# -- driving there -----------------------------------------------------------------------------------------------------


def drive_there(
    body: WholeBody, begin: Array, drive: tuple[float, float]
) -> tuple[tuple[MinimumJerk, MinimumJerk, MinimumJerk], ...]:
    """Turn, go straight, turn: profiles of x, y, phi, to where the hand in its posture is above the path's begin."""
    x, y, phi = body.pose
    heading = atan2(begin[1] - y, begin[0] - x)
    c, s = cos_sin(phi)
    dx, dy = body.places[0, 9] - x, body.places[0, 10] - y
    ahead, aside = c * dx + s * dy, c * dy - s * dx
    c, s = cos_sin(heading)
    goal = np.array([begin[0] - c * ahead + s * aside, begin[1] - s * ahead - c * aside])
    way = np.array([goal[0] - x, goal[1] - y])
    far = length(way)
    along = atan2(way[1], way[0]) if far > CLOSE else phi
    tail_first = abs(near(along - phi, 0.0)) > np.pi / 2 and far < 1.0  # a short way back is driven backwards
    along = along + np.pi if tail_first else along
    stops = [(x, y, phi), (x, y, near(along, phi))]
    if far > CLOSE:
        stops.append((goal[0], goal[1], stops[-1][2]))
    stops.append((*stops[-1][:2], near(heading, stops[-1][2])))
    legs = []
    for before, after in pairwise(stops):
        step = np.array(after) - before
        lasts = max(length(step[:2]) / drive[0], abs(step[2]) / drive[1])
        if lasts > 1e-6:
            legs.append(tuple(MinimumJerk(a, b, lasts) for a, b in zip(before, after, strict=True)))
    return tuple(legs)  # type: ignore[arg-type]


def require_drivable(body: WholeBody, legs: Sequence[tuple[MinimumJerk, ...]]) -> None:
    """Refuse turns on the spot of a base that has a tightest curve (`TrajectoryError`)."""
    if body.steers and any(leg[2].start != leg[2].goal for leg in legs):
        what, why = "the path begins where the base would have to turn on the spot to be", "its steering cannot"
        fix = "let the path begin at the hand, or choose reference.hand.start so that its begin is straight ahead"
        raise TrajectoryError(what, why=why, fix=fix, key="reference.hand.at")


def near(angle: float, other: float) -> float:
    """The angle in the turn around another one [rad]."""
    return other + np.pi - (np.pi - (angle - other)) % (2 * np.pi)


def driving(leg: tuple[MinimumJerk, ...], body: WholeBody, q: Array) -> Samples:
    """Samples of a turn on the spot or of a straight drive, the arm at rest."""
    h, nb = body.period, body.robot.dimensions.twist
    t = np.arange(max(1, round(leg[0].duration / h))) * h
    x, y, phi = (profile.sample(t) for profile in leg)
    c, s = cos_sin_of(phi.q)
    p = len(body.nu)
    nu, nudot = np.zeros((len(t), p)), np.zeros((len(t), p))
    for table, dx, dy, w in ((nu, x.qdot, y.qdot, phi.qdot), (nudot, x.qddot, y.qddot, phi.qddot)):
        table[:, 0], table[:, nb - 1] = c * dx + s * dy, w
        if body.robot.dimensions.sideways:
            table[:, 1] = c * dy - s * dx
    pose = np.column_stack((x.q, y.q, phi.q))
    return Samples(h, pose, np.tile(q, (len(t), 1)), nu, nudot)


# -- reaching and following --------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Wanted:
    """Targets (N, tasks, 24) from where the drive has ended; when the path begins and ends after that [s]."""

    rows: Array
    begins: float
    ends: float


def wanted(
    body: WholeBody, paths: Sequence[HandPath | None], begin: Array | None, turned: Array | None, lasts: float
) -> Wanted:
    """The targets of all tasks, the first one's after reaching its begin.

    Raises:
        TrajectoryError: Nothing is left of the run.
    """
    h = body.period
    count = round(lasts / h) + 1
    if count < 2:
        fix = "set a longer time.duration, or start nearer"
        raise TrajectoryError("the run ends before the robot is where the path begins", fix=fix)
    t, rows = np.arange(count) * h, np.zeros((count, len(paths), TARGET))
    reach, ends, axes = 0.0, 0.0, np.eye(3) if begin is not None else body.axes
    for i, path in enumerate(paths):
        place = body.places[i]
        origin, R = place[9:].copy(), place[:9].reshape(3, 3).copy()
        if path is None:
            rows[:, i] = body.target_here(i)
            continue
        if begin is not None and ends == 0.0:
            reach = max(REACH, length(begin - origin) / body.settings.approach[0] * 2)
            share, by = MinimumJerk(0.0, 1.0, reach).sample(np.minimum(t, reach)), begin - origin
            moved = np.hstack((origin + np.outer(share.q, by), *(np.outer(d, by) for d in (share.qdot, share.qddot))))
            origin, R = begin, R if turned is None else turned
        followed = placed(path.sample(np.maximum(t - reach, 0.0)), origin, axes, R)
        rows[:, i] = followed.flat
        if reach and ends == 0.0:
            before = t < reach
            rows[before, i, : 3 * 3] = moved[before]
        ends = max(ends, reach + path.duration)
    return Wanted(rows, reach, ends)


def follow(body: WholeBody, targets: Array) -> Samples:
    """The program's motion from the body's present state, and where its frames are: into `reached`."""
    N, p = len(targets), body.nu.size
    pose, q = np.zeros((N, body.pose.size)), np.zeros((N, body.q.size))
    nu, nudot = np.zeros((N, p)), np.zeros((N, p))
    for k in range(N):
        pose[k], q[k], nu[k] = body.pose, body.q, body.nu
        nudot[k] = body.step(targets[k])
    return Samples(body.period, pose, q, nu, nudot)


def joined(body: WholeBody, parts: Sequence[Samples], targets: Wanted, driven: int) -> HandMotion:
    """One motion of a drive and what follows it."""
    names = ("pose", "q", "nu", "nudot")
    samples = Samples(body.period, *(np.concatenate([getattr(part, name) for part in parts]) for name in names))
    count = len(samples.nu)
    every = np.zeros((count, len(body.tasks), TARGET))
    every[:driven], every[driven:] = targets.rows[0], targets.rows
    reached = np.zeros((count, len(body.tasks), SIZE))
    for k in range(count):
        body.pose[:], body.q[:], body.nu[:] = samples.pose[k], samples.q[k], samples.nu[k]
        body.look_around()
        reached[k] = body.places
    before = driven * body.period
    when = (before + targets.begins, before + targets.ends)
    return HandMotion(
        samples, body.frames, body.tasks, body.robot.dimensions.sideways, every, reached, *when, body.misses
    )

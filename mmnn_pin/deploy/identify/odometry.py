"""Radii of the wheels and track from odometry against a reference pose: motion capture, lidar, odometry, a tape.

The wheels' angles turn into a path by the base's own law, with unknown radii left and right and an unknown track b:

    phi = phi_0 + (r_right theta_right - r_left theta_left) / b,    ds = (r_right dtheta_right + r_left dtheta_left) / 2

The reference is that path, from an unknown start, seen late by a marker somewhere on the base (Antonelli, Chiaverini,
Fusco 2005, IEEE T-RO 21(5), have the same unknowns but marker and delay). Nonlinear least squares; residuals that are
correlated in time widen the standard deviations. A few poses, as of a tape at start and end (UMBmark: Borenstein, Feng
1996, IEEE T-RA 12(6)), are those of the base itself, `TAPE` exact.

Where radii or track are nonsense, a damage of the log is looked for that makes sense of them: a sign, a unit, sides
exchanged.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
import scipy

from ...elementary.arrays import unwrapped
from ...errors import RecordingError
from ...model.robot import Robot
from ...signals import Array
from .log import REFERENCE, Log, LogFinding
from .mends import Mend, mended, words_of
from .times import spans
from .timing import least_of

NAMES = ("radius_left", "radius_right", "track")
ROWS, QUICK = 1500, 200  # of a log at most; where damages are tried
SHORT, LONG = 12, 60  # evaluations of a fit
TURNED = 1.0  # heading that has to change for a track to be seen [rad]
TRAVELLED = 0.5  # way that has to be driven for radii to be seen [m]
TAPE = np.array([5e-3, 5e-3, 1e-2])  # standard deviation of a pose that is one of a few [m, m, rad]
FEW = 20  # poses in a stretch from which the marker and the delay are looked for
LATEST = 1.5  # [s] of delay either way that is looked at
WIDE = 0.05  # largest relative sd of a radius or track that is believed
ODD, NONSENSE = 1.25, 2.0  # times the URDF's that are told, and that no wheel is
SCRUB = 4.0  # the same of the track of a base whose wheels scrub
OFF = 0.1  # error of the path, of its extent, that is no odometry
NEARER = 10.0  # by how much a damage has to lower the cost to be told


@dataclass(frozen=True, eq=False)
class Wheels:
    """Wheels of a differential or skid-steer base.

    Attributes:
        value: (3,) left and right radius, track [m].
        sd: (3,) their standard deviations [m].
        urdf: (3,) what the robot had.
        error: RMS distance of the path from the reference [m], and before.
        ratio: Right over left radius, and its standard deviation.
        late: How much later the reference is than the wheels [s], and its standard deviation; 0 for a few poses.
        marker: (3,) pose of the marker on the base [m, m, rad].
        relative: Error of path and heading over their extent.
    """

    value: Array
    sd: Array
    urdf: Array
    error: tuple[float, float]
    ratio: tuple[float, float]
    late: tuple[float, float]
    marker: Array
    relative: float

    def to_dict(self) -> dict[str, dict[str, float]]:
        """Value, sd and the former value by name."""
        rows = zip(NAMES, self.value.tolist(), self.sd.tolist(), self.urdf.tolist(), strict=True)
        found = {name: {"value": value, "sd": sd, "urdf": urdf} for name, value, sd, urdf in rows}
        before = self.urdf[1] / self.urdf[0]
        return found | {"ratio": {"value": self.ratio[0], "sd": self.ratio[1], "urdf": float(before)}}

    @property
    def cost(self) -> float:
        """How unlikely they are: by the path's error, and by their distance from the URDF's."""
        if not (self.value > 0).all():
            return 1e4
        away = np.log(self.value / self.urdf) / 0.15
        turned = np.angle(np.exp(1j * self.marker[2]))  # a base that drives ahead, and one that backs, differ by it
        unlikely = np.minimum(away**2, 200.0).sum() + (self.late[0] / 0.5) ** 2 + turned**2
        return float(20 * np.log(self.relative + 1e-3) + unlikely)


@dataclass(frozen=True, eq=False)
class Stretch:
    """A drive without gaps."""

    time: Array  # (n,) of the wheels' angles [s]
    angles: Array  # (n, 2) turned forward, left and right [rad]
    seen: Array  # (k,) times of the reference [s]
    pose: Array  # (k, 3) of it, its heading unwrapped


def has_reference(log: Log, robot: Robot) -> bool:
    """Whether a log has a reference pose, and the angles of a base on two sides of wheels."""
    wheels = [wheel.joint for wheel in robot.base.wheels]
    angles = all(name in log.position for name in wheels)
    return robot.base.two_sided and angles and all(name in log.reference for name in REFERENCE)


def wheels_of(robot: Robot, logs: Sequence[Log], rows: int = ROWS) -> Wheels:
    """Radii and track that lead the wheels' angles along the reference.

    Args:
        robot: On two sides of wheels.
        logs: With a reference.
        rows: Of a stretch of the reference that are looked at, at most.

    Raises:
        RecordingError: The base hardly drives or turns.
    """
    drives = [one for log in logs for one in stretches(log, robot, rows)]
    drives = [one for one in drives if smooth(one)] or drives  # a remnant between two gaps is no tape
    way = sum(float(np.linalg.norm(np.diff(one.pose[:, :2], axis=0), axis=1).sum()) for one in drives if smooth(one))
    way = max(way, sum(float(np.abs(np.diff(one.angles.mean(axis=1))).sum()) * mean_radius(robot) for one in drives))
    turn = sum(turned(one, robot) for one in drives)
    if way < TRAVELLED or turn < TURNED:
        needed = f"radii and track need {TRAVELLED:g} m and {TURNED:g} rad"
        why = f"it drives {way:.2g} m and turns by {turn:.2g} rad; {needed}"
        raise RecordingError("too small a drive for wheels", why=why, fix="drive an eight", file=logs[0].name)
    radius = np.array([np.mean([w.radius for w in robot.base.wheels if (w.y > 0) == left]) for left in (True, False)])
    return fitted(drives, np.array([*radius, robot.base.track]), SHORT if rows < ROWS else LONG)


def mean_radius(robot: Robot) -> float:
    """Of the wheels [m]."""
    return float(np.mean([wheel.radius for wheel in robot.base.wheels]))


def smooth(one: Stretch) -> bool:
    """Whether a stretch has more than a few poses."""
    return len(one.seen) >= FEW


def turned(one: Stretch, robot: Robot) -> float:
    """How far the heading turns, by the reference or by the wheels [rad]."""
    by_wheels = np.ptp(one.angles[:, 1] - one.angles[:, 0]) * mean_radius(robot) / robot.base.track
    return float(max(np.ptp(one.pose[:, 2]), by_wheels))


def stretches(log: Log, robot: Robot, most: int) -> list[Stretch]:
    """The drives of a log between its gaps, thinned."""
    angles, found = side_angles(log, robot), []
    pose = np.column_stack([log.reference[name] for name in REFERENCE])
    known = np.isfinite(pose.sum(axis=1))
    for span in spans(log.time):
        rows = np.arange(span.start, span.stop)
        seen = rows[known[rows]]
        if len(rows) < 10 or len(seen) < 2:
            continue
        rows, few = rows[:: max(1, len(rows) // (2 * most))], seen[:: max(1, len(seen) // most)]
        few = few if len(few) >= FEW else seen
        where = pose[few].copy()
        where[:, 2] = unwrapped(where[:, 2])
        found.append(Stretch(log.time[rows], angles[rows] - angles[rows[0]], log.time[few], where))
    return found


def fitted(drives: Sequence[Stretch], urdf: Array, most: int) -> Wheels:
    """The least squares of the module over some drives."""
    dense = all(map(smooth, drives))
    drives = drives if dense else [nearest_turn(one, urdf) for one in drives]
    late = lateness(drives) if dense else 0.0
    starts = [start_of(one, urdf, late) for one in drives]
    marker = np.array([0.0, 0.0, starts[0][3] if dense else 0.0])
    weight = 1.0 / TAPE if not dense else np.array([1.0, 1.0, urdf[2]])
    free = 7 if dense else 3

    def unpacked(x: Array) -> tuple[Array, Array, float, Array]:
        rest = x[free:].reshape(-1, 3)
        return x[:3], (x[3:6] if dense else marker), (float(x[6]) if dense else 0.0), rest

    def left(x: Array, weight: Array) -> Array:
        numbers, mark, delay, begin = unpacked(x)
        parts = [
            (seen(driven(one, numbers, b, delay), mark) - one.pose) * weight
            for one, b in zip(drives, begin, strict=True)
        ]
        return np.concatenate(parts)

    first = np.concatenate((urdf, [*marker, late] if dense else [], *(one[:3] for one in starts)))
    size = np.concatenate((urdf, [0.1, 0.1, 0.1, 0.1] if dense else [], np.ones(3 * len(drives))))
    solution = scipy.optimize.least_squares(lambda x: left(x, weight).ravel(), first, x_scale=size, max_nfev=most)
    if dense and most > SHORT:  # heading and place by their own scatter
        rms = np.sqrt((left(solution.x, np.ones(3)) ** 2).mean(axis=0))
        weight = 1.0 / np.maximum([np.hypot(*rms[:2]) / np.sqrt(2)] * 2 + [rms[2]], 1e-9)
        solution = scipy.optimize.least_squares(
            lambda x: left(x, weight).ravel(), solution.x, x_scale=size, max_nfev=most
        )
    before = first[3:]
    if most > SHORT:
        before = scipy.optimize.least_squares(
            lambda x: left(np.concatenate((urdf, x)), weight).ravel(), before, max_nfev=most
        ).x
    noise = np.mean(solution.fun**2) * correlated(solution.fun) if dense else max(1.0, spread(solution.fun, len(first)))
    covariance = np.linalg.pinv(solution.jac.T @ solution.jac) * noise
    rows = left(solution.x, np.ones(3))
    extent = np.maximum(
        [np.linalg.norm(np.ptp(np.concatenate([d.pose - d.pose[0] for d in drives])[:, :2], axis=0))] * 2, 1e-3
    )
    turn = max(max(np.ptp(one.pose[:, 2]) for one in drives), 1e-3)
    relative = float(np.sqrt((rows[:, :2] ** 2).mean()) / extent[0] + np.sqrt((rows[:, 2] ** 2).mean()) / turn)
    errors = [
        float(np.sqrt(((left(x, np.ones(3))[:, :2]) ** 2).mean() * 2))
        for x in (solution.x, np.concatenate((urdf, before)))
    ]
    value, mark, delay, _ = unpacked(solution.x)
    ratio = value[1] / value[0]
    lever = np.array([-ratio / value[0], 1 / value[0]])
    ratio_sd = float(np.sqrt(max(lever @ covariance[:2, :2] @ lever, 0.0)))
    late_sd = float(np.sqrt(max(covariance[6, 6], 0.0))) if dense else 0.0
    sd = np.sqrt(np.maximum(np.diag(covariance)[:3], 0.0))
    return Wheels(value, sd, urdf, (errors[0], errors[1]), (float(ratio), ratio_sd), (delay, late_sd), mark, relative)


def nearest_turn(one: Stretch, numbers: Array) -> Stretch:
    """A stretch of a few poses, whose headings are those nearest to where the wheels lead by some numbers."""
    made = driven(one, numbers, one.pose[0], 0.0)
    pose = one.pose.copy()
    pose[:, 2] = made[:, 2] + np.angle(np.exp(1j * (one.pose[:, 2] - made[:, 2])))
    return replace(one, pose=pose)


def spread(residual: Array, unknowns: int) -> float:
    """Variance of residuals over what is free of them."""
    free = residual.size - unknowns
    return float(residual @ residual) / free if free > 0 else 1.0


def lateness(drives: Sequence[Stretch]) -> float:
    """The delay with which the heading of the reference is the most linear in the wheels' angles [s]."""

    def left(late: float) -> float:
        total = 0.0
        for one in drives:
            at = [np.interp(one.seen - late, one.time, column) for column in one.angles.T]
            X = np.column_stack((*at, np.ones(len(one.seen))))
            total += float(((one.pose[:, 2] - X @ np.linalg.lstsq(X, one.pose[:, 2], rcond=None)[0]) ** 2).sum())
        return total

    return least_of(left, 0.0, LATEST)[0]


def start_of(one: Stretch, numbers: Array, late: float) -> Array:
    """Start pose of a stretch, and the angle of the marker, (4,), by laying the path onto the reference."""
    made = driven(one, numbers, np.zeros(3), late)
    a, b = made[:, :2] - made[:, :2].mean(axis=0), one.pose[:, :2] - one.pose[:, :2].mean(axis=0)
    turn = float(np.arctan2((a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]).sum(), (a * b).sum()))
    angle = float(np.mean(one.pose[:, 2] - made[:, 2]))
    if not smooth(one):
        return np.array([*one.pose[0, :2], one.pose[0, 2], 0.0])
    c, s = np.cos(turn), np.sin(turn)
    at = one.pose[:, :2].mean(axis=0) - np.array([[c, -s], [s, c]]) @ made[:, :2].mean(axis=0)
    return np.array([*at, turn, angle - turn])


def side_angles(log: Log, robot: Robot) -> Array:
    """Angles that the wheels of the left and of the right side have turned forward, (N, 2), their means."""
    found = []
    for left in (True, False):
        own = [wheel for wheel in robot.base.wheels if (wheel.y > 0) == left]
        found.append(np.mean([wheel.sign * log.position[wheel.joint] for wheel in own], axis=0))
    return np.column_stack(found)


def driven(one: Stretch, numbers: Array, start: Array, late: float) -> Array:
    """Poses (k, 3) of a base at the times of the reference, so much later."""
    made = path(one.angles, numbers, start)
    return np.column_stack([np.interp(one.seen - late, one.time, column) for column in made.T])


def path(angles: Array, numbers: Array, start: Array) -> Array:
    """Poses (N, 3) of a base whose wheels turn by angles (N, 2), by radii and track, from a start (3,); exact arcs."""
    left, right = numbers[0] * angles[:, 0], numbers[1] * angles[:, 1]
    phi = start[2] + (right - left) / numbers[2]
    way, turn = np.diff(left + right) / 2, np.diff(phi)
    chord, middle = way * np.sinc(turn / (2 * np.pi)), (phi[1:] + phi[:-1]) / 2
    x = start[0] + np.concatenate(([0.0], np.cumsum(chord * np.cos(middle))))
    y = start[1] + np.concatenate(([0.0], np.cumsum(chord * np.sin(middle))))
    return np.column_stack((x, y, phi))


def seen(pose: Array, marker: Array) -> Array:
    """Poses of a marker (x, y, angle) on the base, (N, 3)."""
    c, s = np.cos(pose[:, 2]), np.sin(pose[:, 2])
    x, y = pose[:, 0] + c * marker[0] - s * marker[1], pose[:, 1] + s * marker[0] + c * marker[1]
    return np.column_stack((x, y, pose[:, 2] + marker[2]))


def correlated(residual: Array) -> float:
    """How many residuals say as much as one: 1 and twice their autocorrelation, up to where it is lost in noise."""
    rows = residual.reshape(-1, 3) - residual.reshape(-1, 3).mean(axis=0)
    power, total = float((rows**2).sum()), 1.0
    for lag in range(1, len(rows) // 4):
        rho = float((rows[lag:] * rows[:-lag]).sum()) / max(power, 1e-300)
        if rho < 2 / np.sqrt(len(rows)):
            break
        total += 2 * rho
    return total


# -- what makes sense of them ------------------------------------------------------------------------------------------


def wheel_findings(robot: Robot, logs: Sequence[Log]) -> tuple[Wheels | None, list[LogFinding]]:
    """Radii and track, None where nothing can be said of them, and what contradicts them.

    Args:
        robot: On two sides of wheels.
        logs: Sound ones with a reference, see `has_reference`.
    """
    still = all(np.ptp(side_angles(log, robot), axis=0).max() * mean_radius(robot) < 0.02 for log in logs)
    if still and max(np.ptp(np.nan_to_num(log.reference[REFERENCE[0]])) for log in logs) > TRAVELLED:
        return None, [refusal("the wheels stand still while the reference drives", "wheels", 1e3)]
    try:
        found = wheels_of(robot, logs)
    except RecordingError as error:
        what = "the base stands still" if still else error.what
        return None, [LogFinding("warned", what, error.why, "nothing is said of its wheels")]
    if not list(nonsense(found, robot)):
        return found, list(odd(found, logs))
    mends = explained(robot, logs)
    if mends is None:
        whats = "; ".join(nonsense(found, robot))
        return None, [refusal(whats, "radii and track", 50.0)]
    better = wheels_of(robot, [mended(log, mends) for log in logs])
    late = better.late
    if abs(late[0]) > 3 * late[1] and abs(late[0]) > 0.01:
        mends = (*mends, ("reference.*", f"late:{late[0]:.4g}"))
    what = f"{', '.join(words_of(mends))}"
    why = f"{'; '.join(nonsense(found, robot))}; with this mended {in_mm(better)}"
    return None, [LogFinding("refused", what, why, "radii and track", mends, "", 100.0)]


def refusal(what: str, changes: str, size: float) -> LogFinding:
    """A finding without a mend but to leave the reference out."""
    fix = "look at signs, units and seams; to go on without wheels"
    return LogFinding("refused", what, "", changes, (("reference.*", "dropped"),), fix, size)


def in_mm(found: Wheels) -> str:
    """Radii and track with bands."""
    left, right, track = (f"{1e3 * v:.4g} ± {1.96e3 * s:.2g}" for v, s in zip(found.value, found.sd, strict=True))
    return f"radii {left} and {right}, track {track} mm"


def nonsense(found: Wheels, robot: Robot) -> Iterator[str]:
    """Radii and tracks that no wheels have, and paths that leave the reference."""
    for name, value, sd, urdf in zip(NAMES, found.value, found.sd, found.urdf, strict=True):
        most = SCRUB if robot.base.scrubs and name == "track" else NONSENSE
        said = f"a {name.replace('_', ' ')} of {1e3 * value:.4g} ± {1.96e3 * sd:.2g} mm"
        if value <= 0 or not 1 / NONSENSE < value / urdf < most:
            yield f"{said} for {1e3 * urdf:.4g} in the URDF"
        elif not sd < WIDE * value:
            yield f"{said}: the drive does not tell it"
    if found.relative > OFF:
        yield f"the wheels' path leaves the reference by {found.error[0]:.2g} m"


def odd(found: Wheels, logs: Sequence[Log]) -> Iterator[LogFinding]:
    """Findings on wheels that make sense: a late reference, sizes far from the URDF's, the mounting."""
    late, sd = found.late
    period = float(np.median(np.diff(logs[0].time)))
    if abs(late) > 3 * sd and abs(late) > 1.5 * period:
        what = f"the reference is {1e3 * abs(late):.3g} ± {1.96e3 * sd:.2g} ms {'late' if late > 0 else 'early'}"
        changes = f"radii and track, {in_mm(found)} with it"
        yield LogFinding("refused", what, "", changes, (("reference.*", f"late:{late:.4g}"),), "", 30.0)
    for name, value, urdf in zip(NAMES, found.value, found.urdf, strict=True):
        if not 1 / ODD < value / urdf < ODD:
            what = f"a {name.replace('_', ' ')} of {1e3 * value:.4g} mm for {1e3 * urdf:.4g} in the URDF"
            yield LogFinding("warned", what, "", "what is written beside the URDF", (), "measure it", 5.0)
    if np.linalg.norm(found.marker[:2]) > 0.02 or abs(found.marker[2]) > 0.02:
        x, y, angle = found.marker
        what = f"the reference is mounted at ({1e3 * x:.0f}, {1e3 * y:.0f}) mm of the base, turned by {angle:.3g} rad"
        yield LogFinding("mended", what, "", "taken out")


def explained(robot: Robot, logs: Sequence[Log]) -> Mend | None:
    """Mends, one or two at once, with which the wheels make sense; None where there are none."""
    chosen: Mend = ()
    before = wheels_of(robot, logs, QUICK).cost
    for _ in range(3):
        costs: dict[Mend, float] = {}
        for mend in damages_of(robot, logs):
            try:
                costs[mend] = wheels_of(robot, [mended(log, (*chosen, *mend)) for log in logs], QUICK).cost
            except (RecordingError, ValueError, np.linalg.LinAlgError):
                continue
        best = min(costs, key=lambda one: costs[one], default=())
        if not best or costs[best] > before - NEARER:
            return None
        chosen, before = (*chosen, *best), costs[best]
        if not list(nonsense(wheels_of(robot, [mended(log, chosen) for log in logs]), robot)):
            return chosen
    return None


def damages_of(robot: Robot, logs: Sequence[Log]) -> list[Mend]:
    """Damages of wheels and reference, as what would mend them."""
    sides = [[w.joint for w in robot.base.wheels if (w.y > 0) == left] for left in (True, False)]
    wheels = [f"position.{name}" for side in sides for name in side]
    found: list[Mend] = [((name, "negated"),) for name in wheels]
    found += [tuple((name, how) for name in wheels) for how in ("deg", "negated", "rev")]
    found += [((name, how),) for name in wheels for how in ("deg", "rev")]
    swapped = [pair for a, b in zip(*sides, strict=False) for pair in ((a, b), (b, a))]
    found.append(tuple((f"position.{a}", f"position.{b}") for a, b in swapped))
    found += [(("reference.phi", how),) for how in ("deg", "negated")]
    found += [tuple((name, how) for name in REFERENCE[:2]) for how in ("mm", "cm")]
    found += [((name, "negated"),) for name in REFERENCE[:2]]
    found.append(((REFERENCE[0], REFERENCE[1]), (REFERENCE[1], REFERENCE[0])))
    return found

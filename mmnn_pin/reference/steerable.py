"""Limits of a base that steers: curvatures within its stops, angles that change no faster than its motors turn.

Before a robot moves, `require_steerable` refuses a reference with what would help: a path so many times as large, or
driven so many times as slowly. `fitted` does that to it. Something is kept in hand for errors: of the way between the
stops, and of the rates.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..elementary import arrays, cos_sin
from ..elementary.arrays import hypot
from ..errors import TrajectoryError
from ..model.base.base import Base
from ..model.base.rolling import PASSIVE, ROLES, STEERED, Pivot
from ..model.base.stance import MOVES, Stance, along, bends, room, trail_of
from ..model.base.steered import Articulated, SteeredBase
from ..signals import Array, Dimensions, Setpoint
from .limits import OF_RATE, OF_STOPS
from .path import BasePath, BaseSamples, require_positive
from .samples import in_three
from .trajectory import Trajectory

EXACT = 1e-6  # beyond a limit that is none, by the limit
SLACK = 1.05  # times a rate: a timed path may need a little more between the points of its grid
JUMP = 0.02  # between two samples that is one, beyond what the rates explain [rad]
FOLDED = math.pi / 2  # angle of a hitch without stops beyond which it is folded [rad]
SPOT = 1e3  # curvature that is none, by the largest
LARGER, LARGEST = 1.1, 20.0  # sizes that are tried are powers of it, and at most that
GRID = 101  # curvatures at which their rates are looked at
FINELY = 2000  # instants at which a reference is looked at that is made to fit


@dataclass(frozen=True)
class Needs:
    """Needs of a reference so that a base can steer along it."""

    size: float = 1.0  # how many times as large the path has to be
    slowness: float = 1.0  # how many times as long everything has to take
    refused: TrajectoryError | None = None  # why it cannot be steered as it is; None where it can


@dataclass(frozen=True)
class Enlarged(BasePath):
    """A path so many times as large about its start, with the accelerations of the path itself."""

    path: BasePath  # the path
    factor: float  # how many times as large

    def __post_init__(self) -> None:
        require_positive(factor=self.factor)
        object.__setattr__(self, "sideways", self.path.sideways)

    @property
    def followable(self) -> bool:  # type: ignore[override]
        """See `BasePath`."""
        return self.path.followable

    @property
    def duration(self) -> float:
        """When it has come to rest [s]; inf without an end."""
        return math.sqrt(self.factor) * float(getattr(self.path, "duration", math.inf))

    def sample(self, t: ArrayLike) -> BaseSamples:
        """See `BasePath.sample`."""
        slower, t = math.sqrt(self.factor), np.asarray(t, float)
        one, start = self.path.sample(t / slower), self.path.sample([0.0]).pose[0, :2]
        pose, velocity, acceleration = one.pose.copy(), one.velocity / slower, one.acceleration / self.factor
        pose[:, :2] = start + self.factor * (pose[:, :2] - start)
        velocity[:, :-1] *= self.factor
        acceleration[:, :-1] *= self.factor
        return BaseSamples(t, pose, velocity, acceleration)


def fitted(
    trajectory: Trajectory, base: Base, dimensions: Dimensions, duration: float, trailer: bool = False
) -> Trajectory:
    """A trajectory as large and as slow as a base needs to steer along it.

    Args:
        trajectory: The trajectory.
        base: The robot's base.
        dimensions: Of the robot.
        duration: Of the run [s].
        trailer: Whether it is its trailer's.

    Raises:
        TrajectoryError: No size or slowness helps.
    """
    if not isinstance(base, SteeredBase) or trajectory.base is None:
        return trajectory
    path, tried = trajectory.base, trajectory
    for _ in range(3):
        t = np.linspace(0.0, duration * tried.slowness, FINELY)
        needs = needs_of(base, t, Setpoint.side_by_side(tried.table(t, dimensions), dimensions), trailer)
        if needs.refused is None:
            return tried
        refused = needs.refused
        if 1.0 < needs.size < math.inf:
            factor = needs.size * (tried.base.factor if isinstance(tried.base, Enlarged) else 1.0)
            tried = replace(tried, base=Enlarged(path, factor))
        elif 1.0 < needs.slowness < math.inf:
            tried = replace(tried, slowness=tried.slowness * needs.slowness)
        else:
            break
    raise refused


def start_angles(base: Base, setpoints: Setpoint, near: Array | None = None) -> Array:
    """Angles (K,) of a base's pivots, in the order of `base.shape`, that stand along the first setpoint that moves.

    A wheel that may stand in two ways takes the one in which it stays between its stops all along.

    Args:
        base: The base.
        setpoints: One, or N with arrays (N, size).
        near: (K,) angles from which the nearer way is taken [rad]; None for 0.
    """
    if not isinstance(base, SteeredBase):
        return np.zeros(0)
    twist, change, pivots = in_columns(setpoints.velocity), in_columns(setpoints.acceleration), base.pivots
    return along(pivots, np.arange(float(len(twist))), twist, change, near, OF_STOPS).angles[0]


def require_steerable(base: Base, time: Array, setpoints: Setpoint, trailer: bool = False) -> None:
    """Refuse a reference along which a base cannot steer.

    Args:
        base: The base; one that does not steer follows any.
        time: (N,) [s].
        setpoints: (N, size).
        trailer: Whether the reference is its trailer's, which backs.

    Raises:
        TrajectoryError: With where, what it needs, what can be had, and what would help.
    """
    refused = needs_of(base, time, setpoints, trailer).refused
    if refused is not None:
        raise refused


def needs_of(base: Base, time: Array, setpoints: Setpoint, trailer: bool = False) -> Needs:
    """Size and slowness that a reference needs so that a base steers along it; arguments as of `require_steerable`."""
    if not isinstance(base, SteeredBase) or len(time) < 2:
        return Needs()
    twist, change = in_columns(setpoints.velocity), in_columns(setpoints.acceleration)
    if trailer and (behind := hitches(base)):  # without one `Kinematic` refuses
        twist, change, gamma = pushing(behind[0], time, twist, change)
        needs = folding_needed(behind[0], time, in_columns(setpoints.velocity), gamma)
        base = replace(base, pivots=tuple(p for p in base.pivots if p not in behind))
    else:
        needs = backing_needed(base, time, twist)
    if not base.pivots:
        return needs
    if needs.refused is None:
        needs = bend_needed(base, time, twist)
    if needs.refused is None:
        stance = along(base.pivots, time, twist, change, share=OF_STOPS)
        needs = room_needed(base, time, twist, change, stance)
    if needs.refused is None:
        needs = rates_needed(base, time, stance)
    return needs


def in_columns(velocity: Array) -> Array:
    """Velocities `(vx, vy, w)` (N, 3) of a twist, one or N of them."""
    return np.stack(in_three(np.atleast_2d(velocity)), axis=1)


def bend_needed(base: SteeredBase, time: Array, twist: Array) -> Needs:
    """The size that a path needs so that its curvature is within the steering's."""
    least, most = curvatures(base)
    v, w = twist[:, 0], twist[:, 2]
    size = hypot(v, base.length * w)
    turns = np.where(w * np.where(v < 0.0, -1.0, 1.0) > 0.0, most, -least)  # to the left, to the right
    with np.errstate(divide="ignore", invalid="ignore"):
        over = np.abs(w) / np.abs(v) / turns
    over = np.where((size > MOVES * size.max(initial=0.0)) & (w != 0.0) & np.isfinite(turns), over, 0.0)
    i = int(np.argmax(over))
    if over[i] <= 1.0 + EXACT:
        return Needs()
    there, can = f"at t = {time[i]:.4g} s", f"its steering reaches a curvature of {turns[i]:.3g} 1/m"
    if not over[i] < SPOT:
        what, fix = f"the reference turns on the spot {there}", f"drive a curve of {1.0 / turns[i]:.3g} m or more there"
        return Needs(math.inf, refused=TrajectoryError(what, why=can, fix=fix))
    larger = rounded_up(float(over[i]))
    what = f"the path bends by {over[i] * turns[i]:.3g} 1/m {there}"
    fix = f"draw it {larger:g} times as large, every radius {1.0 / turns[i]:.3g} m or more"
    return Needs(larger, refused=TrajectoryError(what, why=can, fix=fix))


def curvatures(base: Base | None) -> tuple[float, float]:
    """Smallest and largest curvature of a reference [1/m]; without bounds where a base turns on the spot."""
    if isinstance(base, SteeredBase) and base.body == STEERED and not base.sideways:
        return bends(base.pivots, OF_STOPS)
    return -math.inf, math.inf


def bend_rate(base: Base) -> float:
    """Rate of the curvature that a reference may have at any curvature [1/(m s)]; inf where nothing bounds it."""
    least, most = curvatures(base)
    if not isinstance(base, SteeredBase) or not most - least < math.inf:
        return math.inf
    grid = np.linspace(least, most, GRID)
    twist, change = np.stack([grid**0, 0 * grid, grid], 1), np.stack([0 * grid, 0 * grid, grid**0], 1)
    steers = [k for k, p in enumerate(base.pivots) if p.role != ROLES[PASSIVE] and p.parent < 0]
    rates = np.abs(along(base.pivots, grid - grid[0], twist, change).rates)
    return min(
        (OF_RATE * base.pivots[k].rate / rates[:, k].max() for k in steers if rates[:, k].any()), default=math.inf
    )


def hitches(base: SteeredBase) -> list[Pivot]:
    """Pivots that turn as two bodies roll: trailers' hitches, which nothing turns, and a loader's waist."""
    waist = isinstance(base, Articulated)
    return [p for p in base.pivots if waist or (p.role == ROLES[PASSIVE] and not p.motor)]


def pushes_trailer(base: Base) -> bool:
    """Whether a base that backs pushes a trailer on a hitch that no motor turns."""
    loose = (
        [p for p in base.pivots if p.role == ROLES[PASSIVE] and not p.motor] if isinstance(base, SteeredBase) else []
    )
    return bool(loose) and not base.sideways


def backing_needed(base: SteeredBase, time: Array, twist: Array) -> Needs:
    """No size and no slowness helps where a trailer, or a loader's other axle, is pushed further than it is long."""
    trails = [trail_of(p) for p in hitches(base)]
    longest, way = max(map(abs, trails), default=math.inf), 1.0 if max(trails, default=-1.0) > 0.0 else -1.0
    back = np.append(0.0, np.cumsum(np.maximum(way * twist[:-1, 0], 0.0) * np.diff(time)))
    if back[-1] <= longest * (1.0 + EXACT):
        return Needs()
    goes = "backs up" if way < 0.0 else "goes ahead"
    pushed = "an axle" if isinstance(base, Articulated) else "a trailer"
    what, why = f"it {goes} by {back[-1]:.3g} m with {pushed} pushed", "a hitch that is pushed folds from any error"
    fix = f'let what is pushed follow the path, kinematic.guide = "trailer", or go {longest:.3g} m at most so'
    return Needs(math.inf, math.inf, TrajectoryError(what, why=why, fix=fix))


def pushing(hitch: Pivot, time: Array, twist: Array, change: Array) -> tuple[Array, Array, Array]:
    """Twists of the truck, (N, 3), their rates, and the hitch's angle, (N,), where its trailer moves by these twists.

    The trailer stands straight behind at first. See `base.trailers`, whose gammadot is integrated by the midpoint.
    """
    h, L, gamma = -hitch.x, -hitch.wheel[0], np.zeros(len(time))

    def turning(angle: float, i: int) -> float:
        c, s = cos_sin(angle)
        return float(twist[i, 2] + (s * twist[i, 0] + L * c * twist[i, 2]) / h)

    for i in range(len(time) - 1):
        dt = time[i + 1] - time[i]
        gamma[i + 1] = np.clip(gamma[i] + dt * turning(gamma[i] + 0.5 * dt * turning(gamma[i], i), i), -np.pi, np.pi)
    (c, s), (v, w) = arrays.cos_sin(gamma), twist[:, [0, 2]].T
    moved = np.stack((c * v - L * s * w, 0 * v, -(s * v + L * c * w) / h), axis=1)
    return moved, np.gradient(moved, time, axis=0), gamma


def folding_needed(hitch: Pivot, time: Array, twist: Array, gamma: Array) -> Needs:
    """No size and no slowness helps where a trailer that leads folds away from its truck.

    It does from any error where it drives forwards, its hitch behind the truck's axle (`base.trailers`).
    """
    ahead = np.append(0.0, np.cumsum(np.maximum(-hitch.x * twist[:-1, 0] / abs(hitch.x), 0.0) * np.diff(time)))
    low, high = room(hitch, OF_STOPS)
    folds = (np.abs(gamma) >= FOLDED) | (gamma < low) | (gamma > high)
    folds |= ahead > abs(trail_of(hitch)) * (1.0 + EXACT)
    if not folds.any():
        return Needs()
    what, why = f"the truck folds up at t = {time[folds][0]:.4g} s", "its trailer leads"
    fix = 'let the trailer lead backwards only, along wide curves; else kinematic.guide = "base"'
    return Needs(math.inf, math.inf, TrajectoryError(what, why=why, fix=fix))


def stops_of(pivot: Pivot) -> tuple[float, float]:
    """Stops that a reference keeps to [rad]; a hitch without any must not fold."""
    low, high = sorted(pivot.sign * end for end in room(pivot, OF_STOPS))
    if pivot.role == ROLES[PASSIVE] and not pivot.motor:
        return max(low, -FOLDED), min(high, FOLDED)
    return low, high


def out_of_room(base: SteeredBase, stance: Stance) -> tuple[int, int] | None:
    """The pivot, and the sample, that is furthest beyond a stop; None where none is."""
    beyond = np.zeros(stance.angles.shape)
    for k, p in enumerate(base.pivots):
        low, high = stops_of(p)
        beyond[:, k] = np.maximum(low - stance.angles[:, k], stance.angles[:, k] - high)
    i, k = (int(at) for at in np.unravel_index(int(np.argmax(beyond)), beyond.shape))
    return (k, i) if beyond[i, k] > EXACT else None


def room_needed(base: SteeredBase, time: Array, twist: Array, change: Array, stance: Stance) -> Needs:
    """The size that a path needs so that pivots stay between their stops, found by trying."""
    out = out_of_room(base, stance)
    if out is None:
        return Needs()
    (k, i), (low, high) = out, stops_of(base.pivots[out[0]])
    what = f"'{base.pivots[k].joint}' would stand at {stance.angles[i, k]:.3g} rad at t = {time[i]:.4g} s"
    why, size = f"it keeps within {low:.3g} and {high:.3g} rad", LARGER
    while size <= LARGEST:
        larger = np.array([size, size, 1.0])
        if out_of_room(base, along(base.pivots, time, larger * twist, larger * change, share=OF_STOPS)) is None:
            size = rounded_up(size)
            return Needs(size, refused=TrajectoryError(what, why=why, fix=f"draw it {size:g} times as large"))
        size *= LARGER
    fix = "let the base look along its path" if base.sideways else "let it bend to one side less long"
    return Needs(math.inf, math.inf, TrajectoryError(what, why=why, fix=fix))


def rates_needed(base: SteeredBase, time: Array, stance: Stance) -> Needs:
    """The slowness that a reference needs so that its pivots turn no faster than they can."""
    most = OF_RATE * np.array([p.rate for p in base.pivots])
    if not np.isfinite(most).any():
        return Needs()
    over = np.abs(stance.rates) / most
    i, k = (int(at) for at in np.unravel_index(int(np.argmax(over)), over.shape))
    if over[i, k] > SLACK:
        slower = rounded_up(float(over[i, k]))
        what = f"'{base.pivots[k].joint}' would turn at {abs(stance.rates[i, k]):.3g} rad/s at t = {time[i]:.4g} s"
        why, fix = f"a reference may ask for {most[k]:.3g} rad/s", f"let everything take {slower:g} times as long"
        return Needs(slowness=slower, refused=TrajectoryError(what, why=why, fix=fix))
    return jump_needed(base, time, stance, most)


def jump_needed(base: SteeredBase, time: Array, stance: Stance, most: Array) -> Needs:
    """No slowness helps where a wheel jumps, but standing there does."""
    for k, p in enumerate(base.pivots):
        on: NDArray[np.int64] = np.flatnonzero(stance.moves[:, k])
        jumps, passed = np.abs(np.diff(stance.angles[on, k])), np.diff(time[on])
        late = jumps - most[k] * passed
        if late.max(initial=0.0) > JUMP:
            i = int(np.argmax(late))
            what = f"'{p.joint}' would have to jump by {jumps[i]:.3g} rad at t = {time[on[i + 1]]:.4g} s"
            fix = f"stand there for {jumps[i] / most[k] * 1.01:.3g} s, or let the curvature have no corner"
            why = f"a reference may ask for {most[k]:.3g} rad/s"
            return Needs(math.inf, math.inf, TrajectoryError(what, why=why, fix=fix))
    return Needs()


def rounded_up(factor: float) -> float:
    """A factor a little larger, in three digits."""
    digits = 2 if factor < 10.0 else 1
    return math.ceil(factor * 1.002 * 10**digits) / 10**digits

"""Can the wheels' constraint be integrated? The Frobenius test, on the pose and with the wheel angles.

The motions that the wheels permit are `xdot = sum_i f_i(x) u_i` with one vector field per base velocity. The Lie
bracket

    [f, g] = (dg/dx) f - (df/dx) g

is the direction that manoeuvring to and fro along f and g adds. If all brackets stay within the span of the fields (the
distribution is involutive), the constraint is holonomic (Frobenius); otherwise brackets are added until the rank no
longer grows, which gives the involutive closure (2.9), (2.10). Its dimension is that of what the base can reach.

Where a base steers, its fields depend on the angles of its pivots, which are coordinates beside the pose; followers
stand where their master has them. Of wheels that have to agree two say where the others stand.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ...signals import Array
from ..base.rolling import FOLLOWER, ROLES, base_size, closed, new_maps, roll
from ..base.steered import SteeredBase
from ..robot import Robot

VectorField = Callable[[Array], Array]
STEP = 0.01  # of the derivatives, [rad, m]; fourth order, so nested brackets keep more than eight digits
RANK_TOLERANCE = 1e-6  # singular values below this times the largest count as zero, the given fields having unit length
WEIGHTS = ((-2, 1 / 12), (-1, -8 / 12), (1, 8 / 12), (2, -1 / 12))  # fourth-order central difference


@dataclass(frozen=True)
class Closure:
    """Growth of a distribution by Lie brackets.

    Attributes:
        coordinates: Dimension of the space.
        growth: Rank of the distribution, then the rank after every round of brackets, until it stays.
    """

    coordinates: int
    growth: tuple[int, ...]

    @property
    def distribution(self) -> int:
        """Rank of the distribution."""
        return self.growth[0]

    @property
    def closure(self) -> int:
        """Dimension of the involutive closure."""
        return self.growth[-1]


@dataclass(frozen=True)
class Nonholonomy:
    """The Frobenius test of a base.

    Attributes:
        pose: On the pose (x, y, phi), and on the angles of pivots where a base steers; None for a fixed arm.
        with_wheels: On the pose and the angles of the drive wheels; None without wheels, and where a base steers.
        verdict: In words, about the pose.
    """

    pose: Closure | None
    with_wheels: Closure | None
    verdict: str


def nonholonomy(robot: Robot, rng: np.random.Generator | None = None, samples: int = 5) -> Nonholonomy:
    """Frobenius test of a robot's base.

    Args:
        robot: The robot.
        rng: Draws the points at which ranks are taken; the largest rank counts.
        samples: Number of points.
    """
    if not robot.dimensions.base:
        return Nonholonomy(None, None, "fixed: there is no base, and nothing to integrate")
    rng = np.random.default_rng(0) if rng is None else rng
    if isinstance(robot.base, SteeredBase):
        posture = involutive_closure(*steered_fields(robot.base, rng, samples))
        return Nonholonomy(posture, None, verdict(posture, "every pose and every angle"))
    pose = involutive_closure(base_fields(robot, ()), rng.uniform(-2, 2, (samples, 3)))
    wheels = tuple(wheel.joint for wheel in robot.base.wheels)
    size = 3 + len(wheels)
    turned = involutive_closure(base_fields(robot, wheels), rng.uniform(-2, 2, (samples, size))) if wheels else None
    return Nonholonomy(pose, turned, verdict(pose))


def verdict(pose: Closure, all_of_it: str = "every pose") -> str:
    """The meaning of the ranks on the pose, in words."""
    d, c = pose.distribution, pose.closure
    if d == pose.coordinates:
        return f"holonomic: nothing constrains the pose, the base moves in all its {d} directions at once"
    if c == d:
        return (
            f"integrable: the {d} directions of motion are involutive, so the constraint is holonomic and the base "
            f"stays on a surface of dimension {d} of {pose.coordinates}"
        )
    reach = f"{all_of_it} can be reached" if c == pose.coordinates else f"only {c} of {pose.coordinates} dimensions"
    return f"nonholonomic: {d} directions of motion, brackets of them add {c - d}; {reach}"


def base_fields(robot: Robot, wheels: Sequence[str]) -> list[VectorField]:
    """One field per base velocity on (x, y, phi of the control frame in the world; angles of the wheels named).

    They are the columns of T: the control frame's velocity turned into the world, S of (2.7), and the wheels' rates.
    """
    nb = robot.dimensions.base
    body = robot.base.to_control @ robot.T[:3, :nb]
    rates = robot.T[[robot.full_velocity_names.index(name) for name in wheels], :nb]

    def field(i: int) -> VectorField:
        def at(x: Array) -> Array:
            c, s = np.cos(x[2]), np.sin(x[2])
            vx, vy, w = body[:, i]
            return np.concatenate([[c * vx - s * vy, s * vx + c * vy, w], rates[:, i]])

        return at

    return [field(i) for i in range(nb)]


def steered_fields(base: SteeredBase, rng: np.random.Generator, samples: int) -> tuple[list[VectorField], Array]:
    """Fields of a base that steers on (x, y, phi; angles of pivots but followers), and points (samples, dim)."""
    pivots = base.pivots[:2] if base.agree else base.pivots
    base = replace(base, pivots=pivots, wheels=())
    rolling = base.rolling_at({name: 3 + i for i, name in enumerate(base.shape)})
    free = np.array([0, 1, 2, *(3 + k for k, p in enumerate(pivots) if p.role != ROLES[FOLLOWER])])
    maps, still = new_maps(rolling, np.zeros((3 + len(pivots), base_size(rolling)))), np.zeros(base_size(rolling))

    def field(i: int) -> VectorField:
        def at(x: Array) -> Array:
            position = np.zeros(3 + len(pivots))
            position[free] = x
            roll(rolling, closed(rolling, position), still, maps)
            (vx, vy, w), c, s = maps.V[0][:, i], np.cos(x[2]), np.sin(x[2])
            return np.concatenate(([c * vx - s * vy, s * vx + c * vy, w], maps.T[free[3:], i]))

        return at

    points = [np.concatenate((rng.uniform(-2, 2, 3), base.random_angles(rng)))[free] for _ in range(samples)]
    return [field(i) for i in range(still.size)], np.array(points)


def bracket(f: VectorField, g: VectorField) -> VectorField:
    """Lie bracket `[f, g] = (dg/dx) f - (df/dx) g`, by differences along f and g."""

    def at(x: Array) -> Array:
        a, b = f(x), g(x)
        return along(g, x, a) - along(f, x, b)

    return at


def along(f: VectorField, x: Array, direction: Array) -> Array:
    """Derivative of a field at x along a direction."""
    size = float(np.linalg.norm(direction))
    if size == 0:
        return np.zeros_like(direction)
    h = STEP / size
    return np.sum([weight * f(x + i * h * direction) for i, weight in WEIGHTS], axis=0) / h


def involutive_closure(fields: Sequence[VectorField], points: Array) -> Closure:
    """Growth of the rank by brackets of the fields with what is there, until a round adds nothing.

    Args:
        fields: The distribution.
        points: (k, dim) where ranks are taken; the largest counts.
    """
    fields = [unit(f, points) for f in fields]
    kept, newest = list(fields), list(fields)
    growth = [rank(kept, points)]
    while newest and growth[-1] < points.shape[1]:
        added: list[VectorField] = []
        for f in fields:
            for g in newest:
                candidate = bracket(f, g)
                if rank([*kept, *added, candidate], points) > rank([*kept, *added], points):
                    added.append(candidate)
        kept, newest = kept + added, added
        if added:
            growth.append(rank(kept, points))
    return Closure(points.shape[1], tuple(growth))


def unit(f: VectorField, points: Array) -> VectorField:
    """The field divided by its largest length over the points: a bracket of two such that vanishes is seen to."""
    length = max(float(np.linalg.norm(f(x))) for x in points)
    return (lambda x: f(x) / length) if length else f


def rank(fields: Sequence[VectorField], points: Array) -> int:
    """Largest rank of the fields over the points: singular values above `RANK_TOLERANCE` times the largest."""
    best = 0
    for x in points:
        columns = np.stack([f(x) for f in fields], axis=1)
        singular = np.linalg.svd(columns, compute_uv=False)
        best = max(best, int((singular > RANK_TOLERANCE * singular[0]).sum()) if singular[0] > 0 else 0)
    return best

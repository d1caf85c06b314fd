"""Can the wheels' constraint be integrated? The Frobenius test, on the pose and with the wheel angles.

The motions that the wheels permit are `xdot = sum_i f_i(x) u_i` with one vector field per base velocity. Of a base that
steers x is its *posture*: the pose and the angles of steering joints, casters and hitches. The Lie bracket

    [f, g] = (dg/dx) f - (df/dx) g

is the direction that manoeuvring to and fro along f and g adds. If all brackets stay within the span of the fields (the
distribution is involutive), the constraint is holonomic (Frobenius); otherwise brackets are added until the rank no
longer grows, which gives the involutive closure (2.9), (2.10). Its dimension is that of what the base can reach.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from ...signals import Array
from ..base.rolling import FOLLOWER, ROLES
from ..base.steered import SteeredBase
from ..robot import Robot

VectorField = Callable[[Array], Array]
NEAR = 0.8  # angles at which ranks of a base that steers are taken [rad]
STEP = 0.01  # of the derivatives, [rad, m]; fourth order, so nested brackets keep more than eight digits
RANK_TOLERANCE = 1e-6  # singular values below this times the largest count as zero, the given fields having unit length
WEIGHTS = ((-2, 1 / 12), (-1, -8 / 12), (1, 8 / 12), (2, -1 / 12))  # fourth-order central difference


@dataclass(frozen=True)
class Closure:
    """Growth of a distribution by Lie brackets."""

    coordinates: int  # dimension of the space
    growth: tuple[int, ...]  # rank of the distribution, then the rank after every round of brackets, until it stays

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
    """The Frobenius test of a base."""

    pose: Closure | None  # on the pose (x, y, phi), of a base that steers on its posture; None for a fixed arm
    # on the pose and the angles of the drive wheels; None without wheels, and of a base that steers
    with_wheels: Closure | None
    verdict: str  # in words, about the pose or the posture
    on: str = "pose"  # which of the two


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
    if robot.steers:
        return steered_nonholonomy(robot, rng, samples)
    pose = involutive_closure(base_fields(robot, ()), rng.uniform(-2, 2, (samples, 3)))
    wheels = tuple(wheel.joint for wheel in robot.base.wheels)
    size = 3 + len(wheels)
    turned = involutive_closure(base_fields(robot, wheels), rng.uniform(-2, 2, (samples, size))) if wheels else None
    return Nonholonomy(pose, turned, verdict(pose))


def steered_nonholonomy(robot: Robot, rng: np.random.Generator, samples: int) -> Nonholonomy:
    """Frobenius test of a base that steers, on its posture; arguments as of `nonholonomy`.

    Angles are drawn within their stops, and not far from rest, where u has one direction in all of a neighbourhood.
    """
    base = robot.base
    assert isinstance(base, SteeredBase)
    places = [0, 1, 2, *(robot.rows[pivot.joint] for pivot in base.pivots if pivot.role != ROLES[FOLLOWER])]
    low, high = np.maximum(robot.lower[places], -NEAR), np.minimum(robot.upper[places], NEAR)
    points = np.array([rng.uniform(0.9 * low, 0.9 * high) for _ in range(samples)])
    posture = involutive_closure(posture_fields(robot, places), points)
    return Nonholonomy(posture, None, verdict(posture, "posture"), "posture")


def posture_fields(robot: Robot, places: Sequence[int]) -> list[VectorField]:
    """One field per base velocity on the control frame's pose and the angles at other places of a position.

    Followers stand where their masters have them.
    """
    rest = robot.neutral_position()

    def field(i: int) -> VectorField:
        def at(x: Array) -> Array:
            position = rest.copy()
            position[places] = x
            maps = robot.maps_at(robot.follow(position))
            c, s = np.cos(x[2]), np.sin(x[2])
            vx, vy, w = maps.V[0, :, i]
            return np.concatenate(([c * vx - s * vy, s * vx + c * vy, w], maps.T[places[3:], i]))

        return at

    return [field(i) for i in range(robot.dimensions.base)]


def verdict(pose: Closure, on: str = "pose") -> str:
    """The meaning of the ranks on the pose or the posture, in words."""
    d, c = pose.distribution, pose.closure
    if d == pose.coordinates:
        return f"holonomic: nothing constrains the {on}, the base moves in all its {d} directions at once"
    if c == d:
        return (
            f"integrable: the {d} directions of motion are involutive, so the constraint is holonomic and the base "
            f"stays on a surface of dimension {d} of {pose.coordinates}"
        )
    reach = f"every {on} can be reached" if c == pose.coordinates else f"only {c} of {pose.coordinates} dimensions"
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

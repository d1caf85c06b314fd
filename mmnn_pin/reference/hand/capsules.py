"""Bodies that keep apart: spheres and capsules on links, and the rows that slow them down as they near each other.

The distance of two capsules is that of two segments less their radii, in closed form; coal gives the second answer in
the tests. A pair may near each other no faster than braking within the way that is left allows, so that it stops at the
clearance. The rows are soft: a start within the clearance is left slowly, and no limit of the motors gives way.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from ...compiled import compiled
from ...errors import ConfigError
from ...model.chain import SIZE, chain_of, move
from ...model.robot import Robot
from ...settings import Settings
from ...signals import Array

REACT = 3.0  # how fast the way that is left may be used up [1/s]


class Capsule(Settings, frozen=True):
    """All points nearer than a radius to a segment on a link; a sphere where both ends are the same point.

    Args:
        link: A link or another frame.
        start: One end, in the frame [m].
        end: The other end; None for a sphere.
        radius: [m].

    Raises:
        ConfigError: A radius that is not positive.
    """

    link: str
    radius: float
    start: tuple[float, float, float] = (0.0, 0.0, 0.0)
    end: tuple[float, float, float] | None = None

    def __post_init__(self) -> None:
        if not (0 < self.radius < np.inf and np.isfinite(self.start).all() and np.isfinite(self.end or 0.0).all()):
            fix = "give a radius > 0 and finite points"
            raise ConfigError(f"a capsule of radius {self.radius} m", fix=fix, key="reference.hand.capsules")


@compiled
def nearest(a: Array, b: Array, c: Array, d: Array, out: Array) -> float:
    """Distance of the segments ab and cd, and where: shares of the way along both, into out (2,)."""
    uu, vv, uv, uw, vw = 0.0, 0.0, 0.0, 0.0, 0.0
    for i in range(3):
        u, v, w = b[i] - a[i], d[i] - c[i], a[i] - c[i]
        uu += u * u
        vv += v * v
        uv += u * v
        uw += u * w
        vw += v * w
    s, t, det = 0.0, 0.0, uu * vv - uv * uv
    if uu > 1e-18 and vv > 1e-18 and det > 1e-12 * uu * vv:
        s = min(max((uv * vw - vv * uw) / det, 0.0), 1.0)
    if vv > 1e-18:
        t = min(max((uv * s + vw) / vv, 0.0), 1.0)
    if uu > 1e-18:
        s = min(max((uv * t - uw) / uu, 0.0), 1.0)
    out[0], out[1] = s, t
    square = 0.0
    for i in range(3):
        gap = a[i] + s * (b[i] - a[i]) - c[i] - t * (d[i] - c[i])
        square += gap * gap
    return math.sqrt(square)


class Pairs:
    """The pairs of capsules of one robot that can near each other.

    Args:
        robot: The robot.
        capsules: Its bodies.
        clearance: Distance that they keep [m].

    Attributes:
        count: Number of pairs.
        distance: (count,) distances at the last `fill` [m].

    Raises:
        UnknownName: A frame that the robot does not have.
    """

    def __init__(self, robot: Robot, capsules: Sequence[Capsule], clearance: float) -> None:
        self.capsules, self.clearance, p = tuple(capsules), clearance, robot.dimensions.twist + robot.dimensions.arm
        self.chains = [chain_of(robot, capsule.link) for capsule in capsules]
        carried = [tuple(chain.links[:, 1]) for chain in self.chains]
        self.pairs = [
            (i, j)
            for i in range(len(capsules))
            for j in range(i)
            if carried[i] != carried[j] and not neighbours(carried[i], carried[j])
        ]
        self.count, k = len(self.pairs), len(capsules)
        self.places, self.J = np.zeros((k, SIZE)), np.zeros((k, 6, p))
        self.twist, self.bias, self.share = np.zeros(6), np.zeros(6), np.zeros(2)
        self.ends, self.distance = np.zeros((k, 2, 3)), np.zeros(self.count)

    def fill(self, position: Array, nu: Array, h: float, rows: Array, lower: Array, upper: Array) -> None:
        """The rows of all pairs on nudot: `n' (J_i - J_j) (nu + h nudot) >= -REACT way` with the way that is left.

        Args:
            position: (nv,).
            nu: (p,).
            h: [s].
            rows: (count, p) written.
            lower: (count,) written.
            upper: (count,) written: none.
        """
        for i, (capsule, chain) in enumerate(zip(self.capsules, self.chains, strict=True)):
            place = self.places[i]
            move(chain, position, nu, place, self.twist, self.bias, self.J[i])
            for k, point in enumerate((capsule.start, capsule.end or capsule.start)):
                for row in range(3):
                    self.ends[i, k, row] = place[9 + row] + sum(place[3 * row + c] * point[c] for c in range(3))
        upper[:] = 1e30
        for k, (i, j) in enumerate(self.pairs):
            (a, b), (c, d) = self.ends[i], self.ends[j]
            gap = nearest(a, b, c, d, self.share)
            here = [e[0] + s * (e[1] - e[0]) for e, s in zip((self.ends[i], self.ends[j]), self.share, strict=True)]
            n = (here[0] - here[1]) / max(gap, 1e-9)
            self.distance[k] = gap - self.capsules[i].radius - self.capsules[j].radius
            rows[k] = along(self.J[i], here[0] - self.places[i, 9:], n) - along(
                self.J[j], here[1] - self.places[j, 9:], n
            )
            now = float(np.sum(rows[k] * nu))
            lower[k] = (-REACT * (self.distance[k] - self.clearance) - now) / h


def along(J: Array, arm: Array, n: Array) -> Array:
    """Row (p,) of the speed along n of a point at `arm` from a frame with the Jacobian J (6, p)."""
    row = np.zeros(J.shape[1])
    turned = np.cross(arm, n)
    for k in range(3):
        row = row + n[k] * J[k] + turned[k] * J[3 + k]
    return row


def neighbours(a: tuple[int, ...], b: tuple[int, ...]) -> bool:
    """Whether one of two bodies hangs on the other by one joint: they touch there."""
    short, long = sorted((a, b), key=len)
    return len(long) - len(short) == 1 and long[: len(short)] == short

"""Bases that steer: cars, tricycles, loaders, trailers, swerve drives, casters; their T follows from their pivots.

All are one mechanism (`rolling`); a kind says what its body may do and which law drives its pose. The command of the
pose's law, a velocity of the control frame, goes to the law that steers (`steering`).
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import ClassVar

import numpy as np

from ...elementary import cos_sin
from ...signals import Array
from .base import Base, LinearErrors, PoseEnergy, Wheel
from .differential import DifferentialDrive
from .holonomic import HolonomicBase
from .rolling import AXLE, FOLLOWER, FREE, MASTER, ROLES, STEERED, Maps, Pivot, Rolling, new_maps, roll
from .stance import along, bends


@dataclass(frozen=True, eq=False)
class SteeredBase(Base):
    """A base on pivots.

    Its `wheels` are all that roll, driven or not; an idle one is moved by the floor. The steering stands between the
    pose and nu, so that there is no `pose_energy` of these alone.
    """

    body: ClassVar[int] = STEERED  # what its body may do, `STEERED`, `AXLE` or `FREE` (`rolling`)

    pivots: tuple[Pivot, ...] = ()  # its pivots, a carrier before what it carries
    length: float = 1.0  # wheelbase, or radius of gyration of the wheels that steer, l of `rolling` [m]

    @property
    def masters(self) -> list[int]:
        """Numbers of the pivots that are steered."""
        return [k for k, pivot in enumerate(self.pivots) if pivot.role == ROLES[MASTER]]

    @property
    def velocity_names(self) -> tuple[str, ...]:
        """See `Base.velocity_names`: `u`, or the control frame's velocities, and the steering joints' rates."""
        first = ("u",) if self.body == STEERED else self.twist_names
        return (*first, *(self.pivots[k].joint for k in self.masters))

    @property
    def driven(self) -> tuple[str, ...]:
        """See `Base.driven`: drive wheels, then pivots with a motor."""
        wheels = tuple(wheel.joint for wheel in self.wheels if wheel.driven)
        return wheels + tuple(pivot.joint for pivot in self.pivots if pivot.motor)

    def place(self, wheel: Wheel) -> tuple[float, float]:
        """Where a wheel is, its axis where it is on a pivot, all pivots at zero: ahead and to the left [m]."""
        at, x, y = wheel.pivot, wheel.x, wheel.y
        if at >= 0:
            at, x, y = self.pivots[at].parent, self.pivots[at].x, self.pivots[at].y
        while at >= 0:
            at, x, y = self.pivots[at].parent, x + self.pivots[at].x, y + self.pivots[at].y
        return x, y

    @cached_property
    def shape(self) -> tuple[str, ...]:
        """See `Base.shape`."""
        return tuple(pivot.joint for pivot in self.pivots)

    def carriers(self, pose: Sequence[float], angles: Sequence[float]) -> list[Sequence[float]]:
        """See `Base.carriers`."""
        places = [pose]
        for pivot, angle in zip(self.pivots, angles, strict=True):
            x, y, heading = places[pivot.parent + 1]
            c, s = cos_sin(heading)
            at = x + c * pivot.x - s * pivot.y, y + s * pivot.x + c * pivot.y
            places.append((*at, heading + pivot.sign * angle))
        return places

    def rolling_at(self, places: Mapping[str, int]) -> Rolling:
        """The base as arrays for `rolling.roll`.

        Args:
            places: Place of every joint in the position, which is its row of T.
        """
        first, masters = len(self.velocity_names) - len(self.masters), self.masters
        column = {k: first + i for i, k in enumerate(masters)}
        turns = [(ROLES.index(p.role), p.parent, places[p.joint], column.get(k, -1)) for k, p in enumerate(self.pivots)]
        pivots = [
            (p.x, p.y, p.sign, *p.wheel[:2], *cos_sin(p.wheel[2]), *ends, p.rate)
            for p, ends in zip(self.pivots, self.stops(), strict=True)
        ]
        wheels = [(w.x, w.y, *cos_sin(w.heading), 1.0 / (w.sign * w.radius)) for w in self.wheels]
        return Rolling(
            turns=np.array(turns, np.int64).reshape(-1, 4),
            pivots=np.array(pivots, float).reshape(-1, 10),
            carriers=np.array([(w.pivot, places[w.joint]) for w in self.wheels], np.int64).reshape(-1, 2),
            wheels=np.array(wheels, float).reshape(-1, 5),
            body=self.body,
            axle=not self.sideways,
            length=float(self.length),
            root=np.ascontiguousarray(np.linalg.inv(self.to_control)),
        )

    def stops(self) -> list[tuple[float, float]]:
        """Ends of its pivots; a master's are where its followers reach theirs, if they do first [rad]."""
        found = [(p.lower, p.upper) for p in self.pivots]
        if not self.sideways and any(p.role == ROLES[FOLLOWER] for p in self.pivots):
            curves = [0.0, *(bend for bend in bends(self.pivots) if math.isfinite(bend))]
            straight, *turned = (self.angles(np.array([1.0, bend])) for bend in curves)
            for k in self.masters:
                low, high = found[k]
                for angle in (float(angles[k]) for angles in turned):
                    low, high = (max(low, angle), high) if angle < straight[k] else (low, min(high, angle))
                found[k] = low, high
        return found

    def angles(self, twist: Array) -> Array:
        """Angles of its pivots, (K,), that stand along the path of a twist, of those nearest to 0 [rad].

        Args:
            twist: (2,) or (3,) of the control frame; where that is 0 they stand at 0.
        """
        return along(self.pivots, np.zeros(1), self.eta_of(twist)[None], np.zeros((1, 3))).angles[0]

    @property
    def agree(self) -> bool:
        """Whether its steered wheels have to agree, as no axle is fixed."""
        return self.sideways and self.body == STEERED

    def random_angles(self, rng: np.random.Generator) -> Array:
        """Angles of all pivots within their stops, (K,); those whose wheels must agree stand along one twist [rad]."""
        found = np.array([rng.uniform(max(p.lower, -np.pi), min(p.upper, np.pi)) for p in self.pivots])
        if self.agree:
            found[self.masters] = self.angles(rng.uniform(-1.0, 1.0, 3))
        return found

    def eta_of(self, twist: Array) -> Array:
        """`(vx, vy, w)` of a twist."""
        eta = np.zeros(3)
        eta[self.columns] = twist
        return eta

    def linear_errors(self, v_ref: Array, gains: Array) -> LinearErrors:  # type: ignore[override]
        """See `Base.linear_errors`: the errors are those of the pose, then of the steering angles, (3 + masters).

        The wheels stand along the path. How the command of a wheel answers to an error of u along a curve is left out.

        Args:
            v_ref: (2,) or (3,) twist [m/s, rad/s].
            gains: Those of the pose's law, then of the law that steers.
        """
        law, m = self.pose_errors(v_ref, gains[:-1]), len(self.masters)
        if self.body != STEERED:
            return law
        base = {p.joint: 3 + k for k, p in enumerate(self.pivots)}
        wheels = {w.joint: 3 + len(base) + k for k, w in enumerate(self.wheels)}
        rolling, eta = self.rolling_at(base | wheels), self.eta_of(v_ref)
        position = np.zeros(3 + len(base) + len(wheels))
        position[3 : 3 + len(base)] = self.angles(v_ref)
        maps, one = new_maps(rolling, np.zeros((position.size, 1 + m))), np.eye(1 + m)
        roll(rolling, position, 0.0 * one[0], maps)
        n, W = maps.V[0][:, 0].copy(), np.array([1.0, 1.0, self.length**2])
        u, turned = float(n @ (W * eta)), np.zeros((3, m))
        for i in range(m):
            roll(rolling, position, one[1 + i], maps)
            turned[:, i] = maps.Vdot[0][:, 0]
        rates, by_velocity, command = np.zeros((3 + m, 3 + m)), np.zeros((3 + m, 1 + m)), np.zeros((1 + m, 3 + m))
        rates[:3, :3], rates[:3, 3:] = law.rates, u * law.by_velocity @ turned[self.columns]
        by_velocity[:3, 0], by_velocity[3:, 1:] = law.by_velocity @ n[self.columns], np.eye(m)
        command[0, :3] = (W * n)[self.columns] @ law.command
        for i, k in enumerate(self.masters):
            p, angle = self.pivots[k], position[base[self.pivots[k].joint]]
            c, s = cos_sin(p.sign * angle + p.wheel[2])
            row = np.array([-s, c, p.x * c + p.y * s])
            speed = float(np.array([c, s, p.x * s - p.y * c]) @ eta)
            if abs(speed) > 0.0:
                along = p.sign * row[self.columns] / speed
                command[1 + i, :3] = along @ law.command @ (gains[-1] * np.eye(3) + law.rates)
                command[1 + i, 3:] = along @ law.command @ rates[:3, 3:]
                command[1 + i, 3 + i] -= gains[-1]
        return LinearErrors(rates, by_velocity, command)

    @staticmethod
    def pose_errors(v_ref: Array, gains: Array) -> LinearErrors:
        """`linear_errors` of the law of its pose, for a base that moves as asked."""
        raise NotImplementedError

    def velocity_along(self, maps: Maps, twist: Array) -> Array:
        """See `Structure.base_velocity`: u, the part of a twist that the wheels permit; the steering stands still."""
        if self.body != STEERED:
            return twist
        n, W = maps.V[0][:, 0], np.array([1.0, 1.0, self.length**2])
        return np.append(n @ (W * self.eta_of(twist)), np.zeros(len(self.masters)))

    @classmethod
    def largest_gain(cls, gains: Array, speed: float) -> float:
        """See `Base.largest_gain`: of the law of its pose, or of the law that steers."""
        return max(cls.pose_gain(gains[:-1], speed), float(gains[-1]))

    @staticmethod
    def pose_gain(gains: Array, speed: float) -> float:
        """`largest_gain` of the law of its pose."""
        raise NotImplementedError

    @classmethod
    def per_base_velocity(cls, speed: float, yaw_rate: float, count: int) -> list[float]:
        """See `Base.per_base_velocity`: a steering joint turns."""
        own = [speed] if cls.body == STEERED else cls.per_velocity(speed, yaw_rate)
        return own + [yaw_rate] * (count - len(own))


def steered_rows(base: SteeredBase, rows: Mapping[str, int], position: Array) -> Array:
    """Rows on all velocities that vanish: of every wheel those along and across it, of followers that they follow.

    They come from the places of the wheels, not from T.

    Args:
        base: The base.
        rows: Place of every joint in the position.
        position: (nv,).
    """
    nv, K = len(rows) + 3, len(base.pivots)
    yaw = np.array([p.sign * position[rows[p.joint]] for p in base.pivots])
    carriers = [np.eye(3, 3 + K)]  # velocity of the body and of pivots' frames from (vx, vy, w) and the yaw rates
    for k, p in enumerate(base.pivots):
        vx, vy, w = carriers[p.parent + 1]
        vx, vy = vx - p.y * w, vy + p.x * w
        c, s = cos_sin(yaw[k])
        carriers.append(np.array([c * vx + s * vy, c * vy - s * vx, w + np.eye(3 + K)[3 + k]]))
    wheels: list[tuple[int, float, float, float, Wheel | None]] = [
        (w.pivot, w.x, w.y, w.heading, w) for w in base.wheels
    ]
    wheels += [(k, *p.wheel, None) for k, p in enumerate(base.pivots)]
    found, to_eta = list[Array](), np.zeros((3 + K, nv))
    to_eta[:3, :3] = base.to_control
    for k, p in enumerate(base.pivots):
        to_eta[3 + k, rows[p.joint]] = p.sign
    for pivot, x, y, heading, wheel in wheels:
        vx, vy, w = carriers[pivot + 1]
        vx, vy, (c, s) = vx - y * w, vy + x * w, cos_sin(heading)
        if wheel is None or wheel.grips:
            found.append((c * vy - s * vx) @ to_eta)
        if wheel is not None:
            row = (c * vx + s * vy) @ to_eta
            row[rows[wheel.joint]] -= wheel.sign * wheel.radius
            found.append(row)
    found += [following_row(base, k, yaw) @ to_eta for k, p in enumerate(base.pivots) if p.role == ROLES[FOLLOWER]]
    return np.array(found).reshape(-1, nv)


def following_row(base: SteeredBase, k: int, yaw: Array) -> Array:
    """Row on `(vx, vy, w)` and the yaw rates, (3 + K,): follower k's axle meets the master's on the fixed axle's line.

    The axle of a wheel at (x, y) under the heading h meets the line x = 0 at `y + x / tan h`, the same for both:
    `(yk - ym) sin hk sin hm + xk cos hk sin hm - xm cos hm sin hk = 0`, whose derivative the row is.
    """
    row, m = np.zeros(3 + len(base.pivots)), base.masters[0]
    one, other = base.pivots[k], base.pivots[m]
    (c, s), (cm, sm), apart = cos_sin(yaw[k] + one.wheel[2]), cos_sin(yaw[m] + other.wheel[2]), one.y - other.y
    row[3 + k] = apart * c * sm - one.x * s * sm - other.x * cm * c
    row[3 + m] = apart * s * cm + one.x * c * cm + other.x * sm * s
    return row


class OnAxle(SteeredBase):
    """A base with an axle that nothing steers: its pose is driven by Kanayama's law, as a differential drive's."""

    twist_names = DifferentialDrive.twist_names
    columns = DifferentialDrive.columns
    gain_names = (*DifferentialDrive.gain_names, "steering")
    pose_errors = staticmethod(DifferentialDrive.linear_errors)
    pose_gain = staticmethod(DifferentialDrive.largest_gain)


class CarLike(OnAxle):
    """A car: wheels ahead of a fixed axle, or behind it, steer together (Ackermann)."""

    kind = "car_like"
    words = "cars (Ackermann steering)"


class Tricycle(OnAxle):
    """A tricycle, forklift or pallet truck: one wheel steers, and mostly drives."""

    kind = "tricycle"
    words = "tricycles"


class Articulated(OnAxle):
    """A loader: a joint between its two axles steers."""

    kind = "articulated"
    words = "articulated loaders"


class CarWithTrailer(OnAxle):
    """A car or a tricycle with trailers on hitches."""

    kind = "trailer"
    words = "trucks with trailers"


class DriveWithTrailer(OnAxle):
    """A differential drive with trailers on hitches."""

    kind = "drive_trailer"
    words = "differential drives with trailers"
    body = AXLE


class Swerve(SteeredBase):
    """A swerve drive: all its wheels steer and drive."""

    kind = "swerve"
    words = "swerve drives"
    twist_names = HolonomicBase.twist_names
    columns = HolonomicBase.columns
    gain_names = (*HolonomicBase.gain_names, "steering")
    sideways = True
    pose_errors = staticmethod(HolonomicBase.linear_errors)
    pose_gain = staticmethod(HolonomicBase.largest_gain)


class Casters(Swerve):
    """Powered casters: wheels behind their swivels, or a pair behind a turret, so that the body moves freely."""

    kind = "casters"
    words = "powered casters"
    body = FREE

    @staticmethod
    def pose_energy(error: Array, z: Array, v_ref: Array, gains: Array) -> PoseEnergy | None:
        """See `Base.pose_energy`: as of a holonomic base."""
        return HolonomicBase.pose_energy(error, z, v_ref, gains[:-1])

    @staticmethod
    def pose_weights(gains: Array) -> Array | None:
        """See `Base.pose_weights`: as of a holonomic base."""
        return HolonomicBase.pose_weights(gains[:-1])


STEERED_KINDS: tuple[type[SteeredBase], ...] = (
    CarLike, Tricycle, Articulated, CarWithTrailer, DriveWithTrailer, Swerve, Casters,
)  # fmt: skip

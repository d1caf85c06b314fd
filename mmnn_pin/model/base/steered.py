"""Bases that steer: cars, tricycles, loaders, trailers, swerve drives, casters; their T follows from their pivots.

All are one mechanism (`rolling`); a kind says what its body may do and which law drives its pose. The command of the
pose's law, a velocity of the control frame, goes to the law that steers (`steering`).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import ClassVar

import numpy as np

from ...elementary import cos_sin
from ...signals import Array
from .base import Base, PoseEnergy, Wheel
from .differential import DifferentialDrive
from .holonomic import HolonomicBase
from .rolling import AXLE, FOLLOWER, FREE, MASTER, ROLES, STEERED, Pivot, Rolling


@dataclass(frozen=True, eq=False)
class SteeredBase(Base):
    """A base on pivots.

    Its `wheels` are all that roll, driven or not; an idle one is moved by the floor.

    Attributes:
        body: What its body may do, `STEERED`, `AXLE` or `FREE` (`rolling`).
        pivots: Its pivots, a carrier before what it carries.
        length: Wheelbase, or radius of gyration of the wheels that steer, l of `rolling` [m].
        scrub: Largest speed at which a wheel slides sideways per speed of the base, of what its file says; 0 where all
            roll exactly.
    """

    body: ClassVar[int] = STEERED

    pivots: tuple[Pivot, ...] = ()
    length: float = 1.0
    scrub: float = 0.0

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

    @cached_property
    def shape(self) -> tuple[str, ...]:
        """See `Base.shape`."""
        return tuple(pivot.joint for pivot in self.pivots)

    def rolling_at(self, places: Mapping[str, int]) -> Rolling:
        """The base as arrays for `rolling.roll`.

        Args:
            places: Place of every joint in the position, which is its row of T.
        """
        first, masters = len(self.velocity_names) - len(self.masters), self.masters
        column = {k: first + i for i, k in enumerate(masters)}
        turns = [(ROLES.index(p.role), p.parent, places[p.joint], column.get(k, -1)) for k, p in enumerate(self.pivots)]
        pivots = [(p.x, p.y, p.sign, *p.wheel[:2], *cos_sin(p.wheel[2]), p.lower, p.upper, p.rate) for p in self.pivots]
        wheels = [(w.x, w.y, *cos_sin(w.heading), 1.0 / (w.sign * w.radius)) for w in self.wheels]
        return Rolling(
            turns=np.array(turns, np.int64).reshape(-1, 4),
            pivots=np.array(pivots, float).reshape(-1, 10),
            carriers=np.array([(w.pivot, places[w.joint]) for w in self.wheels], np.int64).reshape(-1, 2),
            wheels=np.array(wheels, float).reshape(-1, 5),
            body=self.body,
            axle=any(w.pivot < 0 for w in self.wheels) or not self.sideways,
            length=float(self.length),
            root=np.ascontiguousarray(np.linalg.inv(self.to_control)),
        )

    @staticmethod
    def pose_energy(error: Array, z: Array, v_ref: Array, gains: Array) -> PoseEnergy | None:
        """See `Base.pose_energy`: the steering stands between the pose and nu, so there is none of these alone."""
        return None

    @staticmethod
    def pose_weights(gains: Array) -> Array | None:
        """See `Base.pose_weights`: none."""
        return None

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
        c, s = np.cos(yaw[k]), np.sin(yaw[k])
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
        vx, vy, c, s = vx - y * w, vy + x * w, np.cos(heading), np.sin(heading)
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
    h, g, apart = yaw[k] + one.wheel[2], yaw[m] + other.wheel[2], one.y - other.y
    row[3 + k] = apart * np.cos(h) * np.sin(g) - one.x * np.sin(h) * np.sin(g) - other.x * np.cos(g) * np.cos(h)
    row[3 + m] = apart * np.sin(h) * np.cos(g) + one.x * np.cos(h) * np.cos(g) + other.x * np.sin(g) * np.sin(h)
    return row


class OnAxle(SteeredBase):
    """A base with an axle that nothing steers: its pose is driven by Kanayama's law, as a differential drive's."""

    twist_names = DifferentialDrive.twist_names
    columns = DifferentialDrive.columns
    gain_names = DifferentialDrive.gain_names
    linear_errors = staticmethod(DifferentialDrive.linear_errors)
    largest_gain = staticmethod(DifferentialDrive.largest_gain)


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
    gain_names = HolonomicBase.gain_names
    sideways = True
    linear_errors = staticmethod(HolonomicBase.linear_errors)
    largest_gain = staticmethod(HolonomicBase.largest_gain)


class Casters(Swerve):
    """Powered casters: wheels behind their swivels, or a pair behind a turret, so that the body moves freely."""

    kind = "casters"
    words = "powered casters"
    body = FREE
    pose_energy = staticmethod(HolonomicBase.pose_energy)
    pose_weights = staticmethod(HolonomicBase.pose_weights)


STEERED_KINDS: tuple[type[SteeredBase], ...] = (
    CarLike, Tricycle, Articulated, CarWithTrailer, DriveWithTrailer, Swerve, Casters,
)  # fmt: skip

"""The base, as all kinds share it: how wheels roll, what that forbids, and the motions that are left.

Frames: the *root* link's frame at rest (z up), and the *control frame* of the base: on the floor, at the middle of the
drive axle (holonomic: at the centroid of the wheels), x along the rolling direction (the one nearer the root's x), y
to the left. A wheel at (x, y) there, of radius r, rolls along the unit vector d. Its centre moves with

    c = (vx - y w, vy + x w)

A plain wheel holds the floor in both directions: `d . c = sign r thetadot` and nothing across. A wheel with rollers
slides freely across the axis of the roller on the floor, at the angle `roller` from d, and holds it along that axis a:

    a . c = sign r thetadot (a . d)        thetadot = sign (a . c) / (r cos roller)

`sign` is +1 when a positive joint velocity rolls the wheel along d. Rollers at 0 are an omni wheel's, at 45 degrees a
mecanum wheel's.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import ClassVar, NamedTuple, Self

import numpy as np

from ...elementary import cos, cos_sin
from ...elementary.matrices import product
from ...signals import Array


@dataclass(frozen=True)
class Wheel:
    """A drive wheel."""

    joint: str  # name of its joint
    radius: float  # rolling radius [m]
    sign: float  # +1 if positive joint velocity rolls it along its heading, else -1
    y: float  # lateral offset of the contact point in the control frame [m], positive to the left
    x: float = 0.0  # longitudinal offset [m]
    heading: float = 0.0  # rolling direction in the control frame, counterclockwise from x [rad]
    # angle from the rolling direction to the axis of the roller on the floor, counterclockwise seen from above [rad];
    # None for a plain wheel
    roller: float | None = None
    pivot: int = -1  # number of the pivot that carries it, in whose frame it is placed; -1 for the base's body
    driven: bool = True  # whether a motor drives it
    grips: bool = True  # whether it holds the floor sideways; not one of several axles of a trailer, which must slide

    @property
    def grip(self) -> Array:
        """(3,) row on the control frame's `(vx, vy, w)`: the rim's speed `sign r thetadot` that it imposes [m/s]."""
        roller = self.roller or 0.0
        a = cos_sin(self.heading + roller)
        return np.array([a[0], a[1], a[1] * self.x - a[0] * self.y]) / cos(roller)


class LinearErrors(NamedTuple):
    """The pose error e for small errors, under a law: `edot = rates e + by_velocity dnu`, `dalpha = command e`."""

    rates: Array  # (3, 3); of a base that steers its angles are further errors
    by_velocity: Array  # (3, nb) effect of the base velocity
    command: Array  # (nb, 3) what the law answers


class PoseEnergy(NamedTuple):
    """Lyapunov function V1 of a pose error under a law, `V1dot = decay + coupling`; each (k,)."""

    value: Array  # v1
    decay: Array  # its derivative where the base moves as commanded
    coupling: Array  # what `z = alpha - velocity` adds


@dataclass(frozen=True, eq=False)
class Base:
    """A mobile base and how it can move; a kind of base is a child, in a module with the law that drives it.

    Attributes:
        kind: Its name, a key of `KINDS`.
        words: All of its kind in a sentence.
        twist_names: Names of the velocities that a reference has: `v`, or `vx`, `vy`, in the control frame [m/s], `w`
            to the left [rad/s].
        columns: Which of the control frame's `(vx, vy, w)` those are.
        gain_names: Fields of `Kinematic` with the gains of its law.
        sideways: Whether it moves to the side, too: its twist is `(vx, vy, w)`, else `(v, w)`.
        two_sided: Whether its wheels stand on a left and a right side, each of one rim speed.
        scrubs: Whether its wheels slide over the floor where it turns: dry friction opposes that.
        wheels: Drive wheels, left before right. A holonomic base without any is driven by forces on its frame.
        track: Lateral distance between the contact points of the drive wheels [m]; 0 for a fixed arm. Of a skid-steer
            base the effective one.
        frame: (3,) control frame `(x, y, heading)` in the root link's frame [m, m, rad].
        floor: Height of the floor in the root link's frame [m].
        casters: Joints of casters, locked at rest.
        suspensions: Joints that hold the drive wheels, locked at rest.
        parked: Other joints of wheels (rollers, wheels of a base that is taken as fixed), locked at rest.
        turning: Dry friction of its wheels against turning [N m].
    """

    kind: ClassVar[str]
    words: ClassVar[str]
    twist_names: ClassVar[tuple[str, ...]]
    columns: ClassVar[list[int]]
    gain_names: ClassVar[tuple[str, ...]]
    sideways: ClassVar[bool] = False
    two_sided: ClassVar[bool] = False
    scrubs: ClassVar[bool] = False

    wheels: tuple[Wheel, ...] = ()
    track: float = 0.0
    frame: Array = field(default_factory=lambda: np.zeros(3))
    floor: float = 0.0
    casters: tuple[str, ...] = ()
    suspensions: tuple[str, ...] = ()
    parked: tuple[str, ...] = ()
    turning: float = 0.0

    # -- the law that drives it -------------------------------------------------------------------------------------

    @staticmethod
    def linear_errors(v_ref: Array, gains: Array) -> LinearErrors:
        """The pose error under the law for small errors.

        Args:
            v_ref: (nb,) reference velocity [m/s, rad/s].
            gains: Those of the law.
        """
        raise NotImplementedError

    @staticmethod
    def pose_energy(error: Array, z: Array, v_ref: Array, gains: Array) -> PoseEnergy | None:
        """Lyapunov function of the pose error under the law, None where these gains, or this kind, have none.

        Args:
            error: (k, 3) pose error in the base frame [m, m, rad].
            z: (k, nb) command minus velocity [m/s, rad/s].
            v_ref: (k, nb) reference velocity [m/s, rad/s].
            gains: Those of the law.
        """
        return None

    @staticmethod
    def pose_weights(gains: Array) -> Array | None:
        """Second derivatives of `pose_energy` along what each velocity drives, at no error, (nb,); None without one."""
        return None

    @staticmethod
    def largest_gain(gains: Array, speed: float) -> float:
        """Largest factor from a pose error to the command at a reference speed [m/s]."""
        raise NotImplementedError

    @classmethod
    def per_velocity(cls, speed: float, yaw_rate: float) -> list[float]:
        """A number for translation and one for turning as one for every velocity of a reference."""
        return [yaw_rate if name == "w" else speed for name in cls.twist_names]

    @classmethod
    def per_base_velocity(cls, speed: float, yaw_rate: float, count: int) -> list[float]:
        """Likewise as one for each of the `count` base velocities."""
        return cls.per_velocity(speed, yaw_rate)

    @property
    def velocity_names(self) -> tuple[str, ...]:
        """Names of the nb base velocities: the twist's, or others of a base that steers."""
        return self.twist_names

    @property
    def driven(self) -> tuple[str, ...]:
        """Its joints with motors."""
        return tuple(wheel.joint for wheel in self.wheels)

    @property
    def joints(self) -> tuple[str, ...]:
        """Its joints that move, none of them the arm's: those of its wheels, and what they steer or swivel on."""
        return tuple(wheel.joint for wheel in self.wheels) + self.shape

    @property
    def shape(self) -> tuple[str, ...]:
        """Joints whose angles say how it may move: steering, casters, hitches; none where T is constant."""
        return ()

    def with_radii(self, factors: Mapping[str, float]) -> Self:
        """A copy on wheels whose radii are other by a factor, every wheel's by its joint."""
        return replace(self, wheels=tuple(replace(w, radius=w.radius * factors[w.joint]) for w in self.wheels))

    # -- its maps -----------------------------------------------------------------------------------------------------

    def carriers(self, pose: Sequence[float], angles: Sequence[float]) -> list[Sequence[float]]:
        """Where its body and then what every pivot carries stand, `(x, y, heading)` each [m, m, rad].

        Args:
            pose: (3,) of the control frame.
            angles: Of the joints of `shape` [rad].
        """
        return [pose]

    @property
    def root_size(self) -> int:
        """Number of velocities of the model's root joint: 3 of a planar one where the base moves, else 0."""
        return 3 if self.columns else 0

    @property
    def pushes(self) -> tuple[str, ...]:
        """Names of the forces along its own axes that drive it in the place of wheels; mostly none."""
        return ()

    @property
    def locked(self) -> tuple[str, ...]:
        """All its joints that stand still."""
        return self.casters + self.suspensions + self.parked

    @cached_property
    def to_control(self) -> Array:
        """(3, 3) map from the root's planar velocity `(vx, vy, w)` to the control frame's, each in its own axes."""
        x, y, psi = self.frame
        c, s = cos_sin(psi)
        return np.array([[c, s, s * x - c * y], [-s, c, c * x + s * y], [0.0, 0.0, 1.0]])

    @cached_property
    def root_map(self) -> Array:
        """(3, nb) map from the base velocity to the root's planar velocity; an axle at x = a gives vy = -a w."""
        x, y, psi = self.frame
        c, s = cos_sin(psi)
        return np.array([[c, -s, y], [s, c, -x], [0.0, 0.0, 1.0]])[:, self.columns]

    @property
    def rolling(self) -> tuple[Wheel, ...]:
        """The drive wheels where they would have to be to roll as they do: where they are, unless they skid."""
        return self.wheels

    @cached_property
    def wheel_map(self) -> Array:
        """(number of wheels, nb) map from the base velocity to the wheels' joint velocities."""
        rows = [w.sign / w.radius * w.grip[self.columns] for w in self.rolling]
        return np.array(rows).reshape(len(self.wheels), len(self.velocity_names))

    @cached_property
    def slip_rows(self) -> Array:
        """(3 - nb, 3) rows on the root's planar velocity that vanish: no motion along y for a differential drive."""
        return self.to_control[[i for i in range(3) if i not in self.columns]] if self.columns else np.zeros((0, 3))

    @cached_property
    def rolling_rows(self) -> Array:
        """(number of wheels, 3) speed of each wheel's rim from the root's planar velocity."""
        return np.array([product(w.grip, self.to_control) for w in self.rolling]).reshape(-1, 3)


class Fixed(Base):
    """A base that stands still, and has no law."""

    kind = "fixed"
    words = "fixed arms"
    twist_names = ()
    columns: ClassVar[list[int]] = []
    gain_names = ()

    @staticmethod
    def linear_errors(v_ref: Array, gains: Array) -> LinearErrors:
        """See `Base.linear_errors`: there is no pose."""
        return LinearErrors(np.zeros((0, 0)), np.zeros((0, 0)), np.zeros((0, 0)))

    @staticmethod
    def pose_energy(error: Array, z: Array, v_ref: Array, gains: Array) -> PoseEnergy | None:
        """See `Base.pose_energy`: there is no pose."""
        return PoseEnergy(*np.zeros((3, len(z))))

    @staticmethod
    def pose_weights(gains: Array) -> Array | None:
        """See `Base.pose_weights`: there is no pose."""
        return np.zeros(0)

    @staticmethod
    def largest_gain(gains: Array, speed: float) -> float:
        """See `Base.largest_gain`: there is no command."""
        return 0.0

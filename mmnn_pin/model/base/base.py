"""The mobile base: how its wheels roll, what that forbids, and the motions that are left.

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

import math
from dataclasses import dataclass, field
from functools import cached_property
from typing import Literal, get_args

import numpy as np

from mmnn_pin.errors import RobotError
from mmnn_pin.signals import Array

from ..urdf.finding import Finding

Kind = Literal["differential_drive", "holonomic", "fixed"]
KINDS: tuple[str, ...] = get_args(Kind)


@dataclass(frozen=True)
class Reading:
    """One way to read the geometry of a base.

    Attributes:
        kind: What the base would be.
        reasons: What speaks for it.
        objections: What speaks against it.
    """

    kind: str
    reasons: tuple[str, ...] = ()
    objections: tuple[str, ...] = ()

    def __str__(self) -> str:
        parts = [f"for: {', '.join(self.reasons)}"] if self.reasons else []
        parts += [f"against: {', '.join(self.objections)}"] if self.objections else []
        return f"{self.kind} ({'; '.join(parts)})" if parts else self.kind


class Undecided(RobotError):
    """Geometry and evidence do not tell what the base is.

    Attributes:
        candidates: The joints that could be wheels, each with what is known of it.
        readings: What the base could be, each with the reasons for and against it.
    """

    candidates: tuple[str, ...] = ()
    readings: tuple[Reading, ...] = ()


class Unsupported(RobotError):
    """The machine is understood, and it is none that this package can drive.

    Attributes:
        machine: What it is: `skid-steer`, `car-like`, `legged machine`, `humanoid`, `drone`, ...
    """

    machine: str = ""


@dataclass(frozen=True)
class Wheel:
    """A drive wheel.

    Attributes:
        joint: Name of its joint.
        radius: Rolling radius [m].
        sign: +1 if positive joint velocity rolls it along its heading, else -1.
        y: Lateral offset of the contact point in the control frame [m], positive to the left.
        x: Longitudinal offset [m].
        heading: Rolling direction in the control frame, counterclockwise from x [rad].
        roller: Angle from the rolling direction to the axis of the roller on the floor, counterclockwise seen from
            above [rad]; None for a plain wheel.
    """

    joint: str
    radius: float
    sign: float
    y: float
    x: float = 0.0
    heading: float = 0.0
    roller: float | None = None

    @property
    def grip(self) -> Array:
        """(3,) row on the control frame's `(vx, vy, w)`: the rim's speed `sign r thetadot` that it imposes [m/s]."""
        roller = self.roller or 0.0
        a = math.cos(self.heading + roller), math.sin(self.heading + roller)
        return np.array([a[0], a[1], a[1] * self.x - a[0] * self.y]) / math.cos(roller)


@dataclass(frozen=True, eq=False)
class Base:
    """What carries the arm, and how it can move.

    Attributes:
        kind: `differential_drive`, `holonomic` or `fixed`.
        wheels: Drive wheels, left before right. A holonomic base without any is driven by forces on its frame.
        track: Lateral distance between the contact points of the drive wheels [m]; 0 for a fixed arm.
        frame: (3,) control frame `(x, y, heading)` in the root link's frame [m, m, rad].
        floor: Height of the floor in the root link's frame [m].
        casters: Joints of casters, locked at rest.
        suspensions: Joints that hold the drive wheels, locked at rest.
        parked: Other joints of wheels (rollers, wheels of a base that is taken as fixed), locked at rest.
    """

    kind: Kind
    wheels: tuple[Wheel, ...] = ()
    track: float = 0.0
    frame: Array = field(default_factory=lambda: np.zeros(3))
    floor: float = 0.0
    casters: tuple[str, ...] = ()
    suspensions: tuple[str, ...] = ()
    parked: tuple[str, ...] = ()

    @property
    def velocity_names(self) -> tuple[str, ...]:
        """Names of the nb base velocities: `v`, or `vx`, `vy`, in the control frame [m/s], `w` to the left [rad/s]."""
        return {"fixed": (), "differential_drive": ("v", "w"), "holonomic": ("vx", "vy", "w")}[self.kind]

    @property
    def locked(self) -> tuple[str, ...]:
        """All its joints that stand still."""
        return self.casters + self.suspensions + self.parked

    @property
    def axle_x(self) -> float:
        """Where the control frame lies along the root link's x [m]."""
        return float(self.frame[0])

    @property
    def columns(self) -> list[int]:
        """Which of the control frame's `(vx, vy, w)` the base velocities are."""
        return {"fixed": [], "differential_drive": [0, 2], "holonomic": [0, 1, 2]}[self.kind]

    @cached_property
    def to_control(self) -> Array:
        """(3, 3) map from the root's planar velocity `(vx, vy, w)` to the control frame's, each in its own axes."""
        x, y, psi = self.frame
        c, s = math.cos(psi), math.sin(psi)
        return np.array([[c, s, s * x - c * y], [-s, c, c * x + s * y], [0.0, 0.0, 1.0]])

    @cached_property
    def root_map(self) -> Array:
        """(3, nb) map from the base velocity to the root's planar velocity; an axle at x = a gives vy = -a w."""
        x, y, psi = self.frame
        c, s = math.cos(psi), math.sin(psi)
        return np.array([[c, -s, y], [s, c, -x], [0.0, 0.0, 1.0]])[:, self.columns]

    @cached_property
    def wheel_map(self) -> Array:
        """(number of wheels, nb) map from the base velocity to the wheels' joint velocities."""
        rows = [w.sign / w.radius * w.grip[self.columns] for w in self.wheels]
        return np.array(rows).reshape(len(self.wheels), len(self.velocity_names))

    @cached_property
    def slip_rows(self) -> Array:
        """(k, 3) rows on the root's planar velocity that vanish: no motion along y for a differential drive."""
        return self.to_control[1:2] if self.kind == "differential_drive" else np.zeros((0, 3))

    @cached_property
    def rolling_rows(self) -> Array:
        """(number of wheels, 3) speed of each wheel's rim from the root's planar velocity."""
        return np.array([w.grip @ self.to_control for w in self.wheels]).reshape(-1, 3)


@dataclass(frozen=True, eq=False)
class Understood:
    """A base, and what was noticed on the way.

    Attributes:
        base: The base.
        findings: Warnings and notes.
    """

    base: Base
    findings: tuple[Finding, ...] = ()

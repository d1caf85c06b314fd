"""The floor of the contact plant as settings, and what touches it: drive wheels, casters, skids.

The floor has one friction, patches of another, and a stiffness under the casters. Drive wheels come from the base,
casters and skids from the geometry at rest. Every foot is a sphere, which touches a plane in one point: with a
cylinder's two points a turning wheel scrubs. Casters stand level with the wheels, as our model has them.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
import pinocchio as pin

from ...elementary import cos_sin
from ...errors import ConfigError, RobotError
from ...model.base.overrides import folders_of
from ...model.base.steered import SteeredBase
from ...model.robot import Robot
from ...model.urdf.reading import parse
from ...model.urdf.shapes import AtRest, Shape
from ...settings import Settings
from ...signals import Array

NEAR = 0.1  # a caster's lowest point may be off the floor by this fraction of a wheel's radius
CASTER_RADIUS = 0.02  # of the sphere that stands for a caster [m]


class Patch(Settings, frozen=True):
    """A rectangle of the floor with another friction.

    Args:
        friction: Coulomb coefficient between wheel and floor.
        x: From, to [m]; None for all.
        y: From, to [m]; None for all.

    Raises:
        ConfigError: A negative or non-finite coefficient, or an interval that is none.
    """

    friction: float
    x: tuple[float, float] | None = None
    y: tuple[float, float] | None = None

    def __post_init__(self) -> None:
        require_friction(self.friction, "contact.patches.friction")
        for name in ("x", "y"):
            interval = getattr(self, name)
            if interval is not None and not -math.inf < interval[0] < interval[1] < math.inf:
                raise ConfigError(f"{interval}", fix="give from < to, both finite", key=f"contact.patches.{name}")

    def holds(self, x: float, y: float) -> bool:
        """Whether a point is on it."""
        return within(x, self.x) and within(y, self.y)


class Contact(Settings, frozen=True):
    """Settings of the contact plant.

    Args:
        friction: Coulomb coefficient between wheels and floor; casters have none.
        patches: Places with another friction; the last one that holds a wheel counts.
        step: Longest step of the engine [s]; the plant's step is divided until it is short enough.
        casters: "rigid" as the wheels are, or "soft" (they leave more of the weight to the wheels).

    Raises:
        ConfigError: A negative or non-finite coefficient, or a step that is not in (0, 0.01] s.
    """

    friction: float = 1.0
    patches: tuple[Patch, ...] = ()
    step: float = 0.0005
    casters: Literal["rigid", "soft"] = "rigid"

    def __post_init__(self) -> None:
        require_friction(self.friction, "contact.friction")
        if not 0 < self.step <= 0.01:
            raise ConfigError(f"{self.step} s", fix="use a step in (0, 0.01] s", key="contact.step")

    def at(self, x: float, y: float) -> float:
        """Friction at a point of the floor."""
        found = [patch.friction for patch in self.patches if patch.holds(x, y)]
        return found[-1] if found else self.friction


def within(value: float, interval: tuple[float, float] | None) -> bool:
    """Whether a number lies in an interval; None is all numbers."""
    return interval is None or interval[0] <= value <= interval[1]


def require_friction(value: float, key: str) -> None:
    """Refuse a coefficient that is negative or not finite (`ConfigError`)."""
    if not (math.isfinite(value) and value >= 0):
        raise ConfigError(f"{value} is negative or not finite", fix="use a finite number >= 0", key=key)


@dataclass(frozen=True, eq=False)
class Foot:
    """A sphere that touches the floor."""

    joint: int  # index of the joint in Pinocchio's model whose body carries it
    centre: Array  # (3,) in that joint's frame [m]
    radius: float  # [m]


@dataclass(frozen=True)
class Feet:
    """Drive wheels in the order of the base, and what else touches the floor."""

    wheels: tuple[Foot, ...]
    casters: tuple[Foot, ...]


def feet_of(robot: Robot) -> Feet:
    """The feet of a mobile robot; none of a fixed arm.

    Raises:
        RobotError: A base without wheels, whose wheels do not turn, or one that stands on its two wheels alone.
    """
    if not robot.dimensions.base:
        return Feet((), ())
    require_wheels(robot)
    data = robot.model.createData()
    pin.framesForwardKinematics(robot.model, data, robot.configuration(at_origin(robot)))
    wheels = tuple(wheel_feet(robot, data))
    casters = tuple(caster_feet(robot, data))
    require_standing(robot, data, wheels, casters)
    return Feet(wheels, casters)


def require_wheels(robot: Robot) -> None:
    """Refuse a base that does not stand on wheels that turn (`RobotError`)."""
    why = "" if robot.base.wheels else "it has wheels only, no base that is pushed"
    if isinstance(robot.base, SteeredBase):
        carrying = {wheel.pivot for wheel in robot.base.wheels}
        stiff = [pivot.joint for k, pivot in enumerate(robot.base.pivots) if k not in carrying]
        why = f"what '{stiff[0]}' steers has no joint to roll about" if stiff else ""
    if why:
        what = f"the contact plant cannot carry the {robot.base.kind} base of '{robot.name}'"
        raise RobotError(what, why=why, fix="use the ideal one, --set plant=ideal", file=robot.path)


def on_rollers(robot: Robot) -> bool:
    """Whether a base stands on wheels with rollers: they only hold it up, its forces act on its frame."""
    return robot.base.sideways and not robot.steers and robot.dimensions.base > 0


def at_origin(robot: Robot) -> Array:
    """(nv,) position at rest that puts the root link's frame into the world's."""
    position = robot.neutral_position()
    position[:3] = robot.frame
    return position


def wheel_feet(robot: Robot, data: pin.Data) -> Iterator[Foot]:
    """One foot per drive wheel, its centre on the wheel's axis."""
    carriers = robot.base.carriers(tuple(robot.frame.tolist()), robot.rest[robot.shape_index].tolist())
    for wheel in robot.base.wheels:
        x, y, psi = carriers[wheel.pivot + 1]
        c, s = cos_sin(psi)
        j = robot.model.getJointId(wheel.joint)
        hub, axis = data.oMi[j].translation, data.oMi[j].rotation @ turning_axis(data, j)
        middle = np.array([x + c * wheel.x - s * wheel.y, y + s * wheel.x + c * wheel.y, hub[2]])
        yield Foot(j, data.oMi[j].actInv(hub + axis * ((middle - hub) @ axis)), wheel.radius)


def turning_axis(data: pin.Data, joint: int) -> Array:
    """(3,) axis of a joint in its own frame: direction of travel of a prismatic one."""
    S = np.array(data.joints[joint].S).reshape(6)
    return S[3:] if np.any(S[3:]) else S[:3]


def caster_feet(robot: Robot, data: pin.Data) -> Iterator[Foot]:
    """One foot under every link of the base that reaches the floor, wheels apart."""
    model, floor = robot.model, robot.base.floor
    rest = AtRest(parse(robot.urdf.encode(), robot.path), folders_of(robot.path, robot.overrides))
    near = NEAR * min(wheel.radius for wheel in robot.base.wheels)
    casters = {model.getJointId(name) for name in robot.base.casters}
    casters -= {model.parents[j] for j in casters}  # a fork is no caster, the wheel on it is
    for frame in model.frames:
        j = frame.parentJoint
        if frame.type != pin.FrameType.BODY or not is_level(robot, j):
            continue
        low = lowest_of(rest, frame, data.oMi[j])
        if low is None and j in casters:  # a caster without a shape stands under its hub
            low = np.append(data.oMi[j].translation[:2], floor)
        if low is not None and abs(low[2] - floor) <= near:
            centre = np.array([low[0], low[1], floor + CASTER_RADIUS])
            yield Foot(j, data.oMi[j].actInv(centre), CASTER_RADIUS)


def is_level(robot: Robot, joint: int) -> bool:
    """Whether a body stays as high as the root link: every joint between them is locked, or a pivot of the base."""
    while joint > 1:
        if robot.model.names[joint] not in (*robot.arm.locked, *robot.base.shape):
            return False
        joint = robot.model.parents[joint]
    return joint == 1


def lowest_of(rest: AtRest, frame: pin.Frame, joint: pin.SE3) -> Array | None:
    """(3,) lowest point of a link in the root frame; None for one without a shape that can be read.

    Args:
        rest: Shapes of all links, where the file has them at rest.
        frame: The link.
        joint: Where the robot locks the joint that carries it, which may be elsewhere.
    """
    element = rest.document.links.get(frame.name)
    if element is None:
        return None
    motion = (joint * frame.placement).homogeneous @ np.linalg.inv(rest.placements[frame.name])
    shapes = rest.shapes(frame.name, "visual" if element.find("collision") is None else "collision")
    points = [lowest(shape, motion) for shape in shapes if shape.kind != "mesh" or len(shape.points)]
    return min(points, key=lambda point: float(point[2]), default=None)


def lowest(shape: Shape, motion: Array) -> Array:
    """(3,) lowest point of a moved shape, below its middle where there are several [m]."""
    if shape.kind != "mesh":
        moved = replace(shape, pose=motion @ shape.pose)
        return np.append(moved.pose[:2, 3], moved.lowest)
    points = shape.points @ motion[:3, :3].T + motion[:3, 3]
    bottom = points[:, 2].min()
    return np.append(points[points[:, 2] < bottom + 1e-3, :2].mean(axis=0), bottom)


def require_standing(robot: Robot, data: pin.Data, wheels: tuple[Foot, ...], casters: tuple[Foot, ...]) -> None:
    """Refuse a base that would fall over: all its feet on one line (`RobotError`)."""
    places = np.array([data.oMi[foot.joint].act(foot.centre)[:2] for foot in (*wheels, *casters)])
    if np.linalg.matrix_rank(places - places[0], tol=1e-3) < 2:
        raise RobotError(
            f"nothing but the drive wheels of '{robot.name}' touches the floor",
            why=f"no caster reaches it at height {robot.base.floor:.3g} m, so the base would fall over",
            fix="give a link that slides on the floor a <collision>, or use the ideal one, --set plant=ideal",
            file=robot.path,
        )

"""A robot's bodies as triangles in colours of what was understood of them: for the view and for pictures."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from ...model.arm import WHY, slaves_of
from ...model.base.steered import SteeredBase
from ...model.robot import Robot
from ...model.urdf.reading import parse
from ...signals import Array
from .files import Blob
from .replay.motion import ReplayTree
from .replay.shapes import Shapes


class Role(NamedTuple):
    """The role of a joint: words for a legend, and the colour of the parts that it carries."""

    name: str
    color: str


BODY = Role("body", "#aeb4bd")
LEFT, RIGHT = Role("left wheels", "#0072b2"), Role("right wheels", "#56b4e9")
DRIVEN, ROLLING = Role("driven wheels", "#0072b2"), Role("wheels without a motor", "#56b4e9")
STEERING, CASTER = Role("steering", "#cc79a7"), Role("casters, hitches, suspensions", "#6b4c9a")
ARM, FOLLOWS = Role("arm", "#e69f00"), Role("follow another joint", "#d55e00")
HEAD, JAW = Role("head", "#f0e442"), Role("jaws", "#009e73")
LOCKED = Role("locked", "#6a3d2a")
ROLES = (BODY, LEFT, RIGHT, DRIVEN, ROLLING, STEERING, CASTER, ARM, FOLLOWS, HEAD, JAW, LOCKED)
STILL = {WHY["head"]: HEAD, WHY["jaw"]: JAW}  # the others that stand still are merely locked
ROUND = 24  # edges of a circle


def roles_of(robot: Robot) -> dict[str, Role]:
    """Roles of all moving joints of a robot, by name."""
    base, arm = robot.base, robot.arm
    found = {name: STILL.get(why, LOCKED) for name, why in arm.reasons.items()}
    found |= dict.fromkeys(arm.slaves, FOLLOWS)
    masters = slaves_of(parse(robot.urdf.encode(), robot.path))
    for name in masters.keys() & arm.reasons.keys():
        if arm.reasons[name] not in WHY.values():  # it stands still as its master does
            found[name] = found.get(masters[name].master, LOCKED)
    found |= dict.fromkeys(robot.joint_names, ARM)
    found |= dict.fromkeys((*base.casters, *base.suspensions), CASTER)
    if isinstance(base, SteeredBase):
        found |= {pivot.joint: CASTER if pivot.role == "passive" else STEERING for pivot in base.pivots}
    for wheel in base.wheels:
        sided = base.track and not robot.steers and abs(np.sin(wheel.heading)) < 0.1
        side = (LEFT if wheel.y > 0 else RIGHT) if sided else DRIVEN
        found[wheel.joint] = side if wheel.driven else ROLLING
    return found


@dataclass(frozen=True, eq=False)
class Solid:
    """A shape of a body."""

    joint: str  # name of the joint that carries it, "" for the robot's body
    frame: str  # link whose frame it is placed in
    place: Array  # (4, 4) its placement there
    vertices: Array  # (k, 3) [m]
    triangles: NDArray[np.int64]  # (m, 3) indices of vertices
    role: Role  # what its joint is


def solids_of(robot: Robot, package_dirs: Sequence[str | Path] = ()) -> tuple[list[Solid], tuple[str, ...]]:
    """The shapes of a robot, and a line for each that is not as its file says.

    Args:
        robot: The robot.
        package_dirs: Folders to look for meshes in before those that it knows.
    """
    shapes = Shapes(Blob(), package_dirs)
    tree = ReplayTree.of(parse(robot.urdf.encode(), robot.path))
    roles, found, made = roles_of(robot), list[Solid](), dict[int, tuple[Array, NDArray[np.int64]]]()
    for shown in shapes.visuals(robot, tree):
        joint = tree.bodies[shown["body"]].joint
        if shown["geometry"] not in made:
            made[shown["geometry"]] = triangles_of(shapes, shown["geometry"])
        name, frame = (joint.name, joint.child) if joint else ("", tree.document.root_link)
        place = np.array(shown["place"]).reshape(4, 4).T
        found.append(Solid(name, frame, place, *made[shown["geometry"]], roles.get(name, BODY)))
    return found, shapes.warnings


def triangles_of(shapes: Shapes, index: int) -> tuple[Array, NDArray[np.int64]]:
    """Vertices (k, 3) and triangles (m, 3) of a geometry."""
    from trimesh import creation

    geometry = shapes.geometries[index]
    if geometry["kind"] == "mesh":
        part = shapes.parts[index]
        return part.corner + part.step * part.grid, part.triangles.astype(np.int64)
    if geometry["kind"] == "box":
        mesh = creation.box(geometry["size"])
    elif geometry["kind"] == "cylinder":
        radius, length = geometry["size"]
        mesh = creation.cylinder(radius, length, sections=ROUND)
    else:
        mesh = creation.uv_sphere(geometry["size"][0], count=[ROUND, ROUND])
    return np.asarray(mesh.vertices, float), np.asarray(mesh.faces, np.int64)


def placements(robot: Robot, position: Array, solids: Sequence[Solid]) -> list[Array]:
    """Places (4, 4) of solids in the world, the robot at a position (nv,)."""
    data = robot.model.createData()
    pin.framesForwardKinematics(robot.model, data, robot.configuration(position))
    where = {solid.frame: data.oMf[robot.model.getFrameId(solid.frame)].homogeneous for solid in solids}
    return [where[solid.frame] @ solid.place for solid in solids]


def legend(robot: Robot, room: int = 60) -> list[tuple[Role, str]]:
    """Roles that a robot has, each with the joints that have it, as many names as there is room for."""
    from .robots import names_in

    joints = dict[Role, list[str]]()
    for name, role in roles_of(robot).items():
        joints.setdefault(role, []).append(name)
    return [(role, names_in(joints[role], room)) for role in ROLES if role in joints]

"""Where the links of a robot are: one transform per joint over time, for the tree of frames that viewers draw."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from ....model.robot import Robot
from ....model.urdf.document import Document, Joint
from ....model.urdf.parsing import parse
from ....recording.recording import Recording, recorded_position
from ....signals import Array


@dataclass(frozen=True, eq=False)
class Frame:
    """A frame in its parent's.

    Attributes:
        parent: Name of the parent frame.
        name: Name of the frame.
        translation: (N, 3) [m], or (1, 3) for one that stands still.
        rotation: (N, 4) or (1, 4) quaternion x, y, z, w.
    """

    parent: str
    name: str
    translation: Array
    rotation: Array

    @property
    def moves(self) -> bool:
        """Whether it is not the same at every sample."""
        return len(self.translation) > 1


def frames_of(recording: Recording, robot: Robot) -> list[Frame]:
    """All frames of a robot in a run, parents first; where the robot truly was, if the recording knows."""
    document = parse(robot.urdf.encode(), robot.path)
    position = dict(zip(robot.position_names, recorded_position(recording, robot).T, strict=True))
    base = base_frames(document, robot, position) if robot.layout.pose else []
    joints = (joint_frame(joint, position.get(joint.name)) for joint in document.joints.values())
    return [*base, *joints]


def world_names(document: Document) -> tuple[str, str]:
    """Names of the world's and of the base's control frame that no link has."""
    links = {document.root_link, *(joint.child for joint in document.joints.values())}
    world, control = (next(n for n in endless(name) if n not in links) for name in ("world", "control_frame"))
    return world, control


def endless(name: str) -> Iterator[str]:
    """A name, and that name with more and more underscores."""
    while True:
        yield name
        name += "_"


def base_frames(document: Document, robot: Robot, position: dict[str, Array]) -> list[Frame]:
    """The control frame in the world, and the root link in the control frame."""
    world, control = world_names(document)
    x, y, phi = (position[name] for name in ("x", "y", "phi"))
    turn = np.stack([0 * phi, 0 * phi, np.sin(phi / 2), np.cos(phi / 2)], axis=1)
    moving = Frame(world, control, np.stack([x, y, 0 * x], axis=1), turn)
    heading = Rotation.from_rotvec([[0.0, 0.0, -robot.frame[2]]])
    root = heading.apply(-np.array([[robot.frame[0], robot.frame[1], robot.base.floor]]))
    return [moving, Frame(control, document.root_link, root, heading.as_quat())]


def joint_frame(joint: Joint, position: Array | None) -> Frame:
    """The link that a joint carries, at its positions (N,); None or a joint that stays where it is stands still.

    Where a position is not finite, the frame is NaN.
    """
    values = np.zeros(1) if position is None else position
    values = values[:1] if len(values) and np.all(values == values[0]) else values
    known = np.isfinite(values)
    along = np.where(known, values, 0.0)[:, None] * joint.axis
    placed, origin = Rotation.from_matrix(joint.origin[:3, :3]), joint.origin[:3, 3]
    slides = joint.type == "prismatic"
    translation = origin + slides * placed.apply(along)
    rotation = (placed * Rotation.from_rotvec(0.0 * along if slides else along)).as_quat()
    translation[~known] = rotation[~known] = np.nan
    return Frame(joint.parent, joint.child, translation, rotation)

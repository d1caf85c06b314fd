"""URDFs written piece by piece: links, joints, and differential drives of any geometry."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pinocchio as pin

from mmnn_pin.model import Robot
from mmnn_pin.model.base.overrides import Overrides
from mmnn_pin.model.loading import build
from mmnn_pin.model.urdf.reading import parse

UP = np.array([0.0, 0.0, 1.0])
SPHERE = '<sphere radius="{r!r}"/>'
LYING_CYLINDER = '<origin xyz="0 0 0" rpy="1.5707963267948966 0 0"/>'
CYLINDER = '<cylinder radius="{r!r}" length="0.03"/>'


def words(values) -> str:
    return " ".join(repr(float(v)) for v in np.atleast_1d(values))


def origin(R=None, p=(0, 0, 0)) -> str:
    return f'<origin xyz="{words(p)}" rpy="{words(pin.rpy.matrixToRpy(np.eye(3) if R is None else R))}"/>'


def link(name: str, mass: float = 1.0, inertia: float = 0.02, shape: str = "", at: str = "", tag="collision") -> str:
    body = f"<{tag}>{at}<geometry>{shape}</geometry></{tag}>" if shape else ""
    tensor = f'<inertia ixx="{inertia}" iyy="{inertia}" izz="{inertia}" ixy="0" ixz="0" iyz="0"/>'
    inertial = f'<inertial><mass value="{mass}"/>{tensor}</inertial>' if mass else ""
    return f'<link name="{name}">{inertial}{body}</link>\n'


def joint(name, kind, parent, child, R=None, p=(0, 0, 0), axis=(0, 1, 0), more="") -> str:
    ends = f'<parent link="{parent}"/><child link="{child}"/>'
    return f'<joint name="{name}" type="{kind}">{ends}{origin(R, p)}<axis xyz="{words(axis)}"/>{more}</joint>\n'


LIMIT = '<limit lower="{}" upper="{}" effort="9" velocity="2"/>'
ARM = (
    link("upper", 2.0)
    + link("fore", 1.0)
    + joint("shoulder", "continuous", "base", "upper", p=(0.1, 0, 1), axis=(0, 0, 1))
    + joint("elbow", "revolute", "upper", "fore", p=(0.3, 0, 0), more=LIMIT.format(0.2, 2))
)


@dataclass
class Drive:
    """A differential drive: the control frame in the root frame, wheels (left, right), and how each is written."""

    frame: tuple = (0.0, 0.0, 0.0)  # x, y, heading
    floor: float = 0.0
    track: float = 0.4
    radii: tuple = (0.1, 0.1)
    flips: tuple = (1, 1)
    frames: tuple = (np.eye(3), np.eye(3))  # orientation of the joints' frames in the control frame
    inset: float = 0.0  # how far inside its wheel each joint sits on the axle
    shape: str = CYLINDER
    names: tuple = ("left", "right")
    tag: str = "collision"

    @property
    def R(self) -> np.ndarray:
        return pin.rpy.rpyToMatrix(0.0, 0.0, self.frame[2])

    def hub(self, i: int) -> np.ndarray:
        side = (self.track / 2 - self.inset) * (1, -1)[i]
        return np.array([self.frame[0], self.frame[1], self.floor + self.radii[i]]) + self.R @ [0, side, 0]

    def centre(self, i: int) -> np.ndarray:
        """Of a wheel, in the joint's frame."""
        return self.frames[i].T @ [0, self.inset * (1, -1)[i], 0]

    def centres(self, robot: Robot, data) -> list[np.ndarray]:
        """Of both wheels, in the world."""
        frames = [robot.model.getFrameId(f"{name}_link", pin.FrameType.BODY) for name in self.names]
        return [data.oMf[frame].act(self.centre(i)) for i, frame in enumerate(frames)]

    def urdf(self, more: str = ARM) -> str:
        text = link("base", 20.0, 0.8, '<box size="0.3 0.2 0.1"/>', origin(p=(0, 0, self.floor + 0.2)))
        for i, name in enumerate(self.names):
            axle = self.frames[i].T @ np.array([0, self.flips[i], 0])  # the axle in the joint's frame
            lying = pin.Quaternion.FromTwoVectors(UP, axle).matrix()  # a cylinder stands along z
            text += link(
                f"{name}_link", 1.5, 0.02, self.shape.format(r=self.radii[i]), origin(lying, self.centre(i)), self.tag
            )
            R = self.R @ self.frames[i]
            text += joint(name, "continuous", "base", f"{name}_link", R, self.hub(i), axle)
        return f'<robot name="r">{text}{more}</robot>'


def robot_of(text: str, path: str | Path = "robot.urdf", **said) -> Robot:
    return build(parse(text.encode(), path), Overrides(**said))


def rotation(roll: float, pitch: float, yaw: float) -> np.ndarray:
    return pin.rpy.rpyToMatrix(roll, pitch, yaw)


def moving(robot: Robot, position, nu):
    """Pinocchio's data at a state that T permits."""
    data = robot.model.createData()
    pin.forwardKinematics(robot.model, data, robot.configuration(position), robot.T @ nu)
    pin.updateFramePlacements(robot.model, data)
    return data


def random_state(robot: Robot, seed: int = 0):
    rng = np.random.default_rng(seed)
    return rng.uniform(-2, 2, robot.model.nv), rng.uniform(-2, 2, robot.dimensions.dof)

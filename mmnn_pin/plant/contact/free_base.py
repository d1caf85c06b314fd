"""The free base of the contact plant: MuJoCo's free joint and the planar control frame of our model.

MuJoCo keeps the root link's position and quaternion (w, x, y, z) and its linear velocity in the world's axes, its
angular velocity in its own: `v_mj = diag(R, I) v_pin`.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from ...model.robot import Robot
from ...signals import Array

TOUCH = 1e-7  # how far the feet start in the floor, so that contacts exist from the first step on [m]


@dataclass(frozen=True, eq=False)
class BaseMotion:
    """Where the control frame is and how it moves.

    Attributes:
        pose: (3,) in the world, heading in (-pi, pi] [m, m, rad].
        velocity: (3,) forward, to the left, and about the vertical [m/s, m/s, rad/s].
        rotation: (3, 3) axes of the root link in the world.
        lever: (3,) from the root link's origin to that of the control frame, in the world's axes [m].
    """

    pose: Array
    velocity: Array
    rotation: Array
    lever: Array


class FreeBase:
    """Converts between the free joint's coordinates and the control frame's.

    Args:
        robot: A mobile robot.
    """

    def __init__(self, robot: Robot) -> None:
        x, y, self.psi = robot.frame
        self.origin = np.array([x, y, robot.base.floor])  # of the control frame, in the root link
        self.from_control = np.linalg.inv(robot.base.to_control)

    def place(self, pose: Array, velocity: Array, qpos: Array, qvel: Array) -> None:
        """Write a level base on the floor into MuJoCo's state.

        Args:
            pose: (3,) of the control frame.
            velocity: (3,) planar velocity of the root link in its own axes, as Pinocchio's planar joint has it.
            qpos: (7,) written.
            qvel: (6,) written.
        """
        heading = pose[2] - self.psi
        c, s = math.cos(heading), math.sin(heading)
        x, y, _ = self.origin
        qpos[:3] = pose[0] - c * x + s * y, pose[1] - s * x - c * y, -TOUCH
        qpos[3:] = math.cos(heading / 2), 0.0, 0.0, math.sin(heading / 2)
        vx, vy, w = velocity
        qvel[:] = c * vx - s * vy, s * vx + c * vy, 0.0, 0.0, 0.0, w

    def motion(self, qpos: Array, qvel: Array) -> BaseMotion:
        """The control frame's motion at MuJoCo's state (7,), (6,)."""
        R = rotation(qpos[3:])
        lever, omega = R @ self.origin, R @ qvel[3:]
        v = qvel[:3] + cross(omega, lever)
        heading = math.atan2(R[1, 0], R[0, 0]) + self.psi
        c, s = math.cos(heading), math.sin(heading)
        pose = np.array([qpos[0] + lever[0], qpos[1] + lever[1], heading])
        return BaseMotion(pose, np.array([c * v[0] + s * v[1], c * v[1] - s * v[0], omega[2]]), R, lever)


def rotation(quaternion: Array) -> Array:
    """(3, 3) rotation of a unit quaternion (w, x, y, z)."""
    w, x, y, z = quaternion
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )


def tilt(quaternion: Array) -> float:
    """Angle of the z axis of a unit quaternion (w, x, y, z) from the vertical [rad]."""
    return 2 * math.asin(min(1.0, math.hypot(quaternion[1], quaternion[2])))


def cross(a: Array, b: Array) -> Array:
    """`a x b` of two (3,); numpy's takes fifty times as long."""
    return np.array([a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]])

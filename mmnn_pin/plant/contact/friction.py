"""Friction of joints and base in MuJoCo, the same laws as in `model.reduction.friction`."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from ...model.reduction import COULOMB_SPEED
from ...model.robot import Robot
from ...signals import Array
from .free_base import BaseMotion, cross


class Friction:
    """Friction of a robot: in the joints as a damping, which MuJoCo's Euler takes implicitly, on the base as a force.

    Args:
        robot: The robot.
        moving: (k,) places of the moving joints in the velocities of our model.
        at: (k,) places of the same in MuJoCo's.
        model: MuJoCo's model, whose damping is written.
    """

    def __init__(self, robot: Robot, moving: Array, at: Array, model: Any) -> None:
        viscous = np.zeros(robot.layout.full)
        viscous[robot.arm_index] = robot.viscous[robot.layout.base :]
        self.model, self.at = model, at
        self.damping, self.dry = (robot.damping + viscous)[moving], robot.dry[moving]
        self.base = robot.viscous[: robot.layout.base]
        self.held = False
        self.has_coulomb, self.on_base = bool(self.dry[:, 0].any()), bool(self.base.any())
        model.dof_damping[at] = self.damping

    def apply(self, data: Any, motion: BaseMotion | None, hold: Array) -> None:
        """Write damping, and add the force on the base, for the next step; hold (k,) is friction of blocked joints."""
        if self.has_coulomb or hold.any() or self.held:
            self.held = bool(hold.any())
            v = data.qvel[self.at]
            slow = np.abs(v) < 1e-6 * COULOMB_SPEED
            level = hold + self.dry[:, 0] + self.dry[:, 1] * np.exp(-((v / self.dry[:, 2]) ** 2))
            ratio = np.tanh(v / COULOMB_SPEED) / np.where(slow, 1.0, v)
            self.model.dof_damping[self.at] = self.damping + level * np.where(slow, 1 / COULOMB_SPEED, ratio)
        if self.on_base and motion is not None:
            v, _, w = motion.velocity
            on_base(data, motion, -self.base[0] * v, -self.base[1] * w)

    def power(self, data: Any, motion: BaseMotion | None) -> float:
        """What friction takes at this velocity [W]."""
        lost = float(self.model.dof_damping[self.at] @ data.qvel[self.at] ** 2)
        if self.on_base and motion is not None:
            v, _, w = motion.velocity
            lost += float(self.base[0] * v**2 + self.base[1] * w**2)
        return lost


def on_base(data: Any, motion: BaseMotion, forward: float, turning: float) -> None:
    """Add a force along the heading at the control frame [N], and a torque about the vertical [N m]."""
    c, s = math.cos(motion.pose[2]), math.sin(motion.pose[2])
    force = np.array([c * forward, s * forward, 0.0])
    moment = cross(motion.lever, force)
    moment[2] += turning
    data.qfrc_applied[:3] += force
    data.qfrc_applied[3:6] += motion.rotation.T @ moment

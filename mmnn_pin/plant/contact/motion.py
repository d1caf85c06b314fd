"""How a robot in MuJoCo moves: its free base in our coordinates, and its friction.

Of the free base MuJoCo keeps the root link's position and quaternion (w, x, y, z) and its linear velocity in the
world's axes, its angular velocity in its own: `v_mj = diag(R, I) v_pin`. Friction follows the same laws as in
`model.reduction.friction`.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from ...elementary import arrays, atan2, cos, cos_sin, hypot, sin
from ...elementary.matrices import solve
from ...model.base.steered import SteeredBase
from ...model.reduction import COULOMB_SPEED
from ...model.robot import Robot
from ...signals import Array
from .pivots import Pivots
from .tree import engine

ROUNDS = 4  # of friction at the end of a step
TOUCH = 1e-7  # how far the feet start in the floor, so that contacts exist from the first step on [m]


@dataclass(frozen=True, eq=False)
class BaseMotion:
    """Where the control frame is and how it moves."""

    pose: Array  # (3,) in the world, heading in (-pi, pi] [m, m, rad]
    velocity: Array  # (3,) forward, to the left, and about the vertical [m/s, m/s, rad/s]
    nu: Array  # (nb,) base velocities [m/s, rad/s]
    rotation: Array  # (3, 3) axes of the root link in the world
    lever: Array  # (3,) from the root link's origin to that of the control frame, in the world's axes [m]


class FreeBase:
    """Converts between the free joint's coordinates and the control frame's.

    Args:
        robot: A mobile robot.
        model: MuJoCo's model of it.

    Attributes:
        pivots: What steers; None of a base where nothing does.
    """

    def __init__(self, robot: Robot, model: Any) -> None:
        self.columns = robot.base.columns
        self.pivots = Pivots(robot, robot.base, model) if isinstance(robot.base, SteeredBase) else None
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
        c, s = cos_sin(heading)
        x, y, _ = self.origin
        qpos[:3] = pose[0] - c * x + s * y, pose[1] - s * x - c * y, -TOUCH
        qpos[3:] = cos(heading / 2), 0.0, 0.0, sin(heading / 2)
        vx, vy, w = velocity
        qvel[:] = c * vx - s * vy, s * vx + c * vy, 0.0, 0.0, 0.0, w

    def motion(self, data: Any) -> BaseMotion:
        """The control frame's motion at MuJoCo's state."""
        qpos, qvel = data.qpos[:7], data.qvel[:6]
        R = rotation(qpos[3:])
        lever, omega = R @ self.origin, R @ qvel[3:]
        v = qvel[:3] + cross(omega, lever)
        heading = atan2(R[1, 0], R[0, 0]) + self.psi
        c, s = cos_sin(heading)
        pose = np.array([qpos[0] + lever[0], qpos[1] + lever[1], heading])
        eta = np.array([c * v[0] + s * v[1], c * v[1] - s * v[0], omega[2]])
        return BaseMotion(pose, eta, self.pivots.read(data, eta) if self.pivots else eta[self.columns], R, lever)

    def push(self, data: Any, motion: BaseMotion, force: Array) -> None:
        """Add a force on the base velocities, (nb,) [N, N m]: at the control frame, and on joints that steer."""
        wrench = np.zeros(3)
        if self.pivots is None:
            wrench[self.columns] = force
        else:
            wrench[:] = self.pivots.wrench(force)
            self.pivots.push(data, force)
        data.qfrc_applied[:6] += on_root(motion, wrench)


def on_root(motion: BaseMotion, wrench: Array) -> Array:
    """(6,) what a wrench (3,) at the control frame, forward, to the left, about the vertical, is on the free joint."""
    forward, left, turning = wrench
    c, s = cos_sin(motion.pose[2])
    push = np.array([c * forward - s * left, s * forward + c * left, 0.0])
    moment = cross(motion.lever, push)
    moment[2] += turning
    return np.hstack((push, motion.rotation.T @ moment))


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
    sine = min(1.0, hypot(quaternion[1], quaternion[2]))
    return 2 * atan2(sine, math.sqrt(1.0 - sine * sine))


def cross(a: Array, b: Array) -> Array:
    """`a x b` of two (3,); numpy's takes fifty times as long."""
    return np.array([a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]])


class ContactFriction:
    """Friction of a robot: in the joints as a damping, which MuJoCo's Euler takes implicitly, on the base as a force.

    That of wheels with rollers is as steep as that of joints, and would make a base that stands tremble, so it is that
    at the end of an Euler step. With W of the base's inertia over a step, `v+ = v* - W F` and `F = B v+`, where v* is
    how the base would go on without it, as it did in the last step: `v* = 2 v - v_last + W F_last`. B falls with v+.

    Args:
        robot: The robot.
        moving: (k,) places of the moving joints in the velocities of our model.
        at: (k,) places of the same in MuJoCo's.
        model: MuJoCo's model, whose damping is written.
        base: Its base; None of a fixed arm.
    """

    def __init__(self, robot: Robot, moving: Array, at: Array, model: Any, base: FreeBase | None) -> None:
        viscous = np.zeros(robot.dimensions.full)
        viscous[robot.arm_index] = robot.viscous[robot.dimensions.base :]
        self.model, self.at = model, at
        self.damping, self.dry = (robot.damping + viscous)[moving], robot.dry[moving]
        self.on, self.base = base, robot.viscous[: robot.dimensions.base]
        self.held = False
        self.has_coulomb = bool(self.dry[:, :2].any())
        self.on_base = bool(self.base.any())
        self.rolling, self.wheels = np.zeros((0, len(self.base))), (np.zeros(0), np.zeros((0, 3)))
        self.h = 0.0
        self.last: tuple[Array, Array] | None = None  # velocity of the base before the last step, and friction in it
        model.dof_damping[at] = self.damping

    def roll(self, robot: Robot, rows: Array, h: float) -> None:
        """Take the friction of wheels with rollers, the joints in these rows of all, for the base's, over steps h [s].

        With h = 0 it is that at the beginning of a step, as other methods ask for it.
        """
        self.rolling, self.h, self.on_base = robot.T[rows, : robot.dimensions.base], h, True
        self.wheels = robot.damping[rows], robot.dry[rows]

    def resistance(self, data: Any, motion: BaseMotion) -> Array:
        """(nb,) friction of the base over the next step [N, N m]."""
        if not self.h or self.last is None:
            return self.slope(motion.nu) @ motion.nu
        rows, one = np.zeros((motion.nu.size, self.model.nv)), np.eye(motion.nu.size)
        rows[:, :6] = [on_root(motion, each) for each in one]
        answers = np.zeros_like(rows)
        engine().mj_solveM(self.model, data, answers, rows)
        W, (before, F) = self.h * rows @ answers.T, self.last
        goes, ends = 2.0 * motion.nu - before + W @ F, motion.nu
        for _ in range(ROUNDS):
            B = self.slope(ends)
            ends = solve(one + W @ B, goes)
        return B @ ends

    def slope(self, nu: Array) -> Array:
        """(nb, nb) friction of the base over its velocities (nb,)."""
        wheels = self.rolling
        return np.asarray(np.diag(self.base) + wheels.T @ np.diag(damping_of(wheels @ nu, *self.wheels)) @ wheels)

    def apply(self, data: Any, motion: BaseMotion | None, hold: Array) -> None:
        """Write damping, and add the force on the base, for the next step; hold (k,) is friction of blocked joints."""
        if self.has_coulomb or hold.any() or self.held:
            self.held = bool(hold.any())
            self.model.dof_damping[self.at] = damping_of(data.qvel[self.at], self.damping, self.dry, hold)
        if self.on_base and self.on is not None and motion is not None:
            force = self.resistance(data, motion)
            self.last = motion.nu.copy(), force
            self.on.push(data, motion, -force)

    def power(self, data: Any, motion: BaseMotion | None) -> float:
        """Power that friction takes at this velocity [W]."""
        lost = float(self.model.dof_damping[self.at] @ data.qvel[self.at] ** 2)
        if self.last is not None and motion is not None:
            lost += float(sum(self.last[1] * motion.nu))
        return lost


def damping_of(v: Array, damping: Array, dry: Array, hold: Array | float = 0.0) -> Array:
    """(k,) friction of joints over their velocities (k,), dry (k, 3) as in `dry_level`, and of blocked ones."""
    slow, level = np.abs(v) < 1e-6 * COULOMB_SPEED, hold + dry[:, 0]
    if dry[:, 1].any():
        level = level + dry[:, 1] * arrays.exp(-((v / dry[:, 2]) ** 2))
    ratio = arrays.tanh(v / COULOMB_SPEED) / np.where(slow, 1.0, v)
    return np.asarray(damping + level * np.where(slow, 1 / COULOMB_SPEED, ratio))

"""Single control periods of a recorded loop, from any state, and the loop linearised along its reference.

The state y is how far the robot is from its reference: the pose in the reference's frame, the joints, the velocities.
Under a torque that is held, M, C and gravity stay those of the period's beginning while viscous friction acts exactly
(a matrix exponential), so that a period may be long for stiff friction. Dry friction is left to the error of Psi.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import expm

from ...kinematic import command
from ...loop.before_run import viscous_friction
from ...model.dynamics import Dynamics
from ...sensing import exact
from ...signals import Array
from .subject import Subject

STEP = 1e-5  # by which slopes are taken [m, rad, m/s, rad/s]


class Periods:
    """Single control periods of a run's loop, from anywhere, by Pinocchio; dry friction is left to the error of Psi."""

    def __init__(self, subject: Subject) -> None:
        self.subject, self.layout, self.robot = subject, subject.layout, subject.robot
        smooth = replace(subject.robot, coulomb=np.zeros_like(subject.robot.coulomb))
        self.dynamics, self.rough = Dynamics(smooth), Dynamics(subject.robot)
        self.damping, self.gain = viscous_friction(subject.robot), subject.signal("effective_gain")[0].copy()
        kinematic = subject.kinematic
        self.gains = kinematic.base_gains(self.layout.base), kinematic.arm_gains(self.layout)
        self.poses, self.size = self.layout.pose, self.layout.pose + self.layout.arm + self.layout.dof

    def reference(self, row: Array) -> Array:
        """(p,) velocities of the reference."""
        where = self.layout.where
        return np.concatenate((row[where("velocity_ref")], row[where("qdot_ref")]))

    def placed(self, row: Array, y: Array) -> tuple[Array, Array]:
        """Position and nu at a state (m,)."""
        where, position, at = self.layout.where, self.robot.neutral_position(), self.poses
        if at:
            turned = frame(row[where("pose_ref")][2])
            position[:at] = row[where("pose_ref")] + turned @ y[:at]
        position[self.robot.arm_index] = row[where("q_ref")] + y[at : at + self.layout.arm]
        return self.robot.follow(position), self.reference(row) + y[at + self.layout.arm :]

    def state(self, row: Array, position: Array, nu: Array) -> Array:
        """The state (m,) of a position and nu."""
        where, at = self.layout.where, self.poses
        pose = np.zeros(at)
        if at:
            pose = frame(row[where("pose_ref")][2]).T @ (position[:at] - row[where("pose_ref")])
            pose[2] = np.remainder(pose[2] + np.pi, 2 * np.pi) - np.pi
        return np.concatenate((pose, position[self.robot.arm_index] - row[where("q_ref")], nu - self.reference(row)))

    def seen(self, row: Array, y: Array) -> tuple[Array, Array, Array]:
        """The row of a state as exact sensors and the kinematic law make it; its position and nu."""
        row, (position, nu) = row.copy(), self.placed(row, y)
        exact(row, self.layout.offsets, position, nu, self.robot.arm_index)
        command(row, self.layout.offsets, *self.gains)
        return row, position, nu

    def torque(self, row: Array, y: Array) -> Array:
        """`k s + Psi` at a state, (p,) [N, N m]."""
        where, (row, position, nu) = self.layout.where, self.seen(row, y)
        nu_ref, psi = row[where("nu_ref")], np.zeros(len(nu))
        self.dynamics.refresh(position, nu)
        self.dynamics.refresh_psi(nu_ref, row[where("nudot_ref")], psi)
        return np.asarray(self.gain * (nu_ref - nu) + psi)

    def dry(self, nu: Array) -> Array:
        """Dry friction at a velocity, (p,) [N, N m]."""
        return np.asarray(self.rough.friction(nu) - self.dynamics.friction(nu))

    def after(self, row: Array, following: Array, y: Array, tau: Array) -> Array:
        """The state after a period under a held torque (p,): M, C and gravity of its beginning, friction exactly."""
        position, nu = self.placed(row, y)
        M, C = self.dynamics.mass_matrix(position), self.dynamics.coriolis_matrix(position, nu)
        p, h = len(nu), self.subject.timing.control_period
        rate = np.zeros((2 * p + 1, 2 * p + 1))
        rate[:p, :p] = -np.linalg.solve(M, C + self.damping)
        rate[:p, -1] = np.linalg.solve(M, tau - self.dynamics.gravity(position))
        rate[p:-1, :p] = np.eye(p)
        nu, moved, _ = np.split(expm(h * rate) @ np.concatenate((nu, np.zeros(p), [1.0])), (p, 2 * p))
        position = position.copy()
        if at := self.poses:
            turn = moved[at - 1 if self.layout.base == at else 1]
            way = moved[:2] if self.layout.base == at else np.array([moved[0], 0.0])
            position[:at] += np.append((frame(position[2] + turn / 2) @ np.append(way, 0.0))[:2], turn)
        position[self.robot.arm_index] += moved[self.layout.base :]
        return self.state(following, position, nu)


def frame(phi: float) -> Array:
    """(3, 3) rotation of (x, y, phi) by a heading."""
    c, s = np.cos(phi), np.sin(phi)
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])


@dataclass(frozen=True, eq=False)
class Linear:
    """The loop linearised at K + 1 periods, straight lines between them; m states, l late torques, p velocities.

    Attributes:
        at: (K + 1,) the periods.
        P: (K + 1, m + l, m + l) what a period does to a state, late torques behind it.
        B: (K + 1, m + l, p) what an error of the torque does.
        A: (K + 1, m, m) of the plant alone.
        plant: (K + 1, m, p) of its torque.
        T: (K + 1, p, m) torque of a state.
        torque: (K + 1, p) without any error.
        c: (K + 1, m) where a period without any error leads.
    """

    at: NDArray[np.int64]
    P: Array
    B: Array
    A: Array
    plant: Array
    T: Array
    torque: Array
    c: Array

    @classmethod
    def of(cls, periods: Periods, late: int, blocks: int) -> Linear:
        """By central differences."""
        rows, m, p = periods.subject.rows, periods.size, periods.layout.dof
        at = np.unique(np.linspace(0, len(rows) - 2, blocks + 1).astype(np.int64))
        A, B, T = np.zeros((len(at), m, m)), np.zeros((len(at), m, p)), np.zeros((len(at), p, m))
        torque, c, rest = np.zeros((len(at), p)), np.zeros((len(at), m)), np.zeros(m)
        for b, j in enumerate(at):
            row, following = rows[j], rows[j + 1]
            torque[b] = periods.torque(row, rest)
            c[b] = periods.after(row, following, rest, torque[b])
            for i, y in enumerate(STEP * np.eye(m)):
                ends = [periods.after(row, following, sign * y, torque[b]) for sign in (1.0, -1.0)]
                A[b, :, i] = (ends[0] - ends[1]) / (2 * STEP)
                T[b, :, i] = (periods.torque(row, y) - periods.torque(row, -y)) / (2 * STEP)
            for i, tau in enumerate(np.diag(STEP * np.maximum(periods.gain, 1e-3))):
                ends = [periods.after(row, following, rest, torque[b] + sign * tau) for sign in (1.0, -1.0)]
                B[b, :, i] = (ends[0] - ends[1]) / (2 * tau[i])
        return cls(at, *delayed(A, B, T, late), A, B, T, torque, c)

    def between(self, b: int, j: int, *names: str) -> list[Array]:
        """Some of the attributes at period j of block b."""
        w = (j - self.at[b]) / (self.at[b + 1] - self.at[b])
        return [(1 - w) * getattr(self, name)[b] + w * getattr(self, name)[b + 1] for name in names]


def delayed(A: Array, B: Array, T: Array, late: int) -> tuple[Array, Array]:
    """P and B of `Linear` with commands that take effect `late` periods after their sample."""
    if not late:
        return A + B @ T, B
    K, m, p = B.shape
    P, into = np.zeros((K, m + late * p, m + late * p)), np.zeros((K, m + late * p, p))
    P[:, :m, :m], P[:, :m, m : m + p] = A, B
    P[:, m:-p, m + p :] = np.eye((late - 1) * p)
    P[:, -p:, :m], into[:, -p:] = T, np.eye(p)
    return P, into

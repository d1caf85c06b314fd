"""Single control periods of a recorded loop, from any state.

The state y is how far the robot is from its reference: the pose in the reference's frame, the joints, the velocities.
Under a torque that is held, M, C, gravity and the heading are those of the period's beginning:

    (M + brakes h D) a = tau - gravity - (C + D) nu        nu+ = nu + h a        moved = h (nu + moves h a)

D is viscous friction. With one step of the plant per period, of Euler's kind, this is what the plant does; with several
steps, or RK4, `brakes` and `moves` are the means of what they do. Dry friction is left to the error of Psi.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from mmnn_pin.kinematic import command
from mmnn_pin.lab.psi.subject import Subject
from mmnn_pin.loop.before_run import viscous_friction
from mmnn_pin.model.dynamics import Dynamics
from mmnn_pin.sensing import exact
from mmnn_pin.settings import Timing
from mmnn_pin.signals import Array


class Periods:
    """Single control periods of a run's loop, from anywhere, by Pinocchio; dry friction is left to the error of Psi."""

    def __init__(self, subject: Subject) -> None:
        self.subject, self.layout, self.robot = subject, subject.layout, subject.robot
        smooth = replace(subject.robot, coulomb=np.zeros_like(subject.robot.coulomb))
        self.dynamics, self.rough = Dynamics(smooth), Dynamics(subject.robot)
        self.damping, self.gain = viscous_friction(subject.robot), subject.signal("effective_gain")[0].copy()
        kinematic = subject.kinematic
        self.gains = kinematic.base_gains(self.layout), kinematic.arm_gains(self.layout)
        self.moves, self.brakes = weights(subject.timing)
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
        command(row, self.layout.offsets, *self.gains, np.zeros(0), None)
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
        """The state after a period under a held torque (p,)."""
        (position, nu), h, damping = self.placed(row, y), self.subject.timing.control_period, self.damping
        M, C = self.dynamics.mass_matrix(position), self.dynamics.coriolis_matrix(position, nu)
        force = tau - self.dynamics.gravity(position) - (C + damping) @ nu
        nudot = np.linalg.solve(M + self.brakes * h * damping, force)
        moved, position = h * (nu + self.moves * h * nudot), position.copy()
        if at := self.poses:
            turn = moved[self.layout.base - 1]
            way = moved[:2] if self.layout.sideways else np.array([moved[0], 0.0])
            position[:at] += np.append((frame(position[2] + (1 - self.moves) * turn) @ np.append(way, 0.0))[:2], turn)
        position[self.robot.arm_index] += moved[self.layout.base :]
        return self.state(following, position, nu + h * nudot)


def weights(timing: Timing) -> tuple[float, float]:
    """`moves` and `brakes` of a plant: how much of a period's acceleration counts in its mean velocity and friction."""
    more = 1 / timing.steps_per_control
    return ((1 + more) / 2, (1 - more) / 2) if timing.integrator == "semi_implicit_euler" else (0.5, 0.5)


def frame(phi: float) -> Array:
    """(3, 3) rotation of (x, y, phi) by a heading."""
    c, s = np.cos(phi), np.sin(phi)
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])

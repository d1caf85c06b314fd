"""A base that steers, in MuJoCo: its velocities from the pivots as they stand, forces on these, and its linkage.

A motor turns its own joint, casters and hitches turn freely, and what the wheels then do is the floor's to say. A
*follower* is held to its master by an equality, whether a linkage does it or the wheel's own controller: torques alone,
mirrored from the master's, would let the two drift apart. MuJoCo's equality is a polynomial of the master's angle; this
one is the tangent of the exact curve f at every stage, and `f'' rate^2`, which MuJoCo leaves out, is put in, too.

Of the velocities `nu` the first are the control frame's along the columns n of `V` (`model.base.rolling`), which
stand at right angles to each other and to what the masters' turning moves, in the measure W:

    nu_i = n_i' W eta / n_i' W n_i        the force on it is the wrench W n_i / n_i' W n_i
"""

from __future__ import annotations

from typing import Any

import numpy as np

from ...elementary import cos_sin
from ...model.base.rolling import FOLLOWER, MASTER, TURN, followed, new_maps, roll
from ...model.base.steered import SteeredBase
from ...model.reduction import solve
from ...model.robot import Robot
from ...signals import Array
from .tree import engine, tie_of

SINGULAR = 1e-12  # share of the largest motor's effect: where none drives, none is asked for infinitely much


class Pivots:
    """The pivots of a base that steers in MuJoCo's model.

    Args:
        robot: The robot.
        base: Its base.
        model: MuJoCo's model (`mjModel`), whose equalities are written.

    Attributes:
        maps: Those at the pivots last read.
        nu: (p,) of which the base's part is as last read.
    """

    def __init__(self, robot: Robot, base: SteeredBase, model: Any) -> None:
        rolling = robot.rolling
        assert rolling is not None
        self.robot, self.base, self.rolling, self.model = robot, base, rolling, model
        self.maps = new_maps(rolling, robot.template)
        self.position, self.nu = np.zeros(robot.dimensions.full), np.zeros(robot.dimensions.dof)
        joints = [model.joint(name) for name in base.shape]
        self.at_q = np.array([joint.qposadr[0] for joint in joints], int)
        self.at_v = np.array([joint.dofadr[0] for joint in joints], int)
        self.spins = np.array([model.joint(wheel.joint).dofadr[0] for wheel in base.wheels], int)
        self.masters = np.array(base.masters, int)
        self.own = robot.dimensions.base - len(self.masters)  # how many velocities are the control frame's
        self.weights = np.array([1.0, 1.0, rolling.length**2])
        roles, equality = rolling.turns[:, TURN.role], engine().mjtObj.mjOBJ_EQUALITY
        self.ties = [
            (int(k), engine().mj_name2id(model, equality, tie_of(base.shape[k])))
            for k in np.flatnonzero(roles == FOLLOWER)
        ]
        self.master = int(np.flatnonzero(roles == MASTER)[0]) if self.ties else -1
        p, motors = robot.dimensions.dof, robot.dimensions.motors
        self.EE, self.L, self.share, self.E = np.zeros((p, p)), np.zeros((p, p)), np.zeros(p), np.zeros((p, motors))

    def read(self, data: Any, eta: Array) -> Array:
        """Base velocities, (nb,), at MuJoCo's state, where the control frame moves with eta (3,)."""
        maps, nb = self.maps, self.robot.dimensions.base
        self.position[self.robot.shape_index] = data.qpos[self.at_q]
        self.nu[self.own : nb] = data.qvel[self.at_v][self.masters]
        roll(self.rolling, self.position, self.nu, maps)
        for i, n in enumerate(self._directions()):
            self.nu[i] = n @ eta
        return self.nu[:nb].copy()

    def _directions(self) -> Array:
        """(own, 3) rows that take the control frame's velocity to the base's own velocities."""
        n = self.maps.V[0, :, : self.own]
        weighted = self.weights[:, None] * n
        return (weighted / (n * weighted).sum(axis=0)).T

    def wrench(self, force: Array) -> Array:
        """(3,) force and torque at the control frame of a force on the base's velocities (nb,)."""
        return np.asarray(force[: self.own] @ self._directions())

    def push(self, data: Any, force: Array) -> None:
        """Add what of a force on the base's velocities (nb,) is on the joints that steer."""
        data.qfrc_applied[self.at_v[self.masters]] += force[self.own :]

    def drive(self, tau: Array) -> Array:
        """The least motor torques, (motors,), that give a torque on nu (p,) at the pivots last read."""
        np.matmul(self.maps.T.T, self.robot.E_full, out=self.E)
        np.matmul(self.E, self.E.T, out=self.EE)
        np.fill_diagonal(self.EE, self.EE.diagonal() + SINGULAR * self.EE.diagonal().max())
        solve(self.EE, tau, self.L, self.share)
        return np.asarray(self.E.T @ self.share)

    def couple(self) -> None:
        """Write the tangent of every follower's curve at the pivots last read."""
        if not self.ties:
            return
        places, T, master = self.robot.shape_index, self.maps.T, self.rolling.turns[self.master]
        at = self.position[places[self.master]]
        for k, tie in self.ties:
            slope, there = T[places[k], master[TURN.column]], followed(self.rolling, k, at, self.position[places[k]])
            self.model.eq_data[tie, :2] = there - slope * at, slope

    def curve(self, data: Any) -> None:
        """Put `f'' rate^2` of every follower into what its equality is asked (`efc_aref`)."""
        places, column = self.robot.shape_index, self.rolling.turns[self.master, TURN.column]
        for k, tie in self.ties:
            bend = self.maps.Tdot[places[k], column] * self.nu[column]
            for row in range(data.ne):
                if data.efc_id[row] == tie and data.efc_type[row] == engine().mjtConstraint.mjCNSTR_EQUALITY:
                    data.efc_aref[row] += bend

    def sliding(self, data: Any, eta: Array) -> tuple[Array, Array]:
        """(wheels,) speeds of the contact points over the floor, along the wheels and across, at MuJoCo's state."""
        yaw = [float(pivot.sign * q) for pivot, q in zip(self.base.pivots, data.qpos[self.at_q], strict=True)]
        turning = [float(pivot.sign * v) for pivot, v in zip(self.base.pivots, data.qvel[self.at_v], strict=True)]
        moving: list[tuple[float, float, float]] = [(float(eta[0]), float(eta[1]), float(eta[2]))]
        for pivot, angle, rate in zip(self.base.pivots, yaw, turning, strict=True):
            vx, vy, w = moving[pivot.parent + 1]
            vx, vy, (c, s) = vx - pivot.y * w, vy + pivot.x * w, cos_sin(angle)
            moving.append((c * vx + s * vy, c * vy - s * vx, w + rate))
        along, across = np.zeros((2, len(self.base.wheels)))
        for i, (wheel, spin) in enumerate(zip(self.base.wheels, data.qvel[self.spins], strict=True)):
            vx, vy, w = moving[wheel.pivot + 1]
            vx, vy, (c, s) = vx - wheel.y * w, vy + wheel.x * w, cos_sin(wheel.heading)
            along[i], across[i] = c * vx + s * vy - wheel.sign * wheel.radius * spin, c * vy - s * vx
        return along, across

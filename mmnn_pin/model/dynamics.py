"""Reduced dynamics by Pinocchio: `M nudot + C nu + gravity + friction = tau`, the true Psi, constraint forces.

Full model (2.11) with the Pfaffian constraint `A v = 0` of rolling wheels, planar root in body velocities; reduced by
the null space map T: `M = T' M_full T`, `C = T' (C_full T + M_full Tdot)` (2.23)-(2.25). Where nothing steers, T is
constant. `Mdot = C + C'` holds for any T, with the full matrices that it holds for.
"""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from ..signals import Array
from . import reduction
from .base.rolling import new_maps, roll
from .structure import Structure


class Dynamics:
    """Reduced dynamics of one robot. Holds a workspace: one object per thread.

    Positions are (nv,) `[x, y, phi, every joint]`, velocities (p,) `nu`; results of the public methods are copies.

    Args:
        robot: The robot.
    """

    def __init__(self, robot: Structure) -> None:
        self.robot = robot
        model, p = robot.model, robot.dimensions.dof
        self.model, self.data = model, model.createData()
        self.frame = np.array(robot.frame, float) if robot.dimensions.base else np.zeros(0)
        self.q, self.v = pin.neutral(model), np.zeros(model.nv)
        # Writable copies: compiled code exists once for these, not again for read-only arrays.
        self.q_index, self.is_continuous = robot.q_index.copy(), robot.is_continuous.copy()
        self.maps = new_maps(robot.rolling, robot.template)
        self.T = self.maps.T
        self.damping, self.dry, self.viscous = robot.damping.copy(), robot.dry, robot.viscous.copy()
        # Views of Pinocchio's own memory; M is symmetric, its transpose is contiguous row by row.
        self.M_full, self.C_full, self.h_full, self.g_full = self.data.M.T, self.data.C, self.data.nle, self.data.g
        self.M, self.L, self.half = np.zeros((p, p)), np.zeros((p, p)), np.zeros((model.nv, p))
        self.h, self.F = np.zeros(p), np.zeros(p)
        self.w, self.f = np.zeros(model.nv), np.zeros(model.nv)
        self.feels_gravity = feels_gravity(robot, self.data)

    # -- for people -------------------------------------------------------------------------------------------

    def mass_matrix(self, position: Array) -> Array:
        """Reduced mass matrix `T' M T`, (p, p) [kg, kg m, kg m^2]."""
        T = self.robot.T_at(position)
        return T.T @ pin.crba(self.model, self.data, self.robot.configuration(position)) @ T

    def coriolis_matrix(self, position: Array, nu: Array) -> Array:
        """Reduced Coriolis matrix `T' (C T + M Tdot)`, (p, p), of the factorisation with `Mdot = C + C'`."""
        robot, q = self.robot, self.robot.configuration(position)
        T = robot.T_at(position)
        reduced = T.T @ pin.computeCoriolisMatrix(self.model, self.data, q, T @ nu) @ T
        if not robot.steers:
            return reduced
        return reduced + T.T @ pin.crba(self.model, self.data, q) @ robot.Tdot_at(position, nu)

    def gravity(self, position: Array) -> Array:
        """Reduced gravity, (p,) [N, N m]: the torque that holds the robot still."""
        return gravity(self.robot, self.data, position)

    def friction(self, nu: Array, position: Array | None = None) -> Array:
        """Friction of joints and base, (p,) [N, N m], opposing the motion (see `reduction.friction`).

        Without a position (nv,) a base that steers stands at rest.
        """
        T = self.robot.T_at(self.robot.rest if position is None else position)
        return T.T @ self._joint_friction(T @ nu) + self.robot.viscous * nu

    def psi(self, position: Array, nu: Array, nu_ref: Array, nudot_ref: Array) -> Array:
        """True Psi, what the networks must learn: `M nudot_ref + C nu_ref + gravity + friction`, (p,) [N, N m].

        With `nu_ref = [alpha; qdot_rd + K e]` this is (3.20), (3.21) with (3.22).
        """
        C = self.coriolis_matrix(position, nu)
        return (
            self.mass_matrix(position) @ nudot_ref + C @ nu_ref + self.gravity(position) + self.friction(nu, position)
        )

    def acceleration(self, position: Array, nu: Array, tau: Array) -> Array:
        """Acceleration nudot under the generalized torque tau, (p,)."""
        rest = tau - self.coriolis_matrix(position, nu) @ nu - self.gravity(position) - self.friction(nu, position)
        return np.asarray(np.linalg.solve(self.mass_matrix(position), rest), float)

    def energy(self, position: Array, nu: Array) -> float:
        """Kinetic and potential energy [J]; the latter counts as 0 for a robot that does not feel gravity."""
        self.q[:] = self.robot.configuration(position)
        return float(0.5 * nu @ self.mass_matrix(position) @ nu) + self.potential()

    def constraint_forces(self, position: Array, nu: Array, motors: Array) -> Array:
        """Lagrange multipliers of `M_full a + h + A' lambda + F = E_full motors` (2.11), (nc,), rows as of `A_at`.

        The force of constraint i on the full coordinates is `-A[i] lambda[i]`. Where nothing steers, the first row is
        the lateral force that keeps the wheels from slipping; of rows that repeat each other the forces are the least.
        """
        robot, T, A = self.robot, self.robot.T_at(position), self.robot.A_at(position)
        q, v = robot.configuration(position), T @ nu
        a = T @ self.acceleration(position, nu, robot.E_at(position) @ motors) + robot.Tdot_at(position, nu) @ nu
        friction = self._joint_friction(v) + self._declared_friction(position, robot.viscous * nu)
        rest = robot.E_full @ motors - pin.rnea(self.model, self.data, q, v, a) - friction
        if robot.steers:
            return np.linalg.lstsq(A.T, rest, rcond=1e-10)[0]
        return np.linalg.solve(A @ A.T, A @ rest)

    def _declared_friction(self, position: Array, force: Array) -> Array:
        """Friction declared on nu as forces of the full model, (nv,): at the control frame and on the joints."""
        robot, out = self.robot, np.zeros(self.model.nv)
        nb = robot.dimensions.base
        if robot.steers:  # any forces that do on nu what these do
            return np.linalg.pinv(robot.T_at(position).T) @ force
        if nb:
            wrench = np.zeros(3)
            wrench[robot.base.columns] = force[:nb]
            out[:3] = robot.base.to_control.T @ wrench
        out[robot.arm_index] = force[nb:]
        return out

    def _joint_friction(self, v: Array) -> Array:
        return self.robot.damping * v + self.robot.dry_friction(v) * np.tanh(v / reduction.COULOMB_SPEED)

    # -- for loops: results stay in the workspace ------------------------------------------------------------------

    def refresh(self, position: Array, nu: Array) -> None:
        """Mass matrix M, and h = C nu + gravity + friction, in the workspace."""
        if self.robot.rolling is not None:
            roll(self.robot.rolling, position, nu, self.maps)
        reduction.configuration(position, nu, self.T, self.frame, self.q_index, self.is_continuous, self.q, self.v)
        pin.crba(self.model, self.data, self.q)
        pin.nonLinearEffects(self.model, self.data, self.q, self.v)
        reduction.reduce(self.T, self.M_full, self.half, self.M)
        reduction.friction(self.T, self.v, nu, self.damping, self.dry, self.viscous, self.F)
        self.f[:] = self.h_full
        if self.robot.steers:
            reduction.spread(self.maps.Tdot, nu, self.w)
            reduction.add_product(self.M_full, self.w, self.f)
        reduction.project(self.T, self.f, self.h)
        self.h += self.F

    def refresh_psi(self, nu_ref: Array, nudot_ref: Array, psi: Array) -> None:
        """True Psi at the place and velocity last refreshed, written to psi (p,)."""
        pin.computeCoriolisMatrix(self.model, self.data, self.q, self.v)
        if self.feels_gravity:
            pin.computeGeneralizedGravity(self.model, self.data, self.q)
        reduction.spread(self.T, nu_ref, self.w)
        self.f[:] = self.g_full
        reduction.add_product(self.C_full, self.w, self.f)
        if self.robot.steers:
            reduction.spread(self.maps.Tdot, nu_ref, self.w)
            reduction.add_product(self.M_full, self.w, self.f)
        reduction.project(self.T, self.f, psi)
        psi += self.F
        reduction.add_product(self.M, nudot_ref, psi)

    def potential(self) -> float:
        """Potential energy at the place last refreshed [J]."""
        return float(pin.computePotentialEnergy(self.model, self.data, self.q)) if self.feels_gravity else 0.0


def gravity(robot: Structure, data: pin.Data, position: Array) -> Array:
    """Reduced gravity by Pinocchio, (p,) [N, N m]; data of the robot's model are used."""
    return robot.T_at(position).T @ pin.computeGeneralizedGravity(robot.model, data, robot.configuration(position))


def feels_gravity(robot: Structure, data: pin.Data | None = None) -> bool:
    """Whether gravity does work on the reduced robot (a planar one does not feel it)."""
    rng, data = np.random.default_rng(0), robot.model.createData() if data is None else data
    weight = 9.81 * sum(body.mass for body in robot.model.inertias)
    trials = (gravity(robot, data, rng.uniform(-3, 3, robot.model.nv)) for _ in range(5))
    return any(np.abs(g).max(initial=0.0) > 1e-12 * weight for g in trials)

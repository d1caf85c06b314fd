"""The matrices of a robot at a state, from Pinocchio: what the property checks judge."""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from ...signals import Array
from ..reduction import COULOMB_SPEED
from ..robot import Robot


class Terms:
    """The matrices of one robot at a state, in the full model's velocities (2.11) and reduced by T (2.23)-(2.25).

    The checks ask here for everything that they judge; a subclass can replace a term by a wrong one.

    Args:
        robot: The robot.
    """

    def __init__(self, robot: Robot) -> None:
        self.robot, self.model, self.data = robot, robot.model, robot.model.createData()
        self.T, self.A = robot.T, robot.A

    def mass(self, q: Array) -> Array:
        """Mass matrix M of the full model at Pinocchio's q, (nv, nv)."""
        return pin.crba(self.model, self.data, q).copy()

    def coriolis(self, q: Array, v: Array) -> Array:
        """Coriolis matrix C of the full model, (nv, nv)."""
        return pin.computeCoriolisMatrix(self.model, self.data, q, v).copy()

    def gravity(self, q: Array) -> Array:
        """Gravity of the full model, (nv,)."""
        return pin.computeGeneralizedGravity(self.model, self.data, q).copy()

    def potential(self, q: Array) -> float:
        """Potential energy [J]."""
        return float(pin.computePotentialEnergy(self.model, self.data, q))

    def friction(self, nu: Array) -> Array:
        """Friction of joints and base on nu, (p,), opposing the motion."""
        robot, v = self.robot, self.T @ nu
        return self.T.T @ (robot.damping * v + robot.dry_friction(v) * np.tanh(v / COULOMB_SPEED)) + robot.viscous * nu

    def reduced_mass(self, q: Array) -> Array:
        """Mbar = T' M T, (p, p)."""
        return self.T.T @ self.mass(q) @ self.T

    def reduced_coriolis(self, q: Array, nu: Array) -> Array:
        """Cbar = T' C T, (p, p); T is constant in body velocities."""
        return self.T.T @ self.coriolis(q, self.T @ nu) @ self.T

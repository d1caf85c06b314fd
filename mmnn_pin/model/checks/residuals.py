"""Residuals of the properties that the thesis's proof rests on: functions that return a number.

Every residual is scale-free. Mass matrices are judged as `D M D` with `D = diag(M)^(-1/2)`, which has ones on its
diagonal whatever the masses and units are, and rates of them are divided by the rate of the motion. So one tolerance
serves a robot of 3 kg and one of 300 kg. `FullTerms` are what is judged; passivity is judged along motions.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from ...signals import Array, IntArray
from ..reduction import COULOMB_SPEED
from ..robot import Robot

EXACT = 1e-9  # of residuals of algebra
DEFINITE = 1e-12  # least eigenvalue of a mass matrix with ones on its diagonal
STEP = 1e-3  # of differences along a motion, times its largest rate
STENCIL = ((-2, 1 / 12), (-1, -8 / 12), (1, 8 / 12), (2, -1 / 12))  # fourth-order central difference


class FullTerms:
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


# -- of matrices -------------------------------------------------------------------------------------------------------


def asymmetry(M: Array) -> float:
    """Largest `|M - M'|`, M scaled to ones on its diagonal."""
    return largest((M - M.T) * weights(M))


def smallest_eigenvalue(M: Array) -> float:
    """Smallest eigenvalue of M scaled to ones on its diagonal; negative where M is not positive definite."""
    if not (np.isfinite(M).all() and np.all(np.diag(M) > 0)):
        return -np.inf
    scaled = M * weights(M)
    return float(np.linalg.eigvalsh((scaled + scaled.T) / 2).min(initial=1.0))


def skewness(M: Array, Mdot: Array, C: Array, speed: float) -> float:
    """Largest `|Mdot - (C + C')|` per speed, scaled as M: zero if and only if `Mdot - 2C` is skew (Mdot symmetric)."""
    return largest((Mdot - C - C.T) * weights(M)) / speed


def block_residual(M: Array, Mdot: Array, C: Array, speed: float, part: IntArray) -> float:
    """Properties 1 and 2 of one block: asymmetry, skewness, and 1 where it is not positive definite."""
    at = np.ix_(part, part)
    if smallest_eigenvalue(M[at]) <= DEFINITE:
        return 1.0
    return max(asymmetry(M[at]), skewness(M[at], Mdot[at], C[at], speed))


def cross_residual(M: Array, Mdot: Array, C: Array, speed: float, first: IntArray, second: IntArray) -> float:
    """Property 4 for two sets of velocities: `M_vr = M_rv'` and `Mdot_rv = C_rv + C_vr'`, scaled as M."""
    W = weights(M)[np.ix_(second, first)]
    rate = Mdot[np.ix_(second, first)] - C[np.ix_(second, first)] - C[np.ix_(first, second)].T
    return max(largest(rate * W) / speed, largest((M[np.ix_(first, second)].T - M[np.ix_(second, first)]) * W))


def nonlinearity(C: Callable[[Array], Array], v: Array, M: Array, speed: float) -> float:
    """Largest `|C(2 v) - 2 C(v)|`, scaled as M: with zero, `||C|| <= C_b ||v||` holds for some C_b (property 1)."""
    return largest((C(2 * v) - 2 * C(v)) * weights(M)) / speed


def annihilation(A: Array, T: Array) -> float:
    """Largest `|A T|`, each entry over the sum of the magnitudes that should cancel in it: `A S = 0` (2.17)."""
    return largest(A @ T / np.maximum(abs(A) @ abs(T), np.finfo(float).tiny)) if len(A) else 0.0


def independence(T: Array) -> float:
    """Smallest singular value of T with columns of unit length: above zero if and only if S has full rank."""
    length = np.linalg.norm(T, axis=0)
    if not (T.size and length.all()):
        return 1.0 if not T.size else 0.0
    return float(np.linalg.svd(T / length, compute_uv=False).min())


def missing_constraints(A: Array, T: Array) -> float:
    """Difference of rank A from nv - p, in rows: fewer would permit motions that T does not know."""
    rows = A / np.maximum(np.linalg.norm(A, axis=1, keepdims=True), np.finfo(float).tiny)
    rank = int(np.linalg.matrix_rank(rows, tol=EXACT)) if A.size else 0
    return float(abs(T.shape[0] - T.shape[1] - rank))


def rate_along(function: Callable[[Array], Array], model: pin.Model, q: Array, v: Array, speed: float) -> Array:
    """Time derivative of a matrix along the motion from q with velocity v, by differences of fourth order."""
    h = STEP / speed
    return np.sum([weight * function(pin.integrate(model, q, i * h * v)) for i, weight in STENCIL], axis=0) / h


def weights(M: Array) -> Array:
    """Factors that scale M, and rates of it, to ones on the diagonal: `1 / sqrt(M_ii M_jj)`, (p, p)."""
    diagonal = np.sqrt(abs(np.diag(M)))
    return 1.0 / np.maximum(np.outer(diagonal, diagonal), np.finfo(float).tiny)


def largest(values: Array) -> float:
    """Largest magnitude, nan where there is one; 0 of nothing."""
    return float(np.max(abs(values), initial=0.0))


# -- along motions -----------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class SineMotion:
    """A smooth motion of all independent velocities: `nu = a sin(b t + c)`, each (p,)."""

    a: Array
    b: Array
    c: Array

    @classmethod
    def random(cls, p: int, rng: np.random.Generator) -> SineMotion:
        """Of speeds about one, turning within a second or a few."""
        return cls(rng.standard_normal(p), rng.uniform(1.0, 6.0, p), rng.uniform(0.0, 2 * np.pi, p))

    def nu(self, t: float) -> Array:
        """Velocities."""
        return self.a * np.sin(self.b * t + self.c)

    def nudot(self, t: float) -> Array:
        """Accelerations."""
        return self.a * self.b * np.cos(self.b * t + self.c)

    def travel(self, t: float) -> Array:
        """Integral of the velocities from 0 to t."""
        return self.a / self.b * (np.cos(self.c) - np.cos(self.b * t + self.c))


def energy_leak(terms: FullTerms, position: Array, rng: np.random.Generator, nodes: int = 24) -> float:
    """Passivity: energy gained along a random motion, minus the work of the torques and the loss by friction.

    The motion is a sum of sines over half a second, the torque the one that drives it, `tau = Mbar nudot + Cbar nu +
    gravity + friction` (2.23), the work its integral by Gauss-Legendre. Friction that feeds energy counts as a leak.
    The residual is divided by the sum of the magnitudes of all powers, integrated.
    """
    x, w = np.polynomial.legendre.leggauss(nodes)
    duration = 0.5
    motion = SineMotion.random(terms.robot.dimensions.dof, rng)
    net, total, fed = 0.0, 0.0, 0.0
    for t, weight in zip((1 + x) * duration / 2, w * duration / 2, strict=True):
        nu, nudot = motion.nu(t), motion.nudot(t)
        q = configuration_along(terms, position, motion, t)
        friction = float(nu @ terms.friction(nu))
        conservative = (
            float(nu @ terms.reduced_mass(q) @ nudot),
            float(nu @ terms.reduced_coriolis(q, nu) @ nu),
            float(nu @ (terms.T.T @ terms.gravity(q))),
        )
        net += weight * sum(conservative)
        fed += weight * max(0.0, -friction)
        total += weight * (sum(map(abs, conservative)) + abs(friction))
    gained = energy_at(terms, position, motion, duration) - energy_at(terms, position, motion, 0.0)
    return (abs(gained - net) + fed) / max(total, np.finfo(float).tiny)


def configuration_along(terms: FullTerms, position: Array, motion: SineMotion, t: float) -> Array:
    """Pinocchio's q after a time of a motion; the base stays at its place, on which no energy depends, and turns."""
    root = terms.robot.dimensions.pose
    travel = terms.T @ motion.travel(t)
    travel[: max(0, root - 1)] = 0.0
    return terms.robot.configuration(position + travel)


def energy_at(terms: FullTerms, position: Array, motion: SineMotion, t: float) -> float:
    """Kinetic and potential energy after a time of a motion [J]."""
    q, nu = configuration_along(terms, position, motion, t), motion.nu(t)
    return float(nu @ terms.reduced_mass(q) @ nu) / 2 + terms.potential(q)

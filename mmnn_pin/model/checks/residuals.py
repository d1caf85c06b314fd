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
from ..base.rolling import Maps, new_maps, roll
from ..base.steered import SteeredBase
from ..reduction import COULOMB_SPEED
from ..robot import Robot

EXACT = 1e-9  # of residuals of algebra
DEFINITE = 1e-12  # least eigenvalue of a mass matrix with ones on its diagonal
STEP = 1e-3  # of differences along a motion, times its largest rate
STEPS = 4  # between two times of a motion
SLOW = 0.2  # a base that steers moves so much slower: its steering has stops, and small casters turn fast
STENCIL = ((-2, 1 / 12), (-1, -8 / 12), (1, 8 / 12), (2, -1 / 12))  # fourth-order central difference


class FullTerms:
    """The matrices of one robot at a state, in the full model's velocities (2.11) and reduced by T (2.23)-(2.25).

    The checks ask here for everything that they judge; a subclass can replace a term by a wrong one.

    Args:
        robot: The robot.
    """

    def __init__(self, robot: Robot) -> None:
        self.robot, self.model, self.data = robot, robot.model, robot.model.createData()
        self.maps, self.still = new_maps(robot.rolling, robot.template), np.zeros(robot.dimensions.dof)

    def position(self, q: Array) -> Array:
        """Position (nv,) of Pinocchio's q, its pose at the origin, continuous joints within half a turn."""
        at, root = self.robot.q_index, self.robot.dimensions.pose
        turns, position = self.robot.is_continuous.astype(bool), q[at]
        position[turns] = np.arctan2(q[at[turns] + 1], q[at[turns]])
        position[:root] = 0.0
        return np.asarray(position)

    def T(self, q: Array) -> Array:
        """Map from nu to all velocities, (nv, p)."""
        return self.rolled(q, self.still).T.copy()

    def Tdot(self, q: Array, nu: Array) -> Array:
        """Its rate, (nv, p)."""
        return self.rolled(q, nu).Tdot.copy()

    def A(self, q: Array) -> Array:
        """Constraint rows, (nc or more, nv)."""
        return self.robot.A_at(self.position(q))

    def rolled(self, q: Array, nu: Array) -> Maps:
        """The maps of the base; u of a swerve drive counts as it did where they were asked for before."""
        if self.robot.rolling is not None:
            roll(self.robot.rolling, self.position(q), nu, self.maps)
        return self.maps

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

    def friction(self, q: Array, nu: Array) -> Array:
        """Friction of joints and base on nu, (p,), opposing the motion."""
        robot, T = self.robot, self.T(q)
        v = T @ nu
        return T.T @ (robot.damping * v + robot.dry_friction(v) * np.tanh(v / COULOMB_SPEED)) + robot.viscous * nu

    def reduced_mass(self, q: Array) -> Array:
        """Mbar = T' M T, (p, p)."""
        T = self.T(q)
        return np.asarray(T.T @ self.mass(q) @ T)

    def reduced_coriolis(self, q: Array, nu: Array) -> Array:
        """Cbar = T' (C T + M Tdot), (p, p); T is constant in body velocities where nothing steers."""
        T = self.T(q)
        reduced = T.T @ self.coriolis(q, T @ nu) @ T
        return np.asarray(reduced + T.T @ self.mass(q) @ self.Tdot(q, nu) if self.robot.steers else reduced)


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
    The residual is divided by the sum of the magnitudes of all powers, integrated. A base that steers moves slowly, and
    wheels that have to agree are not steered.
    """
    x, w = np.polynomial.legendre.leggauss(nodes)
    duration = 0.5
    motion = SineMotion.random(terms.robot.dimensions.dof, rng)
    if isinstance(terms.robot.base, SteeredBase):
        motion.a[: terms.robot.dimensions.base] *= SLOW
        if terms.robot.base.agree:
            motion.a[1 : terms.robot.dimensions.base] = 0.0
    net, total, fed = 0.0, 0.0, 0.0
    times = (1 + x) * duration / 2
    start, *along, end = configurations_along(terms, position, motion, np.array([0.0, *times, duration]))
    for t, weight, q in zip(times, w * duration / 2, along, strict=True):
        nu, nudot = motion.nu(t), motion.nudot(t)
        friction = float(nu @ terms.friction(q, nu))
        conservative = (
            float(nu @ terms.reduced_mass(q) @ nudot),
            float(nu @ terms.reduced_coriolis(q, nu) @ nu),
            float(nu @ (terms.T(q).T @ terms.gravity(q))),
        )
        net += weight * sum(conservative)
        fed += weight * max(0.0, -friction)
        total += weight * (sum(map(abs, conservative)) + abs(friction))
    gained = energy_of(terms, end, motion.nu(duration)) - energy_of(terms, start, motion.nu(0.0))
    return (abs(gained - net) + fed) / max(total, np.finfo(float).tiny)


def configurations_along(terms: FullTerms, position: Array, motion: SineMotion, times: Array) -> list[Array]:
    """Pinocchio's q at times of a motion; the base stays at its place, on which no energy depends, and turns."""
    robot, found = terms.robot, list[Array]()
    if not robot.steers:
        return [robot.configuration(moved_by(robot, position, terms.T(position) @ motion.travel(t))) for t in times]

    def rate(t: float, at: Array) -> Array:
        return moved_by(robot, np.zeros(at.size), terms.T(robot.configuration(at)) @ motion.nu(t))

    here, now = position.copy(), float(times[0])
    for t in times:
        h = (float(t) - now) / STEPS
        for _ in range(STEPS if h else 0):  # Runge and Kutta
            k1 = rate(now, here)
            k2 = rate(now + h / 2, here + h / 2 * k1)
            k3 = rate(now + h / 2, here + h / 2 * k2)
            here = here + h / 6 * (k1 + 2 * k2 + 2 * k3 + rate(now + h, here + h * k3))
            now += h
        found.append(robot.configuration(here))
    return found


def moved_by(robot: Robot, position: Array, travel: Array) -> Array:
    """A position (nv,) after a travel of all joints; the base turns and stays at its place."""
    travel[: max(0, robot.dimensions.pose - 1)] = 0.0
    return position + travel


def energy_of(terms: FullTerms, q: Array, nu: Array) -> float:
    """Kinetic and potential energy at Pinocchio's q [J]."""
    return float(nu @ terms.reduced_mass(q) @ nu) / 2 + terms.potential(q)

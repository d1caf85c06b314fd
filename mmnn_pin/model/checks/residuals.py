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
from ..base.rolling import new_maps, roll
from ..base.steered import SteeredBase
from ..reduction import COULOMB_SPEED
from ..robot import Robot

EXACT = 1e-9  # of residuals of algebra
DEFINITE = 1e-12  # least eigenvalue of a mass matrix with ones on its diagonal
STEP = 1e-3  # of differences along a motion, times its largest rate
TURNING = 4.0  # rate of a caster that 24 nodes over half a second are enough for [rad/s]
ROLLED = 2e-3  # longest step of an integration [s]
STENCIL = ((-2, 1 / 12), (-1, -8 / 12), (1, 8 / 12), (2, -1 / 12))  # fourth-order central difference


class FullTerms:
    """The matrices of one robot at a state, in the full model's velocities (2.11) and reduced by T (2.23)-(2.25).

    The checks ask here for everything that they judge; a subclass can replace a term by a wrong one.

    Args:
        robot: The robot.

    Attributes:
        T: (nv, p) as at the place last taken.
        A: Constraint rows there.
    """

    def __init__(self, robot: Robot) -> None:
        self.robot, self.model, self.data = robot, robot.model, robot.model.createData()
        self.maps = new_maps(robot.rolling, robot.template)
        self.T, self.A = robot.T_at(robot.rest), robot.A_at(robot.rest)

    def take(self, position: Array) -> None:
        """Take a place, (nv,): T and A of a base that steers are of there, and u keeps its sign from there on."""
        if self.robot.steers:
            self.maps.n[:] = 0.0
            self.T, self.A = self.motions(position, np.zeros(self.robot.dimensions.dof))[0], self.robot.A_at(position)

    def motions(self, position: Array, nu: Array) -> tuple[Array, Array]:
        """T, (nv, p), and its rate under nu (p,), at a position (nv,) of which only pivots matter."""
        if self.robot.rolling is None:
            return self.T, np.zeros_like(self.T)
        roll(self.robot.rolling, position, nu, self.maps)
        return self.maps.T.copy(), self.maps.Tdot.copy()

    def motions_at(self, q: Array, nu: Array) -> tuple[Array, Array]:
        """Likewise at Pinocchio's q."""
        robot, position = self.robot, self.robot.rest.copy()
        for place in robot.shape_index:
            i = robot.q_index[place]
            position[place] = np.arctan2(q[i + 1], q[i]) if robot.is_continuous[place] else q[i]
        return self.motions(position, nu)

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
        robot, T = self.robot, self.motions_at(q, nu)[0]
        v = T @ nu
        return T.T @ (robot.damping * v + robot.dry_friction(v) * np.tanh(v / COULOMB_SPEED)) + robot.viscous * nu

    def reduced_mass(self, q: Array) -> Array:
        """Mbar = T' M T, (p, p)."""
        T, _ = self.motions_at(q, np.zeros(self.robot.dimensions.dof))
        return T.T @ self.mass(q) @ T

    def reduced_coriolis(self, q: Array, nu: Array) -> Array:
        """Cbar = T' (C T + M Tdot), (p, p); where nothing steers, T is constant in body velocities."""
        T, Tdot = self.motions_at(q, nu)
        reduced = T.T @ self.coriolis(q, T @ nu) @ T
        return reduced + T.T @ self.mass(q) @ Tdot if self.robot.steers else reduced

    def reduced_gravity(self, q: Array) -> Array:
        """Gravity on nu, (p,)."""
        return self.motions_at(q, np.zeros(self.robot.dimensions.dof))[0].T @ self.gravity(q)


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
    """Largest `|A T|`, each entry over the sum of the magnitudes that should cancel in it: thesis (2.17)."""
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

    def without(self, places: IntArray) -> SineMotion:
        """The motion with some velocities at 0."""
        a = self.a.copy()
        a[places] = 0.0
        return SineMotion(a, self.b, self.c)


def energy_leak(terms: FullTerms, position: Array, rng: np.random.Generator, nodes: int = 24) -> float:
    """Passivity: energy gained along a random motion, minus the work of the torques and the loss by friction.

    The motion is a sum of sines over half a second, shorter where casters whirl, the torque the one that drives it,
    `tau = Mbar nudot + Cbar nu + gravity + friction` (2.23), the work its integral by Gauss-Legendre. Friction that
    feeds energy counts as a leak. The residual is divided by the sum of the magnitudes of all powers, integrated.
    """
    x, w = np.polynomial.legendre.leggauss(nodes)
    motion = SineMotion.random(terms.robot.dimensions.dof, rng).without(overdetermined(terms.robot))
    swing = abs(terms.T[terms.robot.shape_index]) @ abs(motion.a)
    duration = 0.5 / max(1.0, swing.max(initial=0.0) / TURNING)
    net, total, fed = 0.0, 0.0, 0.0
    times = (1 + x) * duration / 2
    *along, last = configurations_along(terms, position, motion, np.append(times, duration))
    for q, t, weight in zip(along, times, w * duration / 2, strict=True):
        nu, nudot = motion.nu(t), motion.nudot(t)
        friction = float(nu @ terms.friction(q, nu))
        conservative = (
            float(nu @ terms.reduced_mass(q) @ nudot),
            float(nu @ terms.reduced_coriolis(q, nu) @ nu),
            float(nu @ terms.reduced_gravity(q)),
        )
        net += weight * sum(conservative)
        fed += weight * max(0.0, -friction)
        total += weight * (sum(map(abs, conservative)) + abs(friction))
    first = terms.robot.configuration(position)
    gained = energy_at(terms, last, motion.nu(duration)) - energy_at(terms, first, motion.nu(0.0))
    return (abs(gained - net) + fed) / max(total, np.finfo(float).tiny)


def configurations_along(terms: FullTerms, position: Array, motion: SineMotion, times: Array) -> list[Array]:
    """Pinocchio's q at times of a motion; the base stays at its place, on which no energy depends, and turns.

    Where nothing steers, joints are integrals of sines; else they are integrated by steps of `ROLLED`.
    """
    robot, found, now = terms.robot, list[Array](), 0.0
    still = np.arange(max(0, robot.dimensions.pose - 1))
    for t in times:
        if robot.steers:
            steps = int(np.ceil((t - now) / ROLLED))
            for k in range(steps):
                position = rolled(terms, position, motion, now + k * (t - now) / steps, (t - now) / steps)
            now, there = t, position.copy()
        else:
            there = position + terms.T @ motion.travel(t)
        there[still] = position[still]
        found.append(robot.configuration(there))
    return found


def rolled(terms: FullTerms, position: Array, motion: SineMotion, t: float, h: float) -> Array:
    """The position (nv,) a step of the classical Runge-Kutta method later."""

    def rate(there: Array, then: float) -> Array:
        nu = motion.nu(then)
        return terms.motions(there, nu)[0] @ nu

    k1 = rate(position, t)
    k2 = rate(position + h / 2 * k1, t + h / 2)
    k3 = rate(position + h / 2 * k2, t + h / 2)
    return np.asarray(position + h / 6 * (k1 + 2 * k2 + 2 * k3 + rate(position + h * k3, t + h)))


def overdetermined(robot: Robot) -> IntArray:
    """Steering rates of which not each may be anything, as all wheels steer and more than two: places in nu."""
    base, nb = robot.base, robot.dimensions.base
    if not isinstance(base, SteeredBase) or not base.sideways or len(base.masters) <= 2:
        return np.zeros(0, np.int64)
    return np.arange(nb - len(base.masters), nb)


def energy_at(terms: FullTerms, q: Array, nu: Array) -> float:
    """Kinetic and potential energy [J]."""
    return float(nu @ terms.reduced_mass(q) @ nu) / 2 + terms.potential(q)

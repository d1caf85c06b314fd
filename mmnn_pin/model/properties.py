"""The properties that the thesis's proof rests on, as residuals: functions that return a number.

Every residual is scale-free. Mass matrices are judged as `D M D` with `D = diag(M)^(-1/2)`, which has ones on its
diagonal whatever the masses and units are, rates of them are divided by the rate of the motion, energies by the
energy that went to and fro. So one tolerance serves a robot of 3 kg and one of 300 kg.

`check_properties` takes the worst residual over random states: positions uniform within the limits (unlimited angles
within +-pi, other unlimited travel and the base's place within +-1 m), velocities standard normal in SI units. A sample
is not a proof: M_min, M_max and C_b are what was found, the true bounds may lie a little outside.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from ..signals import Array, IntArray
from .nonholonomy import Nonholonomy, nonholonomy
from .reduction import COULOMB_SPEED
from .robot import Robot
from .world_frame import WorldFrame

TOLERANCE = 1e-6  # of residuals of differences in time; rounding alone gives about 1e-10
EXACT = 1e-9  # of residuals of algebra
DEFINITE = 1e-12  # least eigenvalue of a mass matrix with ones on its diagonal
STEP = 1e-3  # of differences along a motion, times its largest rate
STENCIL = ((-2, 1 / 12), (-1, -8 / 12), (1, 8 / 12), (2, -1 / 12))  # fourth-order central difference


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
        return self.T.T @ (robot.damping * v + robot.coulomb * np.tanh(v / COULOMB_SPEED)) + robot.viscous * nu

    def reduced_mass(self, q: Array) -> Array:
        """Mbar = T' M T, (p, p)."""
        return self.T.T @ self.mass(q) @ self.T

    def reduced_coriolis(self, q: Array, nu: Array) -> Array:
        """Cbar = T' C T, (p, p); T is constant in body velocities."""
        return self.T.T @ self.coriolis(q, self.T @ nu) @ self.T


# -- residuals ------------------------------------------------------------------------------------------------------


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
    """How far rank A is from nv - p, in rows: fewer would permit motions that T does not know."""
    rows = A / np.maximum(np.linalg.norm(A, axis=1, keepdims=True), np.finfo(float).tiny)
    found = int(np.linalg.matrix_rank(rows, tol=EXACT)) if A.size else 0
    return float(abs(T.shape[0] - T.shape[1] - found))


def rate_along(function: Callable[[Array], Array], model: pin.Model, q: Array, v: Array, speed: float) -> Array:
    """Time derivative of a matrix along the motion from q with velocity v, by differences of fourth order."""
    h = STEP / speed
    return np.sum([weight * function(pin.integrate(model, q, i * h * v)) for i, weight in STENCIL], axis=0) / h


def world_rate_residual(world: WorldFrame, position: Array, nu: Array, speed: float) -> float:
    """Skewness of `Mbardot - 2 Cbar` in the thesis's world coordinates, where S turns and `S' M Sdot` counts (2.23)."""
    q = world.coordinates(position)
    qdot, h = world.null_space(q[2]) @ nu, STEP / speed
    # Any path through q with the rate qdot has this derivative; the straight one is the simplest.
    Mdot = np.sum([w * world.reduced_mass_matrix(q + i * h * qdot) for i, w in STENCIL], axis=0) / h
    return skewness(world.reduced_mass_matrix(q), Mdot, world.reduced_coriolis_matrix(q, nu), speed)


def energy_leak(terms: Terms, position: Array, rng: np.random.Generator, nodes: int = 24) -> float:
    """Passivity: energy gained along a random motion, minus the work of the torques and the loss by friction.

    The motion is a sum of sines over half a second, the torque the one that drives it, `tau = Mbar nudot + Cbar nu +
    gravity + friction` (2.23), the work its integral by Gauss-Legendre. Friction that feeds energy counts as a leak.
    The residual is divided by the sum of the magnitudes of all powers, integrated.
    """
    x, w = np.polynomial.legendre.leggauss(nodes)
    duration = 0.5
    motion = Motion.random(terms.robot.layout.dof, rng)
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


@dataclass(frozen=True)
class Motion:
    """A smooth motion of all independent velocities: `nu = a sin(b t + c)`, each (p,)."""

    a: Array
    b: Array
    c: Array

    @classmethod
    def random(cls, p: int, rng: np.random.Generator) -> Motion:
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


def configuration_along(terms: Terms, position: Array, motion: Motion, t: float) -> Array:
    """Pinocchio's q after a time of a motion; the base stays at its place, on which no energy depends, and turns."""
    root = terms.robot.layout.pose
    travel = terms.T @ motion.travel(t)
    travel[: max(0, root - 1)] = 0.0
    return terms.robot.configuration(position + travel)


def energy_at(terms: Terms, position: Array, motion: Motion, t: float) -> float:
    """Kinetic and potential energy after a time of a motion [J]."""
    q, nu = configuration_along(terms, position, motion, t), motion.nu(t)
    return float(nu @ terms.reduced_mass(q) @ nu) / 2 + terms.potential(q)


def weights(M: Array) -> Array:
    """What scales M, and rates of it, to ones on the diagonal: `1 / sqrt(M_ii M_jj)`, (p, p)."""
    diagonal = np.sqrt(abs(np.diag(M)))
    return 1.0 / np.maximum(np.outer(diagonal, diagonal), np.finfo(float).tiny)


def largest(values: Array) -> float:
    """Largest magnitude, nan where there is one; 0 of nothing."""
    return float(np.max(abs(values), initial=0.0))


# -- the check ------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Property:
    """One property over all samples.

    Attributes:
        worst: Worst residual.
        tolerance: What it may be.
        at_least: True where the residual must be above the tolerance, not below.
        means: The property in words.
    """

    worst: float
    tolerance: float
    at_least: bool
    means: str

    @property
    def passed(self) -> bool:
        """Whether the property holds; not a number never does."""
        return bool(self.worst > self.tolerance if self.at_least else self.worst <= self.tolerance)


# name: (tolerance, whether the residual must be above it, meaning)
PROPERTIES: dict[str, tuple[float, bool, str]] = {
    "symmetric": (EXACT, False, "M = M'"),
    "positive_definite": (DEFINITE, True, "least eigenvalue of M > 0, M with ones on its diagonal"),
    "property_1": (EXACT, False, "||C|| <= C_b ||qdot||: C is linear in the velocity"),
    "property_2": (TOLERANCE, False, "Mdot = C + C': Mdot - 2C is skew"),
    "property_3": (TOLERANCE, False, "the same for the blocks M_v of the base and M_r of the arm"),
    "property_4": (TOLERANCE, False, "Mdot_rv = C_rv + C_vr', M_vr = M_rv'"),
    "property_5": (TOLERANCE, False, "Mbardot_v - 2 Cbar_v is skew"),
    "reduced_rate": (TOLERANCE, False, "Mbardot - 2 Cbar is skew along motions"),
    "reduced_rate_world": (TOLERANCE, False, "the same in world coordinates, Cbar with S' M Sdot"),
    "constraint": (EXACT, False, "A S = 0: no motion that the wheels forbid"),
    "constraint_rank": (0.0, False, "rank A = nv - p: every motion that the wheels permit"),
    "full_rank": (EXACT, True, "least singular value of S > 0, S with columns of unit length"),
    "passive": (TOLERANCE, False, "energy gained = work of the torques - loss by friction >= 0"),
}


@dataclass(frozen=True)
class Bounds:
    """Bounds of property 1, estimated.

    Attributes:
        M_min: Smallest eigenvalue of the reduced mass matrix found, in SI units [kg, kg m^2 mixed].
        M_max: Largest.
        C_b: Largest `||Cbar|| / ||nu||` found.
    """

    M_min: float
    M_max: float
    C_b: float


@dataclass(frozen=True)
class Report:
    """What the checks found.

    Attributes:
        robot: Its name.
        samples: Number of random states.
        seed: Their seed.
        properties: Name to property, those that the robot can have.
        bounds: Estimated bounds.
        nonholonomic: The Frobenius test.
    """

    robot: str
    samples: int
    seed: int
    properties: dict[str, Property]
    bounds: Bounds
    nonholonomic: Nonholonomy

    @property
    def passed(self) -> bool:
        """Whether every property holds."""
        return all(found.passed for found in self.properties.values())


def check_properties(
    robot: Robot,
    samples: int = 100,
    seed: int = 0,
    *,
    terms: Terms | None = None,
    world: WorldFrame | None = None,
    progress: Callable[[float], None] | None = None,
) -> Report:
    """Check every property of a robot at random states.

    Args:
        robot: The robot.
        samples: Number of states.
        seed: Their seed.
        terms: The matrices to judge; None for Pinocchio's.
        world: The world-frame form to judge; None for ours (differential drives only).
        progress: Called now and then with the fraction done.
    """
    terms = terms or Terms(robot)
    if world is None and robot.base.kind == "differential_drive":
        world = WorldFrame(robot)
    rng = np.random.default_rng(seed)
    found = {"constraint": annihilation(terms.A, terms.T), "full_rank": independence(terms.T)}
    found["constraint_rank"] = missing_constraints(terms.A, terms.T)
    ranges: list[Array] = []
    for k in range(samples):
        position, v, nu = random_state(robot, rng)
        numbers = residuals_at(terms, position, v, nu)
        if world is not None:
            numbers["reduced_rate_world"] = world_rate_residual(world, position, nu, fastest(terms.T @ nu))
        numbers["passive"] = energy_leak(terms, position, rng)
        for name, value in numbers.items():
            found[name] = worse(found.get(name), value, PROPERTIES[name][1])
        ranges.append(bounds_at(terms, position, nu))
        if progress is not None:
            progress((k + 1) / samples)
    properties = {name: Property(found[name], *PROPERTIES[name]) for name in PROPERTIES if name in found}
    low, high, coriolis = np.array(ranges).T
    bounds = Bounds(float(low.min()), float(high.max()), float(coriolis.max()))
    return Report(robot.name, samples, seed, properties, bounds, nonholonomy(robot, rng))


def worse(a: float | None, b: float, at_least: bool) -> float:
    """The worse of two residuals; nan is worst of all."""
    if a is None or np.isnan(b):
        return b
    if np.isnan(a):
        return a
    return min(a, b) if at_least else max(a, b)


def random_state(robot: Robot, rng: np.random.Generator) -> tuple[Array, Array, Array]:
    """Position (nv,), a velocity of the full model (nv,) and one that the wheels permit, nu (p,); see the top."""
    free = np.isinf(robot.lower) | np.isinf(robot.upper)
    reach = np.where(robot.is_continuous.astype(bool) | revolute(robot), np.pi, 1.0)
    rest = robot.neutral_position()
    lower, upper = np.where(free, rest - reach, robot.lower), np.where(free, rest + reach, robot.upper)
    lower, upper = np.maximum(lower, robot.lower), np.minimum(upper, robot.upper)
    position = robot.follow(rng.uniform(lower, upper))
    return position, rng.standard_normal(robot.layout.full), rng.standard_normal(robot.layout.dof)


def revolute(robot: Robot) -> Array:
    """Which positions are angles, (nv,) bool."""
    root = robot.layout.pose
    kinds = [joint.shortname().removeprefix("JointModel") for joint in robot.model.joints][2 if root else 1 :]
    return np.array([False, False, True][:root] + ["R" in kind for kind in kinds])


def residuals_at(terms: Terms, position: Array, v: Array, nu: Array) -> dict[str, float]:
    """Residuals of M and C at one state, of the full model moving with v and of the reduced one moving with nu."""
    robot, model = terms.robot, terms.model
    q, speed = robot.configuration(position), fastest(v)
    M, C = terms.mass(q), terms.coriolis(q, v)
    Mdot = rate_along(terms.mass, model, q, v, speed)
    arm = robot.arm_index
    base = np.setdiff1d(np.arange(len(M)), arm)
    numbers = {
        "symmetric": asymmetry(M),
        "positive_definite": smallest_eigenvalue(M),
        "property_1": nonlinearity(lambda v: terms.coriolis(q, v), v, M, speed),
        "property_2": skewness(M, Mdot, C, speed),
        "property_3": max(block_residual(M, Mdot, C, speed, part) for part in (base, arm)),
    }
    if base.size and arm.size:
        numbers["property_4"] = cross_residual(M, Mdot, C, speed, base, arm)
    moving = terms.T @ nu
    speed = fastest(moving)
    Mbar, Cbar = terms.reduced_mass(q), terms.reduced_coriolis(q, nu)
    rate = rate_along(terms.reduced_mass, model, q, moving, speed)
    numbers["reduced_rate"] = skewness(Mbar, rate, Cbar, speed)
    nb = robot.layout.base
    if nb:
        numbers["property_5"] = block_residual(Mbar, rate, Cbar, speed, np.arange(nb))
    return numbers


def block_residual(M: Array, Mdot: Array, C: Array, speed: float, part: IntArray) -> float:
    """Properties 1 and 2 of one block: asymmetry, skewness, and 1 where it is not positive definite."""
    at = np.ix_(part, part)
    if smallest_eigenvalue(M[at]) <= DEFINITE:
        return 1.0
    return max(asymmetry(M[at]), skewness(M[at], Mdot[at], C[at], speed))


def bounds_at(terms: Terms, position: Array, nu: Array) -> Array:
    """Least and largest eigenvalue of Mbar, and the largest `||Cbar|| / ||nu||` of nu and of every velocity alone."""
    q = terms.robot.configuration(position)
    M = terms.reduced_mass(q)
    C = np.array([terms.reduced_coriolis(q, d) for d in (nu / np.linalg.norm(nu), *np.eye(nu.size))])
    if not (np.isfinite(M).all() and np.isfinite(C).all()):
        return np.full(3, np.nan)
    eigenvalues = np.linalg.eigvalsh(M)
    return np.array([eigenvalues[0], eigenvalues[-1], np.linalg.norm(C, 2, axis=(1, 2)).max()])


def fastest(v: Array) -> float:
    """Largest rate of a motion, at least 1e-3 [rad/s or m/s]."""
    return max(1e-3, largest(v))

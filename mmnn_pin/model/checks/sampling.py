"""One random state of a robot, and all residuals and bounds there.

Positions are uniform within the limits (unlimited angles within +-pi, other unlimited travel and the base's place
within +-1 m), velocities standard normal in SI units.
"""

from __future__ import annotations

import numpy as np

from ...signals import Array
from ..robot import Robot
from .residuals import (
    STENCIL,
    STEP,
    asymmetry,
    block_residual,
    cross_residual,
    largest,
    nonlinearity,
    rate_along,
    skewness,
    smallest_eigenvalue,
)
from .terms import Terms
from .world_frame import WorldFrame


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


def world_rate_residual(world: WorldFrame, position: Array, nu: Array, speed: float) -> float:
    """Skewness of `Mbardot - 2 Cbar` in the thesis's world coordinates, where S turns and `S' M Sdot` counts (2.23)."""
    q = world.coordinates(position)
    qdot, h = world.null_space(q[2]) @ nu, STEP / speed
    # Any path through q with the rate qdot has this derivative; the straight one is the simplest.
    Mdot = np.sum([w * world.reduced_mass_matrix(q + i * h * qdot) for i, w in STENCIL], axis=0) / h
    return skewness(world.reduced_mass_matrix(q), Mdot, world.reduced_coriolis_matrix(q, nu), speed)


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

"""The properties that the thesis's proof rests on, checked at random states.

`check_properties` takes the worst residual (`residuals`, `passivity`) over random states (`sampling`). A sample is not
a proof: M_min, M_max and C_b are what was found, the true bounds may lie a little outside.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from ...signals import Array
from ..robot import Robot
from .nonholonomy import Nonholonomy, nonholonomy
from .passivity import energy_leak
from .residuals import DEFINITE, EXACT, annihilation, independence, missing_constraints
from .sampling import bounds_at, fastest, random_state, residuals_at, world_rate_residual
from .terms import Terms
from .world_frame import WorldFrame

TOLERANCE = 1e-6  # of residuals of differences in time; rounding alone gives about 1e-10


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

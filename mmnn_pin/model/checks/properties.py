"""The properties that the thesis's proof rests on, checked at random states.

`check` takes the worst of the `residuals` over random states. A sample is not a proof: M_min, M_max and C_b
are what was found, the true bounds may lie a little outside. Positions are uniform within the limits (unlimited angles
within +-pi, other unlimited travel and the base's place within +-1 m), what is locked stands where it is locked,
velocities are standard normal in SI units.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

import numpy as np

from ...errors import ConfigError, RobotError, UnknownName
from ...settings.arguments import checked
from ...shown import AsText, shown
from ...signals import Array
from ..base.report import NO_FRICTION
from ..base.steered import SteeredBase
from ..robot import Robot, revolute
from .nonholonomy import Nonholonomy, nonholonomy
from .residuals import (
    DEFINITE,
    EXACT,
    STENCIL,
    STEP,
    FullTerms,
    annihilation,
    asymmetry,
    block_residual,
    cross_residual,
    energy_leak,
    independence,
    largest,
    missing_constraints,
    nonlinearity,
    overdetermined,
    rate_along,
    skewness,
    smallest_eigenvalue,
)
from .second_answers import SecondKinematics, WorldFrame

PLACED = 5  # states at which placements are compared: yourdfpy takes its time
HUGE_TURN, HUGE_TRAVEL = 80 * np.pi, 40.0  # travel [rad, m] beyond which a limit is none
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
    "coriolis_linear": (EXACT, False, "property 1: ||C|| <= C_b ||qdot||: C is linear in the velocity"),
    "skew_symmetry": (TOLERANCE, False, "property 2: Mdot = C + C': Mdot - 2C is skew"),
    "skew_symmetry_blocks": (
        TOLERANCE,
        False,
        "property 3: the same for the blocks M_v of the base and M_r of the arm",
    ),
    "skew_symmetry_cross": (TOLERANCE, False, "property 4: Mdot_rv = C_rv + C_vr', M_vr = M_rv'"),
    "skew_symmetry_base": (TOLERANCE, False, "property 5: Mbardot_v - 2 Cbar_v is skew"),
    "reduced_rate": (TOLERANCE, False, "Mbardot - 2 Cbar is skew along motions"),
    "reduced_rate_world": (TOLERANCE, False, "the same in world coordinates, Cbar with S' M Sdot"),
    "constraint": (EXACT, False, "A T = 0: no motion that the wheels forbid"),
    "constraint_rank": (0.0, False, "rank A = nv - p: every motion that the wheels permit"),
    "full_rank": (EXACT, True, "least singular value of S > 0, S with columns of unit length"),
    "passive": (TOLERANCE, False, "energy gained = work of the torques - loss by friction >= 0"),
    "forward_kinematics": (EXACT, False, "yourdfpy places every link where Pinocchio does"),
}


BOUNDS = {  # name: (whether the bound found must be above one's own, meaning)
    "M_min": (True, "least eigenvalue of Mbar found, at least your bound"),
    "M_max": (False, "largest eigenvalue of Mbar found, at most your bound"),
    "C_b": (False, "largest ||Cbar|| / ||nu|| found, at most your bound"),
}


@dataclass(frozen=True)
class ModelBounds:
    """Bounds of property 1, estimated."""

    M_min: float  # smallest eigenvalue of the reduced mass matrix found, in SI units [kg, kg m^2 mixed]
    M_max: float  # largest
    C_b: float  # largest `||Cbar|| / ||nu||` found


@dataclass(frozen=True, repr=False)
class CheckReport(AsText):
    """The properties of one robot at all samples; `print` shows every one."""

    robot: str  # its name
    samples: int  # number of random states
    seed: int  # their seed
    properties: dict[str, Property]  # name to property, those that the robot can have
    bounds: ModelBounds  # estimated bounds
    nonholonomic: Nonholonomy  # the Frobenius test
    skipped: Mapping[str, str] = field(default_factory=dict)  # properties that could not be checked, and why
    notes: tuple[str, ...] = ()  # what to know of the states that were drawn, and of the robot

    @property
    def passed(self) -> bool:
        """Whether every property holds."""
        return all(found.passed for found in self.properties.values())

    def __repr__(self) -> str:
        failed = [name for name, found in self.properties.items() if not found.passed]
        end = f"{', '.join(failed)} failed" if failed else f"all {len(self.properties)} properties hold"
        return f"<Report: {self.robot}, {end} at {self.samples} states>"

    def __str__(self) -> str:
        return str(shown(self, "text"))


@checked
def check(
    robot: Robot,
    samples: int = 100,
    seed: int = 0,
    *,
    bounds: Mapping[str, float] | None = None,
    terms: FullTerms | None = None,
    world: WorldFrame | None = None,
    placements: bool = True,
    progress: Callable[[float], None] | None = None,
) -> CheckReport:
    """Check every property of a robot at random states.

    Args:
        robot: The robot.
        samples: Number of states.
        seed: Their seed.
        bounds: Bounds of your own that must hold, as a proof has them: `M_min`, `M_max`, `C_b`, see `ModelBounds`.
        terms: The matrices to judge; None for Pinocchio's.
        world: The world-frame form to judge; None for ours (bases with two sides only).
        placements: Whether yourdfpy, which is slow to import, places the links, too.
        progress: Called now and then with the fraction done.

    Raises:
        ConfigError: Fewer than one state, or a bound that is no positive number.
        UnknownName: A bound of another name.

    >>> report = check(load("platform_arm"), samples=3)
    >>> report.passed
    True
    >>> report.properties["symmetric"].worst < 1e-9
    True
    """
    if samples < 1:
        raise ConfigError(f"{samples} states", fix="give at least 1", key="samples")
    own = required_bounds(bounds or {})
    terms, kinematics, skipped = terms or FullTerms(robot), None, dict[str, str]()
    if world is None and robot.base.two_sided:
        world = WorldFrame(robot)
    try:
        if placements:
            kinematics = SecondKinematics(robot)
        else:
            skipped["forward_kinematics"] = "slow; mmnn check compares it"
    except RobotError as error:
        skipped["forward_kinematics"] = ": ".join(filter(None, (error.what, error.why)))
    rng = np.random.default_rng(seed)
    found: dict[str, float] = {}
    ranges: list[Array] = []
    for k in range(samples):
        position, v, nu = random_state(robot, rng)
        terms.take(position)
        numbers = residuals_at(terms, position, v, nu)
        if robot.steers or not k:
            numbers |= {"constraint": annihilation(terms.A, terms.T), "full_rank": independence(terms.T)}
            numbers["constraint_rank"] = missing_constraints(terms.A, terms.T)
        if world is not None:
            numbers["reduced_rate_world"] = world_rate_residual(world, position, nu, fastest(terms.T @ nu))
        numbers["passive"] = energy_leak(terms, position, rng)
        if kinematics is not None and k < PLACED:
            numbers["forward_kinematics"] = kinematics.residual(position)
        for name, value in numbers.items():
            found[name] = worse(found.get(name), value, PROPERTIES[name][1])
        ranges.append(bounds_at(terms, position, nu))
        if progress is not None:
            progress((k + 1) / samples)
    properties = {name: Property(found[name], *PROPERTIES[name]) for name in PROPERTIES if name in found}
    low, high, coriolis = np.array(ranges).T
    met = ModelBounds(float(low.min()), float(high.max()), float(coriolis.max()))
    properties |= {name: Property(getattr(met, name), value, *BOUNDS[name]) for name, value in own.items()}
    return CheckReport(robot.name, samples, seed, properties, met, nonholonomy(robot, rng), skipped, notes_of(robot))


def required_bounds(bounds: Mapping[str, float]) -> Mapping[str, float]:
    """Bounds that somebody gives, if they are some.

    Raises:
        ConfigError: One is no positive number.
        UnknownName: One has another name.
    """
    for name, value in bounds.items():
        if name not in BOUNDS:
            raise UnknownName("bound", name, BOUNDS, key="bounds")
        if not 0 < value < np.inf:
            raise ConfigError(f"{value:g} is no bound", fix="give a positive number", key=name)
    return bounds


def notes_of(robot: Robot) -> tuple[str, ...]:
    """Notes on limits that were not taken at their word where states were drawn, and on no friction."""
    names = zip(robot.position_names, unlimited(robot), robot.lower, strict=True)
    wide = ", ".join(name for name, free, low in names if free and np.isfinite(low))
    notes = [f"limits too wide to be meant, positions drawn within +-pi or +-1 m: {wide}"] if wide else []
    smooth = not (robot.damping.any() or robot.coulomb.any() or robot.viscous.any())
    return (*notes, *[f"note: {NO_FRICTION}: nothing is lost in `passive`"] * smooth)


def worse(a: float | None, b: float, at_least: bool) -> float:
    """The worse of two residuals; nan is worst of all."""
    if a is None or np.isnan(b):
        return b
    if np.isnan(a):
        return a
    return min(a, b) if at_least else max(a, b)


# -- one random state --------------------------------------------------------------------------------------------------


def random_state(robot: Robot, rng: np.random.Generator) -> tuple[Array, Array, Array]:
    """Position (nv,), a velocity of the full model (nv,) and one that the wheels permit, nu (p,); see the top."""
    reach = np.where(robot.is_continuous.astype(bool) | revolute(robot), np.pi, 1.0)
    free = unlimited(robot)
    rest = robot.neutral_position()
    lower, upper = np.where(free, rest - reach, robot.lower), np.where(free, rest + reach, robot.upper)
    lower = np.where(free, np.maximum(lower, robot.lower), robot.lower)
    upper = np.where(free, np.minimum(upper, robot.upper), robot.upper)
    still = np.isin(robot.position_names, list(robot.arm.locked))
    lower, upper = np.where(still, rest, lower), np.where(still, rest, upper)  # a locked joint's may be swapped
    position = agreeing(robot, robot.follow(rng.uniform(lower, upper)), rng)
    return position, rng.standard_normal(robot.dimensions.full), rng.standard_normal(robot.dimensions.dof)


def agreeing(robot: Robot, position: Array, rng: np.random.Generator) -> Array:
    """The position, (nv,), changed in place: where more than two masters steer, their axles meet in one place."""
    if isinstance(base := robot.base, SteeredBase) and overdetermined(robot).size:
        vx, vy, w = rng.standard_normal(3)
        for pivot in (base.pivots[k] for k in base.masters):
            path = np.arctan2(vy + pivot.x * w, vx - pivot.y * w)
            position[robot.rows[pivot.joint]] = pivot.sign * (path - pivot.wheel[2])
    return position


def unlimited(robot: Robot) -> Array:
    """Which positions have no limits, or such as nobody means: wider than 40 turns, or 40 m, (nv,) bool."""
    with np.errstate(invalid="ignore", over="ignore"):
        travel = robot.upper - robot.lower
    return np.asarray(~(travel <= np.where(revolute(robot), HUGE_TURN, HUGE_TRAVEL)))


def residuals_at(terms: FullTerms, position: Array, v: Array, nu: Array) -> dict[str, float]:
    """Residuals of M and C at one state, of the full model moving with v and of the reduced one moving with nu."""
    robot, model = terms.robot, terms.model
    q, speed = robot.configuration(position), fastest(v)
    M, C = terms.mass(q), terms.coriolis(q, v)
    Mdot = rate_along(terms.mass, model, q, v, speed)
    arm = robot.arm_index
    carried = terms.T.any(axis=1) | (np.arange(len(M)) < robot.dimensions.pose)  # what is locked may have no mass
    base = np.setdiff1d(np.flatnonzero(carried | (np.diag(M) > 0)), arm)
    numbers = {
        "symmetric": asymmetry(M),
        "positive_definite": smallest_eigenvalue(M[np.ix_(carried, carried)]),
        "coriolis_linear": nonlinearity(lambda v: terms.coriolis(q, v), v, M, speed),
        "skew_symmetry": skewness(M, Mdot, C, speed),
        "skew_symmetry_blocks": max(block_residual(M, Mdot, C, speed, part) for part in (base, arm)),
    }
    if base.size and arm.size:
        numbers["skew_symmetry_cross"] = cross_residual(M, Mdot, C, speed, base, arm)
    moving = terms.T @ nu
    speed = fastest(moving)
    Mbar, Cbar = terms.reduced_mass(q), terms.reduced_coriolis(q, nu)
    rate = rate_along(terms.reduced_mass, model, q, moving, speed)
    numbers["reduced_rate"] = skewness(Mbar, rate, Cbar, speed)
    nb = robot.dimensions.base
    if nb:
        numbers["skew_symmetry_base"] = block_residual(Mbar, rate, Cbar, speed, np.arange(nb))
    return numbers


def world_rate_residual(world: WorldFrame, position: Array, nu: Array, speed: float) -> float:
    """Skewness of `Mbardot - 2 Cbar` in the thesis's world coordinates, where S turns and `S' M Sdot` counts (2.23)."""
    q = world.coordinates(position)
    qdot, h = world.null_space(q[2]) @ nu, STEP / speed
    # Any path through q with the rate qdot has this derivative; the straight one is the simplest.
    Mdot = np.sum([w * world.reduced_mass_matrix(q + i * h * qdot) for i, w in STENCIL], axis=0) / h
    return skewness(world.reduced_mass_matrix(q), Mdot, world.reduced_coriolis_matrix(q, nu), speed)


def bounds_at(terms: FullTerms, position: Array, nu: Array) -> Array:
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

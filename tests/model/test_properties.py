"""The property checks: they hold for every robot here, and each fails when its property is broken on purpose."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import sympy
from robots import fixed_arm, mobile_arm
from steered import LAYOUTS
from steered import robot_of as steered_robot
from test_holonomic import mecanum

from mmnn_pin import load
from mmnn_pin.errors import ConfigError, UnknownName
from mmnn_pin.model.checks.nonholonomy import bracket, involutive_closure, nonholonomy
from mmnn_pin.model.checks.properties import PROPERTIES, CheckReport, check, worse
from mmnn_pin.model.checks.residuals import (
    FullTerms,
    annihilation,
    asymmetry,
    missing_constraints,
    skewness,
    smallest_eigenvalue,
)
from mmnn_pin.model.checks.second_answers import WorldFrame
from mmnn_pin.model.dynamics import Dynamics
from mmnn_pin.model.robot import Robot
from mmnn_pin.signals import Array

ROBOTS = {
    "platform_arm": lambda: load("platform_arm"),
    "two_axis_arm": lambda: load("two_axis_arm"),
    "mobile": lambda: mobile_arm(5),
    "fixed": lambda: fixed_arm(5),
    "mecanum": mecanum,
}


def failed(report: CheckReport) -> set[str]:
    return {name for name, found in report.properties.items() if not found.passed}


@pytest.fixture(scope="module")
def mobile() -> Robot:
    return mobile_arm(3)


@pytest.mark.parametrize("name", ROBOTS)
def test_every_property_holds(name):
    robot = ROBOTS[name]()
    report = check(robot, samples=5, seed=1)
    assert not failed(report)
    assert 0 < report.bounds.M_min <= report.bounds.M_max and report.bounds.C_b > 0
    missing = {
        "two_axis_arm": {"skew_symmetry_cross", "skew_symmetry_base", "reduced_rate_world"},
        "fixed": {"skew_symmetry_cross", "skew_symmetry_base", "reduced_rate_world"},
        "mecanum": {"reduced_rate_world"},
    }.get(name, set()) - ({"reduced_rate_world"} if "reduced_rate_world" in report.properties else set())
    assert set(report.properties) == set(PROPERTIES) - missing


def test_one_tolerance_serves_any_mass(mobile):
    """Residuals stay, bounds scale: a robot of 1/100 and of 100 times the mass."""
    reports = [check(mobile.with_masses(factor), samples=4, seed=3) for factor in (0.01, 1.0, 100.0)]
    assert not any(map(failed, reports))
    for report in reports:
        assert all(p.worst < 1e-9 for name, p in report.properties.items() if not p.at_least)
    light, own, heavy = (report.bounds for report in reports)
    for name in ("M_min", "M_max", "C_b"):
        np.testing.assert_allclose([getattr(light, name) * 100, getattr(heavy, name) / 100], getattr(own, name))


@pytest.mark.parametrize("factor", [0.01, 100.0])
def test_one_tolerance_sees_a_small_fault_in_any_mass(mobile, factor):
    class Faulty(FullTerms):
        def coriolis(self, q: Array, v: Array) -> Array:
            return super().coriolis(q, v) * (1 + 1e-4)

    robot = mobile.with_masses(factor)
    assert "skew_symmetry" in failed(check(robot, 2, terms=Faulty(robot)))


class Asymmetric(FullTerms):
    def mass(self, q: Array) -> Array:
        M = super().mass(q)
        M[0, 1] += 1e-6 * M[0, 0]
        return M


class Indefinite(FullTerms):
    def mass(self, q: Array) -> Array:
        M = super().mass(q)
        M[-1, -1] *= -1
        return M


class Singular(FullTerms):
    def mass(self, q: Array) -> Array:
        M = super().mass(q)
        M[-1, :], M[:, -1] = M[-2, :], M[:, -2]
        M[-1, -1] = M[-2, -2]
        return M


class Quadratic(FullTerms):
    def coriolis(self, q: Array, v: Array) -> Array:
        return super().coriolis(q, v) * (1 + 0.01 * np.linalg.norm(v))


class NotChristoffel(FullTerms):
    """The same C v, but all of it in one column: no `Mdot = C + C'`."""

    def coriolis(self, q: Array, v: Array) -> Array:
        C = super().coriolis(q, v)
        return np.outer(C @ v, v) / (v @ v)


class OtherCross(FullTerms):
    """The coupling of base and arm broken, all blocks as they were."""

    def coriolis(self, q: Array, v: Array) -> Array:
        C = super().coriolis(q, v)
        last = self.robot.arm_index[-1]
        C[0, last] += 0.1 * v[last]
        return C


class OtherBase(FullTerms):
    def coriolis(self, q: Array, v: Array) -> Array:
        C = super().coriolis(q, v)
        C[2, 2] += 0.1 * v[2]
        return C


class NoCoriolis(FullTerms):
    def reduced_coriolis(self, q: Array, nu: Array) -> Array:
        return 0 * super().reduced_coriolis(q, nu)


class Antifriction(FullTerms):
    def friction(self, q: Array, nu: Array) -> Array:
        return -super().friction(q, nu) - 0.01 * nu


class NoGravity(FullTerms):
    def gravity(self, q: Array) -> Array:
        return 0 * super().gravity(q)


BROKEN = {
    Asymmetric: {"symmetric"},
    Indefinite: {"positive_definite", "skew_symmetry_blocks"},
    Singular: {"positive_definite", "skew_symmetry_blocks"},
    Quadratic: {"coriolis_linear", "skew_symmetry"},
    NotChristoffel: {"skew_symmetry", "skew_symmetry_blocks", "reduced_rate"},
    OtherCross: {"skew_symmetry", "skew_symmetry_cross", "reduced_rate"},
    OtherBase: {"skew_symmetry", "skew_symmetry_blocks", "skew_symmetry_base", "reduced_rate"},
    NoCoriolis: {"skew_symmetry_base", "reduced_rate", "passive"},
    Antifriction: {"passive"},
    NoGravity: {"passive"},
}


@pytest.mark.parametrize("terms", BROKEN, ids=lambda kind: kind.__name__)
def test_a_broken_property_is_seen(mobile, terms):
    found = failed(check(mobile, samples=3, seed=2, terms=terms(mobile)))
    assert found >= BROKEN[terms]
    blameless = {"constraint", "constraint_rank", "full_rank", "reduced_rate_world"}
    assert not found & blameless


def test_what_only_one_check_can_see(mobile):
    assert failed(check(mobile, samples=3, terms=Antifriction(mobile))) == {"passive"}
    assert failed(check(mobile, samples=3, terms=NoGravity(mobile))) == {"passive"}
    cross = failed(check(mobile, samples=3, terms=OtherCross(mobile)))
    assert not cross & {"skew_symmetry_blocks", "skew_symmetry_base"}


def test_a_forgotten_sdot_is_seen(mobile):
    class NoSdot(WorldFrame):
        def null_space_rate(self, phi: float, phidot: float) -> Array:
            return 0 * super().null_space_rate(phi, phidot)

    assert failed(check(mobile, samples=3, world=NoSdot(mobile))) == {"reduced_rate_world"}


def test_a_wrong_t_is_seen(mobile):
    slipping, doubled = mobile.T.copy(), mobile.T.copy()
    slipping[1, 0] += 1e-6  # drives a little sideways
    doubled[:, 1] = 2 * doubled[:, 0]
    assert failed(check(replace(mobile, template=slipping), samples=2)) == {"constraint"}
    terms = FullTerms(mobile)
    terms.T = doubled
    assert "full_rank" in failed(check(mobile, samples=1, terms=terms))
    fewer = FullTerms(mobile)
    fewer.A = mobile.A[1:]
    assert failed(check(mobile, samples=2, terms=fewer)) == {"constraint_rank"}


def test_nan_never_passes(mobile):
    class Nan(FullTerms):
        def coriolis(self, q: Array, v: Array) -> Array:
            return np.nan * super().coriolis(q, v)

    assert {"coriolis_linear", "skew_symmetry", "passive"} <= failed(check(mobile, samples=2, terms=Nan(mobile)))
    assert np.isnan(worse(np.nan, 1.0, False)) and np.isnan(worse(1.0, np.nan, True))
    assert worse(None, 3.0, True) == 3.0 and worse(1.0, 2.0, False) == 2.0 and worse(1.0, 2.0, True) == 1.0


def test_residuals_by_hand():
    M = np.diag([4.0, 9e-6])
    assert asymmetry(M) == 0 and smallest_eigenvalue(M) == pytest.approx(1)
    M[0, 1] = 6e-3 * 0.5  # sqrt(4 9e-6) = 6e-3
    assert asymmetry(M) == pytest.approx(0.5) and smallest_eigenvalue(M) == pytest.approx(0.75)
    assert smallest_eigenvalue(np.diag([1.0, 0.0])) == -np.inf
    C = np.array([[2.0, 0.0], [0.0, 0.0]])
    assert skewness(np.eye(2), 2 * C, C, 1.0) == 0
    assert skewness(4 * np.eye(2), C, C, 2.0) == pytest.approx(2 / 4 / 2)
    A, T = np.array([[1.0, -1.0]]), np.array([[1.0], [1.0]])
    assert annihilation(A, T) == 0 and annihilation(A, np.array([[1.0], [0.0]])) == 1
    assert missing_constraints(A, T) == 0 and missing_constraints(np.zeros((0, 2)), T) == 1


def test_bounds_against_a_grid():
    """M of the two-axis arm depends on its second angle alone: a grid over it knows the bounds."""
    arm = load("two_axis_arm")
    dynamics = Dynamics(arm)
    grid = [dynamics.mass_matrix(np.array([0.0, q])) for q in np.linspace(arm.lower[1], arm.upper[1], 200)]
    eigenvalues = np.linalg.eigvalsh(grid)
    found = check(arm, samples=60, seed=5).bounds
    assert eigenvalues.min() <= found.M_min * (1 + 1e-9) <= 1.05 * eigenvalues.min()
    assert eigenvalues.max() >= found.M_max * (1 - 1e-9) >= 0.95 * eigenvalues.max()
    assert check(arm, samples=60, seed=5).bounds == found
    more = check(arm, samples=90, seed=5).bounds
    assert more.M_min <= found.M_min and more.C_b >= found.C_b


def test_progress_counts_to_one(mobile):
    said: list[float] = []
    check(mobile, samples=4, progress=said.append)
    assert said == [0.25, 0.5, 0.75, 1.0]


# -- nonholonomy ------------------------------------------------------------------------------------------------------


def test_differential_drive_is_nonholonomic(mobile):
    """Printed in the thesis: 2 grows to 3 (2.9), (2.10); with the wheel angles 4 of 5, one constraint integrates."""
    found = nonholonomy(mobile)
    assert found.pose is not None and found.with_wheels is not None
    assert found.pose.growth == (2, 3) and found.pose.coordinates == 3
    assert found.with_wheels.growth == (2, 3, 4) and found.with_wheels.coordinates == 5
    assert found.verdict.startswith("nonholonomic")


def test_other_bases():
    fixed = nonholonomy(fixed_arm(2))
    assert fixed.pose is None and fixed.with_wheels is None and fixed.verdict.startswith("fixed")
    free = nonholonomy(mecanum())
    assert free.pose is not None and free.pose.growth == (3,) and free.verdict.startswith("holonomic")


@pytest.mark.parametrize(("columns", "verdict"), [([0], "integrable"), ([1], "integrable"), ([0, 1], "nonholonomic")])
def test_a_base_on_rails_is_integrable(mobile, columns, verdict):
    """Only driving, or only turning: one direction is always involutive."""
    T = mobile.T.copy()
    T[:, [c for c in (0, 1) if c not in columns]] = 0.0
    assert nonholonomy(replace(mobile, template=T)).verdict.startswith(verdict)


SYSTEMS = {
    "heisenberg": (["1", "0", "-y/2"], ["0", "1", "x/2"]),
    "sphere": (["0", "-z", "y"], ["z", "0", "-x"]),
    "commuting": (["1", "0", "0"], ["0", "1", "0"]),
    "contact": (["1", "0", "y"], ["0", "1", "0"]),
    "car": (["cos(z)", "sin(z)", "0"], ["0", "0", "1"]),
    "flat": (["cos(y)", "0", "1"], ["0", "1", "0"]),
}


@pytest.mark.parametrize("name", SYSTEMS)
def test_closure_against_symbolic_brackets(name):
    x = sympy.Matrix(sympy.symbols("x y z"))
    f, g = (sympy.Matrix([sympy.sympify(part) for part in field]) for field in SYSTEMS[name])
    first = g.jacobian(x) * f - f.jacobian(x) * g
    exact = [f, g, first, *(first.jacobian(x) * h - h.jacobian(x) * first for h in (f, g))]
    points = np.random.default_rng(0).uniform(-1, 1, (4, 3))
    fields = [lambda at, h=h: np.array(sympy.lambdify(list(x), h)(*at), float).ravel() for h in exact]
    for at in points:
        np.testing.assert_allclose(bracket(fields[0], fields[1])(at), fields[2](at), atol=1e-8)
    expected = max(np.linalg.matrix_rank(np.stack([h(at) for h in fields], axis=1), tol=1e-9) for at in points)
    assert involutive_closure(fields[:2], points).closure == expected


# -- bases that steer --------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", LAYOUTS)
def test_a_base_that_steers_has_them_all(name):
    report = check(steered_robot(LAYOUTS[name]()), samples=3, seed=1)
    assert report.passed and report.nonholonomic.on == "posture", str(report)


class Frozen(FullTerms):
    """T as if nothing turned."""

    def motions(self, position: Array, nu: Array) -> tuple[Array, Array]:
        T, Tdot = super().motions(position, nu)
        return T, 0 * Tdot


class Askew(FullTerms):
    """T of where the pivots do not stand."""

    def motions(self, position: Array, nu: Array) -> tuple[Array, Array]:
        return super().motions(position + 1e-3, nu)


@pytest.mark.parametrize(
    ("terms", "found"), [(Frozen, {"reduced_rate", "skew_symmetry_base", "passive"}), (Askew, {"constraint"})]
)
def test_a_wrong_map_of_a_base_that_steers_is_seen(terms, found):
    robot = steered_robot(LAYOUTS["truck"]())
    assert found <= failed(check(robot, samples=3, terms=terms(robot)))


def test_the_posture_of_a_car_is_reached_by_brackets():
    """Campion's (1, 1): the rate of u and of the steering, then two brackets; a linkage adds no angle."""
    found = nonholonomy(steered_robot(LAYOUTS["car"]()))
    assert found.pose is not None and found.pose.growth == (2, 3, 4) and found.pose.coordinates == 4
    assert found.with_wheels is None and found.verdict.endswith("every posture can be reached")


def test_bounds_of_ones_own_hold_or_fail_with_the_number_found() -> None:
    robot = load("platform_arm")
    found = check(robot, 5).bounds
    report = check(robot, 5, bounds={"M_max": 1.01 * found.M_max, "C_b": 0.99 * found.C_b, "M_min": 0.99 * found.M_min})
    assert failed(report) == {"C_b"} and report.properties["C_b"].worst == found.C_b
    with pytest.raises(UnknownName, match="did you mean 'M_max'"):
        check(robot, 1, bounds={"M_mx": 1.0})
    with pytest.raises(ConfigError, match="M_max: error: 0 is no bound: give a positive number"):
        check(robot, 1, bounds={"M_max": 0.0})

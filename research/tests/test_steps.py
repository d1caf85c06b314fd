"""The periods of a loop to first order, and the bound of what that leaves out (theory.md, section 9)."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from attacks import told
from hypothesis import given, settings
from hypothesis import strategies as st
from proofs import KINDS, loop_of, subject_of
from robots import mobile_arm

from mmnn_pin import Timing, load
from mmnn_pin.model.dynamics import Dynamics
from mmnn_pin.signals import Array
from research.proof.curvature import Curvature
from research.proof.periods import Periods
from research.proof.screws import Bodies
from research.proof.steps import SIZES, Box, Steps
from research.proof.taylor import Taylor

E = 1e-5  # [m, rad, m/s, rad/s]
LATE = [*((kind, 0) for kind in KINDS), ("differential", 2)]


def steps_of(kind: str, late: int = 0) -> Steps:
    return Steps(Periods(subject_of(kind, loop_of(kind, duration=0.06).run())), late, 3)


@settings(deadline=None, max_examples=60)
@given(st.integers(0, 2**32 - 1), st.floats(1e-3, 1.0))
def test_what_a_formula_of_functions_leaves_is_within_its_bound(seed: int, size: float) -> None:
    """Sums, products and circular functions, at corners and inside, against the formula itself."""
    rng = np.random.default_rng(seed)
    box, (a, b, c, d) = size * rng.uniform(0, 1, (1, 3)), rng.uniform(-2, 2, 4)

    def formula(x: object, y: object, z: object, turned: object) -> object:
        cosine, sine = turned(x * a + y)  # type: ignore[operator]
        return cosine * y * b - sine * (z - x * y) + (c - x) * z + d * x  # type: ignore[operator]

    x, y, z = (Taylor.variable(i, box, value) for i, value in enumerate((0.3, -0.7, 1.1)))
    found = formula(x, y, z, Taylor.turned)
    assert isinstance(found, Taylor)
    for where in (*rng.choice((-1.0, 1.0), (20, 3)), *rng.uniform(-1, 1, (20, 3))):
        at = where * box[0]
        exact = formula(0.3 + at[0], -0.7 + at[1], 1.1 + at[2], lambda v: (np.cos(v), np.sin(v)))
        assert abs(exact - found.value[0] - found.slope[0] @ at) <= found.rest[0] + 1e-12  # type: ignore[operator]


@settings(deadline=None, max_examples=12)
@given(st.integers(0, 2**32 - 1), st.integers(1, 3))
def test_no_derivative_in_a_box_is_beyond_its_curvature(seed: int, joints: int) -> None:
    """Of M, C and gravity, entry by entry, by differences with Pinocchio; and of M and C times X."""
    rng, robot = np.random.default_rng(seed), mobile_arm(joints)
    dynamics, position, p = Dynamics(robot), robot.neutral_position(), robot.dimensions.dof
    q, half = rng.uniform(-1, 1, (1, joints)), rng.uniform(0, 0.3, (1, joints))
    found = Curvature.of(Bodies.of(robot), q, half, 0.1 * np.eye(p))
    moved, nu, other = np.zeros((1, joints)), *rng.uniform(-1, 1, (2, p))

    def terms(at: Array) -> tuple[Array, Array, Array]:
        position[robot.arm_index] = at
        where = robot.follow(position)
        return dynamics.mass_matrix(where), dynamics.coriolis_matrix(where, nu), dynamics.gravity(where)

    for where in (*rng.choice((-1.0, 1.0), (3, joints)), *rng.uniform(-1, 1, (2, joints))):
        here, a = q[0] + where * half[0], int(rng.integers(joints))
        step = 1e-4 * np.eye(joints)[a]
        before, at, after = (terms(here + sign * step) for sign in (-1.0, 0.0, 1.0))
        moved[:] = np.eye(joints)[a]
        bent = found.along(moved)
        by_nu = np.einsum("ijl,j->il", bent.C1[0], np.abs(nu))
        once = [(c - b) / 2e-4 for b, c in zip(before, after, strict=True)]
        twice = [(c - 2 * m + b) / 2e-8 for b, m, c in zip(before, at, after, strict=True)]
        for value, bound in zip(once, (bent.M1[0], by_nu, bent.g1[0]), strict=True):
            assert (np.abs(value) <= bound + 1e-6).all()
        by_nu = np.einsum("ijl,j->il", bent.C2[0], np.abs(nu))
        for value, bound in zip(twice, (bent.M2[0], by_nu, bent.g2[0]), strict=True):
            assert (np.abs(value) <= bound + 1e-5).all()
        C = np.einsum("ijl,j,l->i", bent.C0[0], np.abs(nu), np.abs(other))
        assert (np.abs(at[1] @ other) <= C + 1e-9).all()
        assert (np.abs(found.X[0] @ once[0]) <= bent.XM1[0] + 1e-5).all()
        assert (np.abs(found.X[0] @ at[1]) <= np.einsum("ijl,j->il", bent.XC0[0], np.abs(nu)) + 1e-8).all()
        assert (np.abs(found.X[0] @ once[1]) <= np.einsum("ijl,j->il", bent.XC1[0], np.abs(nu)) + 1e-5).all()


@pytest.mark.parametrize(("kind", "late"), LATE)
def test_the_first_order_is_that_of_differences(kind: str, late: int) -> None:
    """Of torque, of s and of a period, at every state and torque, with Pinocchio's own terms."""
    steps = steps_of(kind, late)
    periods, rows, rest, at = steps.periods, steps.rows, np.zeros(steps.size), max(late, 5)
    row, following, acting = rows[at], rows[at + 1], steps.torque[at - late]
    np.testing.assert_allclose(periods.torque(row, rest), steps.torque[at], atol=1e-9)
    np.testing.assert_allclose(periods.after(row, following, rest, acting), steps.c[at], atol=1e-12)
    for i, y in enumerate(E * np.eye(steps.size)):
        by_torque = (periods.torque(row, y) - periods.torque(row, -y)) / (2 * E)
        np.testing.assert_allclose(steps.T[at][:, i], by_torque, rtol=1e-6, atol=1e-6)
        ends = [periods.after(row, following, sign * y, acting) for sign in (1.0, -1.0)]
        np.testing.assert_allclose(steps.A[at][:, i], (ends[0] - ends[1]) / (2 * E), atol=1e-8)
    for i, u in enumerate(E * np.eye(len(acting))):
        ends = [periods.after(row, following, rest, acting + sign * u) for sign in (1.0, -1.0)]
        np.testing.assert_allclose(steps.plant[at][:, i], (ends[0] - ends[1]) / (2 * E), rtol=1e-5, atol=1e-8)


@pytest.mark.parametrize(("kind", "late"), LATE)
@pytest.mark.parametrize("scale", [1e-3, 1e-2, 0.1])
def test_no_corner_of_a_box_leaves_out_more_than_its_bound(kind: str, late: int, scale: float) -> None:
    """Torques and periods against their first order, at corners and inside, noise included; and some come near."""
    steps, rng = steps_of(kind, late), np.random.default_rng(3)
    periods, rows, m, p, K = steps.periods, steps.rows, steps.size, steps.periods.layout.dof, len(steps.at) - 1
    y = np.tile(scale * rng.uniform(0.2, 1.0, m), (K, 1))
    y[:, -p:] *= 5
    noise, push = 0.1 * scale * rng.uniform(size=p), 0.05 * scale * periods.gain * rng.uniform(size=p)
    state = np.zeros((K, m + late * p))
    state[:, :m], state[:, m:] = y, np.tile(push, late)
    sees = np.stack(
        [steps.most(np.abs(np.array([steps.sees(j) for j in range(steps.at[-1])]) @ one)) for one in np.diag(state[0])]
    )
    s, f = np.split(sees.sum(axis=0), 2, axis=1)
    answered = steps.most(np.abs(steps.answers[:-1]) @ noise)
    left = steps.rest(Box(y, s, f, np.tile(push, (K, 1)) + (0.0 if late else answered)), noise)
    assert left is not None
    nearest = np.zeros(2)
    for _ in range(150):
        j = int(rng.integers(late, steps.at[-1]))
        b, corner = steps.of[j], rng.random() < 0.8
        at, seen, u, n = (
            size * (rng.choice((-1.0, 1.0), len(size)) if corner else rng.uniform(-1, 1, len(size)))
            for size in (y[b], y[b], push, noise)
        )
        asked = told(periods, rows[j], seen if late else at, n)
        by_y = steps.torque[j] + steps.T[j] @ (seen if late else at) - steps.answers[j] @ n
        missed = np.abs(asked - by_y) / (left.torque[b] + 1e-12 * np.abs(asked))
        assert (missed <= 1.0).all()
        torque = steps.torque[j - late] + u if late else asked + u
        acted = u if late else u - steps.answers[j] @ n
        first = steps.c[j] + (
            steps.A[j] @ at + steps.plant[j] @ acted if late else steps.P(j) @ at + steps.B(j) @ acted
        )
        off = np.abs(periods.after(rows[j], rows[j + 1], at, torque) - first) / left.state[b]
        assert (off <= 1.0).all()
        nearest = np.maximum(nearest, (missed.max(), off.max()))
    assert nearest.min() > 0.03


def test_boxes_beyond_the_largest_have_no_bound() -> None:
    steps = steps_of("differential")
    K, p = len(steps.at) - 1, steps.periods.layout.dof
    y, nothing = np.full((K, steps.size), 1.01 * SIZES[-1]), np.zeros((K, p))
    assert steps.rest(Box(y, nothing, nothing, nothing), np.zeros(p)) is None


def test_one_step_of_the_plant_is_a_period() -> None:
    """With semi-implicit Euler and one step in a period the plant does what `Periods.after` says, to rounding."""
    timing, robot = Timing(0.05, 1e-3, 1e-3, integrator="semi_implicit_euler"), load("platform_arm")  # no dry friction
    periods = Periods(subject_of("differential", loop_of("differential", robot=robot, timing=timing).run()))
    rows, where = periods.subject.rows, periods.layout.where
    for row, following in pairwise(rows):
        y, then = (periods.state(r, r[where("position")], r[where("nu")]) for r in (row, following))
        np.testing.assert_allclose(periods.after(row, following, y, row[where("torque")]), then, atol=1e-13)

"""Bounds of M, C and gravity over boxes of joint positions, against Pinocchio at places of the boxes."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from robots import fixed_arm, mobile_arm

from mmnn_pin import load
from mmnn_pin.errors import RobotError
from mmnn_pin.model.dynamics import Dynamics
from mmnn_pin.model.robot import Robot
from mmnn_pin.model.robots import extra
from mmnn_pin.signals import Array
from research.proof import postures
from research.proof.cover import ArmMetric, Cover, halves
from research.proof.postures import Jets, Postures, norm
from research.proof.screws import Bodies

REAL = [name for name in ("tiago_no_hand", "panda", "ur5") if name in extra()]
NAMES = ["platform_arm", "locked", *REAL, *(f"{kind}_{n}" for kind in ("mobile", "fixed") for n in (1, 3, 7))]


@cache
def robot_of(name: str) -> Robot:
    kind, _, joints = name.partition("_")
    if name == "locked":
        return load("platform_arm", lock=["arm_1_joint", "arm_2_joint"])
    if kind in ("mobile", "fixed"):
        return {"mobile": mobile_arm, "fixed": fixed_arm}[kind](int(joints), seed=int(joints))
    return load(name)


@cache
def bodies_of(name: str) -> Bodies:
    return Bodies.of(robot_of(name))


def true_terms(robot: Robot, q: Array, rng: np.random.Generator) -> tuple[Array, Array, Array]:
    """M, C (i, j, k) and gravity by Pinocchio; joints that do not follow the arm, wheels among them, are anywhere."""
    position, dynamics, p = robot.neutral_position(), Dynamics(robot), robot.dimensions.dof
    root = robot.dimensions.pose
    spins = [k for k in range(root, len(position)) if robot.T[k, : robot.dimensions.base].any()]
    position[spins] = rng.uniform(-4, 4, len(spins))
    position[:root] = rng.uniform(-4, 4, root)
    position[robot.arm_index] = q
    position = robot.follow(position)
    C = np.stack([dynamics.coriolis_matrix(position, unit) for unit in np.eye(p)], axis=1)
    return dynamics.mass_matrix(position), C, dynamics.gravity(position)


def over(found: Postures, robot: Robot, q: Array, rng: np.random.Generator) -> Array:
    """By how much the terms at a place of the first box are beyond its bounds, over the bounds; at most 0 is right."""
    M, C, gravity = true_terms(robot, q, rng)
    L_inv = np.linalg.inv(np.linalg.cholesky(found.M[0]))
    off = np.einsum("ai,ijk->ajk", L_inv, C - found.coriolis[0])
    turned = np.einsum("ajk,bj->kab", off, L_inv)
    pairs = (
        (np.linalg.norm(L_inv @ (M - found.M[0]) @ L_inv.T, 2), found.mass_off),
        (np.linalg.norm(off, axis=0).ravel(), found.coriolis_off.ravel()),
        (norm((turned + turned.swapaxes(1, 2)) / 2), found.gyration_off[0]),
        (np.linalg.norm(L_inv @ (gravity - found.gravity[0])), found.gravity_off),
    )
    rounding = 1e-10 * max(np.linalg.norm(np.abs(L_inv), 2), 1.0) ** 2  # of Pinocchio's own terms
    return np.array([np.max(true / (bound + rounding)) - 1 for true, bound in pairs])


@pytest.mark.parametrize("name", NAMES)
def test_in_the_middle_the_terms_are_those_of_pinocchio(name: str) -> None:
    robot, rng = robot_of(name), np.random.default_rng(0)
    for _ in range(5):
        q = rng.uniform(-2, 2, robot.dimensions.arm)
        found = postures.postures(bodies_of(name), q[None], np.zeros((1, len(q))))
        M, C, gravity = true_terms(robot, q, rng)
        tolerance = 1e-9 if not bodies_of(name).uneven else 1e-5  # wheels stand where they may
        np.testing.assert_allclose(found.M[0], M, atol=tolerance * np.abs(M).max())
        np.testing.assert_allclose(found.coriolis[0], C, atol=tolerance * max(np.abs(C).max(), 1e-6))
        np.testing.assert_allclose(found.gravity[0], gravity, atol=1e-9 * max(np.abs(gravity).max(), 1.0))
        assert (over(found, robot, q, rng) <= 0).all()


@settings(max_examples=60, deadline=None)
@given(st.sampled_from(NAMES), st.integers(0, 2**32 - 1), st.floats(1e-3, 0.4), st.booleans())
def test_no_place_of_a_box_is_beyond_its_bounds(name: str, seed: int, width: float, alike: bool) -> None:
    """Corners, faces and the inside of boxes whose joints have widths that are alike or differ."""
    robot, rng = robot_of(name), np.random.default_rng(seed)
    n = robot.dimensions.arm
    q, half = rng.uniform(-3, 3, n), width * (np.ones(n) if alike else rng.uniform(0, 1, n) ** 3)
    found = postures.postures(bodies_of(name), q[None], half[None])
    for _ in range(6):
        u = rng.uniform(-1, 1, n)
        place = np.where(rng.random(n) < rng.choice((0.0, 0.5, 1.0)), np.sign(u), u)
        assert (over(found, robot, q + half * place, rng) <= 0).all()


@settings(max_examples=30, deadline=None)
@given(st.sampled_from(NAMES), st.integers(0, 2**32 - 1), st.floats(1e-3, 0.3), st.floats(0, 1))
def test_a_box_in_a_box_has_smaller_bounds_and_lies_within(name: str, seed: int, width: float, share: float) -> None:
    """Around the same middle no bound grows; anywhere inside, the middle of the smaller one is within the larger's."""
    robot, rng = robot_of(name), np.random.default_rng(seed)
    n = robot.dimensions.arm
    q, half = rng.uniform(-3, 3, n), width * rng.uniform(0, 1, n)
    smaller = half * share * rng.uniform(0, 1, n)
    large, small = (postures.postures(bodies_of(name), q[None], one[None]) for one in (half, smaller))
    for bound in ("mass_off", "coriolis_off", "gyration_off", "gravity_off"):
        assert (getattr(small, bound) <= getattr(large, bound) * (1 + 1e-9)).all(), bound
    place = q + (half - smaller) * rng.uniform(-1, 1, n)
    assert (over(large, robot, place, rng) <= 0).all()
    moved = postures.postures(bodies_of(name), place[None], smaller[None])
    corner = place + smaller * rng.choice((-1, 1), n)  # of both boxes: both bounds hold
    assert (over(large, robot, corner, rng) <= 0).all() and (over(moved, robot, corner, rng) <= 0).all()


@pytest.mark.parametrize("name", NAMES)
def test_bounds_of_small_boxes_are_reached(name: str) -> None:
    """Some corner of a box of 0.02 reaches most of the bounds on M and gravity, a part of those on Coriolis terms."""
    robot, rng = robot_of(name), np.random.default_rng(1)
    n, nearest = robot.dimensions.arm, np.full(4, -1.0)
    for _ in range(4):
        q = rng.uniform(-2, 2, n)
        found = postures.postures(bodies_of(name), q[None], np.full((1, n), 0.02))
        for _ in range(60):
            nearest = np.maximum(nearest, over(found, robot, q + 0.02 * rng.choice((-1, 1), n), rng))
    felt = np.array([1, 1, 1, Dynamics(robot).feels_gravity])
    bent = postures.postures(bodies_of(name), q[None], np.full((1, n), 0.02)).mass_off[0] > 1e-6
    assert (1 + nearest[felt > 0] > np.array([0.7, 0.3, 0.3, 0.7])[felt > 0]).all() or not bent


@settings(max_examples=40, deadline=None)
@given(st.sampled_from([name for name in NAMES if name not in ("platform_arm", "locked")]), st.integers(0, 2**32 - 1))
def test_gravity_changes_no_faster_than_its_slope(name: str, seed: int) -> None:
    """Between any two places of a box, joint by joint."""
    robot, rng = robot_of(name), np.random.default_rng(seed)
    n = robot.dimensions.arm
    q, half = rng.uniform(-3, 3, n), rng.uniform(0.0, 0.2) * rng.uniform(0, 1, n)
    found = postures.postures(bodies_of(name), q[None], half[None])
    L_inv = np.linalg.inv(np.linalg.cholesky(found.M[0]))
    for _ in range(6):
        a, b = (q + half * rng.choice((-1, 1), n) * rng.choice((1.0, rng.random())) for _ in range(2))
        change = L_inv @ (true_terms(robot, a, rng)[2] - true_terms(robot, b, rng)[2])
        odd = 2 * found.gravity_wheels[0]  # wheels stand elsewhere
        assert np.linalg.norm(change) <= found.gravity_slope[0] @ np.abs(a - b) + odd + 1e-9


def test_derivatives_are_those_of_finite_differences() -> None:
    """Of M to the third order, by joints that turn and one that slides, normalised as in the middle."""
    name = "mobile_7"
    bodies, rng, h = bodies_of(name), np.random.default_rng(0), 1e-2
    q = rng.uniform(-1, 1, 7)
    jets = Jets(bodies, q[None], np.zeros((1, 7)))
    assert any(bodies.sliding)

    def M(at: Array) -> Array:
        return jets.L_inv[0] @ true_terms(robot_of(name), at, rng)[0] @ jets.L_inv[0].T

    def slope(at: Array, K: tuple[int, ...]) -> Array:
        if not K:
            return M(at)
        step = h * np.eye(7)[K[-1]]
        ends = [slope(at + k * step, K[:-1]) for k in (-2, -1, 1, 2)]
        return (ends[0] - 8 * ends[1] + 8 * ends[2] - ends[3]) / (12 * h)

    for order in (1, 2, 3):
        for _ in range(6):
            K = tuple(sorted(int(k) for k in rng.choice(jets.moving, order)))
            np.testing.assert_allclose(jets.of_M(K)[0], slope(q, K), atol=2e-5)


@settings(max_examples=30, deadline=None)
@given(st.sampled_from([name for name in NAMES if name not in REAL]), st.integers(0, 2**32 - 1))
def test_what_taylors_formula_leaves_is_within_the_bound_of_the_fourth_order(name: str, seed: int) -> None:
    """M at a corner less its polynomial of the third order, in boxes of up to half a radian."""
    robot, rng = robot_of(name), np.random.default_rng(seed)
    n = robot.dimensions.arm
    q, half = rng.uniform(-3, 3, n), rng.uniform(0.05, 0.5) * rng.uniform(0.2, 1, n)
    jets, sign = Jets(bodies_of(name), q[None], half[None]), rng.choice((-1.0, 1.0), n)
    rest = jets.L_inv[0] @ true_terms(robot, q + sign * half, rng)[0] @ jets.L_inv[0].T - np.eye(robot.dimensions.dof)
    for K in (K for some in jets.orders[1:] for K in some):
        joints = [int(np.flatnonzero(bodies_of(name).columns[k])[0]) for k in K]
        rest -= np.prod(sign[joints]) * jets.weight(K)[0] * jets.of_M(K)[0]
    bound = sum(a * b for a, b in zip(jets.motions, reversed(jets.motions), strict=True))[0]
    assert np.linalg.norm(rest, 2) <= bound + 1e-9


@pytest.mark.parametrize("name", ["mobile_3", "fixed_7", "platform_arm"])
def test_no_derivative_of_a_motion_is_longer_in_a_box_than_its_bound(name: str, monkeypatch) -> None:
    """At corners, to the fourth order; and sums by order are those of all derivatives with their weights."""
    monkeypatch.setattr(postures, "ORDER", 4)
    rng, N = np.random.default_rng(0), 6
    n = robot_of(name).dimensions.arm
    q, half = rng.uniform(-2, 2, (N, n)), rng.uniform(0.05, 0.4, (N, n))
    there = Jets(bodies_of(name), q + half * rng.choice((-1, 1), q.shape), half)
    back = np.linalg.inv(there.L_inv)
    monkeypatch.setattr(postures, "ORDER", 3)
    jets = Jets(bodies_of(name), q, half)
    centre = {K: norm(value) for K, value in jets.Z.items()}
    crude = np.linalg.norm(np.abs(jets.L_inv) @ jets.once, axis=1)
    most, sums = jets.largest(centre, crude), [np.zeros(N) for _ in range(5)]
    for K, value in there.Z.items():
        bound = most[K] if K in most else crude[:, K[-1]]
        assert (norm(value @ (jets.L_inv @ back).swapaxes(1, 2)) <= bound * (1 + 1e-9)).all(), K
        sums[len(K)] += jets.weight(K) * bound
    np.testing.assert_allclose(jets.motions, sums)


def test_screws_further_in_only_turn_a_derivative() -> None:
    """`|S_a ... S_d H| <= |S_d H|`, which closes Taylor's formula; and no reach is beyond its bound in the box."""
    bodies, rng = bodies_of("mobile_7"), np.random.default_rng(0)
    q, half = rng.uniform(-2, 2, (20, 7)), np.full((20, 7), 0.3)
    jets, there = Jets(bodies, q, half), Jets(bodies, q + half * rng.choice((-1, 1), q.shape), half)
    for _ in range(100):
        K = tuple(sorted(int(k) for k in rng.choice(jets.moving, rng.integers(2, 5))))
        long, last = (norm(jets.screwed(one)[:, :, :3].reshape(20, -1)) for one in (K, K[-1:]))
        assert (long <= last * (1 + 1e-12)).all()
    for d in jets.moving:
        size = norm(there.screwed((d,))[:, :, :3].reshape(20, -1))
        assert (size <= jets.reach[:, d] * (1 + 1e-12)).all()


def test_a_body_that_cannot_exist_is_bounded_too() -> None:
    """Inertias of URDFs may violate the triangle inequality: a second moment is negative then."""
    robot = robot_of("mobile_3")
    model, joint = robot.model.copy(), robot.model.getJointId(robot.joint_names[-1])
    body = model.inertias[joint]
    model.inertias[joint] = pin.Inertia(body.mass, body.lever, np.diag([0.02, 0.02, 5.0]))
    strange = replace(robot, model=model)
    bodies, rng = Bodies.of(strange), np.random.default_rng(0)
    assert (bodies.signs < 0).any()
    q, half = rng.uniform(-1, 1, 3), np.full(3, 0.1)
    found = postures.postures(bodies, q[None], half[None])
    for _ in range(50):
        assert (over(found, strange, q + half * rng.choice((-1, 1), 3), rng) <= 0).all()


def test_a_wheel_that_is_heavier_on_one_side_is_bounded_at_every_angle() -> None:
    robot = robot_of("platform_arm")
    model = robot.model.copy()
    joint = model.getJointId(robot.actuator_names[0])
    body = model.inertias[joint]
    model.inertias[joint] = pin.Inertia(body.mass, body.lever + np.array([0.01, 0.0, 0.005]), body.inertia)
    heavy = replace(robot, model=model)
    bodies, rng, worst = Bodies.of(heavy), np.random.default_rng(0), -1.0
    assert len(bodies.uneven) == 1 and not bodies_of("platform_arm").uneven
    q = np.array([0.3, 0.9])
    found = postures.postures(bodies, q[None], np.zeros((1, 2)))
    for _ in range(200):
        beyond = over(found, heavy, q, rng)
        assert (beyond <= 0).all()
        worst = max(worst, beyond[0])
    assert worst > -0.95


def test_gravity_of_a_wheel_that_is_heavier_on_one_side_is_no_gravity_that_a_controller_adds() -> None:
    """It knows the joints of the arm, and has the wheels where the robot stands at rest."""
    robot = robot_of("platform_arm")
    model = robot.model.copy()
    joint = model.getJointId(robot.actuator_names[0])
    body = model.inertias[joint]
    model.inertias[joint] = pin.Inertia(body.mass, body.lever + np.array([0.01, 0.0, 0.005]), body.inertia)
    heavy, rng, q = replace(robot, model=model), np.random.default_rng(0), np.array([[0.3, 0.9]])
    bodies, nothing = Bodies.of(heavy), np.zeros((1, 2))
    found, zero = postures.postures(bodies, q, nothing), np.zeros((1, 4))
    metric = ArmMetric(np.eye(2))
    cover = Cover(zero, zero, zero, zero, found, np.zeros((4, 4)), np.zeros(4), metric, 0.0, 1e-3)
    L_inv = np.linalg.inv(np.linalg.cholesky(found.M[0]))
    still = heavy.neutral_position()
    still[heavy.arm_index] = q[0]
    added = Dynamics(heavy).gravity(heavy.follow(still))
    changes = [np.linalg.norm(L_inv @ (true_terms(heavy, q[0], rng)[2] - added)) for _ in range(50)]
    assert 0.3 < max(changes) <= cover.old_gravity(np.zeros(4), 0.0, 1e-4)[0]


def test_what_has_no_bound_says_so() -> None:
    robot = robot_of("platform_arm")
    tilted = robot.model.copy()
    tilted.gravity = pin.Motion(np.array([1.0, 0, -9.7]), np.zeros(3))
    with pytest.raises(RobotError, match="gravity depends on the heading"):
        Bodies.of(replace(robot, model=tilted))


@settings(max_examples=50, deadline=None)
@given(st.integers(0, 2**32 - 1), st.floats(0.0, 0.1), st.integers(1, 4))
def test_all_near_a_place_stays_with_it_in_one_box_however_boxes_are_cut(seed: int, beyond: float, n: int) -> None:
    """Random boxes, cut at random: by brute force, a place of the first box less its margin has a box that holds it."""
    rng = np.random.default_rng(seed)
    first = rng.uniform(-1, 1, n), beyond + rng.uniform(0.01, 0.5, n)
    middle, half = (one[None] for one in first)
    for _ in range(12):
        k, at = rng.integers(len(middle)), rng.integers(n, size=1)
        cut = halves(middle[k : k + 1], half[k : k + 1], at, beyond)
        low, high = cut[0] - cut[1], cut[0] + cut[1]
        np.testing.assert_allclose(low.min(axis=0), middle[k] - half[k])  # together they are the box that was cut
        np.testing.assert_allclose(high.max(axis=0), middle[k] + half[k])
        assert (cut[1] <= half[k] * (1 + 1e-12)).all()
        middle, half = (
            np.concatenate((np.delete(old, k, 0), new)) for old, new in zip((middle, half), cut, strict=True)
        )
    for place in first[0] + (first[1] - beyond) * rng.uniform(-1, 1, (100, n)):
        assert (np.abs(place - middle) + beyond <= half + 1e-12).all(axis=1).any()

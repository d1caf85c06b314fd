"""What learners take a robot for before it has moved: priors for arms of grams and of kilograms."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest
from builders import first_of
from closed_form import inertial, joint
from hypothesis import given, settings
from hypothesis import strategies as st
from numba import config
from robots import fixed_arm, mobile_arm, place, robot_of

from mmnn_pin import load_experiment
from mmnn_pin.model.regressor import Regressor
from mmnn_pin.torque.adaptive import Adaptive, AdaptiveSettings
from mmnn_pin.torque.controller import Bears, Feedback
from mmnn_pin.torque.prior import balls, prior_of, sizes_of, tempo
from mmnn_pin.torque.random_features import BILINEAR, GENERIC, paired, terms

PLAIN = bool(config.DISABLE_JIT)
BALLS = ((30.0, 2.0), (0.3, 0.2))
ROBOTS = {"fixed": fixed_arm(3), "mobile": mobile_arm(2)}
KNOWN = {name: Regressor.of(robot) for name, robot in ROBOTS.items()}
LEARNERS = [
    *("adaptive", "adaptive_composite", "concurrent"),
    *("kalman_regressor", "kalman_bilinear", "kalman_features"),
]


def servo_arm(scale: float = 1.0):
    """A hobby arm with gravity: links of 10 cm and 20 to 100 g, motors that could carry ten times as much."""
    text = f'<link name="base">{inertial(1.0, (0.01,) * 3, place((0, 0, 0)))}</link>'
    for i, mass in enumerate((0.1, 0.08, 0.05, 0.02)):
        mass *= scale
        moments = (mass * 1e-3,) * 3
        text += f'<link name="link_{i}">{inertial(mass, moments, place((0.05, 0, 0)))}</link>'
        more = f'<limit lower="-1.5" upper="1.5" effort="{2.0 * scale}" velocity="6"/>'
        parent, axis = (f"link_{i - 1}", "0 1 0") if i else ("base", "0 0 1")
        text += joint(f"joint_{i}", parent, f"link_{i}", place((0.1, 0, 0) if i else (0, 0, 0)), axis, more, "revolute")
    return robot_of(f'<robot name="servo">{text}</robot>')


def heaviest(robot, bodies, theta, samples=50):
    """Largest diagonal of the reduced mass matrix of a robot of such balls at random angles, by Pinocchio, (p,)."""
    model, rng, most = robot.model.copy(), np.random.default_rng(1), np.zeros(robot.dimensions.dof)
    model.armature = np.zeros(model.nv)
    for name, (m, *_, moment, _, _, _, _, _) in zip(bodies, theta.reshape(-1, 10), strict=True):
        ball = pin.Inertia(m, np.zeros(3), 2 * moment * np.eye(3))  # xx of the pseudo-inertia is half of its own
        model.inertias[1 if name == "root" else model.getJointId(name)] = ball
    data, neutral = model.createData(), pin.neutral(model)
    for _ in range(samples):
        turned = np.zeros(model.nv)
        turned[list(robot.arm_index)] = rng.uniform(-np.pi, np.pi, robot.dimensions.arm)
        M = np.triu(pin.crba(model, data, pin.integrate(model, neutral, turned)))
        most = np.maximum(most, np.diag(robot.T.T @ (M + np.triu(M, 1).T) @ robot.T))
    return most


@settings(max_examples=5 if PLAIN else 15, deadline=None)
@given(name=st.sampled_from(sorted(ROBOTS)), seed=st.integers(0, 1000), slowest=st.floats(0.01, 1.0))
def test_no_velocity_feels_more_of_the_prior_than_its_gain_can_handle(name, seed, slowest):
    """Against Pinocchio with the prior's inertias; random positions, so a little beyond those that were looked at."""
    robot, known = ROBOTS[name], KNOWN[name]
    K = 10.0 ** np.random.default_rng(seed).uniform(-3, 3, robot.dimensions.dof)
    theta = prior_of(known, K, *BALLS, slowest)[: known.inertial]
    assert (theta[::10] > 0).all()
    assert (heaviest(robot, known.bodies, theta) < 1.1 * slowest * K).all()


def test_a_feedback_that_can_handle_the_balls_leaves_them_as_they_are():
    for known in KNOWN.values():
        K = np.full(known.massless.nu.size, 1e6)
        theta = prior_of(known, K, *BALLS, 0.3)
        np.testing.assert_array_equal(theta, balls(known, *BALLS))
        moments = sizes_of(known, K, *BALLS, 0.3).reshape(-1, 10)
        mass = theta[: known.inertial].reshape(-1, 10)[:, 0]
        size = np.where(np.array(known.bodies) == "root", 0.3, 0.2)
        np.testing.assert_allclose(moments, mass[:, None] * size[:, None] ** [0, 1, 1, 1, 2, 2, 2, 2, 2, 2])


@pytest.mark.parametrize("scale", [1.0, 0.01])
@pytest.mark.parametrize("name", first_of(LEARNERS, "concurrent"))
def test_a_light_arm_is_learned_with_the_defaults(name, scale):
    """Servo arms of grams: PD lets them sag, no learner with its defaults is lost or worse."""
    if PLAIN and (scale != 1.0 or name in ("kalman_bilinear", "kalman_features")):
        pytest.skip("slow in plain Python")
    robot, errors = servo_arm(scale), []
    experiment = load_experiment("track", [f"time.duration={0.01 if PLAIN else 3.0}"])
    for one in ("pd", name):
        run = experiment.loop(robot, experiment.controller(one, robot=robot)).run()
        assert run.outcome.status == "completed"
        errors.append(np.sqrt(np.mean(np.square(run["true_e"][len(run) // 2 :]))))
    assert PLAIN or errors[1] < 0.5 * errors[0]


@given(p=st.integers(1, 20), hidden=st.integers(1, 40), largest=st.integers(8, 500))
def test_random_features_of_many_joints_are_shared_out(p, hidden, largest):
    """All pairs once where there is room; else gravity's functions all differ, and each group has its part."""
    pairs, constant = paired(BILINEAR, p, hidden, largest), terms(BILINEAR, p) - 1
    assert (pairs >= 0).all() and pairs[:, 1].max() <= constant
    gravity = pairs[pairs[:, 1] == constant, 0]
    assert len(set(gravity.tolist())) == len(gravity) > 0
    if len(pairs) < largest:
        assert len(set(map(tuple, pairs.tolist()))) == len(pairs) == (pairs[:, 0].max() + 1) * (constant + 1)
    assert len(pairs) <= largest
    if len(set(map(tuple, pairs.tolist()))) != (pairs[:, 0].max() + 1) * (constant + 1):
        assert len(gravity) == largest // 4 and np.sum(pairs[:, 1] < p) == largest // 2
    assert (paired(GENERIC, p, hidden, largest) == [[i, -1] for i in range(hidden)]).all()


def test_rates_follow_from_what_each_joint_feels():
    """A hundredth of all gains is a hundred times the rate; within an arm it is the geometric mean with the median."""
    known = KNOWN["mobile"]
    base, arm = known.massless.base, known.massless.nu.size - known.massless.base
    meant = np.array([500.0] * base + [30.0] * arm)
    bodies, rest = tempo(known, meant)
    np.testing.assert_allclose(np.concatenate((bodies, rest)), 1.0)
    for before, after in zip((bodies, rest), tempo(known, meant / 100), strict=True):
        np.testing.assert_allclose(after, 100 * before)
    weak = meant.copy()
    weak[-1] = 30.0 / 16  # of two joints the median is 15.9375
    at = known.bodies.index("joint_1")
    np.testing.assert_allclose(tempo(known, weak)[0][at], 30.0 / np.sqrt(np.median(weak[base:]) * weak[-1]))
    strong = np.where(np.arange(len(meant)) < base, 4 * meant, meant)
    np.testing.assert_allclose(tempo(known, strong)[0][known.bodies.index("root")], 0.25)


@pytest.mark.parametrize("name", sorted(KNOWN))
def test_no_body_is_believed_to_be_heavier_than_the_held_feedback_bears(name):
    robot, known = ROBOTS[name], KNOWN[name]
    layout, rng = robot.dimensions, np.random.default_rng(3)
    K = 10.0 ** rng.uniform(-2, 1, layout.dof)
    gains = Feedback(tuple(K[: layout.base].tolist()) or None, tuple(K[layout.base :].tolist()))
    free = Adaptive(known, gains, AdaptiveSettings(slowest=0.1))
    weight = rng.uniform(0.05, 1.0, layout.dof)
    for learner, bound in (
        (replace(free, settings=AdaptiveSettings(slowest=0.1, slowest_learned=0.5)), np.full(layout.dof, 0.5)),
        (replace(free, bears=Bears(10.0, 1.0, tuple(weight.tolist()))), weight),
    ):
        most = learner.most()
        assert (most >= 1.0).all() and (most < free.most()).any()
        for b, ratio in enumerate(most):
            theta = np.zeros(known.inertial)
            theta[10 * b : 10 * b + 10] = ratio * learner.start()[10 * b : 10 * b + 10]
            assert (heaviest(robot, known.bodies, theta) < 1.1 * bound * K).all()

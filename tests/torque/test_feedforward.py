"""Feedforward along the reference: against Pinocchio, what it knows, its integral, engines, bases that steer."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest
from learning import assert_engines_agree, assert_frozen, assert_it_resumes, made
from numba import config
from robots import fixed_arm, mobile_arm

from mmnn_pin import Feedback, load, load_experiment
from mmnn_pin.errors import ConfigError
from mmnn_pin.model.reduction import COULOMB_SPEED
from mmnn_pin.model.regressor import Regressor
from mmnn_pin.model.tree.body import parameters
from mmnn_pin.signals import Layout
from mmnn_pin.torque.classical import PID, PIDSettings, integral, integrate
from mmnn_pin.torque.controller import Context
from mmnn_pin.torque.feedforward import Feedforward, FeedforwardSettings, follow, forward
from mmnn_pin.torque.law import motor_limits

H = 1e-3


def bench(robot, limits=None, theta=None, **own):
    layout, n = Layout.of(robot.dimensions), robot.dimensions.arm
    K = Feedback(300.0 if robot.dimensions.base else None, tuple(np.linspace(5.0, 9.0, n)))
    theta = parameters(robot) if theta is None else theta
    settings = FeedforwardSettings(**{"rate": 20.0} | own)
    controller = Feedforward(feedback=K, settings=settings, motion=Regressor.of(robot), theta=theta)
    context = Context(layout, H, 10, limits=limits)
    return layout, controller.law(context).learner, controller.init(context), K


def own_torque(robot, q, nu, nudot):
    """`T' (RNEA + friction)` by Pinocchio at a position and velocity; T of these robots is constant."""
    position = robot.neutral_position()
    position[robot.arm_index] = q
    v, a = robot.T @ nu, robot.T @ nudot
    full = pin.rnea(robot.model, robot.model.createData(), robot.configuration(robot.follow(position)), v, a)
    full += robot.damping * v + robot.coulomb * np.tanh(v / COULOMB_SPEED)
    return robot.T.T @ full + robot.viscous * nu


@pytest.mark.parametrize("robot", [mobile_arm(4), fixed_arm(5)], ids=["mobile", "fixed"])
def test_it_is_dynamics_and_friction_along_the_reference(robot):
    """Whatever velocities are measured; the wheels of the mobile one have friction in their URDF, too."""
    layout, a, state, _ = bench(robot)
    rng, row = np.random.default_rng(1), layout.new_row()
    for _ in range(5):
        row[:] = rng.standard_normal(row.size)
        forward(row, layout.offsets, a, state.values)
        nu = np.concatenate([row[layout.where(name)] for name in ("velocity_ref", "qdot_ref")])
        expected = own_torque(robot, row[layout.where("q")], nu, row[layout.where("nudot_ref")])
        np.testing.assert_allclose(row[layout.where("psi_hat")], expected, rtol=1e-10, atol=1e-9)


@pytest.mark.compiled
def test_it_knows_the_file_and_nothing_that_an_experiment_adds():
    """Neither masses nor rotors nor friction of the true robot, also of one that was changed twice."""
    added = ["robot=so101", "masses=1.7", "armature=0.01", "friction.coulomb=0.3", "friction.arm=0.2"]
    experiment = load_experiment("track", added)
    robot, file = experiment.load_robot(), load("so101")
    found = experiment.controller("feedforward", robot=robot).theta
    np.testing.assert_array_equal(found, parameters(file))
    assert robot.with_masses(2.0).described is robot.described and file.described is file
    labels = Regressor.of(file).labels
    for what in (".m", ".rotor", ".viscous", ".coulomb"):
        at = [i for i, label in enumerate(labels) if label.endswith(what)]
        assert np.abs(parameters(robot)[at] - found[at]).max() > 0.005, what


def sides(K, layout, limits=None, beside=None, **own):
    """PID with the same limits, and with a torque beside that is given."""
    context = Context(layout, H, 10, limits=limits)
    pid = PID(K, PIDSettings(**own))
    a = pid.law(context).learner
    if beside is not None:
        a.beside[:] = beside
    return a, pid.init(context)


@pytest.mark.parametrize("effort", [np.inf, 6.0])
def test_its_integral_is_that_of_pid_with_the_feedforward_beside_it(effort):
    robot = fixed_arm(3)
    limits = motor_limits(np.eye(3), np.full(3, effort))
    layout, a, state, K = bench(robot, limits, rate=20.0)
    rng, row, other = np.random.default_rng(2), layout.new_row(), layout.new_row()
    row[:] = 0.3 * rng.standard_normal(row.size)
    forward(row, layout.offsets, a, state.values)
    beside, stopped = row[layout.where("psi_hat")].copy(), 0
    b, theirs = sides(K, layout, limits, beside, rate=20.0)
    for _ in range(200):
        s = rng.standard_normal(3)
        row[layout.where("r")] = other[layout.where("r")] = s
        forward(row, layout.offsets, a, state.values)
        integral(other, layout.offsets, b, theirs.values)
        difference = row[layout.where("psi_hat")] - other[layout.where("psi_hat")]
        np.testing.assert_allclose(difference, beside, rtol=1e-12, atol=1e-12)
        before = state["integral"].copy()
        asked = K.vector(layout) * s + before + beside
        for _ in range(2):  # twice what follows, as with a supervisor
            follow(row, layout.offsets, a, state.values)
        integrate(other, layout.offsets, b, theirs.values)
        np.testing.assert_array_equal(state["integral"], theirs["integral"])
        winds = (np.abs(asked) > effort) & (asked * s > 0)
        np.testing.assert_array_equal(state["integral"][winds], before[winds])
        stopped += int(winds.sum())
        free = (np.abs(asked) < effort) & (np.abs(before) < 0.9 * effort)
        plain = before + 20.0 * H * K.vector(layout) * s
        np.testing.assert_allclose(state["integral"][free], plain[free], rtol=1e-12)
    assert (stopped > 50) == np.isfinite(effort)


@pytest.mark.compiled
def test_engines_batch_resumption_and_freezing():
    loop = made("feedforward")
    assert_engines_agree(loop)
    assert_it_resumes(loop, loop.timing.duration / 2)
    assert_frozen(loop)


@pytest.mark.parametrize("name", ["car_arm", "swerve_arm"])
def test_of_a_base_that_steers_it_goes_along_what_is_commanded(name):
    """At the measured angles: of alpha and the arm's reference, against the dynamics of the true robot."""
    experiment = load_experiment("track", [f"robot={name}", "time.duration=0.01"])
    robot = experiment.load_robot()
    loop = experiment.loop(robot, "feedforward")
    run, gain = loop.run(), 20.0 * H * loop.controller.feedback.vector(robot.dimensions)
    assert run.outcome.status == "completed"
    for k in (1, 9):
        q = np.concatenate((run["pose"][k], run["shape"][k], run["q"][k]))
        nu = np.concatenate((run["alpha"][k], run["qdot_ref"][k]))
        expected = robot.psi(q, nu, nu, run["nudot_ref"][k])
        own = run["r"][:k].sum(axis=0) - run["edot"][1:k].sum(axis=0) + (run["e"][k - 1] - run["e"][0]) / H
        gathered = gain * np.concatenate((run["z"][:k].sum(axis=0), own))
        found = run["psi_hat"][k] - gathered
        np.testing.assert_allclose(found, expected, rtol=1e-9, atol=1e-9 * np.abs(expected).max())


@pytest.mark.skipif(bool(config.DISABLE_JIT), reason="seconds of control samples")
def test_it_beats_gravity_alone_where_the_file_is_wrong_by_a_tenth():
    """On `track` with friction that no file knows."""
    said = ["robot=platform_arm", "masses=1.1", "friction.coulomb=0.3", "time.duration=6"]
    experiment = load_experiment("track", said)
    robot = experiment.load_robot()
    errors = {}
    for name in ("pd_gravity", "feedforward"):
        run = experiment.loop(robot, experiment.controller(name, robot=robot)).run()
        errors[name] = np.sqrt(np.mean(run["e"][2000:] ** 2))
    assert errors["feedforward"] < 0.2 * errors["pd_gravity"]


def test_its_table_is_one_of_an_experiment():
    experiment = load_experiment("track", ["feedforward.rate=7.0"])
    assert experiment.controller("feedforward", robot=experiment.load_robot()).settings.rate == 7.0
    with pytest.raises(ConfigError) as error:
        load_experiment("track", ["feedforward.rate=-1.0"])
    assert error.value.key == "feedforward.rate"

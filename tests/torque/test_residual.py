"""A nominal model with wrong masses, alone and with a network on the difference."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numba import config

from mmnn_pin import load_experiment
from mmnn_pin.errors import ConfigError, UnknownName
from mmnn_pin.loop.batch import simulate_many
from mmnn_pin.loop.sample import Torque
from mmnn_pin.model.dynamics import Dynamics
from mmnn_pin.model.tree.body import parameters
from mmnn_pin.torque.model_based import ComputedTorque
from mmnn_pin.torque.two_layer_residual import TwoLayerResidual

FRICTION = ["friction.base=[30.0,5.0]", "friction.arm=0.5", "friction.coulomb=0.5"]
SHORT = 0.02 if config.DISABLE_JIT else 0.4


def made(name, *said, duration=SHORT):
    experiment = load_experiment("track", [*FRICTION, f"time.duration={duration}", *said])
    robot = experiment.load_robot()
    return experiment.loop(robot, experiment.controller(name, robot=robot))


def test_psi_hat_is_the_models_psi_and_the_networks_output():
    """Second answer: Pinocchio's Psi of the nominal robot at the measured state, and the network stepped without it."""
    loop = made("two_layer_residual", "nominal.masses=0.6")
    run = loop.run()
    controller = loop.controller
    assert isinstance(controller, TwoLayerResidual) and controller.model is not None
    expected = loop.robot.with_masses(0.6).without_friction()
    np.testing.assert_allclose(parameters(controller.model), parameters(expected), rtol=1e-12)
    dynamics, layout, row = Dynamics(expected), loop.layout, loop.layout.new_row()
    state = controller.learner.init(loop.context())
    network = Torque(controller.learner, loop.context(), row, loop.robot, state)
    for k in range(0, len(run)):
        for name in run:
            row[layout.where(name)] = run[name][k]
        network.answer(run.time[k])
        position = loop.robot.neutral_position()
        position[:3], position[loop.robot.arm_index] = run["pose"][k], run["q"][k]
        nu = np.concatenate((run["velocity"][k], run["qdot"][k]))
        psi0 = dynamics.psi(position, nu, run["nu_ref"][k], run["nudot_ref"][k])
        np.testing.assert_allclose(run["psi_hat"][k], psi0 + network.psi_hat, rtol=1e-9, atol=1e-9)
        feedback = run["effective_gain"][k] * np.concatenate((run["z"][k], run["r"][k]))
        np.testing.assert_allclose(run["torque"][k], feedback + run["psi_hat"][k], rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(state.values, run.final["controller_state"], rtol=1e-9, atol=1e-12)


def test_a_nominal_model_that_is_right_makes_an_oracle():
    right = made("nominal", "nominal.masses=1.0", "nominal.friction=true").run()
    np.testing.assert_array_equal(right["psi_hat"], made("computed_torque").run()["psi_hat"])
    told = made("nominal")
    same = replace(told, controller=ComputedTorque(told.controller.feedback), nominal=told.controller.model).run()
    np.testing.assert_array_equal(told.run()["torque"], same["torque"])


@pytest.mark.compiled
@pytest.mark.parametrize("name", ["two_layer_residual", "nominal"])
def test_both_engines_and_a_batch_agree(name):
    loop = made(name)
    runs = [replace(loop, engine=engine).run() for engine in ("compiled", "ordinary")]
    for signal in ("psi_hat", "torque", "e"):
        np.testing.assert_allclose(runs[0][signal], runs[1][signal], rtol=1e-9, atol=1e-9)
    kept = simulate_many([replace(loop, engine="compiled")], keep=True)[0].recording
    np.testing.assert_array_equal(kept["torque"], runs[0]["torque"])


def test_without_learning_the_weights_stay():
    loop = made("two_layer_residual")
    run = replace(loop, controller=replace(loop.controller, learning=False)).run()
    np.testing.assert_array_equal(run.weights["W1"][0], run.weights["W1"][-1])
    assert run.meta["controller_settings"]["model"]["robot"]


@pytest.mark.compiled
@pytest.mark.parametrize("name", ["two_layer_residual", "two_layer", "one_layer"])
def test_a_projection_bounds_the_weights_at_every_sample(name):
    """Rates a hundred times too large and no leakage; both engines, and a run that never gets there as it was."""
    wild = ["two_layer.F=[100.0,20.0]", "two_layer.G=[100.0,20.0]", "one_layer.beta=[50.0,50.0]"]
    loop = made(name, *wild, "learning.leakage=false", "learning.projection=0.5")
    runs = [replace(loop, engine=engine).run() for engine in ("compiled", "ordinary")]
    np.testing.assert_allclose(runs[0]["torque"], runs[1]["torque"], rtol=1e-9, atol=1e-9)
    network = loop.controller.networks
    state = network.init(loop.context())
    state.values[:] = runs[0].final["controller_state"]
    sizes = {name: np.linalg.norm(W) for name, W in network.weights(state).items()}
    gain = 0.1 * network.feedback_gain(loop.robot.dimensions) / network.network_scales(loop.robot.dimensions)[1]
    bounds = {"W1": 0.5 * gain[:2].max(), "V1": 0.5, "W2": 0.5 * gain[2:].max(), "V2": 0.5}
    shares = [size / bounds[name] for name, size in sizes.items()]
    assert max(shares) == pytest.approx(1.0)
    assert any("ended on the bound of learning.projection" in told for told in network.findings(state))
    most = [np.hypot(bounds[f"W{i}"], bounds[f"V{i}"] * ("V1" in sizes)) for i in (1, 2)]
    assert (runs[0]["weight_norm"][1:] <= np.array(most) * (1 + 1e-12)).all()  # the first output is of the start
    wide, free = (made(name, f"learning.projection={bound}").run() for bound in (1e9, 1e12))
    np.testing.assert_array_equal(wide["torque"], free["torque"])


def test_a_network_on_a_model_has_a_bound_unless_told():
    assert made("two_layer_residual").controller.networks.projection == 100.0
    assert made("two_layer_residual", "learning.projection=7.0").controller.networks.projection == 7.0
    assert made("two_layer").controller.projection is None
    for bad in ("0.0", "-1.0", "nan", "inf"):
        with pytest.raises(ConfigError) as error:
            made("two_layer_residual", f"learning.projection={bad}")
        assert error.value.key == "learning.projection"


@pytest.mark.compiled
def test_a_bound_needs_one_gain_of_a_network_that_learns():
    """A joint without a gain has the bound of its network; where nothing is learned, nothing is bounded."""
    zero = ["feedback.arm=0.0", "learning.robust_term=false"]
    some = made("two_layer_residual", "feedback.arm=[60.0,0.0]", "learning.robust_term=false")
    gain = (
        some.controller.feedback_gain(some.robot.dimensions)
        / some.controller.networks.network_scales(some.robot.dimensions)[1]
    )
    assert gain[3] == 0 and some.run().outcome.status == "completed"
    assert some.controller.networks.radii(some.robot.dimensions)[2] == pytest.approx((100 * 0.1 * gain[2], 100))
    with pytest.raises(ConfigError, match="all gains of the arm are 0") as error:
        made("two_layer_residual", *zero).run()
    assert error.value.key == "feedback.arm"
    assert made("two_layer_residual", *zero, "learning.learning=false").run().outcome.status == "completed"
    assert made("two_layer", *zero).run().outcome.status == "completed"


@pytest.mark.parametrize("bad", [0.0, -1.0, np.nan, np.inf])
def test_a_bound_from_python_is_checked_too(bad):
    with pytest.raises(ConfigError) as error:
        replace(made("two_layer").controller, projection=bad).radii(made("two_layer").robot.dimensions)
    assert error.value.key == "projection"


def test_weights_that_are_held_fixed_are_on_no_bound():
    """Fixed ones are as they were given, larger than the bound or not, and are not said to be on it."""
    loop = made("two_layer_residual")
    state = loop.controller.init(loop.context())
    fixed = replace(loop.controller, projection=1.0, learning=False)
    run = replace(loop, controller=fixed).run(state=state)
    np.testing.assert_array_equal(run.weights["V1"][-1], state["V1"])
    assert np.linalg.norm(run.weights["V1"][-1]) > 1.0 and "bound" not in run.outcome.message
    learnt = replace(loop, controller=replace(fixed, learning=True)).run(state=state)
    assert np.linalg.norm(learnt.weights["V1"][-1]) <= 1.0


@pytest.mark.skipif(config.DISABLE_JIT, reason="needs a long run")
def test_the_network_makes_up_for_wrong_masses():
    def late(name):
        run = made(name, duration=3.0).run()
        return np.sqrt(np.mean(np.hstack((run["true_pose_error"], run["true_e"]))[run.time > 1.0] ** 2, axis=0))

    pd, nominal, residual = (late(name) for name in ("pd", "nominal", "two_layer_residual"))
    assert (nominal < pd).all() and (residual < 0.2 * nominal).all()


def test_what_cannot_be_a_nominal_model_is_refused_with_its_key():
    for said, key, kind in (
        ("nominal.masses=-1.0", "nominal.masses", ConfigError),
        ("nominal.masses={nobody = 0.5}", "nominal.masses", UnknownName),
        ("nominal.robot=two_axis_arm", "nominal.robot", ConfigError),
    ):
        with pytest.raises(kind) as error:
            made("two_layer_residual", said)
        assert error.value.key == key
    with pytest.raises(ConfigError, match="of no robot"):
        load_experiment("track").controller("nominal")

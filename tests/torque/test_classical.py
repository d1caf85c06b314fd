"""PD with gravity and PID: against Pinocchio, closed forms and scipy; anti-windup; engines, resumption, proof."""

from __future__ import annotations

import msgspec
import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from learning import assert_engines_agree, assert_frozen, assert_it_resumes, made
from numba import config
from scipy.integrate import quad

from mmnn_pin import Feedback, load, load_experiment
from mmnn_pin.errors import ConfigError
from mmnn_pin.model.regressor import Regressor
from mmnn_pin.model.tree.body import parameters
from mmnn_pin.signals import Layout
from mmnn_pin.torque.classical import PID, PDGravity, PIDSettings, gravity, integral, integrate
from mmnn_pin.torque.controller import Context
from mmnn_pin.torque.law import motor_limits

LAYOUT = Layout(2, 2, 5, 4)
K = Feedback((400.0, 40.0), 5.0)
H = 1e-3
E = np.array([[8.0, 8.0, 0, 0], [-2.0, 2.0, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]])  # two wheels, two joints
EFFORT = np.array([3.0, 3.0, 2.0, 0.5])


def own_gravity(robot, position):
    """`T' g` by Pinocchio at a position (nv,)."""
    q = robot.configuration(position)
    return robot.T.T @ pin.computeGeneralizedGravity(robot.model, robot.model.createData(), q)


@pytest.mark.parametrize("name", ["platform_arm", "so101", "two_axis_arm"])
def test_gravity_is_that_of_pinocchio_and_of_nothing_else(name):
    """At random poses and speeds: the velocities, which other parts of Psi follow, change nothing."""
    robot, rng = load(name), np.random.default_rng(0)
    layout, K = Layout.of(robot.dimensions), Feedback(1.0, 1.0)
    controller = PDGravity(feedback=K, motion=Regressor.of(robot), theta=parameters(robot))
    law, row = controller.law(Context(layout, H, 10)), layout.new_row()
    for _ in range(5):
        row[:] = rng.standard_normal(row.size)
        gravity(row, layout.offsets, law.learner, np.zeros(0))
        position = robot.neutral_position()
        position[: row[layout.where("pose")].size] = row[layout.where("pose")]
        position[robot.arm_index] = row[layout.where("q")]
        expected = own_gravity(robot, robot.follow(position))
        np.testing.assert_allclose(row[layout.where("psi_hat")], expected, rtol=1e-10, atol=1e-9)


@pytest.mark.compiled
def test_gravity_is_that_of_the_file_not_of_the_true_robot():
    """Masses of the experiment are not in the file."""
    experiment = load_experiment("track", ["robot=so101", "masses=1.7"])
    robot = experiment.load_robot()
    found = experiment.controller("pd_gravity", robot=robot).theta
    np.testing.assert_allclose(found, parameters(load("so101")), rtol=1e-12, atol=1e-300)
    assert np.abs(parameters(robot) - found).max() > 0.01


def bench(limits=None, **own):
    controller, context = PID(K, PIDSettings(**{"rate": 0.3} | own)), Context(LAYOUT, H, 10, limits=limits)
    return controller.law(context).learner, controller.init(context), LAYOUT.new_row()


def step(a, state, row, s):
    """One sample: what goes to the motors beside K s, and twice what follows it, as with a supervisor."""
    row[LAYOUT.where("z")], row[LAYOUT.where("r")] = s[:2], s[2:]
    integral(row, LAYOUT.offsets, a, state.values)
    for _ in range(2):
        integrate(row, LAYOUT.offsets, a, state.values)
    return row[LAYOUT.where("psi_hat")].copy()


def test_the_integral_is_that_of_scipy():
    """Of sines: a sum of rectangles is off by at most h / 2 times the way that s goes."""
    a, state, row = bench(rate=3.0)
    w, samples = np.array([3.0, 5.0, 7.0, 11.0]), 400
    for k in range(samples + 1):
        found = step(a, state, row, np.sin(w * k * H + 0.3))
    expected = [quad(lambda t, w=w: np.sin(w * t + 0.3), 0.0, samples * H)[0] for w in w]
    rate = 3.0 * K.vector(LAYOUT)
    assert (np.abs(found - rate * expected) <= 0.51 * H * rate * w * samples * H + 1e-12).all()
    np.testing.assert_array_equal(row[LAYOUT.where("effective_gain")], K.vector(LAYOUT))


def test_it_does_not_wind_up_and_turns_back_at_once():
    """Ten seconds of an error that saturates all motors leave nothing behind; the first sample that turns is seen."""
    a, state, row = bench(motor_limits(E, EFFORT))
    for _ in range(10000 if not config.DISABLE_JIT else 500):
        step(a, state, row, np.full(4, 1.0))
    np.testing.assert_array_equal(state["integral"], 0.0)
    step(a, state, row, np.array([0.01, 0.0, -0.01, 0.02]))
    assert (np.sign(state["integral"]) == [1, 0, -1, 1]).all()


def test_the_integral_of_joints_is_made_of_their_angles_whatever_their_rates_say():
    """`int s = e + k int e`: a rate that is filtered, and late, leaves nothing behind; after a gap the rate counts."""
    layout, rng = LAYOUT, np.random.default_rng(4)
    feedback, k, h = Feedback((2.0, 3.0), (4.0, 5.0)), 7.0, 0.001
    pid = PID(feedback, PIDSettings(rate=20.0))
    context = Context(layout, h, 100)
    a, state, row = pid.law(context).learner, pid.init(context), layout.new_row()
    e = np.cumsum(rng.standard_normal((50, 2)), axis=0)
    z, lies = rng.standard_normal((2, 50, 2))
    for n in range(50):
        row[layout.where("time")], row[layout.where("e")], row[layout.where("z")] = n * h, e[n], z[n]
        row[layout.where("edot")], row[layout.where("r")] = lies[n], lies[n] + k * e[n]
        integral(row, layout.offsets, a, state.values)
        for _ in range(2):
            integrate(row, layout.offsets, a, state.values)
    joints = e[-1] - e[0] + h * (lies[0] + k * e.sum(axis=0))
    expected = 20.0 * feedback.vector(layout) * np.concatenate((h * z.sum(axis=0), joints))
    np.testing.assert_allclose(state["integral"], expected, rtol=1e-12)
    before, row[layout.where("time")] = state["integral"].copy(), 1.0
    integral(row, layout.offsets, a, state.values)
    integrate(row, layout.offsets, a, state.values)
    gained = 20.0 * h * feedback.vector(layout) * np.concatenate((z[-1], lies[-1] + k * e[-1]))
    np.testing.assert_allclose(state["integral"] - before, gained, rtol=1e-9)


@settings(max_examples=20, deadline=None)
@given(
    seed=st.integers(0, 2**31), size=st.sampled_from([1e-3, 0.1, 10.0, 1e6]), rate=st.sampled_from([0.1, 5.0, 500.0])
)
def test_no_motor_is_asked_for_more_than_its_limit_by_the_integral(seed, size, rate):
    a, state, row = bench(motor_limits(E, EFFORT), rate=rate)
    rng = np.random.default_rng(seed)
    for _ in range(50):
        before, s = state["integral"].copy(), size * rng.standard_normal(4)
        step(a, state, row, s)
        assert (np.abs(np.linalg.solve(E, state["integral"])) <= EFFORT).all()
        u = np.linalg.solve(E, K.vector(LAYOUT) * s + before)
        if (np.abs(u) < EFFORT).all():  # nothing is at its limit: plain integration, clipped
            plain = np.linalg.solve(E, before + rate * H * K.vector(LAYOUT) * s)
            np.testing.assert_allclose(
                state["integral"], E @ np.clip(plain, -EFFORT, EFFORT), rtol=1e-9, atol=1e-9 * np.abs(E).max()
            )
        for i in (2, 3):  # a joint has a motor of its own: saturated it goes back only
            if abs(u[i]) > EFFORT[i]:
                assert (state["integral"][i] - before[i]) * u[i] <= 0


def held(name):
    """The loop of a fixed arm that holds still under gravity, from rest."""
    still = ["reference.arm.amplitude=0.0", "time.duration=12.0", "weights_interval=0.5", "pid.rate=1.0"]
    experiment = load_experiment("track", ["robot=so101", *still])
    robot = experiment.load_robot().without_friction()
    return experiment.loop(robot, experiment.controller(name, robot=robot))


@pytest.mark.skipif(bool(config.DISABLE_JIT), reason="seconds of control samples")
def test_at_rest_pd_errs_by_gravity_pid_learns_it_and_pd_gravity_has_it():
    """Without friction; the error of PD is `g / (K k)` in closed form, Pinocchio's g where it stands."""
    loops = {name: held(name) for name in ("pd", "pid", "pd_gravity")}
    runs = {name: loop.run() for name, loop in loops.items()}
    robot, loop = loops["pd"].robot, loops["pd"]
    nb = robot.dimensions.base
    error = {name: np.abs(run["e"][-1]).max() for name, run in runs.items()}
    g = own_gravity(robot, runs["pd"].final["position"])[nb:]
    k = loop.controller.feedback.vector(robot.dimensions)[nb:] * loop.kinematic.arm_gains(loop.layout)
    np.testing.assert_allclose(runs["pd"]["e"][-1], g / k, rtol=1e-3, atol=1e-6)
    assert error["pid"] < 0.02 * error["pd"] and error["pd_gravity"] < 1e-3 * error["pd"]
    g = own_gravity(robot, runs["pid"].final["position"])
    np.testing.assert_allclose(runs["pid"]["psi_hat"][-1], g, atol=0.02 * np.abs(g).max())


@pytest.mark.compiled
@pytest.mark.parametrize("name", ["pid", "pd_gravity"])
def test_engines_batch_resumption_and_freezing(name):
    loop = made(name)
    assert_engines_agree(loop)
    assert_it_resumes(loop, loop.timing.duration / 2)
    if name == "pid":
        assert_frozen(loop)


def test_with_a_supervisor_engines_agree():
    """There the ordinary engine says twice what was sent."""
    assert_engines_agree(made("pid", "safety.torque=20.0"))


def test_its_table_is_one_of_an_experiment():
    experiment = load_experiment("track", ["pid.rate=7.0"])
    assert experiment.controller("pid", robot=experiment.load_robot()).settings.rate == 7.0
    with pytest.raises(ConfigError) as error:
        load_experiment("track", ["pid.rate=-1.0"])
    assert error.value.key == "pid.rate"
    with pytest.raises(ConfigError):
        PID(Feedback(0.0, 1.0)).law(Context(LAYOUT, H, 10))
    assert msgspec.structs.asdict(experiment.pid) == {"rate": 7.0}
    with pytest.raises(ConfigError, match="a loop or a stepper chooses it") as error:
        PID(K).law(Context(LAYOUT, H, 10))
    assert error.value.key == "pid.rate"

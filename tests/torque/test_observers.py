"""Time-delay control, extended-state observer, L1 and super-twisting: plain numpy, closed forms, limits, engines."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from learning import assert_engines_agree, assert_frozen, assert_it_resumes, made
from numba import config

from mmnn_pin import Feedback, load_experiment, torque
from mmnn_pin.errors import ConfigError
from mmnn_pin.signals import Layout
from mmnn_pin.torque.controller import Context
from mmnn_pin.torque.entries import CONTROLLERS
from mmnn_pin.torque.law import estimate, motor_limits, settle, step

LAYOUT = Layout(2, 2, 5, 4)
M = np.array([40.0, 4.0, 0.3, 0.1])
K = Feedback((1200.0, 120.0), (18.0, 6.0))
H, W = 1e-3, 12.0
E = np.array([[8.0, 8.0, 0, 0], [-2.0, 2.0, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]])
KINDS = {"time_delay": torque.TimeDelay, "extended_state": torque.ExtendedState, "l1_adaptive": torque.L1Adaptive}
NAMES = (*KINDS, "super_twisting")


def controller_of(name, w=W, learning=True, **own):
    kind = KINDS.get(name, torque.SuperTwisting)
    return kind(K, type(kind().settings)(bandwidth=w, **own), tuple(M), learning)


class Bench:
    """A controller beside four velocities, `M nu' = u - d` each alone, the exact reference at rest."""

    def __init__(self, controller, h=H, limits=None):
        self.context = Context(LAYOUT, h, 10, limits=limits)
        self.law, self.state = controller.law(self.context), controller.init(self.context)
        self.row, self.at, self.nu, self.k, self.h, self.limits = (
            LAYOUT.new_row(),
            LAYOUT.offsets,
            np.zeros(4),
            0,
            h,
            limits,
        )

    def sample(self, s=None, nu=None, nudot_ref=0.0):
        """Torque of one sample; s is -nu unless it is given."""
        row, nu = self.row, self.nu if nu is None else nu
        s = -nu if s is None else s
        for name, value in (
            ("time", self.k * self.h), ("velocity", nu[:2]), ("qdot", nu[2:]), ("z", s[:2]), ("r", s[2:]),
            ("nudot_ref", nudot_ref),
        ):  # fmt: skip
            row[LAYOUT.where(name)] = value
        estimate(row, self.at, self.law.learner, self.state.values)
        asked = row[LAYOUT.where("psi_hat")].copy()
        step(row, self.at, self.law.numbers, self.state.values, self.limits, None)
        for _ in range(2):  # twice what follows, as with a supervisor
            settle(row, self.at, self.law.learner, self.state.values)
        self.k += 1
        return asked

    def move(self, d):
        """The motion of one period under the torque that was sent."""
        self.nu = self.nu + self.h * (self.row[LAYOUT.where("torque")] - d) / M


def own_estimates(name, nu, sent, h, w, a=1.0):
    """d_hat after every sample by plain numpy, from velocities (N, 4) and torques that were sent (N, 4)."""
    d, found = np.zeros(4), [np.zeros(4)]
    x, sigma, hat = nu[0].copy(), np.zeros(4), nu[0].copy()
    for k in range(1, len(nu)):
        if name == "time_delay":
            q = np.exp(-w * h)
            d = q * d + (1 - q) * (sent[k - 1] - M * (nu[k] - nu[k - 1]) / h)
        elif name == "extended_state":  # states [nu; d] by the gain of the current estimator, pole by pole
            b = np.exp(-w * h)
            for i in range(4):
                A, B = np.array([[1.0, -h / M[i]], [0.0, 1.0]]), np.array([h / M[i], 0.0])
                CA = np.array([[1.0, 0.0]]) @ A
                power = (A - b * np.eye(2)) @ (A - b * np.eye(2))  # Ackermann's formula on (A, CA)
                L = power @ np.linalg.solve(np.vstack((CA, CA @ A)), [0.0, 1.0])
                before = A @ [x[i], d[i]] + B * sent[k - 1, i]
                x[i], d[i] = before + L * (nu[k, i] - before[0])
        else:
            stays, phi = np.exp(-a * h), (1 - np.exp(-a * h)) / a
            hat = nu[k - 1] + stays * (hat - nu[k - 1]) + phi * (sent[k - 1] / M + sigma)
            sigma = -stays / phi * (hat - nu[k])
            d = d + (1 - np.exp(-w * h)) * (-M * sigma - d)
        found.append(d.copy())
    return np.array(found)


@pytest.mark.parametrize("name", KINDS)
@pytest.mark.parametrize("h", [1e-3, 1e-2])
def test_an_estimate_is_that_of_plain_numpy(name, h):
    rng, bench, nu, sent, found = np.random.default_rng(0), Bench(controller_of(name), h), [], [], []
    for _ in range(40):
        nu.append(rng.standard_normal(4))
        asked = bench.sample(nu=nu[-1], s=0.1 * rng.standard_normal(4), nudot_ref=rng.standard_normal(4))
        sent.append(bench.row[LAYOUT.where("torque")].copy())
        found.append(asked - M * bench.row[LAYOUT.where("nudot_ref")])
    expected = own_estimates(name, np.array(nu), np.array(sent), h, W)
    np.testing.assert_allclose(found, expected, rtol=1e-8, atol=1e-9)


@pytest.mark.parametrize("name", KINDS)
def test_a_constant_disturbance_is_found_as_in_closed_form(name):
    """Of first order `d (1 - exp(-w t))`, of second `d (1 - (1 + w t) exp(-w t))`, whatever moves; to order w h."""
    bench, d, samples = Bench(controller_of(name)), np.array([30.0, -4.0, 2.0, -0.5]), 400
    if config.DISABLE_JIT:
        samples = 60
    for _ in range(samples):
        asked = bench.sample()
        bench.move(d)
    first, second = W * (samples - 1) * H, W * (samples - 0.5) * H
    expected = d * (1 - np.exp(-second) * (1 + second)) if name == "extended_state" else d * (1 - np.exp(-first))
    np.testing.assert_allclose(asked, expected, rtol=0.02, atol=0.01 * np.abs(d).max() * W * H)


@pytest.mark.parametrize("h", [1e-3, 1e-2])
@pytest.mark.parametrize("name", NAMES)
def test_in_the_loop_a_constant_disturbance_is_rejected(name, h):
    """At 1 kHz and 100 Hz; of L1 the predictor's pole leaves a part `1 - exp(-a h)` of it to the feedback."""
    bench, d = Bench(controller_of(name), h), np.array([30.0, -4.0, 2.0, -0.5])
    for _ in range(int((2.0 if not config.DISABLE_JIT else 1.0) / h)):
        bench.sample()
        bench.move(d)
    left = 0.02 if name == "l1_adaptive" else 1e-3 if not config.DISABLE_JIT else 0.02
    assert (np.abs(bench.nu) <= left * np.abs(d) / K.vector(LAYOUT)).all()
    np.testing.assert_allclose(bench.state["integral" if name == "super_twisting" else "d"], d, rtol=max(left, 0.011))


@pytest.mark.parametrize("name", KINDS)
def test_an_estimate_does_not_wind_up_at_a_limit(name):
    """Seconds of an error that saturates all motors: the estimate stays the disturbance that there is."""
    limits = motor_limits(E, np.array([3.0, 3.0, 2.0, 0.5]))
    bench, d = Bench(controller_of(name), limits=limits), np.array([1.0, -0.5, 0.2, -0.1])
    for _ in range(1500 if not config.DISABLE_JIT else 300):
        bench.sample(s=np.full(4, 50.0) * [1, -1, 1, -1])
        bench.move(d)
    np.testing.assert_allclose(bench.state["d"], d, atol=0.03 * np.abs(bench.row[LAYOUT.where("torque")]).max())


def test_the_integral_of_super_twisting_does_not_wind_up():
    limits = motor_limits(E, np.array([3.0, 3.0, 2.0, 0.5]))
    bench = Bench(controller_of("super_twisting"), limits=limits)
    for _ in range(200):
        bench.sample(s=np.full(4, 1.0))
    np.testing.assert_array_equal(bench.state["integral"], 0.0)


def test_super_twisting_has_its_root_beyond_the_layer_and_its_slope_within():
    bench, k = Bench(controller_of("super_twisting", layer=0.04)), K.vector(LAYOUT)
    s = np.array([0.16, -0.01, 0.04, -0.64])
    root = W * M * np.sqrt(0.04 * np.abs(s)) * np.sign(s)
    expected = np.where(np.abs(s) < 0.04, W * M * s, root)
    gathered = np.zeros(4)
    for _ in range(5):
        np.testing.assert_allclose(bench.sample(s=s), expected + gathered, rtol=1e-12)
        gathered = gathered + W * H * k * np.where(np.abs(s) < 0.04, s, 0.04 * np.sign(s))


@settings(max_examples=20, deadline=None)
@given(seed=st.integers(0, 2**31), name=st.sampled_from(NAMES), size=st.sampled_from([1e-3, 1.0, 1e6]))
def test_no_motor_is_asked_for_more_than_its_limit(seed, name, size):
    """Unless K s asks for it alone; a velocity that is no number leaves the estimate as it is."""
    effort = np.array([3.0, 3.0, 2.0, 0.5])
    bench, rng = Bench(controller_of(name), limits=motor_limits(E, effort)), np.random.default_rng(seed)
    for k in range(30):
        s = size * rng.standard_normal(4)
        bench.sample(s=s, nu=np.full(4, np.nan) if k == 17 else size * rng.standard_normal(4), nudot_ref=size)
        u = np.linalg.solve(E, bench.row[LAYOUT.where("torque")])
        alone = np.abs(np.linalg.solve(E, K.vector(LAYOUT) * s))
        assert k == 17 or (np.abs(u) <= np.maximum(effort, alone) * (1 + 1e-9)).all()
        assert np.isfinite(bench.state["integral" if name == "super_twisting" else "d"]).all()


@pytest.mark.parametrize("name", KINDS)
def test_after_a_gap_a_period_tells_nothing(name):
    """The estimate holds over a jump of time and of velocity, and goes on from there."""
    bench, d = Bench(controller_of(name)), np.array([3.0, -0.4, 0.2, -0.05])
    for _ in range(300):
        bench.sample()
        bench.move(d)
    before, bench.k, bench.nu = bench.state["d"].copy(), bench.k + 500, bench.nu + 5.0
    bench.sample()
    np.testing.assert_array_equal(bench.state["d"], before)
    for _ in range(5):
        bench.move(d)
        bench.sample(s=np.zeros(4))
    assert (np.abs(bench.state["d"] - d) <= np.abs(before - d) + 0.02 * np.abs(d)).all()


@pytest.mark.compiled
@pytest.mark.parametrize("name", NAMES)
def test_engines_batch_resumption_and_freezing(name):
    loop = made(name)
    assert_engines_agree(loop)
    assert_it_resumes(loop, loop.timing.duration / 2)
    assert_frozen(loop)


@pytest.mark.skipif(bool(config.DISABLE_JIT), reason="seconds of control samples")
@pytest.mark.parametrize("robot", ["platform_arm", "car_arm"])
def test_they_beat_the_feedback_alone_on_a_base_that_steers_too(robot):
    errors = {}
    for name in ("pd", *NAMES):
        experiment = load_experiment("track", [f"robot={robot}", "friction.coulomb=0.3", "time.duration=3"])
        run = experiment.loop(experiment.load_robot(), name).run()
        assert run.outcome.status == "completed"
        errors[name] = np.sqrt(np.mean(run["e"][1500:] ** 2))
    assert max(errors[name] for name in NAMES) < 0.7 * errors["pd"], errors


@pytest.mark.parametrize("name", NAMES)
def test_it_is_made_again_from_its_facts_and_wants_numbers(name):
    experiment = load_experiment("track", [f"{name}.bandwidth=7.0"])
    robot = experiment.load_robot()
    controller = experiment.loop(robot, name).controller
    again = type(controller).from_facts(name, controller.facts(), None)
    assert again.facts() == controller.facts() and again.rate == 7.0 and len(again.inertia) == robot.dimensions.dof
    assert CONTROLLERS[name].baseline and CONTROLLERS[name].told == ()
    with pytest.raises(ConfigError) as error:
        load_experiment("track", [f"{name}.bandwidth=-1.0"])
    assert error.value.key == f"{name}.bandwidth"
    kind = type(controller)
    for wrong, key in (((1.0, 2.0), "inertia"), (None, "inertia"), ((1.0, 1.0, -1.0, 1.0), "inertia")):
        with pytest.raises(ConfigError, match="inertias") as error:
            kind(K, controller.settings, wrong).law(Context(LAYOUT, H, 10))
        assert error.value.key == f"{name}.{key}"

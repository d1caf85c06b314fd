"""Filtered torque: the means against quadrature, the filters against scipy, the equation against Pinocchio's Psi."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.signal import lsim

from mmnn_pin import load
from mmnn_pin.errors import ConfigError
from mmnn_pin.model.dynamics import Dynamics
from mmnn_pin.model.regressor import Regressor
from mmnn_pin.model.tree.body import parameters
from mmnn_pin.signals import Layout
from mmnn_pin.torque.controller import Context, ControllerState
from mmnn_pin.torque.filtered import Filtered, low_pass, new_filter, parts, period, remember

ROBOT = load("platform_arm").with_friction((30.0, 5.0, 0.5, 0.5)).with_joint_friction(coulomb=0.5)
LAYOUT = Layout.of(ROBOT.dimensions)
REGRESSOR, TRUE = Regressor.of(ROBOT), parameters(ROBOT)
seeds = st.integers(0, 2**32 - 1)


class Bench:
    """A filter alone: states and torques go in."""

    def __init__(self, h=2e-3, pole=0.0, state_pole=0.0, rows=4, k=4, lag=None, way=0.0):
        context = Context(LAYOUT, h, 1, lag=lag, way=way)
        self.f, self.h = new_filter(context, pole, state_pole), h
        self.state, self.row, self.k = ControllerState.of(**parts(context, rows, k)), LAYOUT.new_row(), 0
        self.seen = self.state.view(Filtered)

    def take(self, q, nu, torque, time=None):
        """One sample, and the torque held after it; whether a period has ended."""
        self.row[0] = self.k * self.h if time is None else time
        self.row[LAYOUT.where("velocity")], self.row[LAYOUT.where("q")] = nu[:2], q
        self.row[LAYOUT.where("qdot")] = nu[2:]
        ended = period(self.row, LAYOUT.offsets, self.f, self.seen)
        self.row[LAYOUT.where("torque")] = torque
        remember(self.row, LAYOUT.offsets, self.seen)
        self.k += 1
        return ended


def motion(t):
    """A smooth motion: q, nu, nudot of the thesis robot."""
    rate, phase = np.array([1.3, 2.1, 2.9, 3.7]), np.arange(4.0)
    nu, nudot = np.sin(rate * t + phase), rate * np.cos(rate * t + phase)
    return 0.3 - (np.cos(rate * t + phase) / rate)[2:], nu, nudot


def true_torque(t):
    """What drives the thesis robot along that motion, by Pinocchio."""
    q, nu, nudot = motion(t)
    position = ROBOT.neutral_position()
    position[ROBOT.arm_index] = q
    return Dynamics(ROBOT).psi(ROBOT.follow(position), nu, nu, nudot)


def mean_torque(t, h):
    """Its mean over [t, t + h], by Gauss-Legendre quadrature."""
    x, w = np.polynomial.legendre.leggauss(5)
    return sum(wi / 2 * true_torque(t + h * (1 + xi) / 2) for xi, wi in zip(x, w, strict=True))


def misfit(h, pole, state_pole, duration=2.0):
    """Largest `Phi_f theta - Y_f` along that motion, once the states' filter has settled, relative to Y_f."""
    bench, worst, largest = Bench(h, pole, state_pole, 4, REGRESSOR.size), 0.0, 0.0
    for k in range(int(duration / h)):
        q, nu, _ = motion(k * h)
        if bench.take(q, nu, mean_torque(k * h, h)):
            position = ROBOT.neutral_position()
            position[ROBOT.arm_index] = bench.f.q
            Phi = REGRESSOR.matrix(ROBOT.follow(position), bench.f.nu, bench.f.nu, bench.f.nudot)
            low_pass(bench.f, Phi, bench.seen)
            worst = max(worst, float(np.abs(bench.state["Phi_f"] @ TRUE - bench.state["Y_f"]).max()))
            largest = max(largest, float(np.abs(bench.state["Y_f"]).max()))
    return worst / largest


@pytest.mark.compiled
def test_the_equation_holds_up_to_second_order_in_the_period():
    errors = [misfit(h, 5.0, 0.0) for h in (8e-3, 4e-3)]
    assert errors[0] < 1e-3
    assert errors[1] < 0.3 * errors[0]


@pytest.mark.compiled
def test_a_filter_ahead_of_the_features_bends_what_is_not_linear_and_a_fast_one_less():
    slow, fast = misfit(4e-3, 5.0, 20.0), misfit(4e-3, 5.0, 80.0)
    assert 1e-4 < fast < 0.35 * slow < 0.05


def test_a_torque_that_is_kept_twice_in_a_sample_is_under_way_once():
    """As where a supervisor, limits or a replay make another one of it: the last counts, those before stay theirs."""
    bench, given = Bench(way=4e-3), []
    for k in range(8):
        ended = bench.take(np.zeros(2), np.zeros(4), np.full(4, -100.0))  # the law's, which is not what is sent
        bench.row[LAYOUT.where("torque")] = k
        remember(bench.row, LAYOUT.offsets, bench.seen)
        given += [bench.f.torque.copy()] if ended else []
    np.testing.assert_array_equal(given, np.arange(8 - len(given), 8)[:, None] - 3 + np.zeros(4))


@settings(max_examples=20, deadline=None)
@given(seeds, st.floats(0.5, 200.0), st.floats(5e-4, 2e-2))
def test_the_filter_of_states_and_torque_is_scipys(seed, pole, h):
    """`lsim` of `x' = pole (u - x)`: first-order hold for states, zero-order hold for torque; means by integrals."""
    rng, N = np.random.default_rng(seed), 30
    q, nu, torque = rng.standard_normal((N, 2)), rng.standard_normal((N, 4)), rng.standard_normal((N, 4))
    bench, times = Bench(h, 0.0, pole), np.arange(N) * h
    bench.f = bench.f._replace(wait=0)
    # states x and integral of x
    system = (np.array([[-pole, 0.0], [1.0, 0.0]]), np.array([[pole], [0.0]]), np.eye(2), np.zeros((2, 1)))

    def second(u, start, interp):
        return lsim(system, u, times, [start, 0.0], interp=interp)[1]

    states = np.array([second(u, u[0], True) for u in np.hstack((q, nu)).T])
    drives = np.array([second(u, 0.0, False) for u in torque.T])
    for k in range(N):
        if bench.take(q[k], nu[k], torque[k]):
            means = (states[:, k, 1] - states[:, k - 1, 1]) / h
            np.testing.assert_allclose(np.concatenate((bench.f.q, bench.f.nu)), means, atol=1e-7)
            rates = (states[:, k, 0] - states[:, k - 1, 0]) / h
            np.testing.assert_allclose(bench.f.nudot, rates[2:], atol=1e-9 / h)
            np.testing.assert_allclose(bench.f.torque, (drives[:, k, 1] - drives[:, k - 1, 1]) / h, atol=1e-7)
    assert k == N - 1


@settings(max_examples=20, deadline=None)
@given(seeds, st.floats(1e-3, 5e-2), st.integers(0, 3), st.floats(5e-4, 2e-2))
def test_torque_that_acts_is_late_and_behind_the_lag_of_the_motors(seed, lag, late, h):
    """`lsim` of `x' = (u - x) / lag` for a torque that is held and comes whole periods late; means by integrals."""
    rng, N, zero = np.random.default_rng(seed), 30, np.zeros(4)
    lags = np.array([lag, 0.5 * lag, 2.0 * lag, 0.0])
    torque, times = rng.standard_normal((N, 4)), np.arange(N) * h
    bench = Bench(h, lag=lags, way=late * h)
    bench.f = bench.f._replace(wait=late)
    acting = np.vstack((np.zeros((late, 4)), torque))[:N]
    given = np.zeros((N, 4))
    for i, own in enumerate(lags[:3]):
        system = (np.array([[-1 / own, 0.0], [1.0, 0.0]]), np.array([[1 / own], [0.0]]), np.eye(2), np.zeros((2, 1)))
        given[1:, i] = np.diff(lsim(system, acting[:, i], times, [0.0, 0.0], interp=False)[1][:, 1]) / h
    given[1:, 3] = acting[:-1, 3]
    ended = [bench.f.torque.copy() if bench.take(zero[:2], zero, one) else None for one in torque]
    assert [one is not None for one in ended] == [k > late for k in range(N)]
    np.testing.assert_allclose(ended[late + 1 :], given[late + 1 :], atol=1e-7)


@settings(max_examples=20, deadline=None)
@given(seeds, st.floats(0.0, 4.0).map(lambda late: round(late, 6)))
def test_a_way_that_is_no_whole_number_of_periods_mixes_two_commands(seed, late):
    """The mean of a held torque over a period that lies some of it earlier, by adding up small steps."""
    rng, h, fine, zero = np.random.default_rng(seed), 2e-3, 1000, np.zeros(4)
    torque, bench = rng.standard_normal((12, 4)), Bench(h, way=late * h)
    for k in range(12):
        if bench.take(zero[:2], zero, torque[k]):
            then = k - 1 + (np.arange(fine) + 0.5) / fine - late
            np.testing.assert_allclose(bench.f.torque, torque[np.floor(then).astype(int)].mean(axis=0), atol=5e-3)
    assert bench.f.wait == np.ceil(late)


@settings(max_examples=20, deadline=None)
@given(seeds, st.floats(1.0, 100.0), st.floats(1.0, 100.0))
def test_features_linear_in_acceleration_commute_with_both_filters(seed, pole, state_pole):
    """`M nudot = tau` holds for the filtered signals of any motion, however rough, to rounding."""
    rng, h = np.random.default_rng(seed), 2e-3
    M = rng.standard_normal((4, 4))
    bench = Bench(h, pole, state_pole, 4, 1)
    bench.f = bench.f._replace(wait=0)
    nu = np.zeros(4)
    for _ in range(200):
        after = nu + 0.1 * rng.standard_normal(4)
        torque = M @ (after - nu) / h
        if bench.take(np.zeros(2), nu, torque):
            low_pass(bench.f, (M @ bench.f.nudot)[:, None], bench.seen)
        nu = after
    Phi, Y = bench.state["Phi_f"][:, 0], bench.state["Y_f"]
    np.testing.assert_allclose(Phi, Y, atol=1e-9 * max(1.0, np.abs(Y).max()))


def test_the_low_pass_is_the_held_one_of_scipy():
    rng, h, pole, N = np.random.default_rng(0), 1e-2, 7.0, 50
    bench, Phi, torque = Bench(h, pole, 0.0, 2, 3), rng.standard_normal((N, 2, 3)), rng.standard_normal((N, 4))
    for k in range(N):
        bench.f.torque[:] = torque[k]
        low_pass(bench.f, Phi[k], bench.seen)
    times = np.arange(N + 1) * h
    for part, values in (("Phi_f", Phi), ("Y_f", torque)):
        flat = np.vstack((values.reshape(N, -1), np.zeros((1, values[0].size))))
        expected = [lsim(([pole], [1.0, pole]), u, times, interp=False)[1][-1] for u in flat.T]
        np.testing.assert_allclose(bench.state[part].ravel(), expected, atol=1e-12)


def test_only_periods_between_neighbouring_samples_count():
    bench, zero = Bench(), np.zeros(4)
    ended = [bench.take(zero[:2], zero, zero, time) for time in (0.0, 2e-3, 4e-3, 8e-3, 1e-2, 0.0, 2e-3)]
    assert ended == [False, True, True, False, True, False, True]
    waiting = Bench(state_pole=100.0)
    assert [waiting.take(zero[:2], zero, zero) for _ in range(40)] == [k > 25 for k in range(40)]


@pytest.mark.parametrize("bad", [np.nan, np.inf, 1e12])
def test_what_is_no_number_is_left_out(bad):
    bench, zero = Bench(), np.zeros(4)
    assert not bench.take(zero[:2], zero, zero) and bench.take(zero[:2], zero, zero)
    assert not bench.take(zero[:2], np.array([0.0, bad, 0.0, 0.0]), zero)
    assert not bench.take(zero[:2], zero, np.full(4, bad))
    assert not bench.take(zero[:2], zero, zero)  # after a torque that is none
    assert bench.take(zero[:2], zero, zero)
    assert np.isfinite(bench.state.values[6:]).all()


def test_impossible_poles_are_refused():
    for poles in ((-1.0, 0.0), (1.0, np.inf)):
        with pytest.raises(ConfigError, match="pole"):
            new_filter(Context(LAYOUT, 1e-3, 1), *poles)

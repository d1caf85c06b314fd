"""How fast what integrates may be: eigenvalues of the sampled loop of a joint with the controllers' own code in it."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mmnn_pin import Feedback, load, load_experiment, torque
from mmnn_pin.kinematic import Kinematic
from mmnn_pin.loop import rates, sampled
from mmnn_pin.loop.rates import FASTEST, LEFT, PART, borne, largest_rate, with_inertia
from mmnn_pin.loop.suited import LoopToSuit, bears_of, fit, rate_of
from mmnn_pin.model.base.base import Fixed
from mmnn_pin.signals import Layout
from mmnn_pin.torque.controller import Context
from mmnn_pin.torque.law import estimate, settle, step

STILL = Fixed.linear_errors(np.zeros(0), np.zeros(0))
MASS, k = 0.2, 7.0
LAYOUT = Layout(0, 1, 1, 1)
OBSERVERS = {"time_delay": torque.TimeDelay, "extended_state": torque.ExtendedState, "l1_adaptive": torque.L1Adaptive}


def joint(mass, h, lag=None):
    held = sampled.held_loop(np.array([[mass]]), STILL, np.array([k]), h, sampled.Machinery(lag=lag))
    assert held is not None
    return held


def made(name, gain, rate):
    """A controller of one joint with its rate."""
    if name in OBSERVERS:
        kind = OBSERVERS[name]
        return kind(Feedback(None, gain), type(kind().settings)(bandwidth=kind.rate_factor * rate), (MASS,))
    if name == "super_twisting":
        return torque.SuperTwisting(Feedback(None, gain), torque.SuperTwistingSettings(bandwidth=rate), (MASS,))
    return torque.PID(Feedback(None, gain), torque.PIDSettings(rate=rate))


class Delayed:
    """A joint without a reference under the code of a controller, its torques some periods late: one linear map."""

    def __init__(self, controller, h, periods):
        self.h, self.periods, context = h, periods, Context(LAYOUT, h, 10)
        self.law, self.state = controller.law(context), controller.init(context)
        self.row, self.at = LAYOUT.new_row(), LAYOUT.offsets

    def __call__(self, x):
        """`[e, nu, torques under way, the controller's memory]` of the next sample."""
        h, row, values = self.h, self.row, self.state.values
        e, nu, late, values[:] = x[0], x[1], x[2 : 2 + self.periods], x[2 + self.periods :]
        clock = "when" if "when" in self.state.shapes else "instants"
        self.state[clock] = 1.0 - h
        for name, value in (
            ("time", 1.0), ("qdot", nu), ("e", e), ("edot", -nu), ("r", k * e - nu), ("nu_ref", k * e),
            ("nudot_ref", -k * nu),
        ):  # fmt: skip
            row[LAYOUT.where(name)] = value
        estimate(row, self.at, self.law.learner, values)
        step(row, self.at, self.law.numbers, values, None, None)
        settle(row, self.at, self.law.learner, values)
        self.state[clock] = 0.0
        tau = row[LAYOUT.where("torque")][0]
        acts = late[0] if self.periods else tau
        moved = [e - h * nu - 0.5 * h * h * acts / MASS, nu + h * acts / MASS]
        return np.concatenate((moved, late[1:], [tau] if self.periods else [], values))

    def radius(self):
        """Spectral radius of its matrix, column by column; the map is linear within motors without limits."""
        size = 2 + self.periods + self.state.values.size
        A = np.column_stack([self(1e-6 * unit) / 1e-6 for unit in np.eye(size)])
        np.testing.assert_allclose(self(np.full(size, 1e-6)), A @ np.full(size, 1e-6), rtol=1e-8, atol=1e-15)
        return np.abs(np.linalg.eigvals(A)).max()


def bears(name, gain, rate, h, longest):
    """Largest delay in whole periods at which the loop of a controller is stable [s]."""
    stable = [n for n in range(longest) if Delayed(made(name, gain, rate), h, n).radius() <= 1 + 1e-9]
    return h * max(stable, default=-1)


@pytest.mark.parametrize("bandwidth", [25.0, 60.0])
@pytest.mark.parametrize("name", ["pid", "super_twisting", *OBSERVERS])
def test_a_joint_keeps_its_part_of_the_margin(name, bandwidth):
    """With the rate of the rule; one half as fast again at most does not keep it, and none is above the fastest."""
    h, gain = 5e-4, bandwidth * MASS
    kind = {"pid": "integral", "super_twisting": "sliding"}.get(name, "observer")
    loop, m = joint(MASS, h), np.array([MASS])
    rate = largest_rate([loop], np.array([gain]), m, h, 0.0, kind)
    assert 0.05 * bandwidth < rate <= FASTEST
    longest = int(2.2 / bandwidth / h)
    alone = loop.margin(np.array([gain]), h, kind == "observer")
    found = bears(name, gain, rate, h, longest)
    assert found >= PART * alone - 1.01 * h, (found, alone)
    if rate < FASTEST:
        assert bears(name, gain, 1.5 * rate, h, longest) < PART * alone + 0.01 * h


@settings(deadline=None, max_examples=20)
@given(st.floats(20.0, 80.0), st.floats(0.0, 30.0), st.integers(1, 6), st.booleans())
def test_the_margin_with_an_integral_is_where_the_delayed_loop_turns_unstable(bandwidth, rate, periods, inside):
    """Against the eigenvalues of the loop with its last torques and its integral as further states."""
    h, gain = 0.004, np.array([bandwidth * MASS])
    loop, adds = joint(MASS, h), rate * h * gain
    F, n = loop.feedback(gain, inside), len(loop.state)
    size = n + periods + 1
    A = np.zeros((size, size))
    A[:n, :n], A[:n, n] = loop.state, loop.torque[:, 0]
    A[n : n + periods - 1, n + 1 : n + periods] = np.eye(periods - 1)
    A[n + periods - 1, :n], A[n + periods - 1, -1] = F[0], 1.0
    A[-1, :n], A[-1, -1] = adds * loop.errors[0], 1.0
    margin, radius = loop.margin(gain, h, inside, adds), np.abs(np.linalg.eigvals(A)).max()
    if abs(margin / (periods * h) - 1) > 0.01:
        assert (radius <= 1 + 1e-9) == (margin > periods * h)


def test_a_slow_mode_bounds_an_integral_of_the_error_alone():
    """`rate k < b (k + rate)` of Routh and Hurwitz in the limit of short periods; with `M nudot_ref` nothing does."""
    h, b = 1e-4, 1.0
    loop, gain, m = joint(MASS, h), np.array([b * MASS]), np.array([MASS])
    limit = b * k / (k - b)
    assert loop.radius(gain, False, 0.98 * limit * h * gain) < 1 < loop.radius(gain, False, 1.02 * limit * h * gain)
    rate = largest_rate([loop], gain, m, h, 0.0, "integral")
    assert 0.0 < rate < limit
    assert largest_rate([loop], gain, m, h, 0.0, "model") > rate
    half = with_inertia(loop, 0.5 * m)
    np.testing.assert_allclose(half.inside, 0.5 * loop.inside)


def test_what_is_known_costs_rate():
    """Delay, a filter of velocities and a lag of the motors, each at all postures of an arm."""
    robot, given = load("platform_arm"), LoopToSuit(Kinematic(), 1e-3)
    inertia, share = fit(robot, Feedback(), given)
    feedback, m = Feedback().scaled(robot.dimensions, inertia, share), tuple(inertia)
    found = [
        rate_of(robot, feedback, m, one, "observer")
        for one in (given, given._replace(delay=0.009), given._replace(late=0.006), given._replace(lag=0.004))
    ]
    assert found[0] > max(found[1:]) and min(found) > 0.0, found


def test_a_rate_that_is_given_is_taken_and_none_is_0_where_nothing_is_borne():
    experiment = load_experiment("track", ["robot=so101", "feedforward.rate=3.0", "pid.rate=0.5"])
    robot = experiment.load_robot()
    assert experiment.loop(robot, "feedforward").controller.rate == 3.0
    assert experiment.loop(robot, "pid").controller.rate == 0.5
    chosen = experiment.loop(robot, "time_delay").controller
    assert 0.0 < chosen.rate <= FASTEST and len(chosen.inertia) == 5
    loop, gain = joint(MASS, 0.01), np.array([1.9 * MASS / 0.01])  # barely stable
    assert largest_rate([loop], gain, np.array([MASS]), 0.01, 1.0, "observer") == 0.0
    assert rates.FASTEST * rates.SLOWER**rates.STEPS < 0.01


@settings(deadline=None, max_examples=25)
@given(st.floats(20.0, 90.0), st.floats(0.001, 0.02), st.integers(0, 3), st.sampled_from([0.002, 0.01]))
def test_what_a_loop_bears_of_a_learner_it_bears_when_it_is_delayed(bandwidth, lag, late, h):
    """Eigenvalues with lag, delay and all that a learner may do at once; not much more of it is borne."""
    loop, gain, known, more = joint(MASS, h, np.array([lag])), np.array([bandwidth * MASS]), late * h, h
    alone = loop.margin(gain, h, True)
    rate, room, factor = borne([loop], gain, h, known, more)
    if alone <= known + 1e-9:
        assert rate == 0.0
        return

    def stable(gains, inside, rate, periods):
        """The loop with its last torques and an integral as further states."""
        F, n = gains[:, None] * loop.errors + inside * loop.inside, len(loop.state)
        A = np.zeros((n + periods + 1, n + periods + 1))
        A[:n, :n] = loop.state
        if periods:
            A[:n, n], A[n : n + periods - 1, n + 1 : n + periods] = loop.torque[:, 0], np.eye(periods - 1)
            A[n + periods - 1, :n], A[n + periods - 1, -1] = F[0], 1.0
        else:
            A[:n, :n] += loop.torque @ F
            A[:n, -1] = loop.torque[:, 0]
        A[-1, :n], A[-1, -1] = rate * h * gain[0] * loop.errors[0], 1.0
        return np.abs(np.linalg.eigvals(A)).max() <= 1.0 + 1e-9

    assert stable(room * gain, 1.0, rate, late)
    assert stable(gain, factor, 0.0, late)
    beyond = int(np.ceil((alone + h) / h))  # a delay that the feedback alone does not bear
    assert not stable(gain, 1.0, rate, beyond)
    least = known + min(more, 0.5 * (alone - known))
    if 0.0 < rate < 0.9 / h:
        assert loop.margin(room * gain, h, True, 1.3 * rate * h * gain) < least
    if room > 1.0:
        assert loop.margin(1.3 * room * gain, h, True) < least + LEFT[0] * (alone - least) or room > 3.0


def test_a_lag_and_a_delay_together_cost_more_than_each():
    """10 ms of lag or 5 ms of latency alone leave a learner quick, both leave it a fraction."""
    robot, given = load("platform_arm"), LoopToSuit(Kinematic(kx=3.0, ky=16.0, kth=8.0, K=7.0), 1e-3)
    feedback = Feedback((900.0, 100.0), (5.0, 1.5))
    late = given.delay + 0.005
    alone, lag, delay, both = (
        bears_of(robot, feedback, one).rate
        for one in (given, given._replace(lag=0.01), given._replace(delay=late), given._replace(lag=0.01, delay=late))
    )
    assert both < 0.7 * min(lag, delay) < max(lag, delay) < alone, (alone, lag, delay, both)

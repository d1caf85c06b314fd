"""The tube along a reference (docs/explanation/theory.md, section 9).

Periods against exact motions, sums against the worst signs, and a search for a motion that leaves it.
"""

from __future__ import annotations

from copy import copy
from dataclasses import replace

import numpy as np
import pytest
from attacks import attacked, within
from proofs import KINDS, SLOW, loop_of, subject_of
from scipy.integrate import solve_ivp

from mmnn_pin import Recording, load_experiment
from mmnn_pin.errors import RecordingError
from mmnn_pin.lab.experiments.runner import run_experiment
from mmnn_pin.lab.psi.subject import Subject
from mmnn_pin.loop.before_run import viscous_friction
from mmnn_pin.model.dynamics import Dynamics
from mmnn_pin.signals import Array
from research.proof.certified_run import prove
from research.proof.periods import Periods
from research.proof.steps import delayed
from research.proof.text import tube_sentence
from research.proof.tube import refusal, tube_of
from research.proof.tube_search import Search

compiled = pytest.mark.skipif(SLOW, reason="thousands of periods, uncompiled")
LONGER = ("time.duration=4.0", "windows=[[0.0, 4.0]]")
SHORT = ("time.duration=2.0", "windows=[[0.0, 2.0]]", "plots=[]")


def run(controller: str, *settings: str) -> Recording:
    """A run of `track`, from rest, with its own gains."""
    experiment = load_experiment("track", [*SHORT, f"controllers=['{controller}']", *settings])
    return run_experiment(experiment, "track").recordings[controller]


@pytest.fixture(scope="module")
def learned() -> Recording:
    return run("concurrent", *LONGER)


@pytest.fixture(scope="module")
def search(learned: Recording) -> Search:
    return Search(Periods(Subject.of(learned)), np.zeros(4))


@pytest.fixture(scope="module")
def noisy() -> Search:
    return Search(Periods(Subject.of(run("computed_torque", "sensor.velocity_noise=1e-4"))), np.zeros(4))


# -- a period ----------------------------------------------------------------------------------------------------------


def exact_period(periods: Periods, row: Array, following: Array, y: Array, tau: Array) -> Array:
    """The state after a period by DOP853 and Pinocchio."""
    robot, damping, h = periods.robot, viscous_friction(periods.robot), periods.subject.timing.control_period
    dynamics = Dynamics(replace(robot, coulomb=np.zeros_like(robot.coulomb)))
    start, nu = periods.placed(row, y)
    at, arm = periods.poses, robot.arm_index

    def position(x: Array) -> Array:
        moved = start.copy()
        moved[:at], moved[arm] = x[:at], x[at : at + len(arm)]
        return robot.follow(moved)

    def rates(_: float, x: Array) -> Array:
        now, nu = position(x), x[at + len(arm) :]
        force = tau - dynamics.coriolis_matrix(now, nu) @ nu - dynamics.gravity(now) - damping @ nu
        base = nu[:2] if periods.layout.base == 3 else np.array([*nu[:1], 0.0])
        c, s = np.cos(x[2]), np.sin(x[2])
        pose = [c * base[0] - s * base[1], s * base[0] + c * base[1], nu[periods.layout.base - 1]] if at else []
        return np.concatenate((pose, nu[periods.layout.base :], np.linalg.solve(dynamics.mass_matrix(now), force)))

    x = np.concatenate((start[:at], start[arm], nu))
    x = solve_ivp(rates, (0.0, h), x, method="DOP853", rtol=1e-11, atol=1e-13).y[:, -1]
    return periods.state(following, position(x), x[at + len(arm) :])


@pytest.mark.parametrize("kind", KINDS)
def test_a_period_is_the_exact_motion(kind: str) -> None:
    """To a thousandth of what the torque does to it in that period."""
    periods, rng = Periods(subject_of(kind, loop_of(kind, duration=0.02).run())), np.random.default_rng(1)
    rows = periods.subject.rows
    for j in (3, 15):
        y = 1e-2 * rng.standard_normal(periods.size)
        tau = periods.torque(rows[j], y) + periods.gain * rng.standard_normal(periods.layout.dof)
        exact, found, coasting = (
            exact_period(periods, rows[j], rows[j + 1], y, tau),
            periods.after(rows[j], rows[j + 1], y, tau),
            periods.after(rows[j], rows[j + 1], y, 0 * tau),
        )
        v = slice(periods.size - periods.layout.dof, None)
        assert np.abs(found - exact)[v].max() < 2e-3 * np.abs(exact - coasting)[v].max()
        assert np.abs(found - exact).max() < 2e-3 * np.abs(exact - coasting).max()


@pytest.mark.parametrize("kind", KINDS)
def test_states_and_places_are_each_other(kind: str) -> None:
    periods = Periods(subject_of(kind, loop_of(kind, duration=0.02).run()))
    y = 0.1 * np.random.default_rng(2).standard_normal(periods.size)
    row = periods.subject.rows[5]
    np.testing.assert_allclose(periods.state(row, *periods.placed(row, y)), y, atol=1e-12)


# -- the sums ----------------------------------------------------------------------------------------------------------


@compiled
def test_the_linear_loop_reaches_its_sums_and_never_more(search: Search) -> None:
    """With errors of the torque at their bounds, and the signs of what they do at the end; with random ones less.

    At the ends of blocks; and, in every period between, no sequence gets beyond the largest of the block.
    """
    steps, sums, wanted, rng = search.steps, search.sums, 4, np.random.default_rng(0)  # the second joint's error
    K, m, last = sums.K, sums.m, 5
    eps, rest = np.full((K, 4), 0.1), np.full((K, m), 1e-7)
    bound, most = sums.ends(eps, rest), sums.largest(0, np.zeros((len(steps.rows), sums.r)), eps, rest)
    Z, signs = np.eye(m)[wanted], {}
    for j in range(steps.at[last + 1] - 1, -1, -1):
        signs[j], Z = (np.sign(Z @ steps.B(j)), np.sign(Z)), Z @ steps.P(j)
    found = []
    for chosen in (
        signs,
        *({j: (rng.choice((-1.0, 1.0), 4), rng.choice((-1.0, 1.0), m)) for j in signs} for _ in "abcde"),
    ):
        y = np.zeros(m)
        for j in range(steps.at[last + 1]):
            b = steps.of[j]
            assert (np.abs(sums.rows(j) @ y) <= most[b] * (1 + 1e-9)).all()
            y = steps.P(j) @ y + steps.B(j) @ (eps[b] * chosen[j][0]) + rest[b] * chosen[j][1]
        found.append(abs(y[wanted]))
    np.testing.assert_allclose(found[0], bound[last, wanted], rtol=1e-9)
    assert max(found[1:]) < bound[last, wanted]
    assert (most[: last + 1] >= bound[: last + 1] * (1 - 1e-9)).all()
    assert (most[5] < 3 * bound[5])[[3, 4]].all()


def test_late_commands_take_effect_after_their_periods() -> None:
    """P with two periods of delay, multiplied out, against the plant with the torques of two periods before."""
    rng = np.random.default_rng(3)
    A, B, T = rng.standard_normal((4, 4)) / 3, rng.standard_normal((4, 2)), rng.standard_normal((2, 4)) / 3
    P, into = delayed(A, B, T, 2)
    y = rng.standard_normal(4)
    x, sent = np.concatenate((y, np.zeros(4))), [np.zeros(2), np.zeros(2)]
    for _ in range(6):
        error = rng.standard_normal(2)
        x = P @ x + into @ error
        sent.append(T @ y + error)
        y = A @ y + B @ sent[-3]
    np.testing.assert_allclose(x[:4], y, rtol=1e-12)


# -- the tube ----------------------------------------------------------------------------------------------------------


@compiled
def test_a_search_finds_no_motion_that_leaves_it_and_some_that_come_near(search: Search) -> None:
    """Over seconds, every period of them, each error in turn; with four times the errors of Psi it does leave."""
    first = search.first(lambda share: None)
    last, m = len(search.ends) - 1, search.periods.poses + 2
    size, eps = search.found(first)
    assert search.ends[last] - search.starts[first] >= 2000
    for wanted in range(m):
        reached = attacked(search, first, last, wanted, eps)
        assert within(search, first, reached, size)
        assert abs(reached[-1, wanted]) > 0.1 * size[-1, wanted]  # within 10 times of the worst that is found
    assert not within(search, first, attacked(search, first, last, 4, 4.0 * eps), size)


@compiled
def test_a_search_with_noise_finds_no_motion_that_leaves_it(noisy: Search) -> None:
    """Velocities told with the worst errors; with four times their bound it does leave."""
    first, last = 0, len(noisy.ends) - 1
    size, eps = noisy.found(first)
    assert np.isfinite(size).all() and noisy.told.min() > 0
    for wanted in (1, 2, 4):
        reached = attacked(noisy, first, last, wanted, eps)
        assert within(noisy, first, reached, size)
        assert abs(reached[-1, wanted]) > 0.3 * size[-1, wanted]
    assert not within(noisy, first, attacked(noisy, first, last, 4, eps, noise=4.0), size)


@compiled
def test_learning_gives_a_tube_where_a_plain_controller_has_none(learned: Recording) -> None:
    told, plain = prove(learned, tube=True), tube_of(Subject.of(run("pd", *LONGER)))
    found = told.certificate.tube
    assert found is not None and found.exists and found.covers and found.bears >= 1.0
    assert not plain.exists and plain.bears < 1.0 and "NONE" in tube_sentence(plain)
    assert (found.size[-1] < found.size.max(axis=0)).all()
    assert told.holds and told.to_dict()["certificate"]["tube"]["exists"] and "Tube along" in str(told)


@compiled
def test_the_pushes_that_are_printed_are_borne_and_four_times_as_large_ones_are_not(search: Search) -> None:
    """A search of the worst signs of pushes and errors of Psi stays in their tube; four times of them have none."""
    first = search.first(lambda share: None)
    most, pushed = search.pushes(first), copy(search)
    assert most.min() > 0 and np.ptp(most / search.periods.gain) < 1e-12
    pushed.force = 4 * most
    assert not pushed.exists(first)
    pushed = copy(search)
    pushed.force = most
    size, eps = pushed.found(first)
    assert np.isfinite(size).all() and (size[-1] > search.size(first)[-1]).all()
    reached = attacked(pushed, first, len(search.ends) - 1, 4, eps + most)
    assert within(pushed, first, reached, size)
    assert not within(search, first, reached, search.size(first))  # they count


@compiled
def test_pushes_delays_noise_and_limits_count() -> None:
    exact = Subject.of(run("computed_torque"))
    plain, pushed = tube_of(exact), tube_of(exact, np.array([5.0, 0.0, 0.0, 0.0]))
    assert plain.exists and plain.start == 0.0 and (pushed.size[-1] > plain.size[-1]).all()
    late = tube_of(Subject.of(run("computed_torque", "latency.command=0.001")))
    assert late.late == 1 and late.exists and late.covers
    noisy = tube_of(Subject.of(run("computed_torque", "sensor.velocity_noise=1e-5")))
    assert noisy.exists and noisy.covers and noisy.size[-1, 4] > plain.size[-1, 4]
    assert refusal(Subject.of(run("computed_torque", "latency.command=0.003"))) == ""  # 3.0000000000000004 periods
    limits = exact.motor_limits
    needed, given = plain.torque[0] * limits[0], np.abs(exact.signal("motor_torque")).max()
    weak = tube_of(Subject.of(run("computed_torque", f"actuator.torque_limit={(needed + given) / 2}")))
    assert given < needed and not weak.exists and np.isfinite(weak.start) and "motor" in tube_sentence(weak)


@compiled
@pytest.mark.parametrize(
    ("controller", "settings", "why"),
    [
        ("two_layer", (), "plus Psi_hat"),
        ("computed_torque", ("actuator.lag=0.002",), "more than a limit of torque"),
        ("computed_torque", ("latency.sensing=0.001",), "measurements are late"),
        ("computed_torque", ("latency.command=0.0005", "time.plant_step=0.0005"), "part of a period"),
        ("computed_torque", ("latency.command=0.006",), "more than 4 periods"),
        ("computed_torque", ("sensor.resolution=1e-4",), "its sensors err"),
        ("computed_torque", ("time.sensor_period=0.002",), "slower than its controller"),
        ("computed_torque", ("lead=true",), "plus Psi_hat"),
        ("pd", ("kinematic.ky=0.0",), "gain is 0"),
    ],
)
def test_what_it_does_not_know_is_named(controller: str, settings: tuple[str, ...], why: str) -> None:
    subject = Subject.of(run(controller, "time.duration=0.1", "windows=[[0.0, 0.1]]", *settings))
    assert why in refusal(subject)
    with pytest.raises(RecordingError, match="no tube"):
        tube_of(subject)

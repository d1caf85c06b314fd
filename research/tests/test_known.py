"""What is proved of a learner's error of Psi (docs/explanation/theory.md, section 9): attacks on every step of it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from attacks import attacked, within
from proofs import KINDS, SLOW, loop_of, subject_of
from scipy.linalg import expm

from mmnn_pin import Recording, load_experiment
from mmnn_pin.errors import RecordingError
from mmnn_pin.lab.experiments.runner import run_experiment
from mmnn_pin.lab.psi.learner import LearnerStepper
from mmnn_pin.lab.psi.subject import Subject
from mmnn_pin.model.dynamics import Dynamics
from mmnn_pin.model.regressor import Regressor
from mmnn_pin.model.tree.body import parameters
from mmnn_pin.signals import Array
from research.proof.energy import SAMPLES, allowed, patience, reach
from research.proof.known import roots, unsaid
from research.proof.known_laws import ProvedKalman, unproved
from research.proof.periods import Periods
from research.proof.steps import Box
from research.proof.text import proved_sentence
from research.proof.truth import distances, metric, numbers_of, regressors, true_parameters
from research.proof.tube import tube_from, tube_of
from research.proof.tube_search import Search

compiled = pytest.mark.skipif(SLOW, reason="thousands of periods, uncompiled")
SECONDS, PUSH = 4.0, 0.01  # [s], [N]


def run(controller: str, *settings: str, seconds: float = SECONDS) -> Recording:
    """A run of `track`, from rest, with its own gains."""
    length = (f"time.duration={seconds}", f"windows=[[0.0, {seconds}]]", "plots=[]")
    experiment = load_experiment("track", [*length, f"controllers=['{controller}']", *settings])
    return run_experiment(experiment, "track").recordings[controller]


@pytest.fixture(scope="module")
def search() -> Search:
    return Search(Periods(Subject.of(run("kalman_regressor"))), np.zeros(4))


@pytest.fixture(scope="module")
def proved(search: Search) -> ProvedKalman:
    found = search.proved().errors
    assert isinstance(found, ProvedKalman)
    return found


def test_an_equation_adds_no_more_than_its_error() -> None:
    """`N+^2 = N^2 + e^2 / R - (u + e)^2 / alpha`, against the update written out."""
    rng = np.random.default_rng(0)
    for _ in range(50):
        root, W, ideal, phi = rng.standard_normal((5, 5)), *rng.standard_normal((3, 5))
        P, R, e = root @ root.T + 0.1 * np.eye(5), rng.uniform(0.1, 2.0), rng.standard_normal()
        alpha = R + phi @ P @ phi
        after = W + P @ phi * (phi @ ideal + e - phi @ W) / alpha
        P_after = np.linalg.inv(np.linalg.inv(P) + np.outer(phi, phi) / R)
        N, u = (ideal - W) @ np.linalg.solve(P, ideal - W), phi @ (ideal - W)
        N_after = (ideal - after) @ np.linalg.solve(P_after, ideal - after)
        np.testing.assert_allclose(N_after, N + e * e / R - (u + e) ** 2 / alpha, rtol=1e-8)


@compiled
def test_no_rows_however_wrong_take_the_weights_further_or_the_covariance_above(proved: ProvedKalman) -> None:
    """The learner itself, stepped over rows that are no motion: N and P stay below what their recursions say."""
    learner, rng = proved.learner, np.random.default_rng(1)
    first, where = 60, learner.context.layout.where
    rows, at = proved.periods.subject.rows, int(proved.starts[first])
    stepper = LearnerStepper(learner, learner.start.snapshot())
    for row in rows[:at]:
        stepper.step(row)
    a, k, N = stepper.torque.learner, proved.ideal.size, proved.distance[first]
    P_most, most = proved.P[first].copy(), 0.0
    for row in rows[at : at + 400]:
        wrong = row.copy()
        for name in ("q", "qdot", "velocity", "z", "r", "torque", "nu_ref", "nudot_ref"):
            wrong[where(name)] += 0.3 * rng.standard_normal(wrong[where(name)].size)
        counted, before = int(stepper.state["counts"][1]), stepper.state["W"][0].copy()
        _, P = learner.controller.knowledge(stepper.state)
        stepper.step(wrong)
        state, (_, P_now) = stepper.state, learner.controller.knowledge(stepper.state)
        if int(state["counts"][1]) == counted:
            assert (state["W"][0] == before).all() and (P_now == P).all()
            continue
        place = counted % k
        P_most[place, place] += a.drift * a.interval * k * proved.prior[place]
        e = (state["Y_f"] - state["Phi_f"] @ proved.ideal) / a.gain
        regressor = learner.controller.regressor
        position = np.concatenate((wrong[where("pose")], wrong[where("q")]))
        full = proved.periods.robot.neutral_position()
        full[:3], full[proved.periods.robot.arm_index] = position[:3], position[3:]
        nu = np.concatenate((wrong[where("velocity")], wrong[where("qdot")]))
        Phi = regressor.matrix(proved.periods.robot.follow(full), nu, wrong[where("nu_ref")], wrong[where("nudot_ref")])
        s = np.abs(np.concatenate((wrong[where("z")], wrong[where("r")])))
        N = np.hypot(N + a.answer[0] * a.interval * (s @ roots(Phi, P)), np.sqrt((e**2).sum() / a.noise))
        assert proved.length(proved.ideal - state["W"][0], P_now) <= N * (1 + 1e-6)
        most = max(most, proved.length(proved.ideal - state["W"][0], P_now))
        assert np.linalg.eigvalsh((P_most - P_now) / np.sqrt(np.outer(proved.prior, proved.prior) + 1e-300))[0] > -1e-9
    assert most > proved.distance[first]  # the rows did mislead it


@compiled
def test_the_features_are_those_of_the_learner(proved: ProvedKalman) -> None:
    """At a state of the run, Phi W is the recorded Psi_hat, but for the rest."""
    subject, where, p = proved.periods.subject, proved.periods.layout.where, len(proved.noise)
    for b in (5, 50, 90):
        j = int(proved.starts[b])
        row, places = subject.rows[j], slice(j, j + 1)
        y = proved.periods.state(row, row[where("position")], row[where("nu")])
        stepper = LearnerStepper(proved.learner, proved.learner.start.snapshot())
        for one in subject.rows[:j]:
            stepper.step(one)
        value, slope, rest = proved.features.smooth(places, np.abs(y)[None])
        dry, most = proved.features.dry(places, np.abs(y)[None, -p:])
        W = stepper.state["W"][0]
        off = np.abs((value[0] + dry[0] + np.einsum("z,zij->ij", y, slope[:, 0])) @ W - row[where("psi_hat")])
        assert (off <= (rest[0] + most[0]) @ np.abs(W) + 1e-6).all()


@compiled
def test_features_on_motions_in_a_box_are_no_longer_than_is_proved(proved: ProvedKalman) -> None:
    """In the metric of P, at corners and inside, at any sample of a block, with noise; and some come near."""
    periods, rng, first, nearest = proved.periods, np.random.default_rng(5), 60, np.zeros(4)
    boxes = np.tile([1e-3, 1e-3, 3e-3, 4e-3, 8e-3, 0.01, 0.02, 0.05, 0.1], (len(proved.starts), 1))
    bound, P = proved.spread(first, boxes), proved.covariances(first)
    for b in (60, 80, 99):
        for _ in range(150):
            j = int(rng.integers(proved.starts[b], proved.ends[b]))
            y = boxes[b] * rng.choice((-1.0, 1.0), 9) * rng.choice((1.0, rng.uniform()))
            row, position, nu = periods.seen(periods.subject.rows[j], y)
            nu_ref, nudot_ref = (row[periods.layout.where(name)] for name in ("nu_ref", "nudot_ref"))
            found = roots(proved.learner.controller.regressor.matrix(position, nu, nu_ref, nudot_ref), P[b])
            assert (found <= bound[b]).all()
            nearest = np.maximum(nearest, found / bound[b])
    assert nearest.min() > 0.6


@pytest.mark.parametrize("kind", KINDS)
def test_what_parameters_do_not_say_is_what_dry_friction_has_more_near_a_standstill(kind: str) -> None:
    """Nothing without it, on any motion; a robot whose other friction they do not say is refused."""
    periods = Periods(subject_of(kind, loop_of(kind, duration=0.01).run()))
    regressor, ideal = Regressor.of(periods.robot), parameters(periods.robot)
    assert (unsaid(periods, regressor, ideal) < 1e-5).all()
    rough = periods.robot.with_joint_friction(0.02, 0.5, 1.4)
    periods.robot, periods.rough = rough, Dynamics(rough)
    more, rng = unsaid(periods, regressor, parameters(rough)), np.random.default_rng(0)
    nearest = 0.0
    for _ in range(200):
        nu = rng.uniform(-0.1, 0.1, len(more))
        Y = regressor.matrix(rough.neutral_position(), nu, 0 * nu, 0 * nu)
        off = np.abs(rough.friction(nu) - Y[:, regressor.inertial :] @ parameters(rough)[regressor.inertial :])
        assert (off <= more).all()
        nearest = max(nearest, float((off / more)[more > 0.1].max()))
    assert nearest > 0.3
    with pytest.raises(RecordingError, match="do not say all of its robot"):
        unsaid(periods, regressor, 1.01 * parameters(rough))


def still(search: Search) -> tuple[Box, Array]:
    """The box of a motion that does not leave its reference, and its accelerations."""
    K, nothing = len(search.starts), np.zeros((len(search.starts), search.sums.p))
    return Box(np.zeros((K, search.periods.size)), nothing, nothing, nothing), nothing


@compiled
def test_distance_and_spread_are_their_sums(proved: ProvedKalman) -> None:
    """N with nothing but equations, and with nothing but s; P with as much drift as the updates since bring."""
    first, K, a = 50, len(proved.starts), proved.a
    boxes = np.zeros((K, proved.periods.size))
    spread, n, wrong = proved.spread(first, boxes), proved.updates[first:], 1e-4 * np.arange(4 * K).reshape(K, 4)
    squares = (n * (wrong[first:] ** 2).sum(axis=1)).sum() / a.noise
    wanted = np.sqrt(proved.distance[first] ** 2 + squares)
    np.testing.assert_allclose(proved.distances(first, 0 * wrong, spread, wrong)[-1], wanted, rtol=1e-12)
    s = wrong
    wanted = proved.distance[first] + a.answer[0] * a.interval * (n * (s * spread)[first:].sum(axis=1)).sum()
    np.testing.assert_allclose(proved.distances(first, s, spread, 0 * wrong)[-1], wanted, rtol=1e-12)
    at = np.bincount((proved.done[first] + np.arange(n.sum())) % proved.ideal.size, minlength=proved.ideal.size)
    P = proved.P[first] + np.diag(at * a.drift * a.interval * proved.ideal.size * proved.prior)
    most, periods, rest = np.zeros(4), proved.periods, np.zeros(proved.periods.size)
    for one in periods.subject.rows[proved.starts[-1] : proved.ends[-1]]:
        row, position, nu = periods.seen(one, rest)
        nu_ref, nudot_ref = (row[periods.layout.where(name)] for name in ("nu_ref", "nudot_ref"))
        most = np.maximum(most, roots(proved.learner.controller.regressor.matrix(position, nu, nu_ref, nudot_ref), P))
    np.testing.assert_allclose(spread[-1], most, rtol=1e-6)
    assert len(proved.periods.subject.rows) // a.every - 10 <= proved.updates.sum()  # the filter settles at first


def assert_pushed_within(
    search: Search, controller: str, *told: str, seconds: float = SECONDS
) -> tuple[int, Subject, Search]:
    """A run that is the same until it is pushed: Psi and motion stay within what is proved from that block on.

    Returns:
        The block, the pushed run, and what is proved for such pushes.
    """
    subject, first = search.periods.subject, 9 * len(search.starts) // 10
    n, h = search.starts[first], subject.timing.control_period
    on = {"v": PUSH, "arm_1_joint": -PUSH / 20}
    events = ", ".join(
        f"{{type='push', on='{name}', shape='step', force={f}, start={n * h:.6g}}}" for name, f in on.items()
    )
    pushed = Subject.of(run(controller, *told, f"disturbances=[{events}]", seconds=seconds))
    assert (pushed.rows[:n] == subject.rows[:n]).all() and (pushed.rows[n + 5] != subject.rows[n + 5]).any()
    force = Search(search.periods, np.array([PUSH, 0.0, PUSH / 20, 0.0])).proved()
    size, eps, _ = force.judged(first)
    assert np.isfinite(size).all()
    missed, where = np.abs(pushed.signal("psi") - pushed.signal("psi_hat")), search.periods.layout.where
    states = np.array([search.periods.state(r, r[where("position")], r[where("nu")]) for r in pushed.rows[n:]])
    assert within(search, first, states, size)
    for b in range(first, len(search.ends)):
        assert (missed[search.starts[b] : search.ends[b]].max(axis=0) <= eps[b]).all()
    return first, pushed, force


@compiled
@pytest.mark.parametrize("noise", [0.0, 1e-5])
def test_pushes_from_an_instant_on_take_the_learner_no_further_than_is_proved(noise: float) -> None:
    """A run that is the same until then, without and with noise: Psi, motion and equations stay within their bounds."""
    told = f"sensor.velocity_noise={noise}"
    search = Search(Periods(Subject.of(run("kalman_regressor", told))), np.zeros(4))
    first, pushed, force = assert_pushed_within(search, "kalman_regressor", told)
    n, (size, _, errors) = search.starts[first], force.judged(first)
    proved, box = force.errors, force.box(size, errors)
    assert isinstance(proved, ProvedKalman)
    left = force.steps.rest(box, force.told)
    assert left is not None
    bound, stepper = (
        proved.equations(first, box, left.acceleration),
        LearnerStepper(proved.learner, proved.learner.start.snapshot()),
    )
    nearest = 0.0
    for j, row in enumerate(pushed.rows[:-1]):
        stepper.step(row)
        if j > n:
            state = stepper.state
            error = np.abs(state["Y_f"] - state["Phi_f"] @ proved.ideal) / proved.a.gain
            assert (error <= bound[search.steps.of[j]]).all()
            nearest = max(nearest, float((error / bound[search.steps.of[j]]).max()))
    assert nearest > 0.05


@compiled
@pytest.mark.parametrize("wanted", [0, 3, 4])
def test_equations_of_attacked_motions_err_no_more_than_is_proved(search: Search, wanted: int) -> None:
    """Motions with the worst signs of what is proved, handed to the learner's own filter from the run's state on."""
    proved, first, where = search.proved(), 9 * len(search.starts) // 10, search.periods.layout.where
    size, eps, errors = proved.judged(first)
    known, box, rows = proved.errors, proved.box(size, errors), search.periods.subject.rows
    left = proved.steps.rest(box, proved.told)
    assert isinstance(known, ProvedKalman) and left is not None
    bound, start = known.equations(first, box, left.acceleration), search.starts[first]
    states = attacked(search, first, len(search.ends) - 1, wanted, eps)
    stepper, worst = LearnerStepper(known.learner, known.learner.start.snapshot()), np.zeros(4)
    for row in rows[:start]:
        stepper.step(row)
    taus = [search.periods.torque(rows[start + i], y) for i, y in enumerate(states)]
    signs = errors_of(search, states, taus)
    for i, y in enumerate(states[:-1]):
        row, *_ = search.periods.seen(rows[start + i], y)
        row[where("torque")] = signs[i]
        stepper.step(row)
        state = stepper.state
        error = np.abs(state["Y_f"] - state["Phi_f"] @ known.ideal) / known.a.gain
        assert (error <= bound[search.steps.of[start + i]]).all()
        worst = np.maximum(worst, error / bound[search.steps.of[start + i]])
    assert worst.max() > 0.05


def errors_of(search: Search, states: Array, taus: list[Array]) -> list[Array]:
    """The torques (p,) that took every state to the next one, by inverse dynamics of `Periods`; `taus` start them."""
    periods, start, found = search.periods, len(search.periods.subject.rows) - len(states), []
    rows = periods.subject.rows
    for i, tau in enumerate(taus[:-1]):
        row, following = rows[start + i], rows[start + i + 1]
        position, nu = periods.placed(row, states[i])
        M = periods.dynamics.mass_matrix(position)
        off = (states[i + 1] - periods.after(row, following, states[i], tau))[-len(nu) :]
        found.append(tau + M @ off / search.steps.h)  # without friction: N = M
    return found


@compiled
def test_what_is_proved_falls_as_it_learns_and_gives_a_tube(search: Search) -> None:
    proved, K, (box, nothing) = search.proved(), len(search.ends), still(search)
    bounds = [proved.errors.eps(first, box, nothing)[-1] for first in (25, 50, 90)]
    assert (bounds[0] > bounds[1]).all() and (bounds[1] > bounds[2]).all()
    assert (bounds[2] >= search.errors.eps(K - 1, box, nothing)[-1]).all()
    tube = replace(tube_from(search, print), proof=tube_from(proved, print))
    assert tube.proof is not None and tube.proof.exists and tube.covers and tube.proof.start >= tube.start
    seen = search.errors.eps(int(np.searchsorted(search.starts, round(tube.proof.start / 1e-3))), box, nothing)
    assert (tube.proof.eps > seen.max(axis=0)).all() and (tube.proof.size[-1] > tube.size[-1]).all()
    assert "for every motion that is then where the run was" in proved_sentence(tube)


@compiled
def test_the_worst_signs_of_what_is_proved_stay_in_its_tube_and_come_near(search: Search) -> None:
    first, last, m = 9 * len(search.starts) // 10, len(search.ends) - 1, search.periods.poses + 2
    size, eps = search.proved().found(first)
    for wanted in (1, m - 1):
        reached = attacked(search, first, last, wanted, eps)
        assert within(search, first, reached, size)
        assert abs(reached[-1, wanted]) > 0.1 * size[-1, wanted]


@compiled
def test_equations_of_another_delay_are_told(search: Search) -> None:
    assert unproved(search.periods, 0) == "" and "another delay" in unproved(search.periods, 1)


@compiled
@pytest.mark.parametrize("controller", ["kalman_regressor", "adaptive_composite", "concurrent"])
def test_a_learner_of_late_commands_says_again_what_it_said(controller: str) -> None:
    """Its torques are under way for a sample, in the replay as in the run."""
    subject = Subject.of(run(controller, "latency.command=0.001", seconds=0.4))
    learner = subject.learner
    assert learner is not None and learner.context.way == 1e-3
    stepper, learned = LearnerStepper(learner, learner.start.snapshot()), 0.0
    for row in subject.rows:
        psi_hat = stepper.step(row)
        learned = max(learned, float(np.abs(psi_hat).max()))
        np.testing.assert_allclose(psi_hat, row[subject.layout.where("psi_hat")], atol=1e-9)
    assert learned > 0.1


@compiled
def test_an_adaptive_learner_says_again_what_it_said_under_a_margin_of_delay() -> None:
    """Its share of the feedback follows delays that the recording tells: `latency.margin` among them."""
    subject = Subject.of(run("adaptive", "latency.margin=0.003", "adaptive.share=delays", seconds=0.4))
    assert subject.learner is not None and subject.learner.context.unseen == pytest.approx(0.003)
    stepper = LearnerStepper(subject.learner, subject.learner.start.snapshot())
    for row in subject.rows:
        psi_hat = stepper.step(row)
        np.testing.assert_allclose(psi_hat, row[subject.layout.where("psi_hat")], atol=1e-9)


@compiled
def test_noise_that_leaves_nothing_proved_is_named_and_less_of_it_does_not() -> None:
    """The first thing that is in the way, and following what it says to change."""
    loud = tube_of(Subject.of(run("kalman_regressor", "sensor.velocity_noise=1e-3")))
    assert loud.proof is not None and not loud.proof.exists and "noise of velocities" in proved_sentence(loud)
    assert "use a smaller sensor.velocity_noise" in proved_sentence(loud)
    quiet = tube_of(Subject.of(run("kalman_regressor", "sensor.velocity_noise=1e-5")))
    assert quiet.proof is not None and quiet.proof.exists and quiet.proof.covers


@compiled
def test_what_the_energy_of_an_adaptive_law_allows_is_no_bound_of_use() -> None:
    """Each error found belongs to parameters as near as the true ones, by the log-det divergence written out."""
    subject = Subject.of(run("adaptive", seconds=1.0))
    periods, learner = Periods(subject), subject.learner
    assert learner is not None
    times = allowed(periods) / np.abs(subject.signal("psi")).max(axis=0)
    assert times.min() > 3.0 and unproved(periods) == ""
    assert_patience(periods, np.abs(subject.signal("psi")).max(axis=0))
    bodies, end = numbers_of(learner)[0].bodies, learner.end["theta"]
    energy = float(distances(bodies, true_parameters(subject, learner).theta, end[None])[0])
    ray = metric(bodies, end) @ np.ones(end.size)
    c = reach(bodies, end, ray, energy)
    near = min(abs(float(distances(bodies, end + sign * c * ray, end[None])[0]) / energy - 1) for sign in (1, -1))
    assert near < 1e-3 or reach(bodies, end, ray, 10 * energy) < 1.01 * c  # on its edge, or on that of bodies at all


def assert_patience(periods: Periods, largest: Array) -> None:
    """The time after which the averaged law leaves so much, by its flow, against scipy's matrix exponential."""
    subject, learner = periods.subject, periods.subject.learner
    assert learner is not None
    (a, _), end = numbers_of(learner), learner.end["theta"]
    energy = float(distances(a.bodies, true_parameters(subject, learner).theta, end[None])[0])
    rows = subject.rows[np.linspace(0, len(subject.rows) - 1, SAMPLES).astype(int)]
    Y, Gamma = regressors(learner, rows), metric(a.bodies, end)
    H, time = a.tracking * np.einsum("nij,i,nik->jk", Y, 1 / a.gain, Y) / len(Y), patience(periods, largest)
    assert 1.0 < time < np.inf
    for T, holds in ((1.05 * time, True), (0.95 * time, False)):
        flow = expm(-T * Gamma @ H)  # of theta~, whose ellipsoid V = theta~' Gamma^-1 theta~ / 2 it takes along
        most = np.sqrt(2 * energy * np.einsum("nij,jk,nik->ni", Y, flow @ Gamma @ flow.T, Y)).max(axis=0)
        assert (most <= largest).all() == holds


@compiled
@pytest.mark.parametrize(
    ("controller", "settings", "why"),
    [
        ("pd", (), "learns nothing"),
        ("concurrent", (), "use concurrent.floor = true"),
        ("kalman_bilinear", (), "no parameters"),
        ("kalman_regressor", ("kalman.regressor.alarm=3.0",), "use alarm = 0"),
    ],
)
def test_a_learner_of_which_nothing_is_proved_is_told_why(controller: str, settings: tuple[str, ...], why: str) -> None:
    periods = Periods(Subject.of(run(controller, *settings, seconds=0.1)))
    assert why in unproved(periods)
    with pytest.raises(RecordingError, match="no bound of the learner's error"):
        Search(periods, np.zeros(periods.layout.dof)).proved()

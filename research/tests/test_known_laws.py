"""What is proved of concurrent and adaptive learners along one reference: attacks on every step of it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from attacks import attacked, within
from hypothesis import given, settings
from hypothesis import strategies as st
from proofs import SLOW
from test_known import assert_pushed_within, run, still

from mmnn_pin import load_experiment
from mmnn_pin.errors import RecordingError
from mmnn_pin.lab.psi.learner import LearnerStepper
from mmnn_pin.lab.psi.subject import Subject
from mmnn_pin.signals import Array
from mmnn_pin.torque.pseudo_inertia import BODY, pseudo_inertias, vector_of
from research.proof.confined import Confined
from research.proof.known import roots
from research.proof.known_laws import ProvedConcurrent
from research.proof.periods import Periods
from research.proof.text import proved_sentence
from research.proof.truth import matrices, regressors
from research.proof.tube import tube_from
from research.proof.tube_search import Search

compiled = pytest.mark.skipif(SLOW, reason="thousands of periods, uncompiled")
STACK = ("concurrent.floor=true", "concurrent.noise=3e-4", "concurrent.entries=120")
NARROW = ("adaptive.initial=nominal", "nominal.masses=0.99", "adaptive.bounds=1.03")
TOLD = ("adaptive.viscous=0.0", "adaptive.coulomb=0.0")


def searched(controller: str, *told: str, seconds: float = 4.0) -> Search:
    """A run of `track` and its tubes."""
    return Search(Periods(Subject.of(run(controller, *told, seconds=seconds))), np.zeros(4))


@pytest.fixture(scope="module")
def search() -> Search:
    return searched("concurrent", *STACK, seconds=6.0)


@pytest.fixture(scope="module")
def proved(search: Search) -> ProvedConcurrent:
    found = search.proved().errors
    assert isinstance(found, ProvedConcurrent)
    return found


@compiled
def test_no_rows_however_wrong_take_a_concurrent_estimate_further(proved: ProvedConcurrent) -> None:
    """The learner itself, stepped over rows that are no motion: distance and P stay below their bounds."""
    learner, rng, first, where = proved.learner, np.random.default_rng(1), 60, proved.periods.layout.where
    rows, at, robot = proved.periods.subject.rows, int(proved.starts[60]), proved.periods.robot
    stepper = LearnerStepper(learner, learner.start.snapshot())
    for row in rows[:at]:
        stepper.step(row)
    a, regressor, F = stepper.torque.learner, learner.controller.regressor, stepper.state["F"].copy()
    np.testing.assert_allclose(np.linalg.inv(F), proved.P[first], rtol=1e-6, atol=1e-12)
    N, furthest = proved.distance[first], 0.0
    share, prior = 1.0 - np.exp(-a.rate * a.every * a.h), np.sqrt(proved.ideal @ np.linalg.solve(F, proved.ideal))
    changes = stepper.state["used"][1]
    for row in rows[at : at + 600]:
        wrong = row.copy()
        for name in ("q", "qdot", "velocity", "z", "r", "torque", "nu_ref", "nudot_ref"):
            wrong[where(name)] += 0.3 * rng.standard_normal(wrong[where(name)].size)
        now = int(stepper.state["samples"][0]) % a.every == 0
        stepper.step(wrong)
        state = stepper.state
        full = robot.neutral_position()
        full[:3], full[robot.arm_index] = wrong[where("pose")], wrong[where("q")]
        nu = np.concatenate((wrong[where("velocity")], wrong[where("qdot")]))
        Y = regressor.matrix(robot.follow(full), nu, wrong[where("nu_ref")], wrong[where("nudot_ref")])
        s = np.abs(np.concatenate((wrong[where("z")], wrong[where("r")])))
        N += a.tracking * a.h * float(s @ roots(Y @ proved.basis, proved.P[first]))
        if now:
            off = state["y"] - state["Phi"] @ proved.ideal
            N += share * (prior + np.sqrt((off[state["born"] >= 0] ** 2).sum()) - N)
        error = proved.ideal - state["w"]
        distance = np.sqrt(error @ F @ error)
        assert distance <= N * (1 + 1e-6)
        furthest = max(furthest, float(distance / N))
        assert np.linalg.eigvalsh(proved.P[first] - state["P"])[0] > -1e-9
    assert stepper.state["used"][1] > changes and furthest > 0.05  # equations were exchanged, and misled it


@compiled
def test_a_concurrent_distance_is_its_recursion(proved: ProvedConcurrent) -> None:
    """Without s and with exact equations it goes to what prior and stack have wrong; what comes adds its own."""
    first, K, a = 50, len(proved.starts), proved.a
    none, share = np.zeros((K, 4)), 1.0 - np.exp(-a.rate * a.every * a.h)
    stack = (
        np.sqrt(proved.ideal @ proved.P[first] @ proved.ideal) + np.sqrt(proved.errors[first].sum()) + proved.rounding
    )
    n = proved.updates[first:].sum()
    wanted = stack + (proved.distance[first] - stack) * (1 - share) ** (n - proved.updates[-1])
    found = proved.distances(first, none, none, none)
    np.testing.assert_allclose(found[-1], wanted, rtol=1e-9)  # it falls: the largest of a block is at its beginning
    assert n >= (len(proved.periods.subject.rows) - proved.starts[first]) // a.every - 1
    wrong = np.full((K, 4), 1e-4)
    more = proved.distances(first, none, none, wrong)[-1] - found[-1]
    assert 0 < more <= np.sqrt((4 * 1e-8 / proved.variance) * len(proved.errors[0]))
    s = np.full((K, 4), 1e-2)
    pushed = proved.distances(first, s, np.ones((K, 4)), none)[-1] - found[-1]
    each = a.tracking * a.h * a.every * 4e-2
    assert each < pushed <= each * (1 / share + 2)


@compiled
def test_a_concurrent_distance_counts_what_moved_it_in_the_block_before(proved: ProvedConcurrent) -> None:
    """Sample by sample, with s in one block alone: what came after its last update shows in the next block."""
    first, K, a, none = 50, len(proved.starts), proved.a, np.zeros((len(proved.starts), 4))
    s, share = none.copy(), 1.0 - np.exp(-a.rate * a.every * a.h)
    s[first] = 1.0
    found, N = proved.distances(first, s, np.ones((K, 4)), none), proved.distance[first]
    stack = (
        np.sqrt(proved.ideal @ proved.P[first] @ proved.ideal) + np.sqrt(proved.errors[first].sum()) + proved.rounding
    )
    for n in range(proved.starts[first], proved.ends[first + 3]):
        b = int(np.searchsorted(proved.starts, n, side="right")) - 1
        assert found[b] * (1 + 1e-12) >= N
        N += a.tracking * a.h * s[b].sum()
        if n % a.every == 0:
            N += share * (stack - N)


@compiled
def test_nothing_is_proved_where_what_the_stack_says_may_be_cut(proved: ProvedConcurrent) -> None:
    """However near the estimate still is: the nearest point of a ball may be further off in another metric."""
    first, K, none = len(proved.starts) - 2, len(proved.starts), np.zeros((len(proved.starts), 4))
    limit = (proved.radius - np.linalg.norm(proved.ideal)) ** 2 - proved.errors[first].sum()
    near, far = (np.full((K, 4), np.sqrt(share * limit * proved.variance / 4)) for share in (1e-3, 1.1))
    assert np.isfinite(proved.distances(first, none, none, near)[first:]).all()
    assert np.isinf(proved.distances(first, none, none, far)[first:]).all()


@compiled
def test_what_is_proved_of_a_concurrent_learner_falls_and_gives_a_tube(search: Search) -> None:
    proved, (box, nothing) = search.proved(), still(search)
    bounds = [proved.errors.eps(first, box, nothing)[-1] for first in (25, 60, 90)]
    assert (bounds[0] > bounds[1]).all() and (bounds[1] > bounds[2]).all()
    assert (bounds[2] >= search.errors.eps(len(search.ends) - 1, box, nothing)[-1]).all()
    tube = replace(tube_from(search, print), proof=tube_from(proved, print))
    assert tube.proof is not None and tube.proof.exists and tube.covers and tube.proof.start >= tube.start
    assert "for every motion that is then where the run was" in proved_sentence(tube)
    first, last, m = 9 * len(search.starts) // 10, len(search.ends) - 1, search.periods.poses + 2
    size, eps = proved.found(first)
    for wanted in (1, m - 1):
        reached = attacked(search, first, last, wanted, eps)
        assert within(search, first, reached, size)
        assert abs(reached[-1, wanted]) > 0.1 * size[-1, wanted]


@compiled
@pytest.mark.parametrize("noise", [0.0, 1e-5])
@pytest.mark.parametrize(("controller", "told"), [("concurrent", STACK), ("adaptive", (*NARROW, *TOLD))])
def test_pushes_take_no_learner_further_than_is_proved(controller: str, told: tuple[str, ...], noise: float) -> None:
    """A run that is the same until then, without and with noise: Psi and motion stay within their bounds."""
    told = (*told, f"sensor.velocity_noise={noise}")
    assert_pushed_within(searched(controller, *told, seconds=5.0), controller, *told, seconds=5.0)


@pytest.fixture(scope="module")
def narrow() -> Search:
    return searched("adaptive", *NARROW, *TOLD, seconds=4.0 if not SLOW else 0.05)


@pytest.fixture(scope="module")
def confined(narrow: Search) -> Confined:
    found = narrow.proved().errors
    assert isinstance(found, Confined)
    return found


def estimates_within(confined: Confined, rng: np.random.Generator, worst: Array | None = None) -> Array:
    """Parameters (k,) within the bounds: random ones, or those that a row (k,) of Y makes the largest of."""
    m, theta = confined.a.bodies, confined.start.copy()
    for b, C in enumerate(m.roots):
        here = slice(BODY * b, BODY * b + BODY)
        L = np.zeros((4, 4)) if worst is None else C.T @ matrices(worst[None, here], 0.5)[0] @ C
        values, U = np.linalg.eigh(L) if worst is not None else (None, np.linalg.qr(rng.standard_normal((4, 4)))[0])
        x = rng.uniform(m.least, m.most[b], 4) if values is None else np.where(values > 0, m.most[b], m.least)
        theta[here] = vector_of(C @ (U * x) @ U.T @ C.T)
    return theta


@settings(max_examples=10, deadline=None)
@given(st.integers(0, 2**32 - 1))
def test_no_estimate_within_its_bounds_says_more_and_one_says_as_much(confined: Confined, seed: int) -> None:
    rng = np.random.default_rng(seed)
    Y = rng.standard_normal((4, confined.truth.size))
    low, high = confined.extremes(Y)
    for _ in range(50):
        theta = estimates_within(confined, rng)
        said = Y @ (theta - confined.truth)
        assert (low <= said + 1e-9).all() and (said <= high + 1e-9).all()
    for y, most, least in zip(Y, high, low, strict=True):
        up, down = (estimates_within(confined, rng, side * y) for side in (1.0, -1.0))
        np.testing.assert_allclose(y @ (up - confined.truth), most, rtol=1e-9, atol=1e-9)
        np.testing.assert_allclose(y @ (down - confined.truth), least, rtol=1e-9, atol=1e-9)


@compiled
def test_no_rows_however_wrong_take_an_adaptive_estimate_out_of_its_bounds(confined: Confined) -> None:
    """The law itself, with its friction learned, too: Psi_hat stays within the extremes of Y."""
    wide = (
        searched("adaptive", *NARROW, "adaptive.friction_bound=0.01", "learning.within_limits=false", seconds=1.0)
        .proved()
        .errors
    )
    assert isinstance(wide, Confined)
    learner, where, rng = wide.steps.periods.subject.learner, wide.steps.periods.layout.where, np.random.default_rng(2)
    assert learner is not None
    stepper, nearest = LearnerStepper(learner, learner.start.snapshot()), 0.0
    for row in wide.steps.rows[:500]:
        wrong = row.copy()
        for name in ("q", "qdot", "velocity", "z", "r", "nu_ref", "nudot_ref"):
            wrong[where(name)] += rng.standard_normal(wrong[where(name)].size)
        before = stepper.state["theta"].copy()
        psi_hat = stepper.step(wrong)
        Y = regressors(learner, wrong[None])[0]
        np.testing.assert_allclose(Y @ before, psi_hat, rtol=1e-9, atol=1e-6)
        (low, high), off = wide.extremes(Y), Y @ (before - wide.truth)
        assert (low <= off + 1e-9).all() and (off <= high + 1e-9).all()
        nearest = max(nearest, float((np.abs(off) / np.maximum(-low, high)).max()))
    assert nearest > 0.3
    P, P0 = pseudo_inertias(stepper.state["theta"][: wide.regressor.inertial]), wide.a.bodies.roots
    moved = [np.linalg.eigvalsh(np.linalg.solve(C, np.linalg.solve(C, one).T)) for C, one in zip(P0, P, strict=True)]
    assert max(abs(value - 1) for values in moved for value in values) > 0.02  # they came to their bounds


def resumed(controller: str, before: tuple[str, ...], after: tuple[str, ...], at: float, end: float) -> Search:
    """Tubes of a run of `track` that goes on with what another one has learned."""
    loops, seconds = [], (at, end)
    for told, until in zip((before, after), seconds, strict=True):
        length = (f"time.duration={until}", f"windows=[[0.0, {until}]]", "plots=[]")
        experiment = load_experiment("track", [*length, f"controllers=['{controller}']", *told])
        robot = experiment.load_robot()
        loops.append(experiment.loop(robot, experiment.controller(controller, robot=robot)))
    final, state = loops[0].run().final, loops[1].controller.init(loops[1].context())
    state.values[:] = final["controller_state"]
    period = loops[1].timing.control_period
    found = loops[1].run(state=state, plant_state=(final["position"], final["nu"]), first=round(at / period))
    return Search(Periods(Subject.of(found)), np.zeros(4))


@compiled
def test_an_estimate_that_was_handed_over_is_within_its_bounds_or_refused() -> None:
    own = ("adaptive.initial=nominal", "nominal.masses=0.9", "adaptive.bounds=100", *TOLD)
    confined = resumed("adaptive", own, own, 0.3, 0.4).proved().errors
    assert isinstance(confined, Confined)
    learner = confined.steps.periods.subject.learner
    assert learner is not None and (confined.start != learner.controller.start()).any()
    with pytest.raises(RecordingError, match="no bound") as error:
        resumed("adaptive", own, (*own[:2], "adaptive.bounds=1.0001", *TOLD), 0.3, 0.4).proved()
    assert "run it from its own start" in str(error.value)
    with pytest.raises(RecordingError, match="no bound"):  # rates of 0, but drawn back to another start
        resumed("adaptive", own, (*own, "adaptive.rate=0.0", "adaptive.leakage=1.0"), 0.3, 0.4).proved()


@compiled
def test_a_stack_that_the_recording_does_not_hold_is_no_proof() -> None:
    """A run that goes on with a stack that is not in the recording says nearly the same without it."""
    own = (*STACK, "concurrent.initial=nominal", "concurrent.rate=0.01", "concurrent.tracking=0.0")
    with pytest.raises(RecordingError) as error:
        resumed("concurrent", own, own, 0.5, 0.7).proved()
    assert "says another Psi_hat" in str(error.value)


@compiled
def test_an_adaptive_law_within_narrow_bounds_has_a_tube_from_rest_and_pd_none(narrow: Search) -> None:
    """Errors of Psi in a box of errors are within the bound, and the worst signs of it stay in the tube."""
    proved = narrow.proved()
    confined = proved.errors
    assert isinstance(confined, Confined)
    tube = replace(tube_from(narrow, print), proof=tube_from(proved, print))
    assert tube.proof is not None and tube.proof.exists and tube.covers and tube.proof.start == 0.0
    assert "does not fall" in proved_sentence(tube)
    assert not Search(Periods(Subject.of(run("pd"))), np.zeros(4)).exists(0)
    size, eps, errors = proved.judged(0)
    box, rng, periods, nearest = proved.box(size, errors), np.random.default_rng(3), narrow.periods, 0.0
    regressor = confined.regressor
    for b in (5, 50, 99):
        for _ in range(40):
            j, y = int(rng.integers(narrow.starts[b], narrow.ends[b])), box.y[b] * rng.choice((-1.0, 1.0), 9)
            row, position, nu = periods.seen(periods.subject.rows[j], y)
            nu_ref, nudot_ref = (row[periods.layout.where(name)] for name in ("nu_ref", "nudot_ref"))
            Y = regressor.matrix(position, nu, nu_ref, nudot_ref)
            worst = np.array([estimates_within(confined, rng, sign * one) for one in Y for sign in (1.0, -1.0)])
            off = np.abs(np.einsum("ik,ijk->ij", Y, worst.reshape(len(Y), 2, -1) - confined.truth)).max(axis=1)
            assert (off <= eps[b]).all()
            nearest = max(nearest, float((off / eps[b]).max()))
    assert nearest > 0.5
    last, m = len(narrow.ends) - 1, periods.poses + 2
    for wanted in (1, m - 1):
        reached = attacked(narrow, 0, last, wanted, eps)
        assert within(narrow, 0, reached, size)
        assert abs(reached[-1, wanted]) > 0.1 * size[-1, wanted]


@compiled
@pytest.mark.parametrize("controller", ["adaptive", "adaptive_composite"])
def test_wide_bounds_are_told_and_what_is_printed_helps(controller: str) -> None:
    """As it comes there is no tube; with all that the message says there is one."""
    loose = searched(controller, seconds=1.0).proved()
    text = loose.blame(50)
    assert "its bounds let Psi err by" in text and "adaptive.viscous = 0" in text and not loose.exists(50)
    close = searched(controller, *NARROW, *TOLD, seconds=1.0).proved()
    assert close.exists(0)


@compiled
def test_a_stack_that_tells_too_little_is_told_and_what_is_printed_helps(search: Search) -> None:
    """With its defaults nothing is bounded; with what the message says there is a tube."""
    loose = searched("concurrent", "concurrent.floor=true", seconds=6.0).proved()
    text = loose.blame(90)
    assert "smaller concurrent.noise" in text and "more concurrent.entries" in text and not loose.exists(90)
    assert search.proved().exists(90)


@compiled
def test_rounding_of_the_stack_is_small_and_counted(proved: ProvedConcurrent) -> None:
    assert 0.0 < proved.rounding < 1e-5
    none, before = np.zeros((len(proved.starts), 4)), proved.rounding
    found = proved.distances(50, none, none, none)[-1]
    proved.rounding = 1.0
    try:
        assert proved.distances(50, none, none, none)[-1] > found + 0.1
    finally:
        proved.rounding = before


@compiled
def test_the_rest_of_a_smaller_box_is_no_larger_than_is_said(confined: Confined) -> None:
    """Scaled from a wider box, against the Taylor models of the box itself, and not far above it."""
    rng, ratios = np.random.default_rng(4), []
    for b in (10, 50):
        wide = 10.0 ** rng.uniform(-3, -1, confined.steps.size)
        for share in (1.0, 0.5, 0.1):
            places, box = confined.places(b, share * wide)
            confined.rests[b] = wide, confined.features.smooth(*confined.places(b, wide))[2].max(axis=0)
            said = (share**2) * confined.rests[b][1]
            true = confined.features.smooth(places, box)[2].max(axis=0)
            confined.rests.clear()
            assert (true <= said * (1 + 1e-9)).all() and (true <= confined.rest(b, share * wide) * (1 + 1e-9)).all()
            ratios.append(float(true.max() / confined.rest(b, share * wide).max()))
    assert max(ratios) > 0.1


@compiled
def test_the_rest_is_scaled_from_the_box_that_it_was_taken_in(confined: Confined) -> None:
    """Boxes between two of the widths that are kept share one Taylor model; each has its own square."""
    wide = np.full(confined.steps.size, 2.0**-4.2)
    confined.rests.clear()
    whole = confined.rest(30, wide)
    half = confined.rest(30, 0.75 * wide)
    assert (half <= whole).all()
    np.testing.assert_allclose(half, 0.75**2 * whole, rtol=1e-9)
    confined.rests.clear()

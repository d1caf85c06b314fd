"""V changes as its terms say: V1 and the motion to first order of the period, the weights' part to rounding."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import numpy as np
import pytest
import sympy as sp
from proofs import KINDS, PERIOD, SLOW, learner, loop_of, subject_of
from scipy.special import expit

from mmnn_pin.actuator import Actuator
from mmnn_pin.disturbance import Push
from mmnn_pin.errors import RecordingError
from mmnn_pin.kinematic import Kinematic
from mmnn_pin.lab.psi.subject import Subject
from mmnn_pin.model.base.differential import DifferentialDrive
from mmnn_pin.sensing import Sensor
from mmnn_pin.torque.two_layer import TwoLayer
from research.proof.lyapunov import PREDICTED, TERMS, Lyapunov, growth, lyapunov, pose_part
from research.proof.networks import ideal_weights, network_part
from research.proof.proof import Proof

DURATION = 0.02 if SLOW else 0.3


@pytest.mark.parametrize("kind", KINDS)
def test_what_the_terms_miss_is_of_first_order_in_the_period(kind: str) -> None:
    """`hold` is measured minus predicted: half the period, half of it."""
    missed = []
    for period in (PERIOD, PERIOD / 2):
        v = lyapunov(subject_of(kind, loop_of(kind, period=period, duration=DURATION).run()), most=10**6)
        missed.append(np.abs(np.cumsum(v.terms["hold"]) * period).max() / np.ptp(v.total))
        np.testing.assert_allclose(np.sum(list(v.terms.values()), axis=0), v.measured, rtol=1e-9, atol=1e-9)
        np.testing.assert_allclose(np.diff(v.total) / period, v.measured[:-1], rtol=1e-6, atol=1e-6)
        np.testing.assert_allclose(v.predicted, v.measured - v.terms["hold"], rtol=1e-9, atol=1e-9)
    assert missed[0] < 0.1 and missed[1] < 0.7 * missed[0]
    assert (v.pose.any(), v.motion.any(), v.weights.any()) == (kind != "fixed", True, False)
    assert not v.terms["robust"].any() and not v.terms["leakage"].any() and (v.terms["feedback"] <= 0).all()


def test_v1_and_its_derivative_by_sympy() -> None:
    """Differentiate V1 along (3.2) with `v = alpha - z`: what comes out is decay and coupling."""
    ex, ey, ephi, vr, wr, z1, z2, kx, ky, kth = sp.symbols("ex ey ephi vr wr z1 z2 kx ky kth", positive=True)
    v = vr * sp.cos(ephi) + kx * ex - z1
    w = wr + vr * (ky * ey + kth * sp.sin(ephi)) - z2
    V1 = (ex**2 + ey**2) / 2 + (1 - sp.cos(ephi)) / ky
    rates = {ex: w * ey - v + vr * sp.cos(ephi), ey: -w * ex + vr * sp.sin(ephi), ephi: wr - w}
    rate = sum(V1.diff(q) * qdot for q, qdot in rates.items())
    exact = sp.lambdify((ex, ey, ephi, vr, wr, z1, z2, kx, ky, kth), (V1, rate))
    rng = np.random.default_rng(0)
    for _ in range(20):
        error, v_ref, z = rng.uniform(-1, 1, (1, 3)), rng.uniform(0, 1, (1, 2)), rng.uniform(-1, 1, (1, 2))
        gains = np.array([2.0, 30.0, 7.0])
        found = pose_part(DifferentialDrive, error, z, v_ref, gains)
        value, derivative = exact(*error[0], *v_ref[0], *z[0], 2.0, 30.0, 7.0)
        assert found.value[0] == pytest.approx(value)
        assert found.decay[0] + found.coupling[0] == pytest.approx(derivative)
        assert found.decay[0] <= 0


SETTINGS = {
    "per sample": {},
    "per second": {"rates": "per_second"},
    "scaled": {"inertia": "yes"},
    "no leakage": {"leakage": False},
    "projected": {"projection": 0.9},
    "hidden weights fixed": {"network": TwoLayer(hidden=6, F=(2.0, 1.0), G=(0.0, 0.0), kappa=0.3, v_range=0.5)},
}


@pytest.mark.parametrize("which", ["two_layer", "one_layer"])
@pytest.mark.parametrize("what", SETTINGS)
def test_the_weights_part_changes_exactly_as_its_terms_say(which: str, what: str) -> None:
    """Its value comes from the weights that the compiled law made, its terms from (3.54); they meet to rounding."""
    if which == "one_layer" and "hidden" in what:
        return
    more = dict(SETTINGS[what])
    if "inertia" in more:
        more["inertia"] = (2.0, 0.7, 0.3, 1.4)
    subject = Subject.of(loop_of("differential", learner("differential", which, **more), duration=DURATION).run())
    one = subject.networks
    assert one is not None
    every = np.arange(len(subject.rows))
    found = network_part(subject, one, ideal_weights(subject, one), every)
    s = subject.signal("nu_ref") - subject.signal("nu")
    error = (s * (subject.signal("psi") - subject.signal("psi_hat"))).sum(axis=1)
    change = np.diff(found.value) / PERIOD
    leakage, remainder, step = found.terms["leakage"], found.terms["remainder"], found.arrived["step"]
    projection = found.arrived["projection"]
    expected = (leakage + remainder - error)[:-1] + (step + projection)[1:]
    np.testing.assert_allclose(change, expected, rtol=1e-7, atol=1e-9 * np.abs(expected).max())
    assert found.missed == 0.0 and np.abs(change).max() > 1e-6
    assert leakage.any() == (what != "no leakage") and remainder.any() and (step >= 0).all()
    assert projection.any() == (what == "projected")


def test_the_remainder_is_what_the_thesis_calls_w() -> None:
    """`w = Wt' sigma' V*' x + W*' O + eps` with O of (3.34), each computed here from the formulas."""
    subject = Subject.of(loop_of("fixed", learner("fixed"), duration=0.01).run())
    one = subject.networks
    assert one is not None
    (ideal,) = ideal_weights(subject, one).values()
    found = network_part(subject, one, {2: ideal}, np.array([0]))
    W, V = one.start["W2"], one.start["V2"]
    names = one.controller.inputs.signals
    x = np.concatenate([subject.signal(name)[0] for name in names])
    sigma, ideal_sigma = expit(V.T @ x), expit(ideal.V.T @ x)
    slope = np.diag(sigma * (1 - sigma))
    higher = ideal_sigma - sigma - slope @ (ideal.V - V).T @ x
    eps = subject.signal("psi")[0] - ideal.W.T @ ideal_sigma
    w = (ideal.W - W).T @ slope @ ideal.V.T @ x + ideal.W.T @ higher + eps
    s = (subject.signal("nu_ref") - subject.signal("nu"))[0]
    linear = W.T @ slope @ (ideal.V - V).T @ x + (ideal.W - W).T @ (sigma - slope @ V.T @ x)
    assert found.terms["remainder"][0] == pytest.approx(s @ w)
    psi, psi_hat = subject.signal("psi")[0], subject.signal("psi_hat")[0]
    np.testing.assert_allclose(psi - psi_hat, linear + w, rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize("projection", [None, 0.9])
def test_appendix_b_updates_before_the_output(projection: float | None) -> None:
    """The weights of a sample are those after its step; `hold` takes what the order does."""
    controller = learner("differential", update="before_output", projection=projection)
    subject = Subject.of(loop_of("differential", controller, duration=DURATION).run())
    one = subject.networks
    assert one is not None
    ideal = ideal_weights(subject, one)
    v = lyapunov(subject, partial(network_part, subject, one, ideal), most=10**6)
    end = sum(weigh(one, ideal[i], i) for i, _ in one.networks)
    found = network_part(subject, one, ideal, np.array([len(subject.rows) - 1]))
    assert found.value[0] == pytest.approx(end) and v.missed == 0.0
    np.testing.assert_allclose(np.sum(list(v.terms.values()), axis=0), v.measured, rtol=1e-9, atol=1e-9)
    assert v.terms["projection"].any() == (projection is not None)


@pytest.mark.parametrize("update", ["after_output", "before_output"])
def test_a_projection_never_raises_v_for_ideal_weights_within_it(update: str) -> None:
    """Any weights within the bound will do, not only a fit."""
    controller = learner("differential", update=update, projection=0.9)
    subject = Subject.of(loop_of("differential", controller, duration=DURATION).run())
    one, rng = subject.networks, np.random.default_rng(0)
    assert one is not None
    ideal = ideal_weights(subject, one)
    for i, found in ideal.items():
        W, V = (0.9 * rng.uniform() * A / np.linalg.norm(A) for A in (found.W, found.V))
        ideal[i] = replace(found, W=W, V=V)
    term = network_part(subject, one, ideal, np.arange(len(subject.rows))).arrived["projection"]
    assert (term <= 1e-12 * np.abs(term).max()).all() and (term < 0).sum() > 5


def weigh(one, ideal, i: int) -> float:
    """The weights' part of a network at the end of a run, from (3.53) with rates per sample."""
    network = one.controller.network
    Wt, Vt = ideal.W - one.end[f"W{i}"], ideal.V - one.end[f"V{i}"]
    F, G = network.F[i - 1] / PERIOD, network.G[i - 1] / PERIOD
    return float(np.trace(Wt.T @ Wt) / F + np.trace(Vt.T @ Vt) / G) / 2


def test_sensors_that_err_have_a_term_of_their_own() -> None:
    controller = learner("differential")
    sensor = Sensor(noise=1e-3, velocity_noise=1e-2)
    subject = Subject.of(loop_of("differential", controller, duration=DURATION, sensor=sensor).run())
    v = lyapunov(subject, most=10**6)
    assert np.abs(v.terms["sensors"]).max() > 0
    # V is that of the true errors: its terms still add up, and what is held stays as small as with exact sensors
    share = np.abs(np.cumsum(v.terms["hold"]) * PERIOD).max() / np.ptp(v.total)
    assert share < 0.1
    exact = lyapunov(Subject.of(loop_of("differential", controller, duration=DURATION).run()))
    assert not exact.terms["sensors"].any()


def test_few_samples_tell_the_same_at_their_places() -> None:
    subject = Subject.of(loop_of("differential", learner("differential"), duration=DURATION).run())
    assert subject.networks is not None
    ideal = ideal_weights(subject, subject.networks)
    part = partial(network_part, subject, subject.networks, ideal)
    every, some = lyapunov(subject, part, most=10**6), lyapunov(subject, part, most=7)
    places = np.searchsorted(every.time, some.time)
    assert 1 < len(some.time) <= 7
    for name in TERMS:
        np.testing.assert_allclose(some.terms[name], every.terms[name][places], rtol=1e-9, atol=1e-12)
    np.testing.assert_array_equal(some.total, every.total[places])


def test_without_ky_there_is_no_v1() -> None:
    subject = Subject.of(loop_of("differential", duration=0.01).run())
    with pytest.raises(RecordingError, match="Lyapunov"):
        lyapunov(replace(subject, kinematic=Kinematic(ky=0.0)))


def test_a_run_that_was_lost_is_told_as_long_as_it_is_finite() -> None:
    run = loop_of("fixed", duration=0.05).run()
    run["nu"][40:] = np.nan
    subject = Subject.of(run)
    assert len(subject.rows) == 40 and len(lyapunov(subject).time) == 39


def test_a_recording_that_another_learner_made_is_not_taken_for_its_own() -> None:
    run = loop_of("fixed", learner("fixed"), duration=0.05).run()
    run["psi_hat"][:] *= 1.01
    proof = Proof(run)
    assert not proof.lyapunov.weights.any() and "misses the recorded Psi_hat by" in proof.left_out
    assert any("stepped again" in remark for remark in proof.remarks())


def test_growth_finds_when_and_why() -> None:
    n, h = 100, 0.01
    terms = {name: np.zeros(n) for name in TERMS}
    terms["feedback"] -= 1.0
    terms["remainder"][10:20] += 3.0
    terms["leakage"][50:55] += 1.5
    terms["leakage"][15] += 9.0
    measured = np.sum(list(terms.values()), axis=0)
    nothing = np.zeros(n)
    found = growth(Lyapunov(h * np.arange(n), h, nothing, nothing, nothing, measured, terms, 0.0))
    assert found.samples == pytest.approx(0.15)
    assert found.rise == pytest.approx(h * (10 * 2.0 + 9.0 + 5 * 0.5)) and found.fall == pytest.approx(h * 85)
    assert found.why == {"remainder": pytest.approx(9 / 15), "leakage": pytest.approx(6 / 15)}
    assert [(s.start, s.why) for s in found.spans] == [(0.1, "remainder"), (0.5, "leakage")]
    assert found.spans[0].end == pytest.approx(0.2) and found.spans[0].rise == pytest.approx(h * 29)
    assert found.work["feedback"] == pytest.approx(-1.0) and set(PREDICTED) < set(TERMS)
    falls = growth(Lyapunov(h * np.arange(n), h, nothing, nothing, nothing, -1 - nothing, terms, 0.0))
    assert falls.samples == 0 and falls.why == {} and falls.spans == ()


def test_motors_and_pushes_have_terms_of_their_own() -> None:
    """With them the terms still add up, and what is left for `hold` is as small as without."""
    more = {"actuator": Actuator(torque_gain=0.8), "disturbances": (Push(on="joint_0", force=2.0),)}
    subject = Subject.of(loop_of("fixed", duration=DURATION, **more).run())
    v = lyapunov(subject, most=10**6)
    assert np.abs(v.terms["motors"]).max() > 0 and np.abs(v.terms["push"]).max() > 0
    np.testing.assert_allclose(np.sum(list(v.terms.values()), axis=0), v.measured, rtol=1e-9, atol=1e-9)
    assert np.abs(np.cumsum(v.terms["hold"]) * PERIOD).max() < 0.1 * np.ptp(v.total)
    s = subject.signal("nu_ref") - subject.signal("nu")
    np.testing.assert_allclose(v.terms["push"], -2.0 * s[:-1, 0])
    np.testing.assert_allclose(v.terms["motors"], 0.2 * (s * subject.signal("torque")).sum(axis=1)[:-1])

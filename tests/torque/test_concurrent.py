"""Concurrent learning: the stack against numpy and brute force; its law; knowledge that outlasts the excitation."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from learning import assert_engines_agree, assert_frozen, assert_it_resumes, made
from numba import config
from test_composite import EIGHT

from mmnn_pin.errors import ConfigError
from mmnn_pin.model.regressor import Regressor
from mmnn_pin.model.tree.body import parameters
from mmnn_pin.torque.concurrent import ConcurrentSettings, estimate, into_ball
from mmnn_pin.torque.controller import ControllerState
from mmnn_pin.torque.history import ABOVE, HALF, Stack, consider, estimate_of, scratch, shapes
from mmnn_pin.torque.law import limit, motor_limits

seeds = st.integers(0, 2**32 - 1)
N, P, K = 6, 2, 5
CIRCLE = [
    "reference.base={type='circle', radius=1.0, speed=0.4, ramp=1.0}",
    "reference.arm=[{type='hold', value=0.1},{type='hold', value=0.1}]",
]


class Book:
    """A stack alone."""

    def __init__(self, entries=N, growth=0.05, lifetime=np.inf, floor=True):
        state = ControllerState.of(**shapes(entries, P, K))
        state["L"] = state["P"] = np.eye(K)
        state["born"], state["F"] = -1.0, HALF * np.eye(K)
        self.s, self.w = state.view(Stack), scratch(entries, P, K)
        self.growth, self.lifetime, self.floor, self.time = growth, lifetime, floor, 0.0

    def take(self, Phi, y):
        self.time += 1.0
        return consider(self.s, self.w, Phi, y, self.time, self.growth, self.lifetime, self.floor)

    def worth(self, Phis=None):
        Phis = self.s.Phi if Phis is None else Phis
        return np.linalg.slogdet(np.eye(K) + sum(A.T @ A for A in Phis))[1]


def drawn(rng, size=1.0):
    return size * np.exp(rng.standard_normal()) * rng.standard_normal((P, K)), rng.standard_normal(P)


@settings(max_examples=25, deadline=None)
@given(seeds, st.sampled_from([0.1, 1.0, 100.0]))
def test_the_stack_is_what_its_entries_say(seed, size):
    """L, P, b and G against numpy after many exchanges, and w_L against least squares with a prior."""
    book, rng = Book(lifetime=7.0, floor=False), np.random.default_rng(seed)
    for _ in range(40):
        book.take(*drawn(rng, size))
    s, target = book.s, np.zeros(K)
    L = np.eye(K) + sum(A.T @ A for A in s.Phi)
    np.testing.assert_allclose(s.L, L, rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(s.P, np.linalg.inv(L), rtol=1e-6, atol=1e-10)
    np.testing.assert_allclose(s.b, sum(A.T @ y for A, y in zip(s.Phi, s.y, strict=True)), rtol=1e-8, atol=1e-8 * size)
    for G, A in zip(s.G, s.Phi, strict=True):
        np.testing.assert_allclose(G, A @ np.linalg.inv(L) @ A.T, atol=1e-6)
    rows = np.vstack((np.eye(K), s.Phi.reshape(-1, K)))
    estimate_of(s, target)
    best = np.linalg.lstsq(rows, np.concatenate((np.zeros(K), s.y.ravel())), rcond=None)[0]
    np.testing.assert_allclose(target, best, atol=1e-6 * (1 + np.abs(best).max()))


@settings(max_examples=25, deadline=None)
@given(seeds)
def test_an_exchange_is_the_one_that_determinants_choose(seed):
    """By brute force: log det L of every exchange that keeps all eigenvalues of L - F above 0, one after the other."""
    book, rng = Book(), np.random.default_rng(seed)
    for _ in range(30):
        Phi, y = drawn(rng)
        before, kept = book.worth(), book.s.Phi.copy()
        full = book.s.used[0] == N
        options = [[*kept[:i], Phi, *kept[i + 1 :]] for i in range(N)] if full else [[*kept, Phi]]
        left = [(np.linalg.eigvalsh(np.eye(K) + sum(A.T @ A for A in o) - book.s.F)[0], o) for o in options]
        if min(abs(least) for least, _ in left) < 1e-9:
            continue
        best = max((book.worth(option) for least, option in left if least > 0), default=-np.inf)
        changed = book.take(Phi, y)
        if abs(best - before - book.growth) > 1e-9:
            assert changed == (best - before > book.growth)
        if changed:
            assert book.worth() == pytest.approx(best, abs=1e-9)
        else:
            np.testing.assert_array_equal(book.s.Phi, kept)


@settings(max_examples=25, deadline=None)
@given(seeds, st.sampled_from([0.1, 1.0, 100.0]))
def test_what_is_known_stays_known_whatever_is_exchanged(seed, size):
    """The floor only rises, L stays above it, so P below the inverse of every earlier floor, which follows L."""
    book, rng = Book(), np.random.default_rng(seed)
    floors = []
    for n in range(60):
        direction = rng.standard_normal(K) if n < 30 else np.eye(K)[n % 2]  # then two directions alone
        book.take(size * rng.standard_normal((P, 1)) * direction, rng.standard_normal(P))
        F, scale = book.s.F.copy(), np.linalg.norm(book.s.L)
        assert np.linalg.eigvalsh(book.s.L - F)[0] > -1e-9 * scale
        for earlier in floors:
            assert np.linalg.eigvalsh(F - earlier)[0] > -1e-9 * scale
            assert np.linalg.eigvalsh(np.linalg.inv(earlier) - book.s.P)[0] > -1e-9
        floors.append(F)
        assert book.worth() - np.linalg.slogdet(F)[1] <= K * np.log(ABOVE) + 1e-6


def test_without_a_floor_an_exchange_gives_up_what_alone_told_of_a_direction():
    """A weak equation of one direction beside strong ones of others: log det L would lose it, the floor does not."""
    weak, strong = np.zeros((P, K)), 30.0 * np.eye(K)
    weak[0, 0] = 2.0
    for floor in (True, False):
        book = Book(entries=3, growth=0.01, floor=floor)
        for Phi in (weak, strong[1:3], strong[3:5], 40.0 * np.eye(K)[1:3], 40.0 * np.eye(K)[3:5]):
            book.take(Phi, np.zeros(P))
        for angle in np.linspace(0.1, 1.5, 20):
            both = np.cos(angle) * np.eye(K)[1:3] + np.sin(angle) * np.eye(K)[3:5]
            book.take(80.0 * both, np.zeros(P))
        assert (book.s.L[0, 0] > 1.0 + 1e-9) == floor


def test_bounded_equations_are_exchanged_finitely_often():
    """The bound: each exchange adds `growth`, and log det L <= K log(1 + N sum of squares / K)."""
    book, rng = Book(growth=0.1), np.random.default_rng(0)
    for _ in range(300 if config.DISABLE_JIT else 5000):
        Phi, y = drawn(rng)
        book.take(Phi / max(1.0, np.linalg.norm(Phi)), y)
    assert book.s.used[1] <= K * np.log(1 + N / K) / 0.1


def test_entries_have_a_lifetime():
    book, rng = Book(lifetime=3.5, floor=False), np.random.default_rng(0)
    for _ in range(4):
        book.take(*drawn(rng))
    for _ in range(5):
        book.take(np.zeros((P, K)), np.zeros(P))
    np.testing.assert_allclose(book.s.L, np.eye(K), atol=1e-12)
    assert (book.s.born == -1.0).all() and not book.s.Phi.any()


@settings(max_examples=20, deadline=None)
@given(
    st.lists(st.floats(-1e150, 1e150) | st.just(np.nan) | st.just(np.inf), min_size=3, max_size=3), st.floats(0.1, 10)
)
def test_the_ball(numbers, radius):
    w = np.array(numbers)
    into_ball(w, radius)
    assert np.linalg.norm(w) <= radius * (1 + 1e-12)
    if np.isfinite(numbers).all() and np.linalg.norm(numbers) <= radius:
        np.testing.assert_array_equal(w, numbers)


@pytest.mark.compiled
@settings(max_examples=3 if config.DISABLE_JIT else 10, deadline=None)
@given(seeds, st.floats(0, 8))
def test_it_stays_bounded_whatever_the_sensors_say(seed, size):
    loop, rng = made("concurrent"), np.random.default_rng(seed)
    learner, context = loop.controller, loop.context()
    limits = motor_limits(loop.robot.E, np.full(loop.robot.dimensions.motors, 20.0))
    a, state, row = learner.law(context).learner, learner.init(context), context.layout.new_row()
    for k in range(30):
        row[:] = 10.0**size * rng.standard_normal(row.size)
        row[0] = k * a.h
        estimate(row, context.layout.offsets, a, state.values)
        assert np.linalg.norm(state["w"]) <= a.radius * (1 + 1e-9)
        psi_hat = row[context.layout.where("psi_hat")]
        limit(psi_hat, 0.0 * psi_hat, limits)
        motors = np.linalg.pinv(loop.robot.E) @ psi_hat
        assert (np.abs(motors) <= 20.0 * (1 + 1e-9)).all()


@pytest.mark.parametrize("tracking", [1e-3, 1e3])
def test_a_sample_is_the_law(tracking):
    """By numpy: Psi_hat, and w after the tracking term, below its share of the feedback and cut to it."""
    loop = made("concurrent", f"concurrent.tracking={tracking}")
    learner, context = loop.controller, loop.context()
    a, state, row = learner.law(context).learner, learner.init(context), context.layout.new_row()
    rng, k = np.random.default_rng(0), learner.dimension
    state["w"] = w = 0.1 * rng.standard_normal(k)
    A = rng.standard_normal((k, k))
    state["P"] = P = A @ A.T / k
    for name in ("z", "r"):
        row[context.layout.where(name)] = 1e-3 * rng.standard_normal(2)
    row[context.layout.where("nu_ref")] = nu_ref = rng.standard_normal(4)
    Y = learner.regressor.matrix(learner.regressor.massless.offset, np.zeros(4), nu_ref, np.zeros(4))
    Phi, s = Y @ learner.basis, np.concatenate([row[context.layout.where(n)] for n in ("z", "r")])
    estimate(row, context.layout.offsets, a, state.values)
    np.testing.assert_allclose(row[context.layout.where("psi_hat")], Y @ learner.start() + Phi @ w, rtol=1e-9)
    step = a.h * a.tracking * P @ Phi.T @ s
    late = s @ Phi @ step
    eta = min(1.0, a.share * s @ (a.gain * s) / late)
    assert (eta < 1.0) == (tracking > 1.0)
    np.testing.assert_allclose(state["w"], w + eta * step, rtol=1e-9)


@pytest.mark.compiled
def test_engines_batch_resumption_and_freezing():
    loop = made("concurrent", "concurrent.entries=5")
    assert_engines_agree(loop)
    assert_it_resumes(loop, loop.timing.duration / 2)
    assert_frozen(loop)


def test_the_basis_leaves_nothing_out():
    learner = made("concurrent").controller
    rng, regressor = np.random.default_rng(5), learner.regressor
    B = learner.basis
    for _ in range(5):
        Y = regressor.matrix(regressor.random_position(rng), *rng.standard_normal((3, 4)))
        scaled = np.diag(learner.root)
        delta = scaled * rng.standard_normal(regressor.size)
        w = np.linalg.lstsq(Y @ B, Y @ delta, rcond=None)[0]
        np.testing.assert_allclose(Y @ B @ w, Y @ delta, rtol=1e-8, atol=1e-8)
    assert learner.dimension == regressor.identifiable().shape[1] == 27


def test_the_basis_of_a_fit_has_its_covariance():
    """In all that torques depend on: its correlations, and deviations of at most the prior's."""
    without = made("concurrent").controller
    rng, size = np.random.default_rng(6), np.square(np.diag(without.root))
    A = 0.1 * np.sqrt(size)[:, None] * rng.standard_normal((len(size), len(size))) / np.sqrt(len(size))
    sure, wild = 3, 7
    A[sure], A[wild] = 1e-9 * A[sure], 1e6 * A[wild]
    learner = replace(without, nominal=without.start(), covariance=A @ A.T)
    said = np.linalg.norm(A, axis=1)
    kept = A / said[:, None] * np.minimum(said, np.sqrt(size))[:, None]
    assert said[wild] > np.sqrt(size[wild])
    for _ in range(5):
        Y = learner.regressor.matrix(learner.regressor.random_position(rng), *rng.standard_normal((3, 4)))
        ours = Y @ learner.basis
        wanted = Y @ kept @ kept.T @ Y.T
        np.testing.assert_allclose(ours @ ours.T, wanted, rtol=1e-6, atol=1e-8 * np.abs(wanted).max())
    assert np.abs(learner.root[sure]).max() < 1e-6 * np.sqrt(size[sure])
    assert np.linalg.norm(learner.root[wild]) < 1.01 * np.sqrt(size[wild])
    assert learner.dimension == without.dimension


@pytest.mark.skipif(config.DISABLE_JIT, reason="needs a long run")
def test_knowledge_outlasts_the_excitation():
    """A rich motion, then a circle with the arm still: the stack keeps what the tracking error alone loses."""
    gram = Regressor.of(made("pd").robot).gram()
    found = {}
    for name in ("concurrent", "adaptive"):
        rich, poor = made(name, *EIGHT, duration=24.0), made(name, *CIRCLE, duration=24.0)
        truth, state, errors = parameters(rich.robot), None, []
        for loop in (rich, poor):
            run = loop.run(state=state)
            state = loop.controller.init(loop.context())
            state.values[:] = run.final["controller_state"]
            theta = state["theta"] if name == "adaptive" else loop.controller.theta(state)
            errors.append((theta - truth) @ gram @ (theta - truth) / (truth @ gram @ truth))
        found[name] = (*errors, run.outcome.message)
    assert found["concurrent"][0] < 3e-3 and found["concurrent"][1] < 1.5 * found["concurrent"][0]
    assert found["adaptive"][1] > 10 * found["concurrent"][1] and found["adaptive"][1] > 2 * found["adaptive"][0]
    assert "not excited" not in found["concurrent"][2]
    alone = made("concurrent", *CIRCLE, duration=12.0).run().outcome
    assert alone.status == "completed" and "not excited" in alone.message


@pytest.mark.skipif(config.DISABLE_JIT, reason="needs a long run")
def test_with_a_lifetime_a_payload_is_learned():
    load = ["disturbances=[{type='payload', mass=3.0, start=12.0}]"]
    errors = {}
    for lifetime in (0.0, 6.0):
        loop = made("concurrent", *EIGHT, *load, f"concurrent.lifetime={lifetime}", duration=24.0)
        run = loop.run()
        late = run.time > 20.0
        errors[lifetime] = np.mean((run["psi"] - run["psi_hat"])[late] ** 2, axis=0)
    assert errors[6.0][2] < 0.05 * errors[0.0][2] and errors[6.0][3] < errors[0.0][3]


def test_a_gain_of_0_is_refused_before_anything_is_computed_from_it():
    loop = made("concurrent", "feedback.arm=[60.0,0.0]")
    for use in (lambda: loop.controller.notes, lambda: loop.controller.law(loop.context())):
        with pytest.raises(ConfigError, match="needs all > 0"):
            use()


def test_impossible_settings_are_refused_with_their_key():
    for name, value in (("entries", 0), ("rate", -1.0), ("noise", 0.0), ("growth", 0.0), ("pole", np.inf)):
        with pytest.raises(ConfigError) as error:
            ConcurrentSettings(**{name: value})
        assert error.value.key == f"concurrent.{name}"
    learner = made("concurrent").controller
    with pytest.raises(ConfigError, match="no nominal parameters"):
        replace(learner, settings=ConcurrentSettings(initial="nominal"))
    with pytest.raises(ConfigError, match="give 64 finite ones"):
        replace(learner, nominal=np.ones(3))
    nominal = made("concurrent", "concurrent.initial=nominal", "nominal.masses=0.5")
    np.testing.assert_allclose(nominal.controller.start()[0], 0.5 * parameters(nominal.robot)[0])

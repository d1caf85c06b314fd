"""The weights' parts of the learners that keep a covariance, or a stack of equations, and what changes them.

A linear learner with a covariance has `sum_i W~_i' P^-1 W~_i / (2 tau_i)`.
With the ideal weights W* and P as it was at every sample (`torque.linear`). Once in an interval the weights move by
`eta interval tau_i P Phi' s`, which takes `eta interval s' Phi W~` out: pull and cut. Then each equation `y = phi' W`
of filtered torque is one Kalman update with the variance R. Let `e = y - phi' W*` be what it has wrong, `u = phi' W~`
and `alpha = R + phi' P phi`. As the cost of least squares is the same before and after,

    W~' P^-1 W~ + e^2 / R = W~+' P+^-1 W~+ + (u + e)^2 / alpha,

it changes `W~' P^-1 W~` by

    prediction  -u^2 / alpha <= 0                               what filtered torque says
    noise       (-2 u e + e^2 phi' P phi / R) / alpha           what it has wrong: sensors, motors, what Phi cannot say

Variance q that comes back at a place j takes `q (P^-1 W~)_j^2 / (1 + q (P^-1)_jj)` out: the term `state`, never
positive, as errors count less where less is known. (Continuous: the two sums of V' in docs/learners.md.) The rest, the
second order of the first move and the projection onto the bound, is `step`.

A concurrent learner has `w~' L w~ / (2 tracking)` with L of its stack and `w* = basis^+ (theta - theta_0)` of the true
parameters, `w~ = w* - w` (see `torque.concurrent`). A sample moves w by `eta h tracking P Phi' s`, P = L^-1, which
takes `eta h s' Phi w~` out: pull and cut. When a candidate was looked at it goes on by a share `c = 1 - exp(-rate tau)`
towards `w_L = P b`. With exact equations `b = (L - 1) w*`, in truth `b = (L - 1) w* + d`, so that `L (w_L - w) = (L -
1) w~ - w + d`, and to first order in c the part changes by

    prediction  -c/tracking w~' (L - 1) w~ <= 0     what the stack says
    leakage      c/tracking w~' w                   the pull of the prior, to w_0 = 0
    noise       -c/tracking w~' d                   what the stack's equations have wrong

A change of the stack makes it jump by `w~' (L+ - L) w~ / (2 tracking)`, the term `state`. The rest, second order
and the ball that w is kept in, is `step`.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from scipy.linalg import solve_triangular

from ...errors import RecordingError
from ...signals import Array, IntArray
from ...torque.concurrent import History
from ...torque.controller import ControllerState
from ...torque.linear import Linear, Parts, measure, predict, track
from .learner import Learner
from .subject import Subject
from .weights_part import WITHOUT, Row, WeightsPart, copies, part_of, step_again

LEARNED = ("W", "U", "D", "prior", "counts")  # what an update changes


def covariance_part(
    subject: Subject, learner: Learner, ideal: Array, at: IntArray, progress: Callable[[float], None] | None = None
) -> WeightsPart:
    """The part at some rows of a run, (k,) ascending, for ideal weights (k, m).

    Raises:
        RecordingError: `tracking` is 0, so that nothing takes the pull out.
    """
    a: Linear = learner.controller.law(learner.context).learner
    if not (a.answer > 0).all():
        raise RecordingError(WITHOUT, why="the weights do not follow s: tracking is 0")
    ledger = Ledger(learner, a, ideal, len(subject.rows))
    missed = step_again(learner, subject.rows, ledger.keep, ledger.take, progress)
    value, pull, *rest = ledger.found[:, at]
    return part_of(
        subject, at, value, pull, dict(zip(("cut", "prediction", "noise", "memory"), rest, strict=True)), missed
    )


class Ledger:
    """What every update does to the part.

    Args:
        learner: The learner.
        a: The numbers of its law, with room of their own to work in.
        ideal: (k, m) ideal weights.
        rows: How many rows there are.

    Attributes:
        found: (6, rows) value, pull, cut, prediction, noise, memory.
        value: The part as it is now.
    """

    def __init__(self, learner: Learner, a: Linear, ideal: Array, rows: int) -> None:
        self.a, self.ideal, self.found = a, np.ascontiguousarray(ideal.T), np.zeros((6, rows))
        self.at, self.h = learner.context.layout.offsets, learner.context.control_period
        self.matters = learner.start["prior"] > 0.0
        self.value = self.energy(learner.start.view(Parts))

    def keep(self, state: ControllerState) -> dict[str, Array]:
        """The state before an update; of other samples the weights."""
        now = int(state["counts"][0]) % self.a.every == 0
        return copies(state, *LEARNED) if now else copies(state, "W")

    def take(self, row: Row) -> None:
        """Value, pull and terms of one row."""
        along = row.Phi @ (self.ideal - row.before["W"]).T  # (rows, m)
        pull = float(row.s @ along.ravel())
        self.found[:2, row.number] = self.value, pull
        if "U" in row.before:
            o = Parts(**row.state.view(Parts)._asdict() | row.before)
            self.found[2:, row.number] = np.array(self.update(row, o, pull)) / self.h
            self.value = self.energy(row.state.view(Parts))

    def update(self, row: Row, o: Parts, pull: float) -> tuple[float, float, float, float]:
        """Cut, prediction, noise and memory of one update, over the whole of it; changes o."""
        a, before, weighed = self.a, o.W.copy(), self.weighed(o)
        a.Phi[:] = row.Phi
        track(row.values, self.at, a, o)
        cut = a.interval * pull - float((weighed * (o.W - before)).sum())
        if row.state["counts"][1] == o.counts[1]:  # no control period to learn from
            return cut, 0.0, 0.0, 0.0
        prediction, noise, known = self.measured(row, o)
        predict(a, o)
        return cut, prediction, noise, self.energy(o) - known

    def measured(self, row: Row, o: Parts) -> tuple[float, float, float]:
        """Prediction and noise of the equations of an update, and the part after them; o stays."""
        a, m = self.a, len(self.ideal)
        W, U, D = o.W.copy(), o.U.copy(), o.D.copy()
        Phi_f, Y_f, f, b = row.state["Phi_f"], row.state["Y_f"], np.zeros(D.size), np.zeros(D.size)
        prediction = noise = 0.0
        for i, features in enumerate(Phi_f):
            phi, y = (features / a.gain[i], Y_f[i : i + 1] / a.gain[i]) if m == 1 else (features.copy(), Y_f)
            alpha = measure(U, D, phi, a.noise, f, b)
            if alpha == 0.0:
                continue
            u, e = (self.ideal - W) @ phi, y - self.ideal @ phi
            prediction -= float((u**2 / (2 * a.answer)).sum()) / alpha
            noise += float(((e**2 * (alpha / a.noise - 1.0) - 2 * u * e) / (2 * a.answer)).sum()) / alpha
            W += np.outer((y - W @ phi) / alpha, b)
        return prediction, noise, self.energy(o._replace(W=W, U=U, D=D))

    def energy(self, o: Parts) -> float:
        """The part."""
        z, D = self.rooted(o)
        return float(((z**2 / D[:, None]).sum(axis=0) / (2 * self.a.answer)).sum())

    def weighed(self, o: Parts) -> Array:
        """`P^-1 W~_i / tau_i`, (m, k)."""
        (z, D), found = self.rooted(o), np.zeros_like(self.ideal)
        back = solve_triangular(self.chosen(o.U), z / D[:, None], lower=True, unit_diagonal=True)
        found[:, self.matters] = back.T / self.a.answer[:, None]
        return found

    def rooted(self, o: Parts) -> tuple[Array, Array]:
        """`U^-1 W~` (k, m) and D, of the weights that the prior lets be."""
        error = (self.ideal - o.W)[:, self.matters].T
        found = solve_triangular(self.chosen(o.U), error, lower=True, trans="T", unit_diagonal=True)
        return np.asarray(found), o.D[self.matters]

    def chosen(self, U: Array) -> Array:
        """Rows and columns of U' that the prior lets be."""
        return U if self.matters.all() else U[np.ix_(self.matters, self.matters)]


def stack_part(
    subject: Subject, learner: Learner, ideal: Array, at: IntArray, progress: Callable[[float], None] | None = None
) -> WeightsPart:
    """The part at some rows of a run, (k,) ascending, for the true weights (k,).

    Raises:
        RecordingError: `tracking` is 0, so that nothing takes the pull out.
    """
    history: History = learner.controller.law(learner.context).learner
    if not history.tracking > 0:
        raise RecordingError(WITHOUT, why="the estimate does not follow s: tracking is 0")
    found = np.zeros((7, len(subject.rows)))
    missed = step_again(
        learner,
        subject.rows,
        lambda state: copies(state, "w", "L", "P"),
        lambda row: fill(history, ideal, row, found),
        progress,
    )
    value, pull, *rest = found[:, at]
    terms = dict(zip(("cut", "prediction", "leakage", "noise", "memory"), rest, strict=True))
    return part_of(subject, at, value, pull, terms, missed)


def fill(a: History, ideal: Array, row: Row, found: Array) -> None:
    """Value, pull and terms of one row."""
    w, L, P = (row.before[name] for name in ("w", "L", "P"))
    state, s, n = row.state, row.s, row.number
    error, g = ideal - w, row.Phi.T @ s
    found[0, n] = error @ L @ error / (2 * a.tracking)
    found[1, n] = g @ error
    answer, most = a.h * a.tracking * float(g @ P @ g), a.share * float(a.gain @ s**2)
    eta = most / answer if answer > most else 1.0
    found[2, n] = (1 - eta) * found[1, n]
    learned = int(state["samples"][0] - 1) % a.every == 0 and state["clock"][1] > a.filter.wait + 1
    if not learned:
        return
    w = w + eta * a.h * a.tracking * P @ g
    error, now, weight = ideal - w, state["L"], (1 - np.exp(-a.rate * a.every * a.h)) / a.tracking
    seen = now @ ideal - ideal
    found[3, n] = -weight * (error @ now @ error - error @ error) / a.h
    found[4, n] = weight * (error @ w) / a.h
    found[5, n] = -weight * (error @ (state["b"] - seen)) / a.h
    found[6, n] = error @ (now - L) @ error / (2 * a.tracking * a.h)

"""Learners that are linear in their weights, `Psi_hat = Psi_0 + Phi W`: ideal weights, and the weights' part of V.

*Ideal weights.* With a regressor of the robot they are its true parameters (`truth`), where the weights are those.
Otherwise they are found by least squares of the true Psi on the features of the run, every component over its variance.
Where all components share the weights it is the shortest of all that are best; where each has its own, as random
features have, far more of them than a run tells apart, there is a small penalty as for networks,

    FVU_i + PENALTY mean over j of (W_ij / unit_ij)^2   ->   min over W_i

with the standard deviations of the learner's prior as units, or, without a prior, those that bring all features and Psi
to one size. What ideal weights leave is what no learning could explain there; outside the visited set it bounds
nothing.

*A learner with a covariance* has the part `sum_i W~_i' P^-1 W~_i / (2 tau_i)`, with the ideal weights W* and P as it
was at every sample (`torque.linear`). At an update, t after the last one, the weights move by `eta t tau_i P Phi' s`,
which takes `eta t s' Phi W~` out: pull and cut. Then each equation `y = phi' W` of filtered torque is one Kalman update
with a variance R that goes with 1 / t. Let `e = y - phi' W*` be what it has wrong, `u = phi' W~` and `alpha = R + phi'
P phi`. As the cost of least squares is the same before and after,

    W~' P^-1 W~ + e^2 / R = W~+' P+^-1 W~+ + (u + e)^2 / alpha,

it changes `W~' P^-1 W~` by

    prediction  -u^2 / alpha <= 0                               what filtered torque says
    noise       (-2 u e + e^2 phi' P phi / R) / alpha           what it has wrong: sensors, motors, what Phi cannot say

Variance q that comes back at a place j takes `q (P^-1 W~)_j^2 / (1 + q (P^-1)_jj)` out: the term `memory`, never
positive, as errors count less where less is known. (Continuous: V' in docs/explanation/learners.md.) The rest, the
second order of the first move and the projection onto the bound, is `step`.

*A concurrent learner* has `w~' L w~ / (2 tracking)` with L of its stack and `w* = basis^+ (theta - theta_0)` of the
true parameters, `w~ = w* - w` (see `torque.concurrent`). A sample moves w by `eta h tracking P Phi' s`, P = L^-1, which
takes `eta h s' Phi w~` out: pull and cut. When a candidate was looked at it goes on by a share `c = 1 - exp(-rate tau)`
towards `w_L = P b`. With exact equations `b = (L - 1) w*`, in truth `b = (L - 1) w* + d`, so that `L (w_L - w) = (L -
1) w~ - w + d`, and to first order in c the part changes by

    prediction  -c/tracking w~' (L - 1) w~ <= 0     what the stack says
    leakage      c/tracking w~' w                   the pull of the prior, to w_0 = 0
    noise       -c/tracking w~' d                   what the stack's equations have wrong

A change of the stack makes it jump by `w~' (L+ - L) w~ / (2 tracking)`, the term `memory`. The rest, second order and
the ball that w is kept in, is `step`.

*Any other* needs nothing but what a learner tells of itself: with `features` Phi and `gain` Gamma [1/s in its units] it
is taken to follow s by `W' = Gamma Phi' s`. Over a sample of period h that would change `tr(W~' Gamma^-1 W~) / 2` by
`-h s' Phi W~ + h^2 tr(g' Gamma g) / 2`, `g = Phi' s`: pull and `step`. What the law changes it by beyond that, in W or
in Gamma, is the term `own`: prediction errors, leakage, forgetting, bounds.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import LinAlgError, cho_factor, cho_solve, solve_triangular

from mmnn_pin.errors import RecordingError
from mmnn_pin.lab.psi.excitation import along
from mmnn_pin.lab.psi.learner import Learner, LearnerStepper
from mmnn_pin.lab.psi.subject import Subject
from mmnn_pin.settings import finite
from mmnn_pin.signals import Array, IntArray
from mmnn_pin.torque.controller import ControllerState
from mmnn_pin.torque.factored import measure
from mmnn_pin.torque.learning_law import LearningLaw
from mmnn_pin.torque.linear import Linear, Parts, forget_load, predict, track

from .claims import TellsPrior
from .truth import true_weights
from .weights_part import WITHOUT, Progress, WeightsPart, part_of, step_again

LEARNED = ("W", "U", "D", "prior", "counts")  # what an update of a covariance changes
PENALTY = 1e-6
STILL = 1e-12  # a feature whose RMS is a smaller share of the largest one's is rounding: it does not move
CUT = 1e-9  # singular values below this share of the largest count as zero
MOST = 2000  # rows that a fit sees, evenly spread


@dataclass(frozen=True, eq=False)
class LinearFit:
    """The best fixed weights of a linear learner on the visited set."""

    W: Array  # (k, m) weights; m is 1 where all components share them, else p
    norm: float  # |W|
    eps: Array  # (p,) largest `|Psi - Psi_0 - Phi W|` on the visited set [N, N m]
    unexplained: Array  # (p,) fraction of variance that they leave
    # how far the run's weights are from them at its start and end, (2,): RMS of `Phi (W - W_run)` over the standard
    # deviation of Psi; NaN where the weights are kept otherwise
    distance: Array
    true: bool = False  # whether they are the robot's parameters, not a fit
    still: int = 0  # weights whose features stay 0 in the run: it does not determine them, and here they are 0

    def to_dict(self) -> dict[str, Any]:
        """Norm, distances and errors for JSON."""
        ends = {"start": finite(self.distance[0]), "end": finite(self.distance[1])}
        eps, left = ([finite(value) for value in values] for values in (self.eps, self.unexplained))
        numbers = {"norm": finite(self.norm), "undetermined": self.still, "distance": ends, "eps": eps, "fvu": left}
        return {"linear": numbers}


def linear_fit(subject: Subject, learner: Learner) -> LinearFit | None:
    """The best fixed weights of a run's learner, its true ones where they are known; None without features."""
    at = np.arange(0, len(subject.rows), -(-len(subject.rows) // MOST))
    samples = along(learner, subject.rows[at])
    if samples is None:
        return None
    (Phi, psi_hat), psi = samples, subject.signal("psi")[at]
    m = 1 if Phi.shape[1] > 1 else psi.shape[1]
    ends = [of_shape(learner.controller.weights(state), Phi.shape[2], m) for state in (learner.start, learner.end)]
    nominal = 0.0 if ends[1] is None else psi_hat - (Phi @ ends[1]).reshape(psi.shape)
    target, scale = psi - nominal, np.sqrt(variances(psi))
    true, flat = true_weights(subject, learner), (Phi / scale[:, None]).reshape(-1, Phi.shape[2])
    if true is not None:
        W = true[:, None]
    elif Phi.shape[1] == 1:
        W = penalised(Phi[:, 0], target, PENALTY * variances(psi) / Phi.shape[2], units(learner, Phi[:, 0], scale))
    else:
        W = least_squares(flat, (target / scale).reshape(-1, 1))
    left = target - (Phi @ W).reshape(psi.shape)
    return LinearFit(
        W=W,
        norm=float(np.linalg.norm(W)),
        eps=np.abs(left).max(axis=0),
        unexplained=(left**2).mean(axis=0) / variances(psi),
        true=true is not None,
        still=0 if true is not None else int((~moving(flat)).sum()) * W.shape[1],
        distance=np.array([np.nan if W_run is None else away(Phi @ (W - W_run), scale) for W_run in ends]),
    )


def units(learner: Learner, Phi: Array, scale: Array) -> Array:
    """What a weight of every feature and component counts as one, (k, p); 0 for one that the prior does not let be."""
    law = learner.controller
    if isinstance(law, TellsPrior) and (deviation := law.prior_deviation(learner.start)) is not None:
        return np.asarray(deviation)
    size = np.sqrt((Phi**2).mean(axis=0))
    return np.divide(1.0, size, out=np.zeros_like(size), where=size > 0)[:, None] * scale


def penalised(Phi: Array, target: Array, penalties: Array, unit: Array) -> Array:
    """Weights (k, p) of least penalised squares for features (n, k), target (n, p), penalties (p,) and units (k, p)."""
    gram, cross = Phi.T @ Phi / len(Phi), Phi.T @ target / len(Phi)
    columns = []
    for i, one in enumerate(unit.T):
        factor = cho_factor(gram * np.outer(one, one) + penalties[i] * np.eye(len(gram)))
        columns.append(one * cho_solve(factor, one * cross[:, i]))
    return np.column_stack(columns)


def variances(target: Array) -> Array:
    """Variance of every component, at least a trace of its mean square: a constant is a target, too."""
    return np.maximum(target.var(axis=0), 1e-6 * (target**2).mean(axis=0) + 1e-300)


def away(difference: Array, scale: Array) -> float:
    """RMS of a difference in Psi_hat (n, rows, m), each component over its scale (p,)."""
    return float(np.sqrt(((difference.reshape(-1, scale.size) / scale) ** 2).mean()))


def moving(table: Array) -> NDArray[np.bool_]:
    """Which features (k,) of a table (n, k) are more than rounding."""
    size = np.sqrt((table**2).mean(axis=0))
    return np.asarray(size > STILL * size.max(initial=0.0))


def least_squares(table: Array, target: Array) -> Array:
    """The shortest weights (k, m) of least squares, in units in which all features are of one size; 0 of still ones."""
    moves, size = moving(table), np.sqrt((table**2).mean(axis=0))
    found = np.zeros((table.shape[1], target.shape[1]))
    found[moves] = np.linalg.lstsq(table[:, moves] / size[moves], target, rcond=CUT)[0] / size[moves, None]
    return found


def of_shape(weights: dict[str, Array], k: int, m: int) -> Array | None:
    """The one array of weights with k m numbers, as (k, m); None without exactly one."""
    result = [array for array in weights.values() if array.size == k * m]
    if len(result) != 1:
        return None
    return result[0].T if result[0].shape == (m, k) and m > 1 else result[0].reshape(k, m)


class LinearSample(NamedTuple):
    """One sample of a linear learner."""

    number: int  # which
    values: Array  # (width,) the recorded row
    s: Array  # (p,) the error that it learned from
    Phi: Array  # (rows, k) features at it, with the state before
    before: Any  # what was kept of the state before
    state: ControllerState  # the state after


def linear_steps(
    subject: Subject,
    learner: Learner,
    keep: Callable[[ControllerState], Any],
    visit: Callable[[LinearSample], None],
    progress: Progress,
) -> float:
    """`step_again` with features: visit every row, with what is kept of the state before it."""
    still = LearnerStepper(learner, learner.start.snapshot(), learning=False)
    own, s = isinstance(learner.controller, LearningLaw), subject.s

    def before(n: int, row: Array, stepper: LearnerStepper) -> tuple[Array | None, Any]:
        if own:  # features of a user's law may be learned
            still.state.values[:] = stepper.state.values
        still.step(row)
        return still.features(), keep(stepper.state)

    def after(n: int, row: Array, stepper: LearnerStepper, kept: Any) -> None:
        visit(LinearSample(n, row, s[n], kept[0], kept[1], stepper.state))

    return step_again(learner, subject.rows, before, after, progress)


def copies(state: ControllerState, *parts: str) -> dict[str, Array]:
    """Parts of a state, by name."""
    return {name: state[name].copy() for name in parts}


def covariance_part(
    subject: Subject, learner: Learner, ideal: Array, at: IntArray, progress: Progress = None
) -> WeightsPart:
    """The part at some rows of a run, (k,) ascending, for ideal weights (k, m).

    Raises:
        RecordingError: `tracking` is 0, so that nothing takes the pull out.
    """
    a: Linear = learner.controller.law(learner.context).learner
    if not (a.answer > 0).all():
        raise RecordingError(WITHOUT, why="the weights do not follow s: tracking is 0")
    ledger = Ledger(learner, a, ideal, len(subject.rows))
    missed = linear_steps(subject, learner, ledger.keep, ledger.take, progress)
    value, pull, *rest = ledger.found[:, at]
    terms = dict(zip(("cut", "prediction", "noise", "memory"), rest, strict=True))
    return part_of(subject, at, value, pull, terms, missed)


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
        """The state before an update, or where an alarm may come; of other samples the weights."""
        return copies(state, *(LEARNED if self.a.alarm > 0.0 or self.due(state["counts"]) else ("W",)))

    def due(self, counts: Array) -> bool:
        """Whether the next sample is an update."""
        return int(counts[0]) % self.a.every == 0 or counts[5] > 0.0

    def take(self, row: LinearSample) -> None:
        """Value, pull and terms of one row."""
        pull = float(row.s @ (row.Phi @ (self.ideal - row.before["W"]).T).ravel())
        self.found[:2, row.number] = self.value, pull
        if "U" in row.before:
            o = Parts(**row.state.view(Parts)._asdict() | row.before)
            self.found[2:, row.number] = np.array(self.update(row, o, pull)) / self.h
            self.value = self.energy(row.state.view(Parts))

    def update(self, row: LinearSample, o: Parts, pull: float) -> tuple[float, float, float, float]:
        """Cut, prediction, noise and memory of one update, over the whole of it; changes o."""
        a, before, cut, forgotten = self.a, o.W.copy(), 0.0, 0.0
        o.counts[6] += 1.0
        if self.due(o.counts):
            weighed = self.weighed(o)
            a.Phi[:] = row.Phi
            track(row.values, self.at, a, o)
            cut = o.counts[6] * self.h * pull - float((weighed * (o.W - before)).sum())
        if row.state["counts"][3] > 0.0:
            forgotten = -self.energy(o)
            forget_load(a, o)
            forgotten += self.energy(o)
        if row.state["counts"][1] == o.counts[1]:  # no update, or no control period to learn from
            return cut, 0.0, 0.0, forgotten
        prediction, noise, known = self.measured(row, o)
        predict(a, o)
        return cut, prediction, noise, forgotten + self.energy(o) - known

    def measured(self, row: LinearSample, o: Parts) -> tuple[float, float, float]:
        """Prediction and noise of the equations of an update, and the part after them; o stays."""
        a, m = self.a, len(self.ideal)
        W, U, D = o.W.copy(), o.U.copy(), o.D.copy()
        Phi_f, Y_f, f, b = row.state["Phi_f"], row.state["Y_f"], np.zeros(D.size), np.zeros(D.size)
        prediction, noise, R = 0.0, 0.0, a.noise * a.interval / (o.counts[6] * self.h)
        for i, features in enumerate(Phi_f):
            phi, y = (features / a.gain[i], Y_f[i : i + 1] / a.gain[i]) if m == 1 else (features.copy(), Y_f)
            alpha = measure(U, D, phi, R, f, b)
            if alpha == 0.0:
                continue
            u, e = (self.ideal - W) @ phi, y - self.ideal @ phi
            prediction -= float((u**2 / (2 * a.answer)).sum()) / alpha
            noise += float(((e**2 * (alpha / R - 1.0) - 2 * u * e) / (2 * a.answer)).sum()) / alpha
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
    subject: Subject, learner: Learner, ideal: Array, at: IntArray, progress: Progress = None
) -> WeightsPart:
    """The part at some rows of a run, (k,) ascending, for the true weights (k,) or (k, 1).

    Raises:
        RecordingError: `tracking` is 0, so that nothing takes the pull out.
    """
    a, ideal = learner.controller.law(learner.context).learner, ideal.ravel()
    if not a.tracking > 0:
        raise RecordingError(WITHOUT, why="the estimate does not follow s: tracking is 0")
    found = np.zeros((7, len(subject.rows)))

    def visit(row: LinearSample) -> None:
        (w, L, P), state, s, n = row.before.values(), row.state, row.s, row.number
        error, g = ideal - w, row.Phi.T @ s
        pull = g @ error
        answer, most = a.h * a.tracking * float(g @ P @ g), a.share * float(a.gain @ s**2)
        eta = most / answer if answer > most else 1.0
        found[:3, n] = error @ L @ error / (2 * a.tracking), pull, (1 - eta) * pull
        if int(state["samples"][0] - 1) % a.every or state["clock"][1] <= a.filter.wait + 1:
            return  # nothing was learned from the stack
        w = w + eta * a.h * a.tracking * P @ g
        error, now, weight = ideal - w, state["L"], (1 - np.exp(-a.rate * a.every * a.h)) / a.tracking
        found[3, n] = -weight * (error @ now @ error - error @ error) / a.h
        found[4, n] = weight * (error @ w) / a.h
        found[5, n] = -weight * (error @ (state["b"] - (now @ ideal - ideal))) / a.h
        found[6, n] = error @ (now - L) @ error / (2 * a.tracking * a.h)

    missed = linear_steps(subject, learner, lambda state: copies(state, "w", "L", "P"), visit, progress)
    value, pull, *rest = found[:, at]
    terms = dict(zip(("cut", "prediction", "leakage", "noise", "memory"), rest, strict=True))
    return part_of(subject, at, value, pull, terms, missed)


def gain_part(subject: Subject, learner: Learner, ideal: Array, at: IntArray, progress: Progress = None) -> WeightsPart:
    """The part at some rows of a run, (k,) ascending, for ideal weights (k, m).

    Raises:
        RecordingError: The law tells no gain, or one that is not positive definite; or not which array its weights are.
    """
    h, found = learner.context.control_period, np.zeros((3, len(subject.rows)))
    weights_error(learner, learner.start, ideal)  # before the run is stepped again

    def visit(row: LinearSample) -> None:
        error, weighed, gain = row.before
        g = row.Phi.T @ row.s[:, None] if ideal.shape[1] == 1 else np.outer(row.Phi[0], row.s)
        after, weighed_after, _ = weights_error(learner, row.state, ideal)
        change = ((after * weighed_after).sum() - (error * weighed).sum()) / (2 * h)
        pull, step = (g * error).sum(), h * (g * times(gain, g)).sum() / 2
        found[:, row.number] = (error * weighed).sum() / 2, pull, change + pull - step

    missed = linear_steps(subject, learner, lambda state: weights_error(learner, state, ideal), visit, progress)
    value, pull, own = found[:, at]
    return part_of(subject, at, value, pull, {"own": own}, missed)


def weights_error(learner: Learner, state: ControllerState, ideal: Array) -> tuple[Array, Array, Array]:
    """`W~` and `Gamma^-1 W~` (k, m), and Gamma, at a state; errors as in `gain_part`."""
    law, yours = learner.controller, isinstance(learner.controller, LearningLaw)
    method = "gain(state)" if yours else "learning_gain(state, context)"
    gain, W = law.learning_gain(state, learner.context), of_shape(law.weights(state), *ideal.shape)
    if gain is None:
        raise left_out(
            f"{law.name} does not tell its learning gain",
            f"write a method {method} that returns Gamma of W' = Gamma Phi' s + ...: a number, (k,) or (k, k)",
        )
    if W is None:
        what = f"not exactly one learned array of {law.name} has the {ideal.size} numbers that its features multiply"
        raise left_out(what, "name it in `learned`" if yours else "return one such array in `weights`")
    gain, k = np.array(gain, float), len(ideal)
    if gain.shape not in ((), (k,), (k, k)):
        raise left_out(f"{method} of {law.name} has the shape {gain.shape}", f"return one number, ({k},) or ({k}, {k})")
    if gain.ndim < 2 and not (np.isfinite(gain).all() and (gain > 0).all()):
        raise indefinite(law.name, method)
    if gain.ndim < 2:
        return ideal - W, (ideal - W) / (gain[:, None] if gain.ndim else gain), gain
    try:
        return ideal - W, np.asarray(cho_solve(cho_factor((gain + gain.T) / 2), ideal - W)), gain
    except (LinAlgError, ValueError) as problem:
        raise indefinite(law.name, method) from problem


def indefinite(name: str, method: str) -> RecordingError:
    """The error of a law whose gain is none."""
    return left_out(f"{method} of {name} is not positive definite", "return one that is")


def left_out(why: str, fix: str) -> RecordingError:
    """Why a law's weights have no part in V, and what to write."""
    return RecordingError(WITHOUT, why=f"{why}; {fix}")


def times(gain: Array, g: Array) -> Array:
    """`Gamma g` of (k, m)."""
    return np.asarray(gain @ g if gain.ndim == 2 else (gain if gain.ndim == 0 else gain[:, None]) * g)

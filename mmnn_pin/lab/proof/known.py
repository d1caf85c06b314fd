"""How far Psi_hat can be from Psi on every motion in a tube, from an instant on: docs/explanation/theory.md, section 9.

`Observed` takes the errors of the run: nothing is proved of what the learner does on another motion. `Proved` takes the
law of `torque.linear` with a regressor. With the true parameters W*, `W~ = W* - W` and N = |W~| in the metric P^-1,

    |Psi~_i| <= N sqrt(Phi_i P Phi_i') + what the parameters do not say of Psi

and from one sample to the next, whatever was measured,

    an update along s   W+ = W + eta tau T P Phi' s     N+  <= N + tau T sum_i |s_i| sqrt(Phi_i P Phi_i')
    an equation         y = phi' W* + e, variance R     N+^2 = N^2 + e^2 / R - (u + e)^2 / alpha <= N^2 + e^2 / R
    drift               P grows                         N+  <= N
    no update at all                                    N, P stay

while P grows by nothing but the drift: `P <= P(t_0) + what has come back since`, as an equation's update of P is
monotone in P and takes away. A cut (eta < 1) is counted as none. The projection keeps its hands off as long as
`|W*| + |W~|`, in the metric of the prior, is within its bound, else nothing is said.

Of the equations' errors e are *sampled*: the largest in every block of the run, times `MORE`, and the external force.
`allowed` says what the energy of the adaptive laws, which have no such covariance, leaves open.
"""

from __future__ import annotations

from typing import Any, Protocol

import numpy as np

from ...errors import RecordingError
from ...signals import Array, IntArray
from ...torque.adaptive import Adaptive
from ...torque.concurrent import Concurrent
from ...torque.kalman import Kalman
from ...torque.pseudo_inertia import BODY, pseudo_inertias
from .learner import Stepper
from .periods import STEP, Periods
from .truth import distances, metric, numbers_of, regressors, true_parameters, true_weights
from .weights_part import LOST, step_again

MORE = 1.5  # than the largest error of an equation, or change of the features, that was seen
LOOKS = 4  # at the features in every block
INSTANTS, HALVINGS = 5, 20  # of a run, for what an energy allows; of a bisection


class Errors(Protocol):
    """Bounds of the error of Psi along a tube."""

    def eps(self, first: int, boxes: Array) -> Array:
        """(K, p) by block, for motions whose states are in boxes (K, m) from block `first` on [N, N m]; 0 before."""


class Observed:
    """The errors of the run from every block on; args: `missed` (N, p), and `starts` (K,) of the blocks."""

    def __init__(self, missed: Array, starts: IntArray) -> None:
        later = np.maximum.accumulate(missed[::-1], axis=0)[::-1]
        self.largest = np.asarray(later[starts])

    def eps(self, first: int, boxes: Array) -> Array:
        """As of `Errors`; the boxes do not matter."""
        return np.where((np.arange(len(self.largest)) >= first)[:, None], self.largest, 0.0)


class Proved:
    """What the law of a linear learner with a regressor says from its state at the beginning of any block.

    Args:
        periods: The loop.
        starts: (K,) first period of every block.
        ends: (K,) first period after it.
        force: (p,) largest external force [N, N m].

    Attributes:
        distance: (K,) N at the beginning of every block.
        P: (K, k, k) covariance then.
        equations: (K, p) bounds of the equations' errors, over K [m/s, rad/s].
        updates: (K,) of a block.

    Raises:
        RecordingError: The law is another one, or a condition fails; what to change.
    """

    def __init__(self, periods: Periods, starts: IntArray, ends: IntArray, force: Array) -> None:
        subject = periods.subject
        if why := unproved(periods):
            raise RecordingError("no bound of the learner's error", why=why)
        assert subject.learner is not None
        self.periods, self.starts, self.ends, self.learner = periods, starts, ends, subject.learner
        self.a = self.learner.controller.law(self.learner.context).learner
        ideal = true_weights(subject, self.learner)
        if ideal is None:
            raise RecordingError("no bound of the learner's error", why="its robot has no true parameters")
        self.ideal, K = ideal.ravel(), len(starts)
        self.prior = self.learner.start["prior"].copy()
        self.distance, self.P = np.zeros(K), np.zeros((K, self.ideal.size, self.ideal.size))
        self.equations, self.updates, self.done = np.zeros((K, len(self.a.gain))), np.zeros(K, int), np.zeros(K, int)
        missed = step_again(self.learner, subject.rows, self._before, self._after)
        if not missed <= LOST:
            raise RecordingError("no bound of the learner's error", why="stepped again it says another Psi_hat")
        self.equations = MORE * self.equations + force / self.a.gain
        self._look()

    def _before(self, n: int, row: Array, stepper: Stepper) -> float:
        b = int(np.searchsorted(self.starts, n))
        if b < len(self.starts) and self.starts[b] == n:
            _, self.P[b] = self.learner.controller.knowledge(stepper.state)
            self.distance[b] = self.length(self.ideal - stepper.state["W"][0], self.P[b])
            self.done[b] = int(stepper.state["counts"][1])
        return float(stepper.state["counts"][1])

    def _after(self, n: int, row: Array, stepper: Stepper, counted: float) -> None:
        state, b = stepper.state, min(int(np.searchsorted(self.starts, n, side="right")) - 1, len(self.starts) - 1)
        if state["counts"][1] > counted:
            error = np.abs(state["Y_f"] - state["Phi_f"] @ self.ideal) / self.a.gain
            self.equations[b] = np.maximum(self.equations[b], error)
            self.updates[b] += 1

    def length(self, error: Array, P: Array) -> float:
        """N of an error of the weights (k,)."""
        matters = self.prior > 0.0
        e = error[matters]
        return float(np.sqrt(e @ np.linalg.solve(P[np.ix_(matters, matters)], e)))

    def _look(self) -> None:
        """Features along the reference (K, LOOKS, p, k), how s answers a state, and what the parameters do not say."""
        periods, rest, rows = self.periods, np.zeros(self.periods.size), self.periods.subject.rows
        places = [np.linspace(a, b, LOOKS).astype(int) for a, b in zip(self.starts, self.ends, strict=True)]
        self.Phi = np.array([[self.features(rows[j], rest)[0] for j in some] for some in places])
        self.answers = np.array([self.slopes(rows[j]) for j in self.starts])
        left = []
        for j in self.starts:
            row, where = rows[j], periods.layout.where
            y = periods.state(row, row[where("position")], row[where("nu")])
            left.append(np.abs(row[where("psi")] - self.features(row, y)[0] @ self.ideal))
        self.unsaid = MORE * np.max(left, axis=0)

    def features(self, row: Array, y: Array) -> tuple[Array, Array]:
        """Phi (p, k) and s (p,) at a state."""
        where, (row, position, nu) = self.periods.layout.where, self.periods.seen(row, y)
        nu_ref = row[where("nu_ref")]
        regressor = self.learner.controller.regressor
        return regressor.matrix(position, nu, nu_ref, row[where("nudot_ref")]), nu_ref - nu

    def slopes(self, row: Array) -> Array:
        """(p, m) absolute slopes of s."""
        every = STEP * np.eye(self.periods.size)
        ends = [np.array([self.features(row, sign * y)[1] for y in every]) for sign in (1.0, -1.0)]
        return np.asarray(np.abs(ends[0] - ends[1]).T / (2 * STEP))

    def spread(self, first: int, boxes: Array) -> Array:
        """(K, p) the largest `sqrt(Phi_i P Phi_i')` by block, from block `first` on, in boxes (K, m)."""
        K, k = len(self.starts), self.ideal.size
        found, rng, came = np.zeros((K, len(self.a.gain))), np.random.default_rng(1), np.zeros(k)
        done = self.done[first] if self.a.learning else 0
        for b in range(first, K):
            for _ in range(self.updates[b] if self.a.learning else 0):
                came[done % k] += self.a.drift * k * self.prior[done % k]
                done += 1
            P = self.P[first] + np.diag(came)
            along = roots(self.Phi[b], P).max(axis=0)
            y = boxes[b] * rng.choice((-1.0, 1.0), len(boxes[b]))
            corner = roots(self.features(self.periods.subject.rows[self.starts[b]], y)[0], P)
            found[b] = along + MORE * np.maximum(corner - roots(self.Phi[b, 0], P), 0.0)
        return found

    def distances(self, first: int, boxes: Array, spread: Array) -> Array:
        """(K,) bounds of N by block, from block `first` on."""
        N, found, steps = self.distance[first], np.zeros(len(self.starts)), self.a.answer[0] * self.a.interval
        for b in range(first, len(self.starts)):
            s = MORE * self.answers[b] @ boxes[b]
            moved, wrong = steps * float(s @ spread[b]), float((self.equations[b] ** 2).sum()) / self.a.noise
            for _ in range(self.updates[b] if self.a.learning else 0):
                N = np.hypot(N + moved, np.sqrt(wrong))
            found[b] = N
        return found

    def eps(self, first: int, boxes: Array) -> Array:
        """As of `Errors`; inf where the projection of the weights may act."""
        since, spread = (np.arange(len(self.starts)) >= first)[:, None], self.spread(first, boxes)
        N = self.distances(first, boxes, spread)
        if not self.longest(first, float(N.max())) <= self.a.radius[0]:
            return np.full_like(spread, np.inf)
        return np.where(since, N[:, None] * spread + self.unsaid, 0.0)

    def longest(self, first: int, N: float) -> float:
        """Bound of |W| in the metric of the prior, from a block on and for a bound N."""
        matters = self.prior > 0.0
        size = np.sqrt(self.prior[matters])
        P = self.P[first][np.ix_(matters, matters)] / np.outer(size, size) + np.eye(len(size)) * self.returned(first)
        most = min(np.linalg.eigvalsh(P)[-1], float(len(size)))  # the diagonal is at most the prior's
        return float(np.linalg.norm(self.ideal[matters] / size) + np.sqrt(most) * N)

    def returned(self, first: int) -> float:
        """The largest share of the prior variance that drifts back at a place, from a block on."""
        k, updates = self.ideal.size, self.updates[first:].sum() if self.a.learning else 0
        return float(self.a.drift * k * -(-updates // k))


def roots(Phi: Array, P: Array) -> Array:
    """`sqrt(Phi_i P Phi_i')` of features (..., p, k)."""
    return np.sqrt(np.maximum(np.einsum("...ij,jk,...ik->...i", Phi, P, Phi), 0.0))


def unproved(periods: Periods) -> str:
    """Why nothing is proved of a learner's error of Psi, and what to change; empty where something is."""
    subject, learner = periods.subject, periods.subject.learner
    if learner is None:
        return "it learns nothing"
    law = learner.controller
    if isinstance(law, Adaptive):
        largest = np.abs(subject.signal("psi")).max(axis=0)
        times = float((allowed(periods) / np.maximum(largest, 1e-300)).max())
        return f"its energy, at the end of the run, allows errors of {times:.3g} times Psi; use kalman_regressor"
    if isinstance(law, Concurrent):
        return "its stack gives equations up for others, and with them what it knew here; use kalman_regressor"
    if not isinstance(law, Kalman) or law.knowledge(learner.start) is None:
        return "its weights are no parameters with a covariance that only drift raises; use kalman_regressor"
    if law.settings.alarm > 0:
        return "it may find that its robot has changed, and forgets then; use alarm = 0"
    if subject.velocity_noise.any():
        return "noise of velocities is in its equations, of which no bound is known; use exact velocities"
    return ""


def allowed(periods: Periods) -> Array:
    """(p,) how large an error of Psi the energy of an adaptive law at the end of its run allows [N, N m].

    For every velocity there are parameters as far from the estimate, in V_theta, as the true ones are, with which Psi
    differs by so much along the reference: on the ray `theta_hat + c Gamma Y_i'`, as far as V_theta lets c be. V falls
    on every motion, so nothing less is proved of the law by it.
    """
    subject, learner = periods.subject, periods.subject.learner
    assert learner is not None
    bodies, end = numbers_of(learner)[0].bodies, learner.end["theta"]
    energy = float(distances(bodies, true_parameters(subject, learner).theta, end[None])[0])
    some = np.linspace(0, len(subject.rows) - 1, INSTANTS).astype(int)
    Gamma, Y = metric(bodies, end), regressors(learner, subject.rows[some])
    return np.asarray(np.max([[reach(bodies, end, Gamma @ y, energy) * (y @ Gamma @ y) for y in one] for one in Y], 0))


def reach(bodies: Any, theta: Array, ray: Array, energy: float) -> float:
    """The largest c, either way, for which `theta + c ray` is no further than an energy from theta."""
    best = 0.0
    for sign in (1.0, -1.0):
        low, high = 0.0, 1.0
        while near(bodies, theta, sign * high * ray, energy) and high < 1e12:
            low, high = high, 2 * high
        for _ in range(HALVINGS):
            middle = (low + high) / 2
            low, high = (middle, high) if near(bodies, theta, sign * middle * ray, energy) else (low, middle)
        best = max(best, low)
    return best


def near(bodies: Any, theta: Array, step: Array, energy: float) -> bool:
    """Whether parameters are those of bodies and within an energy of theta."""
    inertial = pseudo_inertias((theta + step)[: BODY * len(bodies.roots)])
    if any(np.linalg.eigvalsh(P)[0] <= 0 for P in inertial):
        return False
    return bool(distances(bodies, theta + step, theta[None])[0] <= energy)

"""What is proved of each law's error of Psi: docs/explanation/theory.md, section 9, and `known`.

`torque.linear` with a regressor has a covariance P. From one sample to the next, whatever was measured,

    an update along s   W+ = W + eta tau T P Phi' s     N+  <= N + tau T sum_i |s_i| sqrt(Phi_i P Phi_i')
    an equation         y = phi' W* + e, variance R     N+^2 = N^2 + e^2 / R - (u + e)^2 / alpha <= N^2 + e^2 / R
    drift               P grows                         N+  <= N
    no update at all                                    N, P stay

while P grows by nothing but the drift: `P <= P(t_0) + what has come back since`, as an equation's update of P is
monotone in P and takes away. A cut (eta < 1) is counted as none.

`torque.concurrent` has a stack of equations, whose information L no exchange takes below its floor F. With the errors e
of its equations, over their noise,

    w* - w_L = P (w* - sum Phi_i' e_i),      |w* - w_L|_F <= |w* - w_L|_L <= |w*|_P + |e|,      P = L^-1 <= F^-1

from then on, and the estimate goes to w_L by a share in every update: N, now in the metric F, follows that.

The adaptive laws have neither, but bounds of their estimate (`confined`).
"""

from __future__ import annotations

import numpy as np

from mmnn_pin.errors import RecordingError
from mmnn_pin.model.regressor import Regressor
from mmnn_pin.model.tree.body import parameters
from mmnn_pin.signals import Array
from mmnn_pin.torque.adaptive import Adaptive
from mmnn_pin.torque.concurrent import Concurrent
from mmnn_pin.torque.controller import ControllerState
from mmnn_pin.torque.kalman import Kalman

from .confined import Confined
from .equations import Motions
from .known import Errors, Proved, exactly
from .periods import Periods
from .steps import Box, Steps
from .truth import true_weights


def proved(steps: Steps, force: Array, noise: Array, otherwise: Array, run: Motions) -> Errors:
    """What is proved of a run's law; arguments as of `Proved`.

    Raises:
        RecordingError: Nothing is, or a condition fails; what to change.
    """
    if why := unproved(steps.periods, steps.late):
        raise RecordingError("no bound of the learner's error", why=why)
    learner = steps.periods.subject.learner
    assert learner is not None
    if isinstance(learner.controller, Adaptive):
        return Confined(steps, noise)
    kind = ProvedConcurrent if isinstance(learner.controller, Concurrent) else ProvedKalman
    return kind(steps, force, noise, otherwise, run)


class ProvedKalman(Proved):
    """What the law of `torque.linear` says; arguments, attributes and errors as of `Proved`.

    Attributes:
        done: (K,) updates before a block.
    """

    def take(self, regressor: Regressor) -> Array:
        """As of `Proved`."""
        self.variance, self.radius = float(self.a.noise), float(self.a.radius[0])
        self.prior = self.learner.start["prior"].copy()
        self.basis, nothing = np.eye(self.prior.size), np.zeros(self.prior.size)
        self.ideal = exactly(regressor, parameters(self.periods.robot), true_of(self.periods), nothing, self.basis)
        self.done = np.zeros(len(self.starts), int)
        return self.ideal

    def begin(self, b: int, state: ControllerState) -> None:
        """As of `Proved`."""
        _, self.P[b] = self.learner.controller.knowledge(state)
        self.distance[b] = self.length(self.ideal - state["W"][0], self.P[b])
        self.done[b] = int(state["counts"][1])

    def count(self, state: ControllerState) -> float:
        """As of `Proved`."""
        return float(state["counts"][1])

    def length(self, error: Array, P: Array) -> float:
        """N of an error of the weights (k,)."""
        matters = self.prior > 0.0
        e = error[matters]
        return float(np.sqrt(e @ np.linalg.solve(P[np.ix_(matters, matters)], e)))

    def covariances(self, first: int) -> Array:
        """(K, k, k) bounds of P by block: what it was, and the drift since; 0 before."""
        k, came, found = self.ideal.size, np.zeros(self.ideal.size), np.zeros((len(self.starts), *self.P.shape[1:]))
        done = self.done[first] if self.a.learning else 0
        for b in range(first, len(found)):
            for _ in range(self.updates[b] if self.a.learning else 0):
                came[done % k] += self.a.drift * self.a.interval * k * self.prior[done % k]
                done += 1
            found[b] = self.P[first] + np.diag(came)
        return found

    def distances(self, first: int, s: Array, spread: Array, equations: Array) -> Array:
        """(K,) bounds of N by block, from block `first` on, for bounds (K, p) of s and of the equations' errors."""
        N, found, steps = self.distance[first], np.zeros(len(self.starts)), self.a.answer[0] * self.a.interval
        for b in range(first, len(self.starts)):
            moved, wrong = steps * float(s[b] @ spread[b]), float((equations[b] ** 2).sum()) / self.a.noise
            for _ in range(self.updates[b] if self.a.learning else 0):
                N = np.hypot(N + moved, np.sqrt(wrong))
            found[b] = N
        return found

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
        return float(self.a.drift * self.a.interval * k * -(-updates // k))


class ProvedConcurrent(Proved):
    """What the law of `torque.concurrent` says; arguments, attributes and errors as of `Proved`.

    Attributes:
        errors: (K, N) squares of the errors of the stack's places at the beginning of a block.
        rounding: How far w_L is from what the stack's entries say, at most in the run, in the metric F.
    """

    def take(self, regressor: Regressor) -> Array:
        """As of `Proved`."""
        law, self.radius = self.learner.controller, float(self.a.radius)
        self.variance, self.basis, start = float(law.settings.noise**2), law.basis, law.start()
        self.ideal = exactly(regressor, parameters(self.periods.robot), true_of(self.periods), start, self.basis)
        self.errors, self.rounding = np.zeros((len(self.starts), law.settings.entries)), 0.0
        return np.asarray(start + self.basis @ self.ideal)

    def begin(self, b: int, state: ControllerState) -> None:
        """As of `Proved`."""
        floor, error = state["F"], self.ideal - state["w"]
        self.P[b], self.distance[b] = np.linalg.inv(floor), np.sqrt(error @ floor @ error)
        rows, right = state["Phi"].reshape(-1, error.size), state["y"].ravel()
        w = np.linalg.lstsq(np.vstack((np.eye(error.size), rows)), np.append(0 * error, right), rcond=None)[0]
        lost = w - state["P"] @ state["b"]
        self.rounding = max(self.rounding, float(np.sqrt(lost @ floor @ lost)))
        off = (state["y"] - state["Phi"] @ self.ideal) ** 2
        self.errors[b] = np.where(state["born"] >= 0, off.sum(axis=1), 0.0)

    def count(self, state: ControllerState) -> float:
        """As of `Proved`."""
        settled = state["clock"][1] > self.a.filter.wait + 1
        return float(-(-int(state["samples"][0]) // self.a.every) if settled else 0)

    def covariances(self, first: int) -> Array:
        """(K, k, k) bounds of P by block: the inverse of the floor."""
        since = np.arange(len(self.starts)) >= first
        return np.asarray(since[:, None, None] * self.P[first])

    def distances(self, first: int, s: Array, spread: Array, equations: Array) -> Array:
        """(K,) bounds of N by block, from block `first` on, for bounds (K, p) of s and of the equations' errors."""
        N, found, a = self.distance[first], np.zeros(len(self.starts)), self.a
        share = 1.0 - np.exp(-a.rate * a.every * a.h) if a.learning else 0.0
        prior, worst, taken = float(np.sqrt(self.ideal @ self.P[first] @ self.ideal)), 0.0, 0
        for b, moved in enumerate(self.moves(first, s, spread)[first:], start=first):
            worst = max(worst, float((equations[b] ** 2).sum()) / self.variance)
            taken += int(self.updates[b])
            more = np.sort(np.maximum(worst - self.errors[first], 0.0))[::-1][:taken].sum()
            own, most = float(np.sqrt(self.errors[first].sum() + more)) + self.rounding, N
            if not np.linalg.norm(self.ideal) + own <= self.radius:  # what the stack says may be cut
                found[b:] = np.inf
                break
            for _ in range(int(self.updates[b])):
                N += moved
                most = max(most, N)
                N += share * (prior + own - N)
            found[b] = max(most, N) + moved
        return found

    def blame(self, first: int, box: Box, acceleration: Array) -> str:
        """As of `Proved`; the prior, where that lets it err by more than its equations."""
        none, prior = np.zeros_like(acceleration), float(np.sqrt(self.ideal @ self.P[first] @ self.ideal))
        most = float(self.distances(first, none, none, self.equations(first, box, acceleration))[first:].max())
        if most > 2 * prior:
            return super().blame(first, box, acceleration)
        return (
            "its stack tells too little against its prior; use a smaller concurrent.noise, as far as velocities "
            "permit, more concurrent.entries, or run for longer"
        )

    def moves(self, first: int, s: Array, spread: Array) -> Array:
        """(K,) how far s moves the estimate from an update up to a sample of a block, the next update included."""
        a = self.a
        each = a.tracking * a.h * a.every * (s * spread).sum(axis=1) * a.learning
        since = np.searchsorted(self.starts, self.starts - a.every + 1, side="right") - 1  # some may lie blocks before
        return np.array([each[max(one, first) : b + 1].max(initial=0.0) for b, one in enumerate(since)])

    def longest(self, first: int, N: float) -> float:
        """As of `Proved`; of what the stack says, `|w_L| <= |w*| + |e|` as P is at most 1, it is in `distances`."""
        return float(np.linalg.norm(self.ideal) + N * np.sqrt(max(1.0, np.linalg.eigvalsh(self.P[first])[-1])))


def true_of(periods: Periods) -> Array:
    """True weights of a learner, flat.

    Raises:
        RecordingError: There are none.
    """
    assert periods.subject.learner is not None
    ideal = true_weights(periods.subject, periods.subject.learner)
    if ideal is None:
        raise RecordingError("no bound of the learner's error", why="its robot has no true parameters")
    return ideal.ravel()


def unproved(periods: Periods, late: int = 0) -> str:
    """Why nothing is proved of a learner's error of Psi, and what to change; empty where something is.

    Args:
        periods: The loop.
        late: Periods by which commands are late.
    """
    learner = periods.subject.learner
    if learner is None:
        return "it learns nothing"
    law = learner.controller
    if isinstance(law, Adaptive):
        return ""
    if isinstance(law, Concurrent):
        if not law.settings.floor:
            return "an exchange of its stack may give up what alone tells of a direction; use concurrent.floor = true"
    elif not isinstance(law, Kalman) or law.knowledge(learner.start) is None:
        return "its weights are no parameters with a covariance that only drift raises; use kalman_regressor"
    elif law.settings.alarm > 0:
        return "it may find that its robot has changed, and forgets then; use alarm = 0"
    filter = law.law(learner.context).learner.filter
    if filter.motor.any() or abs(filter.late - late) > 1e-6:
        return "its equations take another delay of commands than the loop's; run it again"
    return ""

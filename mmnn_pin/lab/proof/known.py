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
`|W*| + |W~|`, in the metric of the prior, is within its bound, else nothing is said. s, Phi and e are those of the
velocities that the learner is told.

The equations' errors e are bounded for all motions in the tube (`equations`). Of the features Phi in the tube some are
looked at. `allowed` says what the energy of the adaptive laws, which have no such covariance, leaves open.
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
from .equations import Misfit, Motions
from .learner import Stepper
from .periods import Periods
from .steps import Box, Steps
from .truth import distances, metric, numbers_of, regressors, true_parameters, true_weights
from .weights_part import LOST, step_again

MORE = 1.5  # than the largest change of the features, or what the parameters do not say, that was seen
LOOKS = 4  # at the features in every block
FORGOTTEN = 36.0  # time constants after which a low-pass has forgotten all, to 2e-16
INSTANTS, HALVINGS = 5, 20  # of a run, for what an energy allows; of a bisection


class Errors(Protocol):
    """Bounds of the error of Psi along a tube."""

    def eps(self, first: int, box: Box, acceleration: Array) -> Array:
        """(K, p) by block, for motions that are in a box from block `first` on [N, N m]; 0 before.

        Args:
            first: The block.
            box: Of the motions.
            acceleration: (K, p) how far their accelerations are from the reference's.
        """


class Observed:
    """The errors of the run from every block on; args: `missed` (N, p), and `starts` (K,) of the blocks."""

    def __init__(self, missed: Array, starts: IntArray) -> None:
        later = np.maximum.accumulate(missed[::-1], axis=0)[::-1]
        self.largest = np.asarray(later[starts])

    def eps(self, first: int, box: Box, acceleration: Array) -> Array:
        """As of `Errors`; the box does not matter."""
        return np.where((np.arange(len(self.largest)) >= first)[:, None], self.largest, 0.0)


class Proved:
    """What the law of a linear learner with a regressor says from its state at the beginning of any block.

    Args:
        steps: The loop.
        force: (p,) largest external force [N, N m].
        noise: (p,) of the velocities that it is told.
        otherwise: (K, m) what the plant does otherwise than `Periods.after` in a period.
        run: The run as motions.

    Attributes:
        distance: (K,) N at the beginning of every block.
        P: (K, k, k) covariance then.
        heard: (K, p) largest errors of the run's equations in a block, over K, by true velocities [m/s, rad/s].
        updates: (K,) of a block.

    Raises:
        RecordingError: The law is another one, or a condition fails; what to change.
    """

    def __init__(self, steps: Steps, force: Array, noise: Array, otherwise: Array, run: Motions) -> None:
        periods, subject = steps.periods, steps.periods.subject
        if why := unproved(periods, steps.late):
            raise RecordingError("no bound of the learner's error", why=why)
        assert subject.learner is not None
        self.run = run
        self.steps, self.periods, self.noise, self.learner = steps, periods, noise, subject.learner
        self.starts, self.ends = steps.at[:-1], steps.at[1:]
        self.a = self.learner.controller.law(self.learner.context).learner
        pushed = np.abs(subject.hardware.push).max(axis=0)
        self.misfit = Misfit(steps, self.a.filter, noise, force + pushed, run, otherwise)
        ideal = true_weights(subject, self.learner)
        if ideal is None:
            raise RecordingError("no bound of the learner's error", why="its robot has no true parameters")
        self.ideal, K = ideal.ravel(), len(self.starts)
        self.prior = self.learner.start["prior"].copy()
        self.distance, self.P = np.zeros(K), np.zeros((K, self.ideal.size, self.ideal.size))
        self.heard, self.updates, self.done = np.zeros((K, len(self.a.gain))), np.zeros(K, int), np.zeros(K, int)
        missed = step_again(self.learner, subject.rows, self._before, self._after)
        if not missed <= LOST:
            raise RecordingError("no bound of the learner's error", why="stepped again it says another Psi_hat")
        if noise.any():
            self._hear_truth()
        self._look()

    def _before(self, n: int, row: Array, stepper: Stepper) -> float:
        b, state = int(np.searchsorted(self.starts, n)), stepper.state
        if b < len(self.starts) and self.starts[b] == n:
            _, self.P[b] = self.learner.controller.knowledge(state)
            self.distance[b] = self.length(self.ideal - state["W"][0], self.P[b])
            self.done[b] = int(state["counts"][1])
        return float(state["counts"][1])

    def _after(self, n: int, row: Array, stepper: Stepper, counted: float) -> None:
        b = min(int(np.searchsorted(self.starts, n, side="right")) - 1, len(self.starts) - 1)
        self.updates[b] += int(stepper.state["counts"][1] > counted)
        self._hear(b, stepper)

    def _hear(self, b: int, stepper: Stepper) -> None:
        state = stepper.state
        error = np.abs(state["Y_f"] - state["Phi_f"] @ self.ideal) / self.a.gain
        self.heard[b] = np.maximum(self.heard[b], error)

    def _hear_truth(self) -> None:
        """The errors of the equations as they were without noise."""
        stepper, of = Stepper(self.learner, self.learner.start.snapshot()), self.steps.of
        self.heard[:] = 0.0
        for row, b in zip(self.periods.subject.truth(self.periods.subject.rows)[: len(of)], of, strict=True):
            stepper.step(row)
            self._hear(int(b), stepper)

    def length(self, error: Array, P: Array) -> float:
        """N of an error of the weights (k,)."""
        matters = self.prior > 0.0
        e = error[matters]
        return float(np.sqrt(e @ np.linalg.solve(P[np.ix_(matters, matters)], e)))

    def _look(self) -> None:
        """Features along the reference (K, LOOKS, p, k), and what the parameters do not say."""
        periods, rest, rows = self.periods, np.zeros(self.periods.size), self.periods.subject.rows
        places = [np.linspace(a, b, LOOKS).astype(int) for a, b in zip(self.starts, self.ends, strict=True)]
        self.Phi = np.array([[self.features(rows[j], rest) for j in some] for some in places])
        left = []
        for j in self.starts:
            row, where = rows[j], periods.layout.where
            y = periods.state(row, row[where("position")], row[where("nu")])
            left.append(np.abs(row[where("psi")] - self.features(row, y) @ self.ideal))
        self.unsaid = MORE * np.max(left, axis=0)

    def features(self, row: Array, y: Array) -> Array:
        """Phi (p, k) at a state."""
        where, (row, position, nu) = self.periods.layout.where, self.periods.seen(row, y)
        nu_ref, nudot_ref = row[where("nu_ref")], row[where("nudot_ref")]
        return np.asarray(self.learner.controller.regressor.matrix(position, nu, nu_ref, nudot_ref))

    def equations(self, first: int, box: Box, acceleration: Array) -> Array:
        """(K, p) bounds of the equations' errors, over K, from block `first` on; arguments as of `eps`."""
        motions, off = Motions(box.y, acceleration).with_run(self.run, first)
        before = int(np.searchsorted(self.ends, self.starts[first] - FORGOTTEN * self.a.filter.lag))
        single, noisy = (
            np.maximum.accumulate(one[before:], axis=0)[first - before :]
            for one in (self.misfit.apart(motions, off), self.misfit.noisy(motions))
        )
        found, now = np.zeros_like(acceleration), np.zeros(acceleration.shape[1])
        for b, (apart, told) in enumerate(zip(single, noisy, strict=True), start=first):
            kept = self.a.filter.hold ** int(self.ends[b] - self.starts[b])
            now = kept * now + (1 - kept) * apart
            found[b] = self.heard[b] + (now + told + self.unsaid) / self.a.gain
        return found

    def blame(self, first: int, box: Box, acceleration: Array) -> str:
        """What its equations err by most from a block on, and what to change; arguments as of `eps`."""
        motions, off = Motions(box.y, acceleration).with_run(self.run, first)
        parts = (self.heard * self.a.gain, self.misfit.noisy(motions), self.misfit.apart(motions, off))
        sizes = [float(np.linalg.norm(one[first:].max(axis=0) / self.a.gain)) for one in parts]
        largest, times = int(np.argmax(sizes)), max(sizes) / np.sqrt(self.a.noise)
        words, change = (
            ("what they erred by in the run, such as dry friction that turns within a period", "use a shorter period"),
            ("noise of velocities", "use a smaller sensor.velocity_noise"),
            ("accelerations of other motions in the tube", "run for longer, so that more is known"),
        )[largest]
        return f"its equations err most, by up to {times:.2g} of its setting noise, by {words}; {change}"

    def spread(self, first: int, boxes: Array) -> Array:
        """(K, p) the largest `sqrt(Phi_i P Phi_i')` by block, from block `first` on, in boxes (K, m)."""
        K, k = len(self.starts), self.ideal.size
        found, rng, came = np.zeros((K, len(self.a.gain))), np.random.default_rng(1), np.zeros(k)
        done = self.done[first] if self.a.learning else 0
        for b in range(first, K):
            for _ in range(self.updates[b] if self.a.learning else 0):
                came[done % k] += self.a.drift * self.a.interval * k * self.prior[done % k]
                done += 1
            P = self.P[first] + np.diag(came)
            along = roots(self.Phi[b], P).max(axis=0)
            y = boxes[b] * rng.choice((-1.0, 1.0), len(boxes[b]))
            corner = roots(self.features(self.periods.subject.rows[self.starts[b]], y), P)
            found[b] = along + MORE * np.maximum(corner - roots(self.Phi[b, 0], P), 0.0)
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

    def eps(self, first: int, box: Box, acceleration: Array) -> Array:
        """As of `Errors`; inf where the projection of the weights may act."""
        since, seen = (np.arange(len(self.starts)) >= first)[:, None], box.y.copy()
        seen[:, -len(self.noise) :] += self.noise
        spread, s = self.spread(first, seen), self.steps.errors(box) + self.noise
        N = self.distances(first, s, spread, self.equations(first, box, acceleration))
        if not self.longest(first, float(N.max())) <= self.a.radius[0]:
            return np.where(since, np.full_like(spread, np.inf), 0.0)
        return np.where(since, N[:, None] * spread + self.unsaid + self.misfit.misread(box.y), 0.0)

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


def roots(Phi: Array, P: Array) -> Array:
    """`sqrt(Phi_i P Phi_i')` of features (..., p, k)."""
    return np.sqrt(np.maximum(np.einsum("...ij,jk,...ik->...i", Phi, P, Phi), 0.0))


def unproved(periods: Periods, late: int = 0) -> str:
    """Why nothing is proved of a learner's error of Psi, and what to change; empty where something is.

    Args:
        periods: The loop.
        late: Periods by which commands are late.
    """
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
    filter = law.law(learner.context).learner.filter
    if filter.motor.any() or abs(filter.late - late) > 1e-6:
        return "its equations take another delay of commands than the loop's; run it again"
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

"""How far Psi_hat can be from Psi on every motion in a tube, from an instant on: docs/explanation/theory.md, section 9.

`Observed` takes the errors of the run: nothing is proved of what the learner does on another motion. `Proved` takes a
law with a regressor that keeps what it knows as a covariance P (`known_laws`). With the true parameters W*,
`W~ = W* - W` and N = |W~| in the metric P^-1,

    |Psi~_i| <= N sqrt(Phi_i P Phi_i') + what the parameters do not say of Psi

The projection keeps its hands off as long as `|W*| + |W~|`, in the metric of the prior, is within its bound, else
nothing is said. s, Phi and e are those of the velocities that the learner is told.

The equations' errors e are bounded for all motions in the tube (`equations`), and so are the features Phi (`features`):
at every sample `|Phi_0 + sum_k y_k Phi_k + rest|`, in the metric of P, the first two by all signs of y, the rest by its
entries. The parameters say all of Psi but what dry friction has more near a standstill (Stribeck) and what rounding
loses.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from mmnn_pin.errors import RecordingError
from mmnn_pin.lab.psi.learner import LearnerStepper
from mmnn_pin.model.regressor import Regressor
from mmnn_pin.signals import Array, IntArray
from mmnn_pin.torque.controller import ControllerState

from .equations import Misfit, Motions, misread
from .features import Features
from .periods import Periods
from .postures import SLACK
from .steps import Box, Steps
from .weights_part import step_again

WIDER, TINY = 0.6, 1e-12  # binary logarithm of how much wider a box is that features are looked at in; the least one
FORGOTTEN = 36.0  # time constants after which a low-pass has forgotten all, to 2e-16
SAME = 1e-6  # relative difference of Psi_hat up to which a learner that is stepped again is the one that ran
SEEN, ROUNDED = 100, 1e-9  # motions on which Psi is compared with what parameters say; share of its terms lost


class Errors(Protocol):
    """Bounds of the error of Psi along a tube.

    Attributes:
        note: What else is to be said of them; ends with a blank.
    """

    note: str

    def eps(self, first: int, box: Box, acceleration: Array) -> Array:
        """(K, p) by block, for motions that are in a box from block `first` on [N, N m]; 0 before.

        Args:
            first: The block.
            box: Of the motions.
            acceleration: (K, p) how far their accelerations are from the reference's.
        """

    def blame(self, first: int, box: Box, acceleration: Array) -> str:
        """What they err by most from a block on, and what to change; arguments as of `eps`."""


class Observed:
    """The errors of the run from every block on; args: `missed` (N, p), and `starts` (K,) of the blocks."""

    note = ""

    def __init__(self, missed: Array, starts: IntArray) -> None:
        later = np.maximum.accumulate(missed[::-1], axis=0)[::-1]
        self.largest = np.asarray(later[starts])

    def eps(self, first: int, box: Box, acceleration: Array) -> Array:
        """As of `Errors`; the box does not matter."""
        return np.where((np.arange(len(self.largest)) >= first)[:, None], self.largest, 0.0)

    def blame(self, first: int, box: Box, acceleration: Array) -> str:
        """Nothing: they are the run's."""
        return ""


class Proved:
    """What a learner with a regressor says from its state at the beginning of any block; the law's own in subclasses.

    Args:
        steps: The loop.
        force: (p,) largest external force [N, N m].
        noise: (p,) of the velocities that it is told.
        otherwise: (K, m) what the plant does otherwise than `Periods.after` in a period.
        run: The run as motions.

    Attributes:
        ideal: True weights W*.
        basis: (k0, k) what the weights are of the parameters.
        distance: (K,) N at the beginning of every block.
        P: (K, k, k) covariance then.
        heard: (K, p) largest errors of the run's equations in a block, over K, by true velocities [m/s, rad/s].
        updates: (K,) of a block.

    Raises:
        RecordingError: A condition fails; what to change.
    """

    note = ""
    ideal: Array
    basis: Array
    variance: float  # of an equation over K [m^2/s^2, rad^2/s^2]
    radius: float  # bound on |W| in the metric of the prior

    def __init__(self, steps: Steps, force: Array, noise: Array, otherwise: Array, run: Motions) -> None:
        periods, subject = steps.periods, steps.periods.subject
        assert subject.learner is not None
        self.run = run
        self.steps, self.periods, self.noise, self.learner = steps, periods, noise, subject.learner
        self.starts, self.ends = steps.at[:-1], steps.at[1:]
        self.a = self.learner.controller.law(self.learner.context).learner
        pushed = np.abs(subject.hardware.push).max(axis=0)
        self.misfit = Misfit(steps, self.a.filter, noise, force + pushed, run, otherwise)
        regressor, K = self.learner.controller.regressor, len(self.starts)
        theta = self.take(regressor)
        self.distance, self.P = np.zeros(K), np.zeros((K, self.ideal.size, self.ideal.size))
        self.heard, self.updates = np.zeros((K, len(self.a.gain))), np.zeros(K, int)
        missed = step_again(self.learner, subject.rows, self.before, self.after)
        if not missed <= SAME:
            raise RecordingError("no bound of the learner's error", why="stepped again it says another Psi_hat")
        if noise.any():
            self.hear_truth()
        self.features = Features(regressor, steps.course, steps.signal("q_ref"))
        self.looks: dict[tuple[int, int], Look] = {}
        self.unsaid = unsaid(periods, regressor, theta)

    # -- what a law says of itself --

    def take(self, regressor: Regressor) -> Array:
        """Set ideal, basis, variance and radius.

        Returns:
            The parameters (k0,) that the ideal weights say.
        """
        raise NotImplementedError

    def begin(self, b: int, state: ControllerState) -> None:
        """Take distance and P at the beginning of a block."""
        raise NotImplementedError

    def count(self, state: ControllerState) -> float:
        """A number that every update raises."""
        raise NotImplementedError

    def covariances(self, first: int) -> Array:
        """(K, k, k) bounds of P by block, from block `first` on; 0 before."""
        raise NotImplementedError

    def distances(self, first: int, s: Array, spread: Array, equations: Array) -> Array:
        """(K,) bounds of N by block, from block `first` on, for bounds (K, p) of s and of the equations' errors."""
        raise NotImplementedError

    def longest(self, first: int, N: float) -> float:
        """Bound of |W| in the metric of the prior, from a block on and for a bound N."""
        raise NotImplementedError

    # -- what follows --

    def before(self, n: int, row: Array, stepper: LearnerStepper) -> float:
        """Before a row of the run."""
        b, state = int(np.searchsorted(self.starts, n)), stepper.state
        if b < len(self.starts) and self.starts[b] == n:
            self.begin(b, state)
        return self.count(state)

    def after(self, n: int, row: Array, stepper: LearnerStepper, counted: float) -> None:
        """After it."""
        b = min(int(np.searchsorted(self.starts, n, side="right")) - 1, len(self.starts) - 1)
        self.updates[b] += int(self.count(stepper.state) > counted)
        self.hear(b, stepper)

    def hear(self, b: int, stepper: LearnerStepper) -> None:
        """Take the errors of a sample's equations."""
        state = stepper.state
        error = np.abs(state["Y_f"] - state["Phi_f"] @ self.ideal) / self.a.gain
        self.heard[b] = np.maximum(self.heard[b], error)

    def hear_truth(self) -> None:
        """The errors of the equations as they were without noise."""
        stepper, of = LearnerStepper(self.learner, self.learner.start.snapshot()), self.steps.of
        self.heard[:] = 0.0
        for row, b in zip(self.periods.subject.truth(self.periods.subject.rows)[: len(of)], of, strict=True):
            stepper.step(row)
            self.hear(int(b), stepper)

    def look(self, first: int, b: int, box: Array, P: Array) -> Look:
        """Features of block b in a box (m,), or one that is wider by up to `WIDER`, for P as from block `first` on."""
        wide = np.exp2(np.ceil(np.log2(np.maximum(box, TINY)) / WIDER) * WIDER)
        known = self.looks.get((first, b))
        if known is None or (known.box != wide).any():
            known = self.looks[first, b] = Look.of(self, b, wide, P)
        return known

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
        largest, times = int(np.argmax(sizes)), max(sizes) / np.sqrt(self.variance)
        words, change = (
            ("what they erred by in the run, such as dry friction that turns within a period", "use a shorter period"),
            ("noise of velocities", "use a smaller sensor.velocity_noise"),
            ("accelerations of other motions in the tube", "run for longer, so that more is known"),
        )[largest]
        return f"its equations err most, by up to {times:.2g} of its setting noise, by {words}; {change}"

    def spread(self, first: int, boxes: Array) -> Array:
        """(K, p) bounds of `sqrt(Phi_i P Phi_i')` by block, from block `first` on, in boxes (K, m)."""
        found, P = np.zeros((len(boxes), len(self.noise))), self.basis @ self.covariances(first) @ self.basis.T
        for b in range(first, len(boxes)):
            found[b] = (1 + SLACK) * self.look(first, b, boxes[b], P[b]).spread(boxes[b], P[b])
        return found

    def eps(self, first: int, box: Box, acceleration: Array) -> Array:
        """As of `Errors`; inf where the projection of the weights may act."""
        since, seen = (np.arange(len(self.starts)) >= first)[:, None], box.y.copy()
        seen[:, -len(self.noise) :] += self.noise
        s, wrong, none = self.steps.errors(box) + self.noise, self.equations(first, box, acceleration), 0.0 * box.s
        N = self.distances(first, s, none, wrong)  # what equations alone do, first: features take time
        if self.longest(first, float(N.max())) <= self.radius:
            spread = self.spread(first, seen)
            N = self.distances(first, s, spread, wrong)
            if self.longest(first, float(N.max())) <= self.radius:
                return np.where(since, N[:, None] * spread + self.unsaid + misread(self.steps, self.noise, box.y), 0.0)
        return np.where(since, np.full_like(none, np.inf), 0.0)


@dataclass(frozen=True, eq=False)
class Look:
    """Features of a block of samples in a box.

    Attributes:
        box: (m,) of the errors that the learner sees.
        gram: (p, 1 + m, 1 + m) largest `|a P b'|`, of the features at no error and their slopes.
        rest: (p, k) of what is left, but for dry friction; for a smaller box it falls at least with its square.
        features: Of the robot.
        places: The samples.
    """

    box: Array
    gram: Array
    rest: Array
    features: Features
    places: slice

    @classmethod
    def of(cls, proved: Proved, b: int, box: Array, P: Array) -> Look:
        """Of block b in a box (m,), for a covariance (k, k)."""
        places = slice(int(proved.starts[b]), int(proved.ends[b]))
        value, slope, left = proved.features.smooth(places, np.tile(box, (places.stop - places.start, 1)))
        dry, _ = proved.features.dry(places, np.zeros(value.shape[:2]))
        ways = np.concatenate(((value + dry)[None], slope)).transpose(1, 2, 0, 3)
        gram = np.abs(ways @ P @ ways.swapaxes(-1, -2)).max(axis=0)
        return cls(box, gram, left.max(axis=0), proved.features, places)

    def spread(self, box: Array, P: Array) -> Array:
        """(p,) bounds of `sqrt(Phi_i P Phi_i')` in a smaller box."""
        y, p, N = np.concatenate(([1.0], box)), len(self.rest), self.places.stop - self.places.start
        _, dry = self.features.dry(self.places, np.broadcast_to(box[-p:], (N, p)))
        rest = float((box / self.box).max()) ** 2 * self.rest + dry.max(axis=0)
        return np.asarray(np.sqrt(np.einsum("pyz,y,z->p", self.gram, y, y)) + roots(rest, np.abs(P)))


def exactly(regressor: Regressor, theta: Array, ideal: Array, start: Array, basis: Array) -> Array:
    """Weights (k,) next to ideal ones so that `start + basis W` says what theta says, on every motion but for rounding.

    Directions that change nothing are known from sums of squares to half the digits alone.
    """
    rng, p = np.random.default_rng(2), len(regressor.massless.nu)
    Y = np.vstack([regressor.matrix(regressor.random_position(rng), *rng.standard_normal((3, p))) for _ in range(SEEN)])
    Phi = Y @ basis
    scale = np.linalg.norm(Phi, axis=0)
    scale = 1 / np.where(scale > 0, scale, 1.0)
    off = Y @ (start + basis @ ideal - theta)
    return np.asarray(ideal - scale * np.linalg.lstsq(Phi * scale, off, rcond=ROUNDED)[0])


def unsaid(periods: Periods, regressor: Regressor, ideal: Array) -> Array:
    """(p,) what parameters (k,) do not say of Psi, at most [N, N m]: friction above its dry level, and rounding.

    Raises:
        RecordingError: They say another Psi than the robot's.
    """
    robot, rng, psi = periods.robot, np.random.default_rng(1), np.zeros(len(periods.gain))
    most = np.abs(robot.T).T @ robot.dry[:, 1]
    size = np.zeros_like(most)
    for row in periods.subject.rows[np.linspace(0, len(periods.subject.rows) - 1, SEEN).astype(int)]:
        y = rng.standard_normal(periods.size)
        for state in (np.zeros_like(y), y):
            seen, position, nu = periods.seen(row, state)
            nu_ref, nudot_ref = (seen[periods.layout.where(name)] for name in ("nu_ref", "nudot_ref"))
            periods.rough.refresh(position, nu)
            periods.rough.refresh_psi(nu_ref, nudot_ref, psi)
            Y = regressor.matrix(position, nu, nu_ref, nudot_ref)
            here = np.abs(Y) @ np.abs(ideal)
            if not (np.abs(psi - Y @ ideal) <= most + ROUNDED * here.max()).all():
                why = "its parameters do not say all of its robot"
                raise RecordingError("no bound of the learner's error", why=why)
            size = np.maximum(size, here)
    return np.asarray(most + ROUNDED * size)


def roots(Phi: Array, P: Array) -> Array:
    """`sqrt(Phi_i P Phi_i')` of features (..., p, k)."""
    return np.sqrt(np.maximum(np.einsum("...ij,jk,...ik->...i", Phi, P, Phi), 0.0))

"""Tube and remainder, made in turn until neither grows: docs/explanation/theory.md, section 9."""

from __future__ import annotations

from collections.abc import Callable
from copy import copy
from functools import cached_property

import numpy as np

from mmnn_pin.signals import Array, IntArray

from .equations import Motions
from .known import Errors, Observed
from .known_laws import proved
from .periods import Periods
from .steps import Box, Steps
from .sums import Sums

BLOCKS = 100  # of the run
ROUNDS, AHEAD = 12, 1.2  # of tube and remainder; times what was found is tried next
LOST = 2.0  # [m, rad] of error: no tube
FACTORS = np.geomspace(1e-3, 1e3, 25)  # on the error of Psi, for how much is borne
PUSHES = np.geomspace(1e-7, 10.0, 33)  # over the gains [m/s, rad/s], likewise
Told = Callable[[float], None]


class Search:
    """Tubes of a run.

    Args:
        periods: The loop.
        force: (p,) largest external force [N, N m].

    Attributes:
        errors: What is counted with of Psi: those of the run, or those of `proved`.

    Raises:
        RecordingError: A robot whose M, C and gravity have no bounds.
    """

    def __init__(self, periods: Periods, force: Array) -> None:
        subject = periods.subject
        self.periods, self.force, self.limits = periods, force, subject.motor_limits
        self.late = round(subject.latency.command / subject.timing.control_period)
        self.steps = Steps(periods, self.late, BLOCKS)
        self.sums = Sums(self.steps)
        self.told = subject.velocity_noise
        self.noise = self.steps.most(np.abs(self.steps.answers[:-1]) @ self.told)
        missed = np.abs(subject.signal("psi") - subject.signal("psi_hat"))
        self.errors: Errors = Observed(missed, self.starts)

    @property
    def starts(self) -> IntArray:
        """(K,) first period of every block."""
        return self.steps.at[:-1]

    @property
    def ends(self) -> IntArray:
        """(K,) first period after every block."""
        return self.steps.at[1:]

    def proved(self) -> Search:
        """The same with what is proved of the learner; errors as of `known_laws.proved`."""
        found = copy(self)
        steps, reached, p = self.steps, self.reached, self.sums.p
        off = np.abs(np.diff(steps.course.nu + reached[:, -p:], axis=0) / steps.h - steps.acceleration[:-1])
        run = Motions(steps.most(np.maximum(np.abs(reached[:-1]), np.abs(reached[1:]))), steps.most(off))
        found.errors = proved(steps, self.force, self.told, self.integrator[:, : self.periods.size], run)
        return found

    @cached_property
    def reached(self) -> Array:
        """(N + 1, m) states of the run."""
        rows, where = self.periods.subject.rows, self.periods.layout.where
        return np.array([self.periods.state(r, r[where("position")], r[where("nu")]) for r in rows])

    def commanded(self, j: int) -> Array:
        """(l,) torques on their way at the beginning of a period, less those without errors; none before the start."""
        off = self.periods.subject.signal("torque") - self.steps.torque
        return np.ravel([off[i] if i >= 0 else np.zeros(off.shape[1]) for i in range(j - self.late, j)])

    def response(self, first: int) -> Array:
        """(N + 1, r) states, s and f from the run's state at block `first` on, nothing else; 0 before."""
        steps, m, start = self.steps, self.periods.size, self.starts[first]
        y = np.concatenate((self.reached[start], self.commanded(start)))
        found = np.zeros((len(steps.rows), self.sums.r))
        for j in range(start, len(steps.rows)):
            found[j] = self.sums.rows(j) @ y
            if j < len(steps.c):
                y = steps.P(j) @ y
                y[:m] += steps.c[j]
        return found

    @cached_property
    def integrator(self) -> Array:
        """(K, m + l) what the plant does in a period otherwise than `Periods.after`, from a block on, in the run."""
        subject, off = self.periods.subject, np.zeros((len(self.steps.c), self.sums.m))
        nu, force = self.periods.layout.where("nu"), subject.hardware.torque + subject.hardware.push
        for j, row in enumerate(subject.rows[:-1]):
            applied = force[j] - self.periods.dry(row[nu])
            after = self.periods.after(row, subject.rows[j + 1], self.reached[j], applied)
            off[j, : len(after)] = np.abs(self.reached[j + 1] - after)
        return np.asarray(np.maximum.accumulate(self.steps.most(off)[::-1], axis=0)[::-1])

    def size(self, first: int, factor: float = 1.0) -> Array:
        """(K, m + l) the tube from a block on for `factor` times the errors of Psi, 0 before; inf if there is none."""
        return self.found(first, factor)[0]

    def found(self, first: int, factor: float = 1.0) -> tuple[Array, Array]:
        """The same, and the errors of Psi (K, p) that were counted with."""
        size, eps, _ = self.judged(first, factor)
        return size[:, : self.sums.m], eps

    def judged(self, first: int, factor: float = 1.0) -> tuple[Array, Array, Array]:
        """The tube with s and f behind it, (K, r), the errors of Psi, and all of the torques, (K, p) each."""
        response, since = self.response(first), (np.arange(len(self.ends)) >= first)[:, None]
        m, told = self.periods.size, slice(0, self.periods.poses + self.periods.layout.arm)
        nothing = np.zeros((len(self.ends), self.sums.p))
        size = self.sums.largest(first, response, nothing, np.zeros((len(nothing), self.sums.m)))
        bent, rest = nothing, np.zeros((len(nothing), m))
        eps = self.errors.eps(first, self.box(size, nothing), nothing)
        for _ in range(ROUNDS):
            if not np.isfinite(eps).all():
                break
            errors = since * (factor * eps + self.force + self.noise + (bent if self.late else 0.0))
            added = since * self.integrator
            added[:, :m] += since * rest
            size = self.sums.largest(first, response, errors, added)
            if not (size[:, told] < LOST).all():
                break
            box = self.box(size, errors)
            if (left := self.steps.rest(box, self.told)) is None:
                break
            wider = self.errors.eps(first, box, left.acceleration)
            if all((now[first:] <= was[first:]).all() for now, was in ((left[0], bent), (left[1], rest), (wider, eps))):
                return size, eps, errors if self.late else errors + since * bent
            bent, rest = (np.where(now > was, AHEAD * now, was) for now, was in ((left[0], bent), (left[1], rest)))
            eps = np.where(wider > eps, AHEAD * wider, eps)
        return np.full_like(size, np.inf), eps, nothing

    def blame(self, first: int) -> str:
        """What stands in the way of errors of Psi that are proved, from a block on, even of motions like the run."""
        if isinstance(self.errors, Observed):
            return ""
        nothing = np.zeros((len(self.ends), self.sums.p))
        size = self.sums.largest(first, self.response(first), nothing, np.zeros((len(nothing), self.sums.m)))
        box = self.box(size, self.noise)
        left = self.steps.rest(box, self.told)
        return self.errors.blame(first, box, nothing if left is None else left.acceleration)

    def box(self, size: Array, errors: Array) -> Box:
        """A tube as `steps` takes it."""
        m, n, p = self.periods.size, self.sums.m, self.sums.p
        s, f = size[:, n : n + p], size[:, n + p :]
        return Box(size[:, :m], s, f, size[:, m : m + p] if self.late else errors)

    def first(self, progress: Told) -> int:
        """The first block from which there is a tube, by bisection; their number where the last tenth has none."""
        low, high = 0, 9 * len(self.ends) // 10
        if self.exists(low):
            return low
        if not self.exists(high):
            return len(self.ends)
        while high - low > 1:
            middle = (low + high) // 2
            low, high = (low, middle) if self.exists(middle) else (middle, high)
            progress(1 - (high - low) / len(self.ends))
        return high

    def exists(self, first: int, factor: float = 1.0) -> bool:
        """Whether there is a tube."""
        return bool(np.isfinite(self.size(first, factor)).all())

    def bears(self, first: int) -> float:
        """Largest of `FACTORS` on the errors of Psi from a block on for which there is a tube; 0 for none."""
        low, high = -1, len(FACTORS)
        while high - low > 1:
            middle = (low + high) // 2
            low, high = (middle, high) if self.exists(first, float(FACTORS[middle])) else (low, middle)
        return 0.0 if low < 0 else float(FACTORS[low]) if high < len(FACTORS) else np.inf

    def pushes(self, first: int) -> Array:
        """(p,) pushes, all at once and alike over the gains, under which there is a tube from a block on; 0 for none.

        They come beside those that are counted already [N, N m].
        """
        low, high, gain = -1, len(PUSHES), self.periods.gain
        while high - low > 1:
            middle = (low + high) // 2
            pushed = copy(self)
            pushed.force = self.force + PUSHES[middle] * gain
            if not isinstance(self.errors, Observed):
                pushed = pushed.proved()
            there = pushed.exists(first) and (pushed.torques(first) < 1.0).all()
            low, high = (middle, high) if there else (low, middle)
        return np.asarray((PUSHES[low] if low >= 0 else 0.0) * gain)

    def torques(self, first: int) -> Array:
        """(motors,) largest torque in a tube over the motors' limits; 0 without limits."""
        steps, (size, _, errors) = self.steps, self.judged(first)
        N, E_inv, m = len(steps.of), np.linalg.inv(self.periods.robot.E), self.periods.size
        tau = np.einsum("kij,kj->ki", np.abs(steps.T[:N]), size[steps.of, :m]) + errors[steps.of]
        asked = np.abs(steps.torque[:N] @ E_inv.T) + tau @ np.abs(E_inv).T
        return np.asarray((asked[self.starts[first] :] / self.limits).max(axis=0))

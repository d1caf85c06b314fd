"""How far Psi_hat of an adaptive law can be from Psi, whatever it learns: docs/explanation/theory.md, section 9.

Its estimate stays within bounds: `least P_0 <= P_hat <= most P_0` for a body that starts from P_0 = C C', and
`0 <= theta_j <= top_j` for friction. With L the matrix of `tr(P L) = Y_i theta`, over the first of these the largest
`tr(P_hat L)` is

    sum_k most max(lambda_k, 0) + least min(lambda_k, 0),      lambda_k the eigenvalues of C' L C,

and every body, every rotor and every friction adds its own. So it holds at every instant of every motion, whatever
the law does; where the bounds are narrow, as about a nominal robot, it is less than Psi, which is what PD alone has to
bear. It does not fall as the law learns: V may not grow, but lets Psi err by more than the bounds do (`energy`).
"""

from __future__ import annotations

from functools import cached_property

import numpy as np

from mmnn_pin.errors import RecordingError
from mmnn_pin.model.tree.body import parameters
from mmnn_pin.signals import Array
from mmnn_pin.torque.pseudo_inertia import BODY, pseudo_inertias

from .energy import allowed, patience
from .equations import misread
from .features import Features
from .known import TINY, WIDER, unsaid
from .postures import SLACK
from .steps import Box, Steps
from .truth import matrices, numbers_of

BEGUN = 1e-9  # relative, by which an estimate may begin beyond its bounds


class Confined:
    """Bounds of the error of Psi from the bounds of an adaptive law's estimate.

    Args:
        steps: The loop.
        noise: (p,) of the velocities that it is told.

    Raises:
        RecordingError: The parameters of its robot do not say its Psi, or it did not begin within its bounds.
    """

    note = "It is what the bounds of its estimate allow, and does not fall as it learns. "

    def __init__(self, steps: Steps, noise: Array) -> None:
        subject = steps.periods.subject
        assert subject.learner is not None
        self.steps, self.noise = steps, noise
        self.a, self.regressor = numbers_of(subject.learner)[0], subject.learner.controller.regressor
        self.start, self.truth = subject.learner.start["theta"], parameters(subject.robot)
        self.require_within()
        self.features = Features(self.regressor, steps.course, steps.signal("q_ref"))
        self.rests: dict[int, tuple[Array, Array]] = {}
        self.unsaid = unsaid(steps.periods, self.regressor, self.truth)

    def require_within(self) -> None:
        """An estimate that was handed over from another run may be beyond the bounds, or drawn to another start."""
        m, first = self.a.bodies, BODY * len(self.a.bodies.roots)
        theta, rest = pseudo_inertias(self.start[:first]), self.start[first:]
        Q = m.inverses @ theta @ m.inverses.swapaxes(-1, -2)
        values, low, high = np.linalg.eigvalsh(Q), m.least * (1 - BEGUN), m.most[:, None] * (1 + BEGUN)
        sound = (values >= low).all() and (values <= high).all() and (rest >= 0).all() and (rest <= m.top).all()
        if self.a.sigma > 0:
            bodies = np.abs(values - 1).max(axis=1)[m.gamma == 0.0]
            sound = sound and (bodies <= BEGUN).all() and (rest == m.start)[m.rates == 0.0].all()
        if self.a.learning and not sound:
            why = "its estimate did not begin within its bounds; run it from its own start"
            raise RecordingError("no bound of the learner's error", why=why)

    def extremes(self, Y: Array) -> tuple[Array, Array]:
        """Least and largest `Y (theta_hat - theta)` of rows (..., k), (...,) each, and of nothing else at once."""
        m, first = self.a.bodies, BODY * len(self.a.bodies.roots)
        low, high = np.zeros(Y.shape[:-1]), np.zeros(Y.shape[:-1])
        for b, (C, gamma) in enumerate(zip(m.roots, m.gamma, strict=True)):
            here = slice(BODY * b, BODY * b + BODY)
            if gamma > 0 and self.a.learning:
                L = matrices(Y[..., here].reshape(-1, BODY), 0.5)
                values = np.linalg.eigvalsh(C.T @ L @ C).reshape(*Y.shape[:-1], 4)
                above, below = np.maximum(values, 0.0).sum(axis=-1), np.minimum(values, 0.0).sum(axis=-1)
                low, high = low + m.least * above + m.most[b] * below, high + m.most[b] * above + m.least * below
            else:
                low, high = (one + Y[..., here] @ self.start[here] for one in (low, high))
        rest, moves = Y[..., first:], (m.rates > 0) & self.a.learning
        bottom, top = np.where(moves, 0.0, self.start[first:]), np.where(moves, m.top, self.start[first:])
        up, down = np.maximum(rest, 0.0), np.minimum(rest, 0.0)
        right = Y @ self.truth
        return low + up @ bottom + down @ top - right, high + up @ top + down @ bottom - right

    @cached_property
    def furthest(self) -> Array:
        """(k,) how far each parameter of the estimate may be from the truth."""
        low, high = self.extremes(np.eye(self.truth.size))
        return np.asarray(np.maximum(-low, high))

    @cached_property
    def first_order(self) -> tuple[Array, Array]:
        """By block, the largest error along the reference itself (K, p), and what each error adds to it (K, z, p)."""
        along, more = [], []
        for b in range(len(self.steps.at) - 1):
            value, slope, _ = self.features.smooth(*self.places(b, np.zeros(self.steps.size)))
            dry, _ = self.features.dry(self.places(b, self.noise)[0], np.zeros(value.shape[:2]))
            low, high = self.extremes(value + dry)
            along.append(np.maximum(-low, high).max(axis=0))
            low, high = self.extremes(slope)
            more.append(np.maximum(-low, high).max(axis=1))
        return np.array(along), np.array(more)

    def places(self, b: int, box: Array) -> tuple[slice, Array]:
        """The samples of a block, and a box at each of them."""
        start, end = int(self.steps.at[b]), int(self.steps.at[b + 1])
        return slice(start, end), np.tile(box, (end - start, 1))

    def rest(self, b: int, box: Array) -> Array:
        """(p, k) what the first order leaves of the features of a block in a box (m,), but for dry friction."""
        wide = np.exp2(np.ceil(np.log2(np.maximum(box, TINY)) / WIDER) * WIDER)
        known = self.rests.get(b)
        if known is None or (known[0] != wide).any():
            _, _, rest = self.features.smooth(*self.places(b, wide))
            known = self.rests[b] = wide, rest.max(axis=0)
        return np.asarray(float((box / wide).max()) ** 2 * known[1])

    def eps(self, first: int, box: Box, acceleration: Array) -> Array:
        """As of `known.Errors`."""
        seen, p, found, (along, more) = box.y.copy(), len(self.noise), np.zeros_like(box.s), self.first_order
        seen[:, -p:] += self.noise
        for b in range(first, len(found)):
            _, dry = self.features.dry(*self.places(b, seen[b, -p:]))
            left = (self.rest(b, seen[b]) + dry.max(axis=0)) @ self.furthest
            found[b] = (1 + SLACK) * (along[b] + seen[b] @ more[b] + left)
        since = (np.arange(len(found)) >= first)[:, None]
        return np.where(since, found + self.unsaid + misread(self.steps, self.noise, box.y), 0.0)

    def blame(self, first: int, box: Box, acceleration: Array) -> str:
        """What lets it err most, and what to change; arguments as of `eps`."""
        periods, m, first_rest = self.steps.periods, self.a.bodies, BODY * len(self.a.bodies.roots)
        largest = np.maximum(np.abs(periods.subject.signal("psi")).max(axis=0), 1e-300)
        times = float((self.first_order[0] / largest).max())
        why = [f"its bounds let Psi err by {times:.3g} times its largest"]
        energy, after = float((allowed(periods) / largest).max()), patience(periods, largest)
        why.append(f"its energy, at the end of the run, by {energy:.3g} times")
        if np.isfinite(after):
            why.append(f"on average, which proves nothing, by Psi itself after another {after:.3g} s of such motion")
        change = ["begin near the robot (adaptive.initial = nominal with nominal.masses within some percent of 1, or "
                  "adaptive.start), within narrow bounds, such as adaptive.bounds = 1.03"]  # fmt: skip
        if (m.rates > 0).any() and (self.furthest[first_rest:] > 0).any():
            change.append("friction that is told and not learned: adaptive.viscous = 0, adaptive.coulomb = 0")
        return f"{', '.join(why)}; {'; '.join(change)}"

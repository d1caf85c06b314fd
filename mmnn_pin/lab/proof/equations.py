"""How far equations of filtered torque are from the truth on every motion in a tube (docs/explanation/theory.md, 9).

The learner takes a mean torque for `M nudot + C nu + gravity + friction` at the mean position, velocity and
acceleration, all means of one kind: over a period, behind a low-pass of time constant T (`torque.filtered`). A motion
of `periods`, with what the plant does otherwise, obeys it at the beginning of every period. What lies between the two
is known of the run, equation by equation; another motion differs from the run by d, and its equations by no more than

    products of d with what a period changes, and of deviations in the window of the mean, d's with others,

which are at most T + h times their rates. Velocities that err by n give means that err by n; mean accelerations err by
differences over h, which the low-pass behind sums up by parts:

    |sum_i w_i M_i (n_i+1 - n_i) / h| <= (2 w_0 |M| + largest change of M in a period) n / h,    w_0 = 1 - hold
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...model.reduction import COULOMB_SPEED
from ...signals import Array
from ...torque.filtered import Filter
from .steps import Steps, times, twice
from .taylor import stacked

STEEPEST = 0.86  # of exp(-x^2)


@dataclass(frozen=True, eq=False)
class Motions:
    """Motions around a reference, in K blocks.

    Attributes:
        y: (K, m) their states at most.
        acceleration: (K, p) how far their accelerations are from the reference's.
    """

    y: Array
    acceleration: Array

    def with_run(self, run: Motions, first: int) -> tuple[Motions, Motions]:
        """Them from a block on and a run's before; and how far they are from the run, nothing before."""
        since = (np.arange(len(self.y)) >= first)[:, None]
        pairs = ((self.y, run.y), (self.acceleration, run.acceleration))
        all_of = (np.where(since, np.maximum(own, its), its) for own, its in pairs)
        return Motions(*all_of), Motions(*(np.where(since, own + its, 0.0) for own, its in pairs))


@dataclass(frozen=True, eq=False)
class Misfit:
    """Errors of the equations of a loop, per velocity.

    Args:
        steps: The loop.
        filter: The learner's.
        noise: (p,) of the velocities that it is told [m/s, rad/s].
        force: (p,) largest external force, and that of the run added [N, N m].
        otherwise: (K, m) what the plant does otherwise than `Periods.after` in a period.
    """

    steps: Steps
    filter: Filter
    noise: Array
    force: Array
    otherwise: Array

    def apart(self, motions: Motions, off: Motions) -> Array:
        """(K, p) how far one mean is from the run's, its window in a block [N, N m].

        Args:
            motions: All motions, the run among them.
            off: How far they are from the run.
        """
        steps, h, window = self.steps, self.steps.h, self.steps.h * (1 + self.filter.lag)
        nu_ref, _, a_ref, _, M, _ = steps.sizes
        joints, p, base = steps.joints, self.noise.size, steps.periods.layout.base
        v, a, dv, da = nu_ref + motions.y[:, -p:], a_ref + motions.acceleration, off.y[:, -p:], off.acceleration
        slip = self.otherwise[:, joints] / h
        speed, dspeed, de = (v + h * a)[:, base:] + slip, (dv + h * da)[:, base:] + slip, off.y[:, joints]
        near = motions.y[:, joints]
        moves = (de, h * speed, window * speed, h * dspeed, window * dspeed)
        found = [steps.bent(near, one) for one in moves]
        cross = steps.bent(near, window * (speed + dspeed), de + window * dspeed)
        if cross is None or any(one is None for one in found):
            return np.full_like(v, np.inf)
        there, step, wide, dstep, dwide = (one for one in found if one is not None)
        swing, wa, wda = motions.acceleration + window * self.jerk, window * a, window * da
        # mass and gravity: what a period and the window change, then how the window's deviations go together
        result = times(dstep.M1 + cross.M2, a) + times(step.M1 + wide.M2 + wide.M1, da)
        result += times(dwide.M1 + cross.M2, swing) + dstep.g1 + cross.g2
        # Coriolis terms: the same of three factors
        both = [(dstep.C1 + cross.C2, v, v), (step.C1 + wide.C2, v, dv), (step.C1 + wide.C2, dv, v)]
        for one in (v, wa), (wa, v):
            both += [(dwide.C1 + cross.C2, *one)]
        for one in (dv, wa), (v, wda), (wa, dv), (wda, v):
            both += [(wide.C1, *one)]
        for one in (v, h * a), (h * a, v), (wa, wa):
            both += [(there.C1, *one)]
        for one in (dv, h * a), (v, h * da), (h * a, dv), (h * da, v), (wa, wda), (wda, wa):
            both += [(wide.C0, *one)]
        result += np.sum([twice(*one) for one in both], axis=0)
        # the rest
        damping = np.abs(steps.periods.damping)
        result += h * da @ damping + 2 * self.dry(motions.y, h * a + wa) + self.force
        M = M + there.M1 + steps.periods.brakes * h * damping
        return result + 2 * times(M, self.otherwise[:, -p:]) / h

    def noisy(self, motions: Motions) -> Array:
        """(K, p) what noise adds to equations behind the low-pass [N, N m]."""
        steps, h, n = self.steps, self.steps.h, np.broadcast_to(self.noise, motions.acceleration.shape)
        if not self.noise.any():
            return np.zeros_like(n)
        nu_ref, _, a_ref, _, M, _ = steps.sizes
        v, near = nu_ref + motions.y[:, -n.shape[1] :], motions.y[:, steps.joints]
        moved = h * (v + h * (a_ref + motions.acceleration))[:, steps.periods.layout.base :]
        there, step = steps.bent(near), steps.bent(near, moved)
        if there is None or step is None:
            return np.full_like(n, np.inf)
        found = twice(step.C0, v, n) + twice(step.C0, n, v) + twice(step.C0, n, n)
        found += n @ np.abs(steps.periods.damping) + self.dry(motions.y, n)
        return found + times(2 * (1 - self.filter.hold) * (M + there.M1) + step.M1, n) / h

    @property
    def jerk(self) -> Array:
        """(K, p) how fast the reference's accelerations change."""
        return self.steps.most(np.abs(np.diff(self.steps.acceleration, axis=0))) / self.steps.h

    def misread(self, y: Array) -> Array:
        """(K, p) how far Psi of the velocities that are told is from that of the true ones [N, N m]."""
        steps, n = self.steps, np.broadcast_to(self.noise, (len(y), len(self.noise)))
        if not self.noise.any():
            return np.zeros_like(n)
        refs = stacked(steps.course.at(slice(0, len(steps.of))).command(y[steps.of])[0])
        nu_ref, bent = steps.sizes[0] + steps.off(refs, y), steps.bent(y[:, steps.joints])
        if bent is None:
            return np.full_like(n, np.inf)
        return twice(bent.C0, n, nu_ref) + n @ np.abs(steps.periods.damping) + self.dry(y, n)

    def dry(self, y: Array, off: Array) -> Array:
        """(K, p) how much dry friction may change where velocities do by (K, p) [N, N m]."""
        robot, nu_ref = self.steps.periods.robot, self.steps.course.nu[: len(self.steps.of)]
        T, (coulomb, more, stribeck) = np.abs(robot.T), robot.dry.T
        change = off @ T.T
        speed = -self.steps.most(-np.abs(nu_ref @ robot.T.T)) - y[:, -off.shape[1] :] @ T.T - change
        steep = np.cosh(np.clip(speed / COULOMB_SPEED, 0.0, 300.0)) ** -2.0 / COULOMB_SPEED
        level = (coulomb + more) * np.minimum(2.0, steep * change)
        bends = more * np.minimum(1.0, STEEPEST * change / np.where(more > 0, stribeck, 1.0))
        return np.asarray((level + bends) @ T)

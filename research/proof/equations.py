"""How far equations of filtered torque are from the truth on every motion in a tube (docs/explanation/theory.md, 9).

The learner takes a mean torque for `M nudot + C nu + gravity + friction` at the mean position, velocity and
acceleration, all means of one kind: over a period, behind a low-pass of time constant T (`torque.filtered`). A motion
of `periods`, with what the plant does otherwise, obeys it at the beginning of every period. What lies between the two
is known of the run, equation by equation; another motion differs from the run by d, and its equations by no more than

    products of d with what a period changes, and of deviations in the window of the mean, d's with others,

which are at most T + h times their rates. Accelerations that d makes and a slow factor X multiplies are summed up by
parts in the low-pass behind, of w_0 = 1 - hold, so that not they count but the velocities d_nu that they add up to,

    |sum_i w_i X_i (d_nu,i+1 - d_nu,i) / h| <= (2 w_0 |X| / h + |X'|) |d_nu|

Velocities that err by n give means that err by n, and accelerations in the same way.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mmnn_pin.model.reduction import COULOMB_SPEED
from mmnn_pin.signals import Array
from mmnn_pin.torque.filtered import Filter

from .curvature import Bent
from .steps import Steps, times, twice
from .taylor import stacked

STEEPEST = 0.86  # of exp(-x^2)
SPREAD = 0.75  # mean distance from its mean, of an age in the window: 2 / e of its deviation, with a period's 1 at most


@dataclass(frozen=True, eq=False)
class Motions:
    """Motions around a reference, in K blocks."""

    y: Array  # (K, m) their states at most
    acceleration: Array  # (K, p) how far their accelerations are from the reference's

    def with_run(self, run: Motions, first: int) -> tuple[Motions, Motions]:
        """Them from a block on and a run's before; and how far they are from the run, nothing before."""
        since = (np.arange(len(self.y)) >= first)[:, None]
        pairs = ((self.y, run.y), (self.acceleration, run.acceleration))
        all_of = (np.where(since, np.maximum(own, its), its) for own, its in pairs)
        return Motions(*all_of), Motions(*(np.where(since, own + its, 0.0) for own, its in pairs))


@dataclass(frozen=True, eq=False)
class Misfit:
    """Errors of the equations of a loop, per velocity."""

    steps: Steps  # the loop
    filter: Filter  # the learner's
    noise: Array  # (p,) of the velocities that it is told [m/s, rad/s]
    force: Array  # (p,) largest external force, and that of the run added [N, N m]
    run: Motions  # the run
    otherwise: Array  # (K, m) what the plant does otherwise than `Periods.after` in a period

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
        own = a_ref + self.run.acceleration

        def bent(*moved: Array) -> Bent:
            return steps.bent(motions.y[:, joints], *moved) or steps.unbounded

        there, step, wide, dstep, dwide = (
            bent(one) for one in (de, h * speed, window * speed, h * dspeed, window * dspeed)
        )
        cross, fast, turning = (
            bent(window * (speed + dspeed), de + window * dspeed),
            bent(speed),
            bent(window * own[:, base:]),
        )
        turned = bent(window * speed, speed)
        rate, swing = 2 * (1 - self.filter.hold) / h * dv, motions.acceleration + window * self.jerk
        wa, sway = window * a, np.minimum(window * da, dv)
        # mass and gravity: what a period and the window change, then how the window's deviations go together
        slow = (1 + SPREAD) * (turned.M2 + turning.M1)
        result = times(dstep.M1 + cross.M2, a) + times(step.M1 + SPREAD * wide.M1, rate) + times(slow, dv)
        result += times(5 * wide.M2 + 2 * window * turning.M1, da) + times(dwide.M1 + cross.M2, swing)
        result += dstep.g1 + cross.g2
        # Coriolis terms: the same of three factors
        either = [
            *((dwide.C1 + cross.C2, v, wa), (step.C1 + wide.C2, v, dv), (wide.C1, dv, wa), (wide.C1, v, sway)),
            *((there.C1, v, h * a), (wide.C0, dv, h * a), (wide.C0, v, h * rate)),
            *((fast.C1, v, h * dv), (wide.C0, a, h * dv)),
            *((wide.C0, window * own, window * rate), (fast.C1, window * own, window * dv)),
            (wide.C0, 2 * window * (window * self.jerk + self.run.acceleration), sway),
        ]
        both = [(C, *pair) for C, x, y in either for pair in ((x, y), (y, x))]
        both += [(dstep.C1 + cross.C2, v, v), (there.C1, wa, wa), (wide.C0, sway, sway)]
        result += np.sum([twice(*one) for one in both], axis=0)
        # the rest
        damping = np.abs(steps.periods.damping)
        result += h * rate @ damping + 2 * dry(steps, motions.y, h * a + wa) + self.force
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
        found += n @ np.abs(steps.periods.damping) + dry(steps, motions.y, n)
        return found + times(2 * (1 - self.filter.hold) * (M + there.M1) + step.M1, n) / h

    @property
    def jerk(self) -> Array:
        """(K, p) how fast the reference's accelerations change."""
        return self.steps.most(np.abs(np.diff(self.steps.acceleration, axis=0))) / self.steps.h


def misread(steps: Steps, noise: Array, y: Array) -> Array:
    """(K, p) how far Psi of velocities that are told with noise (p,) is from that of the true ones [N, N m]."""
    n = np.broadcast_to(noise, (len(y), len(noise)))
    if not noise.any():
        return np.zeros_like(n)
    refs = stacked(steps.course.at(slice(0, len(steps.of))).command(y[steps.of])[0])
    nu_ref, bent = steps.sizes[0] + steps.off(refs, y), steps.bent(y[:, steps.joints])
    if bent is None:
        return np.full_like(n, np.inf)
    return twice(bent.C0, n, nu_ref) + n @ np.abs(steps.periods.damping) + dry(steps, y, n)


def dry(steps: Steps, y: Array, off: Array) -> Array:
    """(K, p) how much dry friction may change where velocities do by (K, p) [N, N m]."""
    robot, nu_ref = steps.periods.robot, steps.course.nu[: len(steps.of)]
    T, (coulomb, more, stribeck) = np.abs(robot.T), robot.dry.T
    change = off @ T.T
    speed = -steps.most(-np.abs(nu_ref @ robot.T.T)) - y[:, -off.shape[1] :] @ T.T - change
    steep = np.cosh(np.clip(speed / COULOMB_SPEED, 0.0, 300.0)) ** -2.0 / COULOMB_SPEED
    level = (coulomb + more) * np.minimum(2.0, steep * change)
    bends = more * np.minimum(1.0, STEEPEST * change / np.where(more > 0, stribeck, 1.0))
    return np.asarray((level + bends) @ T)

"""A correction beside a linear learner: features of the reference, weights that follow the tracking error. Compiled.

    Psi_w = F(t) w,    w' = Gamma F(t)' s - leakage w,    F = S(t) Phi_d,    S diagonal so that (F Gamma F')_ii = c K_i

Filtered torque says what the robot is, some tenths of a second late, and nothing of what its equations do not hold:
half a period without lead, a load that was just picked up, a start beside the reference. That shows in s at once. Phi_d
are the features of the desired motion, q_ref in place of q and the reference's velocity in place of nu and nu_ref: the
desired compensation of Sadegh and Horowitz 1990 (Int. J. Robotics Research 9(3)). S makes every velocity answer alike
on any motion, a slow one as well. F is a function of time alone, so it carries no noise and is no feedback; and for any
robot, known or not, the map from s to Psi_w is passive:

    (w' Gamma^-1 w / 2)' = s' Psi_w - leakage w' Gamma^-1 w.

So V with this term added has in its derivative what it has without a correction, and `- leakage w' Gamma^-1 w`, for any
leakage that changes with time: just after a change of the robot it is `SLOWER` of what it is otherwise, so that w holds
until the equations know the new robot, and takes back what the error has gathered. As `tr(K^-1 F Gamma F') = p c`, the
correction never is more than a feedback of p c / leakage times K, all p velocities together; faster than leakage it is
less. A sample's answer to s is cut at a share of the feedback.

Where the motors' limits cut Psi_hat by some d (p,), w does not learn against them: of s only what is orthogonal to d
counts, `s - A d (d's) / (d' A d)` for d's > 0. For one motor that is the error without its speed; what is left in the
end goes with A d. A is K^-1, and for the base's velocities the inverse of their `pose_weights`, of the same size: the
other wheel then helps the forward speed more than the turning, as the pose error does, where an error of w counts 1/ky
of one of v.

Of a base that steers F has alpha in place of the reference's velocity, which is none of its own, at the measured
angles: it then carries some noise, and the map stays passive, which F may be anything for.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from ..compiled import compiled, copy_to, internal
from ..elementary import exp
from ..model.regressor import Massless, measured, regress
from ..parts import Vector
from ..signals import INDEX, Array, IntArray
from .factored import NEGLIGIBLE, dot
from .friction_features import desired_rates

if TYPE_CHECKING:
    from .controller import Context

TIME, POSE_REF = INDEX["time"], INDEX["pose_ref"]
SHAPE, ALPHA, Q_REF = INDEX["shape"], INDEX["alpha"], INDEX["q_ref"]
Z, R, PSI_HAT = INDEX["z"], INDEX["r"], INDEX["psi_hat"]
SHARE = 0.2  # largest answer of a sample to s, as a share of the feedback
SLOWER = 0.25  # part of the leakage at which it is forgotten just after a change of the robot
FRESH = 0.1  # how long after its last sample a correction counts, beside periods and known delays [s]


class Correction(NamedTuple):
    """The numbers of a correction, and room to work in."""

    h: float  # control period [s]
    keep: float  # exp(-leakage h)
    longer: float  # exp(-SLOWER leakage h)
    top: float  # c, what it answers s with, over K [1/s]
    rate: Array  # (k,) Gamma
    blend: float  # part of the learner's own features that is taken at the reference
    lasts: float  # how long after its last sample it counts [s]
    nu: Array  # (p,) room to work in
    nudot: Array  # (p,) room to work in
    F: Array  # (p, k) room to work in
    g: Array  # (k,) room to work in
    A: Array  # (p,) how an error that the motors cannot help is shared


class Corrected(NamedTuple):
    """State of a correction."""

    w: Vector  # (k,) its weights
    when: Vector  # (1,) time of its last sample [s]
    asked: Vector  # (p,) Psi_hat of its last sample
    cut: Vector  # (p,) what the motors' limits took of it


def new_correction(context: Context, K: Array, typical: Array, c: float, leakage: float, blend: float) -> Correction:
    """The numbers of a correction.

    Every column has the same part in the answer to s on typical motion, which is c of every velocity on average.

    Args:
        context: Control period, and how long a torque is known to be under way.
        K: (p,) feedback gains.
        typical: (samples, p, k) features of random motion of unit size.
        c: How fast it answers s, over K [1/s].
        leakage: How fast it is forgotten [1/s].
        blend: Part of the learner's own features that is taken at the reference.
    """
    (_, p, k), h = typical.shape, float(context.control_period)
    square = ((typical**2).mean(axis=0) / K[:, None]).sum(axis=0)
    matters = square > NEGLIGIBLE * square.max()
    slow = 0.0 if context.lag is None else float(context.lag.max(initial=0.0))
    return Correction(
        h=h,
        keep=exp(-leakage * h),
        longer=exp(-SLOWER * leakage * h),
        top=float(c),
        rate=c * p * matters / matters.sum() / np.where(matters, square, 1.0),
        blend=float(blend),
        lasts=FRESH + 2.0 * (h + context.way + slow),
        nu=np.zeros(p),
        nudot=np.zeros(p),
        F=np.zeros((p, k)),
        g=np.zeros(k),
        A=shared(K, context.pose_weights),
    )


def shared(K: Array, weights: Array | None) -> Array:
    """A (p,) from gains K (p,) and `pose_weights` (nb,), with which the mean of K A is 1 for the base, too."""
    A = 1.0 / K
    if weights is not None and weights.size:
        A[: weights.size] = weights.size / (K[: weights.size] / weights).sum() / weights
    return A


@internal
def desired(row: Array, at: IntArray, c: Correction, known: Massless, gain: Array, Phi: Array) -> None:
    """F of a sample into c.F, and the learner's features (p, k) moved by `blend` towards those of the reference.

    Args:
        row: (width,) row of signals.
        at: Offsets of the signals.
        c: The correction.
        known: How the robot moves; its columns come first in Phi, what follows is of the reference already.
        gain: (p,) K.
        Phi: (p, k) features of the measured motion, changed.
    """
    p, nb, k0, shape = gain.size, at[ALPHA + 1] - at[ALPHA], known.Y.shape[1], row[at[SHAPE] : at[SHAPE + 1]]
    for i in range(p):
        c.nu[i], c.nudot[i] = desired_rates(row, at, i)
    measured(known, row[at[POSE_REF] : at[POSE_REF + 1]], c.nu[:nb], row[at[Q_REF] : at[Q_REF + 1]], c.nu[nb:], shape)
    regress(known, c.nu, c.nudot)
    for i in range(p):
        copy_to(known.Y[i], c.F[i, :k0])
        copy_to(Phi[i, k0:], c.F[i, k0:])
        total = 0.0
        for j in range(c.rate.size):
            total += c.rate[j] * c.F[i, j] * c.F[i, j]
            Phi[i, j] += c.blend * (c.F[i, j] - Phi[i, j])
        scale = math.sqrt(c.top * gain[i] / total) if total > 0.0 else 0.0
        for j in range(c.rate.size):
            c.F[i, j] *= scale


@internal
def correct(row: Array, at: IntArray, c: Correction, o: Corrected) -> None:
    """Psi_w onto psi_hat, as long as w is fresh: one that nobody moves any more is of another motion."""
    age = row[at[TIME]] - o.when[0]
    if 0.0 <= age <= c.lasts:
        for i in range(c.nu.size):
            row[at[PSI_HAT] + i] += dot(c.F[i], o.w, o.w.size)


@internal
def follow_error(row: Array, at: IntArray, c: Correction, gain: Array, changed: bool, o: Corrected) -> None:
    """One sample of `w' = Gamma F' s - leakage w`, from 0 after a gap; what is no number teaches nothing.

    Args:
        row: (width,) row of signals with Psi_hat before the motors' limits.
        at: Offsets of the signals.
        c: The correction, with F of the sample.
        gain: (p,) K.
        changed: Whether the robot has just changed: w is then forgotten at `SLOWER` of the leakage.
        o: What it remembers.
    """
    k, nb, time = o.w.size, at[Z + 1] - at[Z], row[at[TIME]]
    g, s, answer, feedback, against, size = c.g, c.nu, 0.0, 0.0, 0.0, 0.0
    fresh, keep = 0.0 <= time - o.when[0] <= c.lasts, c.longer if changed else c.keep
    for j in range(k):
        g[j] = 0.0
        o.w[j] = keep * o.w[j] if fresh else 0.0
    o.when[0] = time
    for i in range(gain.size):
        s[i] = row[at[Z] + i] if i < nb else row[at[R] + i - nb]
        o.cut[i] = o.cut[i] if fresh else 0.0
        o.asked[i] = row[at[PSI_HAT] + i]
        feedback += gain[i] * s[i] * s[i]
        against += o.cut[i] * s[i]
        size += o.cut[i] * o.cut[i] * c.A[i]
    for i in range(gain.size):
        if against > 0.0 and size > 0.0:
            s[i] -= against / size * o.cut[i] * c.A[i]
        for j in range(k):
            g[j] += c.F[i, j] * s[i]
    for j in range(k):
        answer += c.h * c.rate[j] * g[j] * g[j]
    if not (math.isfinite(answer) and math.isfinite(feedback)):
        return
    step = c.h * (SHARE * feedback / answer if answer > SHARE * feedback else 1.0)
    for j in range(k):
        o.w[j] += step * c.rate[j] * g[j]


@compiled
def find_cut(row: Array, at: IntArray, o: Corrected) -> None:
    """The part of this sample's Psi_hat (p,) that the motors' limits took, into o.cut."""
    for i in range(o.cut.size):
        o.cut[i] = o.asked[i] - row[at[PSI_HAT] + i]

"""The law of a concurrent learner, compiled: `Psi_hat = Psi_0 + Phi w`, w drawn to what a history stack says.

    w' = rate (w_L - w) + tracking P Phi' s,      P = L^-1 of the stack (`torque.history`)

The gain of least squares makes all excited directions converge at the same rate [1/s], however ill conditioned the
stack is. Between two changes of the stack, with a true w and exact equations, V = s' M s / 2 + w~' L w~ / 2 / tracking
has

    V' = -s' K s - rate / tracking w~' (L - 1) w~ - rate / tracking w~' (w - w_0),

the last term being the pull of the prior, which vanishes beside what was seen. A change of the stack makes V jump, but
there are finitely many of them. A sample's answer to s is kept below a share of the feedback, as in `adaptation`.

Bounds, whatever the sensors say: |w| <= radius, as w_L is put into that ball, which is convex, and so is w after the
tracking term; Psi_hat is bounded by the motors' limits (`torque.motor_limits`).
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, NamedTuple

from ..compiled import compiled
from ..model.regressor import measured, regress
from ..signals import INDEX, Array, IntArray
from .filtered import Filter, low_pass, period, remember
from .history import Scratch, consider, estimate_of, views

if TYPE_CHECKING:
    from ..model.regressor import Massless

TIME, POSE, VELOCITY, Q, QDOT = (INDEX[n] for n in ("time", "pose", "velocity", "q", "qdot"))
Z, R, NU_REF, NUDOT_REF = INDEX["z"], INDEX["r"], INDEX["nu_ref"], INDEX["nudot_ref"]
PSI_HAT, EFFECTIVE_GAIN, WEIGHT_NORM = INDEX["psi_hat"], INDEX["effective_gain"], INDEX["weight_norm"]


class History(NamedTuple):
    """The numbers of a concurrent learner, and memory to work in.

    Attributes:
        known: The robot without its masses.
        basis: (k0, k) `theta = theta_0 + basis w`, scaled so that the prior of w is 1.
        theta0: (k0,) parameters to start from.
        filter: Of torque and features.
        gain: (p,) K.
        precision: (p,) one over the noise of the equations.
        learning: Off keeps w and the stack.
        h: Control period [s].
        every: Samples between two candidates.
        rate: Of w towards what the stack says [1/s].
        tracking: Of w along the tracking error [1/J].
        share: Largest answer of a sample to s, as a share of the feedback.
        radius: Bound on |w|.
        growth: Least gain of log det L of a replacement.
        lifetime: Of an entry [s].
        entries: Places of the stack.
        Phi: (p, k) memory to work in.
        psi0: (p,) memory to work in.
        y: (p,) memory to work in.
        gradient, target: (k,) memory to work in.
        scratch: Memory to work in.
    """

    known: Massless
    basis: Array
    theta0: Array
    filter: Filter
    gain: Array
    precision: Array
    learning: bool
    h: float
    every: int
    rate: float
    tracking: float
    share: float
    radius: float
    growth: float
    lifetime: float
    entries: int
    Phi: Array
    psi0: Array
    y: Array
    gradient: Array
    target: Array
    scratch: Scratch


@compiled
def recall(row: Array, at: IntArray, a: History, state: Array) -> None:
    """Psi_hat and gain of one sample, then the update of w and of the stack.

    Args:
        row: (width,) row of signals; psi_hat, effective_gain and weight_norm are written.
        at: Offsets of the signals.
        a: The numbers of the law.
        state: w (k,), the number of samples, what the filter remembers, the stack.
    """
    p, k = a.Phi.shape
    w, f, nb = state[:k], a.filter, p - a.filter.q.size
    seen = state[k + 1 :]
    features(a, row[at[POSE] : at[VELOCITY]], row[at[Q] : at[QDOT]], row[at[VELOCITY] : at[Q]],
             row[at[QDOT] : at[QDOT + 1]], row[at[NU_REF] : at[NU_REF + 1]],
             row[at[NUDOT_REF] : at[NUDOT_REF + 1]])  # fmt: skip
    say(row, at, a, w)
    if not a.learning:
        return
    answer(row, at, a, w, state)
    now = int(state[k]) % a.every == 0
    state[k] += 1.0
    if not period(row, at, f, seen):
        return
    features(a, f.pose, f.q, f.nu[:nb], f.nu[nb:], f.nu, f.nudot)
    for i in range(p):
        f.torque[i] -= a.psi0[i]
    low_pass(f, a.Phi, seen)
    if now:
        start = 2 + 4 * p + 2 * f.q.size
        stack = views(seen[start + p * k + p :], a.entries, p, k)
        for i in range(p):
            a.y[i] = a.precision[i] * seen[start + p * k + i]
            for j in range(k):
                a.Phi[i, j] = a.precision[i] * seen[start + i * k + j]
        consider(stack, a.scratch, a.Phi, a.y, row[at[TIME]], a.growth, a.lifetime)
        estimate_of(stack, a.target)
        into_ball(a.target, a.radius)
        share = 1.0 - math.exp(-a.rate * a.every * a.h)
        for j in range(k):
            w[j] += share * (a.target[j] - w[j])


@compiled
def features(a: History, pose: Array, q: Array, velocity: Array, qdot: Array, nu_ref: Array, nudot_ref: Array) -> None:
    """Phi and Psi_0 at a state, into a.Phi and a.psi0."""
    measured(a.known, pose, velocity, q, qdot)
    regress(a.known, nu_ref, nudot_ref)
    Y, p, k = a.known.Y, a.Phi.shape[0], a.Phi.shape[1]
    for i in range(p):
        a.psi0[i] = 0.0
        for j in range(k):
            a.Phi[i, j] = 0.0
        for c in range(a.theta0.size):
            if Y[i, c] != 0.0:
                a.psi0[i] += Y[i, c] * a.theta0[c]
                for j in range(k):
                    a.Phi[i, j] += Y[i, c] * a.basis[c, j]


@compiled
def say(row: Array, at: IntArray, a: History, w: Array) -> None:
    """Psi_hat, the gain, and the norm of w."""
    psi_hat, square = row[at[PSI_HAT] : at[PSI_HAT + 1]], 0.0
    for j in range(w.size):
        square += w[j] * w[j]
    row[at[WEIGHT_NORM]], row[at[WEIGHT_NORM] + 1] = math.sqrt(square), 0.0
    for i in range(psi_hat.size):
        row[at[EFFECTIVE_GAIN] + i], psi_hat[i] = a.gain[i], a.psi0[i]
        for j in range(w.size):
            psi_hat[i] += a.Phi[i, j] * w[j]


@compiled
def answer(row: Array, at: IntArray, a: History, w: Array, state: Array) -> None:
    """One sample of `w' = tracking P Phi' s`, its answer to s kept below a share of the feedback."""
    p, k = a.Phi.shape
    z, r = row[at[Z] : at[Z + 1]], row[at[R] : at[R + 1]]
    P = views(state[k + 1 + 2 + 4 * p + 2 * a.filter.q.size + p * k + p :], a.entries, p, k).P
    feedback, late = 0.0, 0.0
    for j in range(k):
        a.gradient[j] = 0.0
    for i in range(p):
        s = z[i] if i < z.size else r[i - z.size]
        feedback += a.gain[i] * s * s
        for j in range(k):
            a.gradient[j] += a.Phi[i, j] * s
    for j in range(k):
        a.target[j] = 0.0
        for c in range(k):
            a.target[j] += P[j, c] * a.gradient[c]
        late += a.h * a.tracking * a.target[j] * a.gradient[j]
    eta = a.share * feedback / late if late > a.share * feedback else 1.0
    for j in range(k):
        w[j] += eta * a.h * a.tracking * a.target[j]
    into_ball(w, a.radius)


@compiled
def into_ball(w: Array, radius: float) -> None:
    """The nearest point with |w| <= radius; zero for what is no number."""
    square = 0.0
    for j in range(w.size):
        square += w[j] * w[j]
    if square <= radius * radius:
        return
    share = radius / math.sqrt(square) if math.isfinite(square) else 0.0
    for j in range(w.size):
        w[j] = share * w[j] if share > 0.0 else 0.0


@compiled
def keep(row: Array, at: IntArray, a: History, state: Array) -> None:
    """Keep the torque that is held from this sample on."""
    if a.learning:
        remember(row, at, state[a.Phi.shape[1] + 1 :])

"""Learners linear in their weights, `Psi_hat = Psi_0 + Phi W`, by a Kalman filter on filtered torque. Compiled.

    tau = Psi_hat + K s,      V = s' M s / 2 + sum_i W~_i' P^-1 W~_i / (2 tau_i)

after the bounded-gain composite law of Slotine and Li 1989 (Automatica 25(4)): the weights follow the tracking error
and what filtered torque says of them (`torque.filtered`),

    W_i' = tau_i P Phi' s  +  P Phi_f' R^-1 (Y_f - Phi_f W),      (P^-1)' = Phi_f' R^-1 Phi_f - P^-1 Q P^-1.

The second term is recursive least squares as a Kalman filter for weights that drift. Phi has p rows and W one column
(a regressor, all velocities share theta), or Phi has one row and W a column per velocity (random features, P common).
R is noise in velocity through the feedback gain, `(noise K_i)^2`, so that one number suits newtons and newton metres.
tau_i is such that s is answered at the rate `tracking` times the part of the prior variance that is left: with one row
`tracking K_i / prior^2` on the scaled P, with p rows `tracking / (prior^2 max K)`.

Continuous, without disturbance, Psi = Psi_0 + Phi W exactly and the true torque in Y_f, V falls at least by s' K s.
P is bounded: Q adds to one place of the diagonal after the other, and never beyond the prior's number there, so the
trace of P is at most that of P_0. W is bounded: `W_i' P_0^-1 W_i <= radius_i^2` by the projection onto a half-space
that contains that ball, in the metric P^-1, where it lowers the distance to every point of the ball; what is then still
outside is scaled back, which need not. Psi_hat is bounded by the motors' limits (`torque.motor_limits`).
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, NamedTuple

from ..compiled import compiled, copy_to
from ..model.regressor import measured, regress
from ..signals import INDEX, Array, IntArray
from .covariance import dot
from .features import Random, fill
from .filtered import Filter, low_pass, period, remember
from .least_squares import predict, project, track

if TYPE_CHECKING:
    from ..model.regressor import Massless

POSE, VELOCITY, Q, QDOT = INDEX["pose"], INDEX["velocity"], INDEX["q"], INDEX["qdot"]
Z, R = INDEX["z"], INDEX["r"]
NU_REF, NUDOT_REF = INDEX["nu_ref"], INDEX["nudot_ref"]
PSI_HAT, EFFECTIVE_GAIN, WEIGHT_NORM = INDEX["psi_hat"], INDEX["effective_gain"], INDEX["weight_norm"]


class Linear(NamedTuple):
    """The numbers of a linear learner, and memory to work in.

    Attributes:
        known: The robot without its masses, or None.
        random: Random features, or None: then Phi is the regressor of `known`.
        filter: Of torque and features.
        gain: (p,) K.
        learning: Off keeps the weights.
        every: Samples from one update to the next.
        interval: The same in seconds.
        noise: Variance of an equation divided by K_i [m^2/s^2, rad^2/s^2].
        answer: (m,) tau_i, of every column of W.
        share: Largest answer of an update to s, as a share of the feedback.
        drift: Part of the prior variance that one update adds at its place.
        radius: (m,) bound on every column of W, in the metric of P_0.
        theta0: (k0,) parameters of a nominal robot, Psi_0 = Y theta0; of size 0 for none.
        Phi: (rows, k) memory to work in.
        psi0: (p,) memory to work in.
        work: (4, k) memory to work in.
    """

    known: Massless | None
    random: Random | None
    filter: Filter
    gain: Array
    learning: bool
    every: int
    interval: float
    noise: float
    answer: Array
    share: float
    drift: float
    radius: Array
    theta0: Array
    Phi: Array
    psi0: Array
    work: Array


class Parts(NamedTuple):
    """The parts of a linear learner's memory, as views.

    Attributes:
        W: (m, k) weights, transposed: a column of W is a row here.
        U, D: (k, k), (k,) factors of P.
        prior: (k,) diagonal of P_0.
        counts: (2,) samples, and updates.
        filter: What the filter remembers.
        drawn: What the random features drew.
    """

    W: Array
    U: Array
    D: Array
    prior: Array
    counts: Array
    filter: Array
    drawn: Array


@compiled
def parts_of(state: Array, m: int, k: int, filtered: int) -> Parts:
    """Views of a memory; m columns of weights, k features, `filtered` numbers of the filter."""
    a, b = m * k, m * k + k * k
    c = b + 2 * k + 2
    return Parts(
        state[:a].reshape((m, k)),
        state[a:b].reshape((k, k)),
        state[b : b + k],
        state[b + k : b + 2 * k],
        state[c - 2 : c],
        state[c : c + filtered],
        state[c + filtered :],
    )


@compiled
def filtered_size(p: int, n: int, rows: int, k: int) -> int:
    """How many numbers the filter of p velocities, n of them of joints, remembers with features (rows, k)."""
    return 2 + 5 * p + 2 * n + rows * k


@compiled
def keep_torque(row: Array, at: IntArray, a: Linear, state: Array) -> None:
    """Remember the torque that is held from this sample on, once nothing changes it any more."""
    m, k = a.radius.size, a.Phi.shape[1]
    remember(row, at, state[m * k + k * k + 2 * k + 2 :])


@compiled
def learn(row: Array, at: IntArray, a: Linear, known: Massless | None, random: Random | None, state: Array) -> None:
    """Psi_hat and gain of one sample, then the update of the weights.

    Args:
        row: (width,) row of signals; psi_hat, effective_gain and weight_norm are written.
        at: Offsets of the signals.
        a: The numbers of the law.
        known: `a.known`, as an argument: what a run does not have is not compiled for it.
        random: `a.random`, likewise.
        state: See `Parts`.
    """
    p, m = a.gain.size, a.radius.size
    rows, k = a.Phi.shape
    o = parts_of(state, m, k, filtered_size(p, a.filter.q.size, rows, k))
    nu_ref, nudot_ref = row[at[NU_REF] : at[NU_REF + 1]], row[at[NUDOT_REF] : at[NUDOT_REF + 1]]
    velocity, qdot = row[at[VELOCITY] : at[Q]], row[at[QDOT] : at[QDOT + 1]]
    features(a, known, random, o.drawn, row[at[POSE] : at[VELOCITY]], row[at[Q] : at[QDOT]], velocity, qdot, nu_ref,
             nudot_ref)  # fmt: skip
    say(row, at, a, o)
    if not a.learning:
        return
    f, now = a.filter, int(o.counts[0]) % a.every == 0
    o.counts[0] += 1.0
    if now:
        track(row, at, a, o)
    if period(row, at, f, o.filter):
        nb = p - f.q.size
        features(a, known, random, o.drawn, f.pose, f.q, f.nu[:nb], f.nu[nb:], f.nu, f.nudot)
        for i in range(p):
            f.torque[i] -= a.psi0[i]
        low_pass(f, a.Phi, o.filter)
        if now:
            predict(a, o)
    if now:
        project(a, o)


@compiled
def features(
    a: Linear, known: Massless | None, random: Random | None, drawn: Array, pose: Array, q: Array, velocity: Array,
    qdot: Array, nu_ref: Array, nudot_ref: Array,
) -> None:  # fmt: skip
    """Phi and Psi_0 at a state, into a.Phi and a.psi0."""
    if known is not None:
        measured(known, pose, velocity, q, qdot)
        regress(known, nu_ref, nudot_ref)
        if random is None:
            for i in range(a.Phi.shape[0]):
                copy_to(known.Y[i], a.Phi[i])
        else:
            for i in range(a.psi0.size):
                a.psi0[i] = dot(known.Y[i], a.theta0, a.theta0.size)
    if random is not None:
        fill(random, drawn, q, velocity, qdot, nu_ref, nudot_ref, a.Phi[0])


@compiled
def say(row: Array, at: IntArray, a: Linear, o: Parts) -> None:
    """Psi_hat, the gain, and the norms of the weights of base and arm."""
    p, m, nb = a.gain.size, o.W.shape[0], at[VELOCITY + 1] - at[VELOCITY]
    psi_hat = row[at[PSI_HAT] : at[PSI_HAT + 1]]
    for i in range(p):
        psi_hat[i] = a.psi0[i] + dot(o.W[min(i, m - 1)], a.Phi[min(i, a.Phi.shape[0] - 1)], o.D.size)
        row[at[EFFECTIVE_GAIN] + i] = a.gain[i]
    square, arm = 0.0, 0.0
    for i in range(m):
        one = dot(o.W[i], o.W[i], o.D.size)
        square, arm = (square + one, arm) if i < nb or m == 1 else (square, arm + one)
    row[at[WEIGHT_NORM]], row[at[WEIGHT_NORM] + 1] = math.sqrt(square), math.sqrt(arm)

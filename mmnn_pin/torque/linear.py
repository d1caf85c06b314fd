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
outside is scaled back, which need not. Psi_hat is bounded by the motors' limits (`torque.law`).

P is kept as factors `P = U D U'`: positive definite for ever, whatever is measured. U is unit upper triangular and D
diagonal. A measurement multiplies every D_j with a ratio of positive numbers and never subtracts (Bierman 1977,
Factorization Methods for Discrete Sequential Estimation); variance is added by the algorithm of Agee and Turner that he
gives. So no number of updates makes P indefinite, which rounding does to P itself. Column j of U stands in row j of the
array: `U[j, i] = U_ij` for i < j; the rest of the array is not used.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from ..by_address import by_address
from ..compiled import Matrix, Vector, compiled, copy_to, internal, linked, views
from ..model.regressor import Massless, measured, regress
from ..signals import INDEX, Array, IntArray
from .filtered import Filter, Filtered, low_pass, period, remember
from .friction_features import Friction, beside, follow
from .law import KERNELS, Kernels
from .random_features import Random, fill

POSE, VELOCITY, Q, QDOT = INDEX["pose"], INDEX["velocity"], INDEX["q"], INDEX["qdot"]
Z, R = INDEX["z"], INDEX["r"]
NU_REF, NUDOT_REF = INDEX["nu_ref"], INDEX["nudot_ref"]
PSI_HAT, EFFECTIVE_GAIN, WEIGHT_NORM = INDEX["psi_hat"], INDEX["effective_gain"], INDEX["weight_norm"]
NEGLIGIBLE = 1e-24  # of a variance, or of the largest mean square of a feature, below which it is none
SOON, LONG = 0.1, 3.0  # times over which surprise is averaged [s]
SURPRISE = 100.0  # largest square of an error over its variance that one equation counts for
AT_ONCE, RENEWED = 8, 0.01  # places that get variance in an update when alarmed; part of their prior variance
CERTAIN = 1e12  # an equation that would lower its own variance by more than this is not taken: the data are no data


@by_address
class Linear(NamedTuple):
    """The numbers of a linear learner, and room to work in.

    Attributes:
        known: The robot without its masses, or None.
        random: Random features, or None: then Phi begins with the regressor of `known`.
        friction: Friction features that follow it, and then a constant per velocity; None for none of both.
        filter: Of torque and features.
        gain: (p,) K.
        learning: Off keeps the weights.
        every: Samples from one update to the next.
        interval: The same in seconds.
        noise: Variance of an equation divided by K_i [m^2/s^2, rad^2/s^2].
        answer: (m,) tau_i, of every column of W.
        share: Largest answer of an update to s, as a share of the feedback.
        drift: Part of the prior variance that one update adds at its place.
        change: Part of a constant's prior variance that every update adds; 0 where there are none.
        alarm: How many times larger than for long errors have to be of late for the past to count less; 0 for never.
        radius: (m,) bound on every column of W, in the metric of P_0.
        theta0: (k0,) parameters of a nominal robot, Psi_0 = Y theta0; of size 0 for none.
        Phi: (rows, k) room to work in.
        psi0: (p,) room to work in.
        work: (4, k) room to work in.
        layout: Of `Parts` in the state.
    """

    known: Massless | None
    random: Random | None
    friction: Friction | None
    filter: Filter
    gain: Array
    learning: bool
    every: int
    interval: float
    noise: float
    answer: Array
    share: float
    drift: float
    change: float
    alarm: float
    radius: Array
    theta0: Array
    Phi: Array
    psi0: Array
    work: Array
    layout: IntArray


class Parts(NamedTuple):
    """What a linear learner remembers.

    Attributes:
        W: (m, k) weights, transposed: a column of W is a row here.
        U, D: (k, k), (k,) factors of P.
        prior: (k,) diagonal of P_0.
        counts: (4,) samples, updates, and the mean square of errors over their variances, of late and for long.
        filtered: What the filter remembers.
        a, b: (units, inputs), (units,) what the random features drew.
        moved: (2, p d) friction features of the last sample, and behind the filter of states and torque.
    """

    W: Matrix
    U: Matrix
    D: Vector
    prior: Vector
    counts: Vector
    filtered: Filtered
    a: Matrix
    b: Vector
    moved: Matrix


parts_of = views(Parts)


@linked
def estimate(row: Array, at: IntArray, a: Linear, state: Array) -> None:
    """Psi_hat and gain of one sample, then the update of the weights."""
    learn(row, at, a, a.known, a.random, a.friction, parts_of(state, a.layout))


@linked
def settle(row: Array, at: IntArray, a: Linear, state: Array) -> None:
    """Keep the torque that is held from this sample on."""
    remember(row, at, parts_of(state, a.layout).filtered)


@internal
def learn(
    row: Array, at: IntArray, a: Linear, known: Massless | None, random: Random | None, friction: Friction | None,
    o: Parts,
) -> None:  # fmt: skip
    """Psi_hat and gain of one sample, then the update of the weights.

    Args:
        row: (width,) row of signals; psi_hat, effective_gain and weight_norm are written.
        at: Offsets of the signals.
        a: The numbers of the law.
        known: `a.known`, as an argument: what a run does not have is not compiled for it.
        random: `a.random`, likewise.
        friction: `a.friction`, likewise.
        o: What it remembers.
    """
    p = a.gain.size
    nu_ref, nudot_ref = row[at[NU_REF] : at[NU_REF + 1]], row[at[NUDOT_REF] : at[NUDOT_REF + 1]]
    velocity, qdot = row[at[VELOCITY] : at[Q]], row[at[QDOT] : at[QDOT + 1]]
    features(a, known, random, o, row[at[POSE] : at[VELOCITY]], row[at[Q] : at[QDOT]], velocity, qdot, nu_ref,
             nudot_ref)  # fmt: skip
    if friction is not None:
        beside(row, at, friction, a.Phi)
    say(row, at, a, o)
    if not a.learning:
        return
    f, now = a.filter, int(o.counts[0]) % a.every == 0
    o.counts[0] += 1.0
    if now:
        track(row, at, a, o)
    counts = period(row, at, f, o.filtered)
    if friction is not None:
        follow(f, o.filtered, o.moved, a.Phi)
    if counts:
        nb = p - f.q.size
        features(a, known, random, o, f.pose, f.q, f.nu[:nb], f.nu[nb:], f.nu, f.nudot)
        for i in range(p):
            f.torque[i] -= a.psi0[i]
        low_pass(f, a.Phi, o.filtered)
        if now:
            predict(a, o)
    if now:
        project(a, o)


@internal
def features(
    a: Linear, known: Massless | None, random: Random | None, o: Parts, pose: Array, q: Array, velocity: Array,
    qdot: Array, nu_ref: Array, nudot_ref: Array,
) -> None:  # fmt: skip
    """Phi and Psi_0 at a state, into a.Phi and a.psi0."""
    if known is not None:
        measured(known, pose, velocity, q, qdot)
        regress(known, nu_ref, nudot_ref)
        if random is None:
            for i in range(a.Phi.shape[0]):
                copy_to(known.Y[i], a.Phi[i, : known.Y.shape[1]])
        else:
            for i in range(a.psi0.size):
                a.psi0[i] = dot(known.Y[i], a.theta0, a.theta0.size)
    if random is not None:
        fill(random, o.a, o.b, q, velocity, qdot, nu_ref, nudot_ref, a.Phi[0])


@internal
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


@internal
def track(row: Array, at: IntArray, a: Linear, o: Parts) -> None:
    """One step of `W' = tau P Phi' s`, its answer to s kept below a share of the feedback."""
    z, r, m, k = row[at[Z] : at[Z + 1]], row[at[R] : at[R + 1]], o.W.shape[0], o.D.size
    g, step, answer, feedback = a.work[0], a.work[1], 0.0, 0.0
    for j in range(k):
        g[j] = 0.0 if m == 1 else a.Phi[0, j]
    for i in range(a.gain.size):
        s = z[i] if i < z.size else r[i - z.size]
        feedback += a.gain[i] * s * s
        if m == 1:
            for j in range(k):
                g[j] += a.Phi[i, j] * s
        else:
            answer += a.answer[i] * s * s
    times(o.U, o.D, g, step)
    answer = a.interval * dot(g, step, k) * (a.answer[0] if m == 1 else answer)
    eta = a.share * feedback / answer if answer > a.share * feedback else 1.0
    if not (math.isfinite(answer) and math.isfinite(feedback)):
        return
    for c in range(m):
        size = eta * a.interval * a.answer[c]
        if m > 1:
            size *= z[c] if c < z.size else r[c - z.size]
        for j in range(k):
            o.W[c, j] += size * step[j]


@internal
def predict(a: Linear, o: Parts) -> None:
    """The equations that filtered torque gives, one Kalman update each; then the drift."""
    m, k, rows = o.W.shape[0], o.D.size, a.Phi.shape[0]
    Phi_f, Y_f = o.filtered.Phi_f, o.filtered.Y_f
    phi, f, b, surprise = a.work[0], a.work[1], a.work[2], 0.0
    for i in range(rows):
        for j in range(k):
            phi[j] = Phi_f[i, j] / a.gain[i] if m == 1 else Phi_f[i, j]
        alpha = measure(o.U, o.D, phi, a.noise, f, b)
        if alpha == 0.0:
            continue
        for c in range(m):
            e = Y_f[i] / a.gain[i] if m == 1 else Y_f[c]
            e = (e - dot(o.W[c], phi, k)) / alpha
            surprise += min(e * e * alpha, SURPRISE)
            for j in range(k):
                o.W[c, j] += e * b[j]
    surprise /= rows
    o.counts[2] += a.interval / SOON * (surprise - o.counts[2])
    alarmed = a.alarm > 0.0 and o.counts[1] * a.interval > LONG and o.counts[2] > a.alarm * o.counts[3]
    o.counts[3] += a.interval / LONG * (surprise - o.counts[3])
    for more in range(AT_ONCE if alarmed else 1):
        place = int(o.counts[1] + more) % k
        drift(a, o, place, max(a.drift * k, RENEWED if alarmed else 0.0))
    o.counts[1] += AT_ONCE if alarmed else 1.0
    for c in range(k - a.gain.size if a.change > 0.0 else k, k):
        drift(a, o, c, a.change)


@internal
def drift(a: Linear, o: Parts, place: int, part: float) -> None:
    """Add a part of the prior variance at a place, as far as there is room below the prior."""
    room = o.prior[place] - variance(o.U, o.D, place)
    added = min(part * o.prior[place], room)
    if added > 0.0:
        add(o.U, o.D, place, added, a.work[3])


@internal
def project(a: Linear, o: Parts) -> None:
    """Every column of W back into its ball `W' P_0^-1 W <= radius^2`."""
    n, Pn, inverse = a.work[0], a.work[1], a.work[2]
    for j in range(o.D.size):
        inverse[j] = 1.0 / o.prior[j] if o.prior[j] > 0.0 else 0.0
    for c in range(o.W.shape[0]):
        w, radius = o.W[c], a.radius[c]
        square = quadratic(w, inverse)
        if square <= radius * radius:
            continue
        if math.isfinite(square):
            for j in range(w.size):
                n[j] = w[j] * inverse[j]
            times(o.U, o.D, n, Pn)
            slope = dot(n, Pn, w.size)
            if slope > 0.0:
                back = (square - radius * math.sqrt(square)) / slope
                for j in range(w.size):
                    w[j] -= back * Pn[j]
            square = quadratic(w, inverse)
        if not square <= radius * radius:
            for j in range(w.size):
                w[j] = w[j] * (radius / math.sqrt(square)) if math.isfinite(square) else 0.0


@compiled
def left(Phi: Array, U: Array, D: Array, f: Array) -> float:
    """`sum over rows of phi' P phi` of features (rows, k); f (k,) is room to work in."""
    total = 0.0
    for i in range(Phi.shape[0]):
        for j in range(D.size):
            f[j] = Phi[i, j] + dot(U[j], Phi[i], j)
            total += f[j] * D[j] * f[j]
    return total


@compiled
def dot(a: Array, b: Array, size: int) -> float:
    """`a' b` over the first `size` numbers, in four sums at a time."""
    s0, s1, s2, s3 = 0.0, 0.0, 0.0, 0.0
    whole = size - size % 4
    for i in range(0, whole, 4):
        s0 += a[i] * b[i]
        s1 += a[i + 1] * b[i + 1]
        s2 += a[i + 2] * b[i + 2]
        s3 += a[i + 3] * b[i + 3]
    for i in range(whole, size):
        s0 += a[i] * b[i]
    return (s0 + s1) + (s2 + s3)


@internal
def measure(U: Array, D: Array, phi: Array, noise: float, f: Array, b: Array) -> float:
    """P after `y = phi' w + v` was measured, `P - P phi phi' P / (noise + phi' P phi)`, in place.

    Args:
        U: (k, k) factors, see above.
        D: (k,) factors.
        phi: (k,) features.
        noise: Variance of v, > 0.
        f: (k,) room to work in.
        b: (k,) written: `P phi` of the P before; divided by what is returned it is the Kalman gain.

    Returns:
        `noise + phi' P phi` of the P before; 0 for an equation that was not taken.
    """
    total = noise
    for j in range(D.size):
        f[j] = phi[j] + dot(U[j], phi, j)
        total += f[j] * D[j] * f[j]
    if not total < CERTAIN * noise:
        return 0.0
    alpha = noise
    for j in range(D.size):
        v, before, u = D[j] * f[j], alpha, U[j]
        alpha += f[j] * v
        D[j] *= before / alpha
        share = f[j] / before
        for i in range(j):
            old, bi = u[i], b[i]
            u[i] = old - share * bi
            b[i] = bi + v * old
        b[j] = v
    return alpha


@compiled
def add(U: Array, D: Array, place: int, variance: float, x: Array) -> None:
    """P with a variance >= 0 added at one place of its diagonal, in place; x (k,) is room to work in."""
    for i in range(place):
        x[i] = 0.0
    x[place] = 1.0
    for j in range(place, -1, -1):
        s, u, before = x[j], U[j], D[j]
        after = before + variance * s * s
        if not after > 0.0:
            continue
        share = variance * s / after
        D[j] = after
        variance *= before / after
        for i in range(j):
            x[i] -= s * u[i]
            u[i] += share * x[i]


@compiled
def times(U: Array, D: Array, g: Array, out: Array) -> None:
    """`P g` (k,) into out."""
    for j in range(D.size):
        t = D[j] * (g[j] + dot(U[j], g, j))
        u = U[j]
        for i in range(j):
            out[i] += t * u[i]
        out[j] = t


@compiled
def variance(U: Array, D: Array, place: int) -> float:
    """P at one place of its diagonal."""
    total = D[place]
    for j in range(place + 1, D.size):
        total += U[j, place] * U[j, place] * D[j]
    return total


@compiled
def quadratic(a: Array, scale: Array) -> float:
    """`sum a_j^2 scale_j`; inf where that is too large for a number."""
    total = 0.0
    for j in range(a.size):
        total += a[j] * a[j] * scale[j]
    return total if not math.isnan(total) else math.inf


def factors(P: Array) -> tuple[Array, Array]:
    """U (k, k) and D (k,) of `P = U D U'`, U as `torque.linear` keeps it; P is positive semidefinite."""
    rest, k = P.copy(), len(P)
    U, D = np.zeros((k, k)), np.zeros(k)
    for j in range(k - 1, -1, -1):
        if rest[j, j] <= NEGLIGIBLE * P[j, j]:
            continue
        D[j] = rest[j, j]
        U[j, :j] = rest[:j, j] / D[j]
        rest[:j, :j] -= D[j] * np.outer(U[j, :j], U[j, :j])
    return U, D


KERNELS[Linear] = Kernels(estimate, settle)

"""Learners linear in their weights, `Psi_hat = Psi_0 + Phi W`, by a Kalman filter on filtered torque. Compiled.

    tau = Psi_hat + K s,      V = s' M s / 2 + sum_i W~_i' P^-1 W~_i / (2 tau_i)

after the bounded-gain composite law of Slotine and Li 1989 (Automatica 25(4)): the weights follow the tracking error
and what filtered torque says of them (`torque.filtered`),

    W_i' = tau_i P Phi' s  +  P Phi_f' R^-1 (Y_f - Phi_f W),      (P^-1)' = Phi_f' R^-1 Phi_f - P^-1 Q P^-1.

The second term is recursive least squares as a Kalman filter for weights that drift. Phi has p rows and W one column
(a regressor, all velocities share theta), or Phi has one row and W a column per velocity (random features, P common).
R is noise in velocity through the feedback gain, `(noise K_i)^2 interval`, so that one number suits newtons and newton
metres. An update counts the time since the last one, in all terms: an equation has the variance R over that time. Just
after an alarm every sample is an update, which learns no faster than the law says, only with less delay.
tau_i is such that s is answered at the rate `tracking` times the part of the prior variance that is left: with one row
`tracking K_i / prior^2` on the scaled P, with p rows `tracking / (prior^2 max K)`.

Continuous, without disturbance, Psi = Psi_0 + Phi W exactly and the true torque in Y_f, V falls at least by s' K s.
P is bounded: Q adds to one place of the diagonal after the other, and never beyond the prior's number there, so the
trace of P is at most that of P_0. W is bounded: `W_i' P_0^-1 W_i <= radius_i^2` by the projection onto a half-space
that contains that ball, in the metric P^-1, where it lowers the distance to every point of the ball; what is then still
outside is scaled back, which need not. Psi_hat is bounded by the motors' limits (`torque.law`). P is kept as factors
(`torque.factored`).
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

from ..by_address import by_address
from ..compiled import copy_to, inlined, internal, linked
from ..model.regressor import Massless, measured, regress
from ..parts import Matrix, Vector, views
from ..signals import INDEX, Array, IntArray
from .correction import Corrected, Correction, correct, desired, find_cut, follow_error
from .factored import add, covariance, dot, measure, quadratic, times, variance
from .filtered import Filter, Filtered, low_pass, period, remember
from .friction_features import FrictionFeatures, beside, follow
from .law import KERNELS, Kernels
from .random_features import Movement, Random, fill

POSE, VELOCITY, Q, QDOT, SHAPE = (INDEX[name] for name in ("pose", "velocity", "q", "qdot", "shape"))
Z, R = INDEX["z"], INDEX["r"]
NU_REF, NUDOT_REF = INDEX["nu_ref"], INDEX["nudot_ref"]
PSI_HAT, EFFECTIVE_GAIN, WEIGHT_NORM = INDEX["psi_hat"], INDEX["effective_gain"], INDEX["weight_norm"]
SOON, RISE, FALL = 0.03, 0.3, 5.0  # times over which surprise is averaged, and in which levels of errors follow [s]
OFTEN = 0.005  # control period beyond which these times are counted in samples [s]
AFTER = 0.5  # time after a change in which every sample is an update, and a correction is forgotten more slowly [s]
QUIET = 2.0  # time after a start or a change in which no other one is looked for [s]
FAINT = 1e-5  # part of the expected square of an error below which none is told from another
SURPRISE = 25.0  # largest square of an error over its level that one equation counts for


@by_address
class Linear(NamedTuple):
    """The numbers of a linear learner, and room to work in."""

    known: Massless | None  # the robot without its masses, or None
    random: Random | None  # random features, or None: then Phi begins with the regressor of `known`
    # friction features that follow it, and then a constant per velocity; None for none of both
    friction: FrictionFeatures | None
    correction: Correction | None  # what follows the tracking error beside them (`torque.correction`), or None
    filter: Filter  # of torque and features
    gain: Array  # (p,) K of `tau = K s + Psi_hat` [N s/m, N m s/rad; N m s/rad or N s/m]
    learning: bool  # off keeps the weights
    every: int  # samples from one update to the next
    interval: float  # the same in seconds
    noise: float  # variance of an equation that stands for one interval, divided by K_i [m^2/s^2, rad^2/s^2]
    answer: Array  # (m,) tau_i, of every column of W
    share: float  # largest answer of an update to s, as a share of the feedback
    drift: float  # part of the prior variance that comes back in a second [1/s]
    change: float  # part of a constant's prior variance that comes back in a second [1/s]; 0 where there are none
    # how many times their level of the last seconds the squares of errors are where the robot has changed; 0 for never
    alarm: float
    carrying: IntArray  # places of what changes then most likely
    radius: Array  # (m,) bound on every column of W, in the metric of P_0
    theta0: Array  # (k0,) parameters of a nominal robot, Psi_0 = Y theta0; of size 0 for none
    Phi: Array  # (rows, k) room to work in
    psi0: Array  # (p,) room to work in
    work: Array  # (4, k) room to work in
    layout: IntArray  # of `Parts` in the state


class Parts(NamedTuple):
    """State of a linear learner."""

    W: Matrix  # (m, k) weights, transposed: a column of W is a row here
    U: Matrix  # (k, k) factor of P, `U D U'`
    D: Vector  # (k,) factor of P
    prior: Vector  # (k,) diagonal of P_0
    # (7,) samples, updates, mean square of errors of late over their levels, whether the robot has just changed,
    # samples since it last did, how many more count as just after that, and samples since an update
    counts: Vector
    expected: Vector  # (rows,) variances of the last equations
    level: Vector  # (p,) squares of errors in the last seconds, over K
    filtered: Filtered  # what the filter remembers
    a: Matrix  # (units, inputs) what the random features drew
    b: Vector  # (units,) what they drew
    moved: Matrix  # (2, p d) friction features of the last sample, and behind the filter of states and torque
    corrected: Corrected  # what the correction remembers


parts_of = views(Parts)


@linked
def estimate(row: Array, at: IntArray, a: Linear, state: Array) -> None:
    """Psi_hat and gain of one sample, then the update of the weights."""
    o = parts_of(state, a.layout)
    respond(row, at, a, a.known, a.random, a.friction, a.correction, o)
    if a.learning:
        learn(row, at, a, a.known, a.random, a.friction, a.correction, o)


@linked
def settle(row: Array, at: IntArray, a: Linear, state: Array) -> None:
    """Keep the torque that is held from this sample on."""
    o = parts_of(state, a.layout)
    remember(row, at, o.filtered)
    find_cut(row, at, o.corrected)


@inlined
def respond(
    row: Array, at: IntArray, a: Linear, known: Massless | None, random: Random | None,
    friction: FrictionFeatures | None, correction: Correction | None, o: Parts,
) -> None:  # fmt: skip
    """Psi_hat and gain of one sample.

    Args:
        row: (width,) row of signals; psi_hat, effective_gain and weight_norm are written.
        at: Offsets of the signals.
        a: The numbers of the law.
        known: `a.known`, as an argument: what a run does not have is not compiled for it.
        random: `a.random`, likewise.
        friction: `a.friction`, likewise.
        correction: `a.correction`, likewise; it has features of `known`.
        o: What it remembers.
    """
    nu_ref, nudot_ref = row[at[NU_REF] : at[NU_REF + 1]], row[at[NUDOT_REF] : at[NUDOT_REF + 1]]
    velocity, qdot = row[at[VELOCITY] : at[Q]], row[at[QDOT] : at[QDOT + 1]]
    pose, q, shape = row[at[POSE] : at[VELOCITY]], row[at[Q] : at[QDOT]], row[at[SHAPE] : at[SHAPE + 1]]
    features(a, known, random, o, Movement(pose, q, velocity, qdot, nu_ref, nudot_ref, shape))
    if friction is not None:
        beside(row, at, friction, a.Phi)
    if correction is not None and known is not None:
        desired(row, at, correction, known, a.gain, a.Phi)
    say(row, at, a, o)
    if correction is not None:
        correct(row, at, correction, o.corrected)


@internal
def learn(
    row: Array, at: IntArray, a: Linear, known: Massless | None, random: Random | None,
    friction: FrictionFeatures | None, correction: Correction | None, o: Parts,
) -> None:  # fmt: skip
    """The update of the weights by one sample; arguments as of `respond`."""
    if correction is not None:
        follow_error(row, at, correction, a.gain, o.counts[5] > 0.0, o.corrected)
    f, now = a.filter, int(o.counts[0]) % a.every == 0 or o.counts[5] > 0.0
    o.counts[0] += 1.0
    o.counts[6] += 1.0
    if now:
        track(row, at, a, o)
    counts = period(row, at, f, o.filtered)
    if o.filtered.clock[1] <= 1.0:
        o.counts[3], o.counts[4], o.counts[5] = 0.0, 0.0, 0.0
    if friction is not None:
        follow(f, o.filtered, o.moved, a.Phi)
    if counts:
        nb = f.nu.size - f.q.size
        features(a, known, random, o, Movement(f.pose, f.q, f.nu[:nb], f.nu[nb:], f.nu, f.nudot, f.shape))
        for i in range(f.nu.size):
            f.torque[i] -= a.psi0[i]
        low_pass(f, a.Phi, o.filtered)
        if a.alarm > 0.0:
            heed(a, o)
        if now:
            predict(a, o)
    if now:
        project(a, o)
        o.counts[6] = 0.0


@internal
def features(a: Linear, known: Massless | None, random: Random | None, o: Parts, m: Movement) -> None:
    """Phi and Psi_0 of a movement, into a.Phi and a.psi0."""
    if known is not None:
        measured(known, m.pose, m.velocity, m.q, m.qdot, m.shape)
        regress(known, m.nu_ref, m.nudot_ref)
        if random is None:
            for i in range(a.Phi.shape[0]):
                copy_to(known.Y[i], a.Phi[i, : known.Y.shape[1]])
        else:
            for i in range(a.psi0.size):
                a.psi0[i] = dot(known.Y[i], a.theta0, a.theta0.size)
    if random is not None:
        fill(random, o.a, o.b, m, a.Phi[0])


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
    time = o.counts[6] * a.filter.h
    answer = time * dot(g, step, k) * (a.answer[0] if m == 1 else answer)
    eta = a.share * feedback / answer if answer > a.share * feedback else 1.0
    if not (math.isfinite(answer) and math.isfinite(feedback)):
        return
    for c in range(m):
        size = eta * time * a.answer[c]
        if m > 1:
            size *= z[c] if c < z.size else r[c - z.size]
        for j in range(k):
            o.W[c, j] += size * step[j]


@internal
def predict(a: Linear, o: Parts) -> None:
    """The equations that filtered torque gives, one Kalman update each; then the drift."""
    m, k, rows = o.W.shape[0], o.D.size, a.Phi.shape[0]
    Phi_f, Y_f = o.filtered.Phi_f, o.filtered.Y_f
    phi, f, b, time = a.work[0], a.work[1], a.work[2], o.counts[6] * a.filter.h
    noise = a.noise * a.interval / time
    for i in range(rows):
        for j in range(k):
            phi[j] = Phi_f[i, j] / a.gain[i] if m == 1 else Phi_f[i, j]
        alpha = measure(o.U, o.D, phi, noise, f, b)
        o.expected[i] = alpha
        if alpha == 0.0:
            continue
        for c in range(m):
            e = Y_f[i] / a.gain[i] if m == 1 else Y_f[c]
            e = (e - dot(o.W[c], phi, k)) / alpha
            for j in range(k):
                o.W[c, j] += e * b[j]
    drift(a, o, int(o.counts[1]) % k, a.drift * time * k)
    o.counts[1] += 1.0
    for c in range(k - a.gain.size if a.change > 0.0 else k, k):
        drift(a, o, c, a.change * time)


@internal
def heed(a: Any, o: Any) -> None:
    """Whether the robot has just changed, by the errors of the equations ahead of their update, into o.counts[3].

    What the low-pass remembers is then of another robot, and is dropped.
    """
    p, m, rows, T, surprise = a.gain.size, o.W.shape[0], a.Phi.shape[0], min(a.filter.h, OFTEN), 0.0
    Phi_f, Y_f = o.filtered.Phi_f, o.filtered.Y_f
    for i in range(p):
        e = (Y_f[i] - dot(o.W[min(i, m - 1)], Phi_f[min(i, rows - 1)], o.D.size)) / a.gain[i]
        level, more = max(o.level[i], FAINT * o.expected[min(i, rows - 1)]), e * e - o.level[i]
        surprise += min(e * e / level, SURPRISE) / p if level > 0.0 else 0.0
        o.level[i] += T / (RISE if more > 0.0 else FALL) * more
    o.counts[2] += T / SOON * (surprise - o.counts[2])
    changed = o.counts[4] * T > QUIET and o.counts[2] > a.alarm
    o.counts[3] = 1.0 if changed else 0.0
    o.counts[4] = 0.0 if changed else o.counts[4] + 1.0
    o.counts[5] = AFTER / T if changed else max(0.0, o.counts[5] - 1.0)
    if changed:
        Phi_f[:] = 0.0
        Y_f[:] = 0.0
        forget_load(a, o)


@internal
def forget_load(a: Any, o: Any) -> None:
    """Give what the robot carries its prior variance back."""
    for j in range(a.carrying.size):
        drift(a, o, a.carrying[j], 1.0)


@internal
def drift(a: Any, o: Any, place: int, part: float) -> None:
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


@linked
def doubt(a: Linear, state: Array, S: Array) -> None:
    """Covariance of what the weights say of the last sample, as of `law.doubt`; columns of W have one for each."""
    o = parts_of(state, a.layout)
    if a.Phi.shape[0] == a.gain.size:
        covariance(a.Phi, o.U, o.D, a.work[0], S)
        return
    times(o.U, o.D, a.Phi[0], a.work[0])
    common = dot(a.Phi[0], a.work[0], o.D.size)
    for i in range(a.gain.size):
        S[i, :] = 0.0
        S[i, i] = a.gain[i] * a.gain[i] * common


KERNELS[Linear] = Kernels(estimate, settle, doubt)

"""One update of a linear learner's weights: tracking error, filtered torque, bounds; see `torque.linear`. Compiled."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from ..compiled import compiled
from ..signals import INDEX, Array, IntArray
from .covariance import add, dot, measure, quadratic, times, variance

if TYPE_CHECKING:
    from .linear import Linear, Parts

Z, R = INDEX["z"], INDEX["r"]


@compiled
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


@compiled
def predict(a: Linear, o: Parts) -> None:
    """The equations that filtered torque gives, one Kalman update each; then the drift."""
    p, m, k, rows = a.gain.size, o.W.shape[0], o.D.size, a.Phi.shape[0]
    first = o.filter.size - p - rows * k
    Phi_f, Y_f = o.filter[first : first + rows * k].reshape((rows, k)), o.filter[first + rows * k :]
    phi, f, b = a.work[0], a.work[1], a.work[2]
    for i in range(rows):
        for j in range(k):
            phi[j] = Phi_f[i, j] / a.gain[i] if m == 1 else Phi_f[i, j]
        alpha = measure(o.U, o.D, phi, a.noise, f, b)
        if alpha == 0.0:
            continue
        for c in range(m):
            e = Y_f[i] / a.gain[i] if m == 1 else Y_f[c]
            e = (e - dot(o.W[c], phi, k)) / alpha
            for j in range(k):
                o.W[c, j] += e * b[j]
    place = int(o.counts[1]) % k
    o.counts[1] += 1.0
    room = o.prior[place] - variance(o.U, o.D, place)
    added = min(a.drift * k * o.prior[place], room)
    if added > 0.0:
        add(o.U, o.D, place, added, a.work[3])


@compiled
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
    """`sum over rows of phi' P phi` of features (rows, k); f (k,) is memory to work in."""
    total = 0.0
    for i in range(Phi.shape[0]):
        for j in range(D.size):
            f[j] = Phi[i, j] + dot(U[j], Phi[i], j)
            total += f[j] * D[j] * f[j]
    return total

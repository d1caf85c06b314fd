"""A history stack: the equations worth keeping, so that knowledge needs no motion that goes on exciting. Compiled.

Concurrent learning keeps chosen data and learns from them at every sample beside the new ones (Chowdhary and Johnson
2010, IEEE CDC; Chowdhary, Muehlegg, Johnson 2014, Int. J. Control 87(8)); filtered torque in the place of measured
accelerations makes it the integral kind (Parikh, Kamalapurkar, Dixon 2019, Int. J. Adaptive Control and Signal
Processing 33(12)). An entry is one filtered equation per velocity, `y = Phi w + noise`, divided by its noise, and the
stack has the information matrix and the estimate

    L = 1 + sum Phi_i' Phi_i,      w_L = L^-1 sum Phi_i' y_i,

where 1 is the prior (w is scaled by it). Chowdhary and Johnson replace an entry where the smallest singular value of
the stack grows (2011, ACC). We replace one where `log det L` grows (D-optimal, Fedorov's exchange): it does not stay
zero until the stack has full rank, does not depend on the units of w, and needs no singular values, as for a candidate
C and an entry i

    log det L+ - log det L = log det(1 + C P C') + log det(1 - G_i+),      P = L^-1,   G_i = Phi_i P Phi_i',

with G_i+ from after C was added. Every replacement adds at least `growth` and log det L is bounded, so there are
finitely many of them, unless entries have a lifetime.

A replacement may still give up what alone told of some direction. Where that is not wanted there is a floor F that L
never goes below: it begins at half the prior and goes half the way to L whenever L is `ABOVE` times as large, as
a mean over all directions. F only grows, so that from any instant on P is at most F^-1 of that instant: what is known
stays known, but for a factor (`research.proof.known_laws`).
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from ..compiled import compiled, internal
from ..elementary import log
from ..parts import Cube, Matrix, Vector
from ..signals import Array

ABOVE = 4.0  # mean ratio of the information to its floor, at which the floor rises
HALF = 0.5  # of the prior, where the floor begins; of the way to L


class Stack(NamedTuple):
    """A history stack, all of it views into a controller's state."""

    Phi: Cube  # (N, p, k) entries; zeros where there is none
    y: Matrix  # (N, p) their other sides
    born: Vector  # (N,) when each was taken [s]
    L: Matrix  # (k, k) information matrix
    P: Matrix  # (k, k) its inverse
    G: Cube  # (N, p, p) `Phi_i P Phi_i'`
    F: Matrix  # (k, k) what L stays above
    b: Vector  # (k,) `sum Phi_i' y_i`
    used: Vector  # (2,) entries that are used, and changes


class Scratch(NamedTuple):
    """Room to work in: PU (k, p), S (p, p), C (p, p), X (p, p), factor (k, k), rest (k, k), column (k,), loss (N,)."""

    PU: Array
    S: Array
    C: Array
    X: Array
    factor: Array
    rest: Array
    column: Array
    loss: Array


def shapes(entries: int, p: int, k: int) -> dict[str, tuple[int, ...]]:
    """Names and shapes of what a stack remembers, to be parts of a `ControllerState`."""
    return {
        "Phi": (entries, p, k), "y": (entries, p), "born": (entries,), "L": (k, k), "P": (k, k), "G": (entries, p, p),
        "F": (k, k), "b": (k,), "used": (2,),
    }  # fmt: skip


def scratch(entries: int, p: int, k: int) -> Scratch:
    """Room to work in."""
    return Scratch(*(np.zeros(shape) for shape in ((k, p), (p, p), (p, p), (p, p), (k, k), (k, k), (k,), (entries,))))


@internal
def consider(
    s: Stack, w: Scratch, Phi: Array, y: Array, time: float, growth: float, lifetime: float, floor: bool
) -> bool:
    """Put an equation into the stack where it is worth it; drop one whose time is over.

    Args:
        s: The stack.
        w: Room to work in.
        Phi: (p, k) the equation's features, divided by its noise.
        y: (p,) its other side, likewise.
        time: The present [s].
        growth: Least gain of log det L, > 0.
        lifetime: Of an entry [s]; inf for ever.
        floor: Whether L stays above one; for entries without a lifetime.

    Returns:
        Whether the stack has changed.
    """
    used, changed = int(s.used[0]), False
    for i in range(used):
        if has_entry(s, i) and time - s.born[i] > lifetime:
            put(s, w, i, Phi, y, 0.0)
            changed = True
            break
    image(s, w, Phi)
    gain = log_det_with(w, 1.0)
    if gain < growth:
        return changed
    place = place_for(s, w, Phi, growth - gain, floor)
    if place < 0:
        return changed
    s.used[0] = max(s.used[0], place + 1.0)
    put(s, w, place, Phi, y, 1.0)
    s.born[place] = time
    if floor:
        raise_floor(s, w)
    return True


@internal
def place_for(s: Stack, w: Scratch, Phi: Array, least: float, floor: bool) -> int:
    """Where an equation goes that w.PU and w.S belong to: the entry that is missed least, a free place before it.

    Args:
        s: The stack.
        w: Room to work in.
        Phi: (p, k) the equation.
        least: What log det L may lose, at most, < 0.
        floor: Whether L stays above its floor.

    Returns:
        The place; -1 for none.
    """
    N, used = len(s.born), int(s.used[0])
    for i in range(used):
        w.loss[i] = 0.0
        if has_entry(s, i):
            removed(s, w, i)
            w.loss[i] = log_det(w.X, w.C)
    for _ in range(used):
        place, best = -1, -math.inf
        for i in range(used):
            if w.loss[i] > best:
                place, best = i, w.loss[i]
        if place < 0 or (used < N and best < 0.0) or best < least:
            break
        if best == 0.0 or not floor or above_floor(s, w, Phi, place):
            return place
        w.loss[place] = -math.inf
    return used if used < N else -1


@internal
def above_floor(s: Stack, w: Scratch, Phi: Array, place: int) -> bool:
    """Whether L stays above its floor where an equation replaces an entry."""
    (p, k), old = Phi.shape, s.Phi[place]
    for j in range(k):
        for c in range(k):
            total = s.L[j, c] - s.F[j, c]
            for i in range(p):
                total += Phi[i, j] * Phi[i, c] - old[i, j] * old[i, c]
            w.rest[j, c] = total
    return factored(w.rest, w.factor)


@internal
def raise_floor(s: Stack, w: Scratch) -> None:
    """Put the floor halfway to L where L is `ABOVE` times as large, as a mean over all directions."""
    k = len(s.L)
    for j in range(k):
        for c in range(k):
            w.rest[j, c] = s.L[j, c]
    above = log_det(w.rest, w.factor)
    for j in range(k):
        for c in range(k):
            w.rest[j, c] = s.F[j, c]
    above -= log_det(w.rest, w.factor)
    if above > k * log(ABOVE):
        for j in range(k):
            for c in range(k):
                s.F[j, c] += HALF * (s.L[j, c] - s.F[j, c])


@compiled
def has_entry(s: Stack, i: int) -> bool:
    """Whether a place of the stack is taken."""
    return bool(s.born[i] >= 0.0)


@compiled
def image(s: Stack, w: Scratch, Phi: Array) -> None:
    """`P Phi'` into w.PU, and `Phi P Phi'` into w.S."""
    product(s.P, Phi.T, w.PU)
    product(Phi, w.PU, w.S)


@internal
def log_det_with(w: Scratch, sign: float) -> float:
    """`log det(1 + sign S)`; w.S becomes the Cholesky factor of `1 + sign S`."""
    for i in range(len(w.S)):
        for j in range(len(w.S)):
            w.X[i, j] = sign * w.S[i, j] + (1.0 if i == j else 0.0)
    return log_det(w.X, w.S)


@internal
def removed(s: Stack, w: Scratch, i: int) -> None:
    """`1 - G_i+` into w.X, with G_i+ as it is once the equation of w.PU has been added."""
    p = len(w.S)
    product(s.Phi[i], w.PU, w.C)
    solved(w.S, w.C)
    for a in range(p):
        for b in range(p):
            total = (1.0 if a == b else 0.0) - s.G[i, a, b]
            for c in range(p):
                total += w.C[a, c] * w.C[b, c]
            w.X[a, b] = total


@internal
def put(s: Stack, w: Scratch, place: int, Phi: Array, y: Array, share: float) -> None:
    """Replace an entry by share (1 or 0) times an equation: L, b, P, and G of all entries."""
    p, k = Phi.shape
    old = s.Phi[place]
    for i in range(p):
        for j in range(k):
            s.b[j] += share * Phi[i, j] * y[i] - old[i, j] * s.y[place, i]
            for c in range(k):
                s.L[j, c] += share * Phi[i, j] * Phi[i, c] - old[i, j] * old[i, c]
    if share == 1.0:
        spread(s, w, Phi, 1.0)
    spread(s, w, old, -1.0)
    for i in range(p):
        s.y[place, i] = share * y[i]
        for j in range(k):
            s.Phi[place, i, j] = share * Phi[i, j]
    s.born[place] = -1.0
    s.used[1] += 1.0
    inverse(s.L, w.factor, w.column, s.P)
    refreshed(s, w, place)
    refreshed(s, w, int(s.used[1]) % max(1, int(s.used[0])))


@internal
def spread(s: Stack, w: Scratch, Phi: Array, sign: float) -> None:
    """Update P and every G_i by an equation that comes (1) or goes (-1)."""
    p, k = Phi.shape
    image(s, w, Phi)
    if not math.isfinite(log_det_with(w, sign)):
        return
    for n in range(int(s.used[0])):
        product(s.Phi[n], w.PU, w.C)
        solved(w.S, w.C)
        for i in range(p):
            for j in range(p):
                for c in range(p):
                    s.G[n, i, j] -= sign * w.C[i, c] * w.C[j, c]
    solved(w.S, w.PU)
    for i in range(k):
        for j in range(k):
            for c in range(p):
                s.P[i, j] -= sign * w.PU[i, c] * w.PU[j, c]


@internal
def refreshed(s: Stack, w: Scratch, i: int) -> None:
    """G_i from P."""
    image(s, w, s.Phi[i])
    for a in range(len(w.S)):
        for b in range(len(w.S)):
            s.G[i, a, b] = w.S[a, b]


@internal
def estimate_of(s: Stack, out: Array) -> None:
    """`w_L = P b` into out (k,)."""
    for i in range(out.size):
        out[i] = 0.0
        for j in range(out.size):
            out[i] += s.P[i, j] * s.b[j]


@compiled
def product(A: Array, B: Array, out: Array) -> None:
    """`A B` (n, m) of A (n, k) and B (k, m)."""
    for i in range(len(A)):
        for j in range(B.shape[1]):
            total = 0.0
            for c in range(len(B)):
                total += A[i, c] * B[c, j]
            out[i, j] = total


@internal
def factored(A: Array, F: Array) -> bool:
    """Lower triangular `A = F F'`, the other half of F untouched; False where A is not positive definite."""
    for j in range(len(A)):
        for i in range(j, len(A)):
            total = A[i, j]
            for c in range(j):
                total -= F[i, c] * F[j, c]
            if i > j:
                F[i, j] = total / F[j, j]
            elif total > 0.0:
                F[j, j] = math.sqrt(total)
            else:
                return False
    return True


@internal
def solved(factor: Array, C: Array) -> None:
    """`C F'^-1` in place for a lower triangular F, so that `C C'` becomes `C (F F')^-1 C'`."""
    for a in range(len(C)):
        for j in range(len(factor)):
            total = C[a, j]
            for c in range(j):
                total -= C[a, c] * factor[j, c]
            C[a, j] = total / factor[j, j]


@compiled
def log_det(X: Array, factor: Array) -> float:
    """Logarithm of a determinant, -inf where the matrix is not positive definite; the factor is written."""
    if not factored(X, factor):
        return -math.inf
    total = 0.0
    for i in range(len(X)):
        total += 2.0 * log(factor[i, i])
    return total


@internal
def inverse(L: Array, factor: Array, column: Array, P: Array) -> None:
    """`L^-1` into P, by way of a factor (k, k) and a column (k,); P stays where L is not positive definite."""
    if not factored(L, factor):
        return
    for j in range(len(L)):
        for i in range(j, len(L)):
            total = 1.0 if i == j else 0.0
            for c in range(j, i):
                total -= factor[i, c] * column[c]
            column[i] = total / factor[i, i]
        for i in range(len(L) - 1, j - 1, -1):
            total = column[i]
            for c in range(i + 1, len(L)):
                total -= factor[c, i] * column[c]
            column[i] = total / factor[i, i]
            P[i, j] = P[j, i] = column[i]

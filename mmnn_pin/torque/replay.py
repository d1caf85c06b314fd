"""The prediction error of the thesis's network, on filtered torque, with a memory of the motion. Compiled.

Over a control period the torque was Psi at the mean state with nu_ref = nu and nudot_ref = nudot (`torque.filtered`):
what the network would see on a reference that the robot follows exactly, its pose error, z, e and r zero. So at

    x* = x(q, nu, nu, nudot)      the network is told     e = tau - W' sigma(V' x*),

and both layers follow e beside s (composite adaptation of a network with an acceleration-free prediction error: Patre,
MacKunis, Johnson, Dixon 2010, IEEE TAC 55(4)), here normalised: with J the derivative of the scaled output,

    W += mu sigma e' / (1 + |J|^2),      V += mu x* (sigma' W e)' / (1 + |J|^2),

so that to first order the error of a sample shrinks by at most mu, for any input. Samples of one motion follow each
other closely, and a network that only follows the newest unlearns the rest: on an eight its frozen weights then explain
nothing. So samples are kept, evenly over the whole run (when the memory is full every second one is dropped), and each
control sample also learns from a few of them (experience replay: Lin 1992, Machine Learning 8; for adaptive control
Chowdhary and Johnson 2010, IEEE CDC).

No guarantee beyond the bounds: V' has the term of `e`, which is not linear in V. |W|, |V| are projected onto balls.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from ..compiled import compiled, copy_to
from ..signals import INDEX, Array, IntArray
from .filtered import Filter, period, remember
from .law import HIDDEN
from .network import shrink

Z, R = INDEX["z"], INDEX["r"]
GOLDEN = 0.6180339887498949  # fractions of its multiples are spread evenly, and in no order


class Replay(NamedTuple):
    """The numbers of a network's prediction error, and memory to work in.

    Attributes:
        filter: Of states and torque.
        first: Where in the controller's memory its counters, filter and samples stand.
        sizes: Of the network's law (`torque.law`).
        source: (nx,) which of q, nu, nudot, pose every input is on a reference that is followed exactly; -1 for 0.
        scale: (nx,) factor on every input.
        offset: (nx,) added to it.
        scale_out: (p,) what a network's output is multiplied with, see `Neural.network_scales`.
        unit: (p,) output that counts as 1.
        rate: mu.
        replays: Kept samples that every control sample learns from.
        every: Control samples between two that are kept, until the memory is full.
        radius: Bounds on |W| in units and on |V|.
        seen: (2 n + ..., ) q, nu, nudot, pose of a period.
        x: (nx,) memory to work in.
        net: (hidden,) memory to work in.
        sigma: (hidden,) memory to work in.
        error: (p,) memory to work in.
    """

    filter: Filter
    first: int
    sizes: IntArray
    source: IntArray
    scale: Array
    offset: Array
    scale_out: Array
    unit: Array
    rate: float
    replays: int
    every: int
    radius: Array
    seen: Array
    x: Array
    net: Array
    sigma: Array
    error: Array


@compiled
def replay(row: Array, at: IntArray, a: Replay, state: Array) -> None:
    """Learn from the last control period and from kept ones.

    Args:
        row: (width,) row of signals.
        at: Offsets of the signals.
        a: The numbers of the law.
        state: The networks' memory, then samples counted, samples kept and how many are skipped between two, what the
            filter remembers, and the kept samples.
    """
    f, p, nx = a.filter, a.unit.size, a.x.size
    counts, width = state[a.first : a.first + 3], nx + p
    filtered = a.first + 3 + 2 + 4 * p + 2 * f.q.size + p
    kept = state[filtered:].reshape((-1, width))
    if period(row, at, f, state[a.first + 3 : filtered]):
        recollect(a)
        for i in range(p):
            f.torque[i] /= a.scale_out[i]
        teach(row, at, a, state, a.x, f.torque)
        if int(counts[0]) % (a.every * int(counts[2])) == 0:
            keep_sample(a, counts, kept)
    counts[0] += 1.0
    for i in range(a.replays if counts[1] > 0.0 else 0):
        place = GOLDEN * (counts[0] * a.replays + i)
        sample = kept[int((place - math.floor(place)) * counts[1])]
        teach(row, at, a, state, sample[:nx], sample[nx:])


@compiled
def recollect(a: Replay) -> None:
    """The input x* of a period, into a.x."""
    f = a.filter
    n, p = f.q.size, f.nu.size
    copy_to(f.q, a.seen[:n])
    copy_to(f.nu, a.seen[n : n + p])
    copy_to(f.nudot, a.seen[n + p : n + 2 * p])
    copy_to(f.pose, a.seen[n + 2 * p :])
    for i in range(a.x.size):
        value = a.seen[a.source[i]] if a.source[i] >= 0 else 0.0
        a.x[i] = a.scale[i] * value + a.offset[i]


@compiled
def keep_sample(a: Replay, counts: Array, kept: Array) -> None:
    """Keep the period just seen; when there is no room (for an even number of them) every second one goes."""
    nx = a.x.size
    if int(counts[1]) == len(kept):
        half = len(kept) // 2
        for i in range(half):
            copy_to(kept[2 * i], kept[i])
        counts[1], counts[2] = half, 2.0 * counts[2]
    sample = kept[int(counts[1])]
    copy_to(a.x, sample[:nx])
    copy_to(a.filter.torque, sample[nx:])
    counts[1] += 1.0


@compiled
def teach(row: Array, at: IntArray, a: Replay, state: Array, x: Array, torque: Array) -> None:
    """One normalised step of base's and arm's network towards a torque (p,) at an input (nx,)."""
    nx, start, first = x.size, x.size, 0
    for which in range(2):
        m = at[Z + 1] - at[Z] if which == 0 else at[R + 1] - at[R]
        if m == 0:
            continue
        h = a.sizes[HIDDEN + which]
        W = state[start : start + h * m].reshape((h, m))
        V = state[start + h * m : start + h * (m + nx)].reshape((nx, h))
        start += h * (m + nx + 2) + m
        descend(a, W, V, x, torque[first : first + m], a.unit[first : first + m])
        first += m


@compiled
def descend(a: Replay, W: Array, V: Array, x: Array, torque: Array, unit: Array) -> None:
    """One normalised step of one network."""
    h, m, nx = W.shape[0], W.shape[1], x.size
    net, sigma, e = a.net, a.sigma, a.error
    for j in range(h):
        net[j] = 0.0
    for i in range(nx):
        for j in range(h):
            net[j] += V[i, j] * x[i]
    for i in range(m):
        e[i] = torque[i]
    square, inputs = 1.0, 0.0
    for i in range(nx):
        inputs += x[i] * x[i]
    for j in range(h):
        sigma[j] = 1.0 / (1.0 + np.exp(-net[j]))
        slope = sigma[j] * (1.0 - sigma[j])
        square += sigma[j] * sigma[j]
        for i in range(m):
            e[i] -= W[j, i] * sigma[j]
            square += inputs * (slope * W[j, i] / unit[i]) ** 2
    mu, sum_w, sum_v = a.rate / square, 0.0, 0.0
    if not math.isfinite(mu):
        return
    for j in range(h):
        back = 0.0
        for i in range(m):
            back += W[j, i] * e[i] / unit[i] ** 2
            W[j, i] += mu * sigma[j] * e[i]
            sum_w += (W[j, i] / unit[i]) ** 2
        net[j] = mu * sigma[j] * (1.0 - sigma[j]) * back
    for i in range(nx):
        for j in range(h):
            V[i, j] += x[i] * net[j]
            sum_v += V[i, j] * V[i, j]
    shrink(W, sum_w, a.radius[0])
    shrink(V, sum_v, a.radius[1])


@compiled
def keep_held(row: Array, at: IntArray, a: Replay, state: Array) -> None:
    """Keep the torque that is held from this sample on."""
    remember(row, at, state[a.first + 3 :])

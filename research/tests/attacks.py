"""Attacks on tubes: the true loop under the worst errors that a tube allows."""

from __future__ import annotations

import numpy as np

from mmnn_pin.signals import Array
from research.proof.periods import Periods
from research.proof.tube_search import Search


def attacked(search: Search, first: int, last: int, wanted: int, eps: Array, noise: float = 1.0) -> Array:
    """States (periods, m) of the true loop under errors of Psi (K, p) with the signs worst for one error at the end.

    Velocities are told with errors at `noise` times their bound, of the worst signs, too.
    """
    periods, steps, rows = search.periods, search.steps, search.periods.subject.rows
    Z, signs, wrong = np.eye(search.sums.m)[wanted], {}, {}
    for j in range(search.ends[last] - 1, search.starts[first] - 1, -1):
        signs[j], Z = np.sign(Z @ steps.B(j)), Z @ steps.P(j)
        wrong[j] = -noise * search.told * np.sign(signs[j] @ steps.answers[j])
    y = search.reached[search.starts[first]]
    found = [y]
    for j in range(search.starts[first], search.ends[last]):
        asked = told(periods, rows[j], y, wrong[j]) + eps[steps.of[j]] * signs[j]
        y = periods.after(rows[j], rows[j + 1], y, asked)
        found.append(y)
    return np.array(found)


def told(periods: Periods, row: Array, y: Array, noise: Array) -> Array:
    """The torque of a state whose velocities are told with an error; Psi is that of the true velocity."""
    (position, nu), wrong = periods.placed(row, y), y.copy()
    wrong[-len(noise) :] += noise
    where, (seen, _, measured) = periods.layout.where, periods.seen(row, wrong)
    nu_ref, nudot_ref = seen[where("nu_ref")], seen[where("nudot_ref")]
    psi = periods.dynamics.psi(position, nu, nu_ref, nudot_ref)
    return np.asarray(periods.gain * (nu_ref - measured) + psi)


def within(search: Search, first: int, reached: Array, size: Array) -> bool:
    """Whether states (periods, m) from a block on are in a tube (K, m), at every period."""
    start, m = search.starts[first], reached.shape[1]
    blocks = np.minimum(np.searchsorted(search.ends, start + np.arange(len(reached)), side="left"), len(size) - 1)
    return bool((np.abs(reached) <= size[np.maximum(blocks, first), :m]).all())

"""The weights' part of a concurrent learner, `w~' L w~ / (2 tracking)` with L of its stack, and what changes it.

`w* = basis^+ (theta - theta_0)` of the true parameters, `w~ = w* - w` (see `torque.recall`). A sample moves w by
`eta h tracking P Phi' s`, P = L^-1, which takes `eta h s' Phi w~` out: pull and cut. When a candidate was looked at it
goes on by a share `c = 1 - exp(-rate tau)` towards `w_L = P b`. With exact equations `b = (L - 1) w*`, in truth
`b = (L - 1) w* + d`, so that `L (w_L - w) = (L - 1) w~ - w + d`, and to first order in c the part changes by

    prediction  -c/tracking w~' (L - 1) w~ <= 0     what the stack says
    leakage      c/tracking w~' w                   the pull of the prior, to w_0 = 0
    noise       -c/tracking w~' d                   what the stack's equations have wrong

A change of the stack makes it jump by `w~' (L+ - L) w~ / (2 tracking)`, the term `state`. The rest, second order
and the ball that w is kept in, is `step`.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from ...errors import RecordingError
from ...signals import Array, IntArray
from ...torque.recall import History
from .learner import Learner
from .subject import Subject
from .together import Row, copies, together
from .weights_part import WITHOUT, WeightsPart, part_of


def stack_part(
    subject: Subject, learner: Learner, ideal: Array, at: IntArray, progress: Callable[[float], None] | None = None
) -> WeightsPart:
    """The part at some rows of a run, (k,) ascending, for the true weights (k,).

    Raises:
        RecordingError: `tracking` is 0, so that nothing takes the pull out.
    """
    history = learner.controller.law(learner.context).history
    assert history is not None
    if not history.tracking > 0:
        raise RecordingError(WITHOUT, why="the estimate does not follow s: tracking is 0")
    found = np.zeros((7, len(subject.rows)))
    missed = together(
        learner,
        subject.rows,
        lambda state: copies(state, "w", "L", "P"),
        lambda row: fill(history, ideal, row, found),
        progress,
    )
    value, pull, *rest = found[:, at]
    terms = dict(zip(("cut", "prediction", "leakage", "noise", "memory"), rest, strict=True))
    return part_of(subject, at, value, pull, terms, missed)


def fill(a: History, ideal: Array, row: Row, found: Array) -> None:
    """Value, pull and terms of one row."""
    w, L, P = (row.before[name] for name in ("w", "L", "P"))
    state, s, n = row.state, row.s, row.number
    error, g = ideal - w, row.Phi.T @ s
    found[0, n] = error @ L @ error / (2 * a.tracking)
    found[1, n] = g @ error
    answer, most = a.h * a.tracking * float(g @ P @ g), a.share * float(a.gain @ s**2)
    eta = most / answer if answer > most else 1.0
    found[2, n] = (1 - eta) * found[1, n]
    learned = int(state["samples"][0] - 1) % a.every == 0 and state["clock"][1] > a.filter.wait + 1
    if not learned:
        return
    w = w + eta * a.h * a.tracking * P @ g
    error, now, weight = ideal - w, state["L"], (1 - np.exp(-a.rate * a.every * a.h)) / a.tracking
    seen = now @ ideal - ideal
    found[3, n] = -weight * (error @ now @ error - error @ error) / a.h
    found[4, n] = weight * (error @ w) / a.h
    found[5, n] = -weight * (error @ (state["b"] - seen)) / a.h
    found[6, n] = error @ (now - L) @ error / (2 * a.tracking * a.h)

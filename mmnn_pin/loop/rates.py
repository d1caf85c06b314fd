"""One rule for all that integrates: how fast an integral or an observer beside the feedback may be.

The sampled loop with it, at all velocities coupled, keeps of the delay that the feedback alone bears beyond the known
one the part `PART`:

    margin(rate) - known >= PART (margin(0) - known)

at places along the reference, those where the loop is fastest and those where it is slowest. *margin* is that of
`sampled.HeldLoop`; *known* are latency, its `latency.margin`, the motors' lag (in the loop itself) and the filter of
velocities. What is added to `tau = K s` are, with effective inertias m and bandwidths b = K / m,

    integral    rate K s / p                                                    (pid; feedforward, M nudot_ref beside)
    observer    rate (m s + K s / p) and m nudot_ref
    sliding     the same without m nudot_ref

An observer of the disturbance `d = u - m nudot` behind a low-pass `rate / (p + rate)`, whose estimate is added to u, is
the second one: `u = K s + m nudot_ref + d_hat` is `(1 + rate / p) K s + m nudot_ref + rate m s`. Time-delay control,
L1 adaptive control with its low-pass and an observer of an extended state therefore have one rule, that of a PI
controller. One of second order, `w^2 / (p + w)^2`, is at low frequencies one of first order with the rate w / 2.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Literal

import numpy as np

from ..signals import Array
from .sampled import HeldLoop

MOST = 4.0  # factor on gains or weights
LEFT = 0.5, 0.25  # of the margin beyond what has to be left: what higher gains, and what more weight leave
PART = 0.75  # of the margin of the feedback alone, beyond what is known, that is left
FASTEST = 20.0  # rates that are tried begin here [1/s]
SLOWER, STEPS = 0.9, 80  # and are this times the one before, so many of them

Kind = Literal["integral", "model", "observer", "sliding"]


def largest_rate(loops: Sequence[HeldLoop], gains: Array, inertia: Array, h: float, known: float, kind: Kind) -> float:
    """The largest rate that the rule allows; 0 where it allows none that is tried [1/s].

    Args:
        loops: The loop at some places.
        gains: (p,) K.
        inertia: (p,) effective inertias m [kg, kg m^2].
        h: Control period [s].
        known: Delay that is known, in the sense of the rule [s].
        kind: What is added: "integral", "model" for one beside `M nudot_ref`, "observer", "sliding".
    """
    inside = kind in ("model", "observer")
    loops = [with_inertia(loop, inertia) for loop in loops] if kind == "observer" else loops
    least = []
    for loop in loops:
        alone = loop.margin(gains, h, inside)
        least.append(min(alone, known + PART * max(0.0, alone - known)) if np.isfinite(alone) else known)

    def bears(rate: float) -> bool:
        more = rate * inertia if kind in ("observer", "sliding") else 0.0
        adds = rate * h * gains
        margins = (loop.margin(gains + more, h, inside, adds) for loop in loops)
        return all(margin > 0.0 and margin >= enough for margin, enough in zip(margins, least, strict=True))

    return largest(FASTEST, bears)


def largest(most: float, bears: Callable[[float], bool]) -> float:
    """The largest of `most SLOWER^i` that a loop bears, which is what it bears everything below of; 0 for none."""
    low, high = 0, STEPS  # of the exponent: the first one that the loop bears is in between
    while low < high:
        middle = (low + high) // 2
        low, high = (low, middle) if bears(most * SLOWER**middle) else (middle + 1, high)
    return most * SLOWER**low if low < STEPS else 0.0


def borne(loops: Sequence[HeldLoop], gains: Array, h: float, known: float, more: float) -> tuple[float, float, float]:
    """How fast a learner may answer s over K [1/s], and factors f on the gains and on the weight of an estimate.

    With L the margin that has to be left, what is known and `more` of what is beyond it, or half of that,

        L = known + min(more, (margin(K, M nudot_ref) - known) / 2),

    higher gains (a robust term), or more inertia than there is (an estimate that has run too far), leave a part of the
    margin beyond it to the answer, which is an integral beside the higher gains:

        margin(f K, M nudot_ref) >= L + LEFT[0] (margin - L),    margin(K, f M nudot_ref) >= L + LEFT[1] (margin - L),
        margin(f K, M nudot_ref, integral) >= L

    Args:
        loops: The loop at some places.
        gains: (p,) K.
        h: Control period [s].
        known: Delay that is known [s].
        more: Delay beyond it that the loop should bear [s].
    """
    order, alone = list(loops), {id(loop): max(known, loop.margin(gains, h, True)) for loop in loops}
    least = {key: known + min(more, 0.5 * (margin - known)) for key, margin in alone.items()}

    def holds(margin: Callable[[HeldLoop], float], left: float) -> bool:
        for k, loop in enumerate(order):
            L = least[id(loop)]
            if margin(loop) < L + left * (alone[id(loop)] - L):
                order.insert(0, order.pop(k))  # what fails first will again
                return False
        return True

    def higher(factor: float) -> bool:
        return holds(lambda one: one.margin(factor * gains, h, True), LEFT[0])

    def heavier(factor: float) -> bool:
        return holds(lambda one: replace(one, inside=factor * one.inside).margin(gains, h, True), LEFT[1])

    room = max(1.0, largest(MOST, higher))

    def faster(rate: float) -> bool:
        return holds(lambda one: one.margin(room * gains, h, True, rate * h * gains), 0.0)

    return largest(1.0 / h, faster), room, max(1.0, largest(MOST, heavier))


def with_inertia(loop: HeldLoop, inertia: Array) -> HeldLoop:
    """The loop with `m nudot_ref` inside in place of `M nudot_ref`; inertia (p,)."""
    return replace(loop, inside=inertia[loop.rows, None] * loop.rates)

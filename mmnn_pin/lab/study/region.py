"""Within which values of the factors a controller succeeds often enough: a box.

It is found on half of the runs and judged on the other half. The search peels thin slices off the box where they cost
most successes (PRIM: Friedman and Fisher, 1999) and then takes back every cut that is not needed.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .factors import Factor
from .intervals import Interval, rate
from .sensitivity import key, levels_of

Mask = NDArray[np.bool_]
SLICE = 0.06  # share of the box that a peel takes
SMALLEST = 0.08  # share of the runs that a box must hold
FEWEST = 20  # runs of either half that it must hold


@dataclass(frozen=True)
class Cut:
    """What a box demands of one factor.

    Attributes:
        factor: Its name.
        low: Smallest value; None for no bound.
        high: Largest value; None for no bound.
        levels: Values that are in, of a factor without an order; None for all.
    """

    factor: str
    low: float | None = None
    high: float | None = None
    levels: tuple[Any, ...] | None = None

    def told(self, unit: str = "") -> str:
        """In words."""
        end = f" {unit}" if unit else ""
        if self.levels is not None:
            return f"{self.factor} {' or '.join(map(str, self.levels))}{end}"
        if self.low is not None and self.high is not None:
            return f"{self.factor} {self.low:.3g} to {self.high:.3g}{end}"
        if self.low is not None:
            return f"{self.factor} from {self.low:.3g}{end}"
        return f"{self.factor} up to {self.high:.3g}{end}"

    def holds(self, values: Sequence[Any]) -> Mask:
        """Which values are in."""
        if self.levels is not None:
            inside = {key(level) for level in self.levels}
            return np.array([key(value) in inside for value in values], bool)
        given = np.asarray(values, float)
        low, high = -np.inf if self.low is None else self.low, np.inf if self.high is None else self.high
        return np.asarray((given >= low) & (given <= high))


@dataclass(frozen=True)
class Region:
    """A box in the factors.

    Attributes:
        cuts: What it demands; nothing where all runs are in.
        share: Share of all runs that are in it.
        success: Rate of successes within, of the runs that had no part in finding it.
    """

    cuts: tuple[Cut, ...]
    share: float
    success: Interval


def region_of(
    values: Mapping[str, Sequence[Any]], factors: Mapping[str, Factor], success: Mask, half: Mask, wanted: float
) -> Region | None:
    """The largest box found in which at least the wanted share succeeds; None where there is none.

    Args:
        values: Factor to its values in all runs.
        factors: The factors.
        success: (n,) which runs succeeded.
        half: (n,) which runs find the box; the others judge it.
        wanted: Share of successes.
    """
    cuts: dict[str, Cut] = {}
    inside = np.ones(len(success), bool)
    least = max(FEWEST, SMALLEST * half.sum())
    while share(success, inside & half) < wanted:
        searched = inside & half
        options = [
            cut for name in factors for cut in peels(name, factors[name], values[name], searched, cuts.get(name))
        ]
        gains = [gain(success, searched, cut.holds(values[cut.factor])) for cut in options]
        if max(gains, default=0.0) <= 0:
            return None
        best = options[int(np.argmax(gains))]
        cuts[best.factor] = best
        inside &= best.holds(values[best.factor])
        if (inside & half).sum() < least or (inside & ~half).sum() < FEWEST:
            return None
    cuts = needed(cuts, values, success, half, wanted)
    inside = within(cuts, values, len(success))
    judged = inside & ~half
    return Region(tuple(cuts.values()), float(inside.mean()), rate(int(success[judged].sum()), int(judged.sum())))


def peels(name: str, factor: Factor, values: Sequence[Any], inside: Mask, cut: Cut | None) -> list[Cut]:
    """Boxes that take a slice off one factor."""
    kept = [value for value, is_in in zip(values, inside, strict=True) if is_in]
    levels = levels_of(kept, factor.numeric)
    if len(levels) < 2:
        return []
    if not factor.numeric:
        return [Cut(name, levels=tuple(other for other in levels if other is not level)) for level in levels]
    low, high = (None, None) if cut is None else (cut.low, cut.high)
    ordered = np.sort(np.asarray(kept, float))
    count = max(1, round(SLICE * len(ordered)))
    above, below = ordered[ordered > ordered[count - 1]], ordered[ordered < ordered[-count]]
    options = [Cut(name, float(above[0]), high)] if len(above) else []
    return options + ([Cut(name, low, float(below[-1]))] if len(below) else [])


def gain(success: Mask, inside: Mask, kept: Mask) -> float:
    """How much the rate of successes rises for each run that a peel takes away."""
    left = inside & kept
    taken = int(inside.sum() - left.sum())
    return (share(success, left) - share(success, inside)) / taken if taken and left.any() else -np.inf


def needed(
    cuts: dict[str, Cut], values: Mapping[str, Sequence[Any]], success: Mask, half: Mask, wanted: float
) -> dict[str, Cut]:
    """The cuts without which the rate would be too low; those that take most runs away are tried first."""
    order = sorted(cuts, key=lambda name: int(cuts[name].holds(values[name]).sum()))
    for name in order:
        for fewer in (None, *one_sided(cuts[name])):
            trial = {n: c for n, c in cuts.items() if n != name} | ({} if fewer is None else {name: fewer})
            if share(success, within(trial, values, len(success)) & half) >= wanted:
                cuts = trial
                break
    return cuts


def one_sided(cut: Cut) -> list[Cut]:
    """A cut with one of its two bounds."""
    if cut.low is None or cut.high is None:
        return []
    return [Cut(cut.factor, cut.low, None), Cut(cut.factor, None, cut.high)]


def within(cuts: Mapping[str, Cut], values: Mapping[str, Sequence[Any]], count: int) -> Mask:
    """Runs that are in a box."""
    inside = np.ones(count, bool)
    for name, cut in cuts.items():
        inside &= cut.holds(values[name])
    return inside


def share(success: Mask, inside: Mask) -> float:
    """Rate of successes of some runs; 0 of none."""
    return float(success[inside].mean()) if inside.any() else 0.0

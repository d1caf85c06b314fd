"""Whether a learner knows Psi or only follows it, in a sentence for base and arm, with the joints that count."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from typing import NamedTuple, Self

import numpy as np

from ....signals import Array
from ...proof.psi import Psi, worst
from ..table import number

CONSTANT = "predicts worse than a constant"
JUDGED = ("online", "same", "held_out")
MOST_NAMES = 3  # components that a sentence names


def verdicts(psi: Psi, how: str = "") -> Iterator[str]:
    """Per network one sentence: does it know Psi, or only follow it? First how to hear that of a user's law."""
    if how:
        yield f"{how[0].upper()}{how[1:]}."
    for half, where in psi.halves.items():
        kinds = {"online": psi.online} | {name: frozen.fvu for name, frozen in psi.frozen.items()}
        found = [Judged.of(psi.labels[where], kinds[name][where]) if name in kinds else UNKNOWN for name in JUDGED]
        if not psi.frozen:
            why = "its weights are not at hand" if how else "it learns nothing, so no weights are held fixed"
            yield f"{half}: FVU online {found[0]}; {why}."
            continue
        yield f"{half}: {judgement(*found)}"


class Judged(NamedTuple):
    """The worst FVU of some components, the one that has it, and those that are predicted worse than a constant."""

    fvu: float
    worst: str = ""
    lost: tuple[str, ...] = ()

    @classmethod
    def of(cls, labels: Sequence[str], values: Array) -> Self:
        """Of components by name."""
        short = [label.removesuffix("_joint") for label in labels]
        if not np.isfinite(values).any():
            return cls(math.nan)
        lost = [name for name, value in zip(short, values, strict=True) if value >= 1]
        return cls(worst(values), short[int(np.nanargmax(values))], tuple(lost) if len(lost) < len(short) > 1 else ())

    def __str__(self) -> str:
        return f"{number(self.fvu)} of {self.worst}" if self.worst else number(self.fvu)

    def prediction(self) -> str:
        """How well it predicts; never rounded to all of Psi."""
        if self.fvu >= 1:
            return f"predicts {some(self.lost)} worse than a constant" if self.lost else CONSTANT
        return f"explains {'more than 99.9' if 0 < self.fvu < 0.001 else f'{100 * (1 - self.fvu):.3g}'} % of Psi"


UNKNOWN = Judged(math.nan)


def some(names: Sequence[str]) -> str:
    """Some names as a part of a sentence, not more than a line has room for."""
    shown = [*names[:MOST_NAMES], f"{len(names) - MOST_NAMES} others"] if len(names) > MOST_NAMES + 1 else [*names]
    return " and ".join([", ".join(shown[:-1]), shown[-1]] if shown[1:] else shown)


def judgement(online: Judged, same: Judged, other: Judged) -> str:
    """What FVU online, frozen on the run's own trajectory and frozen on a held-out one say together, in words."""
    numbers = f"FVU online {online}, frozen {same}" + (f", held out {other}" if math.isfinite(other.fvu) else "")
    if not math.isfinite(online.fvu) or not math.isfinite(same.fvu):
        return f"Psi does not vary, there is nothing to judge ({numbers})."
    if same.fvu >= 1:
        frozen = same.prediction()
    elif not math.isfinite(other.fvu):
        frozen = f"{same.prediction()} on its own trajectory"
    elif other.fvu >= 1:
        frozen = f"{same.prediction()} on its own trajectory and {other.prediction()} on a new one"
    else:
        frozen = f"{other.prediction()} on a trajectory that it never saw"
    return f"adapting, it {online.prediction()}; frozen, it {frozen} ({numbers})."

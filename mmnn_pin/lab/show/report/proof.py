"""What the runs prove, for the page: sentences on what was learned, and one table of numbers."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass

import numpy as np

from ....recording.recording import Recording
from ...proof.balance import TOLERANCE
from ...proof.proof import Proof, proofs_with
from ...proof.psi import worst
from ..proof.text import small, verdicts
from ..table import number
from .tables import Cell, Row, Table

CAPTION = (
    "FVU: fraction of variance unexplained of \u03a8, its worst component; 1 is the best constant. Online: while the "
    "weights move. Frozen: with the weights as they were at the end. Equality: "
    "d/dt (s\u1d40Ms/2) = s\u1d40(\u03a8 - \u03c4 + d) over control periods, worst relative error, "
    f"tolerance {TOLERANCE:g}. mmnn prove tells more of each run."
)
FROZEN = {"same": "own trajectory", "held_out": "held out", "payload": "with a payload"}


@dataclass(frozen=True)
class Proved:
    """What the page tells.

    Attributes:
        sentences: One per network.
        table: A column per run.
    """

    sentences: tuple[str, ...]
    table: Table


def proved(recordings: Mapping[str, Recording]) -> Proved | None:
    """What some runs prove; None where nothing can be told of any."""
    proofs, _ = proofs_with(recordings, "subject")
    rows = tuple(rows_of(proofs))
    if not rows:
        return None
    learners = {name: proof for name, proof in proofs.items() if proof.has("psi") and proof.psi.frozen}
    sentences = tuple(f"{name}, {text}" for name, proof in learners.items() for text in verdicts(proof.psi))
    return Proved(sentences, Table("Proof", ("", "", *proofs), rows, 2, CAPTION))


def rows_of(proofs: Mapping[str, Proof]) -> Iterator[Row]:
    """Rows of the table; those that no run has a number for are left out."""
    halves = {half: None for proof in proofs.values() if proof.has("psi") for half in proof.psi.halves}

    def online(half: str) -> Callable[[Proof], Cell]:
        return lambda proof: fvu_cell(worst(proof.psi.online[proof.psi.halves[half]])) if proof.has("psi") else Cell("")

    def frozen(kind: str, half: str) -> Callable[[Proof], Cell]:
        def cell(proof: Proof) -> Cell:
            if not (proof.has("psi") and kind in proof.psi.frozen):
                return Cell("")
            return fvu_cell(worst(proof.psi.frozen[kind].fvu[proof.psi.halves[half]]))

        return cell

    wanted = [("FVU online", half, online(half)) for half in halves]
    wanted += [(f"FVU frozen, {words}", half, frozen(kind, half)) for kind, words in FROZEN.items() for half in halves]
    wanted += [("V grows in", "% of the periods", growing), ("equality", "worst error", equality)]
    before = ""
    for title, second, make in wanted:
        cells = [make(proof) for proof in proofs.values()]
        if any(cell.text for cell in cells):
            yield Row((Cell("" if title == before else title), Cell(second), *cells))
            before = title


def fvu_cell(value: float) -> Cell:
    """An FVU; one that is no better than a constant is bad."""
    return Cell(number(value), "bad" if value >= 1 else "")


def growing(proof: Proof) -> Cell:
    """How much of the time V grows."""
    return Cell(f"{100 * proof.growth.samples:.0f}") if proof.has("lyapunov") else Cell("")


def equality(proof: Proof) -> Cell:
    """The worst error of the equality that the run is held to."""
    if not proof.has("balance"):
        return Cell("")
    found = proof.balance
    return Cell(small(np.nanmax((found.identity, found.steps))), "" if found.holds else "bad")

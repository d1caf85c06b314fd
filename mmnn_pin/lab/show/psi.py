"""Whether a learner knows Psi or only follows it: a sentence for base and arm, and tables with the numbers."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from itertools import pairwise
from typing import NamedTuple, Self

import numpy as np

from ...shown import shows
from ...signals import Array
from ..psi.judgement import Judgement
from ..psi.psi import Psi, how_to_know, worst
from .table import WIDTH, Column, Row, Table, TextLine, grouped, number, row_of, terminal_text

CONSTANT = "predicts worse than a constant"
JUDGED = ("online", "same", "held_out")
FROZEN = {"same": "frozen,\nown run", "held_out": "frozen,\nheld out", "payload": "frozen,\npayload"}
SHARES = {"feedback": "feed-\nback", "network": "network,\nPsi_hat", "robust": "robust\nterm"}
MOST_WINDOWS = 8  # columns that a terminal has room for
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
        """The share of Psi that it predicts; never rounded to all of it."""
        if self.fvu >= 1:
            return f"predicts {some(self.lost)} worse than a constant" if self.lost else CONSTANT
        return f"explains {'more than 99.9' if 0 < self.fvu < 0.001 else f'{100 * (1 - self.fvu):.3g}'} % of Psi"


UNKNOWN = Judged(math.nan)


def some(names: Sequence[str]) -> str:
    """Some names as a part of a sentence, not more than a line has room for."""
    shown = [*names[:MOST_NAMES], f"{len(names) - MOST_NAMES} others"] if len(names) > MOST_NAMES + 1 else [*names]
    return " and ".join([", ".join(shown[:-1]), shown[-1]] if shown[1:] else shown)


def judgement(online: Judged, same: Judged, other: Judged) -> str:
    """The judgement in words on FVU online, frozen on the run's own trajectory and frozen on a held-out one."""
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


# -- tables --


@shows(Judgement, "text")
def render(judgement: Judgement, colour: bool = False, width: int = WIDTH) -> str:
    """The whole judgement as text of at most `width` columns."""
    return terminal_text(parts(judgement), colour, width)


def parts(judgement: Judgement) -> Iterator[str | TextLine | Table]:
    """Title, sentences, tables and notes, in order."""
    yield from learned_parts(judgement)
    yield from notes(judgement)


def learned_parts(judgement: Judgement, more: Iterable[Row] = ()) -> Iterator[str | TextLine | Table]:
    """Title, and what was learned of Psi: sentences and tables.

    Args:
        judgement: The run.
        more: Rows of what is known of its networks beside their excitation, a cell for each.
    """
    subject = judgement.subject
    yield TextLine(f"{subject.controller} on {subject.robot.name}", "bold")
    if judgement.has("psi"):
        yield from verdicts(judgement.psi, how_to_know(subject))
        yield from psi_tables(judgement.psi)
        if judgement.psi.networks:
            yield network_table(judgement.psi, more)


def notes(judgement: Judgement) -> Iterator[TextLine]:
    """Remarks, but for the one that the sentences begin with."""
    how = how_to_know(judgement.subject) if judgement.has("psi") else ""
    yield from (TextLine(f"note: {remark}", "italic") for remark in judgement.remarks() if remark != how)


def network_table(psi: Psi, more: Iterable[Row]) -> Table:
    """Ranks, excitation and what else is known of the networks: a column per network."""
    first = "Networks" if psi.networks[0].what == "activations" else "Learner"
    columns = words(first), *(Column(network.name) for network in psi.networks)
    return Table(first, columns, grouped(excitation_rows(psi), more))


def words(heading: str, fold: bool = True) -> Column:
    """A column of texts."""
    return Column(heading, text=True, fold=fold)


def psi_tables(psi: Psi) -> Iterator[str | Table]:
    """FVU online and frozen and shares of the torque, then the online error in windows: a row per component."""
    columns = {"online": psi.online} | {FROZEN[name]: frozen.fvu for name, frozen in psi.frozen.items()}
    columns |= {SHARES[part]: values for part, values in psi.shares.items()}
    yield component_table("FVU, then shares of the torque", psi, columns)
    if psi.frozen:
        yield "\n".join(f"{FROZEN[name].replace(chr(10), ' ')}: {frozen.about}" for name, frozen in psi.frozen.items())
    if len(psi.errors) <= MOST_WINDOWS:
        spans = zip(pairwise(psi.edges), psi.errors, strict=True)
        columns = {f"{a:.3g} to\n{b:.4g} s": values for (a, b), values in spans}
        yield component_table("Error online over the run's variance", psi, columns)


def component_table(title: str, psi: Psi, columns: Mapping[str, Array]) -> Table:
    """Columns of one number per component."""
    rows = (
        row_of(label.removesuffix("_joint"), *(number(values[i]) for values in columns.values()))
        for i, label in enumerate(psi.labels)
    )
    return Table(title, (words(title), *map(Column, columns)), tuple(rows))


def excitation_rows(psi: Psi) -> Iterator[Row]:
    """Rows of the features that multiply the weights, and how well they were excited."""
    networks, first = psi.networks, psi.networks[0]
    excitations, unknown = [n.excitation for n in networks], [n.unknown for n in networks]
    for weights in first.ranks:
        cells = (f"{number(n.ranks[weights])} of {len(n.singular[weights])}" for n in networks)
        yield row_of(f"effective rank of {weights}", *cells)
    yield row_of(f"effective rank of the {first.what}", *(f"{number(e.rank)} of {e.units}" for e in excitations))
    above = f"excited directions (eigenvalue > {first.excitation.visible:g} of the largest)"
    yield row_of(above, *(f"{e.directions} of {e.units}" for e in excitations))
    smallest = f"smallest eigenvalue of the Gram matrix of the {first.what}"
    yield row_of(smallest, *(small(e.smallest) for e in excitations))
    if any(unknown):
        shares = ("-" if one is None else f"{one.share:.0%}" for one in unknown)
        yield row_of("left undetermined of what random motion shows", *shares)
    if acting := [f"{one.acting} of {one.units}" for one in unknown if one and one.units]:
        yield row_of("as how many its units act on random motion", *acting)


def small(value: float) -> str:
    """Two digits and an exponent; 0 for what is rounding."""
    return f"{value:.1e}" if value > 1e-18 else "0"

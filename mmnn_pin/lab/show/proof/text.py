"""A proof for a terminal: sentences that judge, tables with the numbers."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping

from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.table import Table

from ....signals import Array
from ...proof.balance import TOLERANCE, Balance
from ...proof.fvu import worst
from ...proof.growth import Growth
from ...proof.linear_fit import LinearFit
from ...proof.lyapunov import TERMS, Lyapunov
from ...proof.proof import Proof
from ...proof.psi import Psi, how_to_know
from ...proof.truth import Truth
from ..table import WIDTH, number

FROZEN = {"same": "frozen,\nown run", "held_out": "frozen,\nheld out", "payload": "frozen,\npayload"}
SHARES = {"feedback": "feed-\nback", "network": "network,\nPsi_hat", "robust": "robust\nterm"}
MOST_WINDOWS = 8  # columns that a terminal has room for
PARTS = {"pose": "V1 of the pose", "motion": "s' M s / 2", "weights": "weights' part"}


def render(proof: Proof, colour: bool = False, width: int = WIDTH) -> str:
    """The whole proof as text of at most `width` columns."""
    console = Console(width=width, force_terminal=colour, color_system="standard" if colour else None)
    subject = proof.subject
    with console.capture() as capture:
        console.print(f"{subject.controller} on {subject.robot.name}", style="bold", highlight=False)
        for part in parts(proof):
            if isinstance(part, str):
                console.print(part, highlight=False, markup=False)
            else:
                console.print(part)
        said = how_to_know(subject) if proof.has("psi") else ""
        for remark in (one for one in proof.remarks() if one != said):
            console.print(f"note: {remark}", style="italic", highlight=False, markup=False)
    return "\n".join(line.rstrip() for line in capture.get().splitlines())


def parts(proof: Proof) -> Iterator[str | Table]:
    """Sentences and tables, in order."""
    if proof.has("psi"):
        yield from verdicts(proof.psi, how_to_know(proof.subject))
        yield from psi_tables(proof.psi)
        if proof.psi.networks:
            yield network_table(proof)
    if proof.has("lyapunov"):
        yield lyapunov_sentence(proof.lyapunov, proof.growth)
        yield terms_table(proof.growth)
        if spans := spans_sentence(proof.growth):
            yield spans
    if proof.has("balance"):
        timing = proof.subject.timing
        yield balance_sentence(proof.balance, f"{timing.integrator} at {timing.plant_step:g} s")


def verdicts(psi: Psi, how: str = "") -> Iterator[str]:
    """Per network one sentence: does it know Psi, or only follow it? First how to hear that of a user's law."""
    if how:
        yield f"{how[0].upper()}{how[1:]}."
    for half, where in psi.halves.items():
        online = worst(psi.online[where])
        if not psi.frozen:
            why = "its weights are not at hand" if how else "it learns nothing, so no weights are held fixed"
            yield f"{half}: FVU online {number(online)}; {why}."
            continue
        same, other = (
            worst(psi.frozen[name].fvu[where]) if name in psi.frozen else math.nan for name in ("same", "held_out")
        )
        yield f"{half}: {judgement(online, same, other)}"


def judgement(online: float, same: float, other: float) -> str:
    """In words what FVU online, frozen on the run's own trajectory and frozen on a held-out one say together."""
    told = f"FVU online {number(online)}, frozen {number(same)} on the same trajectory"
    told += f", {number(other)} on one held out" if math.isfinite(other) else ""
    if not math.isfinite(online) or not math.isfinite(same):
        return f"{told}: Psi does not vary, there is nothing to judge."
    if same >= 1:
        follows = "it follows Psi by fast adaptation and" if online < 0.5 else "it"
        return f"{told}: {follows} stores no model, a constant would say as much."
    if math.isfinite(other) and other >= 1:
        return f"{told}: it holds what it was trained on, and nothing beyond."
    known = f"knows {share(1 - (other if math.isfinite(other) else same))} of the variance"
    return f"{told}: it {known}{' where it was not trained' if math.isfinite(other) else ''}."


def share(part: float) -> str:
    """A share in percent; never rounded to all of it."""
    return "more than 99.9 %" if 0.999 < part < 1 else f"{100 * part:.3g} %"


def psi_tables(psi: Psi) -> Iterator[str | Table]:
    """FVU online and frozen and shares of the torque, then the online error in windows: a row per component."""
    columns = {"online": psi.online} | {FROZEN[name]: told.fvu for name, told in psi.frozen.items()}
    columns |= {SHARES[part]: values for part, values in psi.shares.items()}
    yield component_table("FVU, then shares of the torque", psi, columns)
    if psi.frozen:
        yield "\n".join(f"{FROZEN[name].replace(chr(10), ' ')}: {told.about}" for name, told in psi.frozen.items())
    if len(psi.errors) <= MOST_WINDOWS:
        edges = zip(psi.edges[:-1], psi.edges[1:], psi.errors, strict=True)
        spans = {f"{a:.3g} to\n{b:.4g} s": values for a, b, values in edges}
        yield component_table("Error online over the run's variance", psi, spans)


def component_table(title: str, psi: Psi, columns: Mapping[str, Array]) -> Table:
    """Columns of one number per component."""
    table = Table(box=SIMPLE_HEAD, padding=0)
    table.add_column(title, overflow="fold", vertical="bottom")
    for head in columns:
        table.add_column("\n".join(f"  {line}" for line in head.split("\n")), justify="right", no_wrap=True)
    for i, label in enumerate(psi.labels):
        table.add_row(label.removesuffix("_joint"), *(number(values[i]) for values in columns.values()))
    return table


def network_table(proof: Proof) -> Table:
    """Ranks, excitation and ideal weights: a column per network."""
    networks = {network.name: network for network in proof.psi.networks}
    first = next(iter(networks.values()))
    table = Table(box=SIMPLE_HEAD, padding=0)
    table.add_column("Networks" if first.what == "activations" else "Learner", overflow="fold")
    for name in networks:
        table.add_column(f"  {name}", justify="right", no_wrap=True)
    for weights in first.ranks:
        cells = (f"{number(n.ranks[weights])} of {len(n.singular[weights])}" for n in networks.values())
        table.add_row(f"effective rank of {weights}", *cells)
    found = [network.excitation for network in networks.values()]
    table.add_row(f"effective rank of the {first.what}", *(f"{number(e.rank)} of {e.units}" for e in found))
    above = f"excited directions (eigenvalue > {first.excitation.visible:g} of the largest)"
    table.add_row(above, *(f"{e.directions} of {e.units}" for e in found))
    table.add_row(f"smallest eigenvalue of the Gram matrix of the {first.what}", *(small(e.smallest) for e in found))
    if any(network.unknown for network in networks.values()):
        shares = ("-" if n.unknown is None else f"{n.unknown.share:.0%}" for n in networks.values())
        table.add_row("left undetermined of what random motion shows", *shares)
        acting = [
            f"{n.unknown.acting} of {n.unknown.units}" for n in networks.values() if n.unknown and n.unknown.units
        ]
        if acting:
            table.add_row("as how many its units act on random motion", *acting)
    if proof.has("ideal"):
        table.add_section()
        if isinstance(proof.ideal, Truth):
            for part, (start, end) in proof.ideal.parts.items():
                cell = f"{number(start)} to {number(end)}"
                table.add_row(f"distance in V from the true parameters, {part}, start to end", cell)
            table.add_row("largest |Psi - Y theta| of the true ones [N, N m]", number(proof.ideal.eps.max()))
            return table
        if isinstance(proof.ideal, LinearFit):
            start, end = proof.ideal.distance
            best = "the true parameters" if proof.ideal.true else "the best fixed weights, fitted offline"
            table.add_row(f"|W*| of {best}", number(proof.ideal.norm))
            cell = f"{number(start)} to {number(end)}"
            table.add_row("its Psi_hat against the run's, over Psi's deviation, start to end", cell)
            table.add_row("eps_N: what W* leaves at most [N, N m]", number(proof.ideal.eps.max()))
            table.add_row("FVU of W* (worst component)", number(proof.ideal.unexplained.max()))
            return table
        ideal = list(proof.ideal.values())
        table.add_row("|Z| learned", *(number(w.learned_norm) for w in ideal))
        table.add_row("|Z*| of the ideal weights, fitted offline", *(number(w.norm) for w in ideal))
        table.add_row("ZB that the robust term counts with", *(number(w.assumed) for w in ideal))
        ends = (f"{number(w.start_distance)} to {number(w.distance)}" for w in ideal)
        table.add_row("|Z* - Z| from start to end", *ends)
        table.add_row("eps_N: what the ideal weights leave at most", *(number(w.eps_N) for w in ideal))
        table.add_row("FVU of the ideal weights (worst component)", *(number(w.unexplained.max()) for w in ideal))
    return table


def lyapunov_sentence(v: Lyapunov, growth: Growth) -> str:
    """V from start to end, and how much of the time it grows."""
    kept = [(words, getattr(v, name)) for name, words in PARTS.items() if getattr(v, name).any()]
    shown = ", ".join(f"{words} {number(part[0])} to {number(part[-1])}" for words, part in kept)
    text = f"Lyapunov function V: {number(v.total[0])} to {number(v.total[-1])} ({shown}). "
    if not growth.samples:
        return f"{text}It falls all the time."
    what = (
        "control periods" if v.every == 1 else f"intervals of {v.period:g} s from one update of the weights to the next"
    )
    return (
        f"{text}It grows in {100 * growth.samples:.0f} % of the {what}, by {number(growth.rise)} in all, and falls by "
        f"{number(growth.fall)}."
    )


def terms_table(growth: Growth) -> Table:
    """What every term adds to V over the run, and how often it is the one that makes it grow."""
    table = Table(box=SIMPLE_HEAD, padding=0)
    for head in ("term", ""):
        table.add_column(head, overflow="fold")
    table.add_column("  adds to V", justify="right", no_wrap=True)
    table.add_column("  leads its growth", justify="right", no_wrap=True)
    largest = max(map(abs, growth.work.values()))
    for name, words in TERMS.items():
        if abs(growth.work[name]) > 1e-9 * largest:
            share = growth.why.get(name, 0.0)
            table.add_row(name, words, signed(growth.work[name]), f"{100 * share:.0f} %" if share else "")
    return table


def spans_sentence(growth: Growth) -> str:
    """The stretches of most growth."""
    told = [f"{s.start:.3g} to {s.end:.3g} s (+{number(s.rise)}, {s.why})" for s in growth.spans]
    return f"Most growth: {'; '.join(told)}.\n" if told else ""


def balance_sentence(found: Balance, integrator: str) -> str:
    """Whether the equality holds, with its worst errors."""
    steps = small(found.steps) if math.isfinite(found.steps) else "not known"
    plant = f"that integrator's error, {small(found.recorded)} between the recorded states, is not in it"
    off = f" The run was simulated by {integrator}: {plant}." if found.recorded > TOLERANCE else ""
    return (
        f"Equality d/dt (s' M s / 2) = s' (Psi - tau + d): {'holds' if found.holds else 'IS VIOLATED'}, checked along "
        f"exact motions from the recorded states. Worst relative errors over {len(found.time):,} of {found.periods:,} "
        f"control periods: model and command {small(found.identity)}, recorded states against the plant's own steps "
        f"{steps} (tolerance {TOLERANCE:g}).{off}"
    )


def signed(value: float) -> str:
    """A number with its sign."""
    return f"{'-' if value < 0 else '+'}{number(abs(value))}"


def small(value: float) -> str:
    """Two digits and an exponent; rounding is told as such."""
    return f"{value:.1e}" if value > 1e-18 else "0"

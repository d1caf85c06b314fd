"""A certificate for a terminal: the verdict in a sentence, its conditions, its bounds beside the run."""

from __future__ import annotations

import math
from collections.abc import Iterator

from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.markup import escape
from rich.table import Table

from ...proof.certificate import Certificate, Condition
from ...proof.certified_run import CertifiedRun
from ...proof.learner import NAMES
from ...proof.rate import Rate
from ...proof.reached import Reached
from ..table import WIDTH, number


def render_certificate(told: CertifiedRun, colour: bool = False, width: int = WIDTH) -> str:
    """The section on the certificate as text of at most `width` columns."""
    console = Console(width=width, force_terminal=colour, color_system="standard" if colour else None)
    with console.capture() as capture:
        console.print()
        console.print("Certificate (docs/theory.md)", style="bold", highlight=False)
        for part in parts(told):
            if isinstance(part, str):
                console.print(part, highlight=False, markup=False)
            else:
                console.print(part)
    return "\n".join(line.rstrip() for line in capture.get().splitlines())


def parts(told: CertifiedRun) -> Iterator[str | Table]:
    """Sentences and tables, in order."""
    if told.certificate is None:
        yield f"Does not apply: {told.missing['certificate'].removeprefix('no certificate: ')}."
    else:
        yield verdict(told.certificate)
        yield condition_table(told.certificate.conditions)
        if told.certificate.holds and told.reached is not None:
            yield bound_table(told.certificate, told.reached)
            yield run_sentence(told.reached)
        yield constant_table(told.certificate)
    if told.rate is not None:
        yield rate_sentence(told.rate)
    if told.printed:
        yield printed_table(told)


def verdict(certificate: Certificate) -> str:
    """Whether a region is certified, and if not, what fails."""
    if certificate.holds:
        return (
            "Holds: from every error in the region, with any weights that the update can reach and any force within d, "
            "the sampled loop never leaves it and ends up in the bound. Sampled constants are the largest over "
            f"{len(certificate.boxes.samples.M)} configurations along the reference."
        )
    failed = [c for c in certificate.conditions if not c.holds]
    told = "; ".join(f"{c.name}: {side(c.value)} is not {c.need} {side(c.limit)}" for c in failed)
    where = "The region asked for is not held" if certificate.asked else "No region was found. At the one nearest to it"
    return f"FAILS. {where}: {told}. That proves nothing against the loop."


def side(value: float) -> str:
    """One side of a condition."""
    if math.isnan(value):
        return "no number"
    if math.isinf(value):
        return "infinity" if value > 0 else "-infinity"
    return f"{'-' if value < 0 else ''}{number(abs(value))}"


def condition_table(conditions: list[Condition]) -> Table:
    """A row per condition."""
    table = Table(box=SIMPLE_HEAD, padding=0)
    table.add_column("condition", no_wrap=True)
    table.add_column("  is", justify="right", no_wrap=True)
    table.add_column("  limit", justify="right", no_wrap=True)
    table.add_column(" ", no_wrap=True)
    table.add_column(" what it says", overflow="fold")
    for c in conditions:
        limit = f"  {'<' if c.need == 'below' else '>'} {side(c.limit)}"
        table.add_row(c.name, side(c.value), limit, " yes" if c.holds else " NO", escape(f" {c.words}"))
    return table


def bound_table(certificate: Certificate, run: Reached) -> Table:
    """Region, ultimate bound, and what the run had at most over its last half, in the units of the errors."""
    table = Table(box=SIMPLE_HEAD, padding=0)
    for head in ("largest", "  region", "  bound", "  run, last half"):
        table.add_column(head, justify="left" if head == "largest" else "right", no_wrap=True)
    region, bound = certificate.region, certificate.bound
    table.add_row(escape("pose, size a [m]"), number(region.box.pose), number(bound.box.pose), number(run.last.pose))
    for name in ("ex", "ey"):
        table.add_row(
            escape(f"  |{name}| [m]"), number(getattr(region.reach, name)), number(getattr(bound.reach, name)), ""
        )
    table.add_row(escape("  |ephi| [rad]"), number(region.reach.heading), number(bound.reach.heading), "")
    names = certificate.boxes.loop.robot.velocity_names
    if len(region.joints):
        table.add_row("arm, size b", number(region.box.arm), number(bound.box.arm), number(run.last.arm))
        for name, *values in zip(names[2:], region.joints, bound.joints, strict=True):
            table.add_row(escape(f"  |e| {name} [rad or m]"), *map(number, values), "")
    table.add_row(
        escape("velocity, s'Ms/2 [J]"), number(region.box.energy), number(bound.box.energy), number(run.last.energy)
    )
    for name, *values in zip(names, region.velocity, bound.velocity, strict=True):
        table.add_row(escape(f"  |s| {name} [SI]"), *map(number, values), "")
    for i, network in certificate.boxes.networks.items():
        for letter, k in (("W", 0), ("V", 1)):
            most = number(getattr(network, letter))
            if getattr(network, letter):
                table.add_row(f"weights |{letter}|, {NAMES[i]}", most, most, number(run.weights[i][k]))
    return table


def run_sentence(run: Reached) -> str:
    """How the run went beside its region."""
    if math.isnan(run.enters):
        return "The run never was inside of the region: nothing is guaranteed of it."
    if not run.covered:
        return "The run's weights are beyond the bounds, from before it was in the region: nothing is guaranteed."
    begins = (
        "starts inside of the region"
        if run.starts
        else f"starts outside of the region, is inside at {run.enters:.3g} s"
    )
    stays = "and stays" if run.stays else "and LEAVES IT: the certificate is violated"
    settled = "not within the run" if math.isnan(run.settles) else f"at {run.settles:.3g} s"
    return f"The run {begins} {stays}; inside of the bound for good {settled}."


def constant_table(certificate: Certificate) -> Table:
    """A row per constant, with its source."""
    table = Table(box=SIMPLE_HEAD, padding=0)
    for head in ("constant", "  value", " unit", " source", " what it is"):
        table.add_column(head, justify="right" if head == "  value" else "left", overflow="fold")
    for c in certificate.constants:
        value = side(c.value) if math.isfinite(c.value) else "none"
        table.add_row(escape(c.name), value, f" {c.unit}", f" {c.source}", f" {c.words}")
    return table


def rate_sentence(rate: Rate) -> str:
    """The condition on the learning rates, in words."""
    left = rate.limit.min()
    room = "more than 10000" if math.isinf(left) else number(left)
    return (
        f"Learning rate (discrete time, linearised): {'stable' if rate.stable else 'UNSTABLE'}; spectral radius of a "
        f"control period {rate.radius.max():.6f}, {rate.without.max():.6f} without the learner; one update is at most "
        f"{100 * rate.share.max():.3g} % of the gain; rates may be {room} times as large; leakage kappa F |s| at most "
        f"{number(rate.leak.max())} per sample, limit 2."
    )


def printed_table(told: CertifiedRun) -> Table:
    """The thesis's own bounds, labelled as what they are."""
    table = Table(box=SIMPLE_HEAD, padding=0, title="The thesis's bounds, as printed: not proved", title_justify="left")
    table.add_column("", no_wrap=True)
    for i in told.printed:
        table.add_column(f"  {NAMES[i]}", justify="right", no_wrap=True)
    rows = list(told.printed.values())
    table.add_row("|z| or |r| at last, (3.59), (3.62)", *(number(one.error) for one in rows))
    table.add_row("  reached over the run's last half", *(number(one.reached) for one in rows))
    table.add_row("  half-width with both braces (gap a)", *(number(one.half_width) for one in rows))
    table.add_row("|Ztilde| at last, (3.60), (3.63)", *(number(one.weights) for one in rows))
    table.add_row("  but V may grow at any |Ztilde|", *("no bound" for _ in rows))
    needs = (f"{side(one.robust)} > {side(one.C[2])}: {'yes' if one.gain_holds else 'NO'}" for one in rows)
    table.add_row("Kz > C2, C5 (3.51), (3.52)", *needs)
    return table

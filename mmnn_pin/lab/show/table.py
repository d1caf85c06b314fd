"""One table that compares the controllers of an experiment, for a terminal."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any

from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.table import Table
from rich.text import Text

from ...recording.metrics import ERRORS, halves
from ...recording.recording import Recording
from ..experiments.controllers import ORACLES
from ..experiments.runner import Result, unfair
from . import verdicts, wheels
from .units import column_units, milli

WIDTH = 100
NOT_ENFORCED = "which this plant does not enforce"
TITLES = {"pose_error": "pose", "z": "velocity", "e": "joint"}
CAPTION = (
    "effort: time integral of the squared motor torques. learned share: RMS of Psi_hat over RMS of the torque. "
    "effective gain: mean of all that multiplies z (base) or r (arm)."
)


def render(result: Result, colour: bool = False, width: int = WIDTH) -> str:
    """The table with what it shows beneath it and its caption, as text of at most `width` columns.

    A comparison that is not fair says so before anything else.
    """
    console = Console(width=width, force_terminal=colour, color_system="standard" if colour else None)
    with console.capture() as capture:
        if warning := unfair(result.experiment, result.metrics):
            console.print(f"{warning[0].upper()}{warning[1:]}", style="bold red", highlight=False)
        console.print(title(result), style="bold", highlight=False)
        for part in (comparison(result), *verdicts_of(result)):
            console.print(part)
        console.print(caption(result), style="italic", highlight=False)
    return "\n".join(line.rstrip() for line in capture.get().splitlines())


def comparison(result: Result) -> Table:
    """Rows: errors, torques of motors with a limit, effort, learned share, gain, outcome. Columns: controllers."""
    table = Table(box=SIMPLE_HEAD, padding=0)
    table.add_column("", overflow="fold")
    table.add_column("", no_wrap=True)
    for name in result.recordings:
        table.add_column(verdicts.heading(name), justify="right", no_wrap=True)
    for group in (errors(result), wheels.rows(result), torques(result), others(result)):
        for row in group:
            table.add_row(*row)
        table.add_section()
    return table


def verdicts_of(result: Result) -> Iterator[Table]:
    """Gain or learning, and the thesis's figures, where the experiment has what it takes."""
    if improvements := result.improvements():
        yield verdicts.shares(improvements, result.experiment.windows[-1])
    if found := result.largest_errors():
        yield verdicts.largest(found)
    if ranges := result.figure_ranges():
        yield verdicts.figures(ranges)


def title(result: Result) -> str:
    """What was run, which variant of it, on what, for how long, from which seed."""
    experiment = result.experiment
    variant = f"variant {experiment.variant}, " if experiment.variant else ""
    variant += "contact plant, " if experiment.plant == "contact" else ""
    about = f"{variant}{experiment.robot}, {experiment.time.duration:g} s, seed {experiment.seed}"
    return f"{experiment.title or result.name} ({about})"


def caption(result: Result) -> str:
    """What the marks and the words of the table mean."""
    oracles = [name for name in result.recordings if name in ORACLES]
    marks = "* best of the row. " if len(result.recordings) - len(oracles) > 1 else ""
    if oracles:
        marks = (
            marks.replace(".", f" but for {oracles[0]}.")
            + f"{oracles[0]} knows the true model: its share in brackets. "
        )
    if any(map(exceeded, limited(result))):
        enforced = result.experiment.actuator.torque_limit is not None
        marks += f"! asked for above the motor's effort limit, {'all that it gives' if enforced else NOT_ENFORCED}. "
    shares = f" {verdicts.ABOUT_SHARES}" if result.improvements() else ""
    outside = " ! outside of its interval." if any(not row["inside"] for row in result.figure_ranges()) else ""
    return marks + CAPTION + shares + outside


def exceeded(row: dict[str, Any]) -> bool:
    """Whether a peak torque is above its motor's effort limit."""
    return any(peak is not None and peak > row["limit"] for peak in row["peak"].values())


def limited(result: Result) -> list[dict[str, Any]]:
    """Peak torques of the motors that have an effort limit, see `Result.torque_limits`."""
    return [row for row in result.torque_limits() if row["limit"] is not None]


def errors(result: Result) -> Iterator[list[str | Text]]:
    """Peak and RMS of every error; the best value of a row is marked."""
    recording = next(iter(result.recordings.values()))
    statistics = {"peak": "peak"} | {f"rms_{a:g}_{b:g}": f"RMS {a:g}-{b:g} s" for a, b in result.experiment.windows}
    for name in ERRORS:
        if name not in recording:
            continue
        for label, unit in zip(recording.labels(name), column_units(recording, name), strict=True):
            first = f"{TITLES[name]} {label} [{milli(unit)}]"
            for key, words in statistics.items():
                values = {c: 1e3 * m[f"{name}.{label}.{key}"] for c, m in result.metrics.items()}
                yield [Text(first), Text(words), *marked(values)]
                first = ""


def marked(values: dict[str, float]) -> list[Text]:
    """Values with a star at the smallest one of the controllers without the true model."""
    fair = [v for c, v in values.items() if c not in ORACLES and math.isfinite(v)]
    best = min(fair) if len(fair) > 1 else None
    cells = []
    for controller, value in values.items():
        wins = value == best and controller not in ORACLES
        cells.append(Text(f"{number(value)} {'*' if wins else ' '}", style="bold" if wins else ""))
    return cells


def torques(result: Result) -> Iterator[list[str | Text]]:
    """Peak torques of motors with an effort limit: all if the experiment asks for it, else of those that exceed it."""
    for row in limited(result):
        limit, cells = row["limit"], []
        for controller in result.recordings:
            peak = row["peak"].get(controller)
            value = math.inf if peak is None else peak
            cells.append(Text(f"{number(value)} {'!' if value > limit else ' '}", style="bold red" * (value > limit)))
        if result.experiment.torque_limits or exceeded(row):
            yield [f"peak torque {row['actuator']}", f"of {number(limit)}", *cells]


def others(result: Result) -> Iterator[list[str | Text]]:
    """Effort, learned share, effective gain and outcome."""
    recording, metrics = next(iter(result.recordings.values())), result.metrics
    yield ["torque effort [N^2 m^2 s]", "", *(f"{number(m['effort'])}  " for m in metrics.values())]
    for part in halves(recording):
        shares = {c: number(m[f"learned_share.{part}"]) for c, m in metrics.items()}
        yield ["learned share", part, *(f"({s}) " if c in ORACLES else f"{s}  " for c, s in shares.items())]
    for part in halves(recording):
        gains = (m[f"effective_gain.{part}"] for m in metrics.values())
        yield ["mean effective gain", part, *(f"{number(gain)}  " for gain in gains)]
    yield ["outcome", "", *(outcome(r) for r in result.recordings.values())]


def outcome(recording: Recording) -> Text:
    """How a run ended, in red unless it was completed."""
    status = recording.outcome.status
    if status == "completed":
        return Text("done  ", style="green")
    return Text(f"{status}\nat {recording.outcome.time:.3g} s", style="bold red")


def number(value: float) -> str:
    """Three significant digits; a dash where there is no number."""
    if not math.isfinite(value):
        return "-"
    if value == 0:
        return "0"
    if not 1e-3 <= abs(value) < 1e5:
        return f"{value:.1e}"
    return f"{value:.{max(0, 2 - math.floor(math.log10(abs(value))))}f}"


def notes(result: Result) -> list[str]:
    """What the user should know: how runs ended, what their weights show, and notes on the settings."""
    found = [
        message if message.startswith(controller) else f"{controller}: {message}"
        for controller, recording in result.recordings.items()
        if (message := recording.outcome.message)
    ]
    return [*found, *result.notes]

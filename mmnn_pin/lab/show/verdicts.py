"""What the table says beneath its numbers: gain or learning, and whether the thesis's figures are met."""

from __future__ import annotations

from collections.abc import Mapping
from itertools import groupby
from typing import Any

from rich.box import SIMPLE_HEAD
from rich.table import Table
from rich.text import Text

from ..experiments.runner import Improvement

SIGNALS = {"pose_error": "pose", "z": "velocity", "e": "joint"}
ABOUT_SHARES = (
    "better than pd = gain + learning: how much smaller the RMS error is, in % of pd's. gain: from pd to pd at the "
    "learner's effective gain. learning: from there to the learner. shares: of the improvement, gain : learning."
)

ABOUT_LARGEST = "largest error: of the whole run, as measured, as in the thesis; its numbers beside ours."


def shares(improvements: Mapping[str, Mapping[str, Improvement]], window: tuple[float, float]) -> Table:
    """Per error and learner: the improvement over PD, in % of PD's RMS, and the shares of gain and of learning."""
    table = Table(box=SIMPLE_HEAD, padding=0)
    names = {learner: heading(learner) for learner in improvements}
    lines = max(name.count("\n") for name in names.values()) + 1
    table.add_column("\n" * lines + f"RMS {window[0]:g}-{window[1]:g} s", no_wrap=True)
    for name in names.values():
        above = "\n" * (lines - 1 - name.count("\n"))
        heads = (f"{above}{name}\nbetter", *("\n" * lines + head for head in ("= gain", "+ learning", "shares")))
        for head in heads:
            table.add_column(head, justify="right", no_wrap=True)
    for row in next(iter(improvements.values())):
        signal, _, label = row.partition(".")
        cells = [cell for rows in improvements.values() for cell in parts(rows[row])]
        table.add_row(f"{SIGNALS[signal]} {label}", *cells)
    return table


def heading(controller: str, width: int = 9) -> str:
    """Name of a controller in lines of at most `width` letters, where its words allow."""
    lines = [""]
    for word in controller.split("_"):
        longer = f"{lines[-1]}_{word}" if lines[-1] else word
        lines = [*lines[:-1], longer] if len(longer) <= width or not lines[-1] else [*lines, word]
    return "\n".join(lines)


def parts(improvement: Improvement) -> tuple[str, str, str, str]:
    """Improvement, gain and learning in % of PD's RMS, and the shares; dashes where there is nothing to share."""
    numbers = [improvement.total, improvement.gain, improvement.learning]
    total, gain, learning = (f"{100 * v / improvement.pd:.1f}" if improvement.pd > 0 else "-" for v in numbers)
    share = improvement.learning_share
    ratio = "-" if share is None else f"{100 - 100 * share:.0f} : {100 * share:.0f}"
    return total, gain, learning, f"  {ratio}"


def figures(ranges: list[dict[str, Any]]) -> Table:
    """Smallest and largest value of every plot of the thesis's figures, each with the interval that its axis leaves."""
    met = sum(row["inside"] for row in ranges)
    table = Table(box=SIMPLE_HEAD, padding=0)
    table.add_column(f"{met} of {len(ranges)} intervals of the figures met", overflow="fold")
    unit = "deg" if all(row["unit"] == "deg" for row in ranges) else "SI"
    for head in (f"min [{unit}]", "in", f"max [{unit}]", "in"):
        table.add_column(Text(head), justify="right", no_wrap=True)
    for (figure, curve), rows in groupby(ranges, lambda row: (row["figure"], row["curve"])):
        by_name = {row["statistic"]: row for row in rows}
        cells = [cell for name in ("min", "max") if name in by_name for cell in beside(by_name[name])]
        table.add_row(f"{figure}  {curve.partition(' (')[0]}", *cells)
    return table


def largest(found: Mapping[str, Any]) -> Table:
    """Largest error of every joint and controller beside the thesis's, and as a share of one_layer's."""
    table = Table(box=SIMPLE_HEAD, padding=0)
    table.add_column("largest error\nthat encoders saw [deg]", no_wrap=True)
    errors, ratios = found["largest_errors_deg"], found["largest_error_ratios"]
    joints = range(len(next(iter(errors.values()), ())))
    for j in joints:
        table.add_column(f"joint {j + 1}", justify="right", no_wrap=True)
        table.add_column("\n thesis", justify="right", no_wrap=True)
    for j in joints:
        table.add_column(f"/ one_layer\njoint {j + 1}", justify="right", no_wrap=True)
        table.add_column("\n thesis", justify="right", no_wrap=True)
    for name, values in errors.items():
        layers = name.removesuffix("_zero").removesuffix("_random")
        printed = found["thesis_largest_errors_deg"].get(layers)
        cells = [text for j in joints for text in (f"  {values[j]:.4f}", f"{printed[j]:.4f}" if printed else "")]
        shares = ratios.get(name)
        two = found["thesis_largest_error_ratios"] if layers == "two_layer" else None
        cells += [
            text
            for j in joints
            for text in (f"{shares[j]:.3f}" if shares else "", f"{two[j]:.3f}" if two and shares else "")
        ]
        table.add_row(name, *cells)
    return table


def beside(row: dict[str, Any]) -> tuple[Text, str]:
    """A value, marked where it is outside, and its interval."""
    value = "-" if row["value"] is None else f"{row['value']:.4f}"
    style = "" if row["inside"] else "bold red"
    return Text(f"  {value} {' ' if row['inside'] else '!'}", style=style), f"  {row['lower']:g} to {row['upper']:g}"

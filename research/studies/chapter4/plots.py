"""The study's own figures: intervals met, what the figures determine, and the test of the claim."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from mmnn_pin.lab.show.figure import Look, add_legend, new_figure, styled
from research.studies.search import Number

from .claim import Row
from .draws import REFERENCES
from .unstated import MOUNT
from .verdict import JUDGED, across

if TYPE_CHECKING:
    from matplotlib.figure import Figure

COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7")  # Okabe and Ito
DASHES = ((0, ()), (0, (5, 1.6)), (0, (6, 1.5, 1, 1.5)), (0, (1, 1.2)))
MARKS = ("o", "s", "D", "^", "v")
REACH = 2.6  # widths of an interval that are shown on each side


@styled
def intervals_figure(found: Mapping[str, Sequence[Mapping[str, Any]]]) -> Figure:
    """Where every extreme lies relative to its interval, a mark per variant or fit.

    Args:
        found: Label to its twelve intervals with `figure`, `curve`, `statistic`, `lower`, `upper`, `value`.
    """
    figure = new_figure(7.2, 4.4)
    axes = figure.subplots()
    axes.axvspan(0, 1, color="0.87", linewidth=0)
    first = next(iter(found.values()))
    names = [f"{row['figure']}, {quantity(row['curve'])}, {row['statistic']}" for row in first]
    looks: list[tuple[str, Look]] = []
    for i, (label, rows) in enumerate(found.items()):
        look: Look = {"marker": MARKS[i], "color": (*COLOURS, "#000000")[i], "markersize": 5, "linestyle": "none"}
        looks.append((label, look))
        offset = 0.16 * (i - (len(found) - 1) / 2)
        where = [(row["value"] - row["lower"]) / (row["upper"] - row["lower"]) for row in rows]
        shown = np.clip(where, -REACH, 1 + REACH)
        axes.plot(shown, np.arange(len(rows)) + offset, **look)
        for k, (at, there) in enumerate(zip(where, shown, strict=True)):
            if at != there:
                right = at > there
                axes.annotate(
                    f"{at:.0f}",
                    (there, k + offset),
                    xytext=(4 if right else -4, 0),
                    textcoords="offset points",
                    va="center",
                    ha="left" if right else "right",
                    fontsize=7,
                )
    axes.set_yticks(np.arange(len(names)), names)
    axes.invert_yaxis()
    axes.set_xlim(-REACH - 0.5, 1 + REACH + 0.5)
    axes.set_xlabel("place relative to the thesis's tick interval (grey), in its widths")
    add_legend(figure, "Extremes of figures 4.2 to 4.4", looks)
    return figure


def quantity(curve: str) -> str:
    """Short name of a curve."""
    return curve.split(" (")[0].replace("platform pose error", "pose error")


@styled
def flatness_figure(numbers: Sequence[Mapping[str, Any]], ranges: Mapping[str, Number], enough: int) -> Figure:
    """Per number the stretch that keeps enough intervals met: moved alone, and with all others moving too."""
    bar: Look = {"solid_capstyle": "butt", "linewidth": 9}
    whole, together, alone, best = looks = {
        "range searched": {**bar, "color": "0.85", "zorder": 1},
        f"{enough} met, all others free (middle 90 %)": {**bar, "color": "#56B4E9", "zorder": 2},
        f"{enough} met, moved alone": {**bar, "color": "#0072B2", "linewidth": 3, "zorder": 3},
        "best": {"color": "black", "marker": "o", "markersize": 5, "linestyle": "none", "zorder": 4},
    }
    figure = new_figure(7.2, 4.4)
    axes = figure.subplots()
    for i, row in enumerate(numbers):
        place = ranges[row["name"]].place
        axes.plot([0, 1], [i, i], **looks[whole])
        axes.plot([place(v) for v in row["together"]], [i, i], **looks[together])
        axes.plot([place(v) for v in row["alone"]], [i, i], **looks[alone])
        axes.plot(place(row["best"]), i, **looks[best])
        for x, value, side in ((0, row["range"][0], "right"), (1, row["range"][1], "left")):
            axes.annotate(
                f"{value:g}",
                (x, i),
                xytext=(-4 if side == "right" else 4, 0),
                textcoords="offset points",
                ha=side,
                va="center",
                fontsize=7.5,
                color="0.35",
            )
    axes.set_yticks(
        range(len(numbers)), [f"{row['name']} [{row['unit']}]" if row["unit"] else row["name"] for row in numbers]
    )
    axes.invert_yaxis()
    axes.set_xticks([])
    axes.set_xlim(-0.1, 1.1)
    axes.grid(False)
    axes.tick_params(length=0)
    axes.spines[["bottom", "left"]].set_visible(False)
    add_legend(figure, "What the figures determine", list(looks.items()))
    return figure


@styled
def claim_figure(rows: Sequence[Row]) -> Figure:
    """Share of the comparisons in which the ratio two-layer to one-layer is below a value, per motion and part."""
    figure = new_figure(7.2, 5.6)
    conditions = list(dict.fromkeys(row["condition"] for row in rows))
    grid = figure.subplots(len(conditions), len(JUDGED), sharex=True, sharey=True, squeeze=False)
    looks: dict[str, Look] = {
        name: {"color": colour, "linestyle": dash}
        for name, colour, dash in zip(REFERENCES, COLOURS, DASHES, strict=True)
    }
    for line, condition in zip(grid, conditions, strict=True):
        for axes, part in zip(line, JUDGED, strict=True):
            axes.set_title(f"{part}, {RATES[condition]}", loc="left")
            axes.axvline(1, color="0.4", linewidth=1)
            axes.axhline(0.5, color="0.75", linewidth=0.8)
            for reference, look in looks.items():
                mine = [row for row in rows if row["condition"] == condition and row["reference"] == reference]
                two, one = across(mine, part, "tracking")
                with np.errstate(all="ignore"):
                    ratio = (two / one).ravel()
                known = np.sort(ratio[~np.isnan(ratio)])
                axes.step(np.clip(known, 1e-3, 1e3), np.arange(1, len(known) + 1) / len(known), where="post", **look)
    grid[0][0].set(xscale="log", xlim=(0.02, 20), ylim=(0, 1))
    grid[0][0].set_xticks([0.1, 1, 10], ["0.1", "1", "10"])
    grid[0][0].minorticks_off()
    grid[-1][1].set_xlabel("RMS error, two-layer / one-layer (left of 1 the two-layer network is better)")
    for line in grid:
        line[0].set_ylabel("share of the comparisons")
    add_legend(figure, "The claim, at equal feedback gains", list(looks.items()))
    return figure


RATES = {"thesis": "the thesis's rates", "tuned": "both tuned"}


def ranges_of(numbers: Sequence[Mapping[str, Any]]) -> dict[str, Number]:
    """Numbers by name, the mount among them, from JSON."""
    return {number["name"]: Number(**number) for number in numbers} | {MOUNT.name: MOUNT}

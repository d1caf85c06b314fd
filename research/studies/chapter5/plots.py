"""The study's own figure: what every number of the rig does to every controller."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from mmnn_pin.lab.show.figure import STYLES, Look, add_legend, new_figure, styled

from .compare import MEASURES, MOVED, NAMES, SCALE

if TYPE_CHECKING:
    from matplotlib.figure import Figure

INTEGRAL: Look = {"color": "#009E73", "linestyle": (0, (1, 1)), "linewidth": 1.6, "zorder": 2.2}
LABELS = {"largest": "largest error [deg]", "rms": "RMS error from 2 s [deg]"}
TICKS = {"largest": (0.1, 0.2, 0.5, 1.0, 2.0, 4.0), "rms": (0.1, 0.2, 0.5, 1.0, 2.0, 4.0)}  # [deg]


def look_of(controller: str) -> Look:
    """How a controller's curve looks."""
    return STYLES[controller].line if controller in STYLES else INTEGRAL


@styled
def sweep_figure(swept: Mapping[str, Sequence[Mapping[str, Any]]]) -> Figure:
    """Median error of every controller over one number of the rig; bars hold the middle 90 % of the repeats."""
    figure = new_figure(10.0, 5.2)
    grid = figure.subplots(len(MEASURES), len(MOVED), sharey="row", sharex="col", squeeze=False)
    for column, (name, (words, _)) in enumerate(MOVED.items()):
        x = np.array([point["value"] for point in swept[name]]) * SCALE.get(name, 1.0)
        grid[-1][column].set_xlabel(words)
        grid[0][column].set_xscale("log" if name in ("resolution", "rate") else "linear")
        grid[0][column].set_xticks(x, [f"{each:g}" for each in np.round(x, 9)])
        for line, measure in zip(grid, MEASURES, strict=True):
            for controller in NAMES:
                found = [point["errors"][measure][controller] for point in swept[name]]
                median, low, high = (
                    np.array([np.nan if value is None else value for value in values], float)
                    for values in zip(*((each["median"], *each["middle_90"]) for each in found), strict=True)
                )
                look = look_of(controller)
                line[column].plot(x, median, **look, marker="o", markersize=3)
                line[column].vlines(x, low, high, color=look["color"], linewidth=0.8, alpha=0.6)
            line[column].set(yscale="log")
    for line, measure in zip(grid, MEASURES, strict=True):
        line[0].set_ylabel(LABELS[measure])
        line[0].set_yticks(TICKS[measure], [f"{tick:g}" for tick in TICKS[measure]])
        line[0].set_ylim(TICKS[measure][0], TICKS[measure][-1])
        for axes in line:
            axes.minorticks_off()
    looks = [(name, look_of(name)) for name in NAMES]
    add_legend(figure, "The calibrated rig, one number moved at a time", looks)
    return figure

"""Recordings over each other in columns of panels with one time axis."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np

from ...recording.recording import Recording
from .figure import (
    Look,
    add_legend,
    legend_label,
    limits,
    mark_end,
    new_figure,
    plain,
    require_found,
    scale_rows,
    styles_of,
)
from .panels import Panel
from .rig_marks import shade_stops

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

PANELS_PER_COLUMN = 4


def overlay(
    title: str,
    recordings: Mapping[str, Recording],
    columns: Sequence[tuple[str, list[Panel]]],
    drawstyle: str = "default",
    more: Sequence[tuple[str, Look]] = (),
) -> Figure:
    """All recordings in every panel; a column's panels share its height and its time axis; `more` is in the legend."""
    columns = [(heading, panels) for heading, panels in columns if panels]
    require_found(recordings, columns, title.lower())
    rows = max(len(panels) for _, panels in columns)
    figure = new_figure(3.6 * len(columns) + 0.4, 1.75 * max(rows, 2) + 1.1)
    styles = styles_of(recordings)
    grid = figure.add_gridspec(1, len(columns))
    for i, (heading, panels) in enumerate(columns):
        stack = grid[i].subgridspec(len(panels), 1).subplots(sharex=True, squeeze=False)[:, 0]
        stack[0].set_title(heading)
        stack[-1].set_xlabel("time [s]")
        for axes, panel in zip(stack, panels, strict=True):
            draw_panel(axes, panel, recordings, drawstyle)
        figure.align_ylabels(list(stack))
    looks = [(legend_label(name, rec), styles[name].line) for name, rec in recordings.items()]
    add_legend(figure, title, [*looks, *more, *shade_stops(figure.axes, recordings)])
    return figure


def columns_of(heading: str, panels: list[Panel]) -> list[tuple[str, list[Panel]]]:
    """Panels in as few columns as possible, of nearly equal length; the first has the heading."""
    count = -(-len(panels) // PANELS_PER_COLUMN)
    parts = np.array_split(np.arange(len(panels)), max(count, 1))
    return [(heading if i == 0 else " ", [panels[k] for k in part]) for i, part in enumerate(parts)]


def draw_panel(axes: Axes, panel: Panel, recordings: Mapping[str, Recording], drawstyle: str) -> None:
    """Every recording's curve in one panel, and the marks where they end above all curves."""
    styles = styles_of(recordings)
    axes.axhline(0.0, color="0.75", linewidth=0.8, zorder=1)
    axes.set_ylabel(plain(f"{panel.title} [{panel.unit}]"))
    axes.set_ylim(limits(panel.values(*item) for item in scale_rows(recordings.values())))
    for name, recording in recordings.items():
        draw_curve(axes, panel, recording, {**styles[name].line, "drawstyle": drawstyle})
    for name, recording in recordings.items():
        if len(values := panel.values(recording)):
            mark_end(axes, recording, styles[name], recording.time, values)


def draw_curve(axes: Axes, panel: Panel, recording: Recording, look: Look) -> None:
    """A panel's column of one recording, if it has it."""
    if len(values := panel.values(recording)):
        axes.plot(recording.time, values, **look)

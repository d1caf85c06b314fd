"""Figures that look inside a run: norms of the weights, residuals, times of the steps."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING

import numpy as np

from ...errors import RecordingError
from ...recording.recording import Recording
from ...signals import Array
from .figure import (
    add_legend,
    legend_label,
    limits,
    mark_end,
    new_figure,
    require_found,
    scale_rows,
    styled,
    styles_of,
)

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

Recordings = Mapping[str, Recording]
Curves = Mapping[str, tuple[Array, Array]]  # run to times and values

NETWORKS = ("base", "arm")
RESIDUALS = {
    "constraint_residual": ("wheels' constraint [mm/s]", 1e3),
    "energy_residual": ("energy balance [mJ]", 1e3),
}


@styled
def weights_figure(recordings: Recordings) -> Figure:
    """Frobenius norms of all weights of the base's and of the arm's network.

    Raises:
        RecordingError: No recording of a controller with weights.
    """
    panels = {}
    for column, network in enumerate(NETWORKS):
        kept = {n: (r.time, r["weight_norm"][:, column]) for n, r in recordings.items() if "weight_norm" in r}
        panels[rf"$\Vert Z\Vert_F$ of the {network}'s network"] = {n: c for n, c in kept.items() if c[1].any()}
    return stacked("Norms of the weights", recordings, panels)


@styled
def residuals_figure(recordings: Recordings) -> Figure:
    """What should be zero: motion that the wheels forbid (contact plant), and energy that came from nowhere.

    Raises:
        RecordingError: No recording that holds one of them.
    """
    panels = {
        label: {n: (r.time, scale * r[signal]) for n, r in recordings.items() if signal in r}
        for signal, (label, scale) in RESIDUALS.items()
    }
    return stacked("Residuals", recordings, panels)


@styled
def step_times_figure(recordings: Recordings) -> Figure:
    """Histogram of the wall-clock time from measurement to torque.

    Raises:
        RecordingError: No recording in which it was measured: the compiled loop does not.
    """
    times = {name: 1e6 * recording.step_times for name, recording in recordings.items()}
    times = {name: values[values > 0] for name, values in times.items() if (values > 0).any()}
    if not times:
        why = "the compiled loop does not measure its steps"
        raise RecordingError("nothing to plot for step times", why=why, fix="run with engine = 'ordinary'")
    styles = styles_of(recordings)
    figure = new_figure(7.5, 4.0)
    axes = figure.subplots()
    edges = np.geomspace(min(v.min() for v in times.values()), 1.001 * max(v.max() for v in times.values()), 60)
    for name, values in times.items():
        axes.hist(values, edges.tolist(), histtype="step", **styles[name].line)
    axes.set(xscale="log", xlabel="time from measurement to torque [\u00b5s]", ylabel="steps")
    add_legend(figure, "Times of the steps", [(legend_label(n, recordings[n]), styles[n].line) for n in times])
    return figure


MONITORS: Mapping[str, Callable[[Recordings], Figure]] = {
    "weights": weights_figure,
    "residuals": residuals_figure,
    "step-times": step_times_figure,
}


def stacked(title: str, recordings: Recordings, panels: Mapping[str, Curves]) -> Figure:
    """Panels above each other on one time axis; one that no run has a curve for is left out.

    Raises:
        RecordingError: All are.
    """
    panels = {label: curves for label, curves in panels.items() if curves}
    require_found(recordings, panels, title.lower())
    figure = new_figure(7.5, 2.3 * len(panels) + 1.2)
    stack = figure.subplots(len(panels), 1, sharex=True, squeeze=False)[:, 0]
    stack[-1].set_xlabel("time [s]")
    for axes, (label, curves) in zip(stack, panels.items(), strict=True):
        axes.set_ylabel(label)
        draw(axes, recordings, curves)
    figure.align_ylabels(list(stack))
    styles, drawn = styles_of(recordings), {name for curves in panels.values() for name in curves}
    looks = [(legend_label(n, r), styles[n].line) for n, r in recordings.items() if n in drawn]
    add_legend(figure, title, looks)
    return figure


def draw(axes: Axes, recordings: Recordings, curves: Curves) -> None:
    """Curves of one panel; a diverged one does not set its scale."""
    styles, calm = styles_of(recordings), scale_rows(recordings[name] for name in curves)
    until = {id(recording): recording.time[rows][-1] for recording, rows in calm}
    shown = [v[t <= until[id(recordings[n])]] for n, (t, v) in curves.items() if id(recordings[n]) in until]
    axes.axhline(0.0, color="0.75", linewidth=0.8, zorder=1)
    axes.set_ylim(limits(shown))
    for name, (time, values) in curves.items():
        axes.plot(time, values, **styles[name].line)
    for name, (time, values) in curves.items():
        mark_end(axes, recordings[name], styles[name], time, values)

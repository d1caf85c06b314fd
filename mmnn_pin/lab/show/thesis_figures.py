"""Figures 4.2 to 4.4 and 5.3 to 5.5 in the thesis's arrangement, over bands in which the extremes of its curves lie.

The thesis's curves are lost; its axes leave an interval for each extreme (`thesis.figure_ranges`). A ring marks
the largest and the smallest value drawn: it should lie in its band.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np

from ...errors import RecordingError
from ...recording.recording import Recording
from ...signals import Array
from ..experiments.thesis import FigureRange, figure_intervals
from .curves import Recordings
from .figure import (
    TRUTH,
    Look,
    add_legend,
    figure,
    limits,
    mark_end,
    new_figure,
    scale_rows,
    style_looks,
    styles_of_controllers,
)

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

DrawnCurve = tuple[str, Recording, int, Look]  # controller, recording, column, look

BAND: Look = {"facecolor": "0.87", "linewidth": 0, "zorder": 0.5}
COMPONENTS: dict[str, Look] = {
    "x": {"linestyle": "-", "linewidth": 1.8},
    "y": {"linestyle": (0, (5, 1.6)), "linewidth": 1.4},
    "heading": {"linestyle": (0, (1, 1.4)), "linewidth": 1.8},
}


@figure("figure-4.2")
def pose_figure(recordings: Recordings) -> Figure:
    """Figure 4.2: pose error (x, y, heading) with the one-layer network above, with the two-layer network below.

    Raises:
        RecordingError: Not one recording of each learner, or none of a robot with a base.
    """
    learners = learners_of(recordings, "pose_error")
    styles = styles_of_controllers(learners)
    panels = {
        f"{name}: pose error\n[mm, mrad]": [
            (name, recording, column, {**look, "color": styles[name].color, "zorder": 2 + 0.1 * column})
            for column, look in enumerate(COMPONENTS.values())
        ]
        for name, recording in learners.items()
    }
    legend = [(label, {**look, "color": "0.2"}) for label, look in COMPONENTS.items()]
    return arrange("4.2", "pose error of the platform", learners, "pose_error", panels, legend)


@figure("figure-4.3")
def velocity_figure(recordings: Recordings) -> Figure:
    """Figure 4.3: velocity error z1 above and z2 below, both learners in each; errors as in `pose_figure`."""
    return compare_learners("4.3", "velocity error of the platform", recordings, "z", ("z1 [mm/s]", "z2 [mrad/s]"))


@figure("figure-4.4")
def arm_figure(recordings: Recordings) -> Figure:
    """Figure 4.4: arm error e1 above and e2 below, both learners in each; errors as in `pose_figure`."""
    return compare_learners("4.4", "error of the arm", recordings, "e", ("e1 [mrad]", "e2 [mrad]"))


@figure("figure-5.3")
def one_layer_figure(recordings: Recordings) -> Figure:
    """Figure 5.3: measured angle of joint 1 above, of joint 2 below, over the reference, under the one-layer network.

    Raises:
        RecordingError: Not one recording of the one-layer controller.
    """
    return show_angles("5.3", "the one-layer network's joints", recordings, ("one_layer",))


@figure("figure-5.4")
def two_layer_figure(recordings: Recordings) -> Figure:
    """Figure 5.4: the same under the two-layer network, that with weights from zero where it was run, as the thesis's.

    Raises:
        RecordingError: Not one recording of a two-layer controller.
    """
    return show_angles("5.4", "the two-layer network's joints", recordings, (two_layer_of(recordings),))


@figure("figure-5.5")
def joints_figure(recordings: Recordings) -> Figure:
    """Figure 5.5: measured error of joint 1 above and of joint 2 below, both learners in each.

    Raises:
        RecordingError: Not one recording of each learner.
    """
    names = ("one_layer", two_layer_of(recordings))
    return compare_learners("5.5", "error of the joints", recordings, "e", ("joint 1 [deg]", "joint 2 [deg]"), names)


def two_layer_of(recordings: Recordings) -> str:
    """Name of the two-layer controller that a figure of chapter 5 shows."""
    run = {recording.meta.get("controller", name) for name, recording in recordings.items()}
    return "two_layer_zero" if "two_layer_zero" in run else "two_layer"


def learners_of(
    recordings: Recordings, signal: str, learners: Sequence[str] = ("one_layer", "two_layer")
) -> dict[str, Recording]:
    """The recording of each learner, in this order; by default of the one-layer and of the two-layer controller.

    Raises:
        RecordingError: None or several of one, or one without the signal.
    """
    found = {}
    for learner in learners:
        runs = [rec for name, rec in recordings.items() if rec.meta.get("controller", name) == learner]
        runs = [rec for rec in runs if signal in rec and len(rec)]
        if len(runs) != 1:
            why = f"the thesis's figures take one run of {learner} with the signal {signal}; there are {len(runs)}"
            raise RecordingError("nothing to plot", why=why, fix="name the folder of one `mmnn run`")
        found[learner] = runs[0]
    return found


def compare_learners(
    number: str,
    what: str,
    recordings: Recordings,
    signal: str,
    labels: Sequence[str],
    names: Sequence[str] = ("one_layer", "two_layer"),
) -> Figure:
    """A plot per component, both learners in each."""
    learners = learners_of(recordings, signal, names)
    styles = styles_of_controllers(learners)
    panels = {label: [(n, r, k, styles[n].line) for n, r in learners.items()] for k, label in enumerate(labels)}
    return arrange(number, what, learners, signal, panels, style_looks(learners, styles))


def show_angles(number: str, what: str, recordings: Recordings, names: Sequence[str]) -> Figure:
    """A plot per joint, its measured angle over its reference."""
    learners = learners_of(recordings, "q", names)
    styles = styles_of_controllers(learners)
    panels = {f"joint {k + 1} [deg]": [(n, r, k, styles[n].line) for n, r in learners.items()] for k in range(2)}
    legend = [("reference", TRUTH), *style_looks(learners, styles)]
    return arrange(number, what, learners, "q", panels, legend, "q_ref")


def arrange(
    number: str,
    what: str,
    learners: Recordings,
    signal: str,
    panels: Mapping[str, Sequence[DrawnCurve]],
    legend: Sequence[tuple[str, Look]],
    reference: str = "",
) -> Figure:
    """Two plots above each other, as the thesis has them, on the bands of its axes; beneath it all a reference."""
    picture = new_figure(7.2, 6.4)
    stack = picture.subplots(2, 1, sharex=True)
    stack[-1].set_xlabel("time [s]")
    for axes, place, (label, curves) in zip(stack, ("top", "bottom"), panels.items(), strict=True):
        ranges = [known for known in figure_intervals(int(number[0])) if known.figure == f"{number} {place}"]
        axes.set_ylabel(label)
        axes.axhline(0.0, color="0.55", linewidth=0.8, zorder=1)
        for known in ranges:
            axes.axhspan(*shown(np.array([known.lower, known.upper]) / known.scale, ranges), **BAND)
        for _, recording, column, _ in curves if reference else ():
            axes.plot(recording.time, shown(recording[reference][:, column], ranges), **TRUTH)
        draw_curves(axes, signal, curves, ranges)
    picture.align_ylabels(list(stack))
    band = {"color": BAND["facecolor"], "linewidth": 7, "solid_capstyle": "butt"}
    title = f"Figure {number}: {what}{variant_of(learners)}"
    add_legend(picture, title, [*legend, ("thesis's extremes", band)])
    return picture


def draw_curves(axes: Axes, signal: str, curves: Sequence[DrawnCurve], ranges: Sequence[FigureRange]) -> None:
    """Curves, rings at their common extremes, crosses where a run ended early."""
    seen = [rec[signal][rows, column] for _, each, column, _ in curves for rec, rows in scale_rows([each])]
    edges = np.array([edge / known.scale for known in ranges for edge in (known.lower, known.upper)])
    axes.set_ylim(limits([shown(values, ranges) for values in (*seen, edges)]))
    for _, recording, column, look in curves:
        axes.plot(recording.time, shown(recording[signal][:, column], ranges), **look)
    for statistic in sorted({known.statistic for known in ranges}):
        mark_extreme(axes, signal, curves, ranges, np.nanargmax if statistic == "max" else np.nanargmin)
    styles = styles_of_controllers([name for name, *_ in curves])
    for name, recording, column, _ in curves:
        mark_end(axes, recording, styles[name], recording.time, shown(recording[signal][:, column], ranges))


def shown(values: Array, ranges: Sequence[FigureRange]) -> Array:
    """Values in SI in the unit of a plot: degrees where its intervals are in degrees, else thousandths."""
    return (180.0 / np.pi if any(known.unit == "deg" for known in ranges) else 1e3) * values


def mark_extreme(
    axes: Axes,
    signal: str,
    curves: Sequence[DrawnCurve],
    ranges: Sequence[FigureRange],
    place: Callable[[Array], np.intp],
) -> None:
    """Ring at the extreme of all curves of a plot."""
    values = [shown(recording[signal][:, column], ranges) for _, recording, column, _ in curves]
    which = int(place(np.array([each[place(each)] for each in values])))
    k = int(place(values[which]))
    ring: Look = {"marker": "o", "markersize": 7, "markerfacecolor": "none", "markeredgewidth": 1.3, "zorder": 5}
    axes.plot(curves[which][1].time[k], values[which][k], color=curves[which][3]["color"], clip_on=False, **ring)


def variant_of(recordings: Recordings) -> str:
    """` (variant NAME)` as the recordings' config says; nothing if it says none or they differ."""
    configs = [recording.config_text for recording in recordings.values()]
    names = {json.loads(text).get("variant", "") if text else "" for text in configs}
    return f" (variant {names.pop()})" if len(names) == 1 and names != {""} else ""

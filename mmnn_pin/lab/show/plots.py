"""Pictures of one or more recordings of the same task, over each other.

A curve that ends early ends in a cross; a diverged one does not set the scale of the others. What most pictures show
comes from `curves`, as in the report.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np

from ...errors import RecordingError
from ...recording.recording import Recording, as_columns, guided_pose
from ...safety import STOPPING
from ...signals import Array
from ..experiments.controllers import effective
from . import curves
from .curves import Curves, Panel, Recordings, controller_of
from .figure import (
    TRUTH,
    Look,
    add_legend,
    figure,
    folded,
    legend_label,
    limits,
    mark_end,
    new_figure,
    plain,
    require_found,
    scale_rows,
    signals,
    style_looks,
    styles_of,
)

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

STACKED = ("hand", "force", "weights", "residuals")  # charts whose panels stand above each other, without more
PANELS_PER_COLUMN = 4
LEARNERS_BESIDE = 5
NOTE_ROOM = 0.2  # share of an axes' height that is free above the curves for a note
GIVEN: Look = {"linewidth": 0.8, "alpha": 0.65}
STOP: Look = {"color": "#d62728", "alpha": 0.12}


@figure("errors", needs=signals("pose_error", "z", "e"))
def errors_figure(recordings: Recordings) -> Figure:
    """True tracking errors over time: pose in the base frame, velocity `z` (3.6), arm `e` (3.10).

    Raises:
        RecordingError: No recording, or none that holds these signals.
    """
    groups = {"pose": "Pose error, in the base frame", "velocity": "Velocity error z", "joint": "Arm error e"}
    return overlay("Tracking errors", recordings, columns_of(groups, curves.errors(recordings)))


@figure("torque", needs=signals("torque", "motor_torque"))
def torque_figure(recordings: Recordings) -> Figure:
    """Generalized force on the base and torques of the motors, these with `meta["effort_limits"]` if it is there.

    Beside what was commanded, thin, what imperfect motors gave.

    Raises:
        RecordingError: No recording, or none that holds these signals.
    """
    groups = {"base": "Force on the base", "arm": "Arm", "motors": "Motors"}
    columns = columns_of(groups, curves.torques(recordings))
    imperfect = {
        n: r for n, r in recordings.items() if "applied" in r and not np.array_equal(r["applied"], r["motor_torque"])
    }
    more = [("given by the motors", {"color": "0.3", **GIVEN})] if imperfect else []
    picture = overlay("Torques", recordings, columns, more)
    styles = styles_of(recordings)
    for axes, panel in zip(picture.axes, (panel for _, column in columns for panel in column), strict=True):
        if panel.group != "motors":
            continue
        for name, recording in imperfect.items():
            if panel.label in (labels := recording.labels("applied")):
                given = as_columns(recording["applied"])[:, labels.index(panel.label)]
                axes.plot(recording.time, given, color=styles[name].color, drawstyle="steps-post", zorder=2.5, **GIVEN)
        if np.isfinite(panel.limit):
            draw_effort_limit(axes, panel.limit, panel.unit)
    return picture


def draw_effort_limit(axes: Axes, limit: float, unit: str) -> None:
    """Lines at an actuator's limits if the curves come near, else a note of it above them."""
    lower, upper = axes.get_ylim()
    if max(-lower, upper) < 0.5 * limit:
        axes.set_ylim(lower, upper + NOTE_ROOM * (upper - lower))
        place: Look = {"transform": axes.transAxes, "ha": "right", "va": "top"}
        axes.text(0.99, 0.98, rf"limit $\pm${limit:g} {unit}", fontsize=8, color="0.3", **place)
        return
    for side in (-limit, limit):
        axes.axhline(side, color="0.25", linewidth=0.9, linestyle=(0, (4, 3)))
    axes.set_ylim(min(lower, -1.1 * limit), max(upper, 1.1 * limit))


@figure("touch", needs=signals("contact"))
def touch_figure(recordings: Recordings) -> Figure:
    """Contact and wrench of the hand, beside the external torques that leave their band."""
    groups = {"hand": "Hand", "on": "Torque of the world, on"}
    return overlay("Touch", recordings, columns_of(groups, curves.touch(recordings)))


@figure("psi", needs=signals("psi_hat"))
def psi_figure(recordings: Recordings) -> Figure:
    """The unknown terms Psi (3.20), (3.21) and what was learned of them, per component; a column per learner.

    Of many learners, at most `LEARNERS_BESIDE` stand beside each other, and the next ones below them.

    Raises:
        RecordingError: No recording, or none of a learner that holds these signals.
    """
    runs = curves.learners(recordings)
    panels = {(panel.label, panel.group): panel for panel in curves.psi(recordings)}
    require_found(recordings, panels, "psi")
    labels, styles = list(dict.fromkeys(label for label, _ in panels)), styles_of(runs)
    bands = -(-len(runs) // LEARNERS_BESIDE)
    columns = -(-len(runs) // bands)
    picture = new_figure(3.0 * max(columns, 1.5) + 0.8, (1.5 * len(labels) + 0.5) * bands + 0.8)
    grid = picture.subplots(bands * len(labels), columns, sharex=True, sharey="row", squeeze=False)
    of_run = grid.reshape(bands, len(labels), columns).transpose(0, 2, 1).reshape(-1, len(labels))
    for axes in of_run[len(runs) :].flat:
        axes.set_axis_off()
    for i, label in enumerate(labels):
        shown = {name: panels[label, name] for name in runs if (label, name) in panels}
        truth = {name: panel.truth for name, panel in shown.items() if panel.truth}
        learned = {name: panel.curves[name] for name, panel in shown.items()}
        for first in grid[i :: len(labels), 0]:
            first.set_ylabel(folded(next(iter(shown.values())).axis, 13))
            first.set_ylim(limits([*calm_values(truth, runs), *calm_values(learned, runs)]))
        for axes, name in zip(of_run[:, i], runs, strict=False):
            if name in shown:
                axes.plot(*truth[name], **TRUTH)
                axes.plot(*learned[name], **styles[name].line)
    for column, (name, recording) in zip(of_run, runs.items(), strict=False):
        column[0].set_title(legend_label(name, recording))
        column[-1].set_xlabel("time [s]")
        column[-1].tick_params(labelbottom=True)
    picture.align_ylabels(list(grid[:, 0]))
    looks = [(rf"$\hat\Psi$ of {plain(name)}", styles[name].line) for name in runs]
    add_legend(picture, r"Unknown terms $\Psi$, true and learned", [(r"true $\Psi$", TRUTH), *looks])
    return picture


@figure("gains", needs=signals("effective_gain"))
def gains_figure(recordings: Recordings) -> Figure:
    """Effective gains over time: the whole gain on z and r in the torque, `k + Kz (|Z| + ZB)` for a learner.

    PD at a learner's effective gain is left out where that learner is drawn: the two are equal.

    Raises:
        RecordingError: No recording, or none that holds these signals.
    """
    drawn = {controller_of(*item) for item in recordings.items()}
    learner = effective(drawn)
    kept = {name: rec for name, rec in recordings.items() if learner.get(controller_of(name, rec)) not in drawn}
    columns = columns_of({"base": "Base, on z", "arm": "Arm, on r"}, curves.gains(kept))
    return overlay("Effective gains", kept, columns)


@figure("path", needs=signals("pose_ref"))
def path_figure(recordings: Recordings) -> Figure:
    """Path in the plane with headings, wanted and driven; below it the distance to the wanted position over time.

    Raises:
        RecordingError: No recording, or none of a robot with a base.
    """
    panels = list(curves.path(recordings))
    require_found(recordings, panels, "path")
    tracks, gaps = panels[0].tracks, panels[1].curves
    driven, styles = {name: recordings[name] for name in gaps}, styles_of(recordings)
    picture = new_figure(7.5, 7.5)
    plane, below = picture.subplots(2, 1, height_ratios=(3, 1))
    plane.set(xlabel="x [m]", ylabel="y [m]", aspect="equal")
    below.set(xlabel="time [s]", ylabel="distance to the\nreference [mm]")
    for name, pose in tracks:
        draw_path(plane, pose, TRUTH if name is None else styles[name].line)
    for name, gap in gaps.items():
        below.plot(*gap, **styles[name].line)
    frame_paths(plane, scale_rows(driven.values()))
    below.set_ylim(0.0, limits(calm_values(gaps, driven))[1])
    for name, recording in driven.items():
        mark_end(plane, recording, styles[name], *guided_pose(recording)[:, :2].T)
        mark_end(below, recording, styles[name], *gaps[name])
    add_legend(picture, "Path of the base", [("reference", TRUTH), *style_looks(driven, styles)])
    return picture


def draw_path(axes: Axes, pose: Array, look: Look) -> None:
    """Path with ten arrows along the heading, evenly spaced in time."""
    axes.plot(pose[:, 0], pose[:, 1], **look)
    x, y, phi = pose[np.unique(np.linspace(0, len(pose) - 1, 10).astype(int))].T
    arrows = {"color": look["color"], "zorder": look.get("zorder", 3), "scale": 30, "width": 0.003, "headwidth": 4}
    axes.quiver(x, y, np.cos(phi), np.sin(phi), angles="xy", **arrows)


def frame_paths(axes: Axes, scale: Sequence[tuple[Recording, slice]]) -> None:
    """Limits that show the paths of some recordings, of a fixed shape so that a straight line has room around it."""
    points = np.concatenate([recording[name][rows, :2] for recording, rows in scale for name in ("pose", "pose_ref")])
    points = points[np.isfinite(points).all(axis=1)]
    lower, upper = points.min(axis=0), points.max(axis=0)
    shape = np.array([1.6, 1.0])  # width to height
    (x, y), (dx, dy) = (lower + upper) / 2, 0.56 * max(*((upper - lower) / shape), 0.05) * shape
    axes.set(xlim=(x - dx, x + dx), ylim=(y - dy, y + dy))


@figure("step-times")
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
    picture = new_figure(7.5, 4.0)
    axes = picture.subplots()
    edges = np.geomspace(min(v.min() for v in times.values()), 1.001 * max(v.max() for v in times.values()), 60)
    for name, values in times.items():
        axes.hist(values, edges.tolist(), histtype="step", **styles[name].line)
    axes.set(xscale="log", xlabel="time from measurement to torque [\u00b5s]", ylabel="steps")
    add_legend(picture, "Times of the steps", style_looks({name: recordings[name] for name in times}, styles))
    return picture


# -- how panels are drawn ----------------------------------------------------------------------------------------------


def columns_of(groups: Mapping[str, str], panels: Iterable[Panel]) -> list[tuple[str, list[Panel]]]:
    """Panels in columns by group, each with its heading; a group takes as few columns as possible, nearly equal."""
    every, columns = list(panels), []
    for group, heading in groups.items():
        members = [panel for panel in every if panel.group == group]
        count = -(-len(members) // PANELS_PER_COLUMN)
        parts = np.array_split(np.arange(len(members)), count) if count else []
        columns += [
            (f"{heading}, continued" if i else heading, [members[k] for k in part]) for i, part in enumerate(parts)
        ]
    return columns


def overlay(
    title: str,
    recordings: Recordings,
    columns: Sequence[tuple[str, list[Panel]]],
    more: Sequence[tuple[str, Look]] = (),
) -> Figure:
    """All runs in every panel; a column's panels share its height and its time axis; `more` is in the legend."""
    require_found(recordings, columns, title.lower())
    rows = max(len(panels) for _, panels in columns)
    picture = new_figure(3.6 * len(columns) + 0.4, 1.75 * max(rows, 2) + 1.1)
    grid = picture.add_gridspec(1, len(columns))
    for i, (heading, panels) in enumerate(columns):
        axes = grid[i].subgridspec(len(panels), 1).subplots(sharex=True, squeeze=False)[:, 0]
        axes[0].set_title(heading)
        draw_column(picture, list(axes), panels, recordings)
    looks = style_looks(recordings, styles_of(recordings))
    add_legend(picture, title, [*looks, *more, *shade_stops(picture.axes, recordings)])
    return picture


def stack(title: str, recordings: Recordings, panels: Sequence[Panel]) -> Figure:
    """Panels above each other on one time axis, in the legend the runs that they show.

    Raises:
        RecordingError: There is no panel.
    """
    require_found(recordings, panels, title.lower())
    picture = new_figure(7.5, 2.3 * len(panels) + 1.2)
    axes = picture.subplots(len(panels), 1, sharex=True, squeeze=False)[:, 0]
    draw_column(picture, list(axes), panels, recordings)
    shown = {name: r for name, r in recordings.items() if any(name in panel.curves for panel in panels)}
    add_legend(picture, title, style_looks(shown, styles_of(recordings)))
    return picture


def stacked(title: str, recordings: Recordings, panels: Mapping[str, Curves]) -> Figure:
    """Curves by label above each other on one time axis, without labels that no run has a curve for."""
    return stack(title, recordings, [Panel(label, "", shown) for label, shown in panels.items() if shown])


def draw_column(picture: Figure, axes: Sequence[Axes], panels: Sequence[Panel], recordings: Recordings) -> None:
    """Panels above each other: every run's curve, and the marks where they end above all curves."""
    styles = styles_of(recordings)
    for each, panel in zip(axes, panels, strict=True):
        each.axhline(0.0, color="0.75", linewidth=0.8, zorder=1)
        each.set_ylabel(folded(panel.axis))
        each.set_ylim(limits(calm_values(panel.curves, recordings)))
        look: Look = {"drawstyle": "steps-post" if panel.step else "default"}
        for name, curve in panel.curves.items():
            each.plot(*curve, **styles[name].line, **look)
        for name, curve in panel.curves.items():
            mark_end(each, recordings[name], styles[name], *curve)
    axes[-1].set_xlabel("time [s]")
    picture.align_ylabels(axes)


def calm_values(curves: Curves, recordings: Recordings) -> list[Array]:
    """Values of the curves that may set the scale of an axes; see `scale_rows`."""
    calm = scale_rows(recordings[name] for name in curves)
    until = {id(recording): recording.time[rows][-1] for recording, rows in calm}
    return [v[t <= until[id(recordings[n])]] for n, (t, v) in curves.items() if id(recordings[n]) in until]


def shade_stops(every: Sequence[Axes], recordings: Recordings) -> list[tuple[str, Look]]:
    """Shade the time in which a supervisor stops a run; the entry of a legend for that, if there is any."""
    supervised = [recording for recording in recordings.values() if "safety" in recording]
    stops = [times for r in supervised if len(times := r.time[r["safety"] >= STOPPING])]
    for times, axes in itertools.product(stops, every):
        axes.axvspan(times[0], times[-1], linewidth=0, zorder=0, **STOP)
    return [("stopped by the supervisor", {"linewidth": 7, **STOP})] if stops else []


def stack_of(name: str) -> Callable[[Recordings], Figure]:
    """The figure of a chart: its panels above each other."""
    chart = curves.CHARTS[name]

    def make(recordings: Recordings) -> Figure:
        panels = list(chart.panels(recordings))
        require_found(recordings, panels, name)
        return stack(chart.title, recordings, panels)

    return make


for name in STACKED:
    figure(name)(stack_of(name))

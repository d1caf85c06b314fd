"""Figures of one or more recordings of the same task, overlaid.

Every controller has one colour and one line style wherever it appears (`figure.STYLES`). A curve that ends early ends
in a cross; a diverged one does not set the scale of the others.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from ..errors import RecordingError
from ..experiments.controllers import ORACLES, effective
from ..metrics import TRUE
from ..recording import Recording
from ..signals import Array
from .figure import (
    TRUTH,
    Look,
    add_legend,
    legend_label,
    limits,
    mark_end,
    new_figure,
    plain,
    save,
    scale_rows,
    styled,
    styles_of,
)
from .rig_marks import draw_given, looks_of_given, shade_stops
from .units import column_units, milli

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

__all__ = ["FIGURES", "errors_figure", "gains_figure", "path_figure", "psi_figure", "save", "torque_figure"]

Recordings = Mapping[str, Recording]

PANELS_PER_COLUMN = 4


@dataclass(frozen=True)
class Panel:
    """What one axes shows: a column of a signal, scaled from SI."""

    signal: str
    label: str
    title: str
    unit: str
    scale: float

    def values(self, recording: Recording, rows: slice = slice(None)) -> Array:
        """The column in the panel's unit, shape (rows,); empty where the recording does not have it."""
        if not len(recording) or self.signal not in recording or self.label not in recording.labels(self.signal):
            return np.empty(0)
        table = recording[self.signal].reshape(len(recording), -1)
        return self.scale * table[rows, recording.labels(self.signal).index(self.label)]


@styled
def errors_figure(recordings: Recordings) -> Figure:
    """True tracking errors over time: pose in the base frame, velocity `z` (3.6), arm `e` (3.10).

    Raises:
        RecordingError: No recording, or none that holds these signals.
    """
    columns = [
        ("Pose error, in the base frame", error_panels(recordings, "pose_error")),
        ("Velocity error z", error_panels(recordings, "z")),
        *_columns("Arm error e", error_panels(recordings, "e")),
    ]
    return _overlay("Tracking errors", recordings, columns)


@styled
def torque_figure(recordings: Recordings) -> Figure:
    """Generalized force on the base and torques of the motors, these with `meta["effort_limits"]` if it is there.

    Beside what was commanded, thin, what imperfect motors gave.

    Raises:
        RecordingError: No recording, or none that holds these signals.
    """
    panels, motors = panels_of(recordings, "torque"), panels_of(recordings, "motor_torque")
    on_base = {label for recording in recordings.values() for label in base_labels(recording)}
    base = [panel for panel in panels if panel.label in on_base]
    arm = [] if motors else [panel for panel in panels if panel.label not in on_base]
    columns = [("Force on the base", base), *_columns("Arm", arm), *_columns("Motors", motors)]
    figure = _overlay("Torques", recordings, columns, "steps-post", looks_of_given(recordings))
    metas = [recording.meta for recording in recordings.values()]
    known = {
        k: v
        for m in metas
        if "effort_limits" in m
        for k, v in zip(m["actuator_names"], m["effort_limits"], strict=True)
    }
    for axes, panel in zip(figure.axes, (panel for _, column in columns for panel in column), strict=True):
        if panel.signal != "motor_torque":
            continue
        draw_given(axes, panel.label, recordings, styles_of(recordings))
        if np.isfinite(limit := known.get(panel.label, np.inf)):
            _draw_effort_limit(axes, limit, panel.unit)
    return figure


@styled
def psi_figure(recordings: Recordings) -> Figure:
    """The unknown terms Psi (3.20), (3.21) and what was learned of them, per component; one column per learner.

    Raises:
        RecordingError: No recording, or none of a learner that holds these signals.
    """
    runs = learners(recordings)
    panels, styles = panels_of(runs, "psi"), styles_of(runs)
    _require(recordings, panels, "psi")
    figure = new_figure(3.0 * max(len(runs), 1.5) + 0.8, 1.5 * len(panels) + 1.3)
    grid = figure.subplots(len(panels), len(runs), sharex=True, sharey="row", squeeze=False)
    for row, panel in zip(grid, panels, strict=True):
        learned = replace(panel, signal="psi_hat")
        scale = [p.values(*item) for item in scale_rows(runs.values()) for p in (panel, learned)]
        row[0].set_ylabel(plain(f"{panel.title} [{panel.unit}]"))
        row[0].set_ylim(limits(scale))
        for axes, (name, recording) in zip(row, runs.items(), strict=True):
            _draw_curve(axes, panel, recording, TRUTH)
            _draw_curve(axes, learned, recording, styles[name].line)
    for column, (name, recording) in zip(grid.T, runs.items(), strict=True):
        column[0].set_title(legend_label(name, recording))
        column[-1].set_xlabel("time [s]")
    figure.align_ylabels(list(grid[:, 0]))
    looks = [(rf"$\hat\Psi$ of {plain(name)}", styles[name].line) for name in runs]
    add_legend(figure, r"Unknown terms $\Psi$, true and learned", [(r"true $\Psi$", TRUTH), *looks])
    return figure


@styled
def gains_figure(recordings: Recordings) -> Figure:
    """Effective gains over time: all that multiplies z and r in the torque, `k + Kz (|Z| + ZB)` for a learner.

    PD at a learner's effective gain is left out where that learner is drawn: the two are equal.

    Raises:
        RecordingError: No recording, or none that holds these signals.
    """
    drawn = {_controller(*item) for item in recordings.items()}
    learners = effective(drawn)
    kept = {name: rec for name, rec in recordings.items() if learners.get(_controller(name, rec)) not in drawn}
    panels, on_base = panels_of(kept, "effective_gain"), {label for rec in kept.values() for label in base_labels(rec)}
    base = [panel for panel in panels if panel.label in on_base]
    columns = [("Base, on z", base), *_columns("Arm, on r", [panel for panel in panels if panel not in base])]
    return _overlay("Effective gains", kept, columns, drawstyle="steps-post")


@styled
def path_figure(recordings: Recordings) -> Figure:
    """Path in the plane with headings, wanted and driven; below it the distance to the wanted position over time.

    Raises:
        RecordingError: No recording, or none of a robot with a base.
    """
    driven = {name: rec for name, rec in recordings.items() if "pose" in rec and "pose_ref" in rec and len(rec)}
    _require(recordings, list(driven), "path")
    styles = styles_of(recordings)
    figure = new_figure(7.5, 7.5)
    plane, below = figure.subplots(2, 1, height_ratios=(3, 1))
    plane.set(xlabel="x [m]", ylabel="y [m]", aspect="equal")
    below.set(xlabel="time [s]", ylabel="distance to the\nreference [mm]")
    for reference in distinct([rec["pose_ref"] for rec in driven.values()]):
        _draw_path(plane, reference, TRUTH)
    for name, recording in driven.items():
        _draw_path(plane, recording["pose"], styles[name].line)
        below.plot(recording.time, distance(recording), **styles[name].line)
    _frame_paths(plane, scale_rows(driven.values()))
    below.set_ylim(0.0, limits([distance(rec)[rows] for rec, rows in scale_rows(driven.values())])[1])
    for name, recording in driven.items():
        mark_end(plane, recording, styles[name], *recording["pose"][:, :2].T)
        mark_end(below, recording, styles[name], recording.time, distance(recording))
    looks = [(legend_label(name, recording), styles[name].line) for name, recording in driven.items()]
    add_legend(figure, "Path of the base", [("reference", TRUTH), *looks])
    return figure


FIGURES: Mapping[str, Callable[[Recordings], Figure]] = {
    "errors": errors_figure,
    "torque": torque_figure,
    "psi": psi_figure,
    "gains": gains_figure,
    "path": path_figure,
}


def _controller(name: str, recording: Recording) -> str:
    """Controller of a recording."""
    return str(recording.meta.get("controller", name))


def learners(recordings: Recordings) -> dict[str, Recording]:
    """Recordings of controllers that learn Psi: those with an estimate of their own."""
    return {
        name: rec
        for name, rec in recordings.items()
        if _controller(name, rec) not in ORACLES and "psi_hat" in rec and rec["psi_hat"].any()
    }


def panels_of(recordings: Recordings, signal: str) -> list[Panel]:
    """Panels of a signal's columns, of all that any recording has, in their order; errors in thousandths."""
    panels: dict[str, Panel] = {}
    for recording in recordings.values():
        if signal not in recording:
            continue
        for label, unit in zip(recording.labels(signal), column_units(recording, signal), strict=True):
            error = signal.removeprefix("true_")
            title = "heading" if (error, label) == ("pose_error", "phi") else label
            scaled = (milli(unit), 1e3) if error in TRUE else (unit, 1.0)
            panels.setdefault(label, Panel(signal, label, title, *scaled))
    return list(panels.values())


def error_panels(recordings: Recordings, error: str) -> list[Panel]:
    """Panels of a tracking error: the true one, by which runs are judged, where all recordings have it."""
    known = all(TRUE[error] in recording for recording in recordings.values() if error in recording)
    return panels_of(recordings, TRUE[error] if known else error)


def base_labels(recording: Recording) -> tuple[str, ...]:
    """Names of the base velocities; none for a fixed arm."""
    return recording.labels("velocity") if "velocity" in recording else ()


def _columns(heading: str, panels: list[Panel]) -> list[tuple[str, list[Panel]]]:
    """Panels in as few columns as possible, of nearly equal length; the first has the heading."""
    count = -(-len(panels) // PANELS_PER_COLUMN)
    parts = np.array_split(np.arange(len(panels)), max(count, 1))
    return [(heading if i == 0 else " ", [panels[k] for k in part]) for i, part in enumerate(parts)]


def _overlay(
    title: str,
    recordings: Recordings,
    columns: Sequence[tuple[str, list[Panel]]],
    drawstyle: str = "default",
    more: Sequence[tuple[str, Look]] = (),
) -> Figure:
    """All recordings in every panel; a column's panels share its height and its time axis; `more` is in the legend."""
    columns = [(heading, panels) for heading, panels in columns if panels]
    _require(recordings, columns, title.lower())
    rows = max(len(panels) for _, panels in columns)
    figure = new_figure(3.6 * len(columns) + 0.4, 1.75 * max(rows, 2) + 1.1)
    styles = styles_of(recordings)
    grid = figure.add_gridspec(1, len(columns))
    for i, (heading, panels) in enumerate(columns):
        stack = grid[i].subgridspec(len(panels), 1).subplots(sharex=True, squeeze=False)[:, 0]
        stack[0].set_title(heading)
        stack[-1].set_xlabel("time [s]")
        for axes, panel in zip(stack, panels, strict=True):
            axes.axhline(0.0, color="0.75", linewidth=0.8, zorder=1)
            axes.set_ylabel(plain(f"{panel.title} [{panel.unit}]"))
            axes.set_ylim(limits(panel.values(*item) for item in scale_rows(recordings.values())))
            for name, recording in recordings.items():
                _draw_curve(axes, panel, recording, {**styles[name].line, "drawstyle": drawstyle})
            for name, recording in recordings.items():
                if len(values := panel.values(recording)):
                    mark_end(axes, recording, styles[name], recording.time, values)
        figure.align_ylabels(list(stack))
    looks = [(legend_label(name, rec), styles[name].line) for name, rec in recordings.items()]
    add_legend(figure, title, [*looks, *more, *shade_stops(figure.axes, recordings)])
    return figure


def _draw_curve(axes: Axes, panel: Panel, recording: Recording, look: Look) -> None:
    if len(values := panel.values(recording)):
        axes.plot(recording.time, values, **look)


def _draw_effort_limit(axes: Axes, limit: float, unit: str) -> None:
    """Lines at an actuator's limits if the curves come near, else a note of it."""
    lower, upper = axes.get_ylim()
    if max(-lower, upper) < 0.5 * limit:
        note = rf"limit $\pm${limit:g} {unit}"
        axes.text(
            0.99,
            0.96,
            note,
            transform=axes.transAxes,
            ha="right",
            va="top",
            fontsize=8,
            color="0.3",
            backgroundcolor="#ffffffc0",
        )
        return
    for side in (-limit, limit):
        axes.axhline(side, color="0.25", linewidth=0.9, linestyle=(0, (4, 3)))
    axes.set_ylim(min(lower, -1.1 * limit), max(upper, 1.1 * limit))


def _draw_path(axes: Axes, pose: Array, look: Look) -> None:
    """Path with ten arrows along the heading, evenly spaced in time."""
    axes.plot(pose[:, 0], pose[:, 1], **look)
    x, y, phi = pose[np.unique(np.linspace(0, len(pose) - 1, 10).astype(int))].T
    look = {"color": look["color"], "zorder": look.get("zorder", 3), "scale": 30, "width": 0.003, "headwidth": 4}
    axes.quiver(x, y, np.cos(phi), np.sin(phi), angles="xy", **look)


def _frame_paths(axes: Axes, scale: Sequence[tuple[Recording, slice]]) -> None:
    """Limits that show the paths of some recordings, of a fixed shape so that a straight line has room around it."""
    points = np.concatenate([recording[name][rows, :2] for recording, rows in scale for name in ("pose", "pose_ref")])
    points = points[np.isfinite(points).all(axis=1)]
    lower, upper = points.min(axis=0), points.max(axis=0)
    shape = np.array([1.6, 1.0])  # width to height
    (x, y), (dx, dy) = (lower + upper) / 2, 0.56 * max(*((upper - lower) / shape), 0.05) * shape
    axes.set(xlim=(x - dx, x + dx), ylim=(y - dy, y + dy))


def distance(recording: Recording) -> Array:
    """Distance of the base to its reference [mm], shape (N,)."""
    return 1e3 * np.hypot(*(recording["pose_ref"] - recording["pose"])[:, :2].T)


def distinct(references: Sequence[Array]) -> list[Array]:
    """References that are no beginning of another."""
    kept: list[Array] = []
    for reference in sorted(references, key=len, reverse=True):
        if not any(np.allclose(reference, other[: len(reference)]) for other in kept):
            kept.append(reference)
    return kept


def _require(recordings: Recordings, found: Sequence[object], what: str) -> None:
    if not recordings:
        raise RecordingError("nothing to plot", why="no recording was given")
    if not found:
        why = f"its signals are not in {', '.join(recordings)}"
        raise RecordingError(f"nothing to plot for {what}", why=why, fix="choose another figure or recording")

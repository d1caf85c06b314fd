"""Figures of one or more recordings of the same task, overlaid.

Every controller has one colour and one line style wherever it appears (`figure.STYLES`). A curve that ends early ends
in a cross; a diverged one does not set the scale of the others.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from ...recording.recording import Recording
from ..experiments.controllers import ORACLES, effective
from .figure import (
    TRUTH,
    add_legend,
    legend_label,
    limits,
    new_figure,
    plain,
    require_found,
    scale_rows,
    styled,
    styles_of,
)
from .overlay import columns_of, draw_curve, overlay
from .panels import base_labels, error_panels, panels_of
from .path_plot import path_figure
from .rig_marks import draw_given, looks_of_given

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

Recordings = Mapping[str, Recording]


@styled
def errors_figure(recordings: Recordings) -> Figure:
    """True tracking errors over time: pose in the base frame, velocity `z` (3.6), arm `e` (3.10).

    Raises:
        RecordingError: No recording, or none that holds these signals.
    """
    columns = [
        ("Pose error, in the base frame", error_panels(recordings, "pose_error")),
        ("Velocity error z", error_panels(recordings, "z")),
        *columns_of("Arm error e", error_panels(recordings, "e")),
    ]
    return overlay("Tracking errors", recordings, columns)


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
    columns = [("Force on the base", base), *columns_of("Arm", arm), *columns_of("Motors", motors)]
    figure = overlay("Torques", recordings, columns, "steps-post", looks_of_given(recordings))
    known = effort_limits(recordings)
    for axes, panel in zip(figure.axes, (panel for _, column in columns for panel in column), strict=True):
        if panel.signal != "motor_torque":
            continue
        draw_given(axes, panel.label, recordings, styles_of(recordings))
        if np.isfinite(limit := known.get(panel.label, np.inf)):
            draw_effort_limit(axes, limit, panel.unit)
    return figure


@styled
def psi_figure(recordings: Recordings) -> Figure:
    """The unknown terms Psi (3.20), (3.21) and what was learned of them, per component; one column per learner.

    Raises:
        RecordingError: No recording, or none of a learner that holds these signals.
    """
    runs = learners(recordings)
    panels, styles = panels_of(runs, "psi"), styles_of(runs)
    require_found(recordings, panels, "psi")
    figure = new_figure(3.0 * max(len(runs), 1.5) + 0.8, 1.5 * len(panels) + 1.3)
    grid = figure.subplots(len(panels), len(runs), sharex=True, sharey="row", squeeze=False)
    for row, panel in zip(grid, panels, strict=True):
        learned = replace(panel, signal="psi_hat")
        scale = [p.values(*item) for item in scale_rows(runs.values()) for p in (panel, learned)]
        row[0].set_ylabel(plain(f"{panel.title} [{panel.unit}]"))
        row[0].set_ylim(limits(scale))
        for axes, (name, recording) in zip(row, runs.items(), strict=True):
            draw_curve(axes, panel, recording, TRUTH)
            draw_curve(axes, learned, recording, styles[name].line)
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
    drawn = {controller_of(*item) for item in recordings.items()}
    learners = effective(drawn)
    kept = {name: rec for name, rec in recordings.items() if learners.get(controller_of(name, rec)) not in drawn}
    panels, on_base = panels_of(kept, "effective_gain"), {label for rec in kept.values() for label in base_labels(rec)}
    base = [panel for panel in panels if panel.label in on_base]
    columns = [("Base, on z", base), *columns_of("Arm, on r", [panel for panel in panels if panel not in base])]
    return overlay("Effective gains", kept, columns, drawstyle="steps-post")


FIGURES: Mapping[str, Callable[[Recordings], Figure]] = {
    "errors": errors_figure,
    "torque": torque_figure,
    "psi": psi_figure,
    "gains": gains_figure,
    "path": path_figure,
}


def controller_of(name: str, recording: Recording) -> str:
    """Controller of a recording."""
    return str(recording.meta.get("controller", name))


def learners(recordings: Recordings) -> dict[str, Recording]:
    """Recordings of controllers that learn Psi: those with an estimate of their own."""
    return {
        name: rec
        for name, rec in recordings.items()
        if controller_of(name, rec) not in ORACLES and "psi_hat" in rec and rec["psi_hat"].any()
    }


def effort_limits(recordings: Recordings) -> dict[str, float]:
    """Largest torques of the motors by name, where the recordings tell them."""
    metas = [recording.meta for recording in recordings.values() if "effort_limits" in recording.meta]
    return {k: v for m in metas for k, v in zip(m["actuator_names"], m["effort_limits"], strict=True)}


def draw_effort_limit(axes: Axes, limit: float, unit: str) -> None:
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

"""The path of the base in the plane, wanted and driven, and its distance to where it should be."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np

from ...recording.recording import Recording
from ...signals import Array
from .figure import (
    TRUTH,
    Look,
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


@styled
def path_figure(recordings: Mapping[str, Recording]) -> Figure:
    """Path in the plane with headings, wanted and driven; below it the distance to the wanted position over time.

    Raises:
        RecordingError: No recording, or none of a robot with a base.
    """
    driven = {name: rec for name, rec in recordings.items() if "pose" in rec and "pose_ref" in rec and len(rec)}
    require_found(recordings, list(driven), "path")
    styles = styles_of(recordings)
    figure = new_figure(7.5, 7.5)
    plane, below = figure.subplots(2, 1, height_ratios=(3, 1))
    plane.set(xlabel="x [m]", ylabel="y [m]", aspect="equal")
    below.set(xlabel="time [s]", ylabel="distance to the\nreference [mm]")
    for reference in distinct([rec["pose_ref"] for rec in driven.values()]):
        draw_path(plane, reference, TRUTH)
    for name, recording in driven.items():
        draw_path(plane, recording["pose"], styles[name].line)
        below.plot(recording.time, distance(recording), **styles[name].line)
    frame_paths(plane, scale_rows(driven.values()))
    below.set_ylim(0.0, limits([distance(rec)[rows] for rec, rows in scale_rows(driven.values())])[1])
    for name, recording in driven.items():
        mark_end(plane, recording, styles[name], *recording["pose"][:, :2].T)
        mark_end(below, recording, styles[name], recording.time, distance(recording))
    looks = [(legend_label(name, recording), styles[name].line) for name, recording in driven.items()]
    add_legend(figure, "Path of the base", [("reference", TRUTH), *looks])
    return figure


def draw_path(axes: Axes, pose: Array, look: Look) -> None:
    """Path with ten arrows along the heading, evenly spaced in time."""
    axes.plot(pose[:, 0], pose[:, 1], **look)
    x, y, phi = pose[np.unique(np.linspace(0, len(pose) - 1, 10).astype(int))].T
    look = {"color": look["color"], "zorder": look.get("zorder", 3), "scale": 30, "width": 0.003, "headwidth": 4}
    axes.quiver(x, y, np.cos(phi), np.sin(phi), angles="xy", **look)


def frame_paths(axes: Axes, scale: Sequence[tuple[Recording, slice]]) -> None:
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

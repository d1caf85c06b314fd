"""What the page plots: the panels of `curves`, their numbers packed in one block that the page's script reads.

Colours and dashes are those of the pictures.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from ....signals import Array, IntArray
from ...proof.proof import Proof, proofs_with
from ..curves import CHARTS, Chart, Curve, Panel, Recordings, chart, learners
from ..figure import run_label, scale_rows, styles_of
from ..files import Blob
from ..proof.figures import sliced

MOST = 4000  # points of a curve; of a longer one the extremes of this many stretches of time are kept
LARGEST = 1e30  # what single precision and a plot can still hold
PROVED = ("fvu", "lyapunov")  # charts that stand with what is proved


@chart(
    "fvu",
    "What is left unexplained of \u03a8",
    "Mean squared error of \u03a8\u0302 in each window over the variance of \u03a8 in the whole run. The mean "
    "of a curve is its FVU online; the best constant has 1.",
)
def fvu(recordings: Recordings) -> Iterator[Panel]:
    """Error online in windows, a panel per component."""
    proofs, _ = proofs_with(learners(recordings), "psi")
    windows = {name: sliced(proof) for name, proof in proofs.items()}
    for i, name in enumerate(next(iter(proofs.values())).psi.labels if proofs else ()):
        # every value is held to the end of its window
        curves = {n: (edges, np.append(v[:, i], v[-1, i])) for n, (edges, v) in windows.items()}
        yield Panel(f"\u03a8 of {name}", "", curves, scale="log", step=True)


@chart(
    "lyapunov",
    "Lyapunov function",
    "V = V1(pose error) + s\u1d40Ms/2 + the weights' errors (3.53), with the corrected V1 and ideal "
    "weights from an offline fit; the errors' part; and the measured change of V, its axis logarithmic on both sides "
    "of zero.",
)
def lyapunov(recordings: Recordings) -> Iterator[Panel]:
    """V, its part without the weights, and its measured change."""
    proofs: Mapping[str, Proof] = proofs_with(recordings, "lyapunov")[0]
    values = {name: proof.lyapunov for name, proof in proofs.items()}
    if values:
        yield Panel("V", "SI", {n: (v.time, v.total) for n, v in values.items()}, scale="log")
        if any(v.weights.any() for v in values.values()):
            parts = {n: (v.time, v.pose + v.motion) for n, v in values.items()}
            yield Panel("errors' part of V", "SI", parts, scale="log")
        yield Panel("dV/dt", "SI/s", {n: (v.time, v.measured) for n, v in values.items()}, scale="symlog")


@dataclass(frozen=True)
class Section:
    """A chart that the runs have something for: its name in addresses, and its panels as the page reads them."""

    key: str
    chart: Chart
    panels: list[dict[str, Any]]

    @property
    def proves(self) -> bool:
        """Whether it stands with what is proved."""
        return self.key in PROVED


class Charts:
    """The sections of some runs, and the numbers of their curves.

    Args:
        recordings: Runs by name.

    Attributes:
        sections: Those that the runs have something for.
        skipped: Why others are left out, one line each.
    """

    def __init__(self, recordings: Recordings) -> None:
        self.recordings, self.blob = recordings, Blob()
        self._places = {name: place for place, name in enumerate(recordings)}
        self._times: dict[tuple[int, bytes], Any] = {}
        every = (Section(n, c, [self.packed(p) for p in c.panels(recordings)]) for n, c in CHARTS.items())
        self.sections = [section for section in every if section.panels]
        self.skipped = [f"no Lyapunov function of {why}" for why in proofs_with(recordings, "lyapunov")[1]]

    def pack(self) -> str:
        """All that the page's script reads, as text; see `Blob.pack`."""
        calm = {id(run): float(run.time[rows][-1]) for run, rows in scale_rows(self.recordings.values())}
        styles = styles_of(self.recordings)
        runs = [
            {"name": run_label(name, rec), "dash": dash(styles[name].dash[1]), "calm": calm.get(id(rec))}
            for name, rec in self.recordings.items()
        ]
        return self.blob.pack({"runs": runs, "sections": {section.key: section.panels for section in self.sections}})

    def packed(self, panel: Panel) -> dict[str, Any]:
        """A panel as the page reads it; a run is its place, none for what is true or wanted."""
        truth = [self.curve(None, panel.truth)] if panel.truth else []
        curves = [self.curve(self._places[name], curve) for name, curve in panel.curves.items()]
        tracks = [self.track(None if name is None else self._places[name], pose) for name, pose in panel.tracks]
        made: dict[str, Any] = {"title": panel.title, "unit": panel.unit, "curves": [*truth, *curves, *tracks]}
        made |= {"truth": "true \u03a8"} if truth else {}
        made |= {"across": "x [m]", "plane": True} if tracks else {}
        made |= {"step": True} if panel.step else {}
        made |= {"scale": panel.scale} if panel.scale != "linear" else {}
        return made | ({"limit": panel.limit} if np.isfinite(panel.limit) else {})

    def curve(self, run: int | None, curve: Curve) -> dict[str, Any]:
        """A curve over time."""
        time, values = curve
        rows = kept_rows(values)
        key = len(time), time[rows].tobytes()
        if key not in self._times:
            self._times[key] = self.blob.add(time[rows], "f4")
        return {"run": run, "x": self._times[key], "y": self.blob.add(drawable(values[rows]), "f4")}

    def track(self, run: int | None, pose: Array) -> dict[str, Any]:
        """A path (N, 3), thinned evenly, with ten headings."""
        rows = np.unique(np.linspace(0, len(pose) - 1, min(len(pose), MOST)).astype(int))
        ten = np.unique(np.linspace(0, len(pose) - 1, 10).astype(int))
        x, y, _ = drawable(pose[rows]).T
        arrows = self.blob.add(drawable(pose[ten]), "f4")
        return {"run": run, "x": self.blob.add(x, "f4"), "y": self.blob.add(y, "f4"), "arrows": arrows}


def kept_rows(values: Array, most: int = MOST) -> IntArray:
    """Rows of a curve (N,) to keep: all, or of every stretch of time the least and the largest."""
    if len(values) <= most:
        return np.arange(len(values))
    width = -(-len(values) // (most // 2))
    padded = np.nan_to_num(np.pad(values, (0, -len(values) % width), mode="edge")).reshape(-1, width)
    starts = width * np.arange(len(padded))
    ends = np.minimum([starts + padded.argmin(axis=1), starts + padded.argmax(axis=1)], len(values) - 1)
    return np.unique([0, *ends.ravel(), len(values) - 1])


def drawable(values: Array) -> Array:
    """Numbers that single precision holds; NaN for the others."""
    return np.where(np.abs(values) < LARGEST, values, np.nan)


def dash(pattern: Sequence[float] | None) -> str:
    """A dash pattern for SVG, in pixels."""
    return " ".join(f"{1.6 * length:g}" for length in pattern or ())

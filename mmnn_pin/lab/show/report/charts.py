"""What the page plots: sections of panels of curves, their numbers in one block that the page's script reads.

Colours, dashes, units and scales are those of the pictures (`figure`, `plots`).
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from ....recording.recording import Recording
from ....signals import Array, IntArray
from ...proof.proof import proofs_with
from ..figure import scale_rows, styles_of
from ..monitors import NETWORKS, RESIDUALS
from ..panels import Panel, base_labels, error_panels, panels_of
from ..path_plot import distance, distinct
from ..plots import learners
from ..proof.figures import sliced
from ..replay.blob import Blob
from ..replay.scene import label

MOST = 4000  # points of a curve; of a longer one the extremes of this many stretches of time are kept
LARGEST = 1e30  # what single precision and a plot can still hold
ABOUT = {
    "errors": "Reference minus robot. Pose errors are in the base frame.",
    "path": "Arrows show the heading, ten along each path.",
    "torque": "Dashed lines are the motors' limits where they are near; only motors that are simulated keep them.",
    "psi": "Grey is the true \u03a8 of the Pinocchio model, what is to be learned; the curve is what was learned. A "
    "small tracking error does not mean that \u03a8 was learned.",
    "gains": "All that multiplies z (base) or r (arm) in the torque. PD at a learner's effective gain has the same.",
    "weights": "Frobenius norm of all weights of a network.",
    "fvu": "Mean squared error of \u03a8\u0302 in each window over the variance of \u03a8 in the whole run. The mean "
    "of a curve is its FVU online; the best constant has 1.",
    "lyapunov": "V = V1(pose error) + s\u1d40Ms/2 + the weights' errors (3.53), with the corrected V1 and ideal "
    "weights from an offline fit; the errors' part; and the measured change of V, its axis logarithmic on both sides "
    "of zero.",
    "residuals": "What should be zero: motion that the wheels forbid (contact plant), and energy out of nowhere.",
}


@dataclass
class Section:
    """Panels that share an axis.

    Attributes:
        key: For its address in the page.
        title: For people.
        panels: As the page reads them.
    """

    key: str
    title: str
    panels: list[dict[str, Any]] = field(default_factory=list)

    @property
    def proves(self) -> bool:
        """Whether it stands with what is proved."""
        return self.key in ("fvu", "lyapunov")

    @property
    def about(self) -> str:
        """What to know of it."""
        return ABOUT[self.key]


class Charts:
    """The sections of some runs, and the numbers of their curves.

    Args:
        recordings: Runs by name.

    Attributes:
        sections: Those that the runs have something for.
        skipped: Why others are left out, one line each.
    """

    def __init__(self, recordings: Mapping[str, Recording]) -> None:
        self.recordings, self.blob, self.skipped = recordings, Blob(), list[str]()
        self._times: dict[tuple[int, bytes], Any] = {}
        makers = {
            "errors": ("Tracking errors", self.errors),
            "path": ("Path", self.path),
            "torque": ("Torques", self.torques),
            "psi": ("\u03a8 and what was learned of it", self.psi),
            "gains": ("Effective gains", self.gains),
            "weights": ("Norms of the weights", self.weights),
            "fvu": ("What is left unexplained of \u03a8", self.fvu),
            "lyapunov": ("Lyapunov function", self.lyapunov),
            "residuals": ("Residuals", self.residuals),
        }
        made = (Section(key, title, list(make())) for key, (title, make) in makers.items())
        self.sections = [section for section in made if section.panels]

    def pack(self) -> str:
        """All that the page's script reads, as text; see `Blob.pack`."""
        calm = {
            id(recording): float(recording.time[rows][-1]) for recording, rows in scale_rows(self.recordings.values())
        }
        styles = styles_of(self.recordings)
        runs = [
            {"name": label(name, rec), "dash": dash(styles[name].dash[1]), "calm": calm.get(id(rec))}
            for name, rec in self.recordings.items()
        ]
        sections = {section.key: section.panels for section in self.sections}
        return self.blob.pack({"runs": runs, "sections": sections})

    def errors(self) -> Iterator[dict[str, Any]]:
        """Pose, velocities and joints."""
        for signal, words in (("pose_error", "pose "), ("z", "velocity "), ("e", "joint ")):
            for panel in error_panels(self.recordings, signal):
                yield self.panel(replace(panel, title=words + panel.title))

    def path(self) -> Iterator[dict[str, Any]]:
        """The base in the plane, and its distance to the reference."""
        driven = {n: r for n, r in self.recordings.items() if "pose" in r and "pose_ref" in r}
        if not driven:
            return
        curves = [self.track(None, pose) for pose in distinct([r["pose_ref"] for r in driven.values()])]
        curves += [self.track(self.index(name), recording["pose"]) for name, recording in driven.items()]
        yield {"title": "y over x", "unit": "m", "across": "x [m]", "plane": True, "curves": curves}
        curves = [self.curve(self.index(name), rec.time, distance(rec)) for name, rec in driven.items()]
        yield {"title": "distance to the reference", "unit": "mm", "curves": curves}

    def torques(self) -> Iterator[dict[str, Any]]:
        """Forces on the base, torques of the motors with their limits."""
        on_base = {name for recording in self.recordings.values() for name in base_labels(recording)}
        for panel in panels_of(self.recordings, "torque"):
            if panel.label in on_base:
                yield self.panel(replace(panel, title=f"on the base, {panel.title}"), step=True)
        limits = {
            motor: limit
            for recording in self.recordings.values()
            for motor, limit in zip(
                recording.meta["actuator_names"], recording.meta.get("effort_limits", ()), strict=False
            )
        }
        for panel in panels_of(self.recordings, "motor_torque"):
            limit = limits.get(panel.label, np.inf)
            yield self.panel(panel, step=True) | ({"limit": float(limit)} if np.isfinite(limit) else {})

    def psi(self) -> Iterator[dict[str, Any]]:
        """True and learned, one panel per component and learner."""
        runs = learners(self.recordings)
        for panel in panels_of(runs, "psi"):
            for name, recording in runs.items():
                true, learned = (replace(panel, signal=signal).values(recording) for signal in ("psi", "psi_hat"))
                if len(true):
                    curves = [
                        self.curve(None, recording.time, true),
                        self.curve(self.index(name), recording.time, learned),
                    ]
                    yield {
                        "title": f"{panel.title}, {name}",
                        "unit": panel.unit,
                        "curves": curves,
                        "truth": "true \u03a8",
                    }

    def gains(self) -> Iterator[dict[str, Any]]:
        """Effective gains."""
        for panel in panels_of(self.recordings, "effective_gain"):
            yield self.panel(panel, step=True)

    def weights(self) -> Iterator[dict[str, Any]]:
        """Norms per network."""
        for column, network in enumerate(NETWORKS):
            kept = {n: (r.time, r["weight_norm"][:, column]) for n, r in self.recordings.items() if "weight_norm" in r}
            if found := {name: curve for name, curve in kept.items() if curve[1].any()}:
                yield self.curves(f"network of the {network}", "", found)

    def fvu(self) -> Iterator[dict[str, Any]]:
        """Error online in windows, a panel per component."""
        proofs, _ = proofs_with(learners(self.recordings), "psi")
        found = {name: sliced(proof) for name, proof in proofs.items()}
        for i, name in enumerate(next(iter(proofs.values())).psi.labels if proofs else ()):
            # every value is held to the end of its window
            curves = {n: (edges, np.append(v[:, i], v[-1, i])) for n, (edges, v) in found.items()}
            yield self.curves(f"\u03a8 of {name}", "", curves) | {"scale": "log", "step": True}

    def lyapunov(self) -> Iterator[dict[str, Any]]:
        """V, its part without the weights, and its measured change."""
        proofs, reasons = proofs_with(self.recordings, "lyapunov")
        self.skipped += [f"no Lyapunov function of {reason}" for reason in reasons]
        if not proofs:
            return
        found = {name: proof.lyapunov for name, proof in proofs.items()}
        yield self.curves("V", "SI", {n: (v.time, v.total) for n, v in found.items()}) | {"scale": "log"}
        if any(v.weights.any() for v in found.values()):
            parts = {n: (v.time, v.pose + v.motion) for n, v in found.items()}
            yield self.curves("errors' part of V", "SI", parts) | {"scale": "log"}
        yield self.curves("dV/dt", "SI/s", {n: (v.time, v.measured) for n, v in found.items()}) | {"scale": "symlog"}

    def residuals(self) -> Iterator[dict[str, Any]]:
        """What should be zero."""
        for signal, (words, scale) in RESIDUALS.items():
            title, _, unit = words.removesuffix("]").partition(" [")
            if found := {n: (r.time, scale * r[signal]) for n, r in self.recordings.items() if signal in r}:
                yield self.curves(title, unit, found)

    def index(self, name: str) -> int:
        """Place of a run."""
        return list(self.recordings).index(name)

    def panel(self, panel: Panel, step: bool = False) -> dict[str, Any]:
        """A panel of a signal's column for all runs that have it."""
        found = {n: (r.time, v) for n, r in self.recordings.items() if len(v := panel.values(r))}
        return self.curves(panel.title, panel.unit, found) | ({"step": True} if step else {})

    def curves(self, title: str, unit: str, curves: Mapping[str, tuple[Array, Array]]) -> dict[str, Any]:
        """A panel of curves by run."""
        return {
            "title": title,
            "unit": unit,
            "curves": [self.curve(self.index(n), *curve) for n, curve in curves.items()],
        }

    def curve(self, run: int | None, time: Array, values: Array) -> dict[str, Any]:
        """A curve over time; of no run for the truth."""
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

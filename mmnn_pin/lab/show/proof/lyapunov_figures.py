"""Figures of the Lyapunov function: V and its derivative, what each term adds to it, the equality behind it."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np

from ....recording.recording import Recording
from ...proof.balance import TOLERANCE
from ...proof.lyapunov import TERMS
from ..figure import Look, add_legend, legend_label, new_figure, plain, styled, styles_of
from ..plots import Curves, stacked
from .psi_figures import having

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Recordings = Mapping[str, Recording]

COLOURS = (
    "#009E73",
    "#56B4E9",
    "#0072B2",
    "#CC79A7",
    "#E69F00",
    "#7F4F24",
    "#332288",
    "#6A3D9A",
    "#F781BF",
    "#A6B800",
    "#FF1493",
    "#00B8D9",
    "#D55E00",
    "#666666",
    "#44AA99",
    "#000000",
    "#882255",
    "#999999",
)
SHOWN = 1e-3  # terms that add less than this share of the largest are left out
DEEPEST = 1e-10  # part of the largest value below which nothing is shown: a start on the reference has none


@styled
def lyapunov_figure(recordings: Recordings) -> Figure:
    """V, with the weights' part where the ideal weights are known, and its measured change.

    Raises:
        RecordingError: No recording that tells its robot, its gains and its periods.
    """
    found = {name: proof.lyapunov for name, proof in having(recordings, "lyapunov", "the Lyapunov function").items()}
    panels: dict[str, Curves] = {
        "V [SI]": {name: (v.time, v.total) for name, v in found.items()},
        "errors' part [SI]": {name: (v.time, v.pose + v.motion) for name, v in found.items()},
        "dV/dt [SI/s]": {name: (v.time, v.measured) for name, v in found.items()},
    }
    if not any(v.weights.any() for v in found.values()):
        del panels["errors' part [SI]"]
    figure = stacked("Lyapunov function", recordings, panels)
    *values, rates = figure.axes
    for axes in values:
        axes.set_yscale("log")
        axes.autoscale(axis="y")
        top = axes.get_ylim()[1]
        axes.set_ylim(bottom=max(axes.get_ylim()[0], DEEPEST * top))
    largest = max((float(np.abs(v.measured).max(initial=0.0)) for v in found.values()), default=1.0)
    rates.set_yscale("symlog", linthresh=power_of_ten(1e-5 * largest))
    rates.autoscale(axis="y")
    return figure


def power_of_ten(size: float) -> float:
    """The nearest one, 1 for 0: where an axis turns linear between ticks, these crowd around its zero."""
    return float(10.0 ** np.round(np.log10(size))) if size > 1e-300 else 1.0


@styled
def terms_figure(recordings: Recordings) -> Figure:
    """What every term of the derivative has added to V so far, and V itself; one panel per run.

    Raises:
        RecordingError: As for `lyapunov_figure`.
    """
    found = {name: proof.lyapunov for name, proof in having(recordings, "lyapunov", "the Lyapunov function").items()}
    figure = new_figure(7.5, 2.4 * len(found) + 1.4)
    stack = figure.subplots(len(found), 1, sharex=True, squeeze=False)[:, 0]
    shown: set[str] = set()
    looks: dict[str, Look] = {
        term: {"color": color, "linewidth": 1.6} for term, color in zip(TERMS, COLOURS, strict=True)
    }
    change: Look = {"color": "black", "linewidth": 1.2, "linestyle": (0, (5, 1.6))}
    for axes, (name, v) in zip(stack, found.items(), strict=True):
        stride = v.time[1] - v.time[0] if len(v.time) > 1 else v.period
        sums = {term: np.cumsum(values) * stride for term, values in v.terms.items()}
        largest = max(np.abs(values).max() for values in sums.values())
        for term, values in sums.items():
            if np.abs(values).max() > SHOWN * largest:
                axes.plot(v.time, values, **looks[term])
                shown.add(term)
        axes.plot(v.time, v.total - v.total[0], **change)
        axes.axhline(0.0, color="0.75", linewidth=0.8, zorder=1)
        axes.set_yscale("symlog", linthresh=power_of_ten(1e-2 * largest))
        axes.set_ylabel("added to V [SI]")
        axes.set_title(plain(name), loc="left")
    stack[-1].set_xlabel("time [s]")
    kept = [(term, look) for term, look in looks.items() if term in shown]
    add_legend(figure, "What makes V fall and grow", [*kept, ("V - V(0)", change)])
    return figure


@styled
def equality_figure(recordings: Recordings) -> Figure:
    """Relative errors of `d/dt (s' M s / 2) = s' (Psi - tau + d)` over the control periods that were looked at.

    Above along the motion of DOP853, below between the recorded states; between them how far these are from the plant's
    own steps (see `Balance`).

    Raises:
        RecordingError: No recording of a run on the ideal plant.
    """
    found = {name: proof.balance for name, proof in having(recordings, "balance", "the equality").items()}
    styles = styles_of(recordings)
    figure = new_figure(7.5, 6.5)
    upper, middle, lower = figure.subplots(3, 1, sharex=True, sharey=True)
    for axes, words in ((upper, "model"), (middle, "plant's steps"), (lower, "recorded\nstates")):
        axes.axhline(TOLERANCE, color="0.35", linewidth=0.9, linestyle=(0, (4, 3)))
        axes.set(yscale="log", ylabel=words)
    for name, b in found.items():
        look = {"color": styles[name].color, "marker": ".", "markersize": 2.5, "linestyle": "none"}
        for axes, error in ((upper, b.model - b.work), (middle, b.increment - b.again), (lower, b.increment - b.work)):
            axes.plot(b.time, np.maximum(np.abs(error) / b.scale, 1e-17), **look)
    lower.set_xlabel("time [s]")
    dots: list[tuple[str, Look]] = [
        (legend_label(name, recordings[name]), {"color": styles[name].color, "marker": "o", "linestyle": "none"})
        for name in found
    ]
    limit: Look = {"color": "0.35", "linewidth": 0.9, "linestyle": (0, (4, 3))}
    title = r"Equality $\frac{d}{dt}\,\frac{1}{2}s^T M s = s^T(\Psi - \tau + d)$"
    add_legend(figure, title, [*dots, (f"tolerance {TOLERANCE:g}", limit)])
    return figure

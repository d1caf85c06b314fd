"""Figures of a proof: the Lyapunov function and its terms, the equality behind it; the same for a report.

A figure is one function of recordings by name, with the line `@figure(NAME, of="judged")` above it.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import TYPE_CHECKING

import numpy as np

from mmnn_pin.lab.show.curves import Panel, chart
from mmnn_pin.lab.show.figure import (
    Look,
    add_legend,
    figure,
    legend_label,
    new_figure,
    plain,
    styles_of,
)
from mmnn_pin.lab.show.plots import Curves, stacked
from mmnn_pin.lab.show.psi import small
from mmnn_pin.lab.show.psi_figures import having
from mmnn_pin.lab.show.report.verdict import judged_row
from mmnn_pin.lab.show.table import Cell
from mmnn_pin.recording.recording import Recording

from .balance import TOLERANCE
from .lyapunov import TERMS
from .proof import proof_of, proofs_with

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
    "#B8860B",
)
SHOWN = 1e-3  # terms that add less than this share of the largest are left out
DEEPEST = 1e-10  # part of the largest value below which nothing is shown: a start on the reference has none


@figure("lyapunov", of="judged")
def lyapunov_figure(recordings: Recordings) -> Figure:
    """V, with the weights' part where the ideal weights are known, and its measured change.

    Raises:
        RecordingError: No recording that tells its robot, its gains and its periods.
    """
    result = {
        name: proof.lyapunov
        for name, proof in having(recordings, "lyapunov", "the Lyapunov function", proof_of).items()
    }
    panels: dict[str, Curves] = {
        "V [SI]": {name: (v.time, v.total) for name, v in result.items()},
        "errors' part [SI]": {name: (v.time, v.pose + v.motion) for name, v in result.items()},
        "dV/dt [SI/s]": {name: (v.time, v.measured) for name, v in result.items()},
    }
    if not any(v.weights.any() for v in result.values()):
        del panels["errors' part [SI]"]
    picture = stacked("Lyapunov function", recordings, panels)
    *values, rates = picture.axes
    for axes in values:
        axes.set_yscale("log")
        axes.autoscale(axis="y")
        axes.set_ylim(bottom=max(axes.get_ylim()[0], DEEPEST * axes.get_ylim()[1]))
    largest = max((float(np.abs(v.measured).max(initial=0.0)) for v in result.values()), default=1.0)
    rates.set_yscale("symlog", linthresh=power_of_ten(1e-5 * largest))
    rates.autoscale(axis="y")
    return picture


def power_of_ten(size: float) -> float:
    """The nearest one, 1 for 0: where an axis turns linear between ticks, these crowd around its zero."""
    return float(10.0 ** np.round(np.log10(size))) if size > 1e-300 else 1.0


@figure("lyapunov-terms", of="judged")
def terms_figure(recordings: Recordings) -> Figure:
    """What every term of the derivative has added to V so far, and V itself; one panel per run.

    Raises:
        RecordingError: As for `lyapunov_figure`.
    """
    result = {
        name: proof.lyapunov
        for name, proof in having(recordings, "lyapunov", "the Lyapunov function", proof_of).items()
    }
    picture = new_figure(7.5, 2.4 * len(result) + 1.4)
    stack = picture.subplots(len(result), 1, sharex=True, squeeze=False)[:, 0]
    shown: set[str] = set()
    looks: dict[str, Look] = {
        term: {"color": color, "linewidth": 1.6} for term, color in zip(TERMS, COLOURS, strict=True)
    }
    change: Look = {"color": "black", "linewidth": 1.2, "linestyle": (0, (5, 1.6))}
    for axes, (name, v) in zip(stack, result.items(), strict=True):
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
    add_legend(picture, "What makes V fall and grow", [*kept, ("V - V(0)", change)])
    return picture


@figure("equality", of="judged")
def equality_figure(recordings: Recordings) -> Figure:
    """Relative errors of `d/dt (s' M s / 2) = s' (Psi - tau + d)` over the control periods that were looked at.

    Above along the motion of DOP853, below between the recorded states; between them how far these are from the plant's
    own steps (see `Balance`).

    Raises:
        RecordingError: No recording of a run on the ideal plant.
    """
    result = {name: proof.balance for name, proof in having(recordings, "balance", "the equality", proof_of).items()}
    styles = styles_of(recordings)
    picture = new_figure(7.5, 6.5)
    upper, middle, lower = picture.subplots(3, 1, sharex=True, sharey=True)
    for axes, words in ((upper, "model"), (middle, "plant's steps"), (lower, "recorded\nstates")):
        axes.axhline(TOLERANCE, color="0.35", linewidth=0.9, linestyle=(0, (4, 3)))
        axes.set(yscale="log", ylabel=words)
    for name, b in result.items():
        look = {"color": styles[name].color, "marker": ".", "markersize": 2.5, "linestyle": "none"}
        for axes, error in ((upper, b.model - b.work), (middle, b.increment - b.again), (lower, b.increment - b.work)):
            axes.plot(b.time, np.maximum(np.abs(error) / b.scale, 1e-17), **look)
    lower.set_xlabel("time [s]")
    dots: list[tuple[str, Look]] = [
        (legend_label(name, recordings[name]), {"color": styles[name].color, "marker": "o", "linestyle": "none"})
        for name in result
    ]
    limit: Look = {"color": "0.35", "linewidth": 0.9, "linestyle": (0, (4, 3))}
    title = r"Equality $\frac{d}{dt}\,\frac{1}{2}s^T M s = s^T(\Psi - \tau + d)$"
    add_legend(picture, title, [*dots, (f"tolerance {TOLERANCE:g}", limit)])
    return picture


# -- in a report --


def no_lyapunov(recordings: Recordings) -> list[str]:
    """Which runs have no Lyapunov function, and why."""
    return [f"no Lyapunov function of {why}" for why in proofs_with(recordings, "lyapunov")[1]]


@chart(
    "lyapunov",
    "Lyapunov function",
    "V = V1(pose error) + s\u1d40Ms/2 + the weights' errors (3.53), with the corrected V1 and ideal "
    "weights from an offline fit; the errors' part; and the measured change of V, its axis logarithmic on both sides "
    "of zero.",
    judged=True,
    lacks=no_lyapunov,
)
def lyapunov(recordings: Recordings) -> Iterator[Panel]:
    """V, its part without the weights, and its measured change."""
    values = {name: proof.lyapunov for name, proof in proofs_with(recordings, "lyapunov")[0].items()}
    if values:
        yield Panel("V", "SI", {n: (v.time, v.total) for n, v in values.items()}, scale="log")
        if any(v.weights.any() for v in values.values()):
            parts = {n: (v.time, v.pose + v.motion) for n, v in values.items()}
            yield Panel("errors' part of V", "SI", parts, scale="log")
        yield Panel("dV/dt", "SI/s", {n: (v.time, v.measured) for n, v in values.items()}, scale="symlog")


@judged_row("V grows in", "% of the periods")
def growing(recording: Recording) -> Cell:
    """How much of the time V grows."""
    proof = proof_of(recording)
    return Cell(f"{100 * proof.growth.samples:.0f}") if proof.has("lyapunov") else Cell("")


@judged_row(
    "equality",
    "worst error",
    "Equality: d/dt (s\u1d40Ms/2) = s\u1d40(\u03a8 - \u03c4 + d) over control periods, worst relative error, "
    f"tolerance {TOLERANCE:g}. mmnn prove tells more of each run.",
)
def equality(recording: Recording) -> Cell:
    """The worst error of the equality that the run is held to."""
    proof = proof_of(recording)
    if not proof.has("balance"):
        return Cell("")
    found = proof.balance
    return Cell(small(np.nanmax((found.identity, found.steps))), "" if found.holds else "bad")

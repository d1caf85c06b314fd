"""Figures of a proof: what was learned of Psi, the Lyapunov function and its terms, the equality behind it.

A figure is one function of recordings by name, with the line `@figure(NAME, of="proof")` above it.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from ....errors import RecordingError
from ....files import require_free
from ....recording.recording import Recording
from ....signals import Array
from ...experiments.controllers import ORACLES
from ...proof.balance import TOLERANCE
from ...proof.lyapunov import TERMS
from ...proof.proof import Proof, keep, proofs_with
from ...proof.psi import error_in, windows
from ..curves import column_units
from ..figure import (
    FIGURES,
    TRUTH,
    Look,
    add_legend,
    figure,
    folded,
    legend_label,
    limits,
    mark_empty,
    new_figure,
    plain,
    styles_of,
    write_figures,
)
from ..plots import Curves, stacked

if TYPE_CHECKING:
    from matplotlib.figure import Figure


Recordings = Mapping[str, Recording]

SLICES = 20  # windows of the curve over time
FROZEN = {"same": "the run's own", "held_out": "held out", "payload": "with a payload"}
LOW = 12  # letters beside the axes of a low row
MARKERS = {"same": "o", "held_out": "^", "payload": "s"}
PARTS = {"feedback": "feedback", "network": r"network, $\hat\Psi$", "robust": "robust term"}
SHADES = {"feedback": "#999999", "network": "#0072B2", "robust": "#D55E00"}
FLOOR = 1e-17
OF = {"base": "base's network", "arm": "arm's network", "all": "all velocities"}


@figure("fvu", of="proof")
def fvu_figure(recordings: Recordings) -> Figure:
    """FVU of every component: its course online, and with frozen weights at the right.

    The course is the error of each window over the variance of the whole run: its mean is the FVU online.

    Raises:
        RecordingError: No recording with a Psi_hat.
    """
    proofs = estimating(recordings, "FVU")
    labels = next(iter(proofs.values())).psi.labels
    picture = new_figure(7.5, 1.35 * len(labels) + 1.3)
    grid = picture.subplots(len(labels), 2, sharex="col", sharey="row", squeeze=False, width_ratios=(4, 1))
    styles = styles_of(recordings)
    for i, ((axes, right), label) in enumerate(zip(grid, labels, strict=True)):
        for which in (axes, right):
            which.axhline(1.0, color="0.35", linewidth=0.9, linestyle=(0, (4, 3)), zorder=1)
        axes.set(yscale="log", ylabel=folded(label.removesuffix("_joint"), LOW))
        for place, (name, proof) in enumerate(proofs.items()):
            edges, values = sliced(proof)
            if edges.size:
                axes.stairs(values[:, i], edges, baseline=None, **styles[name].line)
            for x, (kind, frozen) in enumerate(proof.psi.frozen.items()):
                right.plot(x + 0.15 * place, frozen.fvu[i], MARKERS[kind], color=styles[name].color, markersize=5)
    grid[-1, 0].set_xlabel("time [s]")
    grid[0, 0].set_title("online: error over the run's variance")
    grid[0, 1].set_title("frozen")
    grid[-1, 1].set_xticks(range(3), ["own", "held\nout", "pay-\nload"])
    grid[-1, 1].set_xlim(-0.5, 2.5 + 0.15 * len(proofs))
    picture.align_ylabels(list(grid[:, 0]))
    looks = [(legend_label(name, recordings[name]), styles[name].line) for name in proofs]
    constant: Look = {"color": "0.35", "linewidth": 0.9, "linestyle": (0, (4, 3))}
    add_legend(picture, r"What is left unexplained of $\Psi$ (FVU)", [*looks, ("best constant", constant)])
    return picture


@figure("frozen", of="proof")
def frozen_figure(recordings: Recordings) -> Figure:
    """Psi and what the final weights, held fixed, say of it: on the run's own trajectory and on the held-out one.

    Raises:
        RecordingError: No recording of a learner.
    """
    proofs = {n: p for n, p in having(recordings, "psi", "frozen weights").items() if p.psi.frozen}
    if not proofs:
        raise RecordingError("nothing to plot for frozen weights", why="no controller of these runs learns")
    first = next(iter(proofs.values()))
    kinds = [kind for kind in ("same", "held_out") if any(kind in proof.psi.frozen for proof in proofs.values())]
    labels, units = first.psi.labels, column_units(next(iter(recordings.values())), "psi")
    picture = new_figure(4.0 * len(kinds) + 0.8, 1.5 * len(labels) + 1.3)
    grid = picture.subplots(len(labels), len(kinds), sharex="col", squeeze=False)
    styles = styles_of(recordings)
    for column, kind in zip(grid.T, kinds, strict=True):
        column[0].set_title(f"trajectory: {FROZEN[kind]}")
        column[-1].set_xlabel("time [s]")
        for i, axes in enumerate(column):
            frozen = {name: proof.psi.frozen[kind] for name, proof in proofs.items() if kind in proof.psi.frozen}
            one = next(iter(frozen.values()))
            axes.plot(one.time, one.psi[:, i], **TRUTH)
            calm = [f.psi[f.time >= 0.5, i] for f in frozen.values()] + [
                f.psi_hat[f.time >= 0.5, i] for f in frozen.values()
            ]
            axes.set_ylim(limits(calm))
            for name, each in frozen.items():
                axes.plot(each.time, each.psi_hat[:, i], **styles[name].line)
            if kind == kinds[0]:
                axes.set_ylabel(folded(f"{labels[i].removesuffix('_joint')} [{units[i]}]", LOW))
    looks = [(rf"$\hat\Psi$ of {plain(name)}, frozen", styles[name].line) for name in proofs]
    add_legend(picture, r"$\Psi$ and what the final weights know of it", [(r"true $\Psi$", TRUTH), *looks])
    return picture


@figure("shares", of="proof")
def shares_figure(recordings: Recordings) -> Figure:
    """Share of the torque that came from feedback, network and robust term, per component; they add up to 1.

    Raises:
        RecordingError: No recording with a Psi_hat.
    """
    proofs = estimating(recordings, "shares of the torque")
    labels = next(iter(proofs.values())).psi.labels
    picture = new_figure(7.5, 0.32 * len(labels) * len(proofs) + 0.4 * len(proofs) + 1.3)
    stack = picture.subplots(len(proofs), 1, sharex=True, squeeze=False)[:, 0]
    for axes, (name, proof) in zip(stack, proofs.items(), strict=True):
        names = [label.removesuffix("_joint") for label in labels]
        right, left = np.zeros(len(labels)), np.zeros(len(labels))
        for part, values in proof.psi.shares.items():
            values = np.nan_to_num(values)
            axes.barh(names, values, left=np.where(values >= 0, right, left), color=SHADES[part], height=0.7)
            right, left = right + np.maximum(values, 0), left + np.minimum(values, 0)
        axes.invert_yaxis()
        axes.axvline(0.0, color="0.3", linewidth=0.8)
        axes.set_title(plain(name), loc="left")
    stack[-1].set_xlabel("share of the torque")
    looks: list[tuple[str, Look]] = [
        (PARTS[part], {"color": color, "linewidth": 7, "solid_capstyle": "butt"}) for part, color in SHADES.items()
    ]
    add_legend(picture, "Where the torque came from", looks)
    return picture


@figure("ranks", of="proof")
def ranks_figure(recordings: Recordings) -> Figure:
    """Singular values of W, V and the activations of every network, relative to the largest, from large to small.

    Raises:
        RecordingError: No recording of a learner.
    """
    proofs = {n: p for n, p in having(recordings, "psi", "ranks").items() if p.psi.networks}
    if not proofs:
        raise RecordingError("nothing to plot for ranks", why="no controller of these runs has networks")
    names = list(dict.fromkeys(network.name for proof in proofs.values() for network in proof.psi.networks))
    kinds = sorted({kind for proof in proofs.values() for n in proof.psi.networks for kind in n.singular}, reverse=True)
    whats = list(dict.fromkeys(network.what for proof in proofs.values() for network in proof.psi.networks))
    picture = new_figure(max(5.4, 3.0 * (len(kinds) + len(whats)) + 0.6), 2.2 * len(names) + 1.2)
    grid = picture.subplots(len(names), len(kinds) + len(whats), sharey=True, squeeze=False)
    styles = styles_of(recordings)
    for name, proof in proofs.items():
        for network in proof.psi.networks:
            row = grid[names.index(network.name)]
            spectra = {**network.singular, network.what: network.excitation.singular}
            for axes, kind in zip(row, [*kinds, *whats], strict=True):
                if kind in spectra and spectra[kind].any():
                    values = np.maximum(spectra[kind] / spectra[kind][0], FLOOR)
                    look = {**styles[name].line, "marker": ".", "linewidth": 1.0}
                    axes.plot(np.arange(1, len(values) + 1), values, **look)
                axes.set_yscale("log")
    for row, which in zip(grid, names, strict=True):
        row[0].set_ylabel(OF.get(which, which))
    for axes, kind in zip(grid[0], [*kinds, *whats], strict=True):
        axes.set_title(plain(kind))
    for axes in grid.flat:
        axes.xaxis.get_major_locator().set_params(integer=True)
        if not axes.lines:
            mark_empty(axes)
        elif max(len(line.get_xdata()) for line in axes.lines) == 1:
            axes.set_xlim(0.0, 2.0)
    for axes in grid[-1]:
        axes.set_xlabel("number")
    looks = [(legend_label(name, recordings[name]), styles[name].line) for name in proofs]
    add_legend(picture, "Singular values: how many units count", looks)
    return picture


def estimating(recordings: Recordings, what: str) -> dict[str, Proof]:
    """Proofs of the runs with a Psi_hat of their own; those told the true model only where there is no other."""
    proofs = having(recordings, "psi", what)
    return {n: p for n, p in proofs.items() if p.subject.controller not in ORACLES} or proofs


def having(recordings: Recordings, part: str, what: str) -> dict[str, Proof]:
    """Proofs that have a part.

    Raises:
        RecordingError: None has it; with the reasons.
    """
    proofs, reasons = proofs_with(recordings, part)
    if not proofs:
        raise RecordingError(f"nothing to plot for {what}", why="; ".join(reasons) or "no recording was given")
    return proofs


def sliced(proof: Proof) -> tuple[Array, Array]:
    """Edges (n + 1,) of windows and the error online in each over the variance of the whole run (n, p)."""
    time = proof.subject.signal("time")[:, 0]
    edges = windows(time, SLICES)
    return edges, error_in(edges, time, proof.subject.signal("psi"), proof.subject.signal("psi_hat"))


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


@figure("lyapunov", of="proof")
def lyapunov_figure(recordings: Recordings) -> Figure:
    """V, with the weights' part where the ideal weights are known, and its measured change.

    Raises:
        RecordingError: No recording that tells its robot, its gains and its periods.
    """
    result = {name: proof.lyapunov for name, proof in having(recordings, "lyapunov", "the Lyapunov function").items()}
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


@figure("lyapunov-terms", of="proof")
def terms_figure(recordings: Recordings) -> Figure:
    """What every term of the derivative has added to V so far, and V itself; one panel per run.

    Raises:
        RecordingError: As for `lyapunov_figure`.
    """
    result = {name: proof.lyapunov for name, proof in having(recordings, "lyapunov", "the Lyapunov function").items()}
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


@figure("equality", of="proof")
def equality_figure(recordings: Recordings) -> Figure:
    """Relative errors of `d/dt (s' M s / 2) = s' (Psi - tau + d)` over the control periods that were looked at.

    Above along the motion of DOP853, below between the recorded states; between them how far these are from the plant's
    own steps (see `Balance`).

    Raises:
        RecordingError: No recording of a run on the ideal plant.
    """
    result = {name: proof.balance for name, proof in having(recordings, "balance", "the equality").items()}
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


def write_proof(proof: Proof, folder: Path, force: bool = False) -> dict[str, Path]:
    """Write the figures that a proof has something for, as PNG; name to file.

    Raises:
        RecordingError: A file exists and `force` is off, or cannot be written; before any is.
    """
    keep(proof)
    for name in FIGURES["proof"]:
        require_free(folder / f"{name}.png", force)
    return write_figures(FIGURES["proof"], {proof.subject.controller: proof.subject.recording}, folder, force)

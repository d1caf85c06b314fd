"""Figures of what was learned of Psi: unexplained variance, frozen weights, shares of the torque, ranks.

A figure is one function of recordings by name, with the line `@figure(NAME, of="judged")` above it.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, TypeVar

import numpy as np

from ...errors import RecordingError
from ...files import require_free
from ...recording.recording import Recording
from ...signals import Array
from ..experiments.controllers import ORACLES
from ..psi.judgement import Judgement, judgement_of, keep, with_part
from ..psi.psi import error_in, windows
from .curves import Recordings, column_units
from .figure import (
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

if TYPE_CHECKING:
    from matplotlib.figure import Figure


J = TypeVar("J", bound=Judgement)

SLICES = 20  # windows of the curve over time
FROZEN = {"same": "the run's own", "held_out": "held out", "payload": "with a payload"}
LOW = 12  # letters beside the axes of a low row
MARKERS = {"same": "o", "held_out": "^", "payload": "s"}
PARTS = {"feedback": "feedback", "network": r"network, $\hat\Psi$", "robust": "robust term"}
SHADES = {"feedback": "#999999", "network": "#0072B2", "robust": "#D55E00"}
FLOOR = 1e-17
OF = {"base": "base's network", "arm": "arm's network", "all": "all velocities"}


@figure("fvu", of="judged")
def fvu_figure(recordings: Recordings) -> Figure:
    """FVU of every component: its course online, and with frozen weights at the right.

    The course is the error of each window over the variance of the whole run: its mean is the FVU online.

    Raises:
        RecordingError: No recording with a Psi_hat.
    """
    judged = estimating(recordings, "FVU")
    labels = next(iter(judged.values())).psi.labels
    picture = new_figure(7.5, 1.35 * len(labels) + 1.3)
    grid = picture.subplots(len(labels), 2, sharex="col", sharey="row", squeeze=False, width_ratios=(4, 1))
    styles = styles_of(recordings)
    for i, ((axes, right), label) in enumerate(zip(grid, labels, strict=True)):
        for which in (axes, right):
            which.axhline(1.0, color="0.35", linewidth=0.9, linestyle=(0, (4, 3)), zorder=1)
        axes.set(yscale="log", ylabel=folded(label.removesuffix("_joint"), LOW))
        for place, (name, judgement) in enumerate(judged.items()):
            edges, values = sliced(judgement)
            if edges.size:
                axes.stairs(values[:, i], edges, baseline=None, **styles[name].line)
            for x, (kind, frozen) in enumerate(judgement.psi.frozen.items()):
                right.plot(x + 0.15 * place, frozen.fvu[i], MARKERS[kind], color=styles[name].color, markersize=5)
    grid[-1, 0].set_xlabel("time [s]")
    grid[0, 0].set_title("online: error over the run's variance")
    grid[0, 1].set_title("frozen")
    grid[-1, 1].set_xticks(range(3), ["own", "held\nout", "pay-\nload"])
    grid[-1, 1].set_xlim(-0.5, 2.5 + 0.15 * len(judged))
    picture.align_ylabels(list(grid[:, 0]))
    looks = [(legend_label(name, recordings[name]), styles[name].line) for name in judged]
    constant: Look = {"color": "0.35", "linewidth": 0.9, "linestyle": (0, (4, 3))}
    add_legend(picture, r"What is left unexplained of $\Psi$ (FVU)", [*looks, ("best constant", constant)])
    return picture


@figure("frozen", of="judged")
def frozen_figure(recordings: Recordings) -> Figure:
    """Psi and what the final weights, held fixed, say of it: on the run's own trajectory and on the held-out one.

    Raises:
        RecordingError: No recording of a learner.
    """
    judged = {n: j for n, j in having(recordings, "psi", "frozen weights", judgement_of).items() if j.psi.frozen}
    if not judged:
        raise RecordingError("nothing to plot for frozen weights", why="no controller of these runs learns")
    first = next(iter(judged.values()))
    kinds = [
        kind for kind in ("same", "held_out") if any(kind in judgement.psi.frozen for judgement in judged.values())
    ]
    labels, units = first.psi.labels, column_units(next(iter(recordings.values())), "psi")
    picture = new_figure(4.0 * len(kinds) + 0.8, 1.5 * len(labels) + 1.3)
    grid = picture.subplots(len(labels), len(kinds), sharex="col", squeeze=False)
    styles = styles_of(recordings)
    for column, kind in zip(grid.T, kinds, strict=True):
        column[0].set_title(f"trajectory: {FROZEN[kind]}")
        column[-1].set_xlabel("time [s]")
        for i, axes in enumerate(column):
            frozen = {
                name: judgement.psi.frozen[kind] for name, judgement in judged.items() if kind in judgement.psi.frozen
            }
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
    looks = [(rf"$\hat\Psi$ of {plain(name)}, frozen", styles[name].line) for name in judged]
    add_legend(picture, r"$\Psi$ and what the final weights know of it", [(r"true $\Psi$", TRUTH), *looks])
    return picture


@figure("shares", of="judged")
def shares_figure(recordings: Recordings) -> Figure:
    """Share of the torque that came from feedback, network and robust term, per component; they add up to 1.

    Raises:
        RecordingError: No recording with a Psi_hat.
    """
    judged = estimating(recordings, "shares of the torque")
    labels = next(iter(judged.values())).psi.labels
    picture = new_figure(7.5, 0.32 * len(labels) * len(judged) + 0.4 * len(judged) + 1.3)
    stack = picture.subplots(len(judged), 1, sharex=True, squeeze=False)[:, 0]
    for axes, (name, judgement) in zip(stack, judged.items(), strict=True):
        names = [label.removesuffix("_joint") for label in labels]
        right, left = np.zeros(len(labels)), np.zeros(len(labels))
        for part, values in judgement.psi.shares.items():
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


@figure("ranks", of="judged")
def ranks_figure(recordings: Recordings) -> Figure:
    """Singular values of W, V and the activations of every network, relative to the largest, from large to small.

    Raises:
        RecordingError: No recording of a learner.
    """
    judged = {n: j for n, j in having(recordings, "psi", "ranks", judgement_of).items() if j.psi.networks}
    if not judged:
        raise RecordingError("nothing to plot for ranks", why="no controller of these runs has networks")
    names = list(dict.fromkeys(network.name for judgement in judged.values() for network in judgement.psi.networks))
    kinds = sorted(
        {kind for judgement in judged.values() for n in judgement.psi.networks for kind in n.singular}, reverse=True
    )
    whats = list(dict.fromkeys(network.what for judgement in judged.values() for network in judgement.psi.networks))
    picture = new_figure(max(5.4, 3.0 * (len(kinds) + len(whats)) + 0.6), 2.2 * len(names) + 1.2)
    grid = picture.subplots(len(names), len(kinds) + len(whats), sharey=True, squeeze=False)
    styles = styles_of(recordings)
    for name, judgement in judged.items():
        for network in judgement.psi.networks:
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
    looks = [(legend_label(name, recordings[name]), styles[name].line) for name in judged]
    add_legend(picture, "Singular values: how many units count", looks)
    return picture


def estimating(recordings: Recordings, what: str) -> dict[str, Judgement]:
    """Judgements of the runs with a Psi_hat of their own; those told the true model only where there is no other."""
    judged = having(recordings, "psi", what, judgement_of)
    return {n: j for n, j in judged.items() if j.subject.controller not in ORACLES} or judged


def sliced(judgement: Judgement) -> tuple[Array, Array]:
    """Edges (n + 1,) of windows and the error online in each over the variance of the whole run (n, p)."""
    time = judgement.subject.signal("time")[:, 0]
    edges = windows(time, SLICES)
    return edges, error_in(edges, time, judgement.subject.signal("psi"), judgement.subject.signal("psi_hat"))


def having(recordings: Recordings, part: str, what: str, of: Callable[[Recording], J]) -> dict[str, J]:
    """Judgements that have a part.

    Args:
        recordings: The runs by name.
        part: Of their judgements.
        what: It in words.
        of: The judgement of a recording.

    Raises:
        RecordingError: None has it; with the reasons.
    """
    found, reasons = with_part(recordings, part, of)
    if not found:
        raise RecordingError(f"nothing to plot for {what}", why="; ".join(reasons) or "no recording was given")
    return found


def write_judged(judgement: Judgement, folder: Path, force: bool = False) -> dict[str, Path]:
    """Write the figures that a judgement has something for, as PNG; name to file.

    Raises:
        RecordingError: A file exists and `force` is off, or cannot be written; before any is.
    """
    keep(judgement)
    for name in FIGURES["judged"]:
        require_free(folder / f"{name}.png", force)
    runs = {judgement.subject.controller: judgement.subject.recording}
    return write_figures(FIGURES["judged"], runs, folder, force)

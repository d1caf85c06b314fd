"""The thesis's claim, tested: the two-layer against the one-layer network, everything else equal, over many draws."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from mmnn_pin import PD
from mmnn_pin.torque.model_based import ScheduledPD
from research.studies.rollouts import Rollout, roll_out

from .choices import Choice, integral_only
from .draws import KEPT, PARTS, WINDOWS, Draw, draw, errors, loop, motion, run_all
from .unstated import LEARNERS

Row = dict[str, Any]
Place = tuple[int, Draw, str]  # a draw's number, the draw, its motion
Conditions = Mapping[str, Sequence[Mapping[str, Choice | None]]]  # tunings per condition: learner to what was chosen
TEST = 2  # stream of draws; the tuning has another
THESIS = "thesis"  # the condition in which both networks are as printed


def conditions(tunings: Mapping[str, Sequence[Mapping[str, Any]]]) -> dict[str, list[dict[str, Choice | None]]]:
    """Both networks as printed, then both as every tuning left them; tunings of equal number share a row."""
    pairs = zip(*(tunings[name] for name in LEARNERS), strict=True)
    tuned = [{name: one["values"] for name, one in zip(LEARNERS, pair, strict=True)} for pair in pairs]
    return {THESIS: [dict.fromkeys(LEARNERS)], "tuned": tuned}


def compare(wanted: Conditions, first: int, last: int, explained: int = 0, finer: int = 1) -> list[Row]:
    """Rows of the test draws first ... last - 1, one per draw, condition and tuning.

    Args:
        wanted: Conditions.
        first: First draw.
        last: One past the last.
        explained: Draws below this number also run what tells why: PD at each learner's effective gain and, where it
            is tuned, its integral alone; in the other rows their errors are None.
        finer: Plant steps per control sample.
    """
    places = [(i, draw(TEST, i), motion(i)) for i in range(first, last)]
    why = [place for place in places if place[0] < explained]
    pd, rows = run_all([(d, m, "pd", None) for _, d, m in places], finer), []
    for condition, tunings in wanted.items():
        for k, chosen in enumerate(tunings):
            runs = {"pd": pd} | {n: run_all([(d, m, n, chosen[n]) for _, d, m in places], finer) for n in LEARNERS}
            runs |= {f"gain_of_{n}": at_gain(why, runs[n][: len(why)], finer) for n in LEARNERS}
            runs |= {f"integral_of_{n}": integral(why, n, chosen[n], finer) for n in LEARNERS}
            for j, (i, d, reference) in enumerate(places):
                row = {"draw": i, "reference": reference, "condition": condition, "tuning": k, **d.facts}
                rows.append(row | flat({name: some[j] if j < len(some) else None for name, some in runs.items()}, d))
    return rows


def flat(runs: Mapping[str, Rollout | None], d: Draw) -> Row:
    """Errors of the runs of a draw as one row; None for what was not run."""
    blank = dict.fromkeys(f"{part}.{window}" for part in PARTS for window in WINDOWS)
    row: Row = {}
    for name, run in runs.items():
        found: Mapping[str, float | None] = blank if run is None else errors(run, d.period)
        row |= {f"{name}.{key}": value for key, value in found.items()}
        row[f"{name}.diverged"] = None if run is None else not run.completed
    return row


def at_gain(places: Sequence[Place], runs: Sequence[Rollout], finer: int = 1) -> list[Rollout]:
    """PD at the effective gain that each learner's run had: its gain without its network."""
    loops = []
    for (_, d, reference), run in zip(places, runs, strict=True):
        experiment = d.experiment(finer)
        gains = run.signals["effective_gain"]
        controller = ScheduledPD(gains) if len(gains) else PD(experiment.feedback)
        loops.append(loop(experiment, d.robot, reference, controller))
    return roll_out(loops, KEPT)


def integral(places: Sequence[Place], learner: str, chosen: Choice | None, finer: int = 1) -> list[Rollout]:
    """The integral that a tuned network holds, without the network; nothing for one as printed."""
    if chosen is None:
        return []
    return run_all([(d, m, learner, integral_only(learner, chosen)) for _, d, m in places], finer)


def claim(wanted: Conditions, draws: int, explained: int, chunk: int, say: Callable[[str], None]) -> list[Row]:
    """Rows of all test draws, a chunk of draws at a time."""
    rows: list[Row] = []
    for first in range(0, draws, chunk):
        last = min(draws, first + chunk)
        rows += compare(wanted, first, last, explained)
        say(f"{last} of {draws} draws")
    return rows


def accuracy(wanted: Conditions, draws: int) -> dict[str, Any]:
    """What the plant's step does to the verdict: the first draws again with two steps per sample.

    Returns:
        Pairs, the share of them with the same winner, median and largest change of the ratio two-layer to one-layer.
    """
    coarse, fine = (compare(wanted, 0, draws, finer=finer) for finer in (1, 2))
    same, change = [], []
    for part in PARTS:
        with np.errstate(all="ignore"):
            a, b = (
                np.array([r[f"two_layer.{part}.tracking"] / r[f"one_layer.{part}.tracking"] for r in rows])
                for rows in (coarse, fine)
            )
            known = np.isfinite(a) & np.isfinite(b) & (a > 0) & (b > 0)  # nobody lost
            same += list((a < 1)[known] == (b < 1)[known])
            change += list(np.abs(a / b - 1)[known])
    return {
        "pairs": len(same),
        "same_winner": float(np.mean(same)),
        "median": float(np.median(change)),
        "largest": float(np.max(change)),
    }

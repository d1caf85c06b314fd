"""The verdict in sentences: which controller, how good, why, and what to beware of."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass

from ....recording.metrics import halves
from ...experiments.controllers import LEARNERS, ORACLES, effective
from ...experiments.runner import Improvement, Result, unfair
from ..replay.scene import label
from ..table import limited, notes, number
from ..units import column_units, milli
from .results import controller_of


@dataclass(frozen=True)
class Verdict:
    """What to know first.

    Attributes:
        headline: One sentence.
        points: Sentences that explain it.
        warnings: What speaks against believing it.
    """

    headline: str
    points: tuple[str, ...]
    warnings: tuple[str, ...]


def verdict(result: Result) -> Verdict:
    """The verdict on the runs of a result."""
    return Verdict(headline(result), tuple(points(result)), tuple(warnings(result)))


def headline(result: Result) -> str:
    """Which controller tracks best, and by how much; of a single run, how well it tracks."""
    scores, judged = ranking(result)
    if len(judged) < 2:
        return alone(result, next(iter([*judged, *result.recordings])))
    best, second = judged[:2]
    base = compared_with(result)
    than = f"{percent(1 - scores[best])} smaller than those of {base}" if base and best != base else ""
    ahead = f"{percent(1 - scores[best] / scores[second])} smaller than those of {second}, the next best"
    errors = than if not than or second == base else f"{than} and {ahead}"
    return f"{best} tracks best of {len(judged)}: in {when(result)} its RMS errors are on average {errors or ahead}."


def alone(result: Result, name: str) -> str:
    """How well a run tracks that has none to compete with."""
    if (end := result.recordings[name].outcome).status != "completed":
        return f"{name}: {end.status} at {end.time:.3g} s."
    rms = [f"{what} {number(1e3 * value)} {unit}" for what, unit, value in errors_of(result, name)]
    return f"{name}: RMS errors in {when(result)} are {', '.join(rms)}."


def errors_of(result: Result, name: str) -> Iterator[tuple[str, str, float]]:
    """Label, unit in thousandths and RMS [SI] of the pose's and the joints' errors of a run."""
    recording = result.recordings[name]
    for signal in ("pose_error", "e"):
        if signal not in recording:
            continue
        for column, unit in zip(recording.labels(signal), column_units(recording, signal), strict=True):
            yield column, milli(unit), result.metrics[name][f"{signal}.{column}{window(result)}"]


def ranking(result: Result) -> tuple[dict[str, float], list[str]]:
    """Score of every run, and the runs that may win, best first.

    A score is the geometric mean over all errors of the RMS in the last window, divided by that of `compared_with`.
    Runs that know the true model, did not reach their end, or have no number do not compete.
    """
    rows = [key for key in next(iter(result.metrics.values())) if key.endswith(window(result))]
    base = result.metrics[compared_with(result) or next(iter(result.metrics))]
    scores = {}
    for name, numbers in result.metrics.items():
        ratios = [numbers[row] / base[row] for row in rows if numbers[row] > 0 and base[row] > 0]
        scores[name] = math.exp(math.fsum(map(math.log, ratios)) / len(ratios)) if ratios else math.nan
    judged = [
        name
        for name, recording in result.recordings.items()
        if controller_of(name, recording) not in ORACLES
        and recording.outcome.status == "completed"
        and math.isfinite(scores[name])
    ]
    return scores, sorted(judged, key=lambda name: scores[name])


def compared_with(result: Result) -> str:
    """The run of plain feedback that the others are measured against, if it reached its end; empty without."""
    for name, recording in result.recordings.items():
        if controller_of(name, recording) == "pd" and recording.outcome.status == "completed":
            return name
    return ""


def window(result: Result) -> str:
    """End of the names of the metrics in the last window."""
    return ".rms_{:g}_{:g}".format(*result.experiment.windows[-1])


def when(result: Result) -> str:
    """The last window in words, as far as the runs go."""
    start, end = result.experiment.windows[-1]
    return f"{start:g} to {min(end, result.experiment.time.duration):g} s"


def percent(share: float) -> str:
    """A share in percent."""
    return f"{100 * share:.0f} %"


def points(result: Result) -> Iterator[str]:
    """How the comparison is made, learning against gain, what is left to win, what the networks carry."""
    scores, judged = ranking(result)
    if len(judged) > 1:
        yield (
            "Compared are the errors of pose, velocities and joints, all weighted alike (geometric mean of their "
            "ratios); the table has each of them."
        )
    yield from (gain_or_learning(learner, rows) for learner, rows in result.improvements().items())
    for name, recording in result.recordings.items():
        if controller_of(name, recording) in ORACLES and len(judged) and math.isfinite(scores[name]):
            left = percent(scores[name] / scores[judged[0]])
            yield f"{name} knows the true model; its errors are {left} of those of {judged[0]}: so much is left to win."
    for name, recording in result.recordings.items():
        if (kind := controller_of(name, recording)) in (*LEARNERS, "adaptive"):
            shares = {part: percent(result.metrics[name][f"learned_share.{part}"]) for part in halves(recording)}
            told = " and ".join(f"{share} of the {part}'s" for part, share in shares.items())
            what = "networks carry" if kind in LEARNERS else "estimate carries"
            yield f"{name}: its {what} {told} torque (RMS)."
    if ranges := result.figure_ranges():
        met = sum(row["inside"] for row in ranges)
        yield f"{met} of {len(ranges)} extremes lie where the axes of the thesis's figures have them."


def gain_or_learning(learner: str, rows: Mapping[str, Improvement]) -> str:
    """What of a learner's advantage over PD is left against PD at the learner's own gain."""
    kept = [row for row in rows.values() if min(row.pd, row.pd_effective, row.learner) > 0]
    if not kept or not all(math.isfinite(row.total) for row in kept):
        return f"{learner} cannot be compared with pd."
    total = math.fsum(math.log(row.pd / row.learner) for row in kept) / len(kept)
    learning = math.fsum(math.log(row.pd_effective / row.learner) for row in kept) / len(kept)
    smaller = 1 - math.exp(-learning)
    change = f"{percent(smaller)} smaller" if smaller >= 0 else f"{percent(-smaller)} larger"
    most = f"so most of its advantage over pd is {'learning' if learning > total / 2 else 'gain'}"
    told = f"{learner}: its errors are {change} than those of pd at the same effective gain, which does not learn"
    return f"{told}, {most}." if total > 0 else f"{told}; it is no better than pd."


def warnings(result: Result) -> Iterator[str]:
    """What speaks against believing the numbers."""
    if text := unfair(result.experiment, result.metrics):
        yield f"{text[0].upper()}{text[1:]}."
    for name, recording in result.recordings.items():
        if recording.outcome.status != "completed":
            yield f"{label(name, recording)}: it does not compete."
    yield from (f"{note}." for note in notes(result))
    yield from torques(result)
    yield from unlike(result)
    for pd, learner in effective(result.recordings).items():
        if learner in result.recordings and pd not in result.recordings:
            yield f"{learner} has no {pd} beside it: what is gain and what is learning cannot be told apart."


def torques(result: Result) -> Iterator[str]:
    """Motors that were asked for more than they can give."""
    enforced = result.experiment.actuator.torque_limit is not None
    for row in limited(result):
        above = {name: peak for name, peak in row["peak"].items() if peak is None or peak > row["limit"]}
        if above:
            told = ", ".join(f"{name} {number(math.inf if peak is None else peak)}" for name, peak in above.items())
            yield (
                f"{row['actuator']} is asked for more than its limit of {number(row['limit'])} ({told}); "
                f"{'it gives no more' if enforced else 'the plant does not enforce limits'}."
            )


def unlike(result: Result) -> Iterator[str]:
    """What the runs do not have in common though a comparison needs it."""
    runs = list(result.recordings.values())
    for key, words in (
        ("urdf_sha256", "robot files"),
        ("seed", "seeds"),
        ("plant", "plants"),
        ("versions", "versions"),
    ):
        if len({str(recording.meta.get(key)) for recording in runs}) > 1:
            yield f"The runs have different {words}."
    if len({recording.config_text for recording in runs}) > 1:
        yield "The runs have different configs; those of the first are shown."

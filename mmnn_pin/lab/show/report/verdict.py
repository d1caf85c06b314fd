"""The verdict in sentences: which controller, how good, why, what to beware of, and what was learned."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass
from itertools import takewhile
from typing import Any, NamedTuple

import numpy as np

from ....errors import InputError
from ....loop.reductions import percent
from ....loop.servo import hidden_torques
from ....recording.metrics import halves
from ....recording.recording import Recording, recorded_robot
from ...experiments.controllers import LEARNERS, ORACLES, PLAIN, USUAL, effective
from ...experiments.outliers import farthest, shown
from ...experiments.result import Improvement, Result, unfair
from ...experiments.runner import weak_joints
from ...psi.judgement import Judgement, judgement_of, with_part
from ...psi.psi import worst
from ..comparison import limited, notes
from ..curves import column_units, controller_of, milli
from ..figure import run_label
from ..psi import verdicts
from ..table import Cell, Column, Row, Table, number, row_of

ABOUT_FVU = (
    "FVU: fraction of variance unexplained of \u03a8, its worst component; 1 is the best constant. Online: while the "
    "weights move. Frozen: with the weights as they were at the end. mmnn judge tells more of each run."
)
SAME = 1e-3  # relative difference of errors that no plot shows
TOLD = 0.1  # share of PD's errors that a plain rival takes off and that is told
FAR = 2.0  # times another's error that is told
FROZEN = {"same": "own trajectory", "held_out": "held out", "payload": "with a payload"}


@dataclass(frozen=True)
class ReportVerdict:
    """The verdict on some runs."""

    headline: str  # one sentence
    points: tuple[str, ...]  # sentences that explain it
    warnings: tuple[str, ...]  # what speaks against believing it


def verdict(result: Result) -> ReportVerdict:
    """The verdict on the runs of a result."""
    return ReportVerdict(headline(result), tuple(points(result)), tuple(warnings(result)))


UNSEEN = 1e-6  # m or rad (per second): a smaller RMS error is seen on no robot
ALIKE = 0.005  # errors within this share of one another are alike: full percents are printed

# A number of runs that push, one that is there only where it was reached, and the sentence.
PUSHED = (
    ("side_force_peak_N", "open_after_s", "The door is opened by {who}; {best} has the least force across: {least} N."),
    ("force_error_rms_N", "", "{best} holds the force best: {least} N of RMS error."),
)


def headline(result: Result) -> str:
    """The controller that tracks best, and by how much; of a single run, how well it tracks."""
    if any(result.pushes.values()) and (told := pushed(result)):
        return told
    scores, judged = ranking(result)
    if judged and (where := lost_in(result, judged[0])):  # no run that is not lost is behind it
        who = f"None of {len(judged)} tracks; the best, {judged[0]}," if len(judged) > 1 else judged[0]
        return f"{who} is lost: {where}{too_weak(result, judged[0])}."
    if len(judged) < 2:
        return alone(result, next(iter([*judged, *result.recordings])))
    best, small = judged[0], {name for name in judged if worst_rms(result, name) < UNSEEN}
    alike = [*takewhile(lambda name: 1 - scores[best] / scores[name] < ALIKE or {best, name} <= small, judged)]
    who = best if len(alike) == 1 else f"{listed(alike)} track alike"
    if alike == judged and small == {*judged}:
        return f"{who}: in {when(result)} none of their RMS errors reaches a micrometre or microradian."
    if alike == judged:
        return f"{who}: in {when(result)} their RMS errors are on average within {100 * ALIKE:g} % of one another."
    second = judged[len(alike)]
    base, others = compared_with(result), plain_runs(result)
    than = ""
    if base not in alike and len(others) > 1:  # feedback alone is no rival
        than = f"{smaller(scores[best], base)}, the best of {listed(others)},"
    ahead = f"{smaller(scores[best] / scores[second], second)}, the next best"
    errors = (than if second == base else f"{than} and {ahead}") if than else ahead
    missing = second in others and rivals_missing(result)  # PD alone is easily beaten
    without = f"; {listed(missing)} did not run" if missing else ""
    far = farthest({name: result.metrics[name] for name in judged}, best, window(result))
    but = f"; but {far[0]} errs {shown(far[1])} times as much as in the others" if far else ""
    told = f"{errors.rstrip(',')}{but}{without}"
    leads = f"{who}, best of" if len(alike) > 1 else f"{who} tracks best of"
    whose = "their" if len(alike) > 1 else "its"
    return f"{leads} {len(judged)}: in {when(result)} {whose} RMS errors are on average {told}."


def pushed(result: Result) -> str:
    """Sentences on a hand that pushes: how well the force is held, how far a door came."""
    sentences = []
    for key, reached, words in PUSHED:
        found = {name: value for name, numbers in result.pushes.items() if (value := numbers.get(key)) is not None}
        if found and reached:
            able = {name: v for name, v in found.items() if (result.pushes[name].get(reached)) is not None}
            if not able:
                far = {name: numbers.get("door_deg") or 0.0 for name, numbers in result.pushes.items()}
                best = max(far, key=lambda name: far[name])
                sentences.append(f"The door is opened by none; {best} comes farthest, {far[best]:.3g} degrees.")
                continue
            found = able
        if found:
            fair = [name for name in found if name not in ORACLES] or [*found]
            best = min(fair, key=lambda name: found[name])
            sentences.append(words.format(who=listed(list(found)), best=best, least=number(found[best])))
    return " ".join(sentences)


def lost_in(result: Result, name: str) -> str:
    """Where a run is lost, and by how much: its worst joint or axis of the base; empty where it is not."""
    if key := result.lost.get(name):
        signal, label = key.removesuffix(".peak").split(".", 1)
        recording = result.recordings[name]
        unit = column_units(recording, signal)[recording.labels(signal).index(label)]
        return f"{label} errs by up to {number(result.metrics[name][key])} {unit}"
    return ""


def too_weak(result: Result, name: str) -> str:
    """That the joint by which a run is lost most has a motor too weak to hold it; empty where that is not known."""
    joint = result.lost[name].removeprefix("e.").removesuffix(".peak")
    with suppress(InputError):  # its robot cannot be made again
        if why := weak_joints(recorded_robot(result.recordings[name])).get(joint):
            return f", as its motor cannot hold it ({why})"
    return ""


def smaller(ratio: float, name: str) -> str:
    """How errors are beside those of a controller, by their ratio."""
    if 1 - ratio < ALIKE:
        return f"as large as those of {name}"
    if ratio < 0.01:
        return f"less than a hundredth of those of {name}"
    return f"{percent(1 - ratio)} smaller than those of {name}"


def listed(names: list[str]) -> str:
    """Names in a sentence."""
    return " and ".join(filter(None, (", ".join(names[:-1]), names[-1])))


def alone(result: Result, name: str) -> str:
    """The errors of a run that has none to compete with."""
    recording, rms = result.recordings[name], []
    if (end := recording.outcome).status != "completed":
        return f"{name}: {end.status} at {end.time:.3g} s."
    for signal in (name for name in ("pose_error", "e") if name in recording):
        for column, unit in zip(recording.labels(signal), column_units(recording, signal), strict=True):
            value = 1e3 * result.metrics[name][f"{signal}.{column}{window(result)}"]
            if not math.isfinite(value):
                return "No run lasts until the window in which it would be judged."
            rms.append(f"{column} {number(value)} {milli(unit)}")
    return f"{name}: RMS errors in {when(result)} are {', '.join(rms)}."


def ranking(result: Result) -> tuple[dict[str, float], list[str]]:
    """Score of every run, and the runs that may win, best first.

    A score is the geometric mean over all errors of the RMS in the last window, divided by that of `compared_with`.
    Runs that know the true model, did not reach their end, or have no number do not compete, nor do lost ones where
    one is not.
    """
    rows = [key for key in next(iter(result.metrics.values())) if key.endswith(window(result))]
    base = result.metrics[compared_with(result) or next(iter(result.metrics))]
    scores = {}
    for name, numbers in result.metrics.items():
        logs = [math.log(numbers[row] / base[row]) for row in rows if numbers[row] > 0 and base[row] > 0]
        scores[name] = math.exp(math.fsum(logs) / len(logs)) if logs else math.nan
    judged = [
        name
        for name, recording in result.recordings.items()
        if controller_of(name, recording) not in ORACLES
        and recording.outcome.status == "completed"
        and math.isfinite(scores[name])
    ]
    kept = [name for name in judged if name not in result.lost] or judged
    return scores, sorted(kept, key=lambda name: scores[name])


def compared_with(result: Result) -> str:
    """The run that others are measured against: the best of `plain_runs`; empty without."""
    return min(plain_runs(result), key=lambda name: mean_log(result, name), default="")


def plain_runs(result: Result) -> list[str]:
    """The runs of `PLAIN` controllers that reached their end."""
    runs = result.recordings.items()
    return [name for name, r in runs if controller_of(name, r) in PLAIN and r.outcome.status == "completed"]


def mean_log(result: Result, name: str) -> float:
    """Mean logarithm of the RMS errors of a run in the last window; inf where it has none."""
    numbers = [value for key, value in result.metrics[name].items() if key.endswith(window(result)) and value > 0]
    return math.fsum(map(math.log, numbers)) / len(numbers) if numbers else math.inf


def worst_rms(result: Result, name: str) -> float:
    """The largest RMS error of a run in the last window, of whatever unit."""
    return max(value for key, value in result.metrics[name].items() if key.endswith(window(result)))


def window(result: Result) -> str:
    """End of the names of the metrics in the last window."""
    return ".rms_{:g}_{:g}".format(*result.experiment.windows[-1])


def when(result: Result) -> str:
    """The last window in words, as far as the runs go."""
    start, end = result.experiment.windows[-1]
    return f"{start:g} to {min(end, result.experiment.time.duration):g} s"


def points(result: Result) -> Iterator[str]:
    """Explanations: how the comparison is made, learning against gain, what is left to win, what the networks carry."""
    scores, judged = ranking(result)
    if len(judged) > 1:
        yield (
            "Compared are the errors of pose, velocities and joints, all weighted alike (geometric mean of their "
            "ratios); the table has each of them."
        )
    yield from alike(result)
    yield from (gain_or_learning(learner, rows) for learner, rows in result.improvements().items())
    base = compared_with(result)
    if result.improvements() and scores.get("pd", 0.0) > 1.0 / (1.0 - TOLD):  # 1 is the error of `base`
        yield f"{base} learns nothing; its errors, too, are {percent(1 - 1 / scores['pd'])} smaller than those of pd."
    for name, recording in result.recordings.items():
        if controller_of(name, recording) in ORACLES and len(judged) and math.isfinite(scores[name]):
            yield beside_the_truth(name, scores[name] / scores[judged[0]], judged[0])
    for name, recording in result.recordings.items():
        if (kind := controller_of(name, recording)) in (*LEARNERS, "adaptive"):
            shares = {part: percent(result.metrics[name][f"learned_share.{part}"]) for part in halves(recording)}
            words = " and ".join(f"{share} of the {part}'s" for part, share in shares.items())
            what = "networks carry" if kind in LEARNERS else "estimate carries"
            yield f"{name}: its {what} {words} torque (RMS)."
    if ranges := result.figure_ranges():
        met = sum(row["inside"] for row in ranges)
        yield f"{met} of {len(ranges)} extremes lie where the axes of the thesis's figures have them."


def beside_the_truth(name: str, ratio: float, best: str) -> str:
    """Errors of a run with the true model beside the best run without it: what a better model could save."""
    if 1 - ratio < ALIKE:
        times = f"{shown(ratio)} times" if ratio > 1 + ALIKE else "as large as"
        return (
            f"{name} knows the true model, yet its errors are {times} those of {best}: knowing it saves nothing here."
        )
    return f"{name} knows the true model: its errors are {smaller(ratio, best)}. A better model can save that."


def alike(result: Result) -> Iterator[str]:
    """Runs with the errors of another, whose curves hide each other."""
    names, keys = (
        list(result.metrics),
        [key for key in next(iter(result.metrics.values())) if key.endswith(window(result))],
    )
    for i, name in enumerate(names):
        one = [result.metrics[name][key] for key in keys]
        for other in names[:i]:
            if np.allclose(one, [result.metrics[other][key] for key in keys], rtol=SAME, atol=0.0):
                yield f"{name} has the errors of {other}: one curve lies on the other."
                break


def gain_or_learning(learner: str, rows: Mapping[str, Improvement]) -> str:
    """The advantage of a learner over PD that is left against PD at the learner's own gain."""
    kept = [row for row in rows.values() if min(row.pd, row.pd_effective, row.learner) > 0]
    if not kept or not all(math.isfinite(row.total) for row in kept):
        return f"{learner} cannot be compared with pd."
    total = math.fsum(math.log(row.pd / row.learner) for row in kept) / len(kept)
    learning = math.fsum(math.log(row.pd_effective / row.learner) for row in kept) / len(kept)
    smaller = 1 - math.exp(-learning)
    change = f"{percent(smaller)} smaller" if smaller >= 0 else f"{percent(-smaller)} larger"
    most = f"so most of its advantage over pd is {'learning' if learning > total / 2 else 'gain'}"
    words = f"{learner}: its errors are {change} than those of pd at the same effective gain, which does not learn"
    return f"{words}, {most}." if total > 0 else f"{words}; it is no better than pd."


def warnings(result: Result) -> Iterator[str]:
    """Reasons not to believe the numbers."""
    if text := unfair(result.experiment, result.metrics):
        yield f"{text[0].upper()}{text[1:]}."
    for name, recording in result.recordings.items():
        if recording.outcome.status != "completed":
            yield f"{run_label(name, recording)}: it does not compete."
    yield from (f"{text}." for text in lost_runs(result))
    yield from (f"{note}." for note in notes(result))
    yield from torques(result)
    yield from unlike(result)
    yield from (f"{text}." for text in (*worse_somewhere(result), *rivals_left_out(result)))
    for pd, learner in effective(result.recordings).items():
        if learner in result.recordings and pd not in result.recordings:
            yield f"{learner} ran without {pd}: its gain and its learning cannot be separated."


def lost_runs(result: Result) -> Iterator[str]:
    """Completed runs that are lost, where another is not: those of one joint or axis together."""
    found: dict[str, list[str]] = {}
    for name, recording in result.recordings.items():
        if recording.outcome.status == "completed" and (key := result.lost.get(name)):
            found.setdefault(key, []).append(name)
    if sum(map(len, found.values())) < len(result.recordings):
        for names in found.values():
            most = max(names, key=lambda name: result.metrics[name][result.lost[name]])
            yield f"{listed(names)} {'are' if len(names) > 1 else 'is'} lost: {lost_in(result, most)}"


def worse_somewhere(result: Result) -> Iterator[str]:
    """The error in which the winner is worst beside the plain run that it is compared with, where that is far worse."""
    (_, judged), base = ranking(result), compared_with(result)
    if not judged or base in ("", judged[0]):
        return
    best, plain = result.metrics[judged[0]], result.metrics[base]
    ratios = {key: best[key] / plain[key] for key in best if key.endswith(window(result)) and plain[key] > 0}
    key = max(ratios, key=lambda one: ratios[one], default="")
    if key and ratios[key] > FAR:
        name = key.removesuffix(window(result))
        yield f"{judged[0]} is best on average alone: its {name} is {number(ratios[key])} times that of {base}"


def rivals_left_out(result: Result) -> Iterator[str]:
    """A warning where a learner did not meet those of `USUAL`."""
    if missing := rivals_missing(result):
        yield f"{listed(missing)} did not run: this does not show whether a learner beats them"


def rivals_missing(result: Result) -> list[str]:
    """Those of `USUAL` that did not run; none where no learner is to beat them, or servos move all of them alike."""
    if torques_hidden(result):
        return []
    ran = {controller_of(name, recording) for name, recording in result.recordings.items()}
    return [name for name in USUAL if name not in ran] if ran - {*PLAIN, *ORACLES} else []


def torques_hidden(result: Result) -> bool:
    """Whether servos hide every torque, so that all controllers move the robot alike."""
    experiment, first = result.experiment, next(iter(result.recordings.values()))
    with suppress(InputError):
        if experiment.interfaces:
            hidden = hidden_torques(recorded_robot(first), experiment.interfaces, experiment.servo)
            return hidden is not None and bool(hidden.all())
    return False


def torques(result: Result) -> Iterator[str]:
    """Motors that were asked for more than they can give."""
    enforced = result.experiment.actuator.torque_limit is not None
    for row in limited(result):
        above = {name: peak for name, peak in row["peak"].items() if peak is None or peak > row["limit"]}
        if above:
            words = ", ".join(f"{name} {number(math.inf if peak is None else peak)}" for name, peak in above.items())
            yield (
                f"{row['actuator']} is asked for more than its limit of {number(row['limit'])} ({words}); "
                f"{'it gives no more' if enforced else 'the plant does not enforce limits'}."
            )


def unlike(result: Result) -> Iterator[str]:
    """Differences between the runs that a comparison must not have."""
    runs = list(result.recordings.values())
    shared = {"urdf_sha256": "robot files", "seed": "seeds", "plant": "plants", "versions": "versions"}
    for key, words in shared.items():
        if len({str(recording.meta.get(key)) for recording in runs}) > 1:
            yield f"The runs have different {words}."
    if len({recording.config_text for recording in runs}) > 1:
        yield "The runs have different configs; those of the first are shown."


# -- what was learned --------------------------------------------------------------------------------------------------


class JudgedRow(NamedTuple):
    """A row of what is known of runs: its head, its second head, its cell of a run, and what to know of it."""

    title: str
    second: str
    cell: Callable[[Recording], Cell]
    about: str = ""


JUDGED_ROWS: list[JudgedRow] = []  # beside those of Psi


def judged_row(
    title: str, second: str, about: str = ""
) -> Callable[[Callable[[Recording], Cell]], Callable[[Recording], Cell]]:
    """Register a row of the table of what is known of runs; arguments as of `JudgedRow`."""

    def register(cell: Callable[[Recording], Cell]) -> Callable[[Recording], Cell]:
        JUDGED_ROWS.append(JudgedRow(title, second, cell, about))
        return cell

    return register


def learned(recordings: Mapping[str, Recording]) -> dict[str, Any] | None:
    """Results of learning: `sentences`, one per network, and a `table`; None where nothing is known of any run."""
    judged, _ = with_part(recordings, "subject", judgement_of)
    rows = tuple(learned_rows(judged))
    if not rows:
        return None
    learners = {name: one for name, one in judged.items() if one.has("psi") and one.psi.frozen}
    sentences = tuple(f"{name}, {text}" for name, one in learners.items() for text in verdicts(one.psi))
    heads = (Column(text=True), Column(text=True), *map(Column, judged))
    about = (ABOUT_FVU, *(row.about for row in JUDGED_ROWS if row.about))
    return {"sentences": sentences, "table": Table("What was learned", heads, rows, about)}


def learned_rows(judged: Mapping[str, Judgement]) -> Iterator[Row]:
    """Rows of the table; those that no run has a number for are left out."""
    halves = {half: None for one in judged.values() if one.has("psi") for half in one.psi.halves}

    def fvu(half: str, kind: str = "") -> Callable[[Recording], Cell]:
        """Cell of a run's FVU: online, or frozen on a kind of trajectory; one no better than a constant is bad."""

        def cell(recording: Recording) -> Cell:
            one = judgement_of(recording)
            if not one.has("psi") or (kind and kind not in one.psi.frozen):
                return Cell("")
            every = one.psi.frozen[kind].fvu if kind else one.psi.online
            value = worst(every[one.psi.halves[half]])
            return Cell(number(value), "bad" if value >= 1 else "")

        return cell

    wanted = [JudgedRow("FVU online", half, fvu(half)) for half in halves]
    wanted += [
        JudgedRow(f"FVU frozen, {words}", half, fvu(half, kind)) for kind, words in FROZEN.items() for half in halves
    ]
    before = ""
    for row in (*wanted, *JUDGED_ROWS):
        cells = [row.cell(one.subject.recording) for one in judged.values()]
        if any(cell.text for cell in cells):
            yield row_of("" if row.title == before else row.title, row.second, *cells)
            before = row.title

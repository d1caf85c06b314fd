"""The tables of an experiment: its controllers beside each other, its cases judged, its readings.

A terminal shows them one after the other (`render...`); a report takes the same tables as data (`tables_of`).
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Mapping
from itertools import groupby
from typing import Any

import numpy as np

from ...plant.contact.plant import SLIPPING
from ...recording.metrics import ERRORS, halves
from ...recording.recording import Recording, as_columns, recorded_robot
from ..experiments.cases import CaseMatrix, CaseVerdict
from ..experiments.controllers import MODELS, ORACLES
from ..experiments.hand import peak_speeds, speed_limit
from ..experiments.result import Improvement, Result, unfair
from .curves import column_units, milli
from .table import WIDTH, Cell, CellKind, Column, Row, Table, TextLine, grouped, number, row_of, terminal_text

CASES_WIDTH = 120
FEW = 8  # joints that a short table has a row for
KEPT = ("delay margin [ms]", "outcome")
NAME = 9  # letters of a controller's name on a line
TITLES = {"pose_error": "pose", "z": "velocity", "e": "joint"}
ABOUT = (
    "effort: time integral of the squared motor torques. learned share: RMS of Psi_hat over RMS of the torque. "
    "effective gain: mean of the whole gain on z (base) or r (arm), robust term included. "
    "delay margin: least delay from measurement to torque with which the linearised loop is unstable, under the "
    "feedback alone or with the one inside Psi."
)
ABOUT_HAND = (
    "hand: the true frame against its path, after the first second. kinematic: of the reference itself. tracking: the "
    "measured hand against the reference's. model: the true hand against the measured one."
)
HAND_ROWS = {
    "position_rms_mm": ("hand position [mm]", "RMS"),
    "position_peak_mm": ("", "peak"),
    "orientation_rms_mrad": ("hand orientation [mrad]", "RMS"),
    "kinematic_rms_mm": ("of it kinematic [mm]", "RMS"),
    "tracking_rms_mm": ("tracking [mm]", "RMS"),
    "model_rms_mm": ("model [mm]", "RMS"),
}
PUSH_ROWS = {
    "force_mean_N": ("force on the surface [N]", "mean"),
    "force_error_rms_N": ("its error [N]", "RMS"),
    "door_deg": ("door opened [deg]", "peak"),
    "open_after_s": ("at 60 deg after [s]", ""),
    "side_force_peak_N": ("force across its way [N]", "peak"),
    "pull_peak_N": ("force along its way [N]", "peak"),
}
MARKED = ("position_rms_mm", "position_peak_mm", "orientation_rms_mrad")
ABOUT_SHARES = (
    "better than pd = gain + learning: how much smaller the RMS error is, in % of pd's. gain: from pd to pd at the "
    "learner's effective gain. learning: from there to the learner. shares: of the improvement, gain : learning."
)
ABOUT_LARGEST = (
    "largest error: of the whole run, as measured, as in the thesis; the thesis's numbers stand beside ours."
)
ABOUT_READINGS = (
    "RMS errors of the last window, in thousandths (mm, mrad). share: RMS of Psi_hat over RMS of the torque. met: "
    "intervals of the thesis's figures. A dash: the run did not get there."
)
VERDICT_KINDS: dict[str, CellKind] = {"tracked": "good", "stopped": "warn", "failed": "bad", "interrupted": "dim"}
HIDDEN_ERRORS = ("pose_error.y",)  # a straight line has next to none


# -- controllers -------------------------------------------------------------------------------------------------------


def render(result: Result, colour: bool = False, width: int = WIDTH) -> str:
    """All tables with their notes beneath them, as text of at most `width` columns.

    A comparison that is not fair says so before anything else.
    """
    tables = list(tables_of(result))
    warning = unfair(result.experiment, result.metrics)
    head = [TextLine(f"{warning[0].upper()}{warning[1:]}", "bold red")] if warning else []
    notes = TextLine(" ".join(table.caption for table in tables if table.notes), "italic")
    return terminal_text([*head, TextLine(title(result), "bold"), *tables, notes], colour, width)


def title(result: Result) -> str:
    """The experiment in one line: variant, robot, duration, seed."""
    experiment = result.experiment
    variant = f"variant {experiment.variant}, " if experiment.variant else ""
    variant += "contact plant, " if experiment.plant == "contact" else ""
    about = f"{variant}{experiment.robot}, {experiment.time.duration:g} s, seed {experiment.seed}"
    return f"{experiment.title or result.name} ({about})"


def render_brief(result: Result, colour: bool = False, width: int = WIDTH) -> str:
    """One table of what matters most, as text of at most `width` columns."""
    warning = unfair(result.experiment, result.metrics)
    head = [TextLine(f"{warning[0].upper()}{warning[1:]}", "bold red")] if warning else []
    table = brief(result)
    return terminal_text(
        [*head, TextLine(title(result), "bold"), table, TextLine(table.caption, "italic")], colour, width
    )


def brief(result: Result) -> Table:
    """A column per controller; RMS errors of the last window that was reached, motors at their limits, outcome."""
    windows, end = result.experiment.windows, result.experiment.time.duration
    start, stop = next(((a, b) for a, b in reversed(windows) if a < end), windows[0])
    force = result.experiment.force
    if force is not None and force.follow:  # the hand goes where it is let: the reference is no measure
        rows = grouped(push_rows(result, brief=True), brief_rest(result))
        notes, about = [], "--details has errors against a reference that stands, peaks, torques and gains."
    else:
        errors = brief_errors(result, f"rms_{start:g}_{stop:g}")
        rows = grouped(push_rows(result, brief=True), brief_hand(result), errors, brief_rest(result))
        notes = [note for note in notes_of(result) if note.startswith(("*", *ORACLES))]
        about = f"Errors: {rms(start, stop, end)}; --details has all of them, peaks, torques and gains."
    controllers = (Column(name, letters=NAME) for name in result.recordings)
    return Table("In short", (Column(text=True, fold=True), *controllers), rows, (*notes, about), gap=0)


def brief_hand(result: Result) -> Iterator[Row]:
    """Errors of the hand, the worst of several."""
    if not any(result.hand.values()):
        return
    every = {name: [errors.numbers() for errors in hands] for name, hands in result.hand.items()}
    for key in ("position_rms_mm", "orientation_rms_mrad"):
        values = {c: max((x for v in h if (x := v[key]) is not None), default=math.nan) for c, h in every.items()}
        if not all(map(math.isnan, values.values())):
            yield row_of(HAND_ROWS[key][0], *marked(result, values))


def brief_errors(result: Result, key: str) -> Iterator[Row]:
    """RMS of the base's distance and heading, and of every joint; of many joints that of the worst."""
    recording = next(iter(result.recordings.values()))
    if "pose_error" in recording:
        both = {c: [m[f"pose_error.{label}.{key}"] for label in "xy"] for c, m in result.metrics.items()}
        yield row_of("base [mm]", *marked(result, {c: 1e3 * math.hypot(*xy) for c, xy in both.items()}))
        turned = {c: 1e3 * m[f"pose_error.phi.{key}"] for c, m in result.metrics.items()}
        yield row_of("base heading [mrad]", *marked(result, turned))
    joints = list(zip(recording.labels("e"), column_units(recording, "e"), strict=True)) if "e" in recording else []
    if len(joints) <= FEW:
        for label, unit in joints:
            values = {c: 1e3 * m[f"e.{label}.{key}"] for c, m in result.metrics.items()}
            yield row_of(f"{label} [{milli(unit)}]", *marked(result, values))
        return
    for unit in dict.fromkeys(unit for _, unit in joints):
        own = [label for label, other in joints if other == unit]
        values = {c: max(1e3 * m[f"e.{label}.{key}"] for label in own) for c, m in result.metrics.items()}
        which = f"worst of {len(own)} joints" if len(own) > 1 else own[0]
        yield row_of(f"{which} [{milli(unit)}]", *marked(result, values))


def brief_rest(result: Result) -> Iterator[Row]:
    """Motors above their limits and wheels that slip, where there are some; the delay that is borne; the outcome."""
    over = [row for row in limited(result) if exceeded(row)]
    if over:
        counts = (sum((row["peak"].get(c) or 0.0) > row["limit"] for row in over) for c in result.recordings)
        yield row_of("motors asked for more than they give", *(Cell(str(n), "bad" if n else "") for n in counts))
    if "slip" in next(iter(result.recordings.values())):
        yield row_of("time slipping [s]", *(f"{slipping(run):.3g}" for run in result.recordings.values()))
    yield from (row_of(row.cells[0].text, *row.cells[2:]) for row in other_rows(result) if row.cells[0].text in KEPT)


def tables_of(result: Result) -> Iterator[Table]:
    """The comparison; gain or learning; the thesis's errors and figures. Those that the result has something for."""
    if any(result.hand.values()):
        yield hand_table(result)
    yield comparison(result)
    improvements, end = result.improvements(), result.experiment.time.duration
    if improvements and result.experiment.windows[-1][0] < end:
        yield improvement_table(improvements, rms(*result.experiment.windows[-1], end))
    if found := result.largest_errors():
        yield largest_table(found)
    if ranges := result.figure_ranges():
        yield ranges_table(ranges)


def comparison(result: Result) -> Table:
    """A column per controller; rows of errors, wheels, torques beyond limits, effort, learned share, gain, outcome."""
    heads = (Column(text=True, fold=True), Column(text=True))
    controllers = (Column(name, letters=NAME) for name in result.recordings)
    rows = grouped(push_rows(result), error_rows(result), wheel_rows(result), torque_rows(result), other_rows(result))
    return Table("Comparison", (*heads, *controllers), rows, notes_of(result), gap=0)


def notes_of(result: Result) -> tuple[str, ...]:
    """Meanings of the marks and words in the comparison."""
    oracles = [name for name in result.recordings if name in ORACLES]
    notes = []
    if len(result.recordings) - len(oracles) > 1:
        told = 0 < len(result.lost) < len(result.recordings)
        knowing = [f"{name}, which knows the true model," for name in oracles]
        out = " and ".join([*knowing, *["runs that are lost"] * told])
        are = "do" if told else "does"
        notes.append(f"* best in its row; {out} {are} not compete." if out else "* best in its row.")
    elif oracles:
        notes.append(f"{oracles[0]} knows the true model.")
    if any(name in MODELS for name in result.recordings):
        notes.append("A learned share in brackets is a model's, not learned.")
    if any(map(exceeded, limited(result))):
        enforced = result.experiment.actuator.torque_limit is not None
        then = "all that it gives" if enforced else "which this plant does not enforce"
        notes.append(f"! asked for above the motor's effort limit, {then}.")
    return (*notes, ABOUT)


def error_rows(result: Result) -> Iterator[Row]:
    """Peak and RMS of every error; the best value of a row is marked."""
    recording = next(iter(result.recordings.values()))
    windows, end = result.experiment.windows, result.experiment.time.duration
    reached = {f"rms_{a:g}_{b:g}": rms(a, b, end) for a, b in windows if a < end}
    statistics = {"peak": "peak"} | reached
    for name in (name for name in ERRORS if name in recording):
        for label, unit in zip(recording.labels(name), column_units(recording, name), strict=True):
            for key, words in statistics.items():
                first = f"{TITLES[name]} {label} [{milli(unit)}]" if key == "peak" else ""
                values = {c: 1e3 * m[f"{name}.{label}.{key}"] for c, m in result.metrics.items()}
                yield row_of(first, words, *marked(result, values))


def push_rows(result: Result, brief: bool = False) -> Iterator[Row]:
    """Forces on a surface, angle and forces of a door; nothing where none is; `brief` in one column."""
    for key, (about, words) in PUSH_ROWS.items():
        values = [numbers.get(key) for numbers in result.pushes.values()]
        if any(key in numbers for numbers in result.pushes.values()):
            heads = (f"{about} {words}".strip(),) if brief else (about, words)
            yield row_of(*heads, *("-" if value is None else number(value) for value in values))


def rms(start: float, stop: float, end: float) -> str:
    """A window in words, as far as the runs go."""
    return f"RMS {start:g}-{min(stop, end):g} s"


def marked(result: Result, values: dict[str, float]) -> list[Cell]:
    """Values with a star at the smallest one of the controllers without the true model, lost ones behind all others."""
    fair = {c: v for c, v in values.items() if c not in ORACLES and math.isfinite(v)}
    kept = {c: v for c, v in fair.items() if c not in result.lost} or fair
    best = min(kept.values()) if len(fair) > 1 else None
    wins = (value == best and controller in kept for controller, value in values.items())
    return [Cell(number(v), *(("best", "*") if w else ())) for v, w in zip(values.values(), wins, strict=True)]


def wheel_rows(result: Result) -> Iterator[Row]:
    """Peak slip and traction use of every wheel, and the time of slipping; nothing on the ideal plant."""
    recording = next(iter(result.recordings.values()))
    if "slip" not in recording:
        return
    for signal, words, scale in (("slip", "slip [mm/s]", 1e3), ("traction", "traction use", 1.0)):
        for wheel in recording.labels(signal):
            peaks = (scale * numbers[f"{signal}.{wheel}.peak"] for numbers in result.metrics.values())
            yield row_of(f"{words} {wheel}", "peak", *(f"{peak:.3g}" for peak in peaks))
    yield row_of("time slipping [s]", "", *(f"{slipping(r):.3g}" for r in result.recordings.values()))


def slipping(recording: Recording) -> float:
    """Time in which a wheel's contact point moved faster than it can creep [s]."""
    fast = as_columns(recording["slip"]) > SLIPPING
    return float(np.count_nonzero(fast.any(axis=1)) * recording.fact("control_period", float))


def limited(result: Result) -> list[dict[str, Any]]:
    """Peak torques of the motors that have an effort limit, see `Result.torque_limits`."""
    return [row for row in result.torque_limits() if row["limit"] is not None]


def exceeded(row: dict[str, Any]) -> bool:
    """Whether a peak torque is above its motor's effort limit."""
    return any(peak is not None and peak > row["limit"] for peak in row["peak"].values())


def torque_rows(result: Result) -> Iterator[Row]:
    """Peak torques of motors with an effort limit: all if the experiment asks for it, else of those that exceed it."""
    for row in limited(result):
        peaks = (row["peak"].get(controller) for controller in result.recordings)
        values = [math.inf if peak is None else peak for peak in peaks]
        cells = (Cell(number(value), *(("bad", "!") if value > row["limit"] else ())) for value in values)
        if result.experiment.torque_limits or exceeded(row):
            yield row_of(f"peak torque {row['actuator']}", f"of {number(row['limit'])}", *cells)


def other_rows(result: Result) -> Iterator[Row]:
    """Effort, learned share, effective gain and outcome."""
    recording, metrics = next(iter(result.recordings.values())), result.metrics
    yield row_of("torque effort [N²m²s]", "", *(number(m["effort"]) for m in metrics.values()))
    for part in halves(recording):
        shares = {c: number(round(m[f"learned_share.{part}"], 9)) for c, m in metrics.items()}
        yield row_of("learned share", part, *(f"({s})" if c in MODELS else s for c, s in shares.items()))
    for part in halves(recording):
        gains = (m[f"effective_gain.{part}"] for m in metrics.values())  # 0: a controller that does not tell its gain
        yield row_of("mean effective gain", part, *(number(gain) if gain else "-" for gain in gains))
    if any("delay_margin" in run.meta for run in result.recordings.values()):
        yield row_of("delay margin [ms]", "", *(margin_cell(run) for run in result.recordings.values()))
    yield row_of("outcome", "", *(outcome_cell(result, name) for name in result.recordings))


def margin_cell(recording: Recording) -> str:
    """The delay that the linearised loop bears [ms]."""
    margin = recording.meta.get("delay_margin")
    return "-" if margin is None else f"{1e3 * margin:.3g}"


def outcome_cell(result: Result, name: str) -> Cell:
    """The end of a run; bad unless it was completed, is not lost, and is not worse than plain control."""
    outcome = result.recordings[name].outcome
    if name in result.worse:
        return Cell("worse\nthan plain\ncontrol", "bad")
    if outcome.status != "completed":
        return Cell(f"{outcome.status}\nat {outcome.time:.3g} s", "bad")
    return Cell("lost", "bad") if name in result.lost else Cell("done", "good")


def notes(result: Result) -> list[str]:
    """Notes for the user: ends of runs, runs that stand out, notes on the settings."""
    messages = {name: recording.outcome.message for name, recording in result.recordings.items()}
    ends = [text if text.startswith(name) else f"{name}: {text}" for name, text in messages.items() if text]
    return [*result.worse.values(), *ends, *result.outliers(), *result.notes]


def hand_table(result: Result) -> Table:
    """A column per controller; rows of the true hand's errors, their shares, and peak speeds."""
    rows, several = [], max(map(len, result.hand.values())) > 1
    for hands in zip(*result.hand.values(), strict=True):
        every = {name: errors.numbers() for name, errors in zip(result.hand, hands, strict=True)}
        for key, (about, words) in HAND_ROWS.items():
            values = {name: math.nan if v[key] is None else float(v[key]) for name, v in every.items()}
            if not all(map(math.isnan, values.values())):
                which = about.replace("hand", hands[0].frame) if several else about
                texts = marked(result, values) if key in MARKED else map(number, values.values())
                rows.append(row_of(which, words, *texts))
    robot = recorded_robot(next(iter(result.recordings.values())))
    speeds = {name: peak_speeds(recording, robot) for name, recording in result.recordings.items()}
    for i, joint in enumerate(next(iter(speeds.values()))):
        limit = speed_limit(robot, joint)
        cells = (Cell(number(s[joint]), *(("bad", "!") if s[joint] > limit else ())) for s in speeds.values())
        about = f"{joint} of {number(limit)}" if math.isfinite(limit) else joint
        rows.append(row_of("peak speed [rad/s, m/s]" if i == 0 else "", about, *cells))
    heads = (Column(text=True, fold=True), Column(text=True))
    controllers = (Column(name, letters=NAME) for name in result.hand)
    return Table("The hand", (*heads, *controllers), tuple(rows), (ABOUT_HAND,), gap=0)


# -- gain, learning, and the thesis's numbers --------------------------------------------------------------------------


def improvement_table(improvements: Mapping[str, Mapping[str, Improvement]], window: str) -> Table:
    """Per error and learner: the improvement over PD, in % of PD's RMS, and the shares of gain and of learning."""
    heads = [
        Column(head, group=learner, letters=NAME)
        for learner in improvements
        for head in ("better", "= gain", "+ learning", "shares")
    ]
    rows = []
    for key in next(iter(improvements.values())):
        signal, _, label = key.partition(".")
        cells = (cell for of_learner in improvements.values() for cell in improvement_cells(of_learner[key]))
        rows.append(row_of(f"{TITLES[signal]} {label}", *cells))
    first = Column(f"{window},\n% of pd's", text=True)
    return Table("Gain or learning", (first, *heads), tuple(rows), (ABOUT_SHARES,), gap=0)


def improvement_cells(improvement: Improvement) -> tuple[str, str, str, str]:
    """Improvement, gain and learning in % of PD's RMS, and the shares; dashes where there is nothing to share."""
    numbers = [improvement.total, improvement.gain, improvement.learning]
    total, gain, learning = (f"{100 * v / improvement.pd:.1f}" if improvement.pd > 0 else "-" for v in numbers)
    share = improvement.learning_share
    ratio = "-" if share is None else f"{100 - 100 * share:.0f} : {100 * share:.0f}"
    return total, gain, learning, f"  {ratio}"


def largest_table(found: Mapping[str, Any]) -> Table:
    """Largest error of every joint and controller beside the thesis's, and as a share of one_layer's."""
    errors, ratios = found["largest_errors_deg"], found["largest_error_ratios"]
    joints = range(len(next(iter(errors.values()), ())))
    heads = [head for j in joints for head in (Column(f"joint {j + 1}"), Column("thesis"))]
    heads += [head for j in joints for head in (Column(f"/ one_layer\njoint {j + 1}"), Column("thesis"))]
    rows = []
    for name, values in errors.items():
        layers = name.removesuffix("_zero").removesuffix("_random")
        printed = found["thesis_largest_errors_deg"].get(layers)
        shares = ratios.get(name)
        two = found["thesis_largest_error_ratios"] if layers == "two_layer" and shares else None
        cells = [text for j in joints for text in (f"{values[j]:.4f}", f"{printed[j]:.4f}" if printed else "")]
        cells += [
            text for j in joints for text in (f"{shares[j]:.3f}" if shares else "", f"{two[j]:.3f}" if two else "")
        ]
        rows.append(row_of(name, *cells))
    first = Column("largest error\nencoders saw [deg]", text=True)
    title = "The largest errors that chapter 5 prints"
    return Table(title, (first, *heads), tuple(rows), (ABOUT_LARGEST,), gap=1)


def ranges_table(ranges: list[dict[str, Any]]) -> Table:
    """Smallest and largest value of every plot of the thesis's figures, each with the interval that its axis leaves."""
    met = sum(row["inside"] for row in ranges)
    unit = "deg" if all(row["unit"] == "deg" for row in ranges) else "SI"
    heads = [head for name in ("min", "max") for head in (Column(name, unit), Column("in"))]
    rows = []
    for (figure, curve), each in groupby(ranges, lambda row: (row["figure"], row["curve"])):
        by_name = {row["statistic"]: row for row in each}
        cells = (cell for name in ("min", "max") if name in by_name for cell in range_cells(by_name[name]))
        rows.append(row_of(f"{figure}  {curve.partition(' (')[0]}", *cells))
    first = Column(f"{met} of {len(ranges)} intervals of the figures met", text=True, fold=True)
    outside = () if met == len(ranges) else ("! outside of its interval.",)
    return Table("The thesis's figures", (first, *heads), tuple(rows), outside, gap=1)


def range_cells(row: dict[str, Any]) -> tuple[Cell, Cell]:
    """A value, marked where it is outside, and its interval."""
    value = "-" if row["value"] is None else f"{row['value']:.4f}"
    shown = Cell(value) if row["inside"] else Cell(value, "bad", "!")
    return shown, Cell(f"{row['lower']:g} to {row['upper']:g}")


# -- cases -------------------------------------------------------------------------------------------------------------


def render_cases(matrix: CaseMatrix, colour: bool = False, width: int = CASES_WIDTH) -> str:
    """The verdicts on all cases and what they add up to, as text of at most `width` columns."""
    controllers, t = matrix.experiment.controllers, matrix.experiment.tolerance
    heads = (Column(head, text=True, fold=True) for head in ("case", *controllers))
    rows = (
        row_of(matrix.experiment.cases[case].title, *(verdict_cell(row.get(name)) for name in controllers))
        for case, row in matrix.verdicts.items()
    )
    about = (
        f"tracked: largest true distance of the base and joint error after {t.settle:g} s, within the case's tolerance "
        f"({1000 * t.pose:g} mm, {1000 * t.joint:g} mrad unless it says otherwise). "
        f"stopped: by the supervisor, at rest at the end, less than {t.runaway:g} m away when it tripped and driven "
        "after it. FAILED: neither."
    )
    head = TextLine(f"{matrix.experiment.title or matrix.name} ({matrix.experiment.robot})", "bold")
    counts = {kind: matrix.count(kind) for kind in ("tracked", "stopped", "failed")}
    total = f"{sum(counts.values())} runs: " + ", ".join(f"{count} {kind}" for kind, count in counts.items())
    return terminal_text(
        [head, Table("Cases", tuple(heads), tuple(rows), gap=1), total, TextLine(about, "italic")], colour, width
    )


def verdict_cell(verdict: CaseVerdict | None) -> Cell:
    """A verdict in a few words: how far off the run tracked, or when and why it stopped."""
    if verdict is None:
        return Cell("-")
    words = f"{verdict.kind.upper()}: {verdict.text}"
    if verdict.kind == "tracked":
        sizes = ((verdict.pose, "mm"), (verdict.joint, "mrad"))
        words = "tracked " + ", ".join(f"{1000 * v:.3g} {unit}" for v, unit in sizes if not math.isnan(v))
    elif verdict.kind == "stopped":
        trip = re.match(r"tripped at t = (\S+) s: (.*?)(,|;|$)", verdict.text)
        words = f"stopped {trip[1]} s: {trip[2]}" if trip else f"stopped: {verdict.text}"
    return Cell(words, VERDICT_KINDS[verdict.kind])


# -- readings ----------------------------------------------------------------------------------------------------------


def render_readings(title: str, rows: list[dict[str, Any]], width: int = WIDTH) -> str:
    """The effect of each reading on the learners, as text: a line for each with RMS errors and learned shares.

    Args:
        title: Heads it.
        rows: As `cases.readings` and `summaries` give them.
        width: Columns of the terminal.
    """
    learners = [name for name, value in rows[0].items() if isinstance(value, dict)]
    first = rows[0][learners[0]]
    heads = [Column(key.partition(".")[2].removesuffix("_joint")) for key in reading_errors(first)]
    heads += [*(Column(f"share\n{part}") for part in first["learned_share"]), Column("met")]
    made = []
    for row in rows:
        for learner in learners:
            head, met = (row["reading"], f"{row['met']} of {row['of']}") if learner == learners[0] else ("", "")
            shares = ("-" if v is None else f"{v:.2f}" for v in row[learner]["learned_share"].values())
            cells = (*reading_errors(row[learner]).values(), *shares, met if row["of"] else "")
            made.append(row_of(head, learner, *cells))
    table = Table("Readings", (Column(text=True), Column(text=True), *heads), tuple(made))
    return terminal_text([TextLine(title, "bold"), table, ABOUT_READINGS], width=width)


def reading_errors(learner: dict[str, Any]) -> dict[str, str]:
    """RMS errors of pose and joints in thousandths."""
    kept = {k: value for k, value in learner["rms"].items() if not k.startswith("z.") and k not in HIDDEN_ERRORS}
    return {key: "-" if value is None else number(1e3 * value) for key, value in kept.items()}

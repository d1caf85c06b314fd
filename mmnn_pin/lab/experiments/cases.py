"""One experiment in many cases: each changes some of its keys, all controllers run in each, every run gets a verdict.

A run has either tracked within its tolerance, or was stopped safely, or failed; there is nothing in between.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import msgspec
import numpy as np

from ...errors import ConfigError, InputError, UnknownName, keyed
from ...model.robot import Robot
from ...recording.metrics import ERRORS
from ...recording.recording import Recording, as_columns
from ...settings import finite
from ...torque.neural import THESIS_INPUT
from .config import E, config_error, merged, on_other_hardware, require_disturbances
from .controllers import LEARNERS
from .experiment import Experiment, Tolerance
from .result import Result
from .runner import require_free, require_runnable, run_experiment

AT_END = 0.1  # of a stopped run, in which the robot must be at rest [s]


@dataclass(frozen=True)
class CaseVerdict:
    """Verdict on a run of a case."""

    # `tracked` within its tolerance, `stopped` safely, or `failed`
    kind: Literal["tracked", "stopped", "failed", "interrupted"]
    text: str  # why, in a few words
    pose: float  # largest true distance from the reference after settling [m]; nan for a fixed arm
    heading: float  # largest true heading error after settling [rad]; nan for a fixed arm
    joint: float  # largest true error of an arm joint after settling [rad or m]; nan without an arm


@dataclass(frozen=True)
class CaseMatrix:
    """All cases of an experiment."""

    experiment: Experiment  # the experiment without its cases
    name: str  # its name
    results: dict[str, Result]  # case to result
    verdicts: dict[str, dict[str, CaseVerdict]]  # case to controller to verdict

    @property
    def completed(self) -> bool:
        """Whether no run failed."""
        return not self.count("failed") and not self.interrupted

    @property
    def interrupted(self) -> bool:
        """Whether the user stopped it."""
        return bool(self.count("interrupted"))

    def count(self, kind: str) -> int:
        """Number of runs with a verdict."""
        return sum(verdict.kind == kind for row in self.verdicts.values() for verdict in row.values())

    def to_dict(self) -> dict[str, Any]:
        """The matrix as the command line's JSON object."""
        runs = {
            f"{case}/{name}": about
            for case, result in self.results.items()
            for name, about in result.to_dict()["runs"].items()
        }
        cells = {
            case: {
                name: msgspec.to_builtins(verdict)
                | {k: finite(getattr(verdict, k)) for k in ("pose", "heading", "joint")}
                for name, verdict in row.items()
            }
            for case, row in self.verdicts.items()
        }
        counts = {kind: self.count(kind) for kind in ("tracked", "stopped", "failed")}
        comparison = {"cases": {c: self.experiment.cases[c].title for c in cells}, "verdicts": cells, "counts": counts}
        return {"experiment": self.name, "robot": self.experiment.robot, "runs": runs, "comparison": comparison}


def with_case(experiment: E, name: str) -> E:
    """The experiment as one of its cases changes it.

    Raises:
        ConfigError: The case sets an unknown key, or a value of the wrong type or range.
    """
    case = experiment.cases[name]
    table = case.set if case.experiment else merged(msgspec.to_builtins(experiment) | {"cases": {}}, case.set)
    try:
        require_disturbances(table.get("disturbances"))
        if "hardware" in case.set and not case.experiment:
            return on_other_hardware(experiment, table, case.set)
        return msgspec.convert(table, type(experiment))
    except msgspec.ValidationError as error:
        found = config_error(error, table, type(experiment))
        raise found.but(key=f"cases.{name}.set.{found.key or ''}".rstrip(".")) from error
    except InputError as error:
        raise error.but(key=f"cases.{name}.set.{error.key or ''}".rstrip(".")) from error


def chosen_cases(experiment: E, names: Sequence[str]) -> E:
    """The experiment with some of its cases; with all where none are named.

    Raises:
        ConfigError: It has no cases.
        UnknownName: It has no such case.
    """
    if not names:
        return experiment
    if not experiment.cases:
        raise ConfigError("has no cases", fix="leave --case out", key="--case")
    for name in names:
        if name not in experiment.cases:
            raise UnknownName("case", name, experiment.cases, key="--case")
    return msgspec.structs.replace(experiment, cases={name: experiment.cases[name] for name in dict.fromkeys(names)})


def run_cases(
    experiment: Experiment,
    name: str,
    *,
    out: Path | None = None,
    force: bool = False,
    progress: Callable[[str, float], None] | None = None,
    understood: Callable[[Robot], None] | None = None,
) -> CaseMatrix:
    """Run all controllers in every case of an experiment; arguments and errors as in `run_experiment`.

    Recordings go to `out/CASE/CONTROLLER.h5`. All cases are read before the first is run.
    """
    cases = {case: with_case(experiment, case) for case in experiment.cases}
    for case, changed in cases.items():
        with keyed(lambda key, case=case: f"cases.{case}: {key}".rstrip(": ")):  # type: ignore[misc]
            require_settled(changed)
            require_runnable(changed, changed.load_robot())
    require_free([out / case / f"{c}.h5" for case in cases for c in experiment.controllers] if out else [], force)
    results: dict[str, Result] = {}
    verdicts: dict[str, dict[str, CaseVerdict]] = {}
    for i, (case, changed) in enumerate(cases.items()):

        def show(controller: str, fraction: float, done: int = i) -> None:
            if progress is not None:
                progress(name, (done + fraction / len(experiment.controllers)) / len(cases))

        folder = out / case if out else None
        told = understood if i == 0 else None
        results[case] = run_experiment(
            changed, f"{name}/{case}", out=folder, force=force, progress=show, understood=told
        )
        verdicts[case] = {
            controller: judge(recording, changed.tolerance)
            for controller, recording in results[case].recordings.items()
        }
        if any(verdict.kind == "interrupted" for verdict in verdicts[case].values()):
            break
    return CaseMatrix(experiment, name, results, verdicts)


def require_settled(experiment: Experiment) -> None:
    """Refuse a run that is over before its errors count: any would do (`ConfigError`)."""
    settle, end = experiment.tolerance.settle, experiment.time.duration
    if settle >= end:
        raise ConfigError(
            f"{settle:g} s",
            why=f"errors count from then on, and the run is over after {end:g} s",
            fix="use a time within the run",
            key="tolerance.settle",
        )


def judge(recording: Recording, tolerance: Tolerance) -> CaseVerdict:
    """Verdict on one run, by its true errors."""
    time, outcome = recording["time"], recording.outcome
    pose, heading, joint = (worst(error, time >= tolerance.settle) for error in true_errors(recording))

    def verdict(kind: Literal["tracked", "stopped", "failed", "interrupted"], text: str) -> CaseVerdict:
        return CaseVerdict(kind, text, pose, heading, joint)

    if outcome.status == "interrupted":
        return verdict("interrupted", outcome.message)
    broken = [name for name in recording if not np.isfinite(recording[name]).all()]
    if broken:
        return verdict("failed", f"{', '.join(broken)} not finite")
    if outcome.status == "tripped":
        unsafe = dangers(recording, tolerance)
        return verdict("failed", f"stopped, but {unsafe[0]}") if unsafe else verdict("stopped", outcome.message)
    if outcome.status != "completed":
        return verdict("failed", outcome.message)
    limits = {"pose": tolerance.pose, "heading": tolerance.heading, "joint": tolerance.joint}
    over = [
        f"{what} {value:.3g} over {limit:g}"
        for (what, limit), value in zip(limits.items(), (pose, heading, joint), strict=True)
        if value > limit
    ]
    return verdict("failed", f"not stopped: {', '.join(over)}") if over else verdict("tracked", "within its tolerance")


def true_errors(recording: Recording) -> tuple[Any, Any, Any]:
    """Distance of the base from its reference, heading error, largest joint error, (N,) each or None."""
    has_base = "true_pose_error" in recording and recording["true_pose_error"].size
    error = recording["true_pose_error"] if has_base else None
    has_arm = "true_e" in recording and recording["true_e"].size
    joint = np.abs(as_columns(recording["true_e"])).max(axis=1) if has_arm else None
    return (
        None if error is None else np.hypot(error[:, 0], error[:, 1]),
        None if error is None else np.abs(error[:, 2]),
        joint,
    )


def worst(values: Any, inside: Any) -> float:
    """Largest of the values that count; nan if there are none."""
    return float(np.max(values[inside])) if values is not None and inside.any() else float("nan")


def dangers(recording: Recording, tolerance: Tolerance) -> list[str]:
    """Dangers of a stop, in words: the robot still moved at its end, or was too far from its reference."""
    time, position = recording["time"], recording["position"]
    base = len(recording.labels("z")) if "z" in recording else 0
    last = np.abs(as_columns(recording["nu"])[time >= time[-1] - AT_END]).max(axis=0)
    found = [f"the base moves at {v:.3g}" for v in last[:base] if v > tolerance.speed]
    found += [f"the arm moves at {v:.3g}" for v in last[base:] if v > tolerance.joint_speed]
    if base:
        at = int(np.searchsorted(time, recording.outcome.time - 1e-9))
        away = true_errors(recording)[0][at]
        driven = float(np.hypot(*(position[at:, :2] - position[at, :2]).T).max())
        found += [f"it was {away:.3g} m away when it tripped"] if away > tolerance.runaway else []
        found += [f"it drove {driven:.3g} m after the trip"] if driven > tolerance.runaway else []
    return found


APPENDIX_B_SHORT = ("alpha", "alphadot", "e", "r", "q_ref", "qdot_ref", "qddot_ref")


@dataclass(frozen=True)
class Switch:
    """A key of an experiment and the two values between which the thesis leaves a choice."""

    key: str  # key path, `section.name`
    first: tuple[Any, str]  # one value, and how the table calls it
    second: tuple[Any, str]  # the other

    def turned(self, experiment: Experiment) -> tuple[str, Experiment]:
        """The experiment with this switch in its other place, and what that is called."""
        section, _, name = self.key.partition(".")
        settings = getattr(experiment, section)
        value, words = self.second if getattr(settings, name) == self.first[0] else self.first
        return words, msgspec.structs.replace(
            experiment, **{section: msgspec.structs.replace(settings, **{name: value})}
        )


WITHOUT_POSITION = tuple(name for name in THESIS_INPUT if name != "pose_ref")
SWITCHES = (
    Switch("learning.rates", ("per_sample", "rates per sample"), ("per_second", "rates per second")),
    Switch("two_layer.initial", ("random", "weights from random"), ("zero", "weights from zero")),
    Switch("learning.update", ("after_output", "update after output"), ("before_output", "update before output")),
    Switch("inputs.constant_yaw_rate", (None, "wd in the input"), (5.0, "wd = 5 in the input")),
    Switch("inputs.pose_error", ("body", "body-frame pose error"), ("world", "world-frame pose error")),
    Switch("inputs.signals", (THESIS_INPUT, "input (3.24)"), (WITHOUT_POSITION, "no absolute position")),
    Switch("inputs.signals", (THESIS_INPUT, "input (3.24)"), (APPENDIX_B_SHORT, "Appendix B's short input")),
)


def readings(
    experiment: Experiment, name: str, progress: Callable[[str, float], None] | None = None
) -> dict[str, Result]:
    """All learners with the experiment as it is, then with one reading changed at a time, in memory.

    Args:
        experiment: Where to start from.
        name: Its name.
        progress: Called before each reading with `readings` and the fraction done.

    Raises:
        KeyboardInterrupt: Ctrl-C during a run.
    """
    learners = tuple(name for name in experiment.controllers if name in LEARNERS)
    base = msgspec.structs.replace(experiment, controllers=learners or ("two_layer", "one_layer"))
    cases = {"as it is": base} | dict(switch.turned(base) for switch in SWITCHES)
    found = {}
    for i, (words, case) in enumerate(cases.items()):
        if progress is not None:
            progress("readings", i / len(cases))
        found[words] = result = run_experiment(case, name)
        if any(recording.outcome.status == "interrupted" for recording in result.recordings.values()):
            raise KeyboardInterrupt
    return found


def summaries(results: dict[str, Result]) -> list[dict[str, Any]]:
    """Per reading, for JSON: RMS errors of the last window, learned shares, the figures' intervals."""
    return [{"reading": words, **effects(result)} for words, result in results.items()]


def effects(result: Result) -> dict[str, Any]:
    """Per learner its outcome, RMS errors of the last window and learned shares; the intervals met and compared."""
    window = ".rms_{:g}_{:g}".format(*result.experiment.windows[-1])
    every, ranges = result.to_dict()["runs"], result.figure_ranges()
    numbers = {
        learner: {
            "outcome": every[learner]["outcome"],
            "rms": {
                key.removesuffix(window): value
                for key, value in every[learner]["metrics"].items()
                if key.startswith(ERRORS) and key.endswith(window)
            },
            "learned_share": {
                key.partition(".")[2]: value
                for key, value in every[learner]["metrics"].items()
                if key.startswith("learned_share")
            },
        }
        for learner in every
    }
    return {**numbers, "figure_ranges": ranges, "met": sum(row["inside"] for row in ranges), "of": len(ranges)}

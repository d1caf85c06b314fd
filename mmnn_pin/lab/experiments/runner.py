"""Runs all controllers of an experiment from equal starts and compares them.

How much of a learner's advantage over PD is gain, and how much is learning? A learner's robust term adds feedback, so
part of what it wins it would win without its network. PD at the learner's own effective gain, sample by sample, has
the one and not the other:

    pd -> learner  =  (pd -> pd at the learner's effective gain)  +  (pd at that gain -> learner)
      improvement  =                  gain                        +            learning
"""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import msgspec
import numpy as np

from ...errors import RecordingError
from ...model.robot import Robot
from ...recording.metrics import metrics
from ...recording.recording import Recording, as_columns
from ...reference import warnings
from ...settings import finite
from ...torque.controller import TorqueController
from .controllers import EFFECTIVE, LEARNERS, effective
from .experiment import Experiment
from .hand import HandErrors, hand_errors, hand_motion
from .thesis import beside_the_thesis, figure_ranges


@dataclass(frozen=True)
class Result:
    """What an experiment gave.

    Attributes:
        experiment: The experiment.
        name: Its name.
        recordings: Controller to recording, in the order asked for.
        metrics: Controller to numbers (see `metrics`).
        notes: What the user should know.
        hand: Controller to what it did at the hand, where the reference is a hand's.
    """

    experiment: Experiment
    name: str
    recordings: dict[str, Recording]
    metrics: dict[str, dict[str, float]]
    notes: tuple[str, ...]
    hand: dict[str, HandErrors] = field(default_factory=dict)

    @property
    def completed(self) -> bool:
        """Whether every run reached its end."""
        return all(recording.outcome.status == "completed" for recording in self.recordings.values())

    def to_dict(self) -> dict[str, Any]:
        """The result as the command line's JSON object."""
        runs = {
            name: {
                "file": str(recording.path) if recording.path else None,
                "outcome": recording.outcome.status,
                "message": recording.outcome.message,
                "metrics": {key: finite(value) for key, value in self.metrics[name].items()},
            }
            for name, recording in self.recordings.items()
        }
        comparison = {
            "relative_to_pd": self.relative_to("pd"),
            "torque_limits": self.torque_limits(),
            "improvement": {
                learner: {row: {key: finite(value) for key, value in i.to_dict().items()} for row, i in rows.items()}
                for learner, rows in self.improvements().items()
            },
            "figure_ranges": self.figure_ranges(),
            **self.largest_errors(),
            **({"hand": {name: errors.numbers() for name, errors in self.hand.items()}} if self.hand else {}),
            "unfair": unfair(self.experiment, self.metrics),
            "notes": list(self.notes),
        }
        about = {"experiment": self.name, "variant": self.experiment.variant, "robot": self.experiment.robot}
        return about | {"runs": runs, "comparison": comparison}

    def improvements(self) -> dict[str, dict[str, Improvement]]:
        """What of each learner's improvement over PD is gain and what is learning, see `improvements`."""
        return improvements(self.metrics, self.experiment.windows)

    def figure_ranges(self) -> list[dict[str, Any]]:
        """The runs beside the intervals of the thesis's figures that this experiment is compared with."""
        figures = tuple(name.removeprefix("figure-") for name in self.experiment.plots if name.startswith("figure-"))
        return [row for row in figure_ranges(self.recordings) if row["figure"].startswith(figures)]

    def largest_errors(self) -> dict[str, Any]:
        """The runs beside the largest errors that chapter 5 prints; empty for an experiment without its figure 5.5."""
        return beside_the_thesis(self.recordings) if "figure-5.5" in self.experiment.plots else {}

    def torque_limits(self) -> list[dict[str, Any]]:
        """Per actuator its effort limit (None without one) and every controller's peak torque [N m or N].

        The torque is the one that the motors gave, where they are simulated.
        """
        if not self.recordings:
            return []
        first = next(iter(self.recordings.values()))
        limits = first.meta["effort_limits"]
        given = {name: "applied" if "applied" in r else "motor_torque" for name, r in self.recordings.items()}
        peaks = {name: as_columns(r[given[name]]) for name, r in self.recordings.items() if len(r)}
        return [
            {
                "actuator": actuator,
                "limit": finite(limit),
                "peak": {name: finite(abs(torque[:, i]).max()) for name, torque in peaks.items()},
            }
            for i, (actuator, limit) in enumerate(zip(first.meta["actuator_names"], limits, strict=True))
        ]

    def relative_to(self, other: str) -> dict[str, dict[str, float | None]]:
        """Every error metric of every controller divided by that of another one; empty without it."""
        if other not in self.metrics:
            return {}
        base = self.metrics[other]
        return {
            name: {
                key: finite(value / base[key]) if base.get(key) else None
                for key, value in numbers.items()
                if key.endswith("peak") or ".rms_" in key
            }
            for name, numbers in self.metrics.items()
            if name != other
        }


def run_experiment(
    experiment: Experiment,
    name: str,
    *,
    out: Path | None = None,
    force: bool = False,
    progress: Callable[[str, float], None] | None = None,
) -> Result:
    """Run every controller of an experiment; a diverged run is part of the result.

    Args:
        experiment: The experiment.
        name: Its name, for the recordings.
        out: Folder for the recordings, one HDF5 file per controller; None keeps them in memory.
        force: Replace existing recordings.
        progress: Called now and then with the controller and the fraction done.

    Raises:
        InputError: Bad robot, reference or gains, or recordings that exist; nothing has been written then.
    """
    wanted = experiment.controllers
    files = {controller: out / f"{controller}.h5" if out else None for controller in wanted}
    robot = experiment.load_robot()
    config = msgspec.structs.replace(experiment, overrides=robot.overrides).to_json()
    require_runnable(experiment, robot)
    require_free([file for file in files.values() if file], force)
    runs: dict[str, Recording] = {}
    notes = [*window_notes(experiment), *reference_notes(experiment, robot)]
    duration, learners = experiment.time.duration, effective(wanted)
    for controller in in_order(wanted):
        learner = runs.get(learners.get(controller, ""))
        if learner is not None and not len(learner):
            notes.append(f"{controller} was not run: {learners[controller]} ended before its first sample")
            continue
        gains = None if learner is None else as_columns(learner["effective_gain"])
        loop = experiment.loop(robot, experiment.controller(controller, gains, robot))
        notes += [note for note in loop.controller.notes if note not in notes]
        runs[controller] = loop.run(
            files.get(controller),
            force=force,
            meta={"experiment": name, "config": config, "delay_margin": finite(loop.delay_margin())},
            progress=None if progress is None else lambda t, c=controller: progress(c, t / duration),  # type: ignore[misc]
        )
        if runs[controller].outcome.status == "interrupted":
            break
    kept = {controller: runs[controller] for controller in wanted if controller in runs}
    numbers = {controller: metrics(recording, experiment.windows) for controller, recording in kept.items()}
    hand, tables = {}, experiment.reference.hand
    if tables is not None:
        hand = {c: hand_errors(recording, robot, tables, experiment.time) for c, recording in kept.items()}
        notes += hand_notes(experiment, robot)
    return Result(experiment, name, kept, numbers, (*notes, *margin_notes(experiment, kept)), hand)


def margin_notes(experiment: Experiment, runs: Mapping[str, Recording]) -> list[str]:
    """Which controllers bear less delay beside their latency than the experiment wants."""
    margins = {name: run.meta["delay_margin"] for name, run in runs.items()}
    least = experiment.latency.margin + experiment.latency.total
    short = {name: m for name, m in margins.items() if m is not None and m < least}
    if not short:
        return []
    worst = min(short, key=short.__getitem__)
    these = worst if len(short) == 1 else f"{len(short)} controllers, least {worst}"
    return [f"delay margin below {1e3 * least:.3g} ms: {these} {1e3 * short[worst]:.3g} ms; see latency.margin"]


def in_order(wanted: Sequence[str]) -> list[str]:
    """Controllers in the order to run them: a learner before the PD that takes its effective gain."""
    learners = [learner for name, learner in effective(wanted).items() if name in wanted]
    first = [name for name in wanted if name not in EFFECTIVE]
    missing = [name for name in dict.fromkeys(learners) if name not in first]
    return [*first, *missing, *(name for name in wanted if name in EFFECTIVE)]


def require_runnable(experiment: Experiment, robot: Robot) -> None:
    """Refuse what cannot run, before anything is written.

    Raises:
        InputError: Bad reference, gains or blocks.
    """
    for controller in in_order(experiment.controllers):
        if controller not in EFFECTIVE:
            loop = experiment.loop(robot, experiment.controller(controller, robot=robot))
            loop.require_stable_gains()
            loop.start.state(robot, loop.table()[0])
            if isinstance(loop.controller, TorqueController):
                loop.rehearse()
            if experiment.plant == "contact" or loop.layout.hardware or not loop.sensor.exact:
                loop.engine_at()


def require_free(files: Sequence[Path], force: bool) -> None:
    """Refuse to write where recordings are, before anything is written; folders are made with their first recording.

    Raises:
        RecordingError: A file exists and `force` is off, or the folder cannot be made or written to.
    """
    for file in files:
        if file.exists() and not force:
            raise RecordingError(
                "the recording exists", fix="choose another folder with --out, or replace it with --force", file=file
            )
    for folder in {file.parent for file in files}:
        existing = next(place for place in (folder, *folder.parents) if place.exists())
        if not existing.is_dir():
            raise RecordingError("the folder cannot be made", why="there is a file of that name", file=existing)
        if not os.access(existing, os.W_OK):
            raise RecordingError("the folder cannot be written to", fix="choose another with --out", file=existing)


Window = tuple[float, float]


def window_notes(experiment: Experiment) -> list[str]:
    """What to know of windows that lie beyond the end of a run or go on after it; nothing where all are within."""
    end = experiment.time.duration
    beyond = [window for window in experiment.windows if window[0] >= end]
    cut = [window for window in experiment.windows if window[0] < end < window[1]]
    found = []
    if beyond:
        found.append(f"no errors in {words(beyond)}: the run is over after {end:g} s; --set windows=... for others")
    if cut:
        found.append(f"errors in {words(cut)} count to the end of the run, {end:g} s")
    return found


def words(windows: Sequence[Window]) -> str:
    """Windows in words."""
    return "the window" + "s" * (len(windows) > 1) + " " + ", ".join(f"{start:g}-{stop:g} s" for start, stop in windows)


def reference_notes(experiment: Experiment, robot: Robot) -> list[str]:
    """What to know of the reference, such as stretches without stabilisation."""
    if experiment.reference.hand is not None:
        return []
    reference, notes = experiment.trajectory_of(robot), []
    path, times = reference.base, np.arange(experiment.time.samples) * experiment.time.control_period
    if reference.slowness > 1.0:
        notes.append(f"the reference takes {reference.slowness:.3g} times as long: the motors' limits ask for it")
    return notes + (warnings(path.sample(times / reference.slowness)) if path is not None else [])


def hand_notes(experiment: Experiment, robot: Robot) -> list[str]:
    """What to know of a motion of the hand: the frame, how far the program itself stays from the path, misses."""
    assert experiment.reference.hand is not None
    motion = hand_motion(experiment.reference.hand, robot, experiment.time)
    begins, ends, missed = motion.begins, motion.ends, motion.misses
    gap = 1e3 * float(motion.gap[round(begins / experiment.time.control_period) :].max())
    follows = f"{motion.frames[0]} follows its path from t = {begins:.3g} s to {ends:.3g} s"
    found = [f"{follows}; the reference's own distance from it is at most {gap:.2g} mm"]
    return [*found, *([f"the program of the hand had no solution at {missed} samples: it braked"] if missed else [])]


@dataclass(frozen=True)
class Improvement:
    """A learner's RMS error beside that of PD and of PD at its effective gain, in the error's unit.

    Attributes:
        pd: RMS error of PD.
        pd_effective: RMS error of PD at the learner's effective gain.
        learner: RMS error of the learner.
    """

    pd: float
    pd_effective: float
    learner: float

    @property
    def total(self) -> float:
        """`pd - learner`; negative where the learner is worse."""
        return self.pd - self.learner

    @property
    def gain(self) -> float:
        """What the higher gain alone takes away from PD's error; negative where it adds to it."""
        return self.pd - self.pd_effective

    @property
    def learning(self) -> float:
        """What the network takes away from there; negative where it adds to it."""
        return self.pd_effective - self.learner

    @property
    def learning_share(self) -> float | None:
        """`learning / total`; above 1 or below 0 where the two work against each other.

        None where there is no improvement to share, or no numbers.
        """
        return self.learning / self.total if self.total > 0 else None

    def to_dict(self) -> dict[str, float | None]:
        """Numbers for JSON; shares are None where the learner is not better than PD."""
        learning = self.learning_share
        return {
            "pd": self.pd,
            "pd_effective": self.pd_effective,
            "learner": self.learner,
            "improvement": self.total,
            "gain": self.gain,
            "learning": self.learning,
            "gain_share": None if learning is None else 1.0 - learning,
            "learning_share": learning,
        }


def improvements(
    metrics: Mapping[str, Mapping[str, float]], windows: tuple[tuple[float, float], ...]
) -> dict[str, dict[str, Improvement]]:
    """Learner to error (`pose_error.x`) to its improvement over PD, in the RMS of the last window.

    Learners without PD and PD at their effective gain beside them are left out.

    Args:
        metrics: Controller to numbers, see `metrics`.
        windows: Windows of the RMS errors [s].
    """
    if not windows or "pd" not in metrics:
        return {}
    ending = ".rms_{:g}_{:g}".format(*windows[-1])
    rows = [key.removesuffix(ending) for key in metrics["pd"] if key.endswith(ending)]
    return {
        learner: {
            row: Improvement(*(float(metrics[name][row + ending]) for name in ("pd", pd, learner))) for row in rows
        }
        for pd, learner in effective(metrics).items()
        if pd in metrics and learner in metrics
    }


def unfair(experiment: Experiment, metrics: Mapping[str, Mapping[str, float]]) -> str:
    """Why the learners are not compared on equal terms, with their mean effective gains; empty if they are.

    Args:
        experiment: The experiment; its learners' robust terms and hidden units are compared.
        metrics: Controller to numbers, see `metrics`.
    """
    names = [name for name in LEARNERS if name in metrics]
    reasons = []
    if len({experiment.robust_term(name) for name in names}) > 1 and experiment.learning.robust_term:
        reasons.append("each learner has a robust term of its own")
    if len({getattr(experiment, "one_layer" if name == "one_layer" else "two_layer").hidden for name in names}) > 1:
        reasons.append("the networks differ in size")
    if not reasons:
        return ""
    gains = ", ".join(
        f"{part} {' against '.join(f'{metrics[name][key]:.4g}' for name in names)}"
        for part in ("base", "arm")
        if (key := f"effective_gain.{part}") in metrics[names[0]]
    )
    return f"not a fair comparison: {' and '.join(reasons)}; mean effective gain {gains} ({' against '.join(names)})"

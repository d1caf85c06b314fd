"""The result of an experiment, from recordings alone."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from ....errors import RecordingError
from ....recording.metrics import metrics
from ....recording.recording import Recording
from ....settings import Timing
from ...experiments.config import recorded_experiment
from ...experiments.controllers import CONTROLLERS
from ...experiments.experiment import Experiment
from ...experiments.references import ReferenceTables
from ...experiments.runner import Result

EARLY = 0.2  # without an experiment, the start counts as over after this share of the run


def result_of(recordings: Mapping[str, Recording]) -> Result:
    """Metrics of runs by name, in the order in which experiments have their controllers; windows of the first run.

    Raises:
        RecordingError: No run, one without rows or control period, or runs of robots with different velocities.
    """
    if not recordings:
        raise RecordingError("nothing to report", why="no recording was given")
    first = next(iter(recordings.values()))
    for name, recording in recordings.items():
        if not len(recording):
            why = "the run ended before its first sample"
            raise RecordingError(f"{name} holds no rows", why=why, file=recording.path)
        if "control_period" not in recording.meta:
            raise RecordingError(f"{name} does not tell its control period", file=recording.path)
        if recording.labels("torque") != first.labels("torque"):
            here, there = ", ".join(recording.labels("torque")), ", ".join(first.labels("torque"))
            why = f"it moves in {here}; {next(iter(recordings))} in {there}"
            raise RecordingError(f"{name} is of another robot", why=why, fix="report them apart", file=recording.path)
    places = {controller: place for place, controller in enumerate(CONTROLLERS)}
    runs = dict(sorted(recordings.items(), key=lambda item: places.get(controller_of(*item), len(places))))
    experiment = experiment_of(max(runs.values(), key=len))
    numbers = {name: metrics(recording, experiment.windows) for name, recording in runs.items()}
    return Result(experiment, str(first.meta.get("experiment", "")), runs, numbers, ())


def controller_of(name: str, recording: Recording) -> str:
    """Controller of a recording."""
    return str(recording.meta.get("controller", name))


def experiment_of(recording: Recording) -> Experiment:
    """The experiment of a recording; without a config one that says as much as the recording does."""
    if (experiment := recorded_experiment(recording)) is not None:
        return experiment
    period = float(recording.meta["control_period"])
    duration = len(recording) * period
    facts: dict[str, Any] = {"robot": str(recording.meta.get("robot", "")), "seed": int(recording.meta.get("seed", 0))}
    return Experiment(
        reference=ReferenceTables(),
        windows=((0.0, EARLY * duration), (EARLY * duration, duration)),
        time=Timing(duration=duration, control_period=period, plant_step=period),
        plant=str(recording.meta.get("plant", "ideal")),
        plots=(),
        **facts,
    )

"""The report: one HTML page with the verdict, the numbers, the plots, the replay, the robots and where it comes from.

It needs recordings alone: what they do not say of their experiment is taken as it must have been.
"""

from __future__ import annotations

import json
import shlex
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

import msgspec

from ....errors import InputError, RecordingError
from ....recording.metrics import metrics
from ....recording.recording import Recording
from ....settings import Timing
from ...experiments.config import bundled, load_experiment, recorded_experiment
from ...experiments.controllers import CONTROLLERS
from ...experiments.experiment import Experiment
from ...experiments.references import ReferenceTables
from ...experiments.runner import Result
from .. import replay
from ..comparison import tables_of
from ..curves import controller_of
from ..figure import run_label, styles_of
from ..files import HtmlPage, fill_template, web_file
from ..replay.page import title_of
from ..robots import CHECK_SAMPLES, CHECK_SEED, RobotShown, robots_of
from .charts import Charts, dash
from .verdict import proved, verdict

FPS = 30.0  # of the replay within
EARLY = 0.2  # without an experiment, the start counts as over after this share of the run
OWN = ("variant", "overrides", "title")  # keys that no `--set` changes


@dataclass(frozen=True)
class Report(HtmlPage):
    """A report.

    Attributes:
        html: The whole page.
        warnings: What of the runs could not be shown, one line each.
    """

    warnings: tuple[str, ...] = ()

    what: ClassVar[str] = "report"

    def _repr_html_(self) -> str:
        """The page within a notebook, isolated from it."""
        return self.within("80vh")


def report(
    recordings: Mapping[str, Recording],
    *,
    command: str = "",
    with_replay: bool = True,
    package_dirs: Sequence[str | Path] = (),
) -> Report:
    """The report on some runs of one task.

    Args:
        recordings: The runs by name, best by controller.
        command: The command that makes this page, to be shown in it.
        with_replay: Whether the replay is in it.
        package_dirs: Folders to look for the replay's meshes in.

    Raises:
        RecordingError: No run, one without rows, or runs of robots with different velocities.
    """
    result = result_of(recordings)
    charts = Charts(result.recordings)
    robots, remarks = robots_in(result.recordings)
    replayed, more = replay_of(result.recordings, package_dirs) if with_replay else (None, ())
    text = fill_template(
        "report.html",
        title=result.experiment.title or title_of(result.recordings) or "Report",
        subject=subject(result),
        verdict=verdict(result),
        runs=runs_of(result),
        tables=list(tables_of(result)),
        charts=charts,
        proved=proved(result.recordings),
        data=charts.pack(),
        replay=replayed,
        robots=robots,
        checks={"samples": CHECK_SAMPLES, "seed": CHECK_SEED},
        facts=list(origin_facts(result.recordings)),
        commands=[line for line in (command_of(result), command) if line],
        config=config_of(result),
        unpack=web_file("unpack.js", replay.__name__),
    )
    return Report(text, (*charts.skipped, *remarks, *more))


def subject(result: Result) -> str:
    """What was run on which robot, for how long, in one line."""
    experiment = result.experiment
    robots = dict.fromkeys(str(recording.meta.get("robot", "")) for recording in result.recordings.values())
    parts = [result.name, f"variant {experiment.variant}" if experiment.variant else "", ", ".join(robots)]
    parts += [f"{experiment.time.duration:g} s", f"seed {experiment.seed}", f"{experiment.plant} plant"]
    return " \u00b7 ".join(part for part in parts if part)


def runs_of(result: Result) -> list[dict[str, str]]:
    """Every run: its name, what its controller is, its colour and dashes as in the pictures.

    Black gives way to white in the dark.
    """
    runs = []
    for name, style in styles_of(result.recordings).items():
        recording = result.recordings[name]
        about = CONTROLLERS.get(controller_of(name, recording), "a controller of your own")
        look = {"dash": dash(style.dash[1]), "color": style.color, "dark": in_the_dark(style.color)}
        runs.append({"name": run_label(name, recording), "about": about, **look})
    return runs


def in_the_dark(color: str) -> str:
    """A colour on a dark ground: itself, but for black."""
    return "#ffffff" if color == "#000000" else color


def config_of(result: Result) -> str:
    """The config of the first run, indented; empty without one."""
    text = next(iter(result.recordings.values())).config_text
    return json.dumps(json.loads(text), indent=2, ensure_ascii=False) if text else ""


def robots_in(recordings: Mapping[str, Recording]) -> tuple[list[RobotShown], tuple[str, ...]]:
    """The robots of some runs, or why they cannot be shown."""
    try:
        return robots_of(recordings), ()
    except InputError as error:
        return [], (f"no robot: {' '.join(str(error).split())}",)


def replay_of(
    recordings: Mapping[str, Recording], package_dirs: Sequence[str | Path]
) -> tuple[dict[str, Any] | None, tuple[str, ...]]:
    """The page of the replay with its size, and remarks; None where the runs have nothing to replay."""
    try:
        made = replay.page(recordings, fps=FPS, package_dirs=package_dirs)
    except InputError as error:
        return None, (f"no replay: {' '.join(str(error).split())}",)
    return {"html": made.html, "megabytes": f"{made.size / 1e6:.1f}", "warnings": made.warnings}, made.warnings


# -- the result of recordings ------------------------------------------------------------------------------------------


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
            raise RecordingError(f"{name} does not have its control period", file=recording.path)
        if recording.labels("torque") != first.labels("torque"):
            here, there = ", ".join(recording.labels("torque")), ", ".join(first.labels("torque"))
            why = f"it moves in {here}; {next(iter(recordings))} in {there}"
            raise RecordingError(f"{name} is of another robot", why=why, fix="report them apart", file=recording.path)
    places = {controller: place for place, controller in enumerate(CONTROLLERS)}
    runs = dict(sorted(recordings.items(), key=lambda item: places.get(controller_of(*item), len(places))))
    experiment = experiment_of(max(runs.values(), key=len))
    numbers = {name: metrics(recording, experiment.windows) for name, recording in runs.items()}
    return Result(experiment, str(first.meta.get("experiment", "")), runs, numbers, ())


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


# -- where it comes from -----------------------------------------------------------------------------------------------


def command_of(result: Result) -> str:
    """The command that makes these runs again; empty where none does, such as for an experiment of a file."""
    if result.name not in bundled() or not all(recording.config_text for recording in result.recordings.values()):
        return ""
    experiment = result.experiment
    try:
        settings = changes(load_experiment(result.name, (), experiment.variant or None), experiment)
        again = load_experiment(result.name, settings, experiment.variant or None)
        default = load_experiment(result.name).variant
    except InputError:
        return ""
    if msgspec.structs.replace(again, overrides=experiment.overrides) != experiment:
        return ""
    variant = ["--variant", experiment.variant] if experiment.variant not in ("", default) else []
    return shlex.join(["mmnn", "run", result.name, *variant, *(p for text in settings for p in ("--set", text))])


def changes(one: Experiment, other: Experiment) -> list[str]:
    """What `--set` makes of one experiment another, as `key.path=value`."""
    before, after = (flat(msgspec.to_builtins(experiment)) for experiment in (one, other))
    return [
        f"{key}={json.dumps(value)}" for key, value in after.items() if before.get(key) != value and value is not None
    ]


def flat(table: Mapping[str, Any], path: str = "") -> dict[str, Any]:
    """Values of a table of tables by key path."""
    found: dict[str, Any] = {}
    for key, value in table.items():
        if isinstance(value, dict) and value:
            found |= flat(value, f"{path}{key}.")
        elif path or key not in OWN:
            found[path + key] = value
    return {key: value for key, value in found.items() if not key.startswith("overrides.")}


def origin_facts(recordings: Mapping[str, Recording]) -> Iterator[tuple[str, str]]:
    """Facts with their names, once where all runs share them, else per run."""
    metas = {name: recording.meta for name, recording in recordings.items()}
    made = sorted(str(meta["created"]) for meta in metas.values() if "created" in meta)
    if made:
        yield "made", made[0] if made[0] == made[-1] else f"{made[0]} to {made[-1]}"
    keys = {"seed": "seed", "control_period": "control period [s]", "loop": "loop", "plant": "plant"}
    keys |= {"urdf_sha256": "sha256 of the URDF"}
    for key, words in keys.items():
        yield words, shared({name: str(meta.get(key, "-")) for name, meta in metas.items()})
    yield "samples", shared({name: f"{len(recording):,}" for name, recording in recordings.items()})
    yield (
        "files",
        ", ".join(recording.path.name if recording.path else "in memory" for recording in recordings.values()),
    )
    versions = {name: meta.get("versions", {}) for name, meta in metas.items()}
    yield "versions", shared({name: ", ".join(f"{k} {v}" for k, v in each.items()) for name, each in versions.items()})


def shared(facts: Mapping[str, str]) -> str:
    """One fact for all runs, or one per run."""
    return (
        next(iter(facts.values())) if len(set(facts.values())) == 1 else "; ".join(f"{k} {v}" for k, v in facts.items())
    )

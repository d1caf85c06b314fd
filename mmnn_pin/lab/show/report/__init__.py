"""The report: one HTML page that shows a colleague what was run, how good it was, and whether to believe it.

recordings -> result (metrics) -> verdict, tables, charts, robots, origin -> page, with the replay in it

It needs recordings alone: what they do not hold of their experiment is taken as it must have been. What the page plots
are the panels of `curves`, their numbers packed in one block that the page's script reads, in the pictures' colours.
"""

from __future__ import annotations

import json
import shlex
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from functools import partial
from pathlib import Path
from typing import Any, TypeVar

import msgspec
import numpy as np

from ....errors import InputError, RecordingError
from ....recording.metrics import metrics
from ....recording.recording import Recording
from ....settings import Timing
from ....shown import filled
from ....signals import Array, IntArray
from ...experiments.config import bundled, load_experiment, named_files, recorded_experiment
from ...experiments.controllers import CONTROLLERS
from ...experiments.experiment import Experiment
from ...experiments.references import ReferenceTables
from ...experiments.result import Result
from ...psi.judgement import judgement_of, with_part
from .. import replay
from ..comparison import tables_of
from ..curves import CHARTS, CurvePoints, Panel, Recordings, chart, controller_of, learners, require_comparable
from ..figure import in_the_dark, run_label, scale_rows, styles_of
from ..files import Blob, HtmlPage, fill_template, web_file
from ..psi_figures import sliced
from ..replay.page import title_of
from ..robots import CHECK_SAMPLES, CHECK_SEED, robots_of
from .verdict import learned, ranking, verdict

T = TypeVar("T")
FPS = 30.0  # of the replay within
EARLY = 0.2  # without an experiment, the start counts as over after this share of the run
OUTSIDE = "outside"  # the loop of a recording that a stepper made
OWN = ("variant", "overrides", "title")  # keys that no `--set` changes
MOST = 4000  # points of a curve; of a longer one the extremes of this many stretches of time are kept
LARGEST = 1e30  # what single precision and a plot can still hold


def report(
    recordings: Mapping[str, Recording],
    *,
    command: str = "",
    with_replay: bool = True,
    package_dirs: Sequence[str | Path] = (),
) -> HtmlPage:
    """The report on some runs of one task.

    Args:
        recordings: The runs by name, best by controller.
        command: The command that makes this page, to be shown in it.
        with_replay: Whether the replay is in it.
        package_dirs: Folders to look for the replay's meshes in.

    Raises:
        RecordingError: No run, one without rows, or runs of robots with different velocities.
    """
    filled()
    result = result_of(recordings)
    charts = Charts(result.recordings)
    robots, without_robots = shown_or_why("robot", lambda: robots_of(result.recordings))
    made: replay.ReplayPage | None = None
    without_replay: list[str] = []
    if with_replay:
        make = partial(replay.page, result.recordings, fps=FPS, package_dirs=package_dirs, best=best_in(result))
        made, without_replay = shown_or_why("replay", make)
    warnings = (*charts.skipped, *without_robots, *without_replay, *(made.warnings if made else ()))
    config = next(iter(result.recordings.values())).config_text
    text = fill_template(
        "report.html",
        title=result.experiment.title or title_of(result.recordings) or "Report",
        subject=subject(result),
        verdict=verdict(result),
        judged=result.experiment.windows[-1],
        runs=runs_of(result),
        tables=list(tables_of(result)),
        charts=charts,
        learned=learned(result.recordings),
        data=charts.pack(),
        replay=made,
        robots=robots,
        checks={"samples": CHECK_SAMPLES, "seed": CHECK_SEED},
        facts=list(origin_facts(result.recordings)),
        commands=[line for line in (command_of(result), command) if line],
        config=json.dumps(json.loads(config), indent=2, ensure_ascii=False) if config else "",
        unpack=web_file("unpack.js", replay.__name__),
    )
    return HtmlPage(text, warnings, "report")


def shown_or_why(what: str, make: Callable[[], T]) -> tuple[T | None, list[str]]:
    """A part of the page; or none, and why it cannot be shown."""
    try:
        return make(), []
    except InputError as error:
        return None, [f"no {what}: {' '.join(str(error).split())}"]


def subject(result: Result) -> str:
    """Experiment, robot and duration of the runs in one line, and whether a stepper recorded them on hardware."""
    experiment, runs = result.experiment, result.recordings.values()
    robots = dict.fromkeys(str(recording.meta.get("robot", "")) for recording in runs)
    parts = [result.name, f"variant {experiment.variant}" if experiment.variant else "", ", ".join(robots)]
    if all(recording.meta.get("loop") == OUTSIDE for recording in runs):
        parts += [f"{max(recording.outcome.time for recording in runs):.4g} s", "recording of hardware, no simulation"]
    else:
        parts += [f"{experiment.time.duration:g} s", f"seed {experiment.seed}", f"{experiment.plant} plant"]
    return " \u00b7 ".join(part for part in parts if part)


def runs_of(result: Result) -> list[dict[str, str]]:
    """Every run: its name, what its controller is, its colour and dashes as in the pictures.

    Dark colours give way to light ones in the dark.
    """
    runs = []
    for name, style in styles_of(result.recordings).items():
        recording = result.recordings[name]
        about = CONTROLLERS.get(controller_of(name, recording), "a controller of your own")
        look = {"dash": dash(style.dash[1]), "color": style.color, "dark": in_the_dark(style.color)}
        runs.append({"name": run_label(name, recording), "about": about, **look})
    return runs


# -- the result of recordings ------------------------------------------------------------------------------------------


def result_of(recordings: Mapping[str, Recording]) -> Result:
    """Metrics of runs by name, in the order in which experiments have their controllers; windows of the first run.

    Raises:
        RecordingError: No run, one without rows or control period, or runs of robots with different velocities.
    """
    if not recordings:
        raise RecordingError("nothing to report", why="no recording was given")
    first = next(iter(recordings.values()))
    require_comparable(recordings.values())
    for name, recording in recordings.items():
        if "control_period" not in recording.meta:
            raise RecordingError(f"{name} does not have its control period", file=recording.path)
    places = {controller: place for place, controller in enumerate(CONTROLLERS)}
    runs = dict(sorted(recordings.items(), key=lambda item: places.get(controller_of(*item), len(places))))
    experiment = experiment_of(max(runs.values(), key=len))
    numbers = {name: metrics(recording, experiment.windows) for name, recording in runs.items()}
    return Result(experiment, str(first.meta.get("experiment", "")), runs, numbers, ())


def best_of(recordings: Mapping[str, Recording]) -> str:
    """Name of the run that tracks best; empty where runs cannot be compared, or none may win."""
    with suppress(InputError):
        return best_in(result_of(recordings))
    return ""


def best_in(result: Result) -> str:
    """Likewise, of a result."""
    return next(iter(ranking(result)[1]), "")


def experiment_of(recording: Recording) -> Experiment:
    """The experiment of a recording; without a config one that says as much as the recording does."""
    if (experiment := recorded_experiment(recording)) is not None:
        return experiment
    period = recording.fact("control_period", float)
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
    if named_files(experiment):  # which would be opened
        return ""
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
    """Changes `key.path=value` that make one experiment another."""
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
    if made := sorted(str(meta["created"]) for meta in metas.values() if "created" in meta):
        yield "made", made[0] if made[0] == made[-1] else f"{made[0]} to {made[-1]}"
    keys = {"seed": "seed", "control_period": "control period [s]", "loop": "loop", "plant": "plant"}
    for key, words in (keys | {"urdf_sha256": "sha256 of the URDF"}).items():
        yield words, shared({name: str(meta.get(key, "-")) for name, meta in metas.items()})
    yield "samples", shared({name: f"{len(recording):,}" for name, recording in recordings.items()})
    yield "files", ", ".join(each.path.name if each.path else "in memory" for each in recordings.values())
    versions = {name: meta.get("versions", {}) for name, meta in metas.items()}
    yield "versions", shared({name: ", ".join(f"{k} {v}" for k, v in each.items()) for name, each in versions.items()})


def shared(facts: Mapping[str, str]) -> str:
    """One fact for all runs, or one per run."""
    return (
        next(iter(facts.values())) if len(set(facts.values())) == 1 else "; ".join(f"{k} {v}" for k, v in facts.items())
    )


# -- charts ------------------------------------------------------------------------------------------------------------


@chart(
    "fvu",
    "What is left unexplained of \u03a8",
    "Mean squared error of \u03a8\u0302 in each window over the variance of \u03a8 in the whole run. The mean "
    "of a curve is its FVU online; the best constant has 1.",
    judged=True,
)
def fvu(recordings: Recordings) -> Iterator[Panel]:
    """Error online in windows, a panel per component."""
    judged, _ = with_part(learners(recordings), "psi", judgement_of)
    windows = {name: sliced(one) for name, one in judged.items()}
    for i, name in enumerate(next(iter(judged.values())).psi.labels if judged else ()):
        # every value is held to the end of its window
        curves = {n: (edges, np.append(v[:, i], v[-1, i])) for n, (edges, v) in windows.items()}
        yield Panel(f"\u03a8 of {name}", "", curves, scale="log", step=True)


class Charts:
    """The sections of some runs, and the numbers of their curves.

    Args:
        recordings: Runs by name.

    Attributes:
        sections: The charts that the runs have something for, by `key`, and their `panels` as the page reads them.
        skipped: Why others are left out, one line each.
    """

    def __init__(self, recordings: Recordings) -> None:
        self.recordings, self.blob = recordings, Blob()
        self._places = {name: place for place, name in enumerate(recordings)}
        self._times: dict[tuple[int, bytes], Any] = {}
        every = ((name, one, [*map(self.packed, one.panels(recordings))]) for name, one in CHARTS.items())
        self.sections = [
            {"key": name, "chart": one, "panels": panels, "judged": one.judged} for name, one, panels in every if panels
        ]
        self.skipped = [why for one in CHARTS.values() for why in one.lacks(recordings)]

    def pack(self) -> str:
        """All that the page's script reads, as text; see `Blob.pack`."""
        calm = {id(run): float(run.time[rows][-1]) for run, rows in scale_rows(self.recordings.values())}
        styles = styles_of(self.recordings)
        runs = [
            {"name": run_label(name, rec), "dash": dash(styles[name].dash[1]), "calm": calm.get(id(rec))}
            for name, rec in self.recordings.items()
        ]
        return self.blob.pack(
            {"runs": runs, "sections": {section["key"]: section["panels"] for section in self.sections}}
        )

    def packed(self, panel: Panel) -> dict[str, Any]:
        """A panel as the page reads it; a run is its place, none for what is true or wanted."""
        truth = [self.curve(None, panel.truth)] if panel.truth else []
        curves = [self.curve(self._places[name], curve) for name, curve in panel.curves.items()]
        tracks = [self.track(None if name is None else self._places[name], pose) for name, pose in panel.tracks]
        about = {
            "truth": "true \u03a8" if truth else None,
            "across": "x [m]" if tracks else None,
            "plane": True if tracks else None,
            "step": panel.step or None,
            "scale": panel.scale if panel.scale != "linear" else None,
            "limit": panel.limit if np.isfinite(panel.limit) else None,
        }
        made = {"title": panel.title, "unit": panel.unit, "curves": [*truth, *curves, *tracks]}
        return made | {key: value for key, value in about.items() if value is not None}

    def curve(self, run: int | None, curve: CurvePoints) -> dict[str, Any]:
        """A curve over time."""
        time, values = curve
        rows = kept_rows(values)
        key = len(time), time[rows].tobytes()
        if key not in self._times:
            self._times[key] = self.blob.add(time[rows], "f4")
        return {"run": run, "x": self._times[key], "y": self.blob.add(drawable(values[rows]), "f4")}

    def track(self, run: int | None, pose: Array) -> dict[str, Any]:
        """A path (N, 3), thinned evenly, with ten headings."""
        rows = np.unique(np.linspace(0, len(pose) - 1, min(len(pose), MOST)).astype(int))
        ten = np.unique(np.linspace(0, len(pose) - 1, 10).astype(int))
        x, y, _ = drawable(pose[rows]).T
        arrows = self.blob.add(drawable(pose[ten]), "f4")
        return {"run": run, "x": self.blob.add(x, "f4"), "y": self.blob.add(y, "f4"), "arrows": arrows}


def kept_rows(values: Array, most: int = MOST) -> IntArray:
    """Rows of a curve (N,) to keep: all, or of every stretch of time the least and the largest."""
    if len(values) <= most:
        return np.arange(len(values))
    width = -(-len(values) // (most // 2))
    padded = np.nan_to_num(np.pad(values, (0, -len(values) % width), mode="edge")).reshape(-1, width)
    starts = width * np.arange(len(padded))
    ends = np.minimum([starts + padded.argmin(axis=1), starts + padded.argmax(axis=1)], len(values) - 1)
    return np.unique([0, *ends.ravel(), len(values) - 1])


def drawable(values: Array) -> Array:
    """Numbers that single precision holds; NaN for the others."""
    return np.where(np.abs(values) < LARGEST, values, np.nan)


def dash(pattern: Sequence[float] | None) -> str:
    """A dash pattern for SVG, in pixels."""
    return " ".join(f"{1.6 * length:g}" for length in pattern or ())

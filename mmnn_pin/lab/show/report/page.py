"""The page: everything of a report in one HTML text that opens anywhere, also from a file."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from importlib import resources
from pathlib import Path
from typing import Any, ClassVar

from ....errors import InputError
from ....recording.recording import Recording
from ...experiments.controllers import CONTROLLERS
from ...experiments.runner import Result
from .. import replay
from ..figure import styles_of
from ..html_page import HtmlPage, filled
from ..replay.page import source as source_of_replay
from ..replay.page import title_of
from ..replay.scene import label
from .charts import Charts, dash
from .origin import command_of, facts_of
from .proof import proved
from .results import controller_of, result_of
from .robots import SAMPLES, SEED, About, robots_of
from .tables import tables_of
from .verdict import verdict

SCRIPTS = ("scale.js", "plot.js", "main.js")
FPS = 30.0  # of the replay within


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
    text = filled(
        source("page.html"),
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
        checks={"samples": SAMPLES, "seed": SEED},
        facts=list(facts_of(result.recordings)),
        commands=[line for line in (command_of(result), command) if line],
        config=config_of(result),
        style=source("page.css"),
        scripts="\n".join([source_of_replay("unpack.js"), *map(source, SCRIPTS)]),
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
        runs.append({"name": label(name, recording), "about": about, **look})
    return runs


def in_the_dark(color: str) -> str:
    """A colour on a dark ground: itself, but for black."""
    return "#ffffff" if color == "#000000" else color


def config_of(result: Result) -> str:
    """The config of the first run, indented; empty without one."""
    text = next(iter(result.recordings.values())).config_text
    return json.dumps(json.loads(text), indent=2, ensure_ascii=False) if text else ""


def robots_in(recordings: Mapping[str, Recording]) -> tuple[list[About], tuple[str, ...]]:
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


def source(name: str) -> str:
    """A file of the page."""
    return resources.files(__package__).joinpath("web", name).read_text("utf-8")

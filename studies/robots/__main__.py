"""Load every robot of `corpus.toml`, hold it against the truth, follow the commands that refusals print.

    python -m studies.robots FOLDER [--only TEXT] [--markdown]

FOLDER has the repositories as `owner+name/`, at the commits that `corpus.toml` names, and beside them the packages that
their xacro files ask for. Robots of example-robot-data are loaded by name. The table is that of docs/robots.md.
"""

from __future__ import annotations

import re
import time
import tomllib
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import click

from mmnn_pin.errors import InputError
from mmnn_pin.model.loading import load
from mmnn_pin.model.robot import Robot

TOLERANCE = 0.03  # of the maker's radius and track
WAY = re.compile(r"--(base|wheels|radius|track) ([A-Za-z0-9_,.]*[A-Za-z0-9_])")  # options in the fix of a refusal
READ: dict[str, Any] = {"wheels": lambda text: text.split(","), "radius": float, "track": float}


@dataclass(frozen=True)
class Outcome:
    """What became of one robot.

    Attributes:
        verdict: `right`, `right after the command`, `refused rightly`, `refused`, `ACCEPTED WRONG`, `refused wrongly`.
        text: What was understood, or why not.
        command: Options that were followed.
        seconds: How long the first try took [s].
    """

    verdict: str
    text: str
    command: str
    seconds: float


def judge(entry: dict[str, Any], folder: Path) -> Outcome:
    """The outcome of one robot, with the command of its refusal followed."""
    path = place(entry, folder)
    if path is None:
        return Outcome("not there", "", "", 0.0)
    said: dict[str, Any] = {"xacro": entry.get("xacro", ())}
    start = time.perf_counter()
    try:
        robot = load(path, **said)
    except InputError as error:
        took = time.perf_counter() - start
        return refused(entry, path, said, error, took)
    took = time.perf_counter() - start
    wrong = faults(entry, robot)
    return Outcome("ACCEPTED WRONG" if wrong else "right", "; ".join(wrong) or words(robot), "", took)


def place(entry: dict[str, Any], folder: Path) -> str | Path | None:
    """Where its file is, or its name; None where it is not."""
    if "repository" not in entry:
        return str(entry["file"])
    path = folder / entry["repository"].split("@")[0].replace("/", "+") / entry["file"]
    return path if path.exists() else None


def refused(entry: dict[str, Any], path: str | Path, said: dict[str, Any], error: InputError, took: float) -> Outcome:
    """The outcome of a robot that was refused."""
    told = " ".join(str(error).split())
    kind = entry["kind"]
    if kind.startswith("refused: "):
        wanted = kind.removeprefix("refused: ")
        ok = wanted.lower() in told.lower()
        return Outcome("refused rightly" if ok else "refused, misleading", told, "", took)
    if "--radius" in error.fix and "radius" in entry and "radius" not in said:  # measured, as it asks
        known = said | {"radius": entry["radius"]}
        try:
            return followed(entry, load(path, **known), f"--radius {entry['radius']}", took)
        except InputError as again:
            return refused(entry, path, known, again, took)
    for way in re.split("; |, | or ", error.fix):
        options = dict(WAY.findall(way))
        if not options or {"METRES", "FOLDER", "VALUE"} & {*options.values()} or options.get("base", kind) != kind:
            continue
        try:
            robot = load(path, **said, **{name: READ.get(name, str)(text) for name, text in options.items()})
        except InputError as again:
            return Outcome("refused wrongly", f"{told} THEN {again}", way, took)
        return followed(entry, robot, " ".join(f"--{name} {text}" for name, text in options.items()), took)
    return Outcome("refused", told, "", took)


def followed(entry: dict[str, Any], robot: Robot, command: str, took: float) -> Outcome:
    """The outcome of a robot that was accepted after the command of its refusal."""
    wrong = faults(entry, robot)
    verdict = "ACCEPTED WRONG" if wrong else "right after the command"
    return Outcome(verdict, "; ".join(wrong) or words(robot), command, took)


def faults(entry: dict[str, Any], robot: Robot) -> list[str]:
    """What is wrong about a robot that was accepted; a length that a finding questions is told, and not wrong."""
    base, found = robot.base, []
    if base.kind != entry["kind"]:
        return [f"{base.kind} for {entry['kind']}: {words(robot)}"]
    told = " ".join(f.message for f in robot.findings if f.code.startswith("base-"))
    lengths = {"radius": [w.radius for w in base.wheels], "track": [base.track]}
    for name, values in lengths.items():
        for value in values[:1] if name in entry else ():
            if abs(value / entry[name] - 1) > TOLERANCE and f"{entry[name]:.4g}" not in told:
                found.append(f"{name} {value:.4g} m for {entry[name]:.4g} m")
    return found


def words(robot: Robot) -> str:
    """A robot in a few words."""
    base = robot.base
    radius = f"radius {base.wheels[0].radius:.4g} m, track {base.track:.4g} m" if base.wheels else "no wheels"
    return f"{base.kind}, {radius}, {robot.dimensions.arm} arm joints"


def markdown_row(entry: dict[str, Any], outcome: Outcome) -> str:
    """A row of the table of docs/robots.md."""
    truth = ", ".join([entry["kind"], *(f"{entry[name]:g} m" for name in ("radius", "track") if name in entry)])
    text = outcome.text if outcome.verdict.startswith("right") else ""
    found = ": ".join(filter(None, (outcome.verdict, f"`{outcome.command}`" if outcome.command else "", text)))
    place = entry.get("repository", "example-robot-data")
    return f"| {entry['name']} | {place} | {truth} ({entry['source']}) | {found} |"


@click.command()
@click.argument("folder", type=click.Path(exists=True, path_type=Path))
@click.option("--only", default="", help="Robots whose names have this text.")
@click.option("--markdown", is_flag=True, help="The table of docs/robots.md.")
def main(folder: Path, only: str, markdown: bool) -> None:
    """Hold all robots of the corpus against the truth."""
    entries = tomllib.loads((Path(__file__).parent / "corpus.toml").read_text())["robot"]
    counts: dict[str, int] = {}
    for entry in entries:
        if only.lower() not in entry["name"].lower():
            continue
        outcome = judge(entry, folder)
        counts[outcome.verdict] = counts.get(outcome.verdict, 0) + 1
        if markdown:
            click.echo(markdown_row(entry, outcome))
        else:
            click.echo(
                f"{outcome.verdict:24}{entry['name']:26}{outcome.seconds:6.2f} s  {outcome.command}  {outcome.text}"
            )
    click.echo(", ".join(f"{count} {verdict}" for verdict, count in sorted(counts.items())))


if __name__ == "__main__":
    main()

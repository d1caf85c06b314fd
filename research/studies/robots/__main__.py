"""Load every robot of `corpus.toml`, hold it against the truth, follow the commands that refusals print.

    python -m research.studies.robots FOLDER [--only TEXT] [--csv] [--corpus FILE] [--inspect] [--track]

FOLDER has the repositories as `owner+name/`, at the commits that `corpus.toml` names, beside them the packages that
their xacro files ask for, and in `.packages/` as `owner+name@commit/` those that are given by `--package-dir`. Robots
of example-robot-data load by name. The table is docs/reference/public-robots.csv. With `--inspect` the whole command
`mmnn inspect` is timed on every robot that was accepted, with what it had to be told: processor time, compiled cache
warm, the shortest of three; the slowest ten are told.
With `--track` every robot that was accepted drives the experiment `track`, as in `studies.track_any`. An entry with an
`erratum`, an error of its truth that was found later, is judged by the truth as it stands, told, and not counted.
"""

from __future__ import annotations

import csv
import json
import math
import os
import re
import subprocess
import sys
import tempfile
import time
import tomllib
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import click

from mmnn_pin.errors import InputError
from mmnn_pin.model.base.base import Base
from mmnn_pin.model.base.overrides import Overrides, folders_of
from mmnn_pin.model.base.steered import SteeredBase
from mmnn_pin.model.loading import load
from mmnn_pin.model.robot import Robot
from mmnn_pin.model.robots import find
from mmnn_pin.model.urdf.reading import read
from research.studies import track_any

CONTROLLERS = ("pd_gravity", "adaptive", "computed_torque")  # that drive
TOLERANCE = 0.03  # of the maker's radius and track
NAMED = 1e-3  # a finding names a length that it has within this fraction
FORWARD = {"+x": 0.0, "+y": math.pi / 2, "-x": math.pi, "-y": -math.pi / 2}  # of the root link's frame [rad]
OBLIQUE = math.radians(10.0)  # by which forward may be off
WAY = re.compile(
    r"--(base|wheels|radius|track|without|lock|free|forward|xacro|steer|hitch|wheelbase|steering-limit)"
    r" ([A-Za-z0-9_,.:=-]*[A-Za-z0-9_])"
)  # options in the fix of a refusal
REPEATED = {"without": "without", "lock": "lock", "free": "free", "xacro": "xacro", "package-dir": "package_dirs"}
LISTED = dict.fromkeys(("wheels", "steer", "hitch"), lambda text: text.split(","))
READ: dict[str, Any] = {**LISTED, **dict.fromkeys(("radius", "track", "wheelbase", "steering-limit"), float)}
ASKED = {"radius": "METRES", "steering-limit": "RAD"}  # what a refusal asks for: the maker's, as if measured
WRITE = re.compile(r"write (<axis [^>]*/>|type=\"continuous\") in ((?:'[^']*'(?:, )?)+)")  # in a file


@dataclass(frozen=True)
class Outcome:
    """What became of one robot.

    Attributes:
        verdict: `right`, `right after the command`, `refused rightly`, `refused`, `ACCEPTED WRONG`, `refused wrongly`.
        text: What was understood, or why not.
        command: Options that were followed.
        seconds: How long the first try took [s].
        said: What was said about the robot in the end, by names of `Overrides`.
        file: The file that it was said about.
    """

    verdict: str
    text: str
    command: str
    seconds: float
    said: dict[str, Any] = field(default_factory=dict)
    file: str = ""


def judge(entry: dict[str, Any], folder: Path) -> Outcome:
    """The outcome of one robot, with the commands of its refusals followed, one after the other."""
    path = place(entry, folder)
    if path is None:
        return Outcome("not there", "", "", 0.0)
    said: dict[str, Any] = {"xacro": tuple(text.replace("FOLDER", str(folder)) for text in entry.get("xacro", ()))}
    steps, start, took = list[str](), time.perf_counter(), 0.0
    for _ in range(8):
        try:
            robot = load(path, **said)
        except InputError as error:
            took = took or time.perf_counter() - start
            told = " ".join(f"{error.what}: {error.why}: {error.fix}".split())
            if entry["kind"].startswith("refused: ") and well_refused(entry, told):
                return Outcome("refused rightly", told, " ".join(steps), took)
            options = packages_of(entry, folder, error.fix, said) or way_out(entry, error.fix, said)
            if "joints" not in entry and {name for name, _ in options} & {"free", "lock"}:  # of its ways the right one
                options = nearest(entry, path, said, by_joint(error.fix))
            if not options and not entry["kind"].startswith("refused: ") and (edit := WRITE.search(error.fix)):
                path, said["package_dirs"] = written(path, said, *edit.groups()), folders_above(path, said)
                said |= {"xacro": (), "without": ()}  # it is expanded
                steps.append(edit[0])
                continue
        else:
            took = took or time.perf_counter() - start
            wrong = faults(entry, robot)
            options = told_by(entry, robot) if wrong and not steps else []
            told = "; ".join(wrong) or words(robot)
            if wrong and not options and said.get("without"):  # left out as a package is missing, and missed
                return Outcome("refused", told, " ".join(steps), took)
            if not options:
                right = "right after the command" if steps else "right"
                return Outcome("ACCEPTED WRONG" if wrong else right, told, " ".join(steps), took, said, str(path))
        if not options:
            verdict = "refused, misleading" if entry["kind"].startswith("refused: ") else "refused"
            verdict = "refused rightly" if well_refused(entry, told) else verdict
            return Outcome(verdict, told, " ".join(steps), took)
        steps += [f"--{name} {text.removeprefix(f'{folder}/.packages/')}" for name, text in options]
        said = followed(said, options)
    return Outcome("refused", told, " ".join(steps), took)


def kinds_of(entry: dict[str, Any]) -> list[str]:
    """What its truth allows: kinds of a base, and refusals as `refused: WORDS`."""
    return [entry["kind"], *entry.get("also", ())]


def well_refused(entry: dict[str, Any], told: str) -> bool:
    """Whether a refusal has the words of one that its truth allows."""
    words = [kind.removeprefix("refused: ") for kind in kinds_of(entry) if kind.startswith("refused: ")]
    return any(word in told.lower() for word in words)


def packages_of(entry: dict[str, Any], folder: Path, fix: str, said: dict[str, Any]) -> list[tuple[str, str]]:
    """The options that give what a refusal asks for with `--package-dir`: packages of the versions that it needs."""
    if "--package-dir" not in fix or "package_dirs" in said:
        return []
    places = [folder / ".packages" / name.replace("/", "+") for name in entry.get("packages", ())]
    return [("package-dir", str(place)) for place in places if place.exists()]


def folders_above(path: str | Path, said: dict[str, Any]) -> tuple[str, ...]:
    """Folders in which a copy of a file elsewhere finds the packages that the file finds."""
    file = find(path).absolute()
    return (*said.get("package_dirs", ()), *map(str, file.parents[:-2]), *map(str, folders_of(file, Overrides())))


def written(path: str | Path, said: dict[str, Any], text: str, joints: str) -> Path:
    """A copy of a file, expanded, with an element or a type written into some joints, as a refusal asks for."""
    file, overrides = find(path), Overrides(**{k: v for k, v in said.items() if k in REPEATED.values()})
    content = read(file, False, folders_of(file, overrides), overrides.xacro, overrides.without).text
    for name in re.findall(r"'([^']*)'", joints):
        tag = re.compile(rf'<joint\b[^>]*\bname="{re.escape(name)}"[^>]*>')
        head = next(hit[0] for hit in tag.finditer(content) if " type=" in hit[0])
        new = head + text if text.startswith("<") else re.sub(r' type="\w+"', f" {text}", head)
        content = content.replace(head, new, 1)
    copy = Path(tempfile.mkdtemp()) / f"{file.name.partition('.')[0]}.urdf"
    copy.write_text(content)
    return copy


def way_out(entry: dict[str, Any], fix: str, said: dict[str, Any]) -> list[tuple[str, str]]:
    """The options of a refusal that suit the truth; a number that it asks for is the maker's, as if measured."""
    kind, asked = entry["kind"], ""
    for name, unit in ASKED.items():
        key = name.replace("-", "_")
        if f"--{name}" in fix and key in entry and key not in said:
            fix, asked = fix.replace(f"--{name} {unit}", f"--{name} {entry[key]}"), asked or name
    ways = re.split("; |, | or ", fix)
    if asked and not any("--wheels" in way and f"--{asked}" in way for way in ways):
        return [(asked, str(entry[asked.replace("-", "_")]))]
    wanted = [f"--base {kind}"] + [f"--{asked}"] * bool(asked) + ["--wheels"] * ("wheels" in entry)
    wanted += ["--steer"] * ("steering" in entry)
    for way in sorted(ways, key=lambda way: [option not in way for option in wanted]):
        options = WAY.findall(way)
        stated = dict(options)
        moved = [(name == "free", joint) for name, joint in options if name in ("free", "lock")]
        if any(free != (joint in entry["joints"]) for free, joint in moved if "joints" in entry):
            continue
        if (towards := signed(stated.get("forward", ""))) != entry.get("forward", towards) and "forward" in stated:
            continue
        fits = kind.startswith("refused: ") or stated.get("base", kind) in kinds_of(entry)
        wheels = stated["wheels"].split(",") if "wheels" in stated else entry.get("wheels", ())
        fits &= {*wheels} == {*entry.get("wheels", wheels)}
        ends = kind.startswith("refused: ") and {"base", "wheels"} & stated.keys()
        named = not re.search(r"\b(METRES|FOLDER|VALUE|JOINT|RAD|KIND)\b", " ".join(stated.values()))
        if options and fits and not ends and named:
            return options
    return []


def by_joint(fix: str) -> list[list[tuple[str, str]]]:
    """The ways out of a question about joints of the arm."""
    return list(filter(None, map(WAY.findall, re.split("; |, | or ", fix))))


def nearest(
    entry: dict[str, Any], path: str | Path, said: dict[str, Any], ways: list[list[tuple[str, str]]]
) -> list[tuple[str, str]]:
    """The first of some ways that leads to the truth's number of joints of the arm, or to another question."""
    for way in ways:
        try:
            if load(path, **followed(said, way)).dimensions.arm == entry.get("arm"):
                return way
        except InputError:
            return way
    return ways[0] if ways else []


def followed(said: dict[str, Any], options: list[tuple[str, str]]) -> dict[str, Any]:
    """What is said about a robot, with some options more."""
    new = dict(said)
    for name, text in options:
        key = REPEATED.get(name)
        new[(key or name).replace("-", "_")] = (*new.get(key, ()), text) if key else READ.get(name, str)(text)
    return new


def signed(direction: str) -> str:
    """A direction of `--forward` as truths have it."""
    return direction if direction.startswith("-") else f"+{direction}"


def told_by(entry: dict[str, Any], robot: Robot) -> list[tuple[str, str]]:
    """The options of a finding that says what else the base may be."""
    fixes = [f.fix for f in robot.findings if f.code == "base-none"]
    return next(filter(None, (way_out(entry, fix, {}) for fix in fixes)), [])


def place(entry: dict[str, Any], folder: Path) -> str | Path | None:
    """Where its file is, or its name; None where it is not."""
    if "repository" not in entry:
        return str(entry["file"])
    path = folder / entry["repository"].split("@")[0].replace("/", "+") / entry["file"]
    return path if path.exists() else None


def faults(entry: dict[str, Any], robot: Robot) -> list[str]:
    """What is wrong about a robot that was accepted; a length that a finding questions is told, and not wrong."""
    base = robot.base
    if base.kind not in kinds_of(entry):
        return [f"{base.kind} for {entry['kind']}: {words(robot)}"]
    own = base.kind == entry["kind"]  # not another one that is right, too
    found = [*wrong_lengths(entry, robot), *wrong_wheels(entry, base)] if own else []
    turn = FORWARD[entry.get("forward", "+x")] - base.frame[2]
    if "forward" in entry and base.kind != "fixed" and math.cos(turn) < math.cos(OBLIQUE):
        found.append(f"forward {math.degrees(base.frame[2]):+.0f} deg from x for {entry['forward']}")
    arms = entry.get("arm", robot.dimensions.arm)
    if robot.dimensions.arm not in (arms if isinstance(arms, list) else [arms]):
        found.append(f"{robot.dimensions.arm} joints of the arm for {arms}: {', '.join(robot.joint_names)}")
    return found


def wrong_lengths(entry: dict[str, Any], robot: Robot) -> list[str]:
    """Radius, track and wheelbase that are not the maker's [m]; the track is what the contacts are apart, too."""
    base, found = robot.base, list[str]()
    told = re.findall(r"([\d.]*\d) m\b", " ".join(f.message for f in robot.findings if f.code.startswith("base-")))
    at = [base.place(w)[1] if isinstance(base, SteeredBase) else w.y for w in base.wheels]
    meant = [w for w in base.wheels if w.joint in entry.get("wheels", ())] or base.wheels  # others may be smaller
    lengths = {"radius": [w.radius for w in meant[:1]], "track": [base.track, max(at) - min(at)] if at else []}
    if isinstance(base, SteeredBase):
        lengths["wheelbase"] = [base.length]
        if not base.sideways and not base.track:  # an axle's wheels may be one body
            lengths["track"] = []
    for name, values in lengths.items():
        if name not in entry or not values or any(abs(float(text) / entry[name] - 1) < NAMED for text in told):
            continue
        if all(abs(value / entry[name] - 1) > TOLERANCE for value in values):
            found.append(f"{name} {values[0]:.4g} m for {entry[name]:.4g} m")
    return found


def wrong_wheels(entry: dict[str, Any], base: Base) -> list[str]:
    """Drive wheels, or all that roll, and steering pivots that are others than the truth's; left before right.

    Of a base that steers all drive where nothing tells which do: the truth's are among them.
    """
    drives, every = [wheel.joint for wheel in base.wheels if wheel.driven], {wheel.joint for wheel in base.wheels}
    wheels, found = entry.get("wheels", drives), list[str]()
    untold = isinstance(base, SteeredBase) and {*drives} == every
    if {*wheels} not in ({*drives}, every) and not (untold and {*wheels} <= every):
        found.append(f"wheels {', '.join(drives) or 'none'} for {', '.join(wheels)}")
    elif len(drives) == 2 and wheels == drives[::-1] and "forward" in entry:
        found.append(f"left and right swapped: {', '.join(drives)}")
    pivots = {pivot.joint for pivot in base.pivots} if isinstance(base, SteeredBase) else set()
    if pivots and not {*entry.get("steering", pivots)} <= pivots:
        found.append(f"steering {', '.join(sorted(pivots))} for {', '.join(entry['steering'])}")
    return found


def words(robot: Robot) -> str:
    """A robot in a few words: base, radius and track [m], how many joints its arm has; pivots of a base that steers."""
    base = robot.base
    if isinstance(base, SteeredBase):
        size = f", wheelbase {base.length:.4g}" if base.masters and not base.sideways else ""
        return f"{base.kind}{size}, {len(base.pivots)} pivots, {len(base.wheels)} wheels, {robot.dimensions.arm} joints"
    lengths = f"{base.wheels[0].radius:.4g}, {base.track:.4g}" if base.wheels else "no wheels"
    return f"{base.kind}, {lengths}, {robot.dimensions.arm} joints"


def row_of(entry: dict[str, Any], outcome: Outcome, errata: bool) -> list[str]:
    """A row of docs/reference/public-robots.csv: robot, repository, truth, outcome; with errata the truth's erratum."""
    truth = ", ".join(
        [entry["kind"], *(f"{entry[name]:g}" for name in ("radius", "track", "wheelbase") if name in entry)]
    )
    text = outcome.text.removeprefix(f"{entry['kind']}, ") if outcome.verdict.startswith("right") else ""
    found = ": ".join(filter(None, (outcome.verdict, outcome.command, text)))
    row = [entry["name"], entry.get("repository", "example-robot-data"), truth, found]
    return [*row, entry.get("erratum", "")] if errata else row


def inspected(outcome: Outcome) -> float:
    """Processor time of `mmnn inspect` with what had to be said, all of its processes: the shortest of three [s]."""
    names = {key: f"--{option}" for option, key in REPEATED.items()}
    command = [sys.executable, "-c", "from mmnn_pin.cli import main; main()", "inspect", outcome.file]
    for key, value in outcome.said.items():
        if key in names:
            command += [word for text in value for word in (names[key], text)]
        else:
            command += [f"--{key}", ",".join(value) if isinstance(value, list) else str(value)]
    times = []
    for _ in range(3):
        before = os.times()
        subprocess.run(command, check=True, capture_output=True)
        after = os.times()
        times.append(sum(after[2:4]) - sum(before[2:4]))
    return min(times)


def driven(entry: dict[str, Any], folder: Path, outcome: Outcome) -> track_any.RobotRow | None:
    """A row of the table of `studies.track_any`, None where it is refused; either is told as it comes."""
    said = {key: list(value) if isinstance(value, tuple) else value for key, value in outcome.said.items() if value}
    settings = tuple(f"overrides.{key}={json.dumps(value)}" for key, value in said.items())
    try:
        row = track_any.row_of(str(place(entry, folder)), settings, CONTROLLERS)
    except InputError as refused:
        click.echo(f"{entry['name']}: not run: {refused.what}: {refused.why}", err=True)
        return None
    click.echo(track_any.summary([replace(row, name=entry["name"])], CONTROLLERS)[2], err=True)
    return replace(row, name=entry["name"])


def tracked(rows: list[track_any.RobotRow]) -> str:
    """The table of the robots that were driven, and the joints on which `adaptive` is worse than `pd_gravity`."""
    worse = [
        f"{row.name}: {joint} ({track_any.cell(one)} for {track_any.cell(other)})"
        for row in rows
        for joint, one, other in zip(row.joints, row.errors["adaptive"], row.errors["pd_gravity"], strict=True)
        if not one <= other
    ]
    joints = sum(len(row.joints) for row in rows)
    text = (
        f"adaptive errs no more than pd_gravity on {joints - len(worse)} of {joints} joints, not on: {', '.join(worse)}"
    )
    return "\n".join([*track_any.summary(rows, CONTROLLERS), "", text, ""])


@click.command()
@click.argument("folder", type=click.Path(exists=True, path_type=Path))
@click.option("--only", default="", help="Robots whose names have this text.")
@click.option(
    "--csv",
    "as_csv",
    is_flag=True,
    help="The rows of docs/reference/public-robots.csv; with --track of public-robots-track.csv.",
)
@click.option(
    "--corpus",
    default="corpus.toml",
    help="File of truths beside this one.",
)
@click.option("--inspect", is_flag=True, help="Time `mmnn inspect` on every robot that is accepted.")
@click.option("--track", is_flag=True, help="Drive the experiment `track` with every robot that is accepted.")
def main(folder: Path, only: str, as_csv: bool, corpus: str, inspect: bool, track: bool) -> None:
    """Hold all robots of the corpus against the truth."""
    entries = tomllib.loads((Path(__file__).parent / corpus).read_text())["robot"]
    counts, rows, times = dict[str, int](), list[track_any.RobotRow | None](), dict[str, float]()
    errata = any("erratum" in entry for entry in entries)
    for entry in entries:
        if only.lower() not in entry["name"].lower():
            continue
        os.environ.update(entry.get("env", {}))
        outcome = judge(entry, folder)
        counted = "erratum in the truth" if "erratum" in entry else outcome.verdict
        counts[counted] = counts.get(counted, 0) + 1
        if inspect and outcome.verdict.startswith("right"):
            times[entry["name"]] = inspected(outcome)
            click.echo(f"{times[entry['name']]:6.2f} s  {entry['name']}")
        elif track:
            rows += [driven(entry, folder, outcome)] if outcome.verdict.startswith("right") else []
        elif as_csv:
            csv.writer(sys.stdout, lineterminator="\n").writerow(row_of(entry, outcome, errata))
        else:
            text = f"{outcome.command}  {outcome.text}" + f"  erratum: {entry.get('erratum')}" * ("erratum" in entry)
            click.echo(f"{outcome.verdict:24}{entry['name']:26}{outcome.seconds:6.2f} s  {text}")
    if times:
        slowest = sorted(times.items(), key=lambda item: -item[1])[:10]
        click.echo(f"slowest of {len(times)}: " + ", ".join(f"{name} {seconds:.2f} s" for name, seconds in slowest))
    done = [row for row in rows if row is not None]
    if track and as_csv:
        csv.writer(sys.stdout, lineterminator="\n").writerows(track_any.cells(done, CONTROLLERS))
    elif track:
        click.echo(tracked(done))
    click.echo(", ".join(f"{count} {verdict}" for verdict, count in sorted(counts.items())))


if __name__ == "__main__":
    main()

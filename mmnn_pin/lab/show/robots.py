"""What is shown of a robot: what was understood of its file, its reduced model, and whether its properties hold."""

from __future__ import annotations

import json
import math
import re
import shlex
import textwrap
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from ...model.checks.nonholonomy import RANK_TOLERANCE
from ...model.checks.properties import CheckReport, check
from ...model.inspection import inspection_of
from ...model.urdf.expansion import EXPANDED
from ...recording.recording import Recording, recorded_robot
from ...shown import shows
from .table import WIDTH

SAMPLING = "positions uniform within limits (else +-pi, +-1 m), velocities standard normal; an estimate from inside"
CHECK_SAMPLES = 20  # random states of the property checks
CHECK_SEED = 0
BARE = re.compile(r"[A-Za-z0-9_-]+")  # keys that TOML takes without quotes
NARROWEST = 24  # columns that a text beside others has at least


def inspection_text(content: dict[str, Any], width: int = WIDTH) -> str:
    """The tables and the findings of what `model.inspection.inspection_of` gives, as text.

    Names are folded to `width` columns; a finding stays one line, so that it can be searched for.
    """
    findings = "".join(f"\n  {finding['text']}" for finding in content["findings"])
    last = f"findings ({len(content['findings'])}){findings}" if findings else "no findings"
    return f"{understood_text(content, width)}\n\n{last}"


def understood_text(content: dict[str, Any], width: int = WIDTH) -> str:
    """Base, wheels, arm and what is locked."""
    told = (head(content, width), wheels(content["base"]), arm(content["arm"]), interfaces(content, width))
    parts = (*told, gains(content.get("track")), *locked(content["locked_at"], width))
    return "\n\n".join(part for part in parts if part)


def refusal_text(content: dict[str, Any]) -> str:
    """A refused robot (`model.inspection.refusal_of`) beside its errors: what its base could be, and the rest."""
    lines = []
    for candidate in (content["base"] or {}).get("candidates", ()):
        lines.append(f"candidate: {candidate['kind'].replace('_', ' ')}")
        lines += [f"  for: {text}" for text in candidate["for"]]
        lines += [f"  against: {text}" for text in candidate["against"]]
    lines += [f"wheel? {text}" for text in (content["base"] or {}).get("wheel_candidates", ())]
    lines += [finding["text"] for finding in content["findings"] if finding["severity"] != "error"]
    return "\n".join(lines)


def head(content: dict[str, Any], width: int) -> str:
    """File, mass and base."""
    base = content["base"]
    lines = [("file", content["file"]), ("sha256", content["sha256"]), ("mass", f"{content['mass']:.4g} kg")]
    lines.append(("base", base["kind"].replace("_", " ")))
    if base["kind"] != "fixed":
        x, y, heading, floor = (round(value, 9) + 0.0 for value in (*base["frame"], base["floor"]))  # no dust, no -0
        frame = f"x {x:.4g} m, y {y:.4g} m, heading {math.degrees(heading):.4g} deg in the root link"
        lines += [("track", f"{base['track']:.4g} m"), ("control frame", frame)]
        lines.append(("floor", f"{floor:.4g} m above the root link's origin"))
    for key in ("casters", "suspensions"):
        lines += [(key, folded(", ".join(base[key]), width, 16).lstrip())] if base[key] else []
    return "\n".join(f"{name:16}{value}" for name, value in lines)


def wheels(base: dict[str, Any]) -> str:
    """Drive wheels with radius, sign and place."""
    if not base["wheels"]:
        return ""
    rows = [("drive wheel", "radius [m]", "sign", "x [m]", "y [m]", "roller [deg]")]
    for w in base["wheels"]:
        roller = "-" if w["roller"] is None else f"{math.degrees(w['roller']):.4g}"
        rows.append((w["joint"], f"{w['radius']:.4g}", f"{w['sign']:+d}", f"{w['x']:.4g}", f"{w['y']:.4g}", roller))
    return underlined(rows)


def arm(content: dict[str, Any]) -> str:
    """Arm joints with limits, and what follows them."""
    if not content["joints"]:
        return "no arm"
    rows = [("arm joint", "lower", "upper", "effort")]
    for name in content["joints"]:
        numbers = (content["limits"][name][key] for key in ("lower", "upper", "effort"))
        rows.append((name, *("-" if limit is None else f"{limit:.4g}" for limit in numbers)))
    slaves = [
        f"{name} follows: {slave['multiplier']:.4g} {slave['master']} {slave['offset']:+.4g}"
        for name, slave in content["slaves"].items()
    ]
    return "\n".join([underlined(rows), "angles in rad, travels in m, efforts in N m or N; - for no limit", *slaves])


def interfaces(content: dict[str, Any], width: int = WIDTH) -> str:
    """Which command interface is used, which are offered, and by which joints; empty where none is stated."""
    offered = content["interfaces_offered"]
    if not any(offered.values()):
        return ""
    groups: dict[tuple[str, str], list[str]] = {}
    for name, used in content["interfaces"].items():
        groups.setdefault((used, ", ".join(offered[name]) or "none stated"), []).append(name)
    heading, line, *rows = underlined([("interface", "offered"), *groups], texts=True).split("\n")
    joints = [folded(", ".join(names), width) for names in groups.values()]
    rows = [f"{row}\n{names}" for row, names in zip(rows, joints, strict=True)]
    return "\n".join([heading, line, *rows, *as_offered(content["interfaces"])])


def as_offered(used: Mapping[str, str]) -> Iterator[str]:
    """How to run a robot by the interfaces of its URDF, where these are not all efforts; one line to be copied."""
    keys = {name: name if BARE.fullmatch(name) else json.dumps(name, ensure_ascii=False) for name in used}
    others = ", ".join(f'{keys[name]}="{kind}"' for name, kind in used.items() if kind != "effort")
    if others:
        yield "mmnn run drives every motor by effort unless it is told otherwise, here as the URDF offers:"
        yield f"  --set {shlex.quote(f'interfaces={{{others}}}')}"


def gains(content: dict[str, Any] | None) -> str:
    """Gains of every velocity, and how to set them; empty where they were not asked for."""
    if content is None:
        return ""
    rows = [("gain of track", "gain", "inertia", "bandwidth")]
    for name, gain in content["gains"].items():
        rows.append((name, *(f"{value:.4g}" for value in (gain, content["inertia"][name], content["bandwidth"][name]))))
    keys = " ".join(f"--set {shlex.quote(f'{key}={value}')}" for key, value in content["set"].items())
    ours = ", ".join(f"{key.partition('.')[2]}={tuple(value)}" for key, value in content["set"].items())
    lines = ["gains in N s/m or N m s, inertias in kg or kg m^2, bandwidths in 1/s; for controllers without a network:"]
    lines += [f"  {keys}", f"  Feedback({ours}) in Python"]
    return "\n".join([underlined(rows), *lines])


def folded(names: str, width: int, indent: int = 2) -> str:
    """Names, indented, in lines of at most `width` characters; a name is never cut."""
    room = " " * indent
    return textwrap.TextWrapper(width, room, room, break_long_words=False, break_on_hyphens=False).fill(names)


def locked(content: dict[str, Any], width: int) -> Iterator[str]:
    """Joints that stand still, a paragraph per reason."""
    for why in dict.fromkeys(entry["why"] for entry in content.values()):
        places: dict[str, list[str]] = {}
        for name, entry in content.items():
            if entry["why"] == why:
                places.setdefault(f"{entry['position']:.4g}", []).append(" ".join(name.split()))
        lines = (folded(f"at {place}: {', '.join(names)}", width) for place, names in places.items())
        yield "\n".join([f"locked joints, {why}", *lines])


def underlined(rows: Sequence[Sequence[str]], texts: bool = False) -> str:
    """Rows in columns, a line under the heading; see `aligned`."""
    clean = [[" ".join(cell.split()) for cell in row] for row in rows]  # a name may hold a line break
    first, *others = aligned(clean, texts)
    return "\n".join([first, "-" * len(first), *others])


def aligned(rows: Sequence[Sequence[str]], texts: bool = False) -> list[str]:
    """Rows in columns, the first one to the left, the others to the right unless they are texts."""
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    place = str.ljust if texts else str.rjust
    others = ([place(cell, width) for cell, width in zip(row[1:], widths[1:], strict=True)] for row in rows)
    return ["  ".join([row[0].ljust(widths[0]), *cells]).rstrip() for row, cells in zip(rows, others, strict=True)]


# -- reduced model -----------------------------------------------------------------------------------------------------


def model_text(model: dict[str, Any], width: int = WIDTH) -> str:
    """Text of what `mmnn_pin.model.inspection.model_at` gives; columns of wide matrices go below each other."""
    names, full, motors = model["velocity_names"], model["full_velocity_names"], model["actuator_names"]
    rows = [f"constraint {i + 1}" for i in range(len(model["A"]))]
    forces = np.transpose([model["gravity"], model["friction"]])
    blocks = [
        f"robot {model['robot']}, base {model['base']}",
        "M nudot + C nu + gravity + friction = E u,   velocity = T nu,   A velocity = 0",
        *matrix("M", model["M"], names, names, width),
        *matrix("C", model["C"], names, names, width),
        *matrix("gravity, friction", forces, names, ["gravity", "friction"], width),
        *matrix("T", model["T"], full, names, width),
        *matrix("A", model["A"], rows, full, width),
        *matrix("E", model["E"], names, motors, width),
    ]
    return "\n\n".join(blocks)


def matrix(title: str, values: Any, rows: Sequence[str], columns: Sequence[str], width: int) -> Iterator[str]:
    """A matrix with names, some columns below the others where it is wider; nothing without rows or columns."""
    values = np.asarray(values, float)
    if not values.size:
        return
    names = [title, *rows]
    cells = [[name, *(f"{value:.5g}" for value in column)] for name, column in zip(columns, values.T, strict=True)]
    room, first = width - max(map(len, names)), 0
    while first < len(cells):
        last, taken = first, 0
        while last < len(cells) and (last == first or taken + 2 + max(map(len, cells[last])) <= room):
            taken += 2 + max(map(len, cells[last]))
            last += 1
        yield "\n".join(aligned([*zip(names, *cells[first:last], strict=True)]))
        first = last


# -- properties --------------------------------------------------------------------------------------------------------


def properties_dict(report: CheckReport) -> dict[str, Any]:
    """The report as the command line's JSON object; what is not finite is null."""
    tested, b = report.nonholonomic, report.bounds
    wheels = tested.with_wheels
    return {
        "robot": report.robot,
        "samples": report.samples,
        "seed": report.seed,
        "ok": report.passed,
        "properties": {
            name: {"worst": json_number(p.worst), "tolerance": p.tolerance, "pass": p.passed, "means": p.means}
            for name, p in report.properties.items()
        },
        "skipped": dict(report.skipped),
        "notes": list(report.notes),
        "bounds": {
            "M_min": json_number(b.M_min),
            "M_max": json_number(b.M_max),
            "C_b": json_number(b.C_b),
            "sampling": SAMPLING,
        },
        "nonholonomic": {
            "distribution": tested.pose.distribution if tested.pose else 0,
            "closure": tested.pose.closure if tested.pose else 0,
            "verdict": tested.verdict,
            "growth": list(tested.pose.growth) if tested.pose else [],
            "with_wheel_angles": wheels
            and asdict(wheels) | {"distribution": wheels.distribution, "closure": wheels.closure},
            "rank_tolerance": RANK_TOLERANCE,
        },
    }


def json_number(value: float) -> float | None:
    """Number for JSON: nothing where it is not finite."""
    return float(value) if math.isfinite(value) else None


@shows(CheckReport, "text")
def properties_text(report: CheckReport, columns: int = WIDTH) -> str:
    """The report for a terminal: the properties with what they mean, the bounds, the Frobenius test."""
    width = max(map(len, report.properties))
    lines = [f"robot {report.robot}: {report.samples} random states, seed {report.seed}", ""]
    lines.append(f"{'property':<{width}}  {'worst':>9}  {'allowed':>9}")
    for name, p in report.properties.items():
        allowed = f"{'>' if p.at_least else '<='} {p.tolerance:.0e}"
        row = f"{name:<{width}}  {p.worst:>9.1e}  {allowed:>9}  {'ok  ' if p.passed else 'FAIL'}  "
        lines.append(beside(row, p.means, columns))
    lines += [beside(f"{name:<{width}}  skipped: ", why, columns) for name, why in report.skipped.items()]
    lines += [beside("", note, columns) for note in report.notes]
    b = report.bounds
    lines += ["", f"reduced M: {b.M_min:.4g} I <= M <= {b.M_max:.4g} I (SI units);  ||C|| <= {b.C_b:.4g} ||nu||"]
    lines += [beside("  sampling: ", SAMPLING, columns), "", beside("base: ", report.nonholonomic.verdict, columns)]
    for where, found in (("pose", report.nonholonomic.pose), ("pose and wheels", report.nonholonomic.with_wheels)):
        if found is not None:
            ranks = " -> ".join(map(str, found.growth))
            lines.append(f"  {where}: rank {ranks} of {found.coordinates} by Lie brackets")
    failed = [name for name, p in report.properties.items() if not p.passed]
    lines += ["", f"FAILED: {', '.join(failed)}" if failed else "all properties hold"]
    return "\n".join(lines)


def beside(head: str, text: str, width: int) -> str:
    """A text behind a head, in lines of at most so many columns; on lines of its own where the head leaves no room."""
    room = textwrap.TextWrapper(width, break_long_words=False, break_on_hyphens=False)
    if len(head) > width - NARROWEST:
        room.initial_indent = room.subsequent_indent = "  "
        return f"{head.rstrip()}\n{room.fill(text)}"
    room.initial_indent, room.subsequent_indent = head, " " * len(head)
    return room.fill(text)


# -- the robots of runs ------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class RobotShown:
    """A robot.

    Attributes:
        name: Its name.
        understood: Base, wheels, arm and what is locked, as text.
        findings: Those of the audit, with `severity` and `text`.
        checks: The property checks, as text.
        ok: Whether all properties hold.
    """

    name: str
    understood: str
    findings: tuple[dict[str, Any], ...]
    checks: str
    ok: bool

    @property
    def counts(self) -> str:
        """How many warnings and notes there are, in words."""
        numbers = {kind: sum(f["severity"] == kind for f in self.findings) for kind in ("error", "warning", "note")}
        words = [f"{n} {kind}{'s' * (n != 1)}" for kind, n in numbers.items() if n]
        return ", ".join(words) or "nothing to remark"


def robots_of(recordings: Mapping[str, Recording]) -> list[RobotShown]:
    """The different robots of some runs.

    Raises:
        InputError: The robot of a run cannot be built.
    """
    keys = ("urdf_sha256", "overrides", "mass_factors", "viscous")
    different = {repr([recording.meta.get(key) for key in keys]): recording for recording in recordings.values()}
    return [about_robot(recording) for recording in different.values()]


def about_robot(recording: Recording, samples: int = CHECK_SAMPLES) -> RobotShown:
    """The robot of a run."""
    robot = recorded_robot(recording)
    sha256 = recording.meta.get("urdf_sha256", "not recorded")
    content = inspection_of(robot) | {"file": robot.path.name, "sha256": sha256}
    report = check(robot, samples, CHECK_SEED)
    found = [f | {"text": f["text"].replace(str(robot.path), robot.path.name)} for f in content["findings"]]
    if Path(recording.meta["urdf_file"]).suffix == ".xacro":  # a recording has what came of it
        note = replace(EXPANDED, file=robot.path.name)
        found.insert(0, {"severity": note.severity, "text": str(note)})
    findings = tuple(found)
    return RobotShown(robot.name, understood_text(content), findings, properties_text(report), report.passed)

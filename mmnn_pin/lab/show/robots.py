"""A robot as text: what was understood of its file, its reduced model, and whether its properties hold."""

from __future__ import annotations

import math
import re
import shlex
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ...errors import few
from ...model.arm import WHY
from ...model.checks.nonholonomy import RANK_TOLERANCE
from ...model.checks.properties import BOUNDS, CheckReport, check
from ...model.inspection import inspection_of
from ...model.urdf.expansion import EXPANDED
from ...settings import finite
from ...shown import shows
from ..experiments.hardware_table import UNKNOWN
from .table import WIDTH, Cell, Column, Table, TextLine, alike, hanging, row_of, terminal_text

if TYPE_CHECKING:
    from ...recording.recording import Recording

SAMPLING = "positions uniform within limits (else +-pi, +-1 m), velocities standard normal; an estimate from inside"
CHECK_SAMPLES = 20  # random states of the property checks
CHECK_SEED = 0
LONGEST = 120  # letters of a line of what was understood
STRAIGHT = 0.02  # of a quarter turn: what forward may be off an axis by and is said to be along it
OPTION = re.compile(  # and its value
    r"(--[a-z-]+)((?: (?:'[^']*'|(?!(?:where|or|with|for|and|if|to|name)\b)[^\s;]*[^\s;,]))?)"
)
DOUBTS = {  # what a finding leaves in doubt, by its code
    "base-doubt": "what the base is",
    "base-shapes": "the radius",
    "base-hub-height": "the radius",
    "base-radius": "the radii",
    "base-stated": "dimensions, which a file states otherwise",
    "base-roller": "the rollers' angle",
    "base-sides": "left and right",
    "base-pair": "the wheels",
    "base-stray": "joints that may be wheels",
    "base-floor": "how high the floor is",
    "arm-passive": "the arm",
}


def inspection_text(content: dict[str, Any], width: int = WIDTH) -> str:
    """The tables and the findings of what `model.inspection.inspection_of` gives, as text.

    Names are folded to `width` columns; a finding stays one line, so that it can be searched for. Several of one kind
    are told once, with how many there are.
    """
    findings = "".join(f"\n  {line}" for line in alike(finding["text"] for finding in content["findings"]))
    last = f"findings ({len(content['findings'])}){findings}" if findings else "no findings"
    return f"{understood_text(content, width)}\n\n{last}"


def summary(content: dict[str, Any]) -> list[str]:
    """A line of a robot's base as it was understood, one of its arm, and one of what is in doubt of them."""
    base, arm, doubts = content["base"], content["arm"]["joints"], dict[str, list[str]]()
    for finding in content["findings"]:
        if about := DOUBTS.get(finding["code"]):
            doubts.setdefault(about, []).append(finding["fix"])
    held = [name for name, entry in content["locked_at"].items() if entry["why"] != WHY["base"]]
    locked = f"; locked: {names_in(held, LONGEST // 3)}" if held else ""
    has = f"{len(arm)} joint{'s' * (len(arm) != 1)}: {names_in(arm, LONGEST - 20 - len(locked))}" if arm else "no arm"
    named = {about: ", ".join(dict.fromkeys(options_in("; ".join(fixes)))) for about, fixes in doubts.items()}
    said = (f"{about} ({options})" if options else about for about, options in named.items())
    hands = [hand["frame"] for hand in content["arm"]["hands"]]
    hand = f"; hand{'s' * (len(hands) != 1)}: {names_in(hands, LONGEST // 3)}" if hands else ""
    hand = hand if len(f"arm: {has}{hand}{locked}") <= LONGEST else ""
    lines = [f"base: {base_summary(base)}", f"arm: {has}{hand}{locked}"]
    return [*lines, f"in doubt: {'; '.join(said)}"] if doubts else lines


def options_in(fix: str) -> list[str]:
    """Options that a fix names, as they are typed; an option without a value only where none has one."""
    found = ["".join(parts) for parts in OPTION.findall(fix)]
    return [option for option in found if not any(other.startswith(f"{option} ") for other in found)]


def summary_text(content: dict[str, Any], width: int = WIDTH) -> str:
    """The lines of `summary`, folded where a terminal is narrow."""
    heads = (line.partition(": ") for line in summary(content))
    return "\n".join(hanging(f"{head}: ", text, width if width < WIDTH else 9 * WIDTH) for head, _, text in heads)


def base_summary(base: dict[str, Any]) -> str:
    """Kind, wheels, radius, track or wheelbase, and forward of a base in one line."""
    wheels, parts = base["wheels"], [base["kind"].replace("_", " ")]
    steers = [p["joint"] for p in base.get("pivots", ()) if p["role"] != "passive"]
    driven = [w for w in wheels if w.get("driven", True)]
    if base["track"] and not steers and all(abs(math.sin(w["heading"])) < 0.1 for w in wheels):
        sides = [[w["joint"] for w in driven if w["y"] * side > 0] for side in (1, -1)]
        parts += [f"{side} {names_in(names, 30)}" for side, names in zip(("left", "right"), sides, strict=True)]
    elif wheels:
        parts += [f"steered {names_in(steers, 30)}"] * bool(steers)
        parts.append(f"driven {names_in([w['joint'] for w in driven], 40)}")
    radii = sorted({f"{w['radius']:.4g}" for w in wheels}, key=float)
    parts += [f"radius {' to '.join(radii[:: max(len(radii) - 1, 1)])} m"] * bool(radii)
    parts += [f"track {base['track']:.4g} m"] * bool(base["track"])
    if steers and "length" in base:
        parts.append(f"wheelbase {base['length']:.4g} m")
    if base["kind"] != "fixed":
        parts.append(f"forward {forward_name(base['frame'][2])}")
    return ", ".join(parts)


def forward_name(heading: float) -> str:
    """A direction by the axis of the root link that it is along, else its angle from x [rad]."""
    quarters = heading / (math.pi / 2)
    if abs(quarters - round(quarters)) < STRAIGHT:
        return ("x", "y", "-x", "-y")[round(quarters) % 4]
    return f"{math.degrees(heading):.3g} deg from x"


def names_in(names: Sequence[str], room: int) -> str:
    """Names, one after the other, as many as there is room for, and how many more there are."""
    shown = [one_line(name) for name in names]
    kept = next((k for k in range(len(shown), 1, -1) if len(", ".join(shown[:k])) <= room), 1)
    return few(shown, kept)


def understood_text(content: dict[str, Any], width: int = WIDTH) -> str:
    """A robot in short; its base, wheels, arm and locked joints."""
    tables = (
        wheels(content["base"]),
        pivots(content["base"]),
        arm(content["arm"]),
        interfaces(content),
        hardware(content),
        gains(content.get("track")),
    )
    text = "\n".join(
        [
            summary_text(content, width),
            "",
            *head(content, width),
            terminal_text((part for parts in tables for part in parts), width=width),
        ]
    )
    return "\n\n".join([text.rstrip(), *locked(content["locked_at"], width)])


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


def head(content: dict[str, Any], width: int) -> Iterator[str]:
    """Lines of the file, the mass and the base."""
    base = content["base"]
    lines = {"file": content["file"], "sha256": content["sha256"], "mass": f"{content['mass']:.4g} kg"}
    lines["base"] = base["kind"].replace("_", " ")
    if base["kind"] != "fixed":
        x, y, heading, floor = map(tidy, (*base["frame"], base["floor"]))
        if base["track"] or "pivots" not in base:
            lines["track"] = f"{base['track']:.4g} m"
        lines["control frame"] = f"x {x:.4g} m, y {y:.4g} m, heading {math.degrees(heading):.4g} deg in the root link"
        lines["floor"] = f"{floor:.4g} m above the root link's origin"
    for name, value in lines.items():
        yield f"{name:16}{value}"
    for key in ("casters", "suspensions"):
        if base[key]:
            yield hanging(f"{key:16}", ", ".join(base[key]), width)


def wheels(base: dict[str, Any]) -> Iterator[Table]:
    """Drive wheels with radius, sign and place; of a base that steers all wheels, and what carries and drives them."""
    steers = "pivots" in base
    heads = (Column("radius", "m"), Column("sign"), Column("x", "m"), Column("y", "m"))
    last = (Column("motor"), Column("on", text=True)) if steers else (Column("roller", "deg"),)
    rows = []
    for w in base["wheels"]:
        roller = "-" if w["roller"] is None else f"{math.degrees(w['roller']):.4g}"
        more = ("yes" if w["driven"] else "-", one_line(w["on"] or "body")) if steers else (roller,)
        radius, x, y = (f"{tidy(w[key]):.4g}" for key in ("radius", "x", "y"))
        rows.append(row_of(one_line(w["joint"]), radius, f"{w['sign']:+d}", x, y, *more))
    if rows:
        title = "Wheels" if steers else "Drive wheels"
        yield Table(title, (Column(title[:-1].lower(), text=True), *heads, *last), tuple(rows))


def pivots(base: dict[str, Any]) -> Iterator[Table]:
    """Steering joints, casters and hitches of a base that steers, with places, stops and motors."""
    heads = (Column("x", "m"), Column("y", "m"), Column("lower"), Column("upper"), Column("rate"), Column("motor"))
    rows = []
    for p in base.get("pivots", ()):
        places = (f"{tidy(p[key]):.4g}" for key in ("x", "y"))
        limits = ("-" if p[key] is None else f"{p[key]:.4g}" for key in ("lower", "upper", "rate"))
        last = "yes" if p["motor"] else "-", one_line(p["on"] or "body")
        rows.append(row_of(one_line(p["joint"]), p["role"], *places, *limits, *last))
    if rows:
        named = Column("pivot", text=True), Column("role", text=True)
        yield Table("Pivots", (*named, *heads, Column("on", text=True)), tuple(rows))


def tidy(value: float) -> float:
    """A length without dust of rounding, and no -0."""
    return round(value, 9) + 0.0


def arm(content: dict[str, Any]) -> Iterator[Table | str]:
    """Arm joints with limits, and what follows them."""
    rows = []
    for name in content["joints"]:
        numbers = (content["limits"][name][key] for key in ("lower", "upper", "effort"))
        rows.append(row_of(one_line(name), *("-" if limit is None else f"{limit:.4g}" for limit in numbers)))
    if not rows:
        yield "no arm"
        return
    heads = (Column("arm joint", text=True), Column("lower"), Column("upper"), Column("effort"))
    yield Table("Arm", heads, tuple(rows))
    yield "angles in rad, travels in m, efforts in N m or N; - for no limit"
    for hand in content["hands"]:
        yield f"hand {one_line(hand['frame'])}, {len(hand['joints'])} joints: {hand['why']}"
    for name, slave in content["slaves"].items():
        yield f"{name} follows: {slave['multiplier']:.4g} {slave['master']} {slave['offset']:+.4g}"


def interfaces(content: dict[str, Any]) -> Iterator[Table | TextLine]:
    """Command interfaces that are used and offered, with their joints; nothing where the URDF states none."""
    offered = content["interfaces_offered"]
    if not any(offered.values()):
        return
    groups: dict[tuple[str, str], list[str]] = {}
    for name, used in content["interfaces"].items():
        groups.setdefault((used, ", ".join(offered[name]) or "none stated"), []).append(name)
    rows = (row_of(*kinds, ", ".join(map(one_line, names))) for kinds, names in groups.items())
    heads = (Column("interface", text=True), Column("offered", text=True), Column("joints", text=True, fold=True))
    yield Table("Interfaces", heads, tuple(rows))


def hardware(content: dict[str, Any]) -> Iterator[TextLine]:
    """The way to run a robot on its hardware, or one that is assumed: a line to be copied."""
    if (proposal := content.get("hardware")) is None:
        return
    which = "what is slower and coarser than most" if proposal["profile"] == UNKNOWN else proposal["profile"]
    yield TextLine(f"By default motors give at once what the URDF lets them. With {which}:")
    yield TextLine(f"  {proposal['run']}", whole=True)


def gains(content: dict[str, Any] | None) -> Iterator[Table | TextLine]:
    """Gains of every velocity, and how to set them; nothing where they were not asked for."""
    if content is None:
        return
    columns = ("gains", "inertia", "bandwidth")
    rows = (row_of(one_line(name), *(f"{content[key][name]:.4g}" for key in columns)) for name in content["gains"])
    heads = (Column("gain of track", text=True), Column("gain"), Column("inertia"), Column("bandwidth"))
    yield Table("Gains", heads, tuple(rows))
    keys = " ".join(f"--set {shlex.quote(f'{key}={value}')}" for key, value in content["set"].items())
    ours = ", ".join(f"{key.partition('.')[2]}={tuple(value)}" for key, value in content["set"].items())
    units = "gains in N s/m or N m s, inertias in kg or kg m^2, bandwidths in 1/s; for controllers without a network:"
    yield TextLine(units)
    yield TextLine(f"  {keys}\n  Feedback({ours}) in Python", whole=True)


def one_line(name: str) -> str:
    """A name of a URDF, which may hold line breaks, on one line."""
    return " ".join(name.split())


def locked(content: dict[str, Any], width: int) -> Iterator[str]:
    """Joints that stand still, a paragraph per reason."""
    for why in dict.fromkeys(entry["why"] for entry in content.values()):
        places: dict[str, list[str]] = {}
        for name, entry in content.items():
            if entry["why"] == why:
                places.setdefault(f"{entry['position']:.4g}", []).append(one_line(name))
        lines = (hanging("  ", f"at {place}: {', '.join(names)}", width) for place, names in places.items())
        yield "\n".join([f"locked joints, {why}", *lines])


# -- reduced model -----------------------------------------------------------------------------------------------------


def model_text(model: dict[str, Any], width: int = WIDTH) -> str:
    """Text of what `mmnn_pin.model.inspection.model_at` gives; columns of wide matrices go below each other."""
    names, full, motors = model["velocity_names"], model["full_velocity_names"], model["actuator_names"]
    rows = [f"constraint {i + 1}" for i in range(len(model["A"]))]
    forces = np.transpose([model["gravity"], model["friction"]])
    tables = (
        matrix("M", model["M"], names, names),
        matrix("C", model["C"], names, names),
        matrix("gravity, friction", forces, names, ["gravity", "friction"]),
        matrix("T", model["T"], full, names),
        matrix("A", model["A"], rows, full),
        matrix("E", model["E"], names, motors),
    )
    head = f"robot {model['robot']}, base {model['base']}"
    equations = "M nudot + C nu + gravity + friction = E u,   velocity = T nu,   A velocity = 0"
    shown = (table for table in tables if table.rows)
    return terminal_text([TextLine(f"{head}\n{equations}", whole=True), *shown], width=width)


def matrix(title: str, values: Any, rows: Sequence[str], columns: Sequence[str]) -> Table:
    """A matrix with names; without rows one that has no columns."""
    cells = np.asarray(values, float).reshape(len(rows), len(columns))
    named = [row_of(one_line(name), *(f"{value:.5g}" for value in row)) for name, row in zip(rows, cells, strict=True)]
    heads = (Column(title, text=True), *(Column(one_line(name)) for name in columns))
    return Table(title, heads, tuple(named) if cells.size else ())


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
            name: {"worst": finite(p.worst), "tolerance": p.tolerance, "pass": p.passed, "means": p.means}
            for name, p in report.properties.items()
        },
        "skipped": dict(report.skipped),
        "notes": list(report.notes),
        "bounds": {key: finite(getattr(b, key)) for key in ("M_min", "M_max", "C_b")} | {"sampling": SAMPLING},
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


@shows(CheckReport, "text")
def properties_text(report: CheckReport, columns: int = WIDTH) -> str:
    """The report for a terminal: the properties with what they mean, the bounds, the Frobenius test."""
    rows = []
    for name, p in report.properties.items():
        verdict = Cell("ok") if p.passed else Cell("FAIL", "bad")
        worst, limit = (f"{x:.4g}" if name in BOUNDS else f"{x:.{n}e}" for x, n in ((p.worst, 1), (p.tolerance, 0)))
        rows.append(row_of(name, worst, f"{'>' if p.at_least else '<='} {limit}", verdict, p.means))
    rows += [row_of(name, "", "", "skipped", why) for name, why in report.skipped.items()]
    heads = (Column("property", text=True), Column("worst"), Column("allowed"))
    table = Table("Properties", (*heads, Column(text=True), Column("means", text=True, fold=True)), tuple(rows))
    b, tested = report.bounds, report.nonholonomic
    bounds = f"reduced M: {b.M_min:.4g} I <= M <= {b.M_max:.4g} I (SI units);  ||C|| <= {b.C_b:.4g} ||nu||"
    head = f"robot {report.robot}: {report.samples} random states, seed {report.seed}"
    parts: list[str | TextLine | Table] = [head, table, *report.notes]
    parts += [TextLine(bounds, whole=True), hanging("  sampling: ", SAMPLING, columns), "", f"base: {tested.verdict}"]
    for where, found in ((tested.on, tested.pose), ("pose and wheels", tested.with_wheels)):
        if found is not None:
            ranks = " -> ".join(map(str, found.growth))
            parts.append(f"  {where}: rank {ranks} of {found.coordinates} by Lie brackets")
    failed = [name for name, p in report.properties.items() if not p.passed]
    parts += ["", f"FAILED: {', '.join(failed)}" if failed else "all properties hold"]
    return terminal_text(parts, width=columns)


# -- the robots of runs ------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class RobotShown:
    """A robot."""

    name: str  # its name
    understood: str  # base, wheels, arm and what is locked, as text
    findings: tuple[dict[str, Any], ...]  # those of the audit, with `severity` and `text`
    checks: str  # the property checks, as text
    ok: bool  # whether all properties hold

    @property
    def counts(self) -> str:
        """Numbers of warnings and notes, in words."""
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
    from ...recording.recording import recorded_robot  # h5py, which `mmnn inspect` needs not

    robot = recorded_robot(recording)
    sha256 = recording.meta.get("urdf_sha256", "not recorded")
    content = inspection_of(robot) | {"file": robot.path.name, "sha256": sha256}
    report = check(robot, samples, CHECK_SEED, placements=False)
    found = [f | {"text": f["text"].replace(str(robot.path), robot.path.name)} for f in content["findings"]]
    if Path(recording.meta["urdf_file"]).suffix == ".xacro":  # a recording has what came of it
        note = replace(EXPANDED, file=robot.path.name)
        found.insert(0, {"severity": note.severity, "text": str(note)})
    findings = tuple(found)
    return RobotShown(robot.name, understood_text(content), findings, properties_text(report), report.passed)

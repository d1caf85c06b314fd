"""What is reported of how a robot was understood: notes with stable codes beside the audit's, and refusals.

A refusal lists what the base could be, each with the reasons for and against, or names the machine.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ...elementary import cos, sin
from ...errors import RobotError
from ..arm import Arm
from ..urdf.document import Joint
from ..urdf.finding import AuditError, Finding, one_line
from ..urdf.shapes import HORIZONTAL, VERTICAL, AtRest
from . import KINDS
from .base import Base
from .differential import DifferentialDrive
from .evidence import RADII, TRACKS, Evidence, beside, evidence, in_yaml, stated
from .overrides import Overrides
from .skid_steer import GRAVITY
from .wheels import HUB, LUMPY, PARTIAL, STATED, UNSEEN, Candidate, Candidates, coaxial

GO_ON = "name the drive wheels with --wheels LEFT,RIGHT, or say what it is with --base"

STRAIGHT = 0.7  # cosine of the largest angle between rolling direction and root link that is not told

LARGE, WIDE = 2.0, 3.0  # [m], fraction of the track; no wheel of a robot has a larger radius

SAME_RADIUS = 0.01  # radii that differ by more than this fraction are told

OPINION = 0.01  # lengths that differ by more than this fraction are told

OFF_FLOOR = 0.02  # wheels further than this fraction of their radius from the footprint are told

# Severity by code; docs/reference/urdf-audit.md tells each with its reason.
CODES = {
    # refused, with the candidates or the machine's name
    "base-undecided": "error",
    "base-unsupported": "error",
    "robot": "error",
    # the base
    "base-evidence": "note",
    "base-roller": "warning",
    "base-omni": "note",
    "base-none": "note",
    "base-pushed": "warning",
    "base-sides": "warning",
    "base-radius": "warning",
    "base-heading": "warning",
    "base-hub-height": "warning",
    "base-size": "error",
    "base-shapes": "warning",
    "base-joints": "note",
    "base-stated": "warning",
    "base-driven": "note",
    "base-stray": "warning",
    "base-pair": "warning",
    "base-skid": "note",
    "base-floor": "warning",
    "base-friction": "warning",
    "base-welded": "warning",
    # the arm and the rest
    "arm-locked": "note",
    "welded": "warning",
    "pinocchio": "warning",
    "overrides": "note",
}


@dataclass(frozen=True, eq=False)
class BaseResult:
    """A base, and what was noticed on the way.

    Attributes:
        base: The base.
        findings: Warnings and notes.
    """

    base: Base
    findings: tuple[Finding, ...] = ()


# -- notes -------------------------------------------------------------------------------------------------------------


def note(rest: AtRest, code: str, joint: str, what: str, why: str = "", fix: str = "", about: str = "base") -> Finding:
    """A finding of a code in `CODES` about what was understood, at the line of a joint, or 1 without one."""
    severity = "warning" if CODES[code] == "strict" else CODES[code]
    line = rest.document.joints[joint].line if joint else 1
    return Finding(severity, code, str(rest.document.path), line, about, what, why, fix)


def settle(audited: Sequence[Finding], findings: Sequence[Finding], strict: bool) -> tuple[Finding, ...]:
    """The audit's findings and those of the understanding, if strictness makes an error of none.

    Raises:
        AuditError: It does.
    """
    pieces = [replace(f, severity="error" if strict and CODES[f.code] == "strict" else f.severity) for f in findings]
    if any(f.severity == "error" for f in pieces):
        raise AuditError([*audited, *pieces])
    return (*audited, *pieces)


def base_notes(rest: AtRest, base: Base, wheels: Sequence[Candidate], given: bool) -> list[Finding]:
    """Warnings about radii that are odd, differ or are not measured, and a floor that is not the root's.

    Args:
        rest: The robot at rest.
        base: Its base.
        wheels: Its drive wheels, and maybe others.
        given: Whether the user states the radius.
    """
    if not base.wheels:
        return []
    notes, first, radii = [], base.wheels[0].joint, [wheel.radius for wheel in base.wheels]
    blind = [c for c in wheels if c.shape == HUB and c.joint.name in [w.joint for w in base.wheels]]
    if blind:
        sizes = ", ".join(f"'{c.joint.name}' {c.radius:.4g} m" for c in blind)
        text = f"radii assumed from the height of the hubs above the floor: {sizes}"
        why, fix = "no shape of them can be read", "--radius, or --package-dir where their meshes are"
        notes.append(note(rest, "base-hub-height", blind[0].joint.name, text, why, fix))
    sides = [side if side in w.joint.lower() else "" for w, side in zip(base.wheels, ("right", "left"), strict=False)]
    if isinstance(base, DifferentialDrive) and all(sides):
        text = f"'{first}' is on the left: does the robot drive along -x?"
        why = "names decide nothing: forward is the rolling direction nearer the root link's x"
        notes.append(note(rest, "base-sides", first, text, why, "check it"))
    if len(base.wheels) != 3 and abs(cos(base.frame[2])) < STRAIGHT:
        turned = np.degrees(base.frame[2])
        text = f"the wheels roll at {turned:.3g} degrees from the x of the root link '{rest.document.root_link}'"
        why, fix = "forward is where they roll", "turn the axes of their joints if they roll along x"
        notes.append(note(rest, "base-heading", first, text, why, fix))
    large = [w for w in base.wheels if w.radius > LARGE or 0 < WIDE * base.track < w.radius]
    if large and not given:
        text = f"wheel '{large[0].joint}' has a radius of {large[0].radius:.4g} m on a track of {base.track:.4g} m"
        why, fix = "is its mesh in millimetres or inches?", "give the mesh its scale, or --radius"
        notes.append(note(rest, "base-size", large[0].joint, text, why, fix))
    if max(radii) - min(radii) > SAME_RADIUS * max(radii):
        sizes = ", ".join(f"'{w.joint}' {w.radius:.4g} m" for w in base.wheels)
        why, fix = "they are used as they are", "--radius if they should be alike"
        notes.append(note(rest, "base-radius", first, f"the wheels' radii differ: {sizes}", why, fix))
    if rest.is_footprint and abs(base.floor) > OFF_FLOOR * max(radii):
        where, root = "below" if base.floor < 0 else "above", rest.document.root_link
        text = f"the wheels touch the ground {abs(base.floor):.3g} m {where} the root link '{root}'"
        notes.append(note(rest, "base-floor", first, text, "the floor is taken where the wheels are"))
    return [*notes, *friction_note(rest, base)]


def friction_note(rest: AtRest, base: Base) -> list[Finding]:
    """A warning where the friction of the wheels' joints, at 1 m/s, takes more than any floor gives the wheels."""
    joints = rest.document.joints
    force = sum((joints[w.joint].damping / w.radius + joints[w.joint].friction) / w.radius for w in base.wheels)
    weight = GRAVITY * math.fsum(rest.mass(name) for name in rest.document.links)
    if force <= weight:
        return []
    first = base.wheels[0].joint
    times = f"{force / weight:.2g} times the weight"
    text = f"rolling at 1 m/s takes {force:.3g} N against the friction of the wheels' joints, {times}"
    why = "no floor gives wheels that grip: a simulator's number? PD hardly moves such a base"
    dynamics = f'damping="{joints[first].damping:g}" friction="{joints[first].friction:g}"'
    return [note(rest, "base-friction", first, text, why, f"state the measured friction instead of {dynamics}")]


def second_opinions(rest: AtRest, base: Base, wheels: Sequence[Candidate], overrides: Overrides) -> Iterator[Finding]:
    """What the distance of the joints, plugins and controllers say of track and radius where geometry says otherwise.

    Args:
        rest: The robot at rest.
        base: Its base.
        wheels: Its drive wheels, and maybe others.
        overrides: What the user says; that is not questioned.

    Raises:
        ConfigError: The controllers' file cannot be read.
    """
    if not base.wheels or any(abs(sin(w.heading)) > HORIZONTAL for w in base.wheels):
        return
    own = [c for c in wheels if c.joint.name in {w.joint for w in base.wheels}]
    first, radius = base.wheels[0].joint, float(np.median([w.radius for w in base.wheels]))
    left = np.array([-sin(base.frame[2]), cos(base.frame[2])])
    across = [float(rest.hub(c.joint)[:2] @ left) for c in own]
    joints, contacts = max(across) - min(across), max(w.y for w in base.wheels) - min(w.y for w in base.wheels)
    if overrides.track is None and apart(joints, contacts):
        text = f"the wheels touch the floor {contacts:.4g} m apart, their joints are {joints:.4g} m apart"
        yield note(rest, "base-joints", first, text, "the track is that of the contacts", "--track for another")
    unseen = [c.joint.name for c in own if c.shape in UNSEEN]
    if unseen and overrides.track is None and len(base.wheels) > 1:
        text = f"the track of {contacts:.4g} m is that of the joints: where {', '.join(unseen)} touch cannot be seen"
        fix = "--track for another, or --package-dir where their meshes are"
        yield note(rest, "base-joints", first, text, "no shape of them can be read whole", fix)
    for c in own if overrides.radius is None else ():
        if not math.isnan(c.other) and apart(c.other, c.radius):
            text = (
                f"'{c.joint.name}' has a radius of {c.radius:.4g} m by its collision shapes, {c.other:.4g} m by sight"
            )
            yield note(rest, "base-shapes", c.joint.name, text, "taken are the former", f"--radius {c.other:.4g}")
            break
    blind = [c.joint.name for c in own if c.shape == STATED and overrides.radius is None]
    questions = [("track", base.track, stated(rest, overrides.controllers_file, TRACKS)), ("radius", radius, [])]
    questions[1] = ("radius", radius, stated(rest, overrides.controllers_file, RADII))
    for name, used, opinions in questions:
        for opinion in opinions if getattr(overrides, name) is None else ():
            if blind and name == "radius":
                text = f"the radius {used:.4g} m of {', '.join(blind)} is what the file states: {opinion.text}"
                why, fix = "no shape of them can be read whole", "--radius, or --package-dir where their meshes are"
                yield note(rest, "base-stated", first, text, why, fix)
            elif apart(opinion.value, used):
                text = f"{opinion.text} states a {name} of {opinion.value:.4g} m, its geometry {used:.4g} m"
                yield note(rest, "base-stated", first, text, "taken is the geometry", f"--{name} {opinion.value:.6g}")


def unasked(rest: AtRest, base: Base, overrides: Overrides) -> Iterator[Finding]:
    """What controllers' files beside the robot's state of its track and radius, where none says what its geometry does.

    They are told, not used: a file may be another robot's.
    """
    if not base.wheels or base.is_pushed or overrides.controllers_file is not None:
        return
    files = beside(rest)
    for name, used, names in (("track", base.track, TRACKS), ("radius", base.wheels[0].radius, RADII)):
        found = [(file, one) for file in files for one in in_yaml(str(file), names)]
        if getattr(overrides, name) is None and found and all(apart(one.value, used) for _, one in found):
            file, one = found[0]
            text = f"{file} states a {name} of {one.value:.4g} m, the geometry has {used:.4g} m"
            fix = f"--controllers {file} where it is this robot's, --{name} {one.value:.6g} to use it"
            yield note(rest, "base-stated", base.wheels[0].joint, text, "taken is the geometry", fix)


def apart(one: float, other: float) -> bool:
    """Whether two lengths differ by more than is told."""
    return abs(one - other) > OPINION * max(abs(one), abs(other))


def welded_note(rest: AtRest, welded: Sequence[Joint]) -> list[Finding]:
    """Wheels beside the drive wheels that are welded on."""
    text = f"wheels on the floor are welded on: {', '.join(joint.name for joint in welded)}"
    why, fix = "taken as sliding without friction", "make their joints continuous if they turn"
    return [note(rest, "base-welded", welded[0].name, text, why, fix)] if welded else []


def evidence_note(rest: AtRest, meaning: str, cited: list[Evidence]) -> Finding:
    """What made four parallel wheels mecanum wheels, or wheels that skid."""
    texts = list(dict.fromkeys(piece.text for piece in cited))
    more = f" and {len(texts) - 4} more" if len(texts) > 4 else ""
    text = f"taken as {meaning}: {'; '.join(texts[:4])}{more}"
    return replace(note(rest, "base-evidence", "", text), line=cited[0].line)


def arm_notes(rest: AtRest, arm: Arm) -> list[Finding]:
    """What was locked without being asked to, one note per reason."""
    notes = []
    for reason in dict.fromkeys(arm.reasons.values()):
        names = [name for name, why in arm.reasons.items() if why == reason]
        if "taken as a" in reason:
            text, fix = f"locked: {', '.join(names)}", "--free JOINT lets one move, --free all every one"
            notes.append(note(rest, "arm-locked", names[0], text, reason, fix, "arm"))
    return notes


def weld_notes(rest: AtRest, names: Sequence[str]) -> list[Finding]:
    """Planar and floating joints that were welded."""
    why, fix = "the loader places the robot in the world itself", "none needed, unless it should move in the arm"
    text = "a planar or floating joint is taken as fixed"
    return [note(rest, "welded", name, text, why, fix, f"joint '{name}'") for name in names]


def printed_notes(rest: AtRest, printed: str) -> list[Finding]:
    """What Pinocchio's parser printed about a file that it accepts."""
    text = f"Pinocchio's parser says: {one_line(printed)}"
    return [note(rest, "pinocchio", "", text, about="")] if printed else []


# -- refusals ----------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Reading:
    """One way to read the geometry of a base.

    Attributes:
        kind: What the base would be.
        reasons: What speaks for it.
        objections: What speaks against it.
    """

    kind: str
    reasons: tuple[str, ...] = ()
    objections: tuple[str, ...] = ()

    def __str__(self) -> str:
        parts = [f"for: {', '.join(self.reasons)}"] if self.reasons else []
        parts += [f"against: {', '.join(self.objections)}"] if self.objections else []
        return f"{self.kind} ({'; '.join(parts)})" if parts else self.kind


class Undecided(RobotError):
    """Geometry and evidence do not tell what the base is.

    Attributes:
        candidates: The joints that could be wheels, each with what is known of it.
        readings: What the base could be, each with the reasons for and against it.
    """

    candidates: tuple[str, ...] = ()
    readings: tuple[Reading, ...] = ()


class Unsupported(RobotError):
    """The machine is understood, and it is none that this package can drive.

    Attributes:
        machine: What it is: `car-like base`, `tracked machine`, `legged machine`, `humanoid`, `drone`, ...
    """

    machine: str = ""


def readings(rest: AtRest, drives: list[Candidate]) -> list[Reading]:
    """What a base on these wheels could be, with the reasons for and against."""
    pieces = evidence(rest, drives)
    speaks = {
        kind: tuple(dict.fromkeys(p.text for p in pieces if p.meaning == kind)) for kind in ("holonomic", "skid_steer")
    }
    many = len(drives) >= 4
    pairs = sum(coaxial(a, b) for i, a in enumerate(drives) for b in drives[:i])
    two = Reading(
        "differential_drive",
        (f"{pairs} pair(s) of coaxial wheels",) if pairs else (),
        (f"{len(drives)} wheel(s) that do not swivel",) if len(drives) != 2 else ("they are not on one axle",),
    )
    if not many:
        return [two]
    rolls = Reading("holonomic", ("four or more parallel wheels", *speaks["holonomic"]), speaks["skid_steer"])
    skids = Reading("skid_steer", ("four or more parallel wheels", *speaks["skid_steer"]), speaks["holonomic"])
    return [rolls, skids, two]


def undecided(
    rest: AtRest,
    wheels: list[Candidate],
    pieces: list[Reading],
    why: str,
    fix: str = GO_ON,
    line: int | None = None,
    names: str = "",
) -> Undecided:
    """The error that lists what could be a wheel, and what the base could be."""
    texts = tuple(c.text for c in wheels)
    none = f"no wheel turns: {names}" if names else "no wheels found"
    listed = f"{len(wheels)} wheel(s) found: {'; '.join(texts)}" if wheels else none
    error = Undecided(
        f"the base is undecided: {listed}; it could be {' or '.join(map(str, pieces))}",
        why=why,
        fix=fix,
        file=rest.document.path,
        line=line or (wheels[0].joint.line if wheels else None),
    )
    error.candidates, error.readings = texts, tuple(pieces)
    return error


def not_on_floor(rest: AtRest, candidates: Candidates) -> Undecided:
    """The error for what would be drive wheels but for one thing."""
    near_misses, fix = candidates.near_misses, GO_ON + "; --base fixed parks them"
    if any(abs(c.axis[2]) > VERTICAL for c in near_misses):
        why = "their axle is vertical"
        fix = "turn the robot so that z points up (a file with y up?); --base fixed parks them"
    elif any(abs(c.axis[2]) > HORIZONTAL for c in near_misses):
        why = "wheels roll about a horizontal axis here, not with camber"
    elif any(c.shape == LUMPY for c in near_misses):
        why, fix = "what turns on them is not round about the axle", blind_fix(near_misses)
    elif any(math.isnan(c.radius) for c in near_misses):
        why = "no shape of them can be read, and nothing tells where the floor is"
        if any(c.shape == PARTIAL for c in near_misses):
            why = "meshes are missing, none is measured from what is left, and nothing tells where the floor is"
        fix = "give --radius METRES, and --package-dir FOLDER where their meshes are; --base fixed parks them"
    else:
        why = f"they end {min(c.bottom for c in near_misses) - candidates.floor:.3g} m above the robot's lowest point"
    return undecided(rest, near_misses, [Reading("differential_drive", ("coaxial wheels",), (why,))], why, fix)


def blind_fix(wheels: Sequence[Candidate]) -> str:
    """The way out for wheels that cannot be measured."""
    names = ",".join(c.joint.name for c in wheels)
    missing = any(c.shape == PARTIAL for c in wheels)
    first = "--package-dir FOLDER with the package of their meshes, or " if missing else ""
    return f"{first}--wheels {names} --radius METRES, of these those that drive; --base fixed parks them"


def unsupported(rest: AtRest, name: str, why: str, wheels: Sequence[Candidate] = (), fix: str = "") -> Unsupported:
    """The refusal of a machine by its name."""
    drives = ", ".join(kind.words for kind in KINDS.values())
    line: int | None = wheels[0].joint.line if wheels else rest.document.root.sourceline
    error = Unsupported(
        f"this is a {name}",
        why=why,
        fix=fix or f"this package drives {drives}; --base fixed takes it as an arm",
        file=rest.document.path,
        line=line,
    )
    error.machine = name
    return error

"""The report of how a robot was understood: notes with stable codes beside the audit's, and refusals."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from shlex import quote
from typing import Any

import numpy as np

from ...errors import RobotError, few, printable
from ...signals import Array
from ..arm import WHY, Arm
from ..signs import MARGIN, Sign, score, told_apart
from ..urdf.document import Joint
from ..urdf.finding import AuditError, Finding
from ..urdf.shapes import HORIZONTAL, VERTICAL, AtRest
from . import KINDS
from .base import Base, Wheel
from .heading import TURNS, axis_name, heading, left_first
from .overrides import Overrides
from .skid_steer import GRAVITY
from .steered import SteeredBase
from .wheels import (
    HUB,
    LUMPY,
    PARTIAL,
    TILTED,
    TOUCHING,
    Candidate,
    Candidates,
    coaxial,
    height_at,
    parallel,
    welded_cylinders,
)

LARGE, WIDE = 2.0, 3.0  # [m], fraction of the track; no wheel of a robot has a larger radius
SPEAKS = {"for": 1, "against": -1}
PARKED = "--base fixed parks it"
FORCES = f"--base holonomic drives it by forces on its frame; {PARKED}"
STILL = f"--base holonomic drives it by forces on its frame, its wheels standing still; {PARKED}"
NO_FRICTION = "no joint has damping or friction"
TELLS = 3.5  # least margin of forward that tells where left and right speak against it: at 3 one of public robots errs
HUGE = 20.0  # [m], no robot has a larger track
SAME_RADIUS = 0.01  # radii that differ by more than this fraction are told
OFF_FLOOR = 0.02  # wheels further than this fraction of their radius from the footprint are told

# Codes by severity; docs/reference/urdf-audit.md tells each with its reason.
SEVERITIES = {
    "error": "base-undecided base-unsupported base-heading arm-doubt robot base-size base-hub-height",
    "warning": "base-doubt base-roller base-pushed base-sides base-radius base-shapes "
    "base-stated base-stray base-pair base-limit base-linkage base-scrub base-floor base-friction base-welded "
    "arm-passive arm-srdf arm-weak welded pinocchio",
    "note": "base-evidence base-omni base-none base-joints base-driven base-skid base-steered arm-locked no-friction "
    "no-rotor overrides",
}
CODES = {code: severity for severity, codes in SEVERITIES.items() for code in codes.split()}


@dataclass(frozen=True, eq=False)
class BaseResult:
    """A base, and what was noticed on the way."""

    base: Base  # the base
    findings: tuple[Finding, ...] = ()  # warnings and notes
    # what the robot's own controllers correct of its geometry, keys of `Overrides`
    taken: dict[str, Any] = field(default_factory=dict)


# -- notes -------------------------------------------------------------------------------------------------------------


def note(rest: AtRest, code: str, joint: str, what: str, why: str = "", fix: str = "", about: str = "base") -> Finding:
    """A finding of a code in `CODES` about what was understood, at the line of a joint, or 1 without one."""
    line = rest.document.joints[joint].line if joint else 1
    return Finding(CODES[code], code, str(rest.document.path), line, about, what, why, fix)


def settle(audited: Sequence[Finding], findings: Sequence[Finding]) -> tuple[Finding, ...]:
    """The audit's findings and those of the understanding.

    Raises:
        AuditError: One of them is an error.
    """
    if any(f.severity == "error" for f in findings):
        raise AuditError([*audited, *findings])
    return (*audited, *findings)


def base_notes(rest: AtRest, base: Base, wheels: Sequence[Candidate], lowest: float, given: bool) -> list[Finding]:
    """Warnings about radii, maybe given, a floor that is not at the lowest height [m], friction, welded wheels."""
    if not base.wheels:
        return []
    return [
        *hidden_radii_note(rest, base, wheels),
        *size_notes(rest, base, given),
        *floor_notes(rest, base, lowest),
        *friction_note(rest, base),
        *welded_note(rest, welded_cylinders(rest, lowest)),
    ]


def hidden_radii_note(rest: AtRest, base: Base, wheels: Sequence[Candidate]) -> Iterator[Finding]:
    """The question whether the hubs of wheels that cannot be seen are as high above the floor as their frame says."""
    driving = {w.joint for w in base.wheels}
    if blind := [c for c in wheels if c.shape == HUB and c.joint.name in driving]:
        sizes = ", ".join(f"'{c.joint.name}' {c.radius:.4g} m" for c in blind)
        text = f"are these the radii, the heights of the hubs above the floor: {sizes}?"
        why = "no shape of them can be read, and such heights were off by 10 and 36 % on two public robots"
        alike = all(abs(c.radius - blind[0].radius) <= SAME_RADIUS * c.radius for c in blind)
        each = " ".join(f"--wheel-radii {quote(c.joint.name)}={c.radius:.4g}" for c in blind)
        so = f"--radius {blind[0].radius:.4g}" if alike else each
        fix = f"{so} if so, else --radius METRES, or --package-dir where their meshes are"
        yield note(rest, "base-hub-height", blind[0].joint.name, text, why, fix)


def heading_notes(rest: AtRest, base: Base, wheels: Sequence[Candidate], overrides: Overrides) -> Iterator[Finding]:
    """Warnings where forward is in doubt, or names and controllers have left and right the other way round."""
    pivots = base.pivots if isinstance(base, SteeredBase) else ()
    any_way = bool(pivots) and base.sideways
    names = [w.joint for w in base.wheels if w.pivot < 0 or any_way]
    drives = [c for c in wheels if c.joint.name in names]
    if not drives or overrides.forward is not None:
        return
    at = [(p.role == "passive", rest.hub(rest.document.joints[p.joint])[:2]) for p in pivots]
    steered, towed = ([place for passive, place in at if passive == role] for role in (False, True))
    found = heading(rest, drives, overrides, steered, towed, any_way)
    way, other = map(axis_name, found.ways[:2])
    pro, contra = told_apart(found.signs[0], found.signs[1]), told_apart(found.signs[1], found.signs[0])
    why = f"for {way}: {', '.join(pro) or 'nothing'}; for {other}: {', '.join(contra) or 'nothing'}"
    fix, root = f"--forward {way}, or --forward {other}", f"of the root link '{rest.document.root_link}'"
    sides = any("left and right" in text for text in contra)  # by somebody who did not mean x, or mixed them up
    settled = not base.sideways and {*contra} <= {TURNS}  # rates alone, of wheels that move it no other way
    settled = settled and any(text == TURNS or "left and right" in text for text in pro)
    if found.said and found.margin < -MARGIN:
        text = f"'{names[0]}' is the left wheel as you said, so forward is {way} {root}"
        yield note(rest, "base-sides", names[0], text, why, fix)
    elif not found.said and found.margin < (TELLS if sides else MARGIN) and not settled:
        text = f"does the robot drive along {way} {root}, or along {other}?"
        yield note(rest, "base-heading", names[0], text, why, fix)
    elif not found.said and (sides or (settled and found.margin < MARGIN)):
        text = f"'{names[0]}' is on the left: does the robot drive along {other} {root}?"
        yield note(rest, "base-sides", names[0], text, why, fix)


def size_notes(rest: AtRest, base: Base, given: bool) -> Iterator[Finding]:
    """Notes on a track or radius that no robot has, and on radii that differ."""
    first = base.wheels[0].joint
    large = [w for w in base.wheels if w.radius > LARGE or 0 < WIDE * base.track < w.radius]
    if base.track > HUGE:
        text, why = f"the wheels are {base.track:.4g} m apart", "is the whole file in millimetres or centimetres?"
        yield note(rest, "base-size", first, text, why, "write it in metres")
    elif large and not given:
        text = f"wheel '{large[0].joint}' has a radius of {large[0].radius:.4g} m on a track of {base.track:.4g} m"
        why, fix = "is its mesh in millimetres or inches?", "give the mesh its scale, or --radius"
        yield note(rest, "base-size", large[0].joint, text, why, fix)
    pivots, sizes_of = base.pivots if isinstance(base, SteeredBase) else (), dict[tuple[bool, bool], list[Wheel]]()
    for w in base.wheels:  # of a base that steers those that drive, the others and those of trailers have a size each
        towed = bool(pivots) and w.pivot >= 0 and pivots[w.pivot].role == "passive"
        sizes_of.setdefault((w.driven or not pivots, towed), []).append(w)
    for wheels in sizes_of.values():
        radii = [w.radius for w in wheels]
        if max(radii) - min(radii) > SAME_RADIUS * max(radii):
            sizes = ", ".join(f"'{w.joint}' {w.radius:.4g} m" for w in wheels)
            why, fix = "they are used as they are", "--radius METRES if they should be alike"
            yield note(rest, "base-radius", wheels[0].joint, f"the wheels' radii differ: {sizes}", why, fix)


def floor_notes(rest: AtRest, base: Base, lowest: float) -> Iterator[Finding]:
    """Warnings where the wheels touch no floor at the height of a footprint, or the robot reaches far below theirs."""
    first, largest = base.wheels[0].joint, max(wheel.radius for wheel in base.wheels)
    if rest.is_footprint and abs(base.floor) > OFF_FLOOR * largest:
        where, root = "below" if base.floor < 0 else "above", rest.document.root_link
        text = f"the wheels touch the ground {abs(base.floor):.3g} m {where} the root link '{root}'"
        yield note(rest, "base-floor", first, text, "the floor is taken where the wheels are")
    if base.floor - lowest > TOUCHING * largest:
        text = f"the robot reaches {base.floor - lowest:.3g} m below the floor that its wheels touch"
        why, fix = "does it stand on its head, or do other wheels carry it?", "turn it over, or name other wheels"
        yield note(rest, "base-floor", first, text, why, fix)


def friction_note(rest: AtRest, base: Base) -> Iterator[Finding]:
    """A warning where the friction of the wheels' joints, at 1 m/s, takes more than any floor gives the wheels."""
    joints, first = rest.document.joints, rest.document.joints[base.wheels[0].joint]
    force = sum((joints[w.joint].damping / w.radius + joints[w.joint].friction) / w.radius for w in base.wheels)
    weight = GRAVITY * math.fsum(rest.mass(name) for name in rest.document.links)
    if force > weight:
        text = f"rolling at 1 m/s takes {force:.3g} N against the friction of the wheels' joints, "
        text += f"{force / weight:.2g} times the weight"
        why = "no floor gives wheels that grip: a simulator's number? PD hardly moves such a base"
        fix = f'state the measured friction instead of damping="{first.damping:g}" friction="{first.friction:g}"'
        yield note(rest, "base-friction", first.name, text, why, fix)


def welded_note(rest: AtRest, welded: Sequence[Joint]) -> Iterator[Finding]:
    """Wheels beside the drive wheels that are welded on."""
    if welded:
        text = f"wheels on the floor are welded on: {', '.join(joint.name for joint in welded)}"
        why, fix = "taken as sliding without friction", "make their joints continuous if they turn"
        yield note(rest, "base-welded", welded[0].name, text, why, fix)


def arm_notes(rest: AtRest, arm: Arm) -> list[Finding]:
    """Notes on joints that were locked without being asked to, one per reason, and on what may be otherwise."""
    notes, by_reason = list[Finding](), dict[str, list[str]]()
    for name, reason in arm.reasons.items():
        by_reason.setdefault(reason, []).append(name)
    for reason, names in by_reason.items():
        if reason == WHY["rigid"]:
            fix = " ".join(f"--free {quote(name)}" for name in names) + " if so, "
            fix += " ".join(f"--lock {quote(name)}" for name in names) + " if not"
            text = f"{few(names)} {'have' if len(names) > 1 else 'has'} limits of one value: do they move all the same?"
            notes.append(
                note(rest, "arm-doubt", names[0], text, "a joint that cannot move is mostly fixed", fix, "arm")
            )
        elif "taken as a" in reason:
            fix = "--free JOINT lets one move, --free all every one"
            notes.append(note(rest, "arm-locked", names[0], f"locked: {few(names)}", reason, fix, "arm"))
        if reason == WHY["passive"]:
            text = f"locked, since they have no motor: {few(names)}"
            fix = f"--free {names[0]} if it has one, or state it: a <command_interface> or a <transmission>"
            notes.append(note(rest, "arm-passive", names[0], text, reason, fix, "arm"))
    for kinds in dict.fromkeys((doubt.role, doubt.other) for doubt in arm.doubts):
        alike = [doubt for doubt in arm.doubts if (doubt.role, doubt.other) == kinds]
        taken, other = ("part of the arm" if kind == "arm" else f"a {kind}" for kind in kinds)
        are = "are each" if len(alike) > 1 else "is"
        names = [f"'{doubt.joints[0]}'" for doubt in alike]
        text = f"{few(names)} {are} {taken} or {other}"
        ways = (" ".join(doubt.option(role) for doubt in alike) for role in kinds[::-1])
        fix = f"{next(ways)} for {other}, {next(ways)} for {taken}"
        notes.append(note(rest, "arm-doubt", alike[0].joints[0], text, "; ".join(alike[0].told), fix, "arm"))
    if arm.broken:
        text, why = f"{few(list(map(str, arm.broken)))} cannot be read", "its groups tell nothing of the arm"
        notes.append(note(rest, "arm-srdf", "", text, why, "correct it, or remove it", "arm"))
    return notes


def weak_notes(rest: AtRest, names: Sequence[str], held: Array, limits: Array) -> list[Finding]:
    """Joints of the arm whose motors cannot hold them where the robot rests: `held` (n,) against `limits` (n,)."""
    notes = []
    for name, needed, limit in zip(names, np.abs(held), limits, strict=True):
        if needed > limit:
            unit = "N" if rest.document.joints[name].type == "prismatic" else "N m"
            what = f"effort of '{name}' is {limit:.3g} {unit}, and gravity takes {needed:.3g} {unit} where it rests"
            fix = f"correct effort in its <limit>, or --lock {name}"
            notes.append(note(rest, "arm-weak", name, what, "no controller holds it up", fix, about=name))
    return notes


def friction_notes(rest: AtRest, damping: Array, coulomb: Array) -> list[Finding]:
    """A note that no joint has friction, of damping and dry friction (nv,) each."""
    if np.any(damping) or np.any(coulomb):
        return []
    why = "runs have none, and a real gear takes a good part of a small motor's torque"
    fix = "state it in <dynamics>, find it with mmnn identify, or try some: --set friction.arm=0.1"
    return [note(rest, "no-friction", "", NO_FRICTION, why, fix, about="")]


def rotor_notes(rest: AtRest, lacking: str, way: str) -> list[Finding]:
    """A note of joints that lack a rotor; the way is an option that gives them some, empty where nothing tells it."""
    why = "gains are bandwidths times inertias, and a rotor behind its gear mostly outweighs a light link"
    fix = f"find them with mmnn identify, or {f'try some: {way}' if way else 'state the effort limits of the motors'}"
    return [note(rest, "no-rotor", "", lacking, why, fix, about="")] if lacking else []


def weld_notes(rest: AtRest, kinds: dict[str, str]) -> list[Finding]:
    """Joints that stand the robot in the world, by name, with what they were: welded."""
    why, fix = "the loader places the robot in the world itself", "none needed, unless it should move in the arm"
    text = "a {} joint that moves the root is taken as fixed"
    return [note(rest, "welded", name, text.format(kind), why, fix, f"joint '{name}'") for name, kind in kinds.items()]


def printed_notes(rest: AtRest, printed: str) -> list[Finding]:
    """A warning with what Pinocchio's parser printed about a file that it accepts."""
    text = f"Pinocchio's parser says: {printable(printed)}"
    return [note(rest, "pinocchio", "", text, about="")] if printed else []


# -- refusals ----------------------------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class BaseReading:
    """One way to understand a base."""

    kind: str  # what it would be, a key of `KINDS`, or another machine
    signs: tuple[Sign, ...]  # what speaks for it and against it

    @property
    def score(self) -> float:
        """The sum of its signs."""
        return score(self.signs)

    def told(self, side: int) -> list[str]:
        """Its signs in words that speak for it (1), or against it (-1), the strongest first."""
        ordered = sorted(self.signs, key=lambda sign: -abs(sign.weight))
        return [sign.text for sign in ordered if sign.weight * side > 0]

    def __str__(self) -> str:
        sides = [f"{word}: {', '.join(texts)}" for word, side in SPEAKS.items() if (texts := self.told(side))]
        return f"{self.kind} ({'; '.join(sides)})" if sides else self.kind


class Undecided(RobotError):
    """Geometry and evidence do not tell what the base is.

    Attributes:
        candidates: The joints that could be wheels, each with what is known of it.
        readings: What the base could be, each with the reasons for and against it.
    """

    candidates: tuple[str, ...] = ()
    readings: tuple[BaseReading, ...] = ()


class Unsupported(RobotError):
    """The machine is understood, and it is none that this package can drive.

    Attributes:
        machine: What it is: `car-like base`, `tracked machine`, `legged machine`, `humanoid`, `drone`, ...
    """

    machine: str = ""


def undecided(
    rest: AtRest,
    wheels: Sequence[Candidate],
    why: str,
    fix: str,
    could: Sequence[BaseReading | str] = (),
    line: int = 0,
) -> Undecided:
    """The error that lists what could be a wheel, and what the base could be: readings, or kinds that `why` tells."""
    texts, found = tuple(c.text for c in wheels), [BaseReading(r, ()) if isinstance(r, str) else r for r in could]
    listed = f"{len(wheels)} wheel(s) found: {'; '.join(texts)}" if wheels else "no wheel that turns is found"
    what = f"the base is undecided: {listed}{'; it could be ' if found else ''}{' or '.join(map(str, found))}"
    at = line or (wheels[0].joint.line if wheels else None)
    error = Undecided(what, why=why, fix=fix, file=rest.document.path, line=at)
    error.candidates, error.readings = texts, tuple(found)
    return error


def not_on_floor(rest: AtRest, candidates: Candidates, package_dirs: Sequence[str] = ()) -> Undecided:
    """The error for what would be drive wheels but for one thing; `package_dirs` were given for meshes."""
    near, gap = candidates.near_misses, min(c.bottom for c in candidates.near_misses) - candidates.floor
    why, parks = f"they end {gap:.3g} m above the robot's lowest point", "--base fixed parks them"
    fix = FORCES
    if any(abs(c.axis[2]) > VERTICAL for c in near):
        why, fix = "their axle is vertical", f"turn the robot so that z points up (a file with y up?); {parks}"
    elif any(abs(c.axis[2]) > HORIZONTAL for c in near):
        why = "wheels roll about a horizontal axis here, not with camber: that is not covered"
    elif any(c.shape == LUMPY for c in near):
        why, fix = lumpy(rest, near)
    elif any(math.isnan(c.radius) for c in near) and any(c.shape == PARTIAL for c in near):
        why = "meshes are missing, none is measured from what is left, and nothing tells where the floor is"
        empty = f" (not in {' or '.join(package_dirs)})" if package_dirs else ""
        fix = f"give --radius METRES, or --package-dir FOLDER where their meshes are{empty}; {parks}"
    elif any(math.isnan(c.radius) for c in near):
        why = "no shape of them can be read, and nothing tells where the floor is"
        fix = f"give --radius METRES, or make their shapes cylinders; {parks}"
    elif min(c.centre[2] for c in near) > height_at(rest, 0.5) and gap > min(c.radius for c in near):
        why, fix = f"{why}, in its upper half", f"turn it over if it stands on its head; {parks}"
    elif len(near) > 1:
        names = ",".join(c.joint.name for c in left_first(rest, near))
        larger = "with --radius METRES if they are larger"
        fix = f"--wheels {names} if the floor is where these touch it, {larger}; {fix}"
    kind = "differential_drive" if len(near) < 3 else "skid_steer"
    kind = kind if all(parallel(near[0], c) for c in near) else "holonomic"
    kind = "swerve" if all(c.mount in ("steering", "swivel") for c in near) else kind
    return undecided(rest, near, why, fix, [kind])


def lumpy(rest: AtRest, wheels: Sequence[Candidate]) -> tuple[str, str]:
    """The reason why bodies are not round about their axles, and the way out: many a cylinder lies across the axis."""
    paired = any(coaxial(a, b) for i, a in enumerate(wheels) for b in wheels[:i])
    across = {c.joint.name: axis for c in wheels if (axis := lying_across(rest, c.joint))}
    if not across:
        return "what turns on them is not round about the axle", blind_fix(rest, wheels)
    c = next(c for c in wheels if c.joint.name in across)
    axis, joint_axis = across[c.joint.name], in_words(c.joint.axis)
    why = f"the cylinder on '{c.joint.name}' lies along {axis} in its link, and its joint turns about {joint_axis}"
    fix = "turn the cylinders or the <axis> of the joints, so that they agree"
    joints = rest.document.joints
    if bare := [f"'{name}'" for name, other in across.items() if other == axis and not joints[name].has_axis]:
        fix = f'an <axis> that is left out is x: write <axis xyz="{axis}"/> in {", ".join(bare)}, or turn the cylinders'
    return why, f"{fix}; {blind_fix(rest, wheels) if paired else '--base fixed parks them'}"


def lying_across(rest: AtRest, joint: Joint) -> str:
    """The direction of a cylinder on a joint that lies across its axis, in the link's frame; empty without one."""
    shapes = [s for link in rest.document.body(joint.child) for s in rest.primitives[link] if s.kind == "cylinder"]
    along = [rest.placements[joint.child][:3, :3].T @ s.pose[:3, 2] for s in shapes]
    return next((in_words(axis) for axis in along if abs(axis @ joint.axis) < TILTED), "")


def in_words(axis: Array) -> str:
    """Numbers of an axis as `<axis>` has them, without its sign."""
    positive = axis * (1.0 if axis[np.argmax(np.abs(axis))] > 0 else -1.0)
    return " ".join(f"{round(float(v), 3) + 0.0:g}" for v in positive)


def blind_fix(rest: AtRest, wheels: Sequence[Candidate]) -> str:
    """The way out for wheels that cannot be measured; no ball drives beside two that are none."""
    rolling = [c for c in wheels if c.shape != "sphere"]
    wheels = rolling if len(rolling) > 1 else wheels
    names = ",".join(c.joint.name for c in left_first(rest, wheels))
    missing = any(c.shape == PARTIAL for c in wheels)
    first = "--package-dir FOLDER with the package of their meshes, or " if missing else ""
    found = [left_first(rest, (a, b)) for i, a in enumerate(wheels) for b in wheels[:i] if coaxial(a, b)]
    pairs = [",".join(c.joint.name for c in pair) for pair in found]
    drive = "".join(f", or --wheels {pair} --radius METRES where these drive" for pair in pairs if len(pairs) > 1)
    which = "" if drive else ", of these those that drive"
    return f"{first}--wheels {names} --radius METRES{which}{drive}; --base fixed parks them"


def unmeasured(rest: AtRest, wheels: Sequence[Candidate], could: Sequence[BaseReading] = ()) -> Undecided:
    """The error where wheels of some cannot be measured; arguments as of `undecided`."""
    why = "what turns on some of them cannot be measured, or does not reach the floor"
    return undecided(rest, wheels, why, blind_fix(rest, wheels), could)


def unsupported(rest: AtRest, name: str, why: str, wheels: Sequence[Candidate] = (), fix: str = "") -> Unsupported:
    """The refusal of a machine by what is seen of it, and what that may be."""
    drives = ", ".join(kind.words for kind in KINDS.values())
    what = f"this cannot be driven here, a {name} perhaps"
    fix = fix or f"this package drives {drives}; --base fixed takes it as an arm"
    line: int | None = wheels[0].joint.line if wheels else rest.document.root.sourceline
    error = Unsupported(what, why=why, fix=fix, file=rest.document.path, line=line)
    error.machine = name
    return error

"""What carries the arm: a differential drive, a holonomic base, nothing that moves; or a question to the user.

Geometry at rest decides first (`wheels`), what else the file says next (`evidence`); a machine that is none of these
is refused by its name. What the user says (`overrides`) is taken as it is.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from mmnn_pin.errors import ConfigError, UnknownName
from mmnn_pin.model.base import Base, Kind, Reading, Undecided, Unsupported, Wheel
from mmnn_pin.model.evidence import Evidence, evidence, roller_angle, verdict
from mmnn_pin.model.machines import machine
from mmnn_pin.model.overrides import Overrides
from mmnn_pin.model.shapes import AtRest
from mmnn_pin.model.urdf import Finding
from mmnn_pin.model.wheels import Candidate, bare_swivels, coaxial, parallel, welded_wheels, wheel_candidates, wheel_of
from mmnn_pin.signals import Array

MECANUM = math.pi / 4  # roller angle that is assumed where nothing states one
SAME_RADIUS = 0.01  # radii that differ by more than this fraction are told
GO_ON = "name the drive wheels with --wheels LEFT,RIGHT, or say what it is with --base"


@dataclass(frozen=True, eq=False)
class Understood:
    """A base, and what was noticed on the way.

    Attributes:
        base: The base.
        findings: Warnings and notes.
    """

    base: Base
    findings: tuple[Finding, ...] = ()


def find_base(rest: AtRest, said: Overrides | None = None) -> Understood:
    """Find the mobile base.

    Args:
        rest: The robot at rest.
        said: What the user says about it.

    Raises:
        Undecided: It may be one thing or another; the candidates are listed with the reasons for and against.
        Unsupported: It is a machine of another kind, e.g. a skid-steer, car-like or legged one.
        UnknownName: A wheel that the robot does not have.
        ConfigError: Wheels that do not suit the base.
    """
    said = said or Overrides()
    wheels, hanging, floor = wheel_candidates(rest)
    if said.base == "fixed":
        parked = tuple(name for c in wheels for name in (c.joint.name, *c.rollers))
        casters = tuple(c.joint.name for c in wheels if c.mount == "swivel")
        found = Understood(Base("fixed", parked=tuple(n for n in parked if n not in casters), casters=casters))
    elif said.wheels is not None:
        chosen = [given_wheel(rest, name, wheels, floor, said) for name in said.wheels]
        found = with_wheels(rest, chosen, wheels, said)
    elif said.base == "holonomic" and not plain(wheels):
        found = pushed(rest, wheels, floor)
    else:
        found = decide(rest, wheels, hanging, said)
    return replace(found, findings=(*found.findings, *remarks(rest, found.base)))


def decide(rest: AtRest, wheels: list[Candidate], hanging: list[Candidate], said: Overrides) -> Understood:
    """The base as geometry and evidence have it."""
    if not wheels and hanging:
        lowest = min(c.bottom for c in hanging)
        why = f"they end {lowest - wheel_candidates(rest)[2]:.3g} m above the robot's lowest point"
        raise undecided(rest, hanging, [Reading("differential_drive", ("coaxial wheels",), (why,))], why)
    if not wheels:
        return without_wheels(rest)
    drives = plain(wheels)
    balls = [c for c in drives if c.shape == "sphere"]
    if 0 < len(balls) == len(drives) - 2:  # balls beside two proper wheels: casters written as continuous joints
        drives = [c for c in drives if c not in balls]
    refuse_steered(rest, wheels)
    if len(drives) == 2 and coaxial(*drives) and said.base != "holonomic":
        return with_wheels(rest, drives, wheels, said)
    if len(drives) >= 3 and said.base != "differential_drive":
        if not all(parallel(drives[0], c) for c in drives[1:]):
            return crossed(rest, drives, wheels, said)
        if len(drives) >= 4:
            return four_parallel(rest, drives, wheels, said)
    why = "a differential drive has exactly two coaxial drive wheels, other casters swivel or are balls"
    raise undecided(rest, wheels, readings(rest, drives), why)


def plain(wheels: Sequence[Candidate]) -> list[Candidate]:
    """Wheels that hang on nothing that turns."""
    return [c for c in wheels if c.mount == ""]


def refuse_steered(rest: AtRest, wheels: list[Candidate]) -> None:
    """Refuse wheels that steer, and wheels at the ends of legs.

    Raises:
        Unsupported: By name.
    """
    steered, drives = [c for c in wheels if c.mount == "steering"], plain(wheels)
    legged = [c for c in wheels if c.mount == "leg"]
    if len(legged) >= 2:
        raise unsupported(
            rest, "legged machine", f"its wheels hang on legs: {'; '.join(c.text for c in legged)}", legged
        )
    if steered:
        name = "car-like base" if drives else "swerve drive"
        raise unsupported(rest, name, f"wheels are steered: {'; '.join(c.text for c in steered)}", steered)


def without_wheels(rest: AtRest) -> Understood:
    """A fixed arm, unless it walks, flies, is welded together or stands on welded wheels."""
    if told := machine(rest):
        name, why = told
        raise unsupported(rest, name, why)
    moving = [joint for joint in rest.document.joints.values() if joint.moves]
    welded = welded_wheels(rest)
    if welded:
        names = ", ".join(f"'{joint.name}'" for joint in welded)
        rolls = Reading("holonomic", ("wheels under casters on all sides",), (f"{names} are welded on (fixed joints)",))
        still = Reading("fixed", ("no wheel can turn in this file",), ("there are wheels under it",))
        fix = (
            "--base fixed to keep the base parked, --base holonomic to drive it by forces on its frame, "
            "or make the wheels' joints continuous"
        )
        raise undecided(rest, [], [rolls, still], f"{len(welded)} wheels are welded on", fix, welded[0].line, names)
    if not moving:
        raise unsupported(rest, "single rigid body", "it has no joint that moves")
    return Understood(Base("fixed"))


def four_parallel(rest: AtRest, drives: list[Candidate], wheels: list[Candidate], said: Overrides) -> Understood:
    """Four or more wheels that roll in one direction: mecanum wheels or a skid-steer, as the evidence has it."""
    told = evidence(rest, drives)
    meaning = "holonomic" if said.base == "holonomic" else verdict(told)
    if meaning is None:
        why = "four parallel wheels roll the same whether they have rollers (mecanum) or skid"
        if told:
            why += ", and the evidence does not decide"
        fix = "--base holonomic for mecanum wheels, or --wheels LEFT,RIGHT for two drive wheels with the others free"
        raise undecided(rest, wheels, readings(rest, drives), why, fix)
    if meaning == "skid-steer":
        why = "; ".join(dict.fromkeys(piece.text for piece in told if piece.meaning == meaning and piece.decides))
        raise unsupported(rest, "skid-steer base", f"{len(drives)} parallel wheels, and {why}", drives)
    cited = [piece for piece in told if piece.meaning == "holonomic"]
    findings = [evidence_note(rest, cited)] if cited else []
    angles = [piece.roller for piece in cited if not math.isnan(piece.roller)]
    base, assumed = mecanum(rest, drives, wheels, said, angles[0] if angles else MECANUM, not angles)
    return Understood(base, (*findings, *assumed))


def evidence_note(rest: AtRest, cited: list[Evidence]) -> Finding:
    """What made four parallel wheels mecanum wheels."""
    texts = list(dict.fromkeys(piece.text for piece in cited))
    more = f" and {len(texts) - 4} more" if len(texts) > 4 else ""
    return remark(
        rest, "note", "base-evidence", cited[0].line, "base", f"taken as holonomic: {'; '.join(texts[:4])}{more}"
    )


def mecanum(
    rest: AtRest, drives: list[Candidate], wheels: list[Candidate], said: Overrides, angle: float, assumed: bool
) -> tuple[Base, list[Finding]]:
    """Base on mecanum wheels; on the floor their rollers lie across the diagonals, or as they are modelled."""
    base = frame_of(rest, drives, wheels, "holonomic", said)
    size = said.roller if said.roller is not None else angle
    modelled = {c.joint.name: c for c in drives if c.rollers}
    rolled = []
    for wheel in base.wheels:
        roller = -math.copysign(size, wheel.x * wheel.y) if size >= 0 else math.copysign(size, wheel.x * wheel.y)
        if wheel.joint in modelled and said.roller is None:
            roller = roller_angle(rest, modelled[wheel.joint])
        rolled.append(replace(wheel, roller=roller))
    base = checked(rest, replace(base, wheels=tuple(rolled)), drives)
    if not assumed or said.roller is not None:
        return base, []
    text = (
        f"rollers at {math.degrees(MECANUM):.0f} degrees assumed, on the floor across the diagonals (from above an X)"
    )
    why, fix = (
        "nothing in the file states their angle",
        "--roller RADIANS, negative for wheels mounted the other way round",
    )
    return base, [remark(rest, "warning", "base-roller", drives[0].joint.line, "base", text, why, fix)]


def crossed(rest: AtRest, drives: list[Candidate], wheels: list[Candidate], said: Overrides) -> Understood:
    """Wheels whose axles are not parallel: to roll together they must slide along them (omni wheels)."""
    base = frame_of(rest, drives, wheels, "holonomic", said)
    roller = said.roller if said.roller is not None else 0.0
    base = checked(rest, replace(base, wheels=tuple(replace(w, roller=roller) for w in base.wheels)), drives)
    if said.roller is not None:
        return Understood(base)
    text = "omni wheels assumed: their rollers turn about the rolling direction (0 degrees)"
    why = "plain wheels whose axles cross could not roll together"
    note = remark(
        rest, "note", "base-roller", drives[0].joint.line, "base", text, why, "--roller RADIANS for another angle"
    )
    return Understood(base, (note,))


def checked(rest: AtRest, base: Base, drives: list[Candidate]) -> Base:
    """The base, if its wheels can move it in all three directions.

    Raises:
        Undecided: They cannot.
    """
    if np.linalg.matrix_rank(np.array([wheel.grip for wheel in base.wheels]), tol=1e-6) < 3:
        against = Reading("holonomic", (), ("its wheels cannot drive it in all three directions",))
        raise undecided(rest, drives, [against], "wheels with rollers at these places leave a direction undriven")
    return base


def pushed(rest: AtRest, wheels: list[Candidate], floor: float) -> Understood:
    """A holonomic base whose wheels are not modelled: forces on its frame drive it."""
    names = tuple(j.name for c in wheels for j in rest.document.moving_ancestors(c.joint.child))
    text = "the base has no drive wheels: forces and a torque on the root link drive it, without limits"
    note = remark(rest, "warning", "base-pushed", 1, "base", text, "you said --base holonomic")
    return Understood(Base("holonomic", floor=floor, casters=in_order(rest, names)), (note,))


# --- From wheels to a base --------------------------------------------------------------------------------------------


def given_wheel(rest: AtRest, name: str, known: list[Candidate], floor: float, said: Overrides) -> Candidate:
    """A wheel that the user named.

    Raises:
        UnknownName: No such joint.
        ConfigError: It cannot turn without end, or not about a horizontal axis, or its radius is not known.
    """
    joint = rest.document.joints.get(name)
    if joint is None:
        turning = [j.name for j in rest.document.joints.values() if j.turns_freely]
        raise UnknownName("wheel joint", name, turning or rest.document.joints, key="wheels")
    if not joint.turns_freely or not rest.is_horizontal(joint):
        why = f"it is {joint.type}" if not joint.turns_freely else "its axis is not horizontal"
        fix = "make it continuous about a horizontal axis" if not joint.turns_freely else "name another joint"
        raise ConfigError(f"joint '{name}' cannot be a wheel", why=why, fix=fix, key="wheels", file=rest.document.path)
    found = next((c for c in known if c.joint.name == name), None)
    candidate = (
        found or wheel_of(rest, joint) or Candidate(joint, rest.axis(joint), rest.hub(joint), math.nan, "unknown")
    )
    radius = said.radius or candidate.radius
    if math.isnan(radius):
        radius = float(candidate.centre[2] - floor)
    if not radius > 0 or not math.isfinite(radius):
        raise ConfigError(f"the radius of wheel '{name}' is unknown", fix="give --radius", key="radius")
    return replace(candidate, radius=radius)


def with_wheels(rest: AtRest, drives: list[Candidate], wheels: list[Candidate], said: Overrides) -> Understood:
    """The base on chosen wheels.

    Raises:
        ConfigError: Wheels that do not suit the base.
    """
    if said.base == "holonomic" or (said.base is None and len(drives) > 2):
        if len(drives) < 3:
            raise ConfigError(f"{len(drives)} wheel(s) for a holonomic base", fix="name at least three", key="wheels")
        if not all(parallel(drives[0], c) for c in drives[1:]):
            return crossed(rest, drives, wheels, said)
        base, findings = mecanum(rest, drives, wheels, said, MECANUM, True)
        return Understood(base, tuple(findings))
    if len(drives) != 2 or not coaxial(*drives):
        what = "not two wheels on one axle" if len(drives) == 2 else f"{len(drives)} wheel(s) for a differential drive"
        raise ConfigError(what, fix="name the left and the right one", key="wheels", file=rest.document.path)
    base = frame_of(rest, drives, wheels, "differential_drive", said)
    left = base.wheels[0].joint
    if said.wheels and left != said.wheels[0]:
        text = f"'{left}' is the left wheel, not '{said.wheels[0]}'"
        note = remark(
            rest, "warning", "base-sides", drives[0].joint.line, "base", text, "seen along the rolling direction"
        )
        return Understood(base, (note,))
    return Understood(base)


def frame_of(rest: AtRest, drives: list[Candidate], wheels: list[Candidate], kind: Kind, said: Overrides) -> Base:
    """Control frame, wheels, casters and suspensions; forward is the rolling direction nearer the root's x."""
    alike = all(parallel(drives[0], c) for c in drives[1:])
    forward = rolling(drives[0]) if alike else np.array([1.0, 0.0])
    backward = forward[0] < -1e-6 or (abs(forward[0]) <= 1e-6 and forward[1] < 0)  # axle along x: y is as near
    forward = (-forward if backward else forward) + 0.0  # no -0
    left = np.array([-forward[1], forward[0]])
    middle = np.mean([c.centre[:2] for c in drives], axis=0)
    placed = [placed_wheel(c, c.centre[:2] - middle, forward, left, alike, said) for c in drives]
    in_rows = kind == "holonomic"
    placed.sort(key=lambda w: (-round(w.x, 6) * in_rows, -w.y))  # front to rear, left before right
    track = max(w.y for w in placed) - min(w.y for w in placed)
    if said.track is not None and track > 0:
        placed = [replace(w, y=w.y * said.track / track) for w in placed]
        track = said.track
    suspensions = [j.name for c in drives for j in rest.document.moving_ancestors(c.joint.child)[1:]]
    others = [c for c in wheels if c.joint not in [d.joint for d in drives]]
    casters = [j.name for c in others for j in rest.document.moving_ancestors(c.joint.child)]
    floor, radius = max(c.bottom for c in drives), max(c.radius for c in drives)
    casters += [joint.name for joint in bare_swivels(rest, floor, radius)]
    return Base(
        kind=kind,
        wheels=tuple(placed),
        track=track,
        frame=np.array([*middle, math.atan2(forward[1], forward[0])]),
        floor=float(np.mean([c.bottom for c in drives])),
        casters=in_order(rest, set(casters) - set(suspensions)),
        suspensions=in_order(rest, suspensions),
        parked=in_order(rest, [name for c in wheels for name in c.rollers]),
    )


def rolling(candidate: Candidate) -> Array:
    """(2,) direction that positive joint velocity rolls a wheel in."""
    return np.array([candidate.axis[1], -candidate.axis[0]]) / np.hypot(*candidate.axis[:2])


def placed_wheel(c: Candidate, at: Array, forward: Array, left: Array, alike: bool, said: Overrides) -> Wheel:
    """The wheel in the control frame; parallel wheels have a sign, others a heading of their own."""
    direction, radius = rolling(c), said.radius or c.radius
    sign = math.copysign(1.0, direction @ forward) if alike else 1.0
    heading = 0.0 if alike else math.atan2(direction @ left, direction @ forward)
    x = 0.0 if abs(at @ forward) < 1e-12 else float(at @ forward)
    return Wheel(c.joint.name, radius, sign, y=float(at @ left), x=x, heading=heading)


def in_order(rest: AtRest, names: Sequence[str] | set[str]) -> tuple[str, ...]:
    """Joints once each, in the order of the file."""
    return tuple(name for name in rest.document.joints if name in set(names))


# --- What is told -----------------------------------------------------------------------------------------------------


def remark(
    rest: AtRest, severity: str, code: str, line: int, element: str, what: str, why: str = "", fix: str = ""
) -> Finding:
    """A finding about what was understood."""
    return Finding(severity, code, str(rest.document.path), line, element, what, why, fix)


def remarks(rest: AtRest, base: Base) -> list[Finding]:
    """Warnings about radii that differ and a floor that is not the root's."""
    found = []
    radii = [wheel.radius for wheel in base.wheels]
    if radii and max(radii) - min(radii) > SAME_RADIUS * max(radii):
        line = rest.document.joints[base.wheels[0].joint].line
        told = ", ".join(f"'{w.joint}' {w.radius:.4g} m" for w in base.wheels)
        text, why = f"the wheels' radii differ: {told}", "they are used as they are"
        found.append(
            remark(rest, "warning", "base-radius", line, "base", text, why, "--radius if they should be alike")
        )
    if base.wheels and is_footprint(rest) and abs(base.floor) > 0.02 * max(radii):
        where = "below" if base.floor < 0 else "above"
        line = rest.document.joints[base.wheels[0].joint].line
        text = f"the wheels touch the ground {abs(base.floor):.3g} m {where} the root link '{rest.document.root_link}'"
        found.append(
            remark(rest, "warning", "base-floor", line, "base", text, "the floor is taken where the wheels are")
        )
    return found


def is_footprint(rest: AtRest) -> bool:
    """Whether the root link has no mass of its own: a frame, by custom on the floor."""
    return rest.mass(rest.document.root_link) == 0


def readings(rest: AtRest, drives: list[Candidate]) -> list[Reading]:
    """What a base on these wheels could be, with the reasons for and against."""
    told = evidence(rest, drives)
    speaks = {
        kind: tuple(dict.fromkeys(p.text for p in told if p.meaning == kind)) for kind in ("holonomic", "skid-steer")
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
    rolls = Reading("holonomic", ("four or more parallel wheels", *speaks["holonomic"]), speaks["skid-steer"])
    skids = Reading("skid-steer", ("four or more parallel wheels", *speaks["skid-steer"]), speaks["holonomic"])
    return [rolls, skids, two]


def undecided(
    rest: AtRest,
    wheels: list[Candidate],
    told: list[Reading],
    why: str,
    fix: str = GO_ON,
    line: int | None = None,
    names: str = "",
) -> Undecided:
    """The error that lists what could be a wheel, and what the base could be."""
    texts = tuple(c.text for c in wheels)
    listed = f"{len(wheels)} wheel(s) found: {'; '.join(texts)}" if wheels else f"no wheel turns: {names}"
    error = Undecided(
        f"the base is undecided: {listed}; it could be {' or '.join(map(str, told))}",
        why=why,
        fix=fix,
        file=rest.document.path,
        line=line or (wheels[0].joint.line if wheels else None),
    )
    error.candidates, error.readings = texts, tuple(told)
    return error


def unsupported(rest: AtRest, name: str, why: str, wheels: Sequence[Candidate] = ()) -> Unsupported:
    """The refusal of a machine by its name."""
    line: int | None = wheels[0].joint.line if wheels else rest.document.root.sourceline
    error = Unsupported(
        f"this is a {name}",
        why=why,
        fix="this package drives differential and holonomic bases and fixed arms; --base fixed takes it as an arm",
        file=rest.document.path,
        line=line,
    )
    error.machine = name
    return error

"""The roles of a robot's joints, in its base and in its arm; or a question to the user.

Geometry at rest tells what may be wheels (`wheels`) and pivots (`modules`); what they make is the reading that is borne
out by all signs together (`readings`, `evidence`). What the user says (`overrides`) is taken as it is. What has no
wheels is looked at for legs, rotors and belts (`machines`).
"""

from __future__ import annotations

import contextlib
import copy
import math
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import product
from typing import Any

import msgspec

from ...errors import ConfigError, InputError, RobotError
from ..arm import Arm, choose_arm
from ..signs import Sign
from ..urdf.document import Document, Joint, text_of
from ..urdf.finding import Finding
from ..urdf.shapes import HORIZONTAL, AtRest
from .base import Base, Fixed
from .evidence import OUTDOORS, RADII, evidence, motors_named, plugins, require_controllers, stated
from .heading import left_first
from .machines import (
    PROPELLERS,
    SWERVE,
    belt_signs,
    machine,
    propellers,
    steering_named,
    track_named,
    welded_tracks,
)
from .modules import STEERED, Undercarriage, says_steered, undercarriages
from .opinions import calibration, second_opinions
from .overrides import Overrides, folders_of
from .placing import (
    declared_wheel,
    in_order,
    on_arms,
    on_wheels,
    pushed,
    require_possible,
    require_used,
)
from .readings import NO_BASE, ROLLING, Drives, Proposal, Question
from .report import (
    FORCES,
    STILL,
    BaseResult,
    Undecided,
    arm_notes,
    base_notes,
    blind_fix,
    heading_notes,
    lumpy,
    not_on_floor,
    note,
    undecided,
    unmeasured,
    unsupported,
    weld_notes,
)
from .steered import CarLike, DriveWithTrailer, Tricycle
from .steering import behind_drive, steered_base, steered_kind
from .wheels import (
    COAXIAL,
    LUMPY,
    ROUND_ABOUT,
    TILTED,
    TOUCHING,
    Candidate,
    Candidates,
    alike_on_root,
    blind_beside,
    called_wheels,
    is_endless_end,
    is_low,
    moving_above,
    pivots_above,
    welded_wheels,
    wheel_candidates,
    wheel_of,
    written_to_turn,
)

CARS = (CarLike.kind, Tricycle.kind)
UPRIGHT = (
    "like bodies turn without end about vertical axes: do they steer, or swivel, is their <axis> wrong, or is y up"
)
Z_UP = "turn the robot so that z points up; --base holonomic drives it by forces on its frame; --base fixed parks them"
WAYS = re.compile(r"(; |,? or (?=--|name )|, (?=--|name ))")  # what stands between the ways out of a fix
OPTION = re.compile(r"--(base|wheels|steer|hitch|forward) (?!if |and |name |JOINTS)([^\s;,]+(?:,[^\s;,]+)*)")
LISTED = ("wheels", "steer", "hitch")
RADII_TRIED = (0.05, 0.15, 0.4)  # [m] in the place of a radius that a way out asks for
NO_WAY = "mend the file: no option leads on"
PLANE = [(False, True), (True, True)]  # a turn and a slide, both upright: beside two level slides
FAR = 50.0  # [m] travel of a slide that no gantry has
NOTHING = 0.05  # of the mass of a robot: what simulators ask for of an empty link


@dataclass(frozen=True, eq=False)
class Roles:
    """The roles of a robot's joints."""

    document: Document  # the URDF, joints that stand the robot in the world made fixed
    rest: AtRest  # the robot at rest
    base: Base  # what carries the arm
    arm: Arm  # the manipulator, and what stands still
    findings: tuple[Finding, ...]  # what there is to say of the base
    notes: tuple[Finding, ...]  # what there is to say of the arm and of the joints that were made fixed
    taken: dict[str, Any]  # what the robot's own controllers correct of the base's geometry, keys of `Overrides`


def understand(document: Document, overrides: Overrides) -> Roles:
    """The roles of a robot's joints, by its geometry, by what else its file says, and by what the user says.

    Raises:
        Undecided: Its base may be one thing or another; the candidates are listed with the reasons for and against.
        Unsupported: It is a machine of another kind, e.g. a car-like, tracked or legged one, or nothing of it moves.
        UnknownName: A joint or link that the robot does not have.
        ConfigError: Something said that does not suit the robot.
    """
    require_controllers(overrides.controllers_file)
    document, welds = welded(document)
    rest = AtRest(document, folders_of(document.path, overrides))
    try:
        return roles_in(rest, welds, overrides)
    except RobotError as error:
        raise error.but(fix=leading_on(rest, welds, overrides, error.fix)) from None


def roles_in(rest: AtRest, welds: dict[str, str], overrides: Overrides) -> Roles:
    """The roles of a robot at rest, without the joints that stood it in the world, their types by names; see above."""
    found = find_base(rest, overrides)
    require_rolling(rest, found.base, welds, overrides)
    arm = choose_arm(rest, found.base, overrides)
    if not found.base.columns and not arm.joints:
        fix = "--free JOINT moves one that is locked"
        raise unsupported(rest, "single rigid body", "no joint of it moves", (), fix)
    notes = (*arm_notes(rest, arm), *weld_notes(rest, welds))
    return Roles(rest.document, rest, found.base, arm, found.findings, notes, found.taken)


def leading_on(rest: AtRest, welds: dict[str, str], overrides: Overrides, fix: str) -> str:
    """A fix without those of its ways out that lead to another refusal: each that names options of a base is tried."""
    first, *more = WAYS.split(fix)
    ways = [("", first), *zip(more[::2], more[1::2], strict=True)]
    kept = [(before, way) for before, way in ways if leads_on(rest, welds, overrides, way)]
    return "".join(f"{before if k else ''}{way}" for k, (before, way) in enumerate(kept)) or NO_WAY


def leads_on(rest: AtRest, welds: dict[str, str], overrides: Overrides, way: str) -> bool:
    """Whether a way out leads to a robot, or names no option of a base; a length that it asks for may be any."""
    said = {key: tuple(text.split(",")) if key in LISTED else text for key, text in OPTION.findall(way)}
    if not said or "FOLDER" in way:
        return True
    radii = RADII_TRIED if "--radius METRES" in way else (overrides.radius,)
    bare = msgspec.structs.replace(overrides, base=None, wheels=None, steer=None, hitch=None)
    for known, radius in product((overrides, bare), radii):  # beside what the user says of it, or in its place
        with contextlib.suppress(InputError):
            roles_in(rest, welds, msgspec.structs.replace(known, **said, radius=radius))
            return True
    return False


def find_base(rest: AtRest, overrides: Overrides | None = None) -> BaseResult:
    """The mobile base of a robot at rest; errors as of `understand`."""
    overrides = overrides or Overrides()
    result = understood(rest, overrides)
    taken, findings = calibration(rest, result.base, overrides)
    if taken:
        result = understood(rest, msgspec.structs.replace(overrides, **taken))
    return replace(result, findings=(*result.findings, *findings), taken=taken)


def understood(rest: AtRest, overrides: Overrides) -> BaseResult:
    """The base by its geometry, by what the file says, and by what the user says; errors of `understand`."""
    radii = {length.nominal for length in stated(rest, overrides.controllers_file, RADII)}
    radius = overrides.radius or (min(radii) if len(radii) == 1 else None)
    candidates = wheel_candidates(rest, radius, overrides.radius is not None)
    named = [declared_wheel(rest, name, candidates, overrides) for name in overrides.wheels or ()]
    if overrides.base != "fixed":
        require_possible(overrides, candidates, named)
    result = with_strays(rest, chosen(rest, candidates, named, overrides), overrides)
    require_drive(rest, result.base, overrides)
    require_used(overrides, result.base)
    drives = named if overrides.wheels is not None and overrides.base != "fixed" else candidates.wheels
    seen = {c.joint.name: c for c in (*candidates.wheels, *candidates.limited, *named)}
    untold = [c for c in drives if c.joint.name not in overrides.radius_of]
    notes = [
        *base_notes(rest, result.base, untold, candidates.floor, overrides.radius is not None),
        *heading_notes(rest, result.base, list(seen.values()), overrides),
        *second_opinions(rest, result.base, drives, overrides),
    ]
    return replace(result, findings=(*result.findings, *notes))


def chosen(rest: AtRest, candidates: Candidates, named: list[Candidate], overrides: Overrides) -> BaseResult:
    """The base as the user says, else as the best reading has it."""
    if overrides.base == "fixed":
        return BaseResult(parked(rest, [*candidates.wheels, *candidates.near_misses, *candidates.limited]))
    if overrides.wheels is not None and not says_steered(overrides):
        wheels = [*candidates.wheels, *candidates.limited]
        found = drive_readings(rest, named, wheels, overrides)
        if not found:  # with the error that says why
            kind = overrides.base or ("holonomic" if len(named) > 2 else "differential_drive")
            return on_wheels(rest, kind, named, wheels, overrides)
        return Question(rest, wheels, sure=True).best_of(found)
    if overrides.base == "holonomic" and not plain(candidates.wheels):
        return pushed(rest, candidates, overrides)
    return decide(rest, candidates, overrides)


def with_strays(rest: AtRest, result: BaseResult, overrides: Overrides) -> BaseResult:
    """The base, and what else low on it turns without end: that is no arm, it stands still.

    Raises:
        Undecided: Nothing says what base they make, or they stand as high as the drive wheels.
    """
    result = replace(result, base=with_balls(rest, result.base, overrides))
    base, strays = result.base, strays_of(rest, result.base, overrides)
    few = len(strays) < ROUND_ABOUT and not side_by_side(rest, strays)
    if not strays or (not base.columns and overrides.base is None and few):
        return result
    level = [j for j in strays if any(abs(rest.hub(j)[2] - hub) < TOUCHING * r for hub, r in hubs_of(rest, base))]
    if overrides.base is None and overrides.wheels is None and (not base.columns or len(level) >= 2):
        raise unclear_strays(rest, strays)
    base = replace(base, casters=in_order(rest, {*base.casters, *(j.name for j in strays)}))
    names = ", ".join(f"'{j.name}'" for j in strays)
    why = "low on the base and endless: hardly joints of an arm"
    fix = f"--wheels JOINTS with them if they drive, --free {strays[0].name} if it is the arm's"
    stray = note(rest, "base-stray", strays[0].name, f"joints that may be wheels stand still: {names}", why, fix)
    return BaseResult(base, (*result.findings, stray))


def with_balls(rest: AtRest, base: Base, overrides: Overrides) -> Base:
    """The base, with balls that touch its floor and turn without end or not at all, about any axis, as casters."""
    joints = rest.document.joints.values()  # a ball whose limits are one value stands as still as it rolls
    ends = [j for j in joints if is_endless_end(rest, j) or (j.type == "revolute" and j.lower == j.upper)]
    free = [j for j in ends if base.columns and j.name not in {*base.locked, *base.joints, *overrides.free}]
    near = {j.name: [s for link in rest.document.body(j.child) for s in rest.primitives[link]] for j in free}
    balls = [
        name
        for name, shapes in near.items()
        if any(s.kind == "sphere" and abs(s.lowest - base.floor) < TOUCHING * s.radius for s in shapes)
    ]
    return replace(base, casters=in_order(rest, {*base.casters, *balls})) if balls else base


def strays_of(rest: AtRest, base: Base, overrides: Overrides) -> list[Joint]:
    """Joints that turn without end low on the base, and have no part in it."""
    used = {*base.locked, *base.joints, *overrides.free}
    alike = [*alike_on_root(rest), *odd_casters(rest, base)]
    return [j for j in rest.document.joints.values() if (is_low(rest, j) or j in alike) and j.name not in used]


def unclear_strays(rest: AtRest, strays: list[Joint]) -> Undecided:
    """The error for joints that turn without end low on the base, and do not tell what it is."""
    near = [j for j in rest.document.joints.values() if is_low(rest, j) or j in strays]
    wheels = [wheel_of(rest, j) for j in near if not rest.is_vertical(j)]
    why, fix = f"{len(strays)} joints turn without end low on the base, and what is on them cannot be measured", ""
    if not wheels:
        wheels, why = [Candidate(j, rest.axis(j), rest.hub(j), math.nan, "unknown") for j in near], UPRIGHT
        fix = Z_UP
    elif any(abs(c.axis[2]) > TILTED for c in wheels):
        why, fix = f"{len(strays)} like bodies turn without end about tilted axes: does it roll on a ball?", FORCES
    elif all(c.shape == LUMPY for c in wheels):
        why, fix = lumpy(rest, wheels)
    return undecided(rest, wheels, why, fix or blind_fix(rest, wheels))


def require_drive(rest: AtRest, base: Base, overrides: Overrides) -> None:
    """Refuse to take a robot as an arm on a stand though a plugin drives its base (`Undecided`)."""
    driving = tuple(dict.fromkeys(piece.text for piece in plugins(rest)))
    if driving and not base.columns and overrides.base is None:
        why = "no joint could be a wheel, and a plugin drives a base"
        why += f": {', '.join(driving)}"
        raise undecided(rest, [], why, FORCES, ["holonomic", "fixed"])


def side_by_side(rest: AtRest, joints: list[Joint]) -> bool:
    """Whether these are two joints, one to the left of the other; their axes may be wrong."""
    if len(joints) != 2:
        return False
    x, y, z = rest.hub(joints[0]) - rest.hub(joints[1])
    return max(abs(x), abs(z)) < COAXIAL * abs(y)


def odd_casters(rest: AtRest, base: Base) -> list[Joint]:
    """Swivels on the root's body, and what turns without end on each alone, no higher than the drive wheels' hubs."""
    highest = min((hub for hub, _ in hubs_of(rest, base)), default=-math.inf)
    joints = list[Joint]()
    for joint in rest.document.moving_children(rest.document.root_link):
        carried = rest.document.moving_children(joint.child)
        ends = len(carried) == 1 and is_endless_end(rest, carried[0]) and rest.hub(carried[0])[2] <= highest
        joints += [joint, *carried] if ends and joint.turns_freely and rest.is_vertical(joint) else []
    return joints


def hubs_of(rest: AtRest, base: Base) -> list[tuple[float, float]]:
    """Height of the hub and radius of every drive wheel [m]."""
    return [(float(rest.hub(rest.document.joints[w.joint])[2]), w.radius) for w in base.wheels]


def decide(rest: AtRest, candidates: Candidates, overrides: Overrides) -> BaseResult:
    """The base as the best reading has it."""
    require_sound_wheels(rest, candidates, overrides)
    if not candidates.wheels:
        return without_wheels(rest, overrides, candidates.floor)
    if len(legged := [c for c in candidates.wheels if c.mount == "leg"]) >= 2:
        why = f"its wheels hang on legs: {'; '.join(c.text for c in legged)}"
        raise unsupported(rest, "legged machine", why, legged)
    found = list(base_readings(rest, candidates, overrides))
    if overrides.base == "holonomic" and not found:
        return pushed(rest, candidates, overrides)
    if not found and overrides.base in ROLLING and len(plain(candidates.wheels)) > 2:  # with the error that says why
        return on_wheels(rest, str(overrides.base), plain(candidates.wheels), candidates.wheels, overrides)
    if not found and overrides.base is not None:
        require_kind(rest, candidates, overrides)
    if not found:
        raise no_base(rest, candidates.wheels, plain(candidates.wheels))
    blind, sure = blind_beside(rest, candidates.wheels), overrides.base is not None or says_steered(overrides)
    return Question(rest, candidates.wheels, blind, sure).best_of(found)


def base_readings(rest: AtRest, candidates: Candidates, overrides: Overrides) -> Iterator[Proposal]:
    """All that these wheels could make, of the kind that the user says."""
    found = list[Proposal]()
    for under in undercarriages(rest, candidates, overrides):
        if under.steers:
            found.append(steered_reading(rest, candidates, under, overrides))
            continue
        trailing = {c.joint.name for m in under.of("hitch") for c in m.wheels}
        own = [c for c in candidates.wheels if c.joint.name not in trailing]
        said = msgspec.structs.replace(overrides, base=None, hitch=None) if trailing else overrides
        for reading in drive_readings(rest, under.fixed, own, said):
            found.append(with_modules(rest, reading, under))
    for reading in found:
        alone = overrides.base in CARS and reading.kind in CARS  # one steered wheel, or a bicycle model of two
        if overrides.base in (None, reading.kind) or alone:
            yield reading


def steered_reading(rest: AtRest, candidates: Candidates, under: Undercarriage, overrides: Overrides) -> Proposal:
    """The reading of modules in their roles."""
    names = [m.joint.name for m in under.of("steered", "waist")]
    said: dict[str, Any] = {"steer": names} if names else {"base": "casters"}
    build = partial(steered_base, rest, candidates, overrides, under)
    return Proposal(steered_kind(under), under.signs, said, build)


def with_modules(rest: AtRest, reading: Proposal, under: Undercarriage) -> Proposal:
    """A reading of wheels that drive, with the modules beside them: casters, trailers."""
    signs, hitches = (*under.signs, *reading.signs), [m.joint.name for m in under.of("hitch")]
    if not hitches:
        return replace(reading, signs=signs)
    build = reading.build
    return Proposal(DriveWithTrailer.kind, signs, {"hitch": hitches}, lambda: behind_drive(rest, build(), under))


def drive_readings(
    rest: AtRest, fixed: list[Candidate], wheels: list[Candidate], overrides: Overrides
) -> list[Proposal]:
    """Readings of wheels that do not steer, of the kind that the user says."""
    words = [Sign(f"{why}: does it steer?", -6.0) for why in (steering_named(rest),) if why and len(fixed) > 2]
    belts, drums, named = tuple(belt_signs(rest, fixed)), on_arms(rest, fixed), overrides.wheels is not None
    drives = Drives(fixed, motors_named(rest), named, overrides.base, belts, words, drums, drawn_plain(rest, fixed))
    found = list[Proposal]()
    for some in drives.sets():
        kinds = [kind for kind in drives.kinds(some) if overrides.base in (None, kind)]
        pieces = evidence(rest, some, overrides.controllers_file) if len(some) > 2 else []
        whole = len(some) == len(fixed)
        for kind in kinds:
            names = [c.joint.name for c in left_first(rest, some)]
            said: dict[str, Any] = {"wheels": names} if kind == "differential_drive" else {"base": kind}
            said |= {} if whole else {"wheels": names}
            build = partial(on_wheels, rest, kind, some, wheels, overrides)
            found.append(Proposal(kind, tuple(drives.signs(kind, some, pieces)), said, build))
    return found


def require_kind(rest: AtRest, candidates: Candidates, overrides: Overrides) -> None:
    """Refuse a kind of base that the user says and no reading of the file is (`ConfigError`)."""
    others = list(base_readings(rest, candidates, msgspec.structs.replace(overrides, base=None)))
    others = sorted((r for r in others if r.score > NO_BASE or len(others) == 1), key=lambda r: -r.score)
    kinds = dict.fromkeys(reading.kind for reading in others)
    if kinds or overrides.base in STEERED:
        why = f"its wheels could make {' or '.join(kinds)}" if kinds else "no wheel of it steers"
        steers = overrides.base in STEERED and {*kinds} & {*STEERED}
        fix = f"leave it out{', or --steer and --hitch name what steers and what is a hitch' if steers else ''}"
        raise ConfigError(f"this is no '{overrides.base}'", why=why, fix=fix, key="base", file=rest.document.path)


def require_sound_wheels(rest: AtRest, candidates: Candidates, overrides: Overrides) -> None:
    """Refuse what turns like wheels and is none: propellers, wheels whose joints have limits, wheels off the floor.

    Raises:
        Unsupported: It has propellers.
        Undecided: It has wheels but for one thing.
    """
    wheels, near = candidates.wheels, candidates.near_misses
    turning = wheels or near
    if turning and (names := propellers(rest, [c.joint for c in turning])):
        raise unsupported(rest, PROPELLERS, f"{names} by their names", ())
    hang = any(moving_above(rest, c.joint) for c in candidates.limited)
    if candidates.limited and (wheels or hang or not machine(rest)):
        raise undecided_limits(rest, candidates)
    if near and not wheels and not (rest.is_vertical(near[0].joint) and machine(rest)):
        raise not_on_floor(rest, candidates, overrides.package_dirs)


def plain(wheels: Sequence[Candidate]) -> list[Candidate]:
    """Wheels that hang on nothing that turns."""
    return [c for c in wheels if c.mount == ""]


def no_base(rest: AtRest, wheels: list[Candidate], drives: list[Candidate]) -> Undecided:
    """The error for wheels that make no base by themselves, with the options that would."""
    if blind := blind_beside(rest, wheels):
        return unmeasured(rest, [*wheels, *blind])
    why = "a differential drive has exactly two coaxial drive wheels, other casters swivel or are balls"
    if len(drives) == 2:
        why = "the two wheels are not on one axle, and no other base has two"
    elif len(drives) == 1:
        why = "a base on one wheel is not covered"
    return undecided(rest, wheels, why, FORCES)


def drawn_plain(rest: AtRest, wheels: Sequence[Candidate]) -> frozenset[str]:
    """Wheels that are drawn as cylinders alone; none where most of the robot is meshes: rollers may be left out."""
    visuals = list(rest.document.root.iterfind("link/visual"))
    if 2 * sum(visual.find("geometry/mesh") is not None for visual in visuals) >= len(visuals):
        return frozenset()
    bodies = {c.joint.name: rest.document.body(c.joint.child) for c in wheels}
    kinds = {name: {s.kind for link in body for s in rest.shapes(link, "visual")} for name, body in bodies.items()}
    return frozenset(name for name, found in kinds.items() if found == {"cylinder"})


def parked(rest: AtRest, wheels: list[Candidate]) -> Base:
    """A base that stands still whatever it has."""
    casters = tuple(c.joint.name for c in wheels if c.mount == "swivel")
    pivots = [pivots_above(rest, c.joint)[:1] for c in wheels]
    names = [name for c in wheels for name in (c.joint.name, *c.rollers)] + [j.name for up in pivots for j in up]
    return Fixed(parked=tuple(dict.fromkeys(name for name in names if name not in casters)), casters=casters)


def without_wheels(rest: AtRest, overrides: Overrides, floor: float) -> BaseResult:
    """A fixed arm, unless it walks, flies, is welded together or stands on welded wheels."""
    if known := machine(rest):
        name, why = known
        raise unsupported(rest, name, why, (), STILL if name == SWERVE else "")
    moving = [joint for joint in rest.document.joints.values() if joint.moves]
    welded = welded_wheels(rest, floor)
    if welded and (why := steering_named(rest)):
        fix = f"{written_to_turn(rest, welded)}; {STILL}"
        raise unsupported(rest, "base that steers", f"{why}, and its wheels are welded on", (), fix)
    if welded:
        names = ", ".join(f"'{joint.name}'" for joint in welded)
        fix = f"{FORCES}; {written_to_turn(rest, welded)}"
        why = f"{len(welded)} wheels are welded on (fixed joints): {names}"
        raise undecided(rest, [], why, fix, ["holonomic", "fixed"], welded[0].line)
    if why := track_named(rest) if not moving else welded_tracks(rest):
        why, more = (f"{why}, are welded on", "; --base fixed takes it as an arm") if moving else (why, "")
        raise unsupported(rest, "tracked machine", why, (), f"--base holonomic drives it by forces on its frame{more}")
    if hit := OUTDOORS.search(f"{rest.document.root.get('name', '')} {rest.document.path.stem}"):
        why = f"it is called '{hit[0]}', and nothing in the file could be a wheel"
        raise undecided(rest, [], why, FORCES, ["skid_steer", "fixed"])
    if not moving:
        fix = "--base holonomic drives it by forces on its frame, if it drives at all"
        raise unsupported(rest, "single rigid body", "it has no joint that moves", (), fix)
    if overrides.base is not None:
        why = "no joint turns without end about a horizontal axis with something round on the floor"
        fix = f"name them with --wheels if they turn in this file, or {FORCES}"
        raise undecided(rest, [], why, fix, [overrides.base])
    if len(called := called_wheels(rest)) > 1:
        why, fix = "joints that turn without end are called wheels, and none is found on the floor", FORCES
        why, fix = lumpy(rest, called) if all(c.shape == LUMPY for c in called) else (why, fix)
        raise undecided(rest, called, why, fix, ["fixed"])
    text = "nothing in this file could be a wheel: taken as an arm on a stand"
    fix = "--base holonomic if it stands on a base whose wheels the file leaves out"
    return BaseResult(Fixed(), (note(rest, "base-none", "", text, fix=fix),))


# -- wheels that leave a doubt -----------------------------------------------------------------------------------------


def undecided_limits(rest: AtRest, candidates: Candidates) -> Undecided:
    """The error for wheels whose joints have limits."""
    names = ", ".join(f"'{c.joint.name}'" for c in candidates.limited)
    why = f"{names}: revolute with limits, and a wheel turns without end"
    all_turn = replace(candidates, wheels=[*candidates.wheels, *candidates.limited])
    found = sorted(base_readings(rest, all_turn, Overrides()), key=lambda reading: -reading.score)
    kind = found[0].kind if found else "differential_drive"
    drives = ",".join(c.joint.name for c in left_first(rest, plain(candidates.wheels)))
    others = f"name the others with --wheels {drives}, " if drives else ""
    fix = f'write type="continuous" in {names} for wheels, {others}or --base fixed to park them'
    return undecided(rest, [*candidates.wheels, *candidates.limited], why, fix, [kind, "fixed"])


# -- joints that stand a robot in the world ----------------------------------------------------------------------------


def welded(document: Document) -> tuple[Document, dict[str, str]]:
    """The robot with its planar and floating joints welded, and those of a virtual x, y and yaw; and what they were."""
    kinds = {joint.name: joint.type for joint in document.joints.values() if joint.type in ("planar", "floating")}
    kinds |= virtual_joints(document)
    if not kinds:
        return document, {}
    root = copy.deepcopy(document.root)
    for element in root.iterchildren("joint"):
        if element.get("name") in kinds:
            element.set("type", "fixed")
    return replace(document, root=root, text=text_of(root)), kinds


def virtual_joints(document: Document) -> dict[str, str]:
    """Joints with their types that place a robot in the plane: two level slides, an upright turn, maybe a slide.

    Their links are frames without shapes, but for the little mass that some simulators ask for; slides that go on and
    on are no gantry's, whatever they weigh.
    """
    rest, link, chain = AtRest(document), document.root_link, list[Joint]()
    little = NOTHING * sum(rest.masses.values())
    while len(chain) < 2 + len(PLANE):
        below = document.moving_children(link)
        far = any(j.type == "prismatic" and j.upper - j.lower > FAR for j in (*chain, *below))
        mass = math.inf if far else little
        if len(below) != 1 or any(rest.mass(name) > mass or shaped(rest, name) for name in document.body(link)):
            break
        chain.append(below[0])
        link = below[0].child
    level = [j for j in chain if j.type == "prismatic" and rest.is_horizontal(j)]
    rest_of = sorted((j.type == "prismatic", rest.is_vertical(j)) for j in chain if j not in level)
    crossed = len(level) == 2 and abs(rest.axis(level[0]) @ rest.axis(level[1])) < HORIZONTAL
    places = crossed and rest_of in (PLANE[:1], PLANE)
    return {j.name: j.type for j in chain} if places and document.moving_children(link) else {}


def shaped(rest: AtRest, link: str) -> bool:
    """Whether a link that weighs something has a shape, too."""
    return rest.mass(link) > 0 and rest.document.links[link].find(".//geometry") is not None


def require_rolling(rest: AtRest, base: Base, welds: dict[str, str], overrides: Overrides) -> None:
    """Refuse to take a robot as an arm on a stand whose root moves in the plane (`Undecided`)."""
    moves = [name for name, kind in welds.items() if kind != "floating"]
    if moves and not base.columns and overrides.base is None:
        why = f"its root moves in the plane by {', '.join(moves)}, and no wheel is found"
        fix = "--base holonomic drives it by forces on its frame; --base fixed takes it as an arm"
        raise undecided(rest, [], why, fix, ["holonomic", "fixed"], rest.document.joints[moves[0]].line)

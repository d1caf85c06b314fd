"""From chosen wheels, by the user or by the geometry, to a base: its control frame, the wheels and rollers in it."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import combinations

import numpy as np

from ...elementary import atan2, cos_sin
from ...elementary.matrices import product
from ...errors import ConfigError, RobotError, UnknownName
from ...signals import Array
from ..urdf.document import Joint
from ..urdf.finding import Finding
from ..urdf.shapes import AtRest
from .base import Base, Wheel
from .differential import DifferentialDrive
from .evidence import evidence, motors_named, plugins
from .heading import heading
from .holonomic import HolonomicBase
from .overrides import Overrides
from .report import BaseResult, note, undecided
from .skid_steer import SkidSteer, Tracked, loads, rotation_centre, turning_friction, turning_track
from .steered import SteeredBase
from .wheels import (
    HUB,
    MIDDLE,
    MOST_PER_SIDE,
    SLOPPY,
    SURE,
    Candidate,
    Candidates,
    alike_on_root,
    bare_swivels,
    coaxial,
    is_endless_end,
    is_low,
    moving_above,
    on_either_side,
    parallel,
    rolling,
    wheel_of,
)

SKIDDING = (SkidSteer.kind, Tracked.kind)
ROLLERS = "--roller RADIANS says how they lie, --wheels which of the wheels drive"
SAME_RATE = 0.05  # rims of wheels that are coupled may differ in speed by this fraction
CLOSE = 3.0  # radii from an upright joint within which what rolls is a caster's, and no arm's drum
OFF_CENTRE = 0.02  # a centre of rotation further off than this fraction of half the wheelbase is told
MECANUM = math.pi / 4  # roller angle that is assumed where nothing states one


def on_wheels(
    rest: AtRest, kind: str, drives: list[Candidate], wheels: list[Candidate], overrides: Overrides
) -> BaseResult:
    """The base of a kind on some of its wheels that drive: a differential drive, one that skids, or a holonomic one.

    Raises:
        ConfigError: Wheels that do not suit the base.
        Undecided: Wheels that follow each other, or rollers that leave a direction undriven.
    """
    if kind in SKIDDING:
        return skidding(rest, drives, wheels, overrides, Tracked if kind == Tracked.kind else SkidSteer)
    if kind == HolonomicBase.kind:
        return rolling_sideways(rest, drives, wheels, overrides)
    if len(drives) != 2 or not coaxial(*drives, within=SLOPPY):
        what = "not two wheels on one axle" if len(drives) == 2 else f"{len(drives)} wheel(s) for a differential drive"
        raise ConfigError(what, fix="name the left and the right one", key="wheels", file=rest.document.path)
    base = frame_of(rest, drives, wheels, DifferentialDrive, overrides)
    first, left, notes = drives[0].joint.name, base.wheels[0].joint, list[Finding]()
    if not coaxial(*drives):
        apart = abs(base.wheels[0].x - base.wheels[1].x)
        text = f"the two wheels are not on one axle: {apart:.3g} m apart along the rolling direction"
        why, fix = "they are taken as on one, in the middle", "put their joints on one line"
        notes.append(note(rest, "base-pair", first, text, why, fix))
        base = replace(base, wheels=tuple(replace(w, x=0.0) for w in base.wheels))
    if overrides.wheels and left != overrides.wheels[0]:
        text = f"'{left}' is the left wheel, not '{overrides.wheels[0]}'"
        notes.append(note(rest, "base-sides", first, text, "seen along the rolling direction"))
    return BaseResult(base, (*notes, *sliding_note(rest, drives, wheels)))


def along_note(rest: AtRest, drives: list[Candidate]) -> Iterator[Finding]:
    """A note where only some wheels of a skid-steer base have motors: the others are taken as turned by these."""
    motors = motors_named(rest)
    powered = [c.joint.name for c in drives if c.joint.name in motors]
    if 0 < len(powered) < len(drives):
        text = f"of the wheels only {', '.join(powered)} have motors: {motors[powered[0]]}"
        why = "the others are taken as turned along with those of their side, by a belt or chain"
        fix = f"--wheels {','.join(powered)} where they roll freely" if len(powered) == 2 else ""
        yield note(rest, "base-driven", powered[0], text, why, fix)


def sliding_note(rest: AtRest, drives: list[Candidate], wheels: list[Candidate]) -> Iterator[Finding]:
    """A note on wheels that are parallel to those that drive and off their axle: they would have to slide."""
    driving = [d.joint for d in drives]
    behind = [c for c in wheels if c.mount == "" and c.joint not in driving and parallel(c, drives[0])]
    if behind := [c for c in behind if c.shape != "sphere" and c.joint.name not in on_arms(rest, wheels)]:
        text = f"wheels off the axle cannot swivel and would have to slide: {', '.join(c.joint.name for c in behind)}"
        why, fix = "they are taken as free, and the axle as where the base turns", "--base skid_steer without --wheels"
        left, right = on_either_side([*drives, *behind])
        if not 2 <= left == right <= MOST_PER_SIDE:
            why, fix = f"{why}; what they rub is left out, no base here has them", "put casters there if that is meant"
        yield note(rest, "base-pair", behind[0].joint.name, text, why, fix)


def declared_wheel(rest: AtRest, name: str, candidates: Candidates, overrides: Overrides) -> Candidate:
    """A wheel that the user named.

    Raises:
        UnknownName: No such joint.
        ConfigError: It cannot turn without end, or not about a horizontal axis, or its radius is not known.
    """
    joint = wheel_joint(rest, name, overrides)
    found = next((c for c in candidates.wheels if c.joint.name == name), None)
    candidate = found or wheel_of(rest, joint)
    radius, left = overrides.radius or candidate.radius, 0.0 if math.isnan(candidate.left) else candidate.left
    if math.isnan(radius) or (found is None and left and overrides.radius is None):
        radius, candidate = float(candidate.centre[2] - candidates.footing), replace(candidate, shape=HUB)
    if not radius > (0.0 if overrides.radius else (1 - SURE) * left):
        why = "no shape of it can be read whole, and nothing tells where the floor is"
        raise ConfigError(f"the radius of wheel '{name}' is unknown", why=why, fix="give --radius", key="radius")
    return replace(candidate, radius=radius)


def wheel_joint(rest: AtRest, name: str, overrides: Overrides) -> Joint:
    """The joint of a wheel that the user named; errors as of `declared_wheel`."""
    joint = rest.document.joints.get(name)
    if joint is None:
        turning = [j.name for j in rest.document.joints.values() if j.turns_freely]
        raise UnknownName("wheel joint", name, turning or rest.document.joints, key="wheels")
    if not joint.turns_freely or not rest.is_horizontal(joint):
        why = f"it is {joint.type}" if not joint.turns_freely else "its axis is not horizontal"
        fix = "make it continuous about a horizontal axis" if not joint.turns_freely else "name another joint"
        raise ConfigError(f"joint '{name}' cannot be a wheel", why=why, fix=fix, key="wheels", file=rest.document.path)
    if joint.mimics is not None and overrides.base not in SKIDDING:
        why, fix = f"it follows '{joint.mimics}' (<mimic>)", "name wheels that turn by themselves, or --base skid_steer"
        raise ConfigError(f"joint '{name}' cannot be a drive wheel", why=why, fix=fix, key="wheels")
    return joint


def require_possible(overrides: Overrides, candidates: Candidates, named: list[Candidate]) -> None:
    """Refuse a radius beyond the distance of wheels on one axle, or ten times that where a shape tells theirs.

    Raises:
        ConfigError: The user says one, maybe in millimetres.
    """
    radius, wheels = overrides.radius or math.nan, [*candidates.wheels, *candidates.near_misses, *named]
    for other, one in combinations(wheels, 2):
        apart = float(np.linalg.norm(one.centre - other.centre))
        blind = math.isnan(one.radius) and math.isnan(other.radius)
        if one.joint is not other.joint and coaxial(one, other) and radius >= (1.0 if blind else 10.0) * apart:
            why = f"the wheels '{other.joint.name}' and '{one.joint.name}' are {apart:.3g} m apart"
            millimetres = f"{radius / 1000:g} if these are millimetres, else " if 1.0 <= radius < 1000.0 * apart else ""
            fix = f"give {'--radius ' if millimetres else ''}{millimetres}less than {apart:.3g} m, or leave it out"
            raise ConfigError(f"{radius:g} m cannot be their radius", why=why, fix=fix, key="radius")


def require_motors(rest: AtRest, base: Base, overrides: Overrides) -> None:
    """Refuse a base that needs all its wheels, of which the file drives some, unless the user names them.

    A skid-steer base's others turn along; a plugin may move the base as a whole.

    Raises:
        RobotError: It does.
    """
    motors, names = motors_named(rest), [wheel.joint for wheel in base.wheels if wheel.driven]
    idle = [name for name in names if name not in motors]
    if base.scrubs or overrides.wheels is not None or not 0 < len(idle) < len(names):
        return
    if base.sideways and any(piece.meaning == HolonomicBase.kind for piece in plugins(rest)):
        return
    driven = next(name for name in names if name not in idle)
    what, why = f"nothing drives the wheel(s) {', '.join(idle)}", f"'{driven}' has a motor: {motors[driven]}"
    fix = f"state theirs likewise, or --wheels {','.join(names)} if they have motors"
    raise RobotError(what, why=why, fix=fix, file=rest.document.path, line=rest.document.joints[idle[0]].line)


def require_used(overrides: Overrides, base: Base) -> None:
    """Refuse what is said of wheels that the base does not have.

    Raises:
        ConfigError: It would be ignored.
        UnknownName: The radius of a joint that is no drive wheel.
    """
    names = [wheel.joint for wheel in base.wheels]
    if strange := [name for name in overrides.radius_of if name not in names]:
        raise UnknownName("drive wheel", strange[0], names, key="wheel_radii")
    pivots = base.pivots if isinstance(base, SteeredBase) else ()
    steers = any(p.role != "passive" for p in pivots)
    used = {"radius": bool(names), "track": len(names) > 1, "roller": base.sideways and bool(names), "mu": base.scrubs}
    used |= {"steer": steers, "hitch": bool(pivots), "wheelbase": steers, "steering_limit": steers}
    for key, uses in (used | {"forward": bool(base.columns)}).items():
        if not uses and getattr(overrides, key) is not None:
            what = f"a {key.replace('_', ' ')} for a base '{base.kind}'{'' if names else ' without drive wheels'}"
            raise ConfigError(what, why="nothing would use it", fix="leave it out, or say what the base is", key=key)


# -- the control frame -------------------------------------------------------------------------------------------------


def frame_of(
    rest: AtRest, drives: list[Candidate], wheels: list[Candidate], kind: type[Base], overrides: Overrides
) -> Base:
    """Control frame, wheels, casters and suspensions; errors as of `heading` and `require_motors`."""
    stated = overrides.radius_of
    drives = [replace(c, radius=stated.get(c.joint.name, overrides.radius or c.radius)) for c in drives]
    forward, middle = heading(rest, drives, overrides).forward, np.mean([c.centre[:2] for c in drives], axis=0)
    placed, track = placed_wheels(drives, middle, forward, kind, overrides.track)
    suspensions = [j.name for c in drives for j in rest.document.moving_ancestors(c.joint.child)[1:]]
    base = kind(
        wheels=placed,
        track=track,
        frame=frame_at(middle, forward),
        floor=float(np.mean([c.bottom for c in drives])),
        casters=in_order(rest, casters_of(rest, drives, wheels) - set(suspensions)),
        suspensions=in_order(rest, suspensions),
        parked=in_order(rest, [name for c in wheels for name in c.rollers]),
    )
    require_motors(rest, base, overrides)
    return base


def placed_wheels(
    drives: list[Candidate], middle: Array, forward: Array, kind: type[Base], stated: float | None
) -> tuple[tuple[Wheel, ...], float]:
    """The wheels in the control frame, front to rear and left before right, and their track, maybe stated [m]."""
    left, alike = np.array([-forward[1], forward[0]]), all(parallel(drives[0], c) for c in drives[1:])
    placed = [placed_wheel(c, c.centre[:2] - middle, forward, left, alike) for c in drives]
    placed = sorted(placed, key=lambda w: -w.y) if kind is DifferentialDrive else in_rows(placed)
    track = max(w.y for w in placed) - min(w.y for w in placed)
    if stated is None or not track > 0 or kind.scrubs:
        return tuple(placed), track
    return tuple(replace(w, y=w.y * (stated / track)) for w in placed), stated


def in_rows(wheels: list[Wheel]) -> list[Wheel]:
    """Wheels front to rear and left before right; a row reaches half the least radius back from its first wheel."""
    deep, rows = min(w.radius for w in wheels) / 2, list[list[Wheel]]()
    for w in sorted(wheels, key=lambda w: -w.x):
        if not rows or rows[-1][0].x - w.x > deep:
            rows.append([])
        rows[-1].append(w)
    return [w for row in rows for w in sorted(row, key=lambda w: -w.y)]


def on_arms(rest: AtRest, wheels: Sequence[Candidate]) -> frozenset[str]:
    """Joints of what is round and hangs on a joint that is not upright, which a motor turns or which carries it alone.

    So do drums on arms; wheels on rockers stand in pairs.
    """
    motors, found = motors_named(rest), set[str]()
    for c in wheels:
        swivels = c.trail < CLOSE * c.radius  # on an upright joint, as a ball in a housing that turns
        above = [] if swivels else [j for j in moving_above(rest, c.joint) if not rest.is_vertical(j)]
        alone = not any(coaxial(c, o) for o in wheels if o is not c)
        if above and (alone or any(j.name in motors for j in above)):
            found.add(c.joint.name)
    return frozenset(found)


def casters_of(rest: AtRest, drives: list[Candidate], wheels: list[Candidate]) -> set[str]:
    """Joints that carry wheels that do not drive, and swivels whose wheel is welded on."""
    floor, radius = max(c.bottom for c in drives), max(c.radius for c in drives)
    driving = [d.joint for d in drives]
    drums = on_arms(rest, wheels)
    free = [c for c in wheels if c.joint not in driving and c.joint.name not in drums]
    others = [j for c in free for j in rest.document.moving_ancestors(c.joint.child)]
    return {joint.name for joint in (*others, *bare_swivels(rest, floor, radius))}


def placed_wheel(c: Candidate, at: Array, forward: Array, left: Array, alike: bool) -> Wheel:
    """The wheel in the control frame; parallel wheels have a sign, others a heading of their own."""
    ahead, beside = (float(product(rolling(c), way)) for way in (forward, left))
    x, y = float(product(at, forward)), float(product(at, left))
    sign, heading = (math.copysign(1.0, ahead), 0.0) if alike else (1.0, atan2(beside, ahead))
    return Wheel(c.joint.name, c.radius, sign, y=y, x=0.0 if abs(x) < 1e-12 else x, heading=heading)


def frame_at(origin: Array, forward: Array) -> Array:
    """(3,) control frame at a place, along a direction."""
    return np.array([origin[0], origin[1], atan2(float(forward[1]), float(forward[0]))])


def in_frame(frame: Array, point: Array) -> tuple[float, float]:
    """A place in a planar frame [m]."""
    c, s = cos_sin(float(frame[2]))
    x, y = float(point[0] - frame[0]), float(point[1] - frame[1])
    return c * x + s * y, c * y - s * x


def in_order(rest: AtRest, names: Sequence[str] | set[str]) -> tuple[str, ...]:
    """Joints once each, in the order of the file."""
    return tuple(name for name in rest.document.joints if name in set(names))


# -- skid-steer bases --------------------------------------------------------------------------------------------------


def skidding(
    rest: AtRest, drives: list[Candidate], wheels: list[Candidate], overrides: Overrides, kind: type[SkidSteer]
) -> BaseResult:
    """Base on wheels or belts that skid when it turns: a virtual axle in the middle, effective track, turning friction.

    Raises:
        ConfigError: Not two or three parallel wheels on either side, on belts one or more; with their names.
        Undecided: Wheels of one side that do not roll alike.
    """
    base = frame_of(rest, drives, wheels, kind, overrides)
    base = replace(base, parked=in_order(rest, [*base.parked, *idlers(rest, base, drives)]))
    sides = [[w for w in base.wheels if side * w.y > MIDDLE * base.track] for side in (1, -1)]
    require_sides(rest, [[w.joint for w in side] for side in sides], drives, kind)
    require_together(rest, drives)
    mass, centre = weight_in(rest, base)
    load, mu = loads(base.wheels, mass, centre), overrides.mu or 1.0
    left, right = (float(np.mean([w.y for w in side])) for side in sides)
    track = overrides.track or left - right
    base = replace(base, track=track, turning=turning_friction(base.wheels, track, load, mu))
    first, rolls = drives[0].joint.name, turning_track(base.wheels)
    text = f"effective track {track:.4g} m, turning friction {base.turning:.3g} N m (mu {mu:g}, {mass:.4g} kg)"
    why = f"of wheels that skid the turn on the spot on a hard floor has about {rolls:.3g} m"
    text = f"the effective track is taken as the geometric one: {text}" if overrides.track is None else text
    fix = f"--track {rolls:.3g}, or as you measured it; --mu"
    findings = [*along_note(rest, drives), note(rest, "base-skid", first, text, why, fix)]
    if kind is Tracked:
        text = "a belt makes the radius larger by its thickness, which is not in the file"
        findings.append(note(rest, "base-skid", first, text, "", "--radius with the belt"))
    ahead = rotation_centre(base.wheels, load)
    if abs(ahead) > OFF_CENTRE * max(abs(w.x) for w in base.wheels):
        text = f"the base turns about a place {abs(ahead):.3g} m {'ahead of' if ahead > 0 else 'behind'} its middle"
        why = f"its weight is there; the middle slides sideways by {abs(ahead):.3g} m times the yaw rate, not in T"
        findings.append(note(rest, "base-skid", first, text, why, "the contact plant shows it: --plant contact"))
    return BaseResult(base, tuple(findings))


def require_sides(
    rest: AtRest, sides: Sequence[Sequence[str]], drives: Sequence[Candidate], kind: type[SkidSteer]
) -> None:
    """Refuse wheels that are not as many on either side, or too few, or too many; errors as of `skidding`."""
    left, right = sides
    least, most = (2, MOST_PER_SIDE) if kind is SkidSteer else (1, len(drives))
    even = all(parallel(drives[0], c) for c in drives[1:]) and least <= len(left) == len(right) <= most
    if even and len(left) + len(right) == len(drives):
        return
    middle = [c.joint.name for c in drives if c.joint.name not in (*left, *right)]
    places = {"on the left": left, "on the right": right, "in the middle": middle}
    told = "; ".join(f"{place} {', '.join(names)}" for place, names in places.items() if names)
    what = f"{len(drives)} wheel(s) for a {'tracked machine' if kind is Tracked else 'skid-steer base'}: {told}"
    several = f"name two or {MOST_PER_SIDE} parallel wheels of either side with --wheels"
    fix = f"--wheels {','.join([*left, *right])} where these drive" if even else several
    raise ConfigError(what, fix=fix, key="wheels", file=rest.document.path)


def idlers(rest: AtRest, base: Base, drives: Sequence[Candidate]) -> list[str]:
    """Endless joints beside the wheels of a side, about parallel axes: sprockets and idlers of a belt."""
    known = {c.joint.name for c in drives}
    ends = [j for j in rest.document.moving_children(rest.document.root_link) if is_endless_end(rest, j)]
    others = [c for c in (wheel_of(rest, j) for j in ends if j.name not in known) if parallel(c, drives[0])]
    at = {c.joint.name: in_frame(base.frame, c.centre)[1] for c in (*drives, *others)}
    return [
        o.joint.name for o in others if any(abs(at[o.joint.name] - at[d.joint.name]) < d.radius / 2 for d in drives)
    ]


def require_together(rest: AtRest, drives: list[Candidate]) -> None:
    """Refuse wheels of a side that a `<mimic>` turns against each other, or at other rates than they roll.

    Raises:
        Undecided: They would have to slide as the base drives straight on.
    """
    by_name = {c.joint.name: c for c in drives}
    for c, master in [(c, by_name[c.joint.mimics]) for c in drives if c.joint.mimics in by_name]:
        right = master.radius / c.radius * math.copysign(1.0, product(rolling(c), rolling(master)))
        if abs(c.joint.multiplier / right - 1) > SAME_RATE:
            rate = f"{c.joint.multiplier / right:.3g} times as fast as '{master.joint.name}'"
            what = f"<mimic> rolls wheel '{c.joint.name}' {rate} (multiplier {c.joint.multiplier:g})"
            fix = f'multiplier="{right:.4g}" rolls them alike; or take out the <mimic> if it turns by itself'
            raise undecided(rest, drives, what, fix, ["skid_steer"], c.joint.line)


def weight_in(rest: AtRest, base: Base) -> tuple[float, Array]:
    """Mass of the robot at rest [kg], and its centre (2,) in the control frame [m]."""
    return math.fsum(rest.masses.values()), np.array(in_frame(base.frame, rest.middle))


# -- holonomic bases ---------------------------------------------------------------------------------------------------


def rolling_sideways(
    rest: AtRest, drives: list[Candidate], wheels: list[Candidate], overrides: Overrides
) -> BaseResult:
    """A holonomic base on mecanum wheels, which are parallel, or on omni wheels.

    Rollers lie as the user or the file says; else those of mecanum wheels on the floor across the diagonals, and those
    of omni wheels across the rolling direction: wheels whose axles cross must slide along them to roll together.

    Raises:
        ConfigError: Fewer than three wheels.
        Undecided: They cannot move it in all three directions.
    """
    if len(drives) < 3:
        raise ConfigError(f"{len(drives)} wheel(s) for a holonomic base", fix="name at least three", key="wheels")
    base = frame_of(rest, drives, wheels, HolonomicBase, overrides)
    level, known, findings = all(parallel(drives[0], c) for c in drives[1:]), dict[str, float](), list[Finding]()
    first, angle = drives[0].joint.name, overrides.roller
    if level and angle is None:
        pieces = evidence(rest, drives, overrides.controllers_file)
        known = {piece.wheel: piece.roller for piece in pieces if not math.isnan(piece.roller)}
    if angle is None and not level:
        angle, text = 0.0, "omni wheels assumed: their rollers turn about the rolling direction (0 degrees)"
        why = "plain wheels whose axles cross could not roll together"
        findings.append(note(rest, "base-omni", first, text, why, "--roller RADIANS for another angle"))
    elif angle is None and not {*known} >= {wheel.joint for wheel in base.wheels}:
        text = f"rollers at {math.degrees(MECANUM):.0f} degrees assumed, on the floor across the diagonals "
        text, why = f"{text}(from above an X)", "nothing in the file states their angle"
        fix = "--roller RADIANS, negative for wheels mounted the other way round"
        findings.append(note(rest, "base-roller", first, text, why, fix))
    size = MECANUM if angle is None else angle
    across = {w.joint: -math.copysign(1.0, w.x * w.y) * size if level else size for w in base.wheels} | known
    base = replace(base, wheels=tuple(replace(w, roller=across[w.joint]) for w in base.wheels))
    if np.linalg.matrix_rank(np.array([wheel.grip for wheel in base.wheels]), tol=1e-6) < 3:
        why = "wheels with rollers at these places leave a direction undriven"
        raise undecided(rest, drives, why, ROLLERS, [HolonomicBase.kind])
    return BaseResult(base, tuple(findings))


def pushed(rest: AtRest, candidates: Candidates, overrides: Overrides) -> BaseResult:
    """A holonomic base whose wheels are not modelled: forces on its frame drive it."""
    found = [c.joint for c in (*candidates.wheels, *candidates.near_misses, *candidates.limited)]
    found += [*(joint for joint in rest.document.joints.values() if is_low(rest, joint)), *alike_on_root(rest)]
    names = tuple(j.name for joint in found for j in rest.document.moving_ancestors(joint.child))
    floor = candidates.floor if math.isfinite(candidates.floor) else 0.0
    text = "the base has no drive wheels: forces and a torque on the root link drive it, without limits"
    if any(c.mount in ("steering", "swivel") for c in candidates.wheels):
        text += "; its wheels slide over the floor, and what steers them stands still"
    frame = frame_at(np.zeros(2), heading(rest, [], overrides, any_way=True).forward)
    base = HolonomicBase(floor=floor, frame=frame, casters=in_order(rest, names))
    return BaseResult(base, (note(rest, "base-pushed", "", text, "you said --base holonomic"),))

"""From chosen wheels, by the user or by the geometry, to a base: its control frame, the wheels and rollers in it."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ...elementary import atan2, hypot
from ...elementary.matrices import product
from ...errors import ConfigError, UnknownName
from ...signals import Array
from ..urdf.finding import Finding
from ..urdf.shapes import AtRest
from .base import Base, Wheel
from .differential import DifferentialDrive
from .evidence import evidence, stated_rollers
from .holonomic import Holonomic
from .overrides import Overrides
from .report import BaseResult, Reading, note, undecided
from .wheels import HUB, Candidate, Candidates, bare_swivels, coaxial, parallel, wheel_of

ROLLERS = "--roller RADIANS says how they lie, --wheels which of the wheels drive"

MECANUM = math.pi / 4  # roller angle that is assumed where nothing states one


def with_wheels(rest: AtRest, drives: list[Candidate], wheels: list[Candidate], overrides: Overrides) -> BaseResult:
    """The base on chosen wheels.

    Raises:
        ConfigError: Wheels that do not suit the base.
    """
    if overrides.base == "holonomic" or (overrides.base is None and len(drives) > 2):
        if len(drives) < 3:
            raise ConfigError(f"{len(drives)} wheel(s) for a holonomic base", fix="name at least three", key="wheels")
        if not all(parallel(drives[0], c) for c in drives[1:]):
            return crossed(rest, drives, wheels, overrides)
        base, findings = mecanum(rest, drives, wheels, overrides, stated_rollers(evidence(rest, drives)))
        return BaseResult(base, tuple(findings))
    if len(drives) != 2 or not coaxial(*drives):
        what = "not two wheels on one axle" if len(drives) == 2 else f"{len(drives)} wheel(s) for a differential drive"
        raise ConfigError(what, fix="name the left and the right one", key="wheels", file=rest.document.path)
    base = frame_of(rest, drives, wheels, DifferentialDrive, overrides)
    left = base.wheels[0].joint
    if overrides.wheels and left != overrides.wheels[0]:
        text = f"'{left}' is the left wheel, not '{overrides.wheels[0]}'"
        sides = note(rest, "base-sides", drives[0].joint.name, text, "seen along the rolling direction")
        return BaseResult(base, (sides,))
    return BaseResult(base)


def declared_wheel(rest: AtRest, name: str, candidates: Candidates, overrides: Overrides) -> Candidate:
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
    if joint.mimics is not None:
        why, fix = f"it follows '{joint.mimics}' (<mimic>)", "name wheels that turn by themselves"
        raise ConfigError(f"joint '{name}' cannot be a drive wheel", why=why, fix=fix, key="wheels")
    found = next((c for c in candidates.wheels if c.joint.name == name), None)
    candidate = found or wheel_of(rest, joint)
    radius = overrides.radius or candidate.radius
    if math.isnan(radius):
        radius, candidate = float(candidate.centre[2] - candidates.footing), replace(candidate, shape=HUB)
    if not radius > 0:
        why = "no shape of it can be read, and nothing tells where the floor is"
        raise ConfigError(f"the radius of wheel '{name}' is unknown", why=why, fix="give --radius", key="radius")
    return replace(candidate, radius=radius)


def require_used(overrides: Overrides, base: Base) -> None:
    """Refuse what is said of wheels that the base does not have.

    Raises:
        ConfigError: It would be ignored.
    """
    unused = {"radius": not base.wheels, "track": len(base.wheels) < 2, "roller": base.kind != "holonomic"}
    unused["roller"] |= not base.wheels
    for key, ignored in unused.items():
        if ignored and getattr(overrides, key) is not None:
            what = f"a {key} for a base '{base.kind}'" + ("" if base.wheels else " without drive wheels")
            raise ConfigError(what, why="nothing would use it", fix="leave it out, or say what the base is", key=key)


# -- the control frame -------------------------------------------------------------------------------------------------


def frame_of(
    rest: AtRest, drives: list[Candidate], wheels: list[Candidate], kind: type[Base], overrides: Overrides
) -> Base:
    """Control frame, wheels, casters and suspensions; forward is the rolling direction nearer the root's x."""
    alike = all(parallel(drives[0], c) for c in drives[1:])
    forward = rolling(drives[0]) if alike else np.array([1.0, 0.0])
    backward = forward[0] < -1e-6 or (abs(forward[0]) <= 1e-6 and forward[1] < 0)  # axle along x: y is as near
    forward = (-forward if backward else forward) + 0.0  # no -0
    left = np.array([-forward[1], forward[0]])
    middle = np.mean([c.centre[:2] for c in drives], axis=0)
    placed = [placed_wheel(c, c.centre[:2] - middle, forward, left, alike, overrides) for c in drives]
    in_rows = kind is Holonomic
    placed.sort(key=lambda w: (-round(w.x, 6) * in_rows, -w.y))  # front to rear, left before right
    track = max(w.y for w in placed) - min(w.y for w in placed)
    if overrides.track is not None and track > 0:
        placed = [replace(w, y=w.y * overrides.track / track) for w in placed]
        track = overrides.track
    suspensions = [j.name for c in drives for j in rest.document.moving_ancestors(c.joint.child)[1:]]
    others = [c for c in wheels if c.joint not in [d.joint for d in drives]]
    casters = [j.name for c in others for j in rest.document.moving_ancestors(c.joint.child)]
    floor, radius = max(c.bottom for c in drives), max(c.radius for c in drives)
    casters += [joint.name for joint in bare_swivels(rest, floor, radius)]
    return kind(
        wheels=tuple(placed),
        track=track,
        frame=np.array([*middle, atan2(forward[1], forward[0])]),
        floor=float(np.mean([c.bottom for c in drives])),
        casters=in_order(rest, set(casters) - set(suspensions)),
        suspensions=in_order(rest, suspensions),
        parked=in_order(rest, [name for c in wheels for name in c.rollers]),
    )


def rolling(candidate: Candidate) -> Array:
    """(2,) direction that positive joint velocity rolls a wheel in."""
    return np.array([candidate.axis[1], -candidate.axis[0]]) / hypot(candidate.axis[0], candidate.axis[1])


def placed_wheel(c: Candidate, at: Array, forward: Array, left: Array, alike: bool, overrides: Overrides) -> Wheel:
    """The wheel in the control frame; parallel wheels have a sign, others a heading of their own."""
    direction, radius = rolling(c), overrides.radius or c.radius
    sign = math.copysign(1.0, product(direction, forward)) if alike else 1.0
    heading = 0.0 if alike else atan2(float(product(direction, left)), float(product(direction, forward)))
    x, y = float(product(at, forward)), float(product(at, left))
    x = 0.0 if abs(x) < 1e-12 else x
    return Wheel(c.joint.name, radius, sign, y=y, x=x, heading=heading)


def in_order(rest: AtRest, names: Sequence[str] | set[str]) -> tuple[str, ...]:
    """Joints once each, in the order of the file."""
    return tuple(name for name in rest.document.joints if name in set(names))


# -- holonomic bases ---------------------------------------------------------------------------------------------------


def mecanum(
    rest: AtRest, drives: list[Candidate], wheels: list[Candidate], overrides: Overrides, stated: dict[str, float]
) -> tuple[Base, list[Finding]]:
    """Base on mecanum wheels; on the floor their rollers lie as the file states it, else across the diagonals.

    Args:
        rest: The robot at rest.
        drives: Its drive wheels.
        wheels: All its wheels.
        overrides: What the user says.
        stated: Roller angle by wheel, where the file states one [rad].
    """
    base = frame_of(rest, drives, wheels, Holonomic, overrides)
    size, known = (MECANUM, stated) if overrides.roller is None else (overrides.roller, {})
    rolled = tuple(replace(w, roller=known.get(w.joint, -math.copysign(1.0, w.x * w.y) * size)) for w in base.wheels)
    base = checked(rest, replace(base, wheels=rolled), drives)
    if overrides.roller is not None or all(wheel.joint in stated for wheel in base.wheels):
        return base, []
    text = (
        f"rollers at {math.degrees(MECANUM):.0f} degrees assumed, on the floor across the diagonals (from above an X)"
    )
    why, fix = (
        "nothing in the file states their angle",
        "--roller RADIANS, negative for wheels mounted the other way round",
    )
    return base, [note(rest, "base-roller", drives[0].joint.name, text, why, fix)]


def crossed(rest: AtRest, drives: list[Candidate], wheels: list[Candidate], overrides: Overrides) -> BaseResult:
    """Wheels whose axles are not parallel: to roll together they must slide along them (omni wheels)."""
    base = frame_of(rest, drives, wheels, Holonomic, overrides)
    roller = overrides.roller if overrides.roller is not None else 0.0
    base = checked(rest, replace(base, wheels=tuple(replace(w, roller=roller) for w in base.wheels)), drives)
    if overrides.roller is not None:
        return BaseResult(base)
    text = "omni wheels assumed: their rollers turn about the rolling direction (0 degrees)"
    why = "plain wheels whose axles cross could not roll together"
    omni = note(rest, "base-omni", drives[0].joint.name, text, why, "--roller RADIANS for another angle")
    return BaseResult(base, (omni,))


def checked(rest: AtRest, base: Base, drives: list[Candidate]) -> Base:
    """The base, if its wheels can move it in all three directions.

    Raises:
        Undecided: They cannot.
    """
    if np.linalg.matrix_rank(np.array([wheel.grip for wheel in base.wheels]), tol=1e-6) < 3:
        against = Reading("holonomic", (), ("its wheels cannot drive it in all three directions",))
        raise undecided(
            rest, drives, [against], "wheels with rollers at these places leave a direction undriven", ROLLERS
        )
    return base


def pushed(rest: AtRest, candidates: Candidates) -> BaseResult:
    """A holonomic base whose wheels are not modelled: forces on its frame drive it."""
    names = tuple(
        j.name
        for c in [*candidates.wheels, *candidates.near_misses, *candidates.limited]
        for j in rest.document.moving_ancestors(c.joint.child)
    )
    floor = candidates.floor if math.isfinite(candidates.floor) else 0.0
    text = "the base has no drive wheels: forces and a torque on the root link drive it, without limits"
    base = Holonomic(floor=floor, casters=in_order(rest, names))
    return BaseResult(base, (note(rest, "base-pushed", "", text, "you said --base holonomic"),))

"""What carries the arm: a differential drive, a holonomic base, nothing that moves; or a question to the user.

Geometry at rest decides first (`wheels`), what else the file says next (`evidence`); a machine that is none of these
is refused by its name. What the user says (`overrides`) is taken as it is.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from ..urdf.shapes import AtRest
from .base import Base, Reading, Understood
from .doubts import limited, require_led, require_no_slaves
from .evidence import evidence, stated_rollers, verdict
from .given import given_wheel, require_used, with_wheels
from .machines import machine
from .overrides import Overrides
from .refusals import not_on_floor, readings, undecided, unsupported
from .remarks import evidence_note, remarks, welded_note
from .rollers import crossed, mecanum, pushed
from .wheels import (
    TRAIL,
    Candidate,
    Seen,
    coaxial,
    parallel,
    welded_cylinders,
    welded_wheels,
    wheel_candidates,
)


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
    seen = wheel_candidates(rest, said.radius)
    drives = seen.wheels
    if said.base == "fixed":
        found = Understood(parked([*seen.wheels, *seen.odd, *seen.limited]))
    elif said.wheels is not None:
        drives = [given_wheel(rest, name, seen, said) for name in said.wheels]
        found = with_wheels(rest, drives, [*seen.wheels, *seen.limited], said)
    elif said.base == "holonomic" and not plain(seen.wheels):
        found = pushed(rest, seen)
    else:
        found = decide(rest, seen, said)
    require_used(said, found.base)
    welds = welded_note(rest, welded_cylinders(rest, seen.floor)) if found.base.wheels else []
    return replace(found, findings=(*found.findings, *remarks(rest, found.base, drives), *welds))


def parked(wheels: list[Candidate]) -> Base:
    """A base that stands still whatever it has."""
    casters = tuple(c.joint.name for c in wheels if c.mount == "swivel")
    names = (name for c in wheels for name in (c.joint.name, *c.rollers))
    return Base("fixed", parked=tuple(name for name in names if name not in casters), casters=casters)


def decide(rest: AtRest, seen: Seen, said: Overrides) -> Understood:
    """The base as geometry and evidence have it."""
    wheels = seen.wheels
    if seen.limited and (wheels or not machine(rest)):
        raise limited(rest, seen)
    if not wheels and seen.odd and not (rest.is_vertical(seen.odd[0].joint) and machine(rest)):
        raise not_on_floor(rest, seen)
    if not wheels:
        return without_wheels(rest, said, seen.floor)
    drives = plain(wheels)
    balls = [c for c in drives if c.shape == "sphere"]
    if 0 < len(balls) == len(drives) - 2:  # balls beside two proper wheels: casters written as continuous joints
        drives = [c for c in drives if c not in balls]
    refuse_steered(rest, wheels)
    require_no_slaves(rest, wheels, drives)
    if len(drives) == 2 and coaxial(*drives) and said.base != "holonomic":
        require_led(rest, drives, wheels)
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
    if not drives and not steered:  # nothing else drives, and what does not trail is no caster
        steered = [c for c in wheels if c.mount == "swivel" and c.trail <= TRAIL]
    legged = [c for c in wheels if c.mount == "leg"]
    if len(legged) >= 2:
        raise unsupported(
            rest, "legged machine", f"its wheels hang on legs: {'; '.join(c.text for c in legged)}", legged
        )
    if steered:
        name = "car-like base" if drives else "swerve drive"
        raise unsupported(rest, name, f"wheels are steered: {'; '.join(c.text for c in steered)}", steered)


def without_wheels(rest: AtRest, said: Overrides, floor: float) -> Understood:
    """A fixed arm, unless it walks, flies, is welded together or stands on welded wheels."""
    if told := machine(rest):
        name, why = told
        raise unsupported(rest, name, why)
    moving = [joint for joint in rest.document.joints.values() if joint.moves]
    welded = welded_wheels(rest, floor)
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
    if said.base is not None:
        why = "no joint turns without end about a horizontal axis with something round on the floor"
        yours = Reading(said.base, ("you said so",), (why,))
        raise undecided(rest, [], [yours], why, "name them with --wheels LEFT,RIGHT")
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
    base, assumed = mecanum(rest, drives, wheels, said, stated_rollers(cited))
    return Understood(base, (*findings, *assumed))

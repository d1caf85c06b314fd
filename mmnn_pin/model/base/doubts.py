"""What makes coaxial wheels on the floor doubtful: slaves, limits, and a wheel in front that steers and drives."""

from __future__ import annotations

import re
from collections.abc import Iterator

from ..urdf.shapes import AtRest
from .base import Reading, Undecided
from .evidence import evidence, verdict
from .refusals import GO_ON, undecided, unsupported
from .wheels import TRAIL, Candidate, Seen, parallel

STEERS = re.compile(r"tricycle|ackermann|bicycle|car[_-]?like", re.IGNORECASE)
ROLLS = re.compile(r"diff[_-]?drive", re.IGNORECASE)


def limited(rest: AtRest, seen: Seen) -> Undecided:
    """The error for wheels whose joints have limits."""
    names = ", ".join(f"'{c.joint.name}'" for c in seen.limited)
    why = f"{names}: revolute with limits, and a wheel turns without end"
    two = Reading("differential_drive", ("coaxial round bodies on the floor",), (why,))
    still = Reading("fixed", ("no wheel can turn without end",), ("there are wheels under it",))
    fix = 'write type="continuous" for wheels, name the others with --wheels LEFT,RIGHT, or --base fixed to park them'
    return undecided(rest, [*seen.wheels, *seen.limited], [two, still], why, fix)


def require_no_slaves(rest: AtRest, wheels: list[Candidate], drives: list[Candidate]) -> None:
    """Refuse drive wheels that follow others (<mimic>): nothing that this package drives has them.

    Raises:
        Unsupported: Wheels behind each other that turn together must slip: a skid-steer.
        Undecided: Other slaves.
    """
    slaves = [c for c in drives if c.joint.mimics is not None]
    if not slaves:
        return
    why = "; ".join(f"wheel '{c.joint.name}' follows '{c.joint.mimics}' (<mimic>)" for c in slaves)
    aligned = all(parallel(drives[0], c) for c in drives[1:])
    if aligned and all(tracked(c, drives) for c in slaves) and verdict(evidence(rest, drives)) != "holonomic":
        raise unsupported(rest, "skid-steer base", why, drives)
    two = Reading("differential_drive", (), ("a drive wheel turns by itself",))
    raise undecided(rest, wheels, [two], why, GO_ON + ", or take out their <mimic>")


def tracked(slave: Candidate, drives: list[Candidate]) -> bool:
    """Whether a wheel follows one in front of or behind it, on the same side."""
    master = next((c for c in drives if c.joint.name == slave.joint.mimics), None)
    if master is None:
        return False
    between = slave.centre - master.centre
    return bool(abs(between @ master.axis) < master.radius < float((between @ between) ** 0.5))


def require_led(rest: AtRest, drives: list[Candidate], wheels: list[Candidate]) -> None:
    """Refuse two coaxial wheels that another wheel or plugin steers.

    A free caster follows by its trail. One without may be a tricycle's front wheel: what the file drives decides.

    Raises:
        Unsupported: The file drives the wheel that steers, and not the two.
        Undecided: Nothing tells, or pieces contradict each other.
    """
    front = [c for c in wheels if c.mount == "swivel" and c.trail <= TRAIL]
    told = list(driven(rest, drives, front))
    steers, rolls = ([text for kind, text in told if kind == wanted] for wanted in ("car-like", "differential_drive"))
    if front and steers and not rolls:
        why = f"{'; '.join(c.text for c in front)} has no trail and steers: {', '.join(steers)}"
        raise unsupported(rest, "car-like base", why, front)
    if steers or (front and not rolls):
        why = f"the file also speaks of steering: {', '.join(steers)}"
        if not steers:
            why = f"'{front[0].joint.name}' has no trail: a caster could not follow, a tricycle steers with it"
        two = Reading("differential_drive", ("two coaxial wheels", *rolls), tuple(steers))
        car = Reading("car-like", tuple(steers) or (f"a wheel without trail: '{front[0].joint.name}'",), tuple(rolls))
        raise undecided(rest, wheels, [two, car], why)


def driven(rest: AtRest, drives: list[Candidate], front: list[Candidate]) -> Iterator[tuple[str, str]]:
    """What plugins, controllers and motors say of two coaxial wheels and those that may steer: a kind, and the text."""
    root = rest.document.root
    for element in root.iterfind("gazebo//*"):
        words = f"{element.get('filename', '')} {element.get('name', '')} {element.text or ''}"
        for kind, pattern in (("car-like", STEERS), ("differential_drive", ROLLS)):
            if element.tag in ("plugin", "controller") and (hit := pattern.search(words)):
                yield kind, f"<gazebo> names '{hit[0]}' (line {element.sourceline})"
    ahead = {j.name for c in front for j in rest.document.moving_ancestors(c.joint.child)}
    pair = {c.joint.name for c in drives}
    moved = [e for e in root.iterfind("ros2_control/joint") if e.find("command_interface") is not None]
    for what, motors in (("<ros2_control>", moved), ("<transmission>", root.findall("transmission/joint"))):
        lines = {e.get("name"): e.sourceline for e in motors}
        for kind, own, others in (("car-like", ahead, pair), ("differential_drive", pair, ahead)):
            if lines.keys() & own and not lines.keys() & others:
                name = sorted(lines.keys() & own)[0]
                yield kind, f"{what} drives '{name}' (line {lines[name]})"

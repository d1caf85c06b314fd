"""Wheels that steer: car-like, tricycle and swerve drives, refused by their names, and casters that only look so."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence

import numpy as np

from ..urdf.shapes import AtRest
from .report import Reading, blind_fix, readings, undecided, unsupported
from .wheels import TRAIL, Candidate, coaxial, is_low, parallel, wheel_of

STEERS = re.compile(r"tricycle|ackermann|bicycle|car[_-]?like", re.IGNORECASE)

ROLLS = re.compile(r"diff[_-]?drive", re.IGNORECASE)

PUSHED = "--base holonomic drives it by forces on its frame, its wheels standing still"


def plain(wheels: Sequence[Candidate]) -> list[Candidate]:
    """Wheels that hang on nothing that turns."""
    return [c for c in wheels if c.mount == ""]


def refuse_steered(rest: AtRest, wheels: list[Candidate]) -> None:
    """Refuse wheels that steer, wheels on casters that have motors, and wheels at the ends of legs.

    Raises:
        Unsupported: By name.
        Undecided: What drives beside casters cannot be measured.
    """
    steered, drives = [c for c in wheels if c.mount == "steering"], plain(wheels)
    swivels = [c for c in wheels if c.mount == "swivel"]
    legged = [c for c in wheels if c.mount == "leg"]
    if len(legged) >= 2:
        raise unsupported(
            rest, "legged machine", f"its wheels hang on legs: {'; '.join(c.text for c in legged)}", legged
        )
    known = {c.joint.name for c in wheels}
    blind = [wheel_of(rest, j) for j in rest.document.joints.values() if is_low(rest, j) and j.name not in known]
    if not drives and len(blind) >= 2:
        why = "what would drive them cannot be measured"
        raise undecided(rest, [*wheels, *blind], readings(rest, blind), why, blind_fix(blind))
    if not drives and not steered and swivels and all(c.trail <= TRAIL for c in swivels):
        steered = swivels  # what does not trail is no caster
    if steered and drives:
        raise unsupported(rest, "car-like base", f"wheels are steered: {'; '.join(c.text for c in steered)}", steered)
    if steered or (swivels and not drives):
        name = "swerve drive" if steered else "base on powered casters"
        why = f"all its wheels {'are steered' if steered else 'hang on swivels'}: {'; '.join(c.text for c in wheels)}"
        raise unsupported(rest, name, why, wheels, turned_fix(wheels))


def turned_fix(wheels: list[Candidate]) -> str:
    """The way out for a base all of whose wheels can be turned about the vertical."""
    fix = PUSHED
    corners = {(c.centre[0] > np.mean([o.centre[0] for o in wheels]), c.centre[1] > 0) for c in wheels}
    if len(wheels) == 4 and len(corners) == 4 and all(parallel(wheels[0], c) for c in wheels):
        names = ",".join(c.joint.name for c in wheels)
        fix += f"; --base holonomic --wheels {names} takes them as mecanum wheels that do not steer"
    return fix + "; --base fixed takes it as an arm"


def refuse_steered_pair(rest: AtRest, drives: list[Candidate], wheels: list[Candidate]) -> None:
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
    if front_axle(front, drives) and not rolls:
        names = ",".join(c.joint.name for c in drives)
        fix = f"--wheels {names} if those in front are casters, --base fixed takes it as an arm"
        why = f"two wheels on one axle are steered, without a trail: {'; '.join(c.text for c in front)}"
        raise unsupported(rest, "car-like base", why, front, fix)
    if steers or (front and not rolls):
        why = f"the file also speaks of steering: {', '.join(steers)}"
        if not steers:
            why = f"'{front[0].joint.name}' has no trail: a caster could not follow, a tricycle steers with it"
        two = Reading("differential_drive", ("two coaxial wheels", *rolls), tuple(steers))
        car = Reading("car-like", tuple(steers) or (f"a wheel without trail: '{front[0].joint.name}'",), tuple(rolls))
        names = ",".join(c.joint.name for c in drives)
        fix = f"--wheels {names} if what else stands on the floor are casters, --base fixed takes it as an arm"
        raise undecided(rest, wheels, [two, car], why, fix)


def front_axle(front: list[Candidate], drives: list[Candidate]) -> bool:
    """Whether two wheels that could be steered make an axle of their own, parallel to that of two others."""
    return len(front) == 2 and coaxial(*front) and not coaxial(front[0], drives[0]) and parallel(front[0], drives[0])


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

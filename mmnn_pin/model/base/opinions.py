"""What else speaks of radius, track and sides than geometry: other shapes, joints, plugins, controllers' files.

They are told, and the geometry is taken; what is taken of a controllers' file is in `calibration`.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Sequence

import numpy as np

from ...elementary import cos, sin
from ..urdf.finding import Finding
from ..urdf.shapes import HORIZONTAL, AtRest
from .base import Base
from .controllers import RADII, TRACKS, beside, in_yaml
from .evidence import stated
from .overrides import Overrides
from .report import note
from .wheels import STATED, UNSEEN, Candidate

SIDED = re.compile(r"(left|right)_?(?:wheel_?)?joint", re.IGNORECASE)  # tags of plugins

OPINION = 0.01  # lengths that differ by more than this fraction are told


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
    if overrides.radius is None:
        yield from shape_opinions(rest, own)
    yield from named_sides(rest, base)
    blind = [c.joint.name for c in own if c.shape == STATED and overrides.radius is None]
    questions = [("track", base.track, stated(rest, overrides.controllers_file, TRACKS)), ("radius", radius, [])]
    questions[1] = ("radius", radius, stated(rest, overrides.controllers_file, RADII))
    for name, used, opinions in questions:
        for opinion in opinions if getattr(overrides, name) is None else ():
            if blind and name == "radius":
                text = f"the radius {used:.4g} m of {', '.join(blind)} is what the file states: {opinion.text}"
                why, fix = "no shape of them can be read whole", "--radius, or --package-dir where their meshes are"
                yield note(rest, "base-stated", first, text, why, fix)
            elif apart(opinion.value, used if not opinion.side else side_radius(base, opinion.side)):
                text = f"{opinion.text} states a {name} of {opinion.value:.4g} m, its geometry {used:.4g} m"
                yield note(rest, "base-stated", first, text, "taken is the geometry", f"--{name} {opinion.value:.6g}")


def side_radius(base: Base, side: str) -> float:
    """Radius of the drive wheels on a side, "left" or "right" [m]."""
    return float(np.median([w.radius for w in base.wheels if (w.y > 0.0) == (side == "left")]))


def shape_opinions(rest: AtRest, wheels: Sequence[Candidate]) -> Iterator[Finding]:
    """Wheels whose visual shapes have another radius than the collision shapes that are measured, or are missing."""
    hubs = [c for c in wheels if not math.isnan(c.left) and c.shape not in UNSEEN]
    if hubs:
        names = ", ".join(c.joint.name for c in hubs)
        text = (
            f"the radius {hubs[0].radius:.4g} m is that of the collision shapes of {names}: a mesh of them is missing"
        )
        fix = "--package-dir FOLDER with the package of their meshes, or --radius METRES"
        yield note(rest, "base-shapes", hubs[0].joint.name, text, "the floor or the file bears it out", fix)
    others = [c for c in wheels if not math.isnan(c.other) and apart(c.other, c.radius)]
    for c in others[:1]:
        text = f"'{c.joint.name}' has a radius of {c.radius:.4g} m by its collision shapes, {c.other:.4g} m by sight"
        yield note(rest, "base-shapes", c.joint.name, text, "taken are the former", f"--radius {c.other:.4g}")


def named_sides(rest: AtRest, base: Base) -> Iterator[Finding]:
    """Wheels that a plugin calls left and that are on the right, or the other way round, and joints that are not there.

    A simulator would drive the robot backwards, or not at all.
    """
    sides = {w.joint: "left" if w.y > 0 else "right" for w in base.wheels}
    told: set[str] = set()
    for element in rest.document.root.iterfind("gazebo//*"):
        hit, name = SIDED.fullmatch(str(element.tag)), (element.text or "").strip()
        if not hit or not name or told & {name, hit[1].lower()}:
            continue
        where, first = f"<{element.tag}> (line {element.sourceline})", base.wheels[0].joint
        if name not in rest.document.joints:
            text = f"{where} names '{name}', which the robot does not have"
            yield note(rest, "base-stated", first, text, "a simulator would not drive it", "name its joint")
            told.add(name)
        elif sides.get(name, hit[1].lower()) != hit[1].lower():
            text = f"{where} names '{name}', which is on the {sides[name]} seen along x of the root link"
            yield note(rest, "base-sides", name, text, "does the robot drive along -x?", "check it")
            told |= {"left", "right"}


def unasked(rest: AtRest, base: Base, overrides: Overrides) -> Iterator[Finding]:
    """What controllers' files beside the robot's state of its track and radius, where none says what its geometry does.

    They are told, not used: a file may be another robot's.
    """
    if not base.wheels or base.pushes or overrides.controllers_file is not None:
        return
    files = beside(rest)
    for name, used, names in (("track", base.track, TRACKS), ("radius", base.wheels[0].radius, RADII)):
        found = [(file, one) for file in files for one in in_yaml(str(file), names)]
        known = getattr(overrides, name) is not None or (name == "radius" and overrides.wheel_radii)
        if not known and found and all(apart(one.value, used) for _, one in found):
            file, one = found[0]
            text = f"{file} states a {name} of {one.value:.4g} m, the geometry has {used:.4g} m"
            fix = f"--controllers {file} where it is this robot's, --{name} {one.value:.6g} to use it"
            yield note(rest, "base-stated", base.wheels[0].joint, text, "taken is the geometry", fix)


def apart(one: float, other: float) -> bool:
    """Whether two lengths differ by more than is told."""
    return abs(one - other) > OPINION * max(abs(one), abs(other))

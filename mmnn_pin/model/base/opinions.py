"""Second opinions on radius, track and sides: of other shapes, joints, plugins, controllers' files.

The geometry is taken, and what contradicts it is told; but a robot's own controllers correct it. Their file was given,
or lies beside the robot's and names all its drive wheels. Multipliers of a length that the geometry bears out are
taken: somebody measured how far the robot rolls. Of a file that was given, the track of a base that scrubs is taken,
too, which no geometry shows. Which side a wheel is on and where forward is, is for `heading`.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Sequence
from pathlib import Path
from shlex import quote
from typing import Any

import numpy as np

from ...elementary import cos, sin
from ...elementary.arrays import hypot
from ..signs import told_apart
from ..urdf.finding import Finding
from ..urdf.shapes import HORIZONTAL, AtRest
from .base import Base, Wheel
from .evidence import (
    RADII,
    SIDES,
    TRACKS,
    Stated,
    beside,
    in_yaml,
    mappings_of,
    multipliers,
    number_of,
    own_files,
    stated,
)
from .overrides import LARGEST, SMALLEST, Overrides
from .report import note
from .steered import SteeredBase
from .wheels import STATED, UNSEEN, Candidate

SIDED = re.compile(r"(left|right)_?(?:wheel_?)?joint", re.IGNORECASE)  # tags of plugins
OPINION = 0.01  # lengths that differ by more than this fraction are told
TAKEN = "taken is the geometry"
LENGTHS = {"track": TRACKS, "radius": RADII, "wheelbase": {"wheelbase": 1.0, "wheel_base": 1.0, "wheelBase": 1.0}}


def second_opinions(rest: AtRest, base: Base, wheels: Sequence[Candidate], overrides: Overrides) -> Iterator[Finding]:
    """Notes where joints, plugins or controllers have other lengths than the geometry; see `lines_of`."""
    if isinstance(base, SteeredBase):
        yield from stated_notes(rest, base, "radius", (), overrides)
        yield from stated_notes(rest, base, "wheelbase", (), overrides)
    if not base.wheels or base.shape:
        return
    drives = [c for c in wheels if c.joint.name in {w.joint for w in base.wheels}]
    crossed = any(abs(sin(w.heading)) > HORIZONTAL for w in base.wheels)
    if overrides.track is None and not crossed:
        yield from track_opinions(rest, base, drives)
        yield from stated_notes(rest, base, "track", (), overrides)
    if overrides.radius is None:
        yield from shape_opinions(rest, drives)
        yield from stated_notes(rest, base, "radius", [c.joint.name for c in drives if c.shape == STATED], overrides)
    yield from joints_of_others(rest, base)


def track_opinions(rest: AtRest, base: Base, drives: Sequence[Candidate]) -> Iterator[Finding]:
    """Joints that are nearer to each other, or further, than where the wheels touch the floor; or that is not seen."""
    first, left = base.wheels[0].joint, np.array([-sin(base.frame[2]), cos(base.frame[2])])
    across = [float(rest.hub(c.joint)[:2] @ left) for c in drives]
    joints, contacts = max(across) - min(across), max(w.y for w in base.wheels) - min(w.y for w in base.wheels)
    if apart(joints, contacts):
        text = f"the wheels touch the floor {contacts:.4g} m apart, their joints are {joints:.4g} m apart"
        yield note(rest, "base-joints", first, text, "the track is that of the contacts", "--track for another")
    seen = np.array([float((c.centre + c.beside * c.axis)[:2] @ left) for c in drives])
    on_left = seen > seen.mean()
    if on_left.any() and apart(by_sight := float(seen[on_left].mean() - seen[~on_left].mean()), base.track):
        text = f"the wheels stand {base.track:.4g} m apart by their collision shapes, {by_sight:.4g} m by sight"
        yield note(rest, "base-shapes", first, text, "taken are the former", f"--track {by_sight:.4g}")
    widths = [2.0 * abs(w.y) for w in base.wheels]
    if base.scrubs and apart(min(widths), max(widths)):
        text = f"wheels of a side stand on several widths, from {min(widths):.4g} m to {max(widths):.4g} m"
        yield note(rest, "base-joints", first, text, "the track is that of their means", "--track for another")
    unseen = [c.joint.name for c in drives if c.shape in UNSEEN]
    if unseen and len(base.wheels) > 1:
        text = f"the track of {contacts:.4g} m is that of the joints: where {', '.join(unseen)} touch cannot be seen"
        fix = "--track for another, or --package-dir where their meshes are"
        yield note(rest, "base-joints", first, text, "no shape of them can be read whole", fix)


def shape_opinions(rest: AtRest, wheels: Sequence[Candidate]) -> Iterator[Finding]:
    """Wheels whose visual shapes have another radius than the collision shapes that are measured, or are missing."""
    if hubs := [c for c in wheels if c.is_partial and c.shape not in UNSEEN]:
        first, names = hubs[0], ", ".join(c.joint.name for c in hubs)
        text = f"the radius {first.radius:.4g} m is that of the collision shapes of {names}: a mesh of them is missing"
        fix = "--package-dir FOLDER with the package of their meshes, or --radius METRES"
        why = f"borne out by {' and '.join(told_apart(first.signs, ())) or 'its collision shape'}"
        yield note(rest, "base-shapes", first.joint.name, text, why, fix)
    if c := next((c for c in wheels if not math.isnan(c.other) and apart(c.other, c.radius)), None):
        text = f"'{c.joint.name}' has a radius of {c.radius:.4g} m by its collision shapes, {c.other:.4g} m by sight"
        yield note(rest, "base-shapes", c.joint.name, text, "taken are the former", f"--radius {c.other:.4g}")


def stated_notes(rest: AtRest, base: Base, name: str, blind: Sequence[str], overrides: Overrides) -> Iterator[Finding]:
    """Lengths that plugins and controllers state: taken for blind wheels, told where they contradict.

    Those of files beside the robot's, which may be another robot's, are told where none is that of the geometry.
    """
    names, files = LENGTHS[name], beside(rest) if overrides.controllers_file is None else ()
    if getattr(overrides, name) is not None or not measured(base, name):
        return
    first = base.joints[0]
    for length in stated(rest, overrides.controllers_file, names):
        used = min(measured(base, name, length.side), key=lambda own: abs(own - length.value))
        if blind:
            text = f"the radius {used:.4g} m of {', '.join(blind)} is what the file states: {length.text}"
            why, fix = "no shape of them can be read whole", "--radius, or --package-dir where their meshes are"
            yield note(rest, "base-stated", first, text, why, fix)
        elif apart(length.value, used):
            text = f"{length.text} states a {name} of {length.value:.4g} m, its geometry {used:.4g} m"
            yield note(rest, "base-stated", first, text, TAKEN, f"--{name} {length.value:.6g}")
    lengths = [(file, one) for file in files for one in in_yaml(str(file), names)]
    known = name == "radius" and overrides.wheel_radii
    if lengths and not known and all(apart(one.value, used) for _, one in lengths for used in measured(base, name)):
        (file, one), used = lengths[0], measured(base, name)[0]
        text = f"{file.name} states a {name} of {one.value:.4g} m, the geometry has {used:.4g} m"
        path = file.relative_to(here) if file.is_relative_to(here := Path.cwd()) else file
        fix = f"--controllers {quote(str(path))} where it is this robot's, --{name} {one.value:.6g} to use it"
        yield note(rest, "base-stated", first, text, TAKEN, fix)


def joints_of_others(rest: AtRest, base: Base) -> Iterator[Finding]:
    """Joints that a plugin would turn as wheels, and which the robot does not have."""
    for element in rest.document.root.iterfind("gazebo//*"):
        name = (element.text or "").strip()
        if SIDED.fullmatch(str(element.tag)) and name and name not in rest.document.joints:
            what = f"<{element.tag}> (line {element.sourceline}) names '{name}', which"
            if all(one in rest.document.joints for one in re.split(r"[,\s]+", name.strip(", "))):
                text, fix = f"{what} a simulator takes as one joint", f"write <{element.tag}> once for each"
            else:
                text, fix = f"{what} the robot does not have", "name its joint"
            yield note(rest, "base-stated", base.wheels[0].joint, text, "a simulator would not drive it", fix)


def measured(base: Base, name: str, side: str = "") -> list[float]:
    """Lengths of a base by its geometry: tracks, radii, maybe of a side, or wheelbases [m]."""
    if name == "radius":
        return [w.radius for w in (of_side(base, side) if side else base.wheels)]
    if name == "track":
        return [base.track]
    return [base.length] if isinstance(base, SteeredBase) and base.masters and not base.sideways else []


def of_side(base: Base, side: str) -> list[Wheel]:
    """Drive wheels on a side, "left" or "right"."""
    return [w for w in base.wheels if (w.y > 0.0) == (side == "left")]


def apart(one: float, other: float) -> bool:
    """Whether two lengths differ by more than is told."""
    return abs(one - other) > OPINION * max(abs(one), abs(other))


# -- what controllers correct ------------------------------------------------------------------------------------------


def calibration(rest: AtRest, base: Base, overrides: Overrides) -> tuple[dict[str, Any], list[Finding]]:
    """Corrections of a base's geometry by the robot's own controllers, where the user does not say it; see `lines_of`.

    Returns:
        `track` and `wheel_radii` as `Overrides` has them; that they are taken, and what contradicts the URDF.
    """
    taken, findings = dict[str, Any](), list[Finding]()
    if base.shape or not base.wheels:
        return taken, findings
    files = own_files(rest, {wheel.joint for wheel in base.wheels}, overrides.controllers_file)
    findings += contradictions(rest, base, files)
    tracks, radii = ([length for file in files for length in in_yaml(file, names)] for names in (TRACKS, RADII))
    track, unseen = agreed(tracks), base.scrubs and overrides.controllers_file is not None
    differs = track and (corrects(track, base.track) or (unseen and apart(track.value, base.track)))
    if track and differs and overrides.track is None:
        taken["track"] = track.value
        findings.append(taken_note(rest, base, "track", track, base.track))
    for side in SIDES if base.two_sided and overrides.radius is None else ():
        wheels = [w for w in of_side(base, side) if w.joint not in overrides.radius_of]
        radius = agreed([length for length in radii if length.side in ("", side)])
        if radius and wheels and all(corrects(radius, w.radius) for w in wheels):
            entries = (f"{w.joint}={radius.value:.9g}" for w in wheels)
            taken["wheel_radii"] = (*taken.get("wheel_radii", overrides.wheel_radii), *entries)
            findings.append(taken_note(rest, base, f"{side} radius", radius, wheels[0].radius))
    return taken, findings


def agreed(lengths: Sequence[Stated]) -> Stated | None:
    """The one length that is stated, best with multipliers; None where none is, several, or one that no robot has."""
    same = len({round(length.value, 6) for length in lengths}) == 1
    length = max(lengths, key=lambda length: length.value != length.nominal, default=None)
    return length if length and same and SMALLEST <= length.value <= LARGEST else None


def corrects(length: Stated, measured: float) -> bool:
    """Whether a length is one that the geometry bears out, times something."""
    return length.value != length.nominal and not apart(length.nominal, measured)


def taken_note(rest: AtRest, base: Base, name: str, length: Stated, measured: float) -> Finding:
    """A note that a length of the controllers is taken in the place of the geometry's."""
    text = f"the {name} is taken as {length.value:.4g} m, as {length.text} has it; the geometry has {measured:.4g} m"
    fix = f"--{name.split()[-1]} {measured:.6g} for that of the geometry"
    return note(rest, "base-stated", base.wheels[0].joint, text, "the robot's driver works with it", fix)


def contradictions(rest: AtRest, base: Base, files: Sequence[str]) -> Iterator[Finding]:
    """Contradictions between the robot's own controllers and its URDF: arms of wheels, signs."""
    x, y = (np.array([getattr(wheel, at) for wheel in base.wheels]) for at in ("x", "y"))
    sums = {"sum_of_robot_center_projection_on_X_Y_axis": abs(x) + abs(y), "robot_radius": hypot(x, y)}
    for path in files:
        file = Path(path).name
        for table in mappings_of(path).values():
            for key in sums.keys() & table.keys() if base.sideways else ():
                used, value = float(sums[key].mean()), number_of(table, key, 0.0)
                if apart(value, used):
                    text = f"{key} ({file}, line {table[key].line}) is {value:.4g} m, here {used:.4g} m"
                    yield note(rest, "base-stated", base.wheels[0].joint, text, TAKEN, "check it")
            for side in SIDES if base.two_sided else ():
                key = next((k for k in (f"{side}_wheel_names", f"{side}_wheel") if k in table), "")  # latter: ROS 1
                sign = math.copysign(1.0, math.prod(multipliers(table, "wheel_radius", side).values()))
                for wheel in of_side(base, side) if key else ():
                    if wheel.joint in table[key].items and sign != wheel.sign:
                        text = f"{key} ({file}, line {table[key].line}) rolls '{wheel.joint}' backward: "
                        text += "its axis is that of a wheel that rolls at -rate"
                        own = f"{side}_wheel_radius_multiplier: {wheel.sign:.1f}"
                        fix = f"write {own}, as mmnn ros2 --controllers does, or turn its <axis>"
                        yield note(
                            rest, "base-stated", wheel.joint, text, "the robot would turn or drive otherwise", fix
                        )

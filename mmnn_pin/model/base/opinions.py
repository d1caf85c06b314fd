"""Second opinions on radius, track and sides: of other shapes, joints, plugins, controllers' files.

The geometry is taken, and what contradicts it is told; but a robot's own controllers correct it. Their file was given,
or lies beside the robot's and names all its drive wheels. Multipliers of a length that the geometry bears out are
taken: somebody measured how far the robot rolls. Of a file that was given, the track of a base that scrubs is taken,
too, which no geometry shows.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from ...elementary import cos, cos_sin, sin
from ...elementary.arrays import hypot
from ..signs import told_apart
from ..urdf.finding import Finding
from ..urdf.shapes import HORIZONTAL, AtRest
from .base import Base, Wheel
from .evidence import (
    RADII,
    SIDES,
    STEERED,
    TRACKS,
    Stated,
    YamlTable,
    beside,
    in_yaml,
    lines_of,
    multipliers,
    number_of,
    stated,
    tables_of,
    words_of,
)
from .heading import axis_name
from .overrides import LARGEST, SMALLEST, Overrides
from .report import note
from .wheels import STATED, UNSEEN, Candidate

SIDED = re.compile(r"(left|right)_?(?:wheel_?)?joint", re.IGNORECASE)  # tags of plugins
OPINION = 0.01  # lengths that differ by more than this fraction are told


def second_opinions(rest: AtRest, base: Base, wheels: Sequence[Candidate], overrides: Overrides) -> Iterator[Finding]:
    """Notes where joints, plugins or controllers have another track or radius than the geometry.

    Args:
        rest: The robot at rest.
        base: Its base.
        wheels: Its drive wheels, and maybe others.
        overrides: What the user says; that is not questioned.

    Raises:
        ConfigError: The controllers' file cannot be read.
    """
    if not base.wheels or base.shape or any(abs(sin(w.heading)) > HORIZONTAL for w in base.wheels):
        return
    drives = [c for c in wheels if c.joint.name in {w.joint for w in base.wheels}]
    if overrides.track is None:
        yield from track_opinions(rest, base, drives)
    if overrides.radius is None:
        yield from shape_opinions(rest, drives)
    yield from named_sides(rest, base)
    if overrides.track is None:
        for length in stated(rest, overrides.controllers_file, TRACKS):
            yield from contradiction(rest, base, "track", length, base.track)
    if overrides.radius is None:
        yield from radius_opinions(rest, base, drives, overrides)


def track_opinions(rest: AtRest, base: Base, drives: Sequence[Candidate]) -> Iterator[Finding]:
    """Joints that are nearer to each other, or further, than where the wheels touch the floor; or that is not seen."""
    first, left = base.wheels[0].joint, np.array([-sin(base.frame[2]), cos(base.frame[2])])
    across = [float(rest.hub(c.joint)[:2] @ left) for c in drives]
    joints, contacts = max(across) - min(across), max(w.y for w in base.wheels) - min(w.y for w in base.wheels)
    if apart(joints, contacts):
        text = f"the wheels touch the floor {contacts:.4g} m apart, their joints are {joints:.4g} m apart"
        yield note(rest, "base-joints", first, text, "the track is that of the contacts", "--track for another")
    unseen = [c.joint.name for c in drives if c.shape in UNSEEN]
    if unseen and len(base.wheels) > 1:
        text = f"the track of {contacts:.4g} m is that of the joints: where {', '.join(unseen)} touch cannot be seen"
        fix = "--track for another, or --package-dir where their meshes are"
        yield note(rest, "base-joints", first, text, "no shape of them can be read whole", fix)


def radius_opinions(rest: AtRest, base: Base, drives: Sequence[Candidate], overrides: Overrides) -> Iterator[Finding]:
    """Radii that plugins and controllers state: where no shape can be read they are taken, else they may contradict."""
    radius = float(np.median([w.radius for w in base.wheels]))
    blind = [c.joint.name for c in drives if c.shape == STATED]
    for length in stated(rest, overrides.controllers_file, RADII):
        if blind:
            text = f"the radius {radius:.4g} m of {', '.join(blind)} is what the file states: {length.text}"
            why, fix = "no shape of them can be read whole", "--radius, or --package-dir where their meshes are"
            yield note(rest, "base-stated", base.wheels[0].joint, text, why, fix)
        else:
            yield from contradiction(rest, base, "radius", length, radius)


def contradiction(rest: AtRest, base: Base, name: str, length: Stated, used: float) -> Iterator[Finding]:
    """A note where a stated length is another than the geometry's."""
    if apart(length.value, used if not length.side else side_radius(base, length.side)):
        text = f"{length.text} states a {name} of {length.value:.4g} m, its geometry {used:.4g} m"
        fix = f"--{name} {length.value:.6g}"
        yield note(rest, "base-stated", base.wheels[0].joint, text, "taken is the geometry", fix)


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
        why = f"borne out by {' and '.join(told_apart(hubs[0].signs, ())) or 'its collision shape'}"
        yield note(rest, "base-shapes", hubs[0].joint.name, text, why, fix)
    others = [c for c in wheels if not math.isnan(c.other) and apart(c.other, c.radius)]
    for c in others[:1]:
        text = f"'{c.joint.name}' has a radius of {c.radius:.4g} m by its collision shapes, {c.other:.4g} m by sight"
        yield note(rest, "base-shapes", c.joint.name, text, "taken are the former", f"--radius {c.other:.4g}")


def named_sides(rest: AtRest, base: Base) -> Iterator[Finding]:
    """Wheels that a plugin calls left and that are on the right, or the other way round, and joints that are not there.

    A simulator would drive the robot backwards, or not at all.
    """
    sides = {w.joint: "left" if w.y > 0 else "right" for w in base.wheels}
    known: set[str] = set()
    for element in rest.document.root.iterfind("gazebo//*"):
        hit, name = SIDED.fullmatch(str(element.tag)), (element.text or "").strip()
        if not hit or not name or known & {name, hit[1].lower()}:
            continue
        where, first = f"<{element.tag}> (line {element.sourceline})", base.wheels[0].joint
        if name not in rest.document.joints:
            text = f"{where} names '{name}', which the robot does not have"
            yield note(rest, "base-stated", first, text, "a simulator would not drive it", "name its joint")
            known.add(name)
        elif sides.get(name, hit[1].lower()) != hit[1].lower():
            text = f"{where} names '{name}', which is on the {sides[name]}"
            yield note(rest, "base-sides", name, text, *backward(base))
            known |= {"left", "right"}


def unasked(rest: AtRest, base: Base, overrides: Overrides) -> Iterator[Finding]:
    """Tracks and radii of controllers' files beside the robot's, where none is that of the geometry.

    They are told, not used: a file may be another robot's.
    """
    if not base.wheels or base.shape or base.pushes or overrides.controllers_file is not None:
        return
    files = beside(rest)
    for name, used, names in (("track", base.track, TRACKS), ("radius", base.wheels[0].radius, RADII)):
        lengths = [(file, one) for file in files for one in in_yaml(str(file), names)]
        known = getattr(overrides, name) is not None or (name == "radius" and overrides.wheel_radii)
        if not known and lengths and all(apart(one.value, used) for _, one in lengths):
            file, one = lengths[0]
            text = f"{file} states a {name} of {one.value:.4g} m, the geometry has {used:.4g} m"
            fix = f"--controllers {file} where it is this robot's, --{name} {one.value:.6g} to use it"
            yield note(rest, "base-stated", base.wheels[0].joint, text, "taken is the geometry", fix)


def backward(base: Base) -> tuple[str, str]:
    """The question whether a base drives the other way, and the option that says so."""
    ahead = np.array(cos_sin(base.frame[2]))
    return f"forward is taken as {axis_name(ahead)}", f"--forward {axis_name(-ahead)} if it drives that way"


def apart(one: float, other: float) -> bool:
    """Whether two lengths differ by more than is told."""
    return abs(one - other) > OPINION * max(abs(one), abs(other))


# -- what controllers correct ------------------------------------------------------------------------------------------


class Calibration(NamedTuple):
    """Corrections of a base by the robot's own controllers.

    Attributes:
        taken: `track` and `wheel_radii` as `Overrides` has them, as far as they are taken.
        findings: That they are, and what contradicts the URDF.
    """

    taken: dict[str, Any]
    findings: tuple[Finding, ...]


def calibration(rest: AtRest, base: Base, overrides: Overrides) -> Calibration:
    """Corrections of a base's geometry by the robot's own controllers.

    Args:
        rest: The robot at rest.
        base: Its base by its geometry.
        overrides: What the user says; that is not corrected.

    Raises:
        ConfigError: The controllers' file cannot be read.
    """
    files = own_files(rest, base, overrides)
    findings = [*contradictions(rest, base, files)]
    taken = dict[str, Any]()
    if overrides.track is None and (track := stated_track(base, files, overrides.controllers_file is not None)):
        taken["track"] = track.value
        findings.append(taken_note(rest, base, "track", track, base.track))
    radii = [length for file in files for length in in_yaml(file, RADII)]
    for side in SIDES if base.two_sided and overrides.radius is None else ():
        wheels = [w for w in base.wheels if on_side(w, side) and w.joint not in overrides.radius_of]
        radius = agreed([length for length in radii if length.side in ("", side)])
        if radius and wheels and all(corrects(radius, w.radius) for w in wheels):
            entries = (f"{w.joint}={radius.value:.9g}" for w in wheels)
            taken["wheel_radii"] = (*taken.get("wheel_radii", overrides.wheel_radii), *entries)
            findings.append(taken_note(rest, base, f"{side} radius", radius, wheels[0].radius))
    return Calibration(taken, tuple(findings))


def stated_track(base: Base, files: Sequence[str], given: bool) -> Stated | None:
    """The track that controllers' files correct, or that one which was given states of a base that scrubs."""
    track = agreed([length for file in files for length in in_yaml(file, TRACKS)])
    if track is None:
        return None
    unseen = base.scrubs and given and apart(track.value, base.track)
    return track if unseen or corrects(track, base.track) else None


def own_files(rest: AtRest, base: Base, overrides: Overrides) -> list[str]:
    """The controllers' file that was given, else those beside the robot's that name all its drive wheels."""
    if base.shape or not base.wheels or overrides.controllers_file is not None:
        return [overrides.controllers_file] if base.wheels and not base.shape and overrides.controllers_file else []
    joints = {wheel.joint for wheel in base.wheels}
    return [str(file) for file in beside(rest) if joints <= words_of(str(file))]


def agreed(lengths: list[Stated]) -> Stated | None:
    """The one length that is stated, best with multipliers; None where none is, several, or one that no robot has."""
    same = len({round(length.value, 6) for length in lengths}) == 1
    length = max(lengths, key=lambda length: length.value != length.nominal, default=None)
    return length if length and same and SMALLEST <= length.value <= LARGEST else None


def corrects(length: Stated, measured: float) -> bool:
    """Whether a length is one that the geometry bears out, times something."""
    return length.value != length.nominal and not apart(length.nominal, measured)


def on_side(wheel: Wheel, side: str) -> bool:
    """Whether a wheel is on that side."""
    return (wheel.y > 0.0) == (side == "left")


def taken_note(rest: AtRest, base: Base, name: str, length: Stated, measured: float) -> Finding:
    """A note that a length of the controllers is taken in the place of the geometry's."""
    text = f"the {name} is taken as {length.value:.4g} m, as {length.text} has it; the geometry has {measured:.4g} m"
    fix = f"--{name.split()[-1]} {measured:.6g} for that of the geometry"
    return note(rest, "base-stated", base.wheels[0].joint, text, "the robot's driver works with it", fix)


def contradictions(rest: AtRest, base: Base, files: list[str]) -> Iterator[Finding]:
    """Contradictions between the robot's own controllers and its URDF: sides, signs, steering."""
    x, y = (np.array([getattr(wheel, at) for wheel in base.wheels]) for at in ("x", "y"))
    sums = {"sum_of_robot_center_projection_on_X_Y_axis": abs(x) + abs(y), "robot_radius": hypot(x, y)}
    for file in files:
        steered = [(n, hit[0]) for n, line in lines_of(file) if (hit := STEERED.search(line))]
        for line, name in steered[:1]:
            text = f"{Path(file).name} names '{name}' (line {line}), which steers its wheels; this base does not"
            yield note(rest, "base-stated", base.wheels[0].joint, text, "nothing of it is used", "check which it is")
        for table in tables_of(file):
            for key in sums.keys() & table.keys() if base.sideways else ():
                used, value = float(sums[key].mean()), number_of(table, key, 0.0)
                if apart(value, used):
                    text = f"{key} ({Path(file).name}, line {table[key].line}) is {value:.4g} m, here {used:.4g} m"
                    yield note(rest, "base-stated", base.wheels[0].joint, text, "taken is the geometry", "check it")
            if base.two_sided:
                yield from turned(rest, base, table, Path(file).name)


def turned(rest: AtRest, base: Base, table: YamlTable, file: str) -> Iterator[Finding]:
    """Wheels that a differential drive's controller takes for the other side's, or rolls backward."""
    for side in SIDES:
        key = next((k for k in (f"{side}_wheel_names", f"{side}_wheel") if k in table), "")  # the latter in ROS 1
        names = table[key].items if key else ()
        sign = math.copysign(1.0, math.prod(multipliers(table, "wheel_radius", side).values()))
        for wheel in (w for w in base.wheels if w.joint in names):
            where = f"{key} ({file}, line {table[key].line})"
            if not on_side(wheel, side):
                text = f"{where} names '{wheel.joint}', which is on the other side"
                yield note(rest, "base-sides", wheel.joint, text, *backward(base))
            elif sign != wheel.sign:
                text = f"{where} rolls '{wheel.joint}' backward: its axis is that of a wheel that rolls at -rate"
                own = f"{side}_wheel_radius_multiplier: {wheel.sign:.1f}"
                fix = f"write {own}, as mmnn ros2 --controllers does, or turn its <axis>"
                yield note(rest, "base-stated", wheel.joint, text, "the robot would turn or drive otherwise", fix)

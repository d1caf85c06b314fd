"""What the robot's own controllers correct of its geometry, and where they contradict its URDF.

Their file was given, or lies beside the robot's and names all its drive wheels. Multipliers of a length that the
geometry bears out are taken: somebody measured how far the robot rolls. Of a file that was given, the track of a
skid-steer base is taken, too, which no geometry shows. Any other length is an opinion, told and not taken.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from ...elementary.arrays import hypot
from ..urdf.finding import Finding
from ..urdf.shapes import AtRest
from .base import Base, Wheel
from .controllers import (
    RADII,
    SIDES,
    STEERED,
    TRACKS,
    Stated,
    Table,
    beside,
    in_yaml,
    lines_of,
    multipliers,
    number_of,
    tables_of,
)
from .opinions import apart
from .overrides import LARGEST, SMALLEST, Overrides
from .report import note


class Calibration(NamedTuple):
    """What the robot's own controllers say of its base.

    Attributes:
        taken: `track` and `wheel_radii` as `Overrides` has them, as far as they are taken.
        findings: That they are, and what contradicts the URDF.
    """

    taken: dict[str, Any]
    findings: tuple[Finding, ...]


def calibration(rest: AtRest, base: Base, overrides: Overrides) -> Calibration:
    """What the robot's own controllers correct of its geometry.

    Args:
        rest: The robot at rest.
        base: Its base by its geometry.
        overrides: What the user says; that is not corrected.

    Raises:
        ConfigError: The controllers' file cannot be read.
    """
    given, files = overrides.controllers_file is not None, own_files(rest, base, overrides)
    taken, findings = dict[str, Any](), [*contradictions(rest, base, files)]
    one = agreed([one for file in files for one in in_yaml(file, TRACKS)])
    unseen = one and base.scrubs and given and apart(one.value, base.track)
    if one and overrides.track is None and (unseen or corrects(one, base.track)):
        taken["track"] = one.value
        findings.append(taken_note(rest, base, "track", one, base.track))
    radii = [one for file in files for one in in_yaml(file, RADII)]
    for side in SIDES if base.two_sided and overrides.radius is None else ():
        wheels = [w for w in base.wheels if on_side(w, side) and w.joint not in overrides.radius_of]
        one = agreed([one for one in radii if one.side in ("", side)])
        if one and wheels and all(corrects(one, w.radius) for w in wheels):
            taken["wheel_radii"] = (*taken.get("wheel_radii", ()), *(f"{w.joint}={one.value:.9g}" for w in wheels))
            findings.append(taken_note(rest, base, f"{side} radius", one, wheels[0].radius))
    if "wheel_radii" in taken:
        taken["wheel_radii"] = (*overrides.wheel_radii, *taken["wheel_radii"])
    return Calibration(taken, tuple(findings))


def own_files(rest: AtRest, base: Base, overrides: Overrides) -> list[str]:
    """The controllers' file that was given, else those beside the robot's that name all its drive wheels."""
    if not base.wheels or overrides.controllers_file is not None:
        return [overrides.controllers_file] if base.wheels and overrides.controllers_file else []
    joints = {wheel.joint for wheel in base.wheels}
    return [str(file) for file in beside(rest) if joints <= words_of(str(file))]


def words_of(file: str) -> set[str]:
    """All values in a controllers' file, the items of lists each."""
    return {word for table in tables_of(file) for entry in table.values() for word in entry.items}


def agreed(found: list[Stated]) -> Stated | None:
    """The one length that is stated, best with multipliers; None where none is, several, or one that no robot has."""
    same = len({round(one.value, 6) for one in found}) == 1
    one = max(found, key=lambda one: one.value != one.nominal, default=None)
    return one if one and same and SMALLEST <= one.value <= LARGEST else None


def corrects(one: Stated, measured: float) -> bool:
    """Whether a length is one that the geometry bears out, times something."""
    return one.value != one.nominal and not apart(one.nominal, measured)


def on_side(wheel: Wheel, side: str) -> bool:
    """Whether a wheel is on that side."""
    return (wheel.y > 0.0) == (side == "left")


def taken_note(rest: AtRest, base: Base, name: str, one: Stated, measured: float) -> Finding:
    """That a length of the controllers is taken in the place of the geometry's."""
    text = f"the {name} is taken as {one.value:.4g} m, as {one.text} has it; the geometry has {measured:.4g} m"
    fix = f"--{name.split()[-1]} {measured:.6g} for that of the geometry"
    return note(rest, "base-stated", base.wheels[0].joint, text, "the robot's driver works with it", fix)


def contradictions(rest: AtRest, base: Base, files: list[str]) -> Iterator[Finding]:
    """Where the robot's own controllers drive its wheels otherwise than the URDF has them: sides, signs, steering."""
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


def turned(rest: AtRest, base: Base, table: Table, file: str) -> Iterator[Finding]:
    """Wheels that a differential drive's controller takes for the other side's, or rolls backward."""
    for side in SIDES:
        key = next((k for k in (f"{side}_wheel_names", f"{side}_wheel") if k in table), "")  # the latter in ROS 1
        names = table[key].items if key else ()
        sign = math.copysign(1.0, math.prod(multipliers(table, "wheel_radius", side).values()))
        for wheel in (w for w in base.wheels if w.joint in names):
            where = f"{key} ({file}, line {table[key].line})"
            if not on_side(wheel, side):
                text = f"{where} names '{wheel.joint}', which is on the other side seen along the rolling direction"
                yield note(rest, "base-sides", wheel.joint, text, "does the robot drive along -x?", "check it")
            elif sign != wheel.sign:
                text = f"{where} rolls '{wheel.joint}' backward: its axis is that of a wheel that rolls at -rate"
                own = f"{side}_wheel_radius_multiplier: {wheel.sign:.1f}"
                fix = f"write {own}, as mmnn ros2 --controllers does, or turn its <axis>"
                yield note(rest, "base-stated", wheel.joint, text, "the robot would turn or drive otherwise", fix)

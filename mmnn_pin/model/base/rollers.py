"""Holonomic bases: mecanum wheels, omni wheels, and bases that forces on their frame drive."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from ..urdf.parsing import Finding
from ..urdf.shapes import AtRest
from .base import Base, Reading, Understood
from .overrides import Overrides
from .placing import frame_of, in_order
from .refusals import undecided
from .remarks import remark
from .wheels import Candidate, Seen

ROLLERS = "--roller RADIANS says how they lie, --wheels which of the wheels drive"
MECANUM = math.pi / 4  # roller angle that is assumed where nothing states one


def mecanum(
    rest: AtRest, drives: list[Candidate], wheels: list[Candidate], said: Overrides, stated: dict[str, float]
) -> tuple[Base, list[Finding]]:
    """Base on mecanum wheels; on the floor their rollers lie as the file states it, else across the diagonals.

    Args:
        rest: The robot at rest.
        drives: Its drive wheels.
        wheels: All its wheels.
        said: What the user says.
        stated: Roller angle by wheel, where the file states one [rad].
    """
    base = frame_of(rest, drives, wheels, "holonomic", said)
    size, known = (MECANUM, stated) if said.roller is None else (said.roller, {})
    rolled = tuple(replace(w, roller=known.get(w.joint, -math.copysign(1.0, w.x * w.y) * size)) for w in base.wheels)
    base = checked(rest, replace(base, wheels=rolled), drives)
    if said.roller is not None or all(wheel.joint in stated for wheel in base.wheels):
        return base, []
    text = (
        f"rollers at {math.degrees(MECANUM):.0f} degrees assumed, on the floor across the diagonals (from above an X)"
    )
    why, fix = (
        "nothing in the file states their angle",
        "--roller RADIANS, negative for wheels mounted the other way round",
    )
    return base, [remark(rest, "base-roller", drives[0].joint.line, "base", text, why, fix)]


def crossed(rest: AtRest, drives: list[Candidate], wheels: list[Candidate], said: Overrides) -> Understood:
    """Wheels whose axles are not parallel: to roll together they must slide along them (omni wheels)."""
    base = frame_of(rest, drives, wheels, "holonomic", said)
    roller = said.roller if said.roller is not None else 0.0
    base = checked(rest, replace(base, wheels=tuple(replace(w, roller=roller) for w in base.wheels)), drives)
    if said.roller is not None:
        return Understood(base)
    text = "omni wheels assumed: their rollers turn about the rolling direction (0 degrees)"
    why = "plain wheels whose axles cross could not roll together"
    note = remark(rest, "base-omni", drives[0].joint.line, "base", text, why, "--roller RADIANS for another angle")
    return Understood(base, (note,))


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


def pushed(rest: AtRest, seen: Seen) -> Understood:
    """A holonomic base whose wheels are not modelled: forces on its frame drive it."""
    names = tuple(
        j.name for c in [*seen.wheels, *seen.odd, *seen.limited] for j in rest.document.moving_ancestors(c.joint.child)
    )
    floor = seen.floor if math.isfinite(seen.floor) else 0.0
    text = "the base has no drive wheels: forces and a torque on the root link drive it, without limits"
    note = remark(rest, "base-pushed", 1, "base", text, "you said --base holonomic")
    return Understood(Base("holonomic", floor=floor, casters=in_order(rest, names)), (note,))

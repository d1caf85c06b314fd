"""Why a robot is not taken: what its base could be, or what machine it is."""

from __future__ import annotations

import math
from collections.abc import Sequence

from ..urdf.shapes import HORIZONTAL, VERTICAL, AtRest
from .base import Reading, Undecided, Unsupported
from .evidence import evidence
from .wheels import LUMPY, Candidate, Seen, coaxial

GO_ON = "name the drive wheels with --wheels LEFT,RIGHT, or say what it is with --base"


def readings(rest: AtRest, drives: list[Candidate]) -> list[Reading]:
    """What a base on these wheels could be, with the reasons for and against."""
    told = evidence(rest, drives)
    speaks = {
        kind: tuple(dict.fromkeys(p.text for p in told if p.meaning == kind)) for kind in ("holonomic", "skid-steer")
    }
    many = len(drives) >= 4
    pairs = sum(coaxial(a, b) for i, a in enumerate(drives) for b in drives[:i])
    two = Reading(
        "differential_drive",
        (f"{pairs} pair(s) of coaxial wheels",) if pairs else (),
        (f"{len(drives)} wheel(s) that do not swivel",) if len(drives) != 2 else ("they are not on one axle",),
    )
    if not many:
        return [two]
    rolls = Reading("holonomic", ("four or more parallel wheels", *speaks["holonomic"]), speaks["skid-steer"])
    skids = Reading("skid-steer", ("four or more parallel wheels", *speaks["skid-steer"]), speaks["holonomic"])
    return [rolls, skids, two]


def not_on_floor(rest: AtRest, seen: Seen) -> Undecided:
    """The error for what would be drive wheels but for one thing."""
    odd, fix = seen.odd, GO_ON + "; --base fixed parks them"
    if any(abs(c.axis[2]) > VERTICAL for c in odd):
        why = "their axle is vertical"
        fix = "turn the robot so that z points up (a file with y up?); --base fixed parks them"
    elif any(abs(c.axis[2]) > HORIZONTAL for c in odd):
        why = "wheels roll about a horizontal axis here, not with camber"
    elif any(c.shape == LUMPY for c in odd):
        why = "what turns on them is not round about the axle"
    elif any(math.isnan(c.radius) for c in odd):
        why = "no shape of them can be read, and nothing tells where the floor is"
        fix = "give --radius (and --package-dir, where their meshes are); --base fixed parks them"
    else:
        why = f"they end {min(c.bottom for c in odd) - seen.floor:.3g} m above the robot's lowest point"
    return undecided(rest, odd, [Reading("differential_drive", ("coaxial wheels",), (why,))], why, fix)


def undecided(
    rest: AtRest,
    wheels: list[Candidate],
    told: list[Reading],
    why: str,
    fix: str = GO_ON,
    line: int | None = None,
    names: str = "",
) -> Undecided:
    """The error that lists what could be a wheel, and what the base could be."""
    texts = tuple(c.text for c in wheels)
    none = f"no wheel turns: {names}" if names else "no wheels found"
    listed = f"{len(wheels)} wheel(s) found: {'; '.join(texts)}" if wheels else none
    error = Undecided(
        f"the base is undecided: {listed}; it could be {' or '.join(map(str, told))}",
        why=why,
        fix=fix,
        file=rest.document.path,
        line=line or (wheels[0].joint.line if wheels else None),
    )
    error.candidates, error.readings = texts, tuple(told)
    return error


def unsupported(rest: AtRest, name: str, why: str, wheels: Sequence[Candidate] = ()) -> Unsupported:
    """The refusal of a machine by its name."""
    line: int | None = wheels[0].joint.line if wheels else rest.document.root.sourceline
    error = Unsupported(
        f"this is a {name}",
        why=why,
        fix="this package drives differential and holonomic bases and fixed arms; --base fixed takes it as an arm",
        file=rest.document.path,
        line=line,
    )
    error.machine = name
    return error

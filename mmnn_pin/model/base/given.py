"""Drive wheels that are chosen, by the user or by the geometry: can they be wheels, and what base do they make?"""

from __future__ import annotations

import math
from dataclasses import replace

from mmnn_pin.errors import ConfigError, UnknownName

from ..urdf.shapes import AtRest
from .base import Base, Understood
from .evidence import evidence, stated_rollers
from .overrides import Overrides
from .placing import frame_of
from .remarks import remark
from .rollers import crossed, mecanum
from .wheels import HUB, Candidate, Seen, coaxial, parallel, wheel_of


def given_wheel(rest: AtRest, name: str, seen: Seen, said: Overrides) -> Candidate:
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
    found = next((c for c in seen.wheels if c.joint.name == name), None)
    candidate = found or wheel_of(rest, joint)
    radius = said.radius or candidate.radius
    if math.isnan(radius):
        radius, candidate = float(candidate.centre[2] - seen.footing), replace(candidate, shape=HUB)
    if not radius > 0:
        why = "no shape of it can be read, and nothing tells where the floor is"
        raise ConfigError(f"the radius of wheel '{name}' is unknown", why=why, fix="give --radius", key="radius")
    return replace(candidate, radius=radius)


def require_used(said: Overrides, base: Base) -> None:
    """Refuse what is said of wheels that the base does not have.

    Raises:
        ConfigError: It would be ignored.
    """
    unused = {"radius": not base.wheels, "track": len(base.wheels) < 2, "roller": base.kind != "holonomic"}
    unused["roller"] |= not base.wheels
    for key, ignored in unused.items():
        if ignored and getattr(said, key) is not None:
            what = f"a {key} for a base '{base.kind}'" + ("" if base.wheels else " without drive wheels")
            raise ConfigError(what, why="nothing would use it", fix="leave it out, or say what the base is", key=key)


def with_wheels(rest: AtRest, drives: list[Candidate], wheels: list[Candidate], said: Overrides) -> Understood:
    """The base on chosen wheels.

    Raises:
        ConfigError: Wheels that do not suit the base.
    """
    if said.base == "holonomic" or (said.base is None and len(drives) > 2):
        if len(drives) < 3:
            raise ConfigError(f"{len(drives)} wheel(s) for a holonomic base", fix="name at least three", key="wheels")
        if not all(parallel(drives[0], c) for c in drives[1:]):
            return crossed(rest, drives, wheels, said)
        base, findings = mecanum(rest, drives, wheels, said, stated_rollers(evidence(rest, drives)))
        return Understood(base, tuple(findings))
    if len(drives) != 2 or not coaxial(*drives):
        what = "not two wheels on one axle" if len(drives) == 2 else f"{len(drives)} wheel(s) for a differential drive"
        raise ConfigError(what, fix="name the left and the right one", key="wheels", file=rest.document.path)
    base = frame_of(rest, drives, wheels, "differential_drive", said)
    left = base.wheels[0].joint
    if said.wheels and left != said.wheels[0]:
        text = f"'{left}' is the left wheel, not '{said.wheels[0]}'"
        note = remark(rest, "base-sides", drives[0].joint.line, "base", text, "seen along the rolling direction")
        return Understood(base, (note,))
    return Understood(base)

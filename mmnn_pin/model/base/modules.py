"""Pivots that wheels hang on, found in a file, and what each may be, with the signs for it and against.

A wheel's *pivot* is the nearest joint above it about a vertical axis. Its lever on the floor, from the axis to the
middle of its wheels, has two parts: along the rolling direction, the *trail*, and across it, which no steering feels.
Each pivot with its wheels is a *module*, and has one of five roles:

    steered   a motor turns it, mostly within stops, mostly above its wheels
    powered   the floor turns it, for its wheel trails, and motors are on it (HSR's turret, powered casters)
    hitch     a body of its own: wheels on both sides, far from the axis, beside wheels that drive
    waist     likewise, and a motor turns it: a loader
    caster    it trails, and has no motor: it stands still here, as casters do

Modules that look alike have one role. What the user says counts more.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import product as combined
from typing import NamedTuple

import numpy as np

from ...elementary.matrices import product
from ...errors import ConfigError, UnknownName, few
from ...signals import Array
from ..signs import Sign
from ..urdf.document import Joint
from ..urdf.shapes import AtRest
from .evidence import DRIVING, motors_named, types_in, words_in
from .overrides import Overrides
from .report import in_words, unsupported
from .steered import STEERED_KINDS
from .wheels import STEER_NAMES, TOUCHING, TRAIL, Candidate, Candidates, coaxial, parallel, pivots_above, rolling

TURNED = 0.12  # trail by radius from which the floor turns a wheel (Robile's 10 mm of 51)
ALIKE = 0.05  # radii that differ by less than this fraction are of wheels of one kind
ON_LINE = 0.02  # wheels of one axle may be off their line by this fraction of its width
STEERED = tuple(kind.kind for kind in STEERED_KINDS)
ROLES = ("steered", "caster", "powered", "waist", "hitch")
WEIGHTS = {  # of what is seen of a module, for each role, as of `model.signs`; names alone do not decide
    "turn all round": (-1.0, 1.0, -1.0, 0.0, 0.0),
    "have stops": (4.5, -4.5, -4.5, 0.0, 0.0),
    "trail as casters do": (-3.5, 3.0, 3.0, 0.0, 0.0),
    "trail a little": (0.0, 1.5, -4.0, 0.0, 0.0),
    "no trail: casters could not follow": (1.0, -1.0, 0.0, 0.0, 0.0),
    "wheels as large as those that do not turn aside": (0.0, -1.6, 0.0, 0.0, 0.0),  # of casters few are
    "make an axle of their own": (3.0, 0.0, 0.0, 0.0, 0.0),
    "have motors": (3.0, -3.0, 3.0, 4.0, -4.0),
    "no motors, as others have": (-3.0, 1.0, 0.0, -3.0, 3.0),
    "no motors beside what steers": (0.0, 0.0, 0.0, 0.0, 3.0),
    "drive by their wheels": (0.0, -2.0, 3.0, 0.0, 0.0),
    "no motors on their wheels": (0.0, 0.0, -3.0, 0.0, 0.0),
    "the file names no motors": (0.0, 0.0, 2.0, 0.0, 0.0),
    "called steering": (1.5, 0.0, 0.0, 1.5, 0.0),
    "called casters": (0.0, 1.5, 0.0, 0.0, 0.0),
    "called casters, with one wheel right below": (-5.5, 1.5, 0.0, 0.0, 0.0),  # as some draw mecanum wheels
    "called hitches": (0.0, 0.0, 0.0, 0.0, 1.5),
    "called waists": (0.0, 0.0, 0.0, 1.5, 0.0),
}
NAMES = {
    "called steering": re.compile(r"steer|ackermann|knuckle|lenk|direction|volante", re.IGNORECASE),
    "called casters": re.compile(r"caster|castor|roulette|lenkrolle|rueda_?loca", re.IGNORECASE),
    "called hitches": re.compile(r"hitch|trailer|tow|king_?pin|anhaenger|remorque|remolque", re.IGNORECASE),
    "called waists": re.compile(r"waist|articulat", re.IGNORECASE),
}
MOST = 200  # combinations of roles that are looked at


@dataclass(frozen=True, eq=False)
class Module:
    """A pivot and the wheels on it."""

    joint: Joint  # the pivot
    # on it, and on no other pivot that it carries; without joints of their own where they cannot spin
    wheels: list[Candidate]
    carrier: Joint | None = None  # the next pivot above, None for the body
    role: str = ""  # one of the five of this module's heading; empty while it is not known
    spins: bool = True  # whether its wheels have joints to spin about

    def lever(self, rest: AtRest) -> Array:
        """(2,) from the axis to the middle of its wheels: along the rolling direction and across it [m]."""
        ahead = rolling(self.wheels[0])
        at = np.mean([c.centre for c in self.wheels], axis=0)[:2] - rest.hub(self.joint)[:2]
        return np.array([product(ahead, at), product([-ahead[1], ahead[0]], at)])

    def trails(self, rest: AtRest) -> bool:
        """Whether the floor turns it."""
        return bool(abs(self.lever(rest)[0]) > TURNED * self.wheels[0].radius)

    @property
    def swivels(self) -> bool:
        """Whether it turns all the way round, as a caster does."""
        return all(c.mount == "swivel" for c in self.wheels)

    def is_body(self, rest: AtRest) -> bool:
        """Whether it is a body of its own: wheels more than a radius apart, and more than one from its axis."""
        ahead, radius = rolling(self.wheels[0]), self.wheels[0].radius
        sides = [product([-ahead[1], ahead[0]], c.centre[:2]) for c in self.wheels]
        alike = all(parallel(self.wheels[0], c) for c in self.wheels)
        return bool(alike and np.ptp(sides) > radius and abs(self.lever(rest)[0]) > radius)


class Undercarriage(NamedTuple):
    """The modules of a base and its fixed wheels."""

    modules: list[Module]  # a carrier before what it carries
    fixed: list[Candidate]  # wheels on the body
    motors: dict[str, str]  # joints that the file drives, with where it says so
    signs: tuple[Sign, ...] = ()  # what speaks for these roles of the modules, and against them

    def of(self, *roles: str) -> list[Module]:
        """The modules of some roles."""
        return [m for m in self.modules if m.role in roles]

    @property
    def told(self) -> bool:
        """Whether the file tells motors of some of its joints: then those that it leaves out have none."""
        wheels = [*self.fixed, *(c for m in self.modules for c in m.wheels)]
        return bool(self.motors.keys() & {*(m.joint.name for m in self.modules), *(c.joint.name for c in wheels)})

    @property
    def steers(self) -> bool:
        """Whether something of it steers, or trails under motors."""
        return bool(self.of("steered", "powered", "waist"))

    @property
    def stands(self) -> bool:
        """Whether these roles suit each other."""
        steered, waists, powered = self.of("steered"), self.of("waist"), self.of("powered")
        if waists and (len(waists) > 1 or steered or not self.fixed):
            return False
        return not (powered and (self.fixed or steered)) and bool(self.fixed or steered or powered)

    def in_line(self, rest: AtRest) -> bool:
        """Whether it is held by steered wheels on one line alone, though others may steer, as they do not trail."""
        wheels, others = [c for m in self.of("steered") for c in m.wheels], self.of("caster")
        alone = bool(wheels) and not self.fixed and on_line(wheels)
        return alone and any(not m.trails(rest) for m in others)


def says_steered(overrides: Overrides) -> bool:
    """Whether the user says that the base steers or pulls."""
    return bool(overrides.base in STEERED or overrides.steer or overrides.hitch)


def undercarriages(rest: AtRest, candidates: Candidates, overrides: Overrides) -> list[Undercarriage]:
    """All ways to give the pivots roles, each with its signs.

    Raises:
        UnknownName: A joint that the user names and the robot does not have.
        ConfigError: It is no pivot with wheels.
        Unsupported: A joint steers by its name, about a level axis, or hangs on one that turns without end about one.
    """
    wheels = [c for c in candidates.wheels if c.mount != "leg" and not math.isnan(c.radius)]
    fixed, groups = list[Candidate](), dict[str, list[Candidate]]()
    for c in wheels:
        pivot = next(iter(pivots_above(rest, c.joint)), None)
        if pivot is None:
            fixed.append(c)
        else:
            groups.setdefault(pivot.name, []).append(c)
    refuse_level(rest, [c for c in fixed if c.mount == "steering" or (groups and leaning(rest, c))])
    pivots = {name: rest.document.joints[name] for name in groups}
    carriers = {name: next(iter(pivots_above(rest, pivot)), None) for name, pivot in pivots.items()}
    modules = [Module(pivots[name], cs, carriers[name]) for name, cs in groups.items()]
    modules += without_spin(rest, candidates, modules, overrides) if fixed else []
    modules.sort(key=lambda m: len(rest.document.moving_ancestors(m.joint.child)))
    require_pivots(rest, modules, overrides)
    motors = motors_named(rest, overrides.controllers_file)
    found = list(with_roles(rest, Undercarriage(modules, fixed, motors), overrides))
    return [under for under in found if not under.in_line(rest)] or found


def with_roles(rest: AtRest, under: Undercarriage, overrides: Overrides) -> Iterator[Undercarriage]:
    """Ways to give the modules of an undercarriage roles that suit each other, each with its signs."""
    alike = dict[tuple[object, ...], list[Module]]()
    for m in under.modules:
        alike.setdefault(likeness(rest, m, under, overrides), []).append(m)
    chances = [roles_for(rest, some[0], under, overrides) for some in alike.values()]
    for k, roles in enumerate(combined(*chances)):
        role_of = {m.joint.name: role for some, role in zip(alike.values(), roles, strict=True) for m in some}
        found = under._replace(modules=[replace(m, role=role_of[m.joint.name]) for m in under.modules])
        if found.stands and k < MOST:
            signs = [
                s for some, role in zip(alike.values(), roles, strict=True) for s in signs_of(rest, some, role, found)
            ]
            yield found._replace(signs=(*signs, *signs_of_words(rest, found, overrides)))


def likeness(rest: AtRest, m: Module, under: Undercarriage, overrides: Overrides) -> tuple[object, ...]:
    """Properties that modules share which have one role."""
    name, said = m.joint.name, (*(overrides.steer or ()), *(overrides.hitch or ()))
    driven = name in under.motors, any(c.joint.name in under.motors for c in m.wheels)
    carrier = m.carrier.name if m.carrier is not None else ""
    return m.is_body(rest), m.swivels, m.trails(rest), m.spins, *driven, carrier, name if name in said else ""


def roles_for(rest: AtRest, m: Module, under: Undercarriage, overrides: Overrides) -> list[str]:
    """The roles that a module may have: what the user says, else what its structure lets it be."""
    name, others = m.joint.name, [o for o in under.modules if o is not m]
    body = m.is_body(rest) and (under.fixed or any(not o.trails(rest) for o in others)) and m.joint.mimics is None
    if name in (overrides.steer or ()):
        return ["waist" if m.is_body(rest) and under.fixed and not m.carrier else "steered"]
    if name in (overrides.hitch or ()):
        return ["hitch"]
    if body:
        return ["waist", "hitch"] if not m.carrier else ["hitch"]
    free = ["caster", "powered"] if abs(m.lever(rest)[0]) > TRAIL else ["caster"]  # a wheel under it could not turn it
    return [*free, "steered"]


# -- signs -------------------------------------------------------------------------------------------------------------


def signs_of(rest: AtRest, some: Sequence[Module], role: str, under: Undercarriage) -> Iterator[Sign]:
    """Signs that some modules that look alike have a role, and against it."""
    names, place = few([f"'{m.joint.name}'" for m in some], 2), ROLES.index(role)
    for what, detail in dict.fromkeys(seen_of(rest, some, under)):
        if weight := WEIGHTS[what][place]:
            yield Sign(f"{what}{detail}: {names}", weight, some[0].joint.line, some[0].joint.name)


def seen_of(rest: AtRest, some: Sequence[Module], under: Undercarriage) -> Iterator[tuple[str, str]]:
    """Keys of `WEIGHTS` that are seen of some modules that look alike, and what more there is to say."""
    first, wheels = some[0], [c for m in some for c in m.wheels]
    trails = first.trails(rest)
    yield "turn all round" if first.swivels else "have stops", ""
    little = abs(first.lever(rest)[0]) > TRAIL
    none = "trail a little" if little else "no trail: casters could not follow"
    yield "trail as casters do" if trails else none, ""
    if not trails and under.fixed and front_axle(wheels, under.fixed):
        yield "make an axle of their own", ""
    large = max((c.radius for c in under.fixed), default=math.inf)
    if all(abs(c.radius - large) < ALIKE * large for c in wheels):
        yield "wheels as large as those that do not turn aside", ""
    powered = [m.joint.name for m in some if m.joint.name in under.motors]
    rolls = [c.joint.name for c in wheels if c.joint.name in under.motors]
    if powered:
        yield "have motors", f", by {under.motors[powered[0]]}"
    elif under.told and not any(m.joint.mimics for m in some):
        yield "no motors, as others have", ""
    elif under.of("steered") and not under.told:
        yield "no motors beside what steers", ""
    if rolls:
        yield "drive by their wheels", f", by {under.motors[rolls[0]]}"
    elif under.told:
        yield "no motors on their wheels", ""
    else:
        yield "the file names no motors", ""
    for named, pattern in NAMES.items():
        if any(pattern.search(f"{m.joint.name} {m.joint.child}") for m in some):
            below = named == "called casters" and not little and len(first.wheels) == 1
            yield f"{named}, with one wheel right below" if below else named, ""


def signs_of_words(rest: AtRest, under: Undercarriage, overrides: Overrides) -> Iterator[Sign]:
    """Signs of plugins and controllers that say whether the base steers, or two wheels drive it."""
    words = words_in(rest, DRIVING, ("gazebo",), ("plugin", "controller"))
    for kind, text, _ in (*words, *types_in(overrides.controllers_file, DRIVING)):
        steers = bool(under.of("steered") and under.fixed)
        if kind == "car-like" and (steers or not under.modules):
            yield Sign(f"the file speaks of steering: {text}", 3.5 if steers else -3.5)
        if kind == "differential_drive" and not steers and under.fixed and under.modules:
            yield Sign(text, 3.5)


def front_axle(front: Sequence[Candidate], fixed: Sequence[Candidate]) -> bool:
    """Whether two wheels that could be steered make an axle of their own, parallel to that of the others."""
    if len(front) != 2 or not coaxial(*front):
        return False
    return parallel(front[0], fixed[0]) and not coaxial(front[0], fixed[0])


# -- pivots ------------------------------------------------------------------------------------------------------------


def leaning(rest: AtRest, c: Candidate) -> bool:
    """Whether a joint carries a wheel from above it, as pivots do, about a level axis."""
    above = [j for j in rest.document.moving_ancestors(c.joint.child)[1:2] if rest.is_horizontal(j)]
    return any(math.dist(rest.hub(j)[:2], c.centre[:2]) < c.radius / 2 and rest.hub(j)[2] > c.centre[2] for j in above)


def refuse_level(rest: AtRest, steered: Sequence[Candidate]) -> None:
    """Refuse joints that steer by their names, or as others do, about level axes: their axes are written wrong.

    Raises:
        Unsupported: There are some; with the axes that would be right.
    """
    joints = dict[str, Joint]()
    for c in steered:
        above = rest.document.moving_ancestors(c.joint.child)[1:]
        joints |= {
            j.name: j for j in above if not rest.is_vertical(j) and (STEER_NAMES.search(j.name) or leaning(rest, c))
        }
    axes = dict[str, list[str]]()
    for joint in joints.values():
        up = in_words(product(rest.placements[joint.child][:3, :3].T, np.array([0.0, 0.0, 1.0])))
        axes.setdefault(up, []).append(f"'{joint.name}'")
    if axes:
        fix = "; ".join(f'write <axis xyz="{up}"/> in {", ".join(names)}' for up, names in axes.items())
        named = ", ".join(f"'{name}'" for name in joints)
        why = f"{named} steer by their names, or as others do, and turn about level axes"
        raise unsupported(rest, "car-like base", why, steered, fix)


def without_spin(rest: AtRest, candidates: Candidates, known: Sequence[Module], overrides: Overrides) -> list[Module]:
    """Pivots whose wheels have no joint to spin about: a cylinder is on the floor, and a stop or a motor steers it."""
    said, motors, found = overrides.steer or (), motors_named(rest), dict[str, Module]()
    taken, floor = {m.joint.name for m in known}, min(c.bottom for c in candidates.wheels)
    for joint in rest.document.joints.values():
        steers = joint.name in {*said, *motors} or (joint.type == "revolute" and not joint.turns_freely)
        alone = rest.is_vertical(joint) and not rest.document.moving_children(joint.child)
        shapes = [s for link in rest.document.body(joint.child) for s in rest.primitives[link]]
        lying = [s for s in shapes if s.kind == "cylinder" and s.rolls]
        on_floor = [s for s in lying if abs(s.lowest - floor) <= TOUCHING * s.radius]
        if steers and alone and on_floor and joint.name not in taken and joint.type != "prismatic":
            s = on_floor[0]
            refuse_rolled(rest, joint)
            wheel = Candidate(joint, s.pose[:3, 2], s.pose[:3, 3], s.radius, "cylinder", "steering", 0.0)
            found[joint.name] = Module(joint, [wheel], spins=False)
    virtual = {m.joint.mimics: m for m in found.values() if m.joint.mimics in rest.document.joints}
    for name, m in virtual.items():  # what they follow without having a wheel: the virtual one of a bicycle model
        if name not in found and name not in taken:
            joint = rest.document.joints[str(name)]
            at = np.array([*rest.hub(joint)[:2], m.wheels[0].centre[2]])
            found[str(name)] = Module(joint, [replace(m.wheels[0], joint=joint, centre=at)], spins=False)
    return [m for m in found.values() if m.joint.mimics not in found]


def refuse_rolled(rest: AtRest, pivot: Joint) -> None:
    """Refuse a pivot with its wheel on a joint that turns without end about a level axis (`Unsupported`)."""
    for spin in rest.document.moving_ancestors(pivot.child)[1:]:
        if spin.turns_freely and rest.is_horizontal(spin):
            why = f"pivot '{pivot.name}' hangs on '{spin.name}', which turns without end about a level axis"
            fix = f"let the body carry '{pivot.name}', and that '{spin.name}' with the wheel"
            raise unsupported(rest, "car-like base", why, (), fix)


def require_pivots(rest: AtRest, modules: Sequence[Module], overrides: Overrides) -> None:
    """Refuse joints that the user names as steered or as hitches and that are none; errors as of `undercarriage_of`."""
    known = [m.joint.name for m in modules]
    for key in ("steer", "hitch"):
        for name in getattr(overrides, key) or ():
            if name not in rest.document.joints:
                raise UnknownName("joint", name, known or rest.document.joints, file=rest.document.path, key=key)
            if name not in known:
                why = "no wheel on the floor is under it" if rest.is_vertical(rest.document.joints[name]) else ""
                fix = f"name one of {', '.join(known)}" if known else "name a joint about a vertical axis under a wheel"
                what = f"joint '{name}' cannot be a pivot"
                raise ConfigError(
                    what, why=why or "its axis is not vertical", fix=fix, key=key, file=rest.document.path
                )


def on_line(wheels: Sequence[Candidate]) -> bool:
    """Whether wheels turn about one line."""
    ahead = rolling(wheels[0])
    off = [abs(product(ahead, (c.centre - wheels[0].centre)[:2])) for c in wheels]
    width = max(float(np.linalg.norm((c.centre - wheels[0].centre)[:2])) for c in wheels)
    return all(parallel(wheels[0], c) for c in wheels) and bool(max(off) <= max(ON_LINE * width, 1e-6))

"""Bases that steer, built from modules in their roles: pivots and wheels in the control frame, trailers, limits.

Wheels on the body, on one line, are its fixed axle. With it a base is (1,1) and one module is its master; without it
all that steer are masters (1,2), or all trail and the body is free (3,0).
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import replace

import numpy as np

from ...elementary import atan2, cos_sin, hypot
from ...elementary.matrices import product
from ...errors import UnknownName
from ...signals import Array
from ..urdf.document import Joint
from ..urdf.finding import Finding
from ..urdf.shapes import AtRest, rotation
from .base import Base, Wheel
from .heading import heading, left_first
from .modules import Module, Undercarriage, on_line
from .overrides import Overrides
from .placing import casters_of, frame_at, in_frame, in_order
from .report import STILL, BaseResult, note, unsupported
from .rolling import FOLLOWER, MASTER, PASSIVE, ROLES, Pivot, closed, new_maps, roll
from .steered import (
    Articulated,
    CarLike,
    CarWithTrailer,
    Casters,
    DriveWithTrailer,
    SteeredBase,
    Swerve,
    Tricycle,
)
from .wheels import HUB, Candidate, Candidates, coaxial, rolling

SIDEWAYS = 5e-4  # speed across a wheel per speed of the base that is told
SAMPLES = 6  # of angles at which it is looked for
MIDDLE = 0.1  # a wheel that steers within this fraction of the wheelbase of the fixed axle steers nothing
ONE_BODY = "write one vehicle in a file, or --base holonomic drives it by forces on its frame"


# -- what it makes -----------------------------------------------------------------------------------------------------


def steered_kind(under: Undercarriage) -> str:
    """The kind of base that modules in their roles make, with what it pulls."""
    steered, pulls = under.of("steered"), under.of("hitch")
    if under.of("waist"):
        kind: type[SteeredBase] = Articulated
    elif under.fixed and steered:
        kind = Tricycle if len(steered) == 1 and steered[0].spins else CarLike
    else:
        kind = Swerve if steered else Casters if under.of("powered") else DriveWithTrailer
    return kind.kind if not pulls or kind is DriveWithTrailer else CarWithTrailer.kind


def steered_base(rest: AtRest, candidates: Candidates, overrides: Overrides, under: Undercarriage) -> BaseResult:
    """The base that modules in their roles make where some steer, or trail under motors.

    Raises:
        Unsupported: Machines of several bodies, wheels on several lines, one wheel alone.
        ConfigError: What the user says does not suit it.
    """
    refuse_linked(rest, under)
    require_alike(rest, under)
    if under.fixed:
        under = under._replace(fixed=axle_of(rest, under, overrides))
        base = on_axle(rest, under, overrides)
    elif under.of("steered"):
        base = without_axle(rest, under, overrides)
    else:
        base = on_casters(rest, under, overrides)
    return finished(rest, candidates, base, under, overrides)


def refuse_linked(rest: AtRest, under: Undercarriage) -> None:
    """Refuse machines of several bodies that steer or drive each by itself (`Unsupported`)."""
    linked = [m for m in under.of("steered", "powered", "waist") if m.carrier is not None]
    if linked:
        pivots = ", ".join(f"'{m.joint.name}' on '{m.carrier.name}'" for m in linked if m.carrier)
        why = f"the base is more than one body: {pivots}"
        raise unsupported(rest, "machine of several vehicles, linked", why, linked[0].wheels, ONE_BODY)


def require_alike(rest: AtRest, under: Undercarriage) -> None:
    """Refuse what trails under stops beside others that steer: only a single wheel that steers may trail.

    Raises:
        Unsupported: A slip in the file, or a machine of its own.
    """
    steered = under.of("steered")
    odd = [m for m in steered if m.trails(rest)]
    if len(steered) > 1 and odd:
        names, trail = ", ".join(f"'{m.joint.name}'" for m in odd), abs(odd[0].lever(rest)[0])
        why = f"the wheel under {names} stands {trail:.3g} m behind its axis"
        why += ", and others steer" if len(odd) < len(steered) else ""
        two = left_first(rest, under.fixed) if len(under.fixed) == 2 and coaxial(*under.fixed) else []
        pair = ",".join(c.joint.name for c in two)
        casters = f"--wheels {pair} if they are casters; " if pair else ""
        fix = f"{casters}mend the <origin> of the wheel or of its pivot; {STILL}"
        raise unsupported(rest, "base that steers with wheels off their pivots", why, odd[0].wheels, fix)


def axle_of(rest: AtRest, under: Undercarriage, overrides: Overrides) -> list[Candidate]:
    """The fixed wheels that hold the base: on one line, those that are not balls, or those that the user names.

    Raises:
        Unsupported: They stand on several lines; with the options that choose one.
    """
    seen = [c for c in under.fixed if c.shape != HUB]  # others may be joints of a bicycle model, without a body
    fixed = seen or under.fixed
    named = [c for c in fixed if c.joint.name in (overrides.wheels or ())]
    proper = [c for c in fixed if c.shape != "sphere"]
    for wheels in (named, fixed, proper):
        if wheels and on_line(wheels):
            return wheels
    why = f"wheels that do not steer stand on several lines: {'; '.join(c.text for c in fixed)}"
    lines = {tuple(o.joint.name for o in fixed if o is c or coaxial(c, o)) for c in fixed}
    kind = Tricycle.kind if len(under.of("steered")) == 1 else CarLike.kind
    rolling_too = [c.joint.name for m in under.of("steered") if m.spins for c in m.wheels]
    ways = [f"--base {kind} --wheels {','.join([*n, *rolling_too])}" for n in sorted(lines) if len(n) > 1]
    fix = f"{', or '.join(ways)} if the others slide or swivel; {STILL}" if ways else STILL
    raise unsupported(rest, "base that steers and skids", why, fixed, fix)


def on_axle(rest: AtRest, under: Undercarriage, overrides: Overrides) -> SteeredBase:
    """A car, a tricycle or a loader, without what it pulls.

    Args:
        rest: The robot at rest.
        under: Its fixed wheels are those of the axle.
        overrides: What the user says.

    Raises:
        Unsupported: A wheel that steers stands on the line of those that do not.
        ConfigError: The user says that it is another kind.
    """
    fixed, steered = under.fixed, under.of("steered", "waist")
    ahead, behind = ([rest.hub(m.joint)[:2] for m in under.of(role)] for role in ("steered", "hitch"))
    forward = heading(rest, fixed, overrides, ahead, behind).forward
    frame = frame_at(np.mean([c.centre for c in fixed], axis=0), forward)
    steered = sorted(steered, key=lambda m: order(frame, rest, m))
    master = first_master(steered, under.motors)
    loader = master.role == "waist"
    kind = Articulated if loader else Tricycle if len(steered) == 1 and master.spins else CarLike
    if overrides.base in (CarLike.kind, Tricycle.kind) and not loader:
        kind = Tricycle if overrides.base == Tricycle.kind else CarLike
    pivots = [placed_pivot(rest, frame, m, ROLES[MASTER if m is master else FOLLOWER], under) for m in steered]
    wheelbase = abs(ahead_of(pivots[steered.index(master)]))
    near = next((p for p in pivots if abs(ahead_of(p)) < MIDDLE * wheelbase or wheelbase == 0), None)
    if near is not None:
        why = f"the wheel under '{near.joint}' stands on the line of those that do not steer"
        raise unsupported(rest, "base that cannot steer", why, fixed, STILL)
    if overrides.wheelbase is not None:
        pivots = [replace(p, x=p.x * overrides.wheelbase / wheelbase) for p in pivots]
        wheelbase = overrides.wheelbase
    return kind(pivots=tuple(pivots), frame=frame, length=wheelbase)


def ahead_of(pivot: Pivot) -> float:
    """Place of the wheel on a pivot of the body along the base, the pivot at 0 [m]."""
    return pivot.x + pivot.wheel[0]


def order(frame: Array, rest: AtRest, m: Module) -> tuple[float, float]:
    """Front before rear, left before right."""
    x, y = in_frame(frame, rest.hub(m.joint))
    return -round(x, 3), -y


def first_master(steered: Sequence[Module], motors: Iterable[str]) -> Module:
    """The one that others follow: the master of their <mimic>, the only one with a motor, else the first."""
    followed = [m for m in steered if m.joint.name in {o.joint.mimics for o in steered}]
    powered = [m for m in steered if m.joint.name in set(motors)]
    return next(iter(followed if len(followed) == 1 else powered if len(powered) == 1 else steered))


def without_axle(rest: AtRest, under: Undercarriage, overrides: Overrides) -> SteeredBase:
    """A swerve drive: all that steer are masters.

    Raises:
        Unsupported: One steered wheel and nothing that holds the base beside it, or all on one line.
    """
    steered = under.of("steered")
    if len(steered) < 2:
        why = f"one wheel steers and nothing else holds it: {steered[0].wheels[0].text}"
        raise unsupported(rest, "base on one wheel", why, steered[0].wheels, STILL)
    wheels = [c for m in steered for c in m.wheels]
    if on_line(wheels):
        what = "swerve drive whose wheels stand on one line, about any point of which it could turn"
        why = f"there nothing tells how it moves: {'; '.join(c.text for c in wheels)}"
        raise unsupported(rest, what, why, wheels, STILL)
    forward = heading(rest, wheels, overrides, any_way=True).forward
    frame = frame_at(np.mean([rest.hub(m.joint) for m in steered], axis=0), forward)
    pivots = [placed_pivot(rest, frame, m, ROLES[MASTER], under) for m in steered]
    size = math.sqrt(float(np.mean([p.x**2 + p.y**2 for p in pivots])))
    return Swerve(pivots=tuple(pivots), frame=frame, length=size)


def on_casters(rest: AtRest, under: Undercarriage, overrides: Overrides) -> SteeredBase:
    """A base on powered casters, or on a turret.

    Raises:
        Unsupported: One caster with one wheel.
    """
    powered = under.of("powered")
    if len(powered) == 1 and len(powered[0].wheels) < 2:
        why = f"one caster and nothing else: {powered[0].wheels[0].text}"
        raise unsupported(rest, "base on one wheel", why, powered[0].wheels, STILL)
    forward = heading(rest, [c for m in powered for c in m.wheels], overrides, any_way=True).forward
    frame = frame_at(np.mean([rest.hub(m.joint) for m in powered], axis=0), forward)
    pivots = [placed_pivot(rest, frame, m, ROLES[PASSIVE], under) for m in powered]
    silent = not any({m.joint.name, *(c.joint.name for c in m.wheels)} & under.motors.keys() for m in powered)
    if silent:  # a pair of wheels turns its swivel by itself, unless it is the only one
        pivots = [
            replace(p, motor=len(powered) == 1 or len(m.wheels) < 2) for p, m in zip(pivots, powered, strict=True)
        ]
    return Casters(pivots=tuple(pivots), frame=frame, length=1.0)


# -- places ------------------------------------------------------------------------------------------------------------


def frame_on(rest: AtRest, joint: Joint, heading: float) -> Array:
    """(3,) frame of what a pivot carries, at its axis: that of its carrier turned by where the pivot rests."""
    sign = math.copysign(1.0, rest.axis(joint)[2])
    return np.array([*rest.hub(joint)[:2], heading + sign * joint.rest])


def placed(frame: Array, c: Candidate) -> tuple[float, float, float, float]:
    """Place of a wheel in a planar frame, its heading within a quarter turn, and the sign of its joint."""
    direction = rolling(c)
    heading = math.remainder(atan2(float(direction[1]), float(direction[0])) - float(frame[2]), math.tau)
    back = abs(heading) > math.pi / 2 + 1e-9
    heading = math.remainder(heading - math.pi, math.tau) if back else heading
    return *in_frame(frame, c.centre), heading, -1.0 if back else 1.0


def placed_pivot(rest: AtRest, frame: Array, m: Module, role: str, under: Undercarriage) -> Pivot:
    """A module's pivot in the frame of its carrier, with the middle of its wheels on it."""
    joint, own = m.joint, frame_on(rest, m.joint, float(frame[2]))
    x, y = in_frame(frame, rest.hub(joint))
    wheels = [placed(own, c) for c in m.wheels]
    wheel = float(np.mean([w[0] for w in wheels])), float(np.mean([w[1] for w in wheels])), wheels[0][2]
    steers = role == ROLES[MASTER] or (joint.name in under.motors and joint.mimics is None and m.role != "hitch")
    return Pivot(
        joint=joint.name,
        role=role,
        x=x,
        y=y,
        sign=math.copysign(1.0, rest.axis(joint)[2]),
        lower=joint.lower if joint.type == "revolute" else -math.inf,
        upper=joint.upper if joint.type == "revolute" else math.inf,
        rate=joint.rate,
        motor=steers,
        wheel=wheel,
    )


def placed_wheels(frame: Array, wheels: Sequence[Candidate], pivot: int, **more: bool) -> list[Wheel]:
    """Wheels with joints in the frame of what carries them, left before right."""
    at = [(placed(frame, c), c) for c in wheels]
    at.sort(key=lambda pair: (-round(pair[0][0], 6), -pair[0][1]))
    return [Wheel(c.joint.name, c.radius, sign, y, x, h, pivot=pivot, **more) for (x, y, h, sign), c in at]


# -- trailers, motors, limits ------------------------------------------------------------------------------------------


def finished(
    rest: AtRest, candidates: Candidates, base: SteeredBase, under: Undercarriage, overrides: Overrides
) -> BaseResult:
    """The base with its wheels, what it pulls, what stands still, and what there is to say of it."""
    base, findings = with_limits(rest, base, under, overrides)
    modules = {m.joint.name: m for m in under.modules}
    own = [modules[p.joint] for p in base.pivots]
    own_wheels = [c for m in own if m.spins for c in m.wheels]
    stated_radii = overrides.radius_of
    rolls = [*under.fixed, *own_wheels]
    resized = {c.joint.name: stated_radii.get(c.joint.name, overrides.radius or c.radius) for c in rolls}
    wheels = placed_wheels(base.frame, under.fixed, -1)
    if overrides.track is not None and (width := np.ptp([w.y for w in wheels])) > 0:
        wheels = [replace(w, y=w.y * overrides.track / float(width)) for w in wheels]
    for k, m in enumerate(own):
        wheels += placed_wheels(frame_on(rest, m.joint, float(base.frame[2])), m.wheels, k) if m.spins else []
    wheels = [replace(w, radius=resized[w.joint]) for w in wheels]
    wheels, driving = with_motors(rest, wheels, under, overrides)
    track = float(np.ptp([w.y for w in wheels if w.pivot < 0])) if len(under.fixed) > 1 else 0.0
    bottoms = [c.bottom for c in [*under.fixed, *(c for m in own for c in m.wheels)]]
    base = replace(base, wheels=tuple(wheels), track=track, floor=float(np.mean(bottoms)))
    base, trailing = with_trailers(rest, base, under)
    base = standing(rest, base, candidates)
    notes = [
        steered_note(rest, base),
        *findings,
        *driving,
        *trailing,
        *spinless_note(rest, own),
        *linkage_note(rest, base, own),
    ]
    return BaseResult(base, (*notes, *scrub_note(rest, base, under)))


def with_trailers(rest: AtRest, base: Base, under: Undercarriage) -> tuple[SteeredBase, list[Finding]]:
    """The base with the trailers behind it; a differential drive's body moves by `(v, w)`.

    Raises:
        Unsupported: A trailer on something else than the body or a trailer.
    """
    hitches, findings = under.of("hitch"), list[Finding]()
    pivots = list(base.pivots) if isinstance(base, SteeredBase) else []
    wheels, frames, numbers = list(base.rolling if not pivots else base.wheels), dict[str, Array](), dict[str, int]()
    for m in hitches:
        carrier = m.carrier.name if m.carrier is not None else ""
        if carrier and carrier not in frames:
            why = f"trailer '{m.joint.name}' hangs on '{carrier}', which is no trailer"
            raise unsupported(rest, "machine of several vehicles, linked", why, m.wheels, ONE_BODY)
        at = frames.get(carrier, base.frame)
        numbers[m.joint.name] = len(pivots)
        frames[m.joint.name] = frame_on(rest, m.joint, float(at[2]))
        pivot = placed_pivot(rest, at, m, ROLES[PASSIVE], under)
        pivots.append(replace(pivot, parent=numbers.get(carrier, -1), motor=False))
        alone = on_line(m.wheels)
        wheels += placed_wheels(frames[m.joint.name], m.wheels, len(pivots) - 1, driven=False, grips=alone)
        if not alone:
            text = f"the trailer on '{m.joint.name}' has several axles, which scrub about their middle"
            why = f"it is taken as on one, {abs(pivot.wheel[0]):.3g} m from the hitch"
            findings.append(note(rest, "base-scrub", m.joint.name, text, why))
    if not hitches:
        return base, findings  # type: ignore[return-value]
    more = {key: getattr(base, key) for key in ("track", "frame", "floor", "casters", "suspensions", "parked")}
    kind = CarWithTrailer if isinstance(base, SteeredBase) else DriveWithTrailer
    length = base.length if isinstance(base, SteeredBase) else 1.0
    made = kind(wheels=tuple(wheels), pivots=tuple(pivots), length=length, turning=base.turning, **more)
    return made, findings


def behind_drive(rest: AtRest, result: BaseResult, under: Undercarriage) -> BaseResult:
    """A differential or skid-steer drive with the trailers behind it."""
    base, findings = with_trailers(rest, result.base, under)
    return BaseResult(base, (*result.findings, steered_note(rest, base), *findings, *scrub_note(rest, base, under)))


def with_motors(
    rest: AtRest, wheels: list[Wheel], under: Undercarriage, overrides: Overrides
) -> tuple[list[Wheel], list[Finding]]:
    """The wheels, those with motors marked: which the file and the user name, the file, the user, else all.

    Raises:
        UnknownName: The user names another joint.
    """
    names = [w.joint for w in wheels]
    for name in overrides.wheels or ():
        if name not in names:
            raise UnknownName("wheel joint", name, names, key="wheels")
    ours, theirs = [n for n in names if n in (overrides.wheels or ())], [n for n in names if n in under.motors]
    told = [name for name in ours if name in theirs] or theirs or ours
    driven = [replace(w, driven=not told or w.joint in told) for w in wheels]
    if told or not wheels:
        return driven, []
    text = f"nothing says which wheels drive: all are taken as driven ({', '.join(names)})"
    fix = f"name those that drive: --base KIND --wheels {','.join(names[:2])}"
    return driven, [note(rest, "base-driven", names[0], text, "no motor of them is in the file", fix)]


def with_limits(
    rest: AtRest, base: SteeredBase, under: Undercarriage, overrides: Overrides
) -> tuple[SteeredBase, list[Finding]]:
    """The base with the stops of what steers, and what there is to say where the file states none.

    Raises:
        Unsupported: Their limits are one value.
    """
    limit = overrides.steering_limit
    steers = [p for p in base.pivots if p.role != ROLES[PASSIVE]]
    if limit is not None:
        held = {p.joint: replace(p, lower=-limit, upper=limit) for p in steers}
        return replace(base, pivots=tuple(held.get(p.joint, p) for p in base.pivots)), []
    rigid = [p for p in steers if p.lower == p.upper]
    if rigid:
        names = ", ".join(f"'{p.joint}'" for p in rigid)
        wheels = [c for m in under.modules for c in m.wheels if m.joint.name == rigid[0].joint]
        why = f"the limits of {names} are one value: nothing turns there"
        fix = "--steering-limit RAD, or write lower and upper in its <limit>"
        raise unsupported(rest, "base that steers, and cannot", why, wheels, fix)
    endless = [p.joint for p in steers if p.lower == -math.inf and isinstance(base, CarLike | Tricycle | Articulated)]
    if not endless:
        return base, []
    text = f"nothing limits how far {', '.join(endless)} {'steer' if len(endless) > 1 else 'steers'}"
    return base, [note(rest, "base-limit", endless[0], text, "a robot has stops there", "--steering-limit RAD")]


def standing(rest: AtRest, base: SteeredBase, candidates: Candidates) -> SteeredBase:
    """The base with what stands still of it: casters, what holds its wheels, rollers."""
    used = [c for c in candidates.wheels if c.joint.name in {w.joint for w in base.wheels}]
    moving = {*base.shape, *(w.joint for w in base.wheels)}
    joints = rest.document.joints
    above = {j.name for name in moving for j in rest.document.moving_ancestors(joints[name].child)}
    followers = {j.name for j in joints.values() if j.mimics in moving}
    others = casters_of(rest, used, candidates.wheels) - moving - above - followers
    return replace(
        base,
        casters=in_order(rest, others),
        suspensions=in_order(rest, above - moving),
        parked=in_order(rest, [name for c in candidates.wheels for name in c.rollers]),
    )


# -- what there is to say ----------------------------------------------------------------------------------------------


def steered_note(rest: AtRest, base: SteeredBase) -> Finding:
    """A note on what steers and what drives."""
    roles = {role: [p.joint for p in base.pivots if p.role == role] for role in ROLES}
    parts = [f"{role} {', '.join(names)}" for role, names in roles.items() if names]
    size = f"wheelbase {base.length:.4g} m" if not base.sideways and base.masters else ""
    drives = f"driven {', '.join(w.joint for w in base.wheels if w.driven)}"
    text = f"taken as {base.kind}: {'; '.join(filter(None, (*parts, drives, size)))}"
    return note(rest, "base-steered", base.pivots[0].joint, text)


def spinless_note(rest: AtRest, own: Sequence[Module]) -> list[Finding]:
    """A note on steered wheels that have no joint to spin about."""
    names = [m.joint.name for m in own if not m.spins]
    if not names:
        return []
    text = f"the wheels on {', '.join(names)} have no joint to spin about: they slide along, and only steer"
    fix = "give them continuous joints if they are to be seen turning"
    return [note(rest, "base-steered", names[0], text, "the file welds them on", fix)]


def linkage_note(rest: AtRest, base: SteeredBase, own: Sequence[Module]) -> list[Finding]:
    """A warning of rods between what steers by itself: joints of a simulator's own, which close loops."""
    by_link = {link: m.joint.name for m in own for link in rest.document.body(m.joint.child)}
    held = {end.text.strip() for end in rest.document.root.iterfind("gazebo/joint/*") if end.text}
    linked = sorted({by_link[link] for link in held & by_link.keys()} & {base.pivots[k].joint for k in base.masters})
    if len(linked) < 2:
        return []
    text = f"joints in <gazebo> hold {', '.join(linked)}: here each steers by itself"
    return [note(rest, "base-linkage", linked[0], text, "a linkage closes loops, which URDF does not have")]


def scrub_of(rest: AtRest, base: SteeredBase, under: Undercarriage) -> float:
    """Largest speed across a wheel per speed of the base, over some angles within the stops.

    A follower is steered as if its pivot were upright beside its wheel; here pivots and axles are as the file has them.
    """
    if base.sideways:
        return 0.0
    joints = list(base.joints)
    places = {name: 3 + k for k, name in enumerate(joints)}
    rolls, rng, worst = base.rolling_at(places), np.random.default_rng(0), 0.0
    nu = np.array([1.0] + [0.0] * (len(base.velocity_names) - 1))
    wheels = {c.joint.name: c for c in (*under.fixed, *(c for m in under.modules for c in m.wheels))}
    passive = {k for k, p in enumerate(base.pivots) if p.role == ROLES[PASSIVE]}  # they turn while the steering stands
    held = [w for w in base.wheels if w.grips and w.joint in wheels and w.pivot not in passive]
    for _ in range(SAMPLES):
        position = np.zeros(3 + len(joints))
        for p in base.pivots:
            position[places[p.joint]] = rng.uniform(max(p.lower, -0.5), min(p.upper, 0.5))
        maps = new_maps(rolls, np.zeros((3 + len(joints), nu.size)))
        roll(rolls, closed(rolls, position), nu, maps)
        for w in held:
            pivot = rest.document.joints[base.pivots[w.pivot].joint] if w.pivot >= 0 else None
            angle = position[places[pivot.name]] if pivot is not None else 0.0
            worst = max(worst, sliding(rest, base, wheels[w.joint], pivot, angle, maps.V[0, :, 0]))
    return worst


def sliding(rest: AtRest, base: Base, c: Candidate, pivot: Joint | None, angle: float, eta: Array) -> float:
    """Speed of a wheel along its own axle, at an angle of its pivot and a velocity (3,) of the control frame [m/s]."""
    centre, axle = c.centre, c.axis
    if pivot is not None:
        turned = rotation(rest.axis(pivot), angle - pivot.rest)[:3, :3]
        centre = rest.hub(pivot) + product(turned, centre - rest.hub(pivot))
        axle = product(turned, axle)
    ahead, left, w = (float(value) for value in eta)
    x, y = in_frame(base.frame, centre)
    cosine, sine = cos_sin(float(base.frame[2]))
    across = cosine * axle[0] + sine * axle[1], cosine * axle[1] - sine * axle[0]
    size = hypot(float(across[0]), float(across[1]))
    return abs(across[0] * (ahead - y * w) + across[1] * (left + x * w)) / size


def scrub_note(rest: AtRest, base: SteeredBase, under: Undercarriage) -> list[Finding]:
    """A warning about wheels that slide sideways as they stand in the file."""
    if (scrub := scrub_of(rest, base, under)) <= SIDEWAYS:
        return []
    text = f"wheels slide sideways by up to {scrub:.2g} m per metre driven"
    why = "their pivots lean, or are not beside them"
    fix = "mend the <origin> of the wheels if that is a slip"
    return [note(rest, "base-scrub", base.pivots[0].joint, text, why, fix)]

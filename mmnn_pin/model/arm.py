"""Which joints are the manipulator, where the others stand, and where its hands are.

By default the arm is every joint that moves by itself and is no part of the base, but heads, jaws, sensors that turn,
buttons and linkages stand still: `limbs` tells them apart. Where the file says what drives some joints of the arm, by
transmissions, command interfaces or plugins, the others have no motor: they are locked, too. What the user locks,
frees, or names as the arm or its tip counts more.

A mimic joint is a slave: its position is `multiplier q + offset` of its master's, its rate `multiplier qdot`.
Pinocchio builds it as a joint of its own (its algorithms refuse its mimic joint); here T gives it its master's row
times the multiplier, and the offset enters the position at rest.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from pathlib import Path

from ..errors import ConfigError, RobotError, UnknownName
from .base.base import Base
from .base.evidence import motors_named
from .base.overrides import Overrides
from .base.wheels import alike_on_root, is_low
from .groups import groups_of
from .hands import Hand, hands_of, of_other_arm
from .limbs import STILL, WRIST, Limb, Limbs
from .urdf.document import Document
from .urdf.shapes import AtRest

WHY = {
    "base": "part of the base",
    "user": "locked as you said",
    "tip": "it does not lead to the arm's tip",
    "other": "it is the other arm's",
    "head": "taken as a head",
    "jaw": "taken as a jaw of a gripper",
    "sensor": "taken as a sensor that turns",
    "button": "taken as a button or bumper",
    "linkage": "taken as a linkage, which moves with what it links",
    "passive": "no transmission, command interface or plugin drives them, as it does other joints",
    "rigid": "taken as a rigid joint: its limits are one value",
}


@dataclass(frozen=True)
class Arm:
    """The manipulator, and the joints that stand still."""

    joints: tuple[str, ...]  # joints that move by themselves, in the order of the file
    locked: dict[str, float]  # position of every joint that stands still [rad or m]
    reasons: dict[str, str]  # why each of these stands still
    slaves: dict[str, Slave]  # mimic joints that move with a master
    hands: tuple[Hand, ...] = ()  # the end of every arm, that with the most joints first
    doubts: tuple[Limb, ...] = ()  # what may be otherwise
    broken: tuple[Path, ...] = ()  # SRDF files that cannot be read


def choose_arm(rest: AtRest, base: Base, overrides: Overrides) -> Arm:
    """The manipulator of a robot.

    Args:
        rest: The robot at rest.
        base: Its base.
        overrides: What the user says about it.

    Raises:
        UnknownName: A joint or link that the robot does not have.
        ConfigError: A lock on a drive wheel or outside the limits, a joint freed that is not locked, a tip that no
            joint carries, or an arm of two where there are not two.
        RobotError: A joint that mimics a wheel.
    """
    joints, slaves = rest.document.joints, slaves_of(rest.document)
    moving = [joint.name for joint in joints.values() if joint.moves and joint.name not in base.joints]
    require_free(rest, base, slaves, overrides)
    require_not_rolling(rest.document, base, {name: slaves[name] for name in moving if name in slaves})
    ours = [name for name in moving if name not in slaves and name not in base.locked]
    free = [name for name in ours if name not in overrides.locks]
    freed = {*ours} if "all" in overrides.free else {*overrides.free}
    limbs, still, broken = limbs_of(rest, base, ours, slaves, overrides)
    if overrides.arm_tip is None:
        still |= {name: WHY[role] for name, role in limbs.roles.items() if role in STILL}
    else:
        leading = leading_to(rest, overrides.arm_tip, free, slaves)
        still |= {name: WHY["tip"] for name in free if name not in leading and (name not in still or name in freed)}
    moves = [name for name in free if name not in still or name in freed]
    hands = hands_of(limbs, moves, overrides.arm_tip)
    still |= dict.fromkeys(of_other_arm(rest, base, hands, overrides.arm), WHY["other"])
    low = {j.name for j in joints.values() if is_low(rest, j)}  # a base may take these for its own
    open_ones = {name for limb in limbs.doubts(()) for name in limb.joints}
    known = {*still, *low, *(j.name for j in alike_on_root(rest)), *open_ones, "all"}
    if idle := [name for name in overrides.free if name not in known]:
        raise ConfigError(f"'{idle[0]}' need not be freed", why="it is not locked", fix="leave it out", key="free")
    reasons = {name: still[name] for name in free if name in still and name not in freed}
    reasons |= dict.fromkeys(base.locked, WHY["base"]) | dict.fromkeys(overrides.locks, WHY["user"])
    at = {name: where for name, where in overrides.locks.items() if where is not None}
    locked = {name: at.get(name, joints[name].rest) for name in moving if name in reasons}
    for name, slave in slaves.items():  # a slave stands still with its master
        if slave.master not in (*free, *base.joints) or slave.master in locked:
            locked.setdefault(name, slave.at(locked.get(slave.master, joints[slave.master].rest)))
            reasons.setdefault(name, f"follows '{slave.master}', which stands still")
    still_now = [name for name in joints if name in locked]
    return Arm(
        joints=tuple(name for name in free if name not in locked),
        locked={name: locked[name] for name in still_now},
        reasons={name: reasons[name] for name in still_now},
        slaves={name: slave for name, slave in slaves.items() if name not in locked and name not in base.joints},
        hands=tuple(hand for hand in hands if hand.joints[-1] not in reasons),
        doubts=() if overrides.arm_tip else limbs.doubts({*overrides.locks, *overrides.free}),
        broken=broken,
    )


def limbs_of(
    rest: AtRest, base: Base, joints: list[str], slaves: dict[str, Slave], overrides: Overrides
) -> tuple[Limbs, dict[str, str], tuple[Path, ...]]:
    """Roles of joints that are not the base's, those of them that cannot move, with why, and broken files.

    A joint of an arm whose limits are one value may be rigid, unless nobody wrote any limits. It has no motor in a file
    that names the motors of others, unless those are at most of heads and jaws: then the arm's own are said elsewhere.
    """
    stiff = [name for name in joints if rest.document.joints[name].lower == rest.document.joints[name].upper]
    stiff = stiff if len(stiff) < len(joints) or (base.columns and len(stiff) < WRIST) else []
    driven = {slaves[name].master if name in slaves else name for name in motors_named(rest)}
    masters = {name: slave.master for name, slave in slaves.items()}
    groups, broken = groups_of(rest, overrides.controllers_file)
    limbs = Limbs(rest, frozenset(joints), masters, base, groups)
    stiff = [name for name in stiff if name in limbs.arm]
    idle = {name for name in joints if name not in driven} if driven & limbs.arm else set()
    still = dict.fromkeys(idle, WHY["passive"]) | dict.fromkeys(stiff, WHY["rigid"])
    fixed = set() if "all" in overrides.free else still.keys() - {*overrides.free}
    return replace(limbs, candidates=limbs.candidates - fixed), still, broken


def require_free(rest: AtRest, base: Base, slaves: Iterable[str], overrides: Overrides) -> None:
    """Refuse to lock or free what the robot lacks, or what stands and moves with something else.

    Raises:
        UnknownName: A joint that the robot does not have.
        ConfigError: A lock on a drive wheel or outside the limits; a joint of the base, or one that follows another.
    """
    names = {joint.name: joint for joint in rest.document.joints.values() if joint.moves}
    for key, done, said in (("lock", "locked", {*overrides.locks}), ("free", "freed", {*overrides.free} - {"all"})):
        for name in sorted(said):
            if name not in names:
                raise UnknownName("joint", name, names, file=rest.document.path, key=key)
            held = {*base.joints, *(base.locked if key == "free" else ())}
            if name in slaves or name in held:
                why = "it is part of the base" if name in held else "it follows another joint"
                fix = "use --base fixed to park the base" if key == "lock" and name in held else "leave it out"
                raise ConfigError(f"'{name}' cannot be {done}", why=why, fix=fix, key=key)
    for name, at in overrides.locks.items():
        if at is not None and not names[name].lower <= at <= names[name].upper:
            fix = f"give a position within [{names[name].lower:g}, {names[name].upper:g}]"
            raise ConfigError(f"'{name}' cannot be locked at {at:g}", fix=fix, key="lock")


def require_not_rolling(document: Document, base: Base, slaves: dict[str, Slave]) -> None:
    """Refuse joints beside the base's that a `<mimic>` turns with a wheel: they would go round as the robot drives.

    Raises:
        RobotError: The first of them.
    """
    wheels = {wheel.joint for wheel in base.wheels}
    for name, slave in slaves.items():
        if slave.master in wheels and name not in base.locked:
            what, line = f"joint '{name}' mimics the wheel '{slave.master}'", document.joints[name].line
            fix = "take out its <mimic>, or make it fixed"
            raise RobotError(what, why="it would turn as the robot drives", fix=fix, file=document.path, line=line)


def leading_to(rest: AtRest, tip: str, free: Iterable[str], slaves: dict[str, Slave]) -> set[str]:
    """Joints between the root and the arm's tip, and those that they follow; errors as of `choose_arm`."""
    if tip not in rest.document.links:
        raise UnknownName("link", tip, rest.document.links, file=rest.document.path, key="arm_tip")
    leading = {joint.name for joint in rest.document.moving_ancestors(tip)}
    leading |= {slaves[name].master for name in leading & slaves.keys()}
    if leading.isdisjoint(free):
        fix = "name a link that the arm carries"
        raise ConfigError(f"no joint leads to '{tip}'", fix=fix, file=rest.document.path, key="arm_tip")
    return leading


# -- mimic joints ------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Slave:
    """A joint that follows another one that does not itself follow."""

    master: str  # the joint that it follows
    multiplier: float  # its rate over the master's
    offset: float  # its position where the master's is 0 [rad or m]

    def at(self, position: float) -> float:
        """Its position at a position of the master."""
        return self.multiplier * position + self.offset


def slaves_of(document: Document) -> dict[str, Slave]:
    """All moving joints that follow others, each with the joint at the end of its chain of masters.

    Raises:
        RobotError: A master that does not exist, or a circle.
    """
    followers = [j for j in document.joints.values() if j.mimics is not None and j.moves]
    direct, slaves = {j.name: Slave(j.mimics or "", j.multiplier, j.offset) for j in followers}, dict[str, Slave]()
    for name, slave in direct.items():
        seen, problem = {name}, ""
        while slave.master in direct and slave.master not in seen:  # a slave of a slave: of the first master
            above = direct[slave.master]
            seen.add(slave.master)
            slave = Slave(above.master, slave.multiplier * above.multiplier, slave.at(above.offset))
        if slave.master not in document.joints:
            problem = f"mimics '{slave.master}', which does not exist"
        if problem or slave.master in seen:
            what, line = f"joint '{name}' {problem or 'follows itself in a circle'}", document.joints[name].line
            raise RobotError(what, fix="name a joint that moves by itself", file=document.path, line=line)
        slaves[name] = slave
    return slaves

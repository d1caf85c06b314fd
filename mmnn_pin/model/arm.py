"""Which joints are the manipulator, where the others stand, and where its hands are.

By default the arm is every joint that moves by itself and is no part of the base, but heads, jaws, sensors that turn
and buttons stand still: `limbs` tells them apart. Where the file says what drives some joints of the arm, by
transmissions, command interfaces or plugins, the others have no motor: they are locked, too. What the user locks,
frees, or names as the arm or its tip counts more.

A mimic joint is a slave: its position is `multiplier q + offset` of its master's, its rate `multiplier qdot`.
Pinocchio builds it as a joint of its own (its algorithms refuse its mimic joint); here T gives it its master's row
times the multiplier, and the offset enters the position at rest.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace

from ..errors import ConfigError, RobotError, UnknownName
from .base.base import Base
from .base.evidence import motors_named
from .base.overrides import Overrides
from .base.wheels import alike_on_root, is_low
from .groups import groups_of
from .hands import Hand, hands_of, of_other_arm
from .limbs import STILL, WRIST, Limb, Limbs
from .urdf.document import Document, Joint, number
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
    "passive": "no transmission, command interface or plugin drives them, as it does other joints",
    "rigid": "taken as a rigid joint: its limits are one value",
}


@dataclass(frozen=True)
class Arm:
    """The manipulator, and the joints that stand still.

    Attributes:
        joints: Joints that move by themselves, in the order of the file.
        locked: Position of every joint that stands still [rad or m].
        reasons: Why each of these stands still.
        slaves: Mimic joints that move with a master.
        hands: The end of every arm, that with the most joints first.
        doubts: What may be otherwise.
    """

    joints: tuple[str, ...]
    locked: dict[str, float]
    reasons: dict[str, str]
    slaves: dict[str, Slave]
    hands: tuple[Hand, ...] = ()
    doubts: tuple[Limb, ...] = ()


def choose_arm(rest: AtRest, base: Base, overrides: Overrides) -> Arm:
    """The manipulator of a robot.

    Args:
        rest: The robot at rest.
        base: Its base.
        overrides: What the user says about it.

    Raises:
        UnknownName: A joint or link that the robot does not have.
        ConfigError: A lock on a drive wheel or outside the limits, a tip that no joint carries, or an arm of two where
            there are not two.
    """
    joints, slaves, wheels = rest.document.joints, slaves_of(rest.document), {*base.joints}
    moving = [joint.name for joint in joints.values() if joint.moves and joint.name not in wheels]
    reasons = dict.fromkeys(base.locked, WHY["base"])
    reasons |= dict.fromkeys(user_locks(rest, overrides, wheels, base.locked), WHY["user"])
    free = [name for name in moving if name not in reasons and name not in slaves]
    known = {*overrides.locks}.difference(slaves, base.locked)  # they have roles among the others, too
    ours = [name for name in moving if name in free or name in known]
    limbs, still = limbs_of(rest, base, ours, slaves, overrides)
    if overrides.arm_tip is not None:
        left = [name for name in free if name not in still or freed(name, overrides)]
        leading = leading_to(rest, overrides.arm_tip, left, slaves)
        still |= {name: WHY["tip"] for name in left if name not in leading}
    else:
        still |= {name: WHY[role] for name, role in limbs.roles.items() if name in free and role in STILL}
    hands = hands_of(limbs, [name for name in free if name not in still or freed(name, overrides)], overrides.arm_tip)
    still |= dict.fromkeys(of_other_arm(rest, base, hands, overrides.arm), WHY["other"])
    require_locked(rest, overrides, still)
    reasons |= {name: why for name, why in still.items() if name in free and not freed(name, overrides)}
    hands = tuple(hand for hand in hands if hand.joints[-1] not in reasons)
    locked = {name: position_of(joints[name], overrides) for name in moving if name in reasons}
    masters = {*free, *wheels}.difference(locked)
    for name, slave in slaves.items():  # a slave stands still with its master
        if slave.master in locked or (name not in locked and slave.master not in masters):
            locked.setdefault(name, slave.at(locked.get(slave.master, joints[slave.master].rest)))
            reasons.setdefault(name, f"follows '{slave.master}', which stands still")
    still_now = [name for name in joints if name in locked]
    return Arm(
        joints=tuple(name for name in free if name not in locked),
        locked={name: locked[name] for name in still_now},
        reasons={name: reasons[name] for name in still_now},
        slaves={name: slave for name, slave in slaves.items() if name not in locked and name not in wheels},
        hands=hands,
        doubts=() if overrides.arm_tip else limbs.doubts({*overrides.locks, *overrides.free}),
    )


def limbs_of(
    rest: AtRest, base: Base, joints: list[str], slaves: dict[str, Slave], overrides: Overrides
) -> tuple[Limbs, dict[str, str]]:
    """Roles of joints that are not the base's, and those of them that cannot move, with why.

    A joint is rigid where its limits are one value, unless nobody wrote the limits of an arm. It has no motor in a file
    that names the motors of others, unless those are at most of heads and jaws: then the arm's own are said elsewhere.
    """
    stiff = [name for name in joints if rest.document.joints[name].lower == rest.document.joints[name].upper]
    stiff = stiff if len(stiff) < len(joints) or (base.columns and len(stiff) < WRIST) else []
    driven = {slaves[name].master if name in slaves else name for name in motors_named(rest)}
    masters = {name: slave.master for name, slave in slaves.items()}
    limbs = Limbs(rest, frozenset(joints), masters, groups_of(rest, overrides.controllers_file))
    idle = {name for name in joints if name not in driven} if driven & {*limbs.arm} else set()
    still = dict.fromkeys(idle, WHY["passive"]) | dict.fromkeys(stiff, WHY["rigid"])
    fixed = {name for name in still if not freed(name, overrides)}
    return replace(limbs, candidates=limbs.candidates - fixed), still


def user_locks(rest: AtRest, overrides: Overrides, wheels: Iterable[str], held: Iterable[str]) -> list[str]:
    """Joints that the user locks.

    Raises:
        UnknownName: A joint that the robot does not have.
        ConfigError: A lock on a drive wheel; a joint freed that stands or moves with something else.
    """
    names = [joint.name for joint in rest.document.joints.values() if joint.moves]
    for name in overrides.locks:
        if name not in names:
            raise UnknownName("joint", name, names, file=rest.document.path, key="lock")
        if name in wheels:
            fix = "use --base fixed to park the base"
            what = f"'{name}' is a drive wheel, or steers one, and cannot be locked"
            raise ConfigError(what, fix=fix, key="lock")
        if name in slaves_of(rest.document):
            why, fix = "it stands where the joint that it follows puts it", "lock that one"
            raise ConfigError(f"'{name}' cannot be locked", why=why, fix=fix, key="lock")
    for name in overrides.free:
        if name not in names and name != "all":
            raise UnknownName("joint", name, ["all", *names], file=rest.document.path, key="free")
        if name in (*wheels, *held, *slaves_of(rest.document)):
            why = "it is part of the base" if name in (*wheels, *held) else "it follows another joint"
            raise ConfigError(f"'{name}' cannot be freed", why=why, fix="leave it out", key="free")
    return list(overrides.locks)


def position_of(joint: Joint, overrides: Overrides) -> float:
    """Position of a locked joint [rad or m].

    Raises:
        ConfigError: Outside its limits.
    """
    given = overrides.locks.get(joint.name)
    if given is None:
        return joint.rest
    if not joint.lower <= given <= joint.upper:
        what = f"'{joint.name}' cannot be locked at {given:g}"
        raise ConfigError(what, fix=f"give a position within [{joint.lower:g}, {joint.upper:g}]", key="lock")
    return given


def leading_to(rest: AtRest, tip: str, free: list[str], slaves: dict[str, Slave]) -> set[str]:
    """Joints between the root and the arm's tip, and those that they follow; errors as of `unwanted`."""
    if tip not in rest.document.links:
        raise UnknownName("link", tip, rest.document.links, file=rest.document.path, key="arm_tip")
    leading = {j.name for j in rest.document.moving_ancestors(tip)}
    leading |= {slaves[name].master for name in leading & slaves.keys()}
    if not leading & set(free):
        fix = "name a link that the arm carries"
        raise ConfigError(f"no joint leads to '{tip}'", fix=fix, file=rest.document.path, key="arm_tip")
    return leading


def require_locked(rest: AtRest, overrides: Overrides, still: Iterable[str]) -> None:
    """Refuse to free joints that are not locked; those that a base may take for its own can be freed.

    Raises:
        ConfigError: One moves anyhow.
    """
    low = [j for j in rest.document.joints.values() if is_low(rest, j)]
    known = {*still, "all", *(j.name for j in (*low, *alike_on_root(rest)))}
    idle = [name for name in overrides.free if name not in known]
    if idle:
        raise ConfigError(f"'{idle[0]}' is freed, and moves anyhow", fix="leave it out", key="free")


def freed(name: str, overrides: Overrides) -> bool:
    """Whether the user frees a joint."""
    return name in overrides.free or "all" in overrides.free


# -- mimic joints ------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Slave:
    """A joint that follows another one that does not itself follow.

    Attributes:
        master: The joint that it follows.
        multiplier: Its rate over the master's.
        offset: Its position where the master's is 0 [rad or m].
    """

    master: str
    multiplier: float
    offset: float

    def at(self, position: float) -> float:
        """Its position at a position of the master."""
        return self.multiplier * position + self.offset


def slaves_of(document: Document) -> dict[str, Slave]:
    """All moving joints that follow others, each with the joint at the end of its chain of masters.

    Raises:
        RobotError: A master that does not exist, or a circle.
    """
    direct: dict[str, Slave] = {}
    for element in document.root.iterchildren("joint"):
        mimic = element.find("mimic")
        if mimic is not None and document.joints[element.get("name")].moves:
            gain, offset = number(mimic, "multiplier", 1.0), number(mimic, "offset", 0.0)
            direct[element.get("name")] = Slave(mimic.get("joint", ""), gain, offset)
    return {name: resolved(document, name, direct) for name in direct}


def resolved(document: Document, name: str, direct: dict[str, Slave]) -> Slave:
    """A slave of a slave, as slave of the first master."""
    slave, seen = direct[name], {name}
    while slave.master in direct:
        above = direct[slave.master]
        if slave.master in seen:
            raise broken(document, name, "follows itself in a circle")
        seen.add(slave.master)
        slave = Slave(above.master, slave.multiplier * above.multiplier, slave.at(above.offset))
    if slave.master not in document.joints:
        raise broken(document, name, f"mimics '{slave.master}', which does not exist")
    return slave


def broken(document: Document, name: str, what: str) -> RobotError:
    """The refusal of a mimic joint."""
    fix = "name a joint that moves by itself"
    return RobotError(f"joint '{name}' {what}", fix=fix, file=document.path, line=document.joints[name].line)

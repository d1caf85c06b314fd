"""Which joints are the manipulator, and where the others stand.

By default the arm is every joint that moves by itself and is no part of the base, but heads and fingers are locked:
short branches of the tree of joints. A branch is a joint beside another one on the same body (one that moves by
itself, or follows it), and what it carries. It is short when it reaches less than a third as far as the robot's
longest chain, and is either a head (fewer than four joints in a row) or sits at the end of an arm (three joints or
more lead to it). Second arms reach as far as the first, so they stay. Where the file says what drives some joints of
the arm, by transmissions, command interfaces or plugins, the others have no motor: they are locked, too. What the user
locks, frees, or names as the arm's tip counts more.

A mimic joint is a slave: its position is `multiplier q + offset` of its master's, its rate `multiplier qdot`.
Pinocchio builds it as a joint of its own (its algorithms refuse its mimic joint); here T gives it its master's row
times the multiplier, and the offset enters the position at rest.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass

from ..errors import ConfigError, RobotError, UnknownName
from .base.base import Base
from .base.evidence import motors_named
from .base.overrides import Overrides
from .base.wheels import alike_on_root, is_low
from .urdf.document import Document, Joint, number
from .urdf.shapes import AtRest

SHORT = 1 / 3  # a branch is short below this fraction of the longest chain's reach
BUTTON = 0.02  # [m] longest travel of a button
HEAD_JOINTS, ARM_JOINTS = 4, 3  # a head has fewer joints than the first, fingers have at least the second before them

WHY = {
    "base": "part of the base",
    "user": "locked as you said",
    "tip": "it does not lead to the arm's tip",
    "short": "taken as a head or finger: a short branch",
    "passive": "no transmission, command interface or plugin drives them, as it does other joints",
    "rigid": "taken as a rigid joint: its limits are one value",
    "button": "taken as a button or bumper: it slides by two centimetres at most and carries no joint",
}


@dataclass(frozen=True)
class Arm:
    """The manipulator, and the joints that stand still.

    Attributes:
        joints: Joints that move by themselves, in the order of the file.
        locked: Position of every joint that stands still [rad or m].
        reasons: Why each of these stands still.
        slaves: Mimic joints that move with a master.
    """

    joints: tuple[str, ...]
    locked: dict[str, float]
    reasons: dict[str, str]
    slaves: dict[str, Slave]


def choose_arm(rest: AtRest, base: Base, overrides: Overrides) -> Arm:
    """The manipulator of a robot.

    Args:
        rest: The robot at rest.
        base: Its base.
        overrides: What the user says about it.

    Raises:
        UnknownName: A joint or link that the robot does not have.
        ConfigError: A lock on a drive wheel or outside the limits, or a tip that no joint carries.
    """
    joints, slaves, wheels = rest.document.joints, slaves_of(rest.document), {*base.joints}
    moving = [joint.name for joint in joints.values() if joint.moves and joint.name not in wheels]
    reasons = dict.fromkeys(base.locked, WHY["base"])
    reasons |= dict.fromkeys(user_locks(rest, overrides, wheels, base.locked), WHY["user"])
    free = [name for name in moving if name not in reasons and name not in slaves]
    reasons |= unwanted(rest, free, rigid_joints(rest, base, free), slaves, overrides)
    locked = {name: position_of(joints[name], overrides) for name in moving if name in reasons}
    masters = {*free, *wheels}.difference(locked)
    for name, slave in slaves.items():  # a slave stands still with its master
        if slave.master in locked or (name not in locked and slave.master not in masters):
            locked.setdefault(name, slave.at(locked.get(slave.master, joints[slave.master].rest)))
            reasons.setdefault(name, f"follows '{slave.master}', which stands still")
    still = [name for name in joints if name in locked]
    return Arm(
        joints=tuple(name for name in free if name not in locked),
        locked={name: locked[name] for name in still},
        reasons={name: reasons[name] for name in still},
        slaves={name: slave for name, slave in slaves.items() if name not in locked and name not in wheels},
    )


def rigid_joints(rest: AtRest, base: Base, free: list[str]) -> list[str]:
    """Joints whose limits are one value; none of a fixed arm all of whose joints are so: nobody wrote their limits."""
    joints = rest.document.joints
    stiff = [name for name in free if joints[name].lower == joints[name].upper]
    return stiff if base.columns or len(stiff) < len(free) else []


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


def unwanted(
    rest: AtRest, free: list[str], stiff: list[str], slaves: dict[str, Slave], overrides: Overrides
) -> dict[str, str]:
    """Joints that are not of the manipulator, and why.

    Raises:
        UnknownName: The tip is no link.
        ConfigError: No joint leads to it, or a joint is freed that is not locked.
    """
    rigid = dict.fromkeys(passive(rest, free, slaves), WHY["passive"]) | dict.fromkeys(stiff, WHY["rigid"])
    ours = [name for name in free if name not in rigid or freed(name, overrides)]
    if overrides.arm_tip is not None:
        leading = leading_to(rest, overrides.arm_tip, ours, slaves)
        still = {name: WHY["tip"] for name in ours if name not in leading}
    else:
        still = dict.fromkeys(short_branches(rest, set(ours), slaves), WHY["short"])
        still |= {name: WHY["button"] for name in ours if name not in still and is_button(rest, name)}
    still |= rigid
    require_locked(rest, overrides, still)
    return {name: why for name, why in still.items() if not freed(name, overrides)}


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


def passive(rest: AtRest, joints: list[str], slaves: dict[str, Slave]) -> list[str]:
    """Joints without a motor in a file that names the motors of others.

    None where it names at most those of heads and fingers: then the arm's own are said elsewhere.
    """
    driven = {slaves[name].master if name in slaves else name for name in motors_named(rest)}
    main = set(joints).difference(short_branches(rest, set(joints), slaves))
    return [name for name in joints if name not in driven] if main & driven else []


def is_button(rest: AtRest, name: str) -> bool:
    """Whether a joint slides a little on the root's body, and carries no other."""
    joint = rest.document.joints[name]
    if joint.type != "prismatic" or not joint.upper - joint.lower <= BUTTON:
        return False
    return not rest.document.moving_children(joint.child) and len(rest.document.moving_ancestors(joint.child)) == 1


def freed(name: str, overrides: Overrides) -> bool:
    """Whether the user frees a joint."""
    return name in overrides.free or "all" in overrides.free


# -- branches of the tree ----------------------------------------------------------------------------------------------


def short_branches(rest: AtRest, candidates: set[str], slaves: dict[str, Slave]) -> list[str]:
    """Joints of heads and fingers, from the ends inwards: antennas lengthen no row of a head."""
    tree = tree_of(rest)
    longest = max((tree[name].reach for name in candidates), default=0.0)
    short: set[str] = set()
    for name in sorted(candidates | slaves.keys(), key=lambda name: (-len(tree[name].above), name)):
        branch = tree[name]
        moving = [joint for joint in branch.carried if joint not in short]
        in_row = max((1 + sum(up in branch.carried for up in tree[joint].above) for joint in moving), default=0)
        led = {slave for slave, its in slaves.items() if its.master in branch.carried}
        siblings = [other for other in branch.beside if other in candidates or other in led]
        at_end = sum(above in candidates for above in branch.above) >= ARM_JOINTS
        if siblings and branch.reach < SHORT * longest and (in_row < HEAD_JOINTS or at_end):
            short |= candidates & {*branch.carried}
    return [name for name in rest.document.joints if name in short]


@dataclass(frozen=True)
class Branch:
    """A joint and what it carries.

    Attributes:
        reach: How far it reaches from its joint, along the longest path of joints and links [m].
        carried: Itself and all joints on it.
        above: Joints that lead to it.
        beside: Other joints on the body that carries it.
    """

    reach: float
    carried: tuple[str, ...]
    above: tuple[str, ...]
    beside: tuple[str, ...]


def tree_of(rest: AtRest) -> dict[str, Branch]:
    """The branch of every moving joint."""
    tree: dict[str, Branch] = {}

    def grow(joints: list[Joint], above: tuple[str, ...]) -> None:
        names = [joint.name for joint in joints]
        for joint in joints:
            below = rest.document.moving_children(joint.child)
            grow(below, (joint.name, *above))
            branches = [tree[j.name] for j in below]
            hub = rest.hub(joint)
            ends = [own_reach(rest, joint)]
            ends += [math.dist(rest.hub(j), hub) + b.reach for j, b in zip(below, branches, strict=True)]
            tree[joint.name] = Branch(
                reach=max(ends),
                carried=(joint.name, *(name for b in branches for name in b.carried)),
                above=above,
                beside=tuple(name for name in names if name != joint.name),
            )

    grow(rest.document.moving_children(rest.document.root_link), ())
    return tree


def own_reach(rest: AtRest, joint: Joint) -> float:
    """Reach of the body on a joint: to its farthest frame, or as a rod with that centre of mass would [m]."""
    hub = rest.hub(joint)
    frames = [math.dist(rest.placements[link][:3, 3], hub) for link in rest.document.body(joint.child)]
    rod = 2 * math.dist(rest.centre(joint.child), hub) if rest.mass(joint.child) > 0 else 0.0
    return max([*frames, rod])


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

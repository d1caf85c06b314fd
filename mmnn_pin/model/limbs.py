"""Roles of the joints that are not the base's: which branches of the tree are heads, jaws, sensors, buttons, linkages.

Every joint that moves by itself is the top of a *branch*: itself and what it carries. A branch moves, as part of an
arm, or stands still as one whole: as a head, the jaw of a gripper, a sensor that turns, a button, or a linkage, whose
loop no URDF can close. Signs speak for or against each of these over an arm, with the weights of `WEIGHTS` [nats]; the
branches that stand still are those whose scores have the largest sum. So the roles are found together: an arm is what
carries its jaws. Names are one sign among others, and what the files of controllers and of MoveIt group is another.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import combinations
from shlex import quote

from ..elementary.matrices import length, product
from .base.base import Base
from .groups import Group
from .signs import MARGIN, Sign, score, told_apart
from .urdf.document import Joint
from .urdf.shapes import AtRest

STILL = ("head", "jaw", "sensor", "button", "linkage")  # roles of branches that stand still
WEIGHTS: dict[str, tuple[float, float, float, float, float]] = {  # of a sign for each of these over an arm
    "most joints are an arm's": (-1.5, -1.5, -3.0, -6.0, -4.0),
    "it reaches less than a third as far as the longest chain": (1.5, 1.5, 1.5, 0.0, 1.5),
    "it has four joints or more in a row": (-3.5, -1.5, -4.0, -6.0, -4.0),
    "three joints or more lead to it": (-1.0, 1.5, 0.0, -6.0, -1.0),
    "one joint at most leads to it": (0.0, -2.0, 0.0, 0.0, 0.0),
    "it stands beside a longer branch": (2.0, 1.0, 1.0, 1.0, 1.0),
    "nothing stands beside it on an arm": (-2.0, -4.0, -1.0, 0.0, -4.0),
    "nothing stands beside it on an arm, and it carries a joint": (0.0, -2.0, 0.0, 0.0, 0.0),
    "others stand beside it at the end of an arm": (0.0, 1.5, 0.0, 0.0, 0.0),
    "its like faces it": (-1.0, 2.5, -2.0, 0.0, 0.0),
    "two that are alike hang on it": (0.0, -10.0, 0.0, 0.0, 0.0),
    "it slides by a few centimetres and carries no joint": (-1.0, 1.0, -1.0, 0.0, 0.0),
    "it slides": (0.0, 0.0, -3.0, 0.0, 0.0),
    "it slides by two centimetres at most on the base and carries no joint": (0.0, -1.0, 0.0, 8.0, 0.0),
    "it turns across the joint before it, which rolls": (0.0, 1.0, 0.0, 0.0, 0.0),
    "it turns by half a turn or more, to either side": (0.0, -1.0, 0.0, 0.0, 0.0),
    "it turns without end about an upright axis and carries no joint": (0.0, -2.0, 3.0, 0.0, -4.0),
    "it turns alone on a base": (4.0, 0.0, 4.0, 0.0, 0.0),
    "it hangs on a rocker": (0.0, 0.0, 0.0, 0.0, 7.0),
    "it is all at the height at which rockers turn": (0.0, 0.0, 0.0, 0.0, 7.0),
    "it slides or spins at its end, beside a longer chain on an arm": (0.0, 0.0, 0.0, 0.0, 7.0),
    "it carries what turns without end about a level axis": (-0.5, 0.0, 0.0, 0.0, 0.0),
    "it carries a camera": (1.5, -0.5, 1.0, 0.0, 0.0),
    "it carries a lidar": (0.5, -0.5, 2.5, 0.0, 0.0),
    "it carries the frame of a tool": (-4.0, -2.0, -4.0, -4.0, -4.0),
    "names of arms": (-5.0, -5.0, -5.0, -2.0, -1.0),
    "names of heads": (6.0, -1.0, 2.0, 0.0, -1.0),
    "names of jaws": (-1.0, 5.0, -1.0, 0.0, -1.0),
    "names of sensors": (3.0, -1.0, 5.0, 0.0, -1.0),
    "names of buttons": (0.0, 0.0, 0.0, 6.0, 0.0),
    "names of linkages": (0.0, 0.0, 0.0, 0.0, 2.0),
}
SHORT = 1 / 3  # fraction of the longest chain's reach
ROW, WRIST = 4, 3  # joints in a row that are more than a head's; joints that lead to a jaw
STROKE, BUTTON = 0.15, 0.02  # [m] longest travel of a jaw and of a button
HALF = 3.1  # [rad] half a turn, as files round it
ALIKE = 0.2  # reaches of two jaws differ by less than this fraction
ALONG = 0.9  # cosine of the largest angle between parallel directions
WORDS = {  # English, German, French, Spanish, Italian, Portuguese, and Chinese and Japanese in Latin letters
    "arm": "arm forearm upperarm shoulder elbow wrist flange lift lifter elevator torso waist trunk column telescope"
    " boom bucket fork schulter ellenbogen handgelenk unterarm oberarm hub saeule bras epaule coude poignet torse"
    " brazo hombro codo muneca cintura columna braccio spalla gomito polso busto braco ombro cotovelo punho"
    " jian zhou wan yao ude kata hiji tekubi koshi",
    "head": "head neck eye gaze turret gun cannon"
    " kopf hals nacken tete cou cabeza cuello testa collo cabeca pescoco tou jing kubi atama",
    "jaw": "gripper grip grasper finger fingertip thumb index middle little knuckle jaw claw clamp pinch hand palm"
    " griffe pince doigt mors pinza garra dedo mano dito greifer klaue backe zange zhua jiazhua shou hasami yubi",
    "sensor": "camera cam gimbal lidar laser radar scanner lds sonar antenna antenne antena kamera fotocamera",
    "button": "button bumper knopf taste bouton boton bottone botao",
    "linkage": "linkage rocker bogie differential diff crank strut piston pushrod",
}
ROLE_OF = {word: role for role, words in WORDS.items() for word in words.split()}
FINGERS = {"index", "middle", "little"}  # of fingers only where other words speak of hands
WEAK = dict.fromkeys(("pan", "tilt", "mast"), "head")  # said of shoulders, too
TOOL = re.compile(
    r"tool0|(?:^|_)(?:tcp|tool|ee|eef)(?:_|$)|end_?effector|flange|grip(?:per)?_frame|grasp", re.IGNORECASE
)
LOADS = {
    "it carries a camera": re.compile(r"camera|kinect|realsense|zed|xtion|d4[0-9]5|kamera", re.IGNORECASE),
    "it carries a lidar": re.compile(r"lidar|laser|hokuyo|velodyne|rplidar|\bray\b", re.IGNORECASE),
    "it carries the frame of a tool": TOOL,
}
LETTERS = re.compile(r"[A-Z]?[a-z]+|[A-Z]+(?![a-z])")


def words_of(name: str) -> list[str]:
    """The words of a name."""
    return [text.lower() for text in LETTERS.findall(name)]


def role_named(name: str, told: Iterable[str] = (), turns: bool = True) -> tuple[str, str]:
    """The role that a name states and its word for it, the last of several: nouns stand last; empty without one.

    Args:
        name: Of a joint, a link or a group.
        told: Words that tell nothing, of arms only where no other word tells.
        turns: Whether it is of a joint that turns: what slides neither pans nor is a mast for a camera.
    """
    words = [word for word in reversed(words_of(name)) if word not in told or ROLE_OF.get(word) == "arm"]
    words.sort(key=lambda word: word in told)
    for table in (ROLE_OF, WEAK if turns else {}):
        for form in (form for word in words for form in (word, word.rstrip("s"), word[1:] * (word[0] in "lr"))):
            if form in table:
                sensor = next((word for word in words_of(name) if ROLE_OF.get(word) == "sensor"), "")
                return ("sensor", sensor) if table[form] == "arm" and sensor else (table[form], form)
    return "", ""


@dataclass(frozen=True)
class Branch:
    """A joint and what it carries."""

    reach: float  # how far it reaches from its joint, along the longest path of joints and links [m]
    carried: tuple[str, ...]  # itself and all joints on it
    above: tuple[str, ...]  # joints that lead to it
    beside: tuple[str, ...]  # other joints on the body that carries it
    below: tuple[str, ...]  # joints that hang on its own body
    row: int  # joints in its longest row


@dataclass(frozen=True)
class Limb:
    """How a branch is taken."""

    joints: tuple[str, ...]  # joints on it that may move by themselves, its own first
    role: str  # `arm` where it moves, else one of `STILL`
    other: str  # what else it may be
    signs: tuple[Sign, ...]  # what speaks for a branch that stands still over one that moves
    margin: float  # by how much the role beats the other [nats]

    @property
    def told(self) -> list[str]:
        """Signs that tell its role from the other, the strongest first."""
        return told_apart((), self.signs) if self.role == "arm" else told_apart(self.signs, ())

    def option(self, role: str) -> str:
        """Options that make it part of the arm, or of what stands still."""
        return " ".join(f"--{'free' if role == 'arm' else 'lock'} {quote(joint)}" for joint in self.joints)


@dataclass(frozen=True, eq=False)
class Limbs:
    """The branches of a robot and their roles."""

    rest: AtRest  # the robot at rest
    candidates: frozenset[str]  # joints that may move by themselves
    followers: Mapping[str, str]  # joints that follow others, with those
    base: Base  # the base that carries them
    groups: tuple[Group, ...] = ()  # joints that files of its controllers and of MoveIt name together
    # of every sign, as `WEIGHTS` has them
    weights: Mapping[str, tuple[float, ...]] = field(default_factory=lambda: WEIGHTS)

    @cached_property
    def tree(self) -> dict[str, Branch]:
        """The branch of every moving joint."""
        rest, tree = self.rest, dict[str, Branch]()

        def grow(joints: list[Joint], above: tuple[str, ...]) -> None:
            for joint in joints:
                below = rest.document.moving_children(joint.child)
                grow(below, (joint.name, *above))
                hub, branches = rest.hub(joint), [tree[j.name] for j in below]
                ends = [math.dist(rest.hub(j), hub) + b.reach for j, b in zip(below, branches, strict=True)]
                tree[joint.name] = Branch(
                    reach=max([own_reach(rest, joint), *ends]),
                    carried=(joint.name, *(name for b in branches for name in b.carried)),
                    above=above,
                    beside=tuple(j.name for j in joints if j is not joint),
                    below=tuple(j.name for j in below),
                    row=(joint.name in self.candidates) + max((b.row for b in branches), default=0),
                )

        grow(rest.document.moving_children(rest.document.root_link), ())
        return tree

    @cached_property
    def rockers(self) -> dict[str, float]:
        """Joints of the base that turn with two of its wheels or more, but not all, each with their radius [m]."""
        found = dict[str, float]()
        for name in self.base.suspensions:
            radii = [wheel.radius for wheel in self.base.wheels if wheel.joint in self.tree[name].carried]
            if self.joint(name).type != "prismatic" and 2 <= len(radii) < len(self.base.wheels):
                found[name] = max(radii)
        return found

    @cached_property
    def longest(self) -> float:
        """Reach of the longest chain [m]."""
        return max((self.tree[name].reach for name in self.candidates), default=0.0)

    @cached_property
    def limbs(self) -> dict[str, Limb]:
        """Every branch that moves, and those that stand still, by their topmost joints."""
        found, worth = dict[str, Limb](), dict[str, float]()
        for name in sorted(self.tree, key=lambda name: -len(self.tree[name].above)):
            branch = self.tree[name]
            worth[name] = moves = sum(worth[joint] for joint in branch.below)
            if name not in self.candidates:
                continue
            role, signs = max(self.readings(name).items(), key=lambda item: score(item[1]))
            still, joints = score(signs), tuple(joint for joint in branch.carried if joint in self.candidates)
            if still > moves:
                worth[name] = still
                found = {joint: limb for joint, limb in found.items() if joint not in joints}
            roles = (role, "arm") if still > moves else ("arm", role)
            called = role_named(name, turns=False)[0] if roles == ("arm", "head") else ""  # though much hangs on it
            found[name] = Limb(joints, *roles, tuple(signs), 0.0 if called == "head" else abs(still - moves))
        if not self.base.columns and not any(limb.role == "arm" for limb in found.values()):  # what else would move?
            found |= {n: replace(limb, role="arm") for n, limb in found.items() if limb.role in ("head", "jaw")}
        return found

    @cached_property
    def roles(self) -> dict[str, str]:
        """The role of every candidate: of the branch that it is on, `arm` where that moves."""
        tops = sorted(self.limbs, key=lambda name: len(self.tree[name].above))
        return {joint: self.limbs[top].role for top in tops for joint in self.limbs[top].joints}

    @property
    def arm(self) -> set[str]:
        """Joints of the arm."""
        return {name for name, role in self.roles.items() if role == "arm"}

    def doubts(self, said: Iterable[str]) -> tuple[Limb, ...]:
        """Branches whose roles beat others by little, one of every chain; none of those that the user speaks of."""
        found, known = list[Limb](), {*said}
        open_ones = [limb for limb in self.limbs.values() if limb.margin < MARGIN and limb.role == "arm"]
        in_doubt = {name for limb in open_ones for name in limb.joints}
        for name, limb in sorted(self.limbs.items(), key=lambda item: (item[1].margin, -len(item[1].joints))):
            alone = self.arm <= in_doubt and limb.role == "arm"  # something moves
            if limb.margin < MARGIN and limb.other != limb.role and not alone and not known & {"all", *limb.joints}:
                found.append(limb)
                known |= {*limb.joints, *self.tree[name].above}
        return tuple(found)

    def readings(self, name: str) -> dict[str, list[Sign]]:
        """Signs for every role of a branch that stands still, over one that moves."""
        seen, weights = self.seen(name), self.weights
        return {r: [Sign(text, weights[key][i], joint=of) for key, text, of in seen] for i, r in enumerate(STILL)}

    def seen(self, name: str) -> list[tuple[str, str, str]]:
        """Signs of a branch: of its shape, and every joint's name; keys of `WEIGHTS`, what is told, and the joint."""
        joints = self.tree[name].carried
        links = [link for joint in joints for link in self.rest.document.body(self.joint(joint).child)]
        loads = [text for link in links for text in (link, self.sensors.get(link, ""))]
        facts = self.of_place(name) | self.of_motion(name)
        facts |= {key: any(map(hint.search, loads)) for key, hint in LOADS.items()}
        named = [sign for joint in joints if joint in self.candidates for sign in self.of_name(joint)]
        return [(key, key, name) for key, seen in facts.items() if seen] + named

    def of_place(self, name: str) -> dict[str, bool]:
        """Whether there are the signs of its size and its place in the tree."""
        branch, tree = self.tree[name], self.tree
        led = {follower for follower, master in self.followers.items() if master in branch.carried}
        above = [up for up in branch.above if up in self.candidates]
        beside = [tree[other] for other in branch.beside if other in self.candidates | led]
        on_arm, ends = above[:1] == [*branch.above[:1]] != [], [n for n in branch.carried if not tree[n].below]
        longer = any(other.row > branch.row and other.reach > branch.reach for other in beside)
        free = all(self.joint(n).type in ("prismatic", "continuous") for n in ends)
        return {
            "most joints are an arm's": True,
            "it reaches less than a third as far as the longest chain": branch.reach < SHORT * self.longest,
            "it has four joints or more in a row": branch.row >= ROW,
            "three joints or more lead to it": len(above) >= WRIST,
            "one joint at most leads to it": len(above) <= 1,
            "it stands beside a longer branch": any(other.reach > branch.reach / SHORT for other in beside),
            "nothing stands beside it on an arm": on_arm and not beside,
            "nothing stands beside it on an arm, and it carries a joint": on_arm and not beside and branch.row > 1,
            "others stand beside it at the end of an arm": len(above) >= WRIST and bool(beside),
            "its like faces it": any(self.faces(name, other.carried[0]) for other in beside),
            "two that are alike hang on it": any(self.alike(*two) for two in combinations(branch.below, 2)),
            "it hangs on a rocker": not self.rockers.keys().isdisjoint(branch.above[:1]),
            "it is all at the height at which rockers turn": not above and self.level(branch),
            "it slides or spins at its end, beside a longer chain on an arm": on_arm and longer and free,
        }

    def joint(self, name: str) -> Joint:
        """A joint by its name."""
        return self.rest.document.joints[name]

    def level(self, branch: Branch) -> bool:
        """Whether a branch turns at the height at which a rocker does, all of it, within the radius of the wheels."""
        links = [link for name in branch.carried for link in self.rest.document.body(self.joint(name).child)]
        heights = [float(self.rest.placements[link][2, 3]) for link in links]
        pivots = [(float(self.rest.hub(self.joint(name))[2]), radius) for name, radius in self.rockers.items()]
        turns = all(self.joint(name).type != "prismatic" for name in branch.carried)
        return turns and any(all(abs(height - pivot) < radius for height in heights) for pivot, radius in pivots)

    def faces(self, name: str, other: str) -> bool:
        """Whether two short branches beside one another on a joint are alike."""
        one = self.tree[name]
        return self.alike(name, other) and one.reach < SHORT * self.longest and bool(one.above)

    def alike(self, name: str, other: str) -> bool:
        """Whether two branches are of one type and size, about or along parallel axes."""
        one, two, pair = self.tree[name], self.tree[other], (self.joint(name), self.joint(other))
        parallel = abs(float(product(*map(self.rest.axis, pair)))) > ALONG
        slides = {joint.type == "prismatic" for joint in pair}
        return abs(one.reach - two.reach) <= ALIKE * max(one.reach, two.reach) and parallel and len(slides) == 1

    def of_motion(self, name: str) -> dict[str, bool]:
        """Whether there are the signs of its joint: type, axis and travel."""
        joint, branch, rest = self.joint(name), self.tree[name], self.rest
        slides, alone, upright = joint.type == "prismatic", not branch.below, rest.is_vertical(joint)
        travel = joint.upper - joint.lower if slides and alone else math.inf
        before, first = map(self.joint, (*branch.above, name, name)[:2])
        along = rest.hub(before) - rest.hub(first)
        rolls = abs(float(product(rest.axis(before), along))) > ALONG * length(along) > 0
        across = abs(float(product(rest.axis(joint), rest.axis(before)))) < 1 - ALONG
        carried = [self.joint(led) for led in branch.carried if led != name]
        return {
            "it carries what turns without end about a level axis": any(
                j.turns_freely and rest.is_horizontal(j) for j in carried
            ),
            "it slides": slides,
            "it turns alone on a base": alone and not slides and not branch.above and bool(self.base.columns),
            "it slides by a few centimetres and carries no joint": travel <= STROKE,
            "it slides by two centimetres at most on the base and carries no joint": travel <= BUTTON
            and not branch.above,
            "it turns across the joint before it, which rolls": alone and not slides and rolls and across,
            "it turns by half a turn or more, to either side": alone
            and not (slides or branch.beside)
            and joint.lower < 0 < joint.upper
            and joint.upper - joint.lower > HALF,
            "it turns without end about an upright axis and carries no joint": upright
            and alone
            and joint.turns_freely
            and not any(self.joint(up).type != "prismatic" for up in branch.above),
        }

    @cached_property
    def sensors(self) -> dict[str, str]:
        """Types of the sensors that Gazebo has on links."""
        found = dict[str, str]()
        for sensor in self.rest.document.root.iterfind("gazebo//sensor"):
            link = next(block for block in sensor.iterancestors("gazebo")).get("reference", "")
            found[link] = f"{found.get(link, '')} {sensor.get('type', '')}"
        return found

    @cached_property
    def told(self) -> dict[str, set[str]]:
        """Words that tell nothing in the name of a joint, for the top of what it is on: those of all names on it."""
        found, every = dict[str, set[str]](), shared(self.candidates)
        joints = self.rest.document.joints.values()
        words = {word for joint in joints for word in words_of(f"{joint.name} {joint.child}")}
        if all(ROLE_OF.get(word.rstrip("s")) != "jaw" for word in words - FINGERS):
            every |= FINGERS
        for top in self.rest.document.moving_children(self.rest.document.root_link):
            names = [name for name in self.tree[top.name].carried if name in self.candidates]
            own = {word for word in shared(names) if ROLE_OF.get(word) in ("arm", "jaw")} if len(names) > 2 else set()
            found[top.name] = every | own
        return found

    def of_name(self, name: str) -> Iterable[tuple[str, str, str]]:
        """Signs of the name of a joint, else of its link's, and of the smallest group's that has it."""
        joint, told = self.joint(name), self.told[[name, *self.tree[name].above][-1]]
        texts = (joint.child,) if "_to_" in name else (name, joint.child)
        named = [(text, *role_named(text, told, joint.type != "prismatic")) for text in texts]
        text, role, word = next((one for one in named if one[1]), ("", "", ""))
        groups = sorted((group for group in self.groups if name in group.joints), key=lambda group: len(group.joints))
        by, where = next(((by, group) for group in groups if (by := role_named(group.name)[0])), ("", None))
        if role and role != by:
            yield f"names of {role}s", f"'{word}' in the name of '{text}'", name
        if where is not None:
            yield f"names of {by}s", f"'{where.name}' has '{name}' ({where.where})", name


def shared(names: Iterable[str]) -> set[str]:
    """Words of all of two names or more."""
    words = [{*words_of(name)} for name in names]
    return set.intersection(*words) if len(words) > 1 else set()


def own_reach(rest: AtRest, joint: Joint) -> float:
    """Reach of the body on a joint: to its farthest frame, or as a rod with that centre of mass would [m]."""
    hub = rest.hub(joint)
    frames = [math.dist(rest.placements[link][:3, 3], hub) for link in rest.document.body(joint.child)]
    rod = 2 * math.dist(rest.centre(joint.child), hub) if rest.mass(joint.child) > 0 else 0.0
    return max([*frames, rod])

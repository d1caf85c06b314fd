"""Roles of the joints that are not the base's: which branches of the tree are heads, jaws, sensors or buttons.

Every joint that moves by itself is the top of a *branch*: itself and what it carries. A branch moves, as part of an
arm, or stands still as one whole: as a head, the jaw of a gripper, a sensor that turns, or a button. Signs speak for
or against each of these over an arm, with the weights of `WEIGHTS` [nats]; the branches that stand still are those
whose scores have the largest sum. So the roles are found together: an arm is what carries its jaws. Names are one
sign among others, and what the files of controllers and of MoveIt group is another.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property

from ..elementary.matrices import length, product
from .groups import Group
from .signs import MARGIN, Sign, score, told_apart
from .urdf.document import Joint
from .urdf.shapes import AtRest

STILL = ("head", "jaw", "sensor", "button")  # roles of branches that stand still
WEIGHTS: dict[str, tuple[float, float, float, float]] = {  # of a sign for each of these over an arm; NEVER decides
    "most joints are an arm's": (-2.0, -2.0, -3.0, -6.0),
    "it reaches less than a third as far as the longest chain": (1.5, 1.5, 1.5, 0.0),
    "it reaches more than half as far as the longest chain": (-2.5, -3.0, -2.5, 0.0),
    "it has four joints or more in a row": (-3.0, -1.0, -4.0, -6.0),
    "it has three joints or fewer in a row": (0.5, 0.5, 0.0, 0.0),
    "three joints or more lead to it": (-1.0, 1.5, 0.0, -6.0),
    "one joint at most leads to it": (0.0, -2.0, 0.0, 0.0),
    "it stands beside a longer branch": (2.0, 1.0, 1.0, 1.0),
    "nothing stands beside it on an arm": (-2.0, -4.0, -1.0, 0.0),
    "nothing stands beside it on an arm, and it carries a joint": (0.0, -2.0, 0.0, 0.0),
    "others stand beside it at the end of an arm": (0.0, 1.5, 0.0, 0.0),
    "its like faces it": (-1.0, 2.5, -2.0, 0.0),
    "another joint follows it": (-0.5, 1.5, -1.0, -2.0),
    "it slides by a few centimetres and carries no joint": (-1.0, 1.0, -1.0, 0.0),
    "it slides by two centimetres at most on the base and carries no joint": (0.0, -1.0, 0.0, 8.0),
    "it slides": (0.0, 0.0, -3.0, 0.0),
    "it turns across the joint before it, which rolls": (0.0, 1.0, 0.0, 0.0),
    "it pans, and what it carries tilts": (1.0, -0.5, 0.0, 0.0),
    "it turns without end about an upright axis and carries no joint": (0.0, -2.0, 3.0, 0.0),
    "it carries what turns without end about a level axis": (-0.5, 0.0, 0.0, 0.0),
    "it carries a camera": (1.5, -0.5, 1.0, 0.0),
    "it carries a lidar": (0.5, -0.5, 2.5, 0.0),
    "it carries the frame of a tool": (-4.0, -2.0, -4.0, -4.0),
    "names of arms": (-5.0, -5.0, -5.0, -2.0),
    "names of heads": (6.0, -1.0, 2.0, 0.0),
    "names of jaws": (-1.0, 5.0, -1.0, 0.0),
    "names of sensors": (3.0, -1.0, 5.0, 0.0),
    "names of buttons": (0.0, 0.0, 0.0, 6.0),
}
SHORT, LONG = 1 / 3, 1 / 2  # fractions of the longest chain's reach
ROW, WRIST = 4, 3  # joints in a row that are more than a head's; joints that lead to a jaw
STROKE, BUTTON = 0.15, 0.02  # [m] longest travel of a jaw and of a button
ALIKE = 0.2  # reaches of two jaws differ by less than this fraction
ALONG = 0.9  # cosine of the largest angle between parallel directions
WORDS = {  # English, German, French, Spanish, Italian, Portuguese, and Chinese and Japanese in Latin letters
    "arm": "arm forearm upperarm shoulder elbow wrist flange lift lifter elevator torso waist trunk column telescope"
    " boom bucket fork schulter ellenbogen handgelenk unterarm oberarm hub saeule bras epaule coude poignet torse"
    " brazo hombro codo muneca cintura columna braccio spalla gomito polso busto braco ombro cotovelo punho"
    " jian zhou wan yao ude kata hiji tekubi koshi",
    "head": "head neck eye gaze kopf hals nacken tete cou cabeza cuello testa collo cabeca pescoco tou jing kubi atama",
    "jaw": "gripper grip grasper finger fingertip thumb index middle little knuckle jaw claw clamp pinch hand palm"
    " griffe pince doigt mors pinza garra dedo mano dito greifer klaue backe zange zhua jiazhua shou hasami yubi",
    "sensor": "camera cam gimbal lidar laser radar scanner lds sonar antenna antenne antena kamera fotocamera",
    "button": "button bumper knopf taste bouton boton bottone botao",
}
ROLE_OF = {word: role for role, words in WORDS.items() for word in words.split()}
WEAK = dict.fromkeys(("pan", "tilt", "mast"), "head")  # said of shoulders, too
TOOL = re.compile(
    r"tool0|(?:^|_)(?:tcp|tool|ee|eef)(?:_|$)|end_?effector|flange|grip(?:per)?_frame|grasp", re.IGNORECASE
)
LOADS = {
    "a camera": re.compile(r"camera|kinect|realsense|zed|xtion|d4[0-9]5|kamera", re.IGNORECASE),
    "a lidar": re.compile(r"lidar|laser|hokuyo|velodyne|rplidar|\bray\b", re.IGNORECASE),
    "the frame of a tool": TOOL,
}
LETTERS = re.compile(r"[A-Z]?[a-z]+|[A-Z]+(?![a-z])")


def role_named(name: str, told: Iterable[str] = (), turns: bool = True) -> tuple[str, str]:
    """The role that a name states and its word for it, the last of several: nouns stand last; empty without one.

    Args:
        name: Of a joint, a link or a group.
        told: Words that tell nothing.
        turns: Whether it is of a joint that turns: what slides neither pans nor is a mast for a camera.
    """
    words = [word for text in LETTERS.findall(name) if (word := text.lower()) not in told]
    for table in (ROLE_OF, WEAK if turns else {}):
        for word in reversed(words):
            found = next((w for w in (word, word.rstrip("s"), word[1:] * (word[0] in "lr")) if w in table), "")
            if found:
                return table[found], found
    return "", ""


@dataclass(frozen=True)
class Branch:
    """A joint and what it carries.

    Attributes:
        reach: How far it reaches from its joint, along the longest path of joints and links [m].
        carried: Itself and all joints on it.
        above: Joints that lead to it.
        beside: Other joints on the body that carries it.
        below: Joints that hang on its own body.
        row: Joints in its longest row.
    """

    reach: float
    carried: tuple[str, ...]
    above: tuple[str, ...]
    beside: tuple[str, ...]
    below: tuple[str, ...]
    row: int


@dataclass(frozen=True)
class Limb:
    """How a branch is taken.

    Attributes:
        joints: Joints on it that may move by themselves, its own first.
        role: `arm` where it moves, else one of `STILL`.
        other: What else it may be.
        signs: What speaks for a branch that stands still over one that moves.
        margin: By how much the role beats the other [nats].
    """

    joints: tuple[str, ...]
    role: str
    other: str
    signs: tuple[Sign, ...]
    margin: float

    @property
    def told(self) -> list[str]:
        """Signs that tell its role from the other, the strongest first."""
        return told_apart((), self.signs) if self.role == "arm" else told_apart(self.signs, ())

    @property
    def option(self) -> str:
        """Options that make it the other."""
        return " ".join(f"--{'lock' if self.role == 'arm' else 'free'} {joint}" for joint in self.joints)


@dataclass(frozen=True, eq=False)
class Limbs:
    """The branches of a robot and their roles.

    Attributes:
        rest: The robot at rest.
        candidates: Joints that may move by themselves.
        followers: Joints that follow others, with those.
        groups: Joints that files of its controllers and of MoveIt name together.
        weights: Of every sign, as `WEIGHTS` has them.
    """

    rest: AtRest
    candidates: frozenset[str]
    followers: Mapping[str, str]
    groups: tuple[Group, ...] = ()
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
            found[name] = Limb(joints, *roles, tuple(signs), abs(still - moves))
        if not any(limb.role == "arm" for limb in found.values()):  # what else is there to move?
            found |= {name: replace(limb, role="arm") for name, limb in found.items() if limb.role in ("head", "jaw")}
        return found

    @cached_property
    def roles(self) -> dict[str, str]:
        """The role of every candidate: of the branch that it is on, `arm` where that moves."""
        tops = sorted(self.limbs, key=lambda name: len(self.tree[name].above))
        return {joint: self.limbs[top].role for top in tops for joint in self.limbs[top].joints}

    def is_jaw(self, name: str) -> bool:
        """Whether a joint is of a jaw, or follows one that is."""
        return self.roles.get(self.followers.get(name, name)) == "jaw"

    @property
    def arm(self) -> list[str]:
        """Joints of the arm."""
        return [name for name, role in self.roles.items() if role == "arm"]

    def doubts(self, said: Iterable[str]) -> tuple[Limb, ...]:
        """Branches whose roles beat others by little, one of every chain; none of those that the user speaks of."""
        found, known = list[Limb](), {*said}
        for name, limb in sorted(self.limbs.items(), key=lambda item: item[1].margin):
            alone = {*self.arm} <= {*limb.joints} and limb.other in ("head", "jaw")  # it would be the arm all the same
            if limb.margin < MARGIN and limb.other != limb.role and not alone and not known & {"all", *limb.joints}:
                found.append(limb)
                known |= {*limb.joints, *self.tree[name].above}
        return tuple(found)

    def readings(self, name: str) -> dict[str, list[Sign]]:
        """Signs for every role of a branch that stands still, over one that moves."""
        seen = self.seen(name)
        weigh = self.weights.__getitem__
        return {role: [Sign(text, weigh(key)[i], joint=of) for key, text, of in seen] for i, role in enumerate(STILL)}

    def seen(self, name: str) -> list[tuple[str, str, str]]:
        """Signs of a branch: of its shape, and every joint's name; keys of `WEIGHTS`, what is told, and the joint."""
        carried = self.tree[name].carried
        load = {key for joint in carried for key in self.loads[joint]}
        keys = ("most joints are an arm's", *self.of_place(name), *self.of_motion(name), *sorted(load))
        return [*((key, key, name) for key in keys), *(one for joint in carried for one in self.named.get(joint, ()))]

    def of_place(self, name: str) -> Iterable[str]:
        """Signs of its size and its place in the tree."""
        branch = self.tree[name]
        led = {follower for follower, master in self.followers.items() if master in branch.carried}
        if branch.reach < SHORT * self.longest:
            yield "it reaches less than a third as far as the longest chain"
        elif branch.reach >= LONG * self.longest and not self.candidates <= {*branch.carried}:
            yield "it reaches more than half as far as the longest chain"
        yield f"it has {'four joints or more' if branch.row >= ROW else 'three joints or fewer'} in a row"
        above, beside = (
            [up for up in branch.above if up in self.candidates],
            [n for n in branch.beside if n in self.candidates | led],
        )
        if len(above) >= WRIST:
            yield "three joints or more lead to it"
        elif len(above) <= 1:
            yield "one joint at most leads to it"
        if any(self.tree[other].reach > branch.reach / SHORT for other in beside):
            yield "it stands beside a longer branch"
        if not beside and branch.above and branch.above[0] in self.candidates:
            yield "nothing stands beside it on an arm"
            if branch.row > 1:
                yield "nothing stands beside it on an arm, and it carries a joint"
        if beside and len(above) >= WRIST:
            yield "others stand beside it at the end of an arm"
        if any(self.faces(name, other) for other in beside):
            yield "its like faces it"

    def faces(self, name: str, other: str) -> bool:
        """Whether two short branches beside one another are of one type and size, about or along parallel axes."""
        one, two, joints = self.tree[name], self.tree[other], self.rest.document.joints
        alike = abs(one.reach - two.reach) <= ALIKE * max(one.reach, two.reach)
        parallel = abs(float(product(self.rest.axis(joints[name]), self.rest.axis(joints[other])))) > ALONG
        slides = {joints[name].type == "prismatic", joints[other].type == "prismatic"}
        return alike and parallel and len(slides) == 1 and one.reach < SHORT * self.longest and bool(one.above)

    def of_motion(self, name: str) -> Iterable[str]:
        """Signs of its joint: type, axis and travel."""
        joint, branch, rest = self.rest.document.joints[name], self.tree[name], self.rest
        if any(self.followers.get(led) == name for led in self.followers if led in (*branch.beside, *branch.carried)):
            yield "another joint follows it"
        joints = [rest.document.joints[led] for led in branch.carried if led != name]
        if any(j.turns_freely and rest.is_horizontal(j) for j in joints):
            yield "it carries what turns without end about a level axis"
        travel, alone = joint.upper - joint.lower, not branch.below
        if joint.type == "prismatic" and alone and travel <= STROKE:
            yield "it slides by a few centimetres and carries no joint"
            if travel <= BUTTON and not branch.above:
                yield "it slides by two centimetres at most on the base and carries no joint"
        if joint.type == "prismatic":
            yield "it slides"
            return
        before, first = (rest.document.joints[name] for name in (*branch.above, name, name)[:2])
        along = rest.hub(before) - rest.hub(first)
        rolls = abs(float(product(rest.axis(before), along))) > ALONG * length(along) > 0
        if alone and rolls and abs(float(product(rest.axis(joint), rest.axis(before)))) < 1 - ALONG:
            yield "it turns across the joint before it, which rolls"
        if rest.is_vertical(joint):
            if branch.row == 2 and [rest.is_horizontal(rest.document.joints[n]) for n in branch.below] == [True]:
                yield "it pans, and what it carries tilts"
            if alone and joint.turns_freely:
                yield "it turns without end about an upright axis and carries no joint"

    @cached_property
    def loads(self) -> dict[str, set[str]]:
        """Signs of the links and sensors on the body of every joint."""
        document, sensors = self.rest.document, dict[str, list[str]]()
        for block in document.root.iterchildren("gazebo"):
            kinds = [sensor.get("type", "") for sensor in block.iter("sensor")]
            sensors.setdefault(block.get("reference", ""), []).extend(kinds)
        found = dict[str, set[str]]()
        for name in self.tree:
            links = document.body(document.joints[name].child)
            texts = [*links, *(kind for link in links for kind in sensors.get(link, ()))]
            found[name] = {f"it carries {key}" for key, hint in LOADS.items() if any(map(hint.search, texts))}
        return found

    @cached_property
    def named(self) -> dict[str, list[tuple[str, str, str]]]:
        """Signs of the name of every joint, else of its link's, and of the smallest group's that has it.

        Words in all names tell nothing, nor does a jaw's in all names that hang on one joint of the base.
        """
        words, root = {name: words_of(name) for name in self.candidates}, self.rest.document.root_link
        every, found = common(words.values()), dict[str, list[tuple[str, str, str]]]()
        for top in self.rest.document.moving_children(root):
            branch = [name for name in self.tree[top.name].carried if name in words]
            ours = common(words[name] for name in branch) if len(branch) > 2 else set()
            told = {w for w in every if ROLE_OF.get(w) != "arm"} | {w for w in ours if ROLE_OF.get(w) == "jaw"}
            found |= {name: list(self.of_name(name, told)) for name in branch}
        return found

    def of_name(self, name: str, told: set[str]) -> Iterable[tuple[str, str, str]]:
        """Signs of the name of a joint; words that are told mean nothing."""
        joint = self.rest.document.joints[name]
        texts = (joint.child,) if "_to_" in name else (name, joint.child)
        named = [(text, *role_named(text, told, joint.type != "prismatic")) for text in texts]
        text, role, word = next((one for one in named if one[1]), ("", "", ""))
        groups = sorted((group for group in self.groups if name in group.joints), key=lambda group: len(group.joints))
        by, where = next(((by, group) for group in groups if (by := role_named(group.name)[0])), ("", None))
        if role and role != by:
            yield f"names of {role}s", f"'{word}' in the name of '{text}'", name
        if where is not None:
            yield f"names of {by}s", f"'{where.name}' has '{name}' ({where.where})", name


def common(names: Iterable[set[str]]) -> set[str]:
    """Words of all of two names or more."""
    names = list(names)
    return set.intersection(*names) if len(names) > 1 else set()


def words_of(name: str) -> set[str]:
    """The words of a name."""
    return {text.lower() for text in LETTERS.findall(name)}


def own_reach(rest: AtRest, joint: Joint) -> float:
    """Reach of the body on a joint: to its farthest frame, or as a rod with that centre of mass would [m]."""
    hub = rest.hub(joint)
    frames = [math.dist(rest.placements[link][:3, 3], hub) for link in rest.document.body(joint.child)]
    rod = 2 * math.dist(rest.centre(joint.child), hub) if rest.mass(joint.child) > 0 else 0.0
    return max([*frames, rod])

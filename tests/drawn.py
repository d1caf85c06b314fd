"""Robots of drawn structure for tests, as files whose order, names, frames, motors and meshes are drawn, too."""

from __future__ import annotations

import random
import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cache
from typing import Any

import numpy as np
from drives import CYLINDER, LIMIT, LYING_CYLINDER, joint, link, origin
from lxml import etree
from steered import ARM, LAYOUTS, urdf_of

Pick = Callable[[Sequence[Any]], Any]
TURNS = (0.0, np.pi, np.pi / 2, -np.pi / 2)
WORDS = {  # honest words, and those of other languages
    "german": {"left": "links", "right": "rechts", "front": "vorne", "rear": "hinten", "wheel": "rad", "caster":
               "lenkrolle", "arm": "gelenk", "jaw": "backe", "head": "kopf", "steer": "lenk", "drive": "antrieb",
               "lift": "hub"},
    "french": {"left": "gauche", "right": "droite", "front": "avant", "rear": "arriere", "wheel": "roue", "caster":
               "roulette", "arm": "bras", "jaw": "doigt", "head": "tete", "steer": "direction", "hitch": "remorque"},
    "swapped": {"left": "right", "right": "left", "front": "rear", "rear": "front"},
}  # fmt: skip


@dataclass(frozen=True)
class Made:
    """A robot of drawn structure, and the truth about it."""

    text: str  # the URDF
    kind: str  # of its base
    wheels: frozenset[str]  # joints of its wheels; of a base that does not steer those that drive
    pivots: frozenset[str]  # joints that steer, or on which trailers follow
    motors: frozenset[str]  # all joints of the base that have motors
    arm: frozenset[str]  # joints of its arm; those of a head where there is none
    drums: frozenset[str] = frozenset()  # endless joints at the ends of booms, which may be counted with these or not
    forward: tuple[float, float] | None = (1.0, 0.0)  # (2,) in the root link; None where nobody could know it
    radius: float = 0.1  # of its drive wheels [m]


# -- structures --------------------------------------------------------------------------------------------------------


def wheel(name: str, x: float, y: float, radius: float, yaw: float = 0.0, parent: str = "base", z: float = 0.0) -> str:
    """A cylinder on an endless level joint, at a height over the floor."""
    R = np.array([[np.cos(yaw), -np.sin(yaw), 0], [np.sin(yaw), np.cos(yaw), 0], [0, 0, 1]])
    body = link(f"{name}_link", 1.0, 0.004, CYLINDER.format(r=radius), LYING_CYLINDER)
    return body + joint(name, "continuous", parent, f"{name}_link", R, (x, y, radius + z))


def caster(name: str, x: float, y: float, radius: float, trail: float) -> str:
    """A wheel on a swivel."""
    swivel = link(f"{name}_link", 0.3, 0.001)
    swivel += joint(name, "continuous", "base", f"{name}_link", p=(x, y, 2.5 * radius), axis=(0, 0, 1))
    return swivel + wheel(f"{name}_wheel", -trail, 0.0, radius, parent=f"{name}_link", z=-2.5 * radius)


def chassis(pick: Pick, kind: str) -> Made:
    """A base that does not steer: wheels on a box, and casters or balls."""
    r, half = pick((0.1, 0.06, 0.2)), pick((0.25, 0.2))
    text = link("base", 30.0, 1.0, '<box size="0.6 0.35 0.2"/>', origin(p=(0, 0, 2 * r + 0.1)))
    if kind == "differential_drive":
        places = [("left_wheel", 0.0, half, 0.0), ("right_wheel", 0.0, -half, 0.0)]
        for k, (x, y) in enumerate(((-0.25, 0.0), (0.25, 0.0), (-0.25, 0.1), (0.25, 0.1))[: pick(range(5))]):
            if pick((True, False)):
                text += caster(f"caster_{k}", x, y, 0.4 * r, pick((0.03, 0.1, 0.012, 0.005, 0.0)))
            else:
                text += link(f"ball_{k}", 0.1, 1e-4, f'<sphere radius="{0.3 * r}"/>')
                text += joint(f"ball_{k}_mount", "fixed", "base", f"ball_{k}", p=(x, y, 0.3 * r))
    elif kind == "omni":
        n, start = pick((3, 4)), pick((0.0, np.pi / 4))
        angles = [start + 2 * np.pi * k / n for k in range(n)]
        places = [(f"wheel_{k}", *polar(0.3, a), a + np.pi / 2) for k, a in enumerate(angles)]
    else:
        rows = {"front": 0.25, "rear": -0.25}
        rows |= {"middle": 0.0} if kind == "skid_steer" and pick((False, True)) else {}
        mark, sides = "mecanum_" * (kind == "mecanum"), {"left": half, "right": -half}
        places = [(f"{row}_{s}_{mark}wheel", x, y, 0.0) for row, x in rows.items() for s, y in sides.items()]
    text += "".join(wheel(name, x, y, r, yaw) for name, x, y, yaw in places)
    names = frozenset(name for name, *_ in places)
    title = "tracked_robot" if kind == "tracked" else "robot"
    kind = {"omni": "holonomic", "mecanum": "holonomic"}.get(kind, kind)
    return Made(f'<robot name="{title}">{text}</robot>', kind, names, frozenset(), names, frozenset(), radius=r)


def moving(name: str, kind: str, on: str, at, axis, most: float, mass: float = 0.5, inertia: float = 2e-3) -> str:
    """A link on a joint with limits."""
    low = 0 if kind == "prismatic" else -most
    return link(f"{name}_link", mass, inertia) + joint(
        name, kind, on, f"{name}_link", p=at, axis=axis, more=LIMIT.format(low, most)
    )


def polar(r: float, angle: float) -> tuple[float, float]:
    return r * float(np.cos(angle)), r * float(np.sin(angle))


@cache
def layout(name: str) -> Made:
    """A base that steers, of `steered`, with its arm of three."""
    base = LAYOUTS[name]()
    wheels, pivots = frozenset(w.joint for w in base.wheels), frozenset(p.joint for p in base.pivots)
    made = Made(urdf_of(base), base.kind, wheels, pivots, frozenset(base.driven), frozenset(ARM))
    return replace(made, forward=polar(1.0, float(base.frame[2])), radius=base.wheels[0].radius)


def with_limbs(made: Made, pick: Pick) -> Made:
    """With an arm, jaws, a head, a lidar, drums on arms, as drawn."""
    text, arm, drums, mount, z = "", list[str](), list[str](), "base", 0.5
    if not made.arm and pick((True, False)):
        if pick((False, True)):
            text += moving("lift", "prismatic", mount, (0, 0, z), (0, 0, 1), 0.4)
            mount, z, arm = "lift_link", 0.2, ["lift"]
        for k, axis in enumerate(("001", "010", "010", "100", "010", "100")[: pick((3, 6, 4))], 1):
            text += moving(f"arm_{k}", "revolute", mount, (0.05, 0, z), tuple(map(int, axis)), 2, 2.0, 0.01)
            arm, mount, z = [*arm, f"arm_{k}"], f"arm_{k}_link", 0.2
        for side, y in (("left", 0.03), ("right", -0.03)) if pick((True, False)) else ():
            text += moving(f"{side}_jaw", "prismatic", mount, (0, y, 0.08), (0, 1, 0), 0.03, 0.1, 1e-4)
    if pick((False, True)):
        text += moving("head_pan", "revolute", "base", (-0.2, 0, 0.9), (0, 0, 1), 2)
        text += moving("head_tilt", "revolute", "head_pan_link", (0, 0, 0.08), (0, 1, 0), 2)
        text += link("head_camera", 0) + joint("eye", "fixed", "head_tilt_link", "head_camera", p=(0.05, 0, 0))
    if pick((False, True)):
        text += link("lidar_link", 0.2, 1e-3)
        text += joint("lidar_spin", "continuous", "base", "lidar_link", p=(0.2, 0, 0.45), axis=(0, 0, 1))
    booms = made.kind in ("skid_steer", "differential_drive") and (arm or "head_pan" not in text)
    for k, x in enumerate((0.45, -0.45)) if booms and pick((False, False, True)) else ():
        text += moving(f"boom_{k}", "revolute", "base", (x, 0, 0.3), (0, 1, 0), 2, 1.0, 0.01)
        text += wheel(f"drum_{k}", 0.2 * np.sign(x), 0.0, 0.8 * made.radius, parent=f"boom_{k}_link", z=-0.15)
        arm, drums = [*arm, f"boom_{k}"], [*drums, f"drum_{k}"]
    if not arm and not made.arm and "head_pan" in text:
        arm = ["head_pan", "head_tilt"]
    whole = made.text.replace("</robot>", f"{text}</robot>")
    return replace(made, text=whole, arm=frozenset((*made.arm, *arm)), drums=frozenset(drums))


# -- how a file is written ---------------------------------------------------------------------------------------------


def turned(made: Made, angle: float) -> Made:
    """With another frame of the root link."""
    root = etree.fromstring(made.text)
    children = {e.find("child").get("link") for e in root.iterchildren("joint")}
    top = next(e for e in root.iterchildren("link") if e.get("name") not in children)
    owners = [*top, *(e for e in root.iterchildren("joint") if e.find("parent").get("link") == top.get("name"))]
    c, s = np.cos(angle), np.sin(angle)
    for element in owners:
        place = element.find("origin")
        if place is None:
            place = etree.SubElement(element, "origin")
        x, y, z = map(float, place.get("xyz", "0 0 0").split())
        roll, pitch, yaw = map(float, place.get("rpy", "0 0 0").split())
        place.set("xyz", f"{float(c * x - s * y)!r} {float(s * x + c * y)!r} {z!r}")
        place.set("rpy", f"{roll!r} {pitch!r} {yaw + angle!r}")
    x, y = made.forward or (0.0, 0.0)
    forward = None if made.forward is None else (float(c * x - s * y), float(s * x + c * y))
    return replace(made, text=etree.tostring(root).decode(), forward=forward)


def renamed(made: Made, new: Callable[[str], str]) -> Made:
    """With other names of joints and links."""
    root = etree.fromstring(made.text)
    table = {e.get("name"): new(e.get("name")) for e in root if e.tag in ("joint", "link")}
    if len(set(table.values())) < len(table):
        return made
    for e in root.iter("joint", "link", "parent", "child", "mimic"):
        for key in ("name", "link", "joint"):
            if e.get(key) in table:
                e.set(key, table[e.get(key)])
    sets = {
        key: frozenset(table[n] for n in getattr(made, key)) for key in ("wheels", "pivots", "motors", "arm", "drums")
    }
    return replace(made, text=etree.tostring(root).decode(), **sets)


def neutral(made: Made) -> Made:
    """With names that tell nothing."""
    root = etree.fromstring(made.text)
    root.set("name", "machine")
    numbers = {e.get("name"): f"{e.tag[0]}{k}" for k, e in enumerate(root)}
    return renamed(replace(made, text=etree.tostring(root).decode()), numbers.__getitem__)


def in_words(language: str) -> Callable[[str], str]:
    """Names with the words of a language."""
    return lambda name: "_".join(WORDS[language].get(word, word) for word in name.split("_"))


def shuffled(made: Made, seed: int) -> Made:
    """With joints and links in another order."""
    root = etree.fromstring(made.text)
    parts = list(root)
    random.Random(seed).shuffle(parts)
    root[:] = parts
    return replace(made, text=etree.tostring(root).decode())


def unseen(made: Made) -> Made:
    """With a missing visual mesh on every wheel, beside the collision shape that was there."""
    mesh = '<visual><geometry><mesh filename="package://nowhere/wheel.stl"/></geometry></visual>'
    ends = re.sub(r"(<link name=\"[^\"]*wheel_link\">)", rf"\1{mesh}", made.text)
    return replace(made, text=ends)


def powered(made: Made, names: Sequence[str]) -> Made:
    """With transmissions of some joints."""
    blocks = "".join(f'<transmission name="t_{n}"><joint name="{n}"/></transmission>' for n in sorted(names))
    return replace(made, text=made.text.replace("</robot>", f"{blocks}</robot>"))


def made_by(pick: Pick, kinds: Sequence[str]) -> Made:
    """A robot as drawn; what nobody could know of it is no part of the truth."""
    kind = pick(kinds)
    made = layout(kind) if kind in LAYOUTS else chassis(pick, kind)
    made = with_limbs(made, pick)
    motors = pick(("none", "right", "all"))
    made = unseen(made) if pick((False, False, True)) else made
    angle = pick(TURNS)
    made = turned(made, angle)
    names = pick(("honest", "neutral", *WORDS))
    if motors == "right":
        made = powered(made, [*made.motors, *made.arm])
    elif motors == "all":
        free = re.findall(r'<joint name="((?!caster_\d"|hitch)[^"]*)" type="(?!fixed)', made.text)
        made = powered(made, free)
    if names == "neutral":
        made = neutral(replace(made, kind="skid_steer" if kind == "tracked" else made.kind))
    elif names != "honest":
        made = renamed(made, in_words(names))
    if pick((False, True)):
        made = renamed(made, lambda name: f"robot1_{name}")
    told = angle in (0.0, *TURNS[2:]) and names != "neutral" and kind in ("skid_steer", "differential_drive", "mecanum")
    known = kind != "omni" and names != "swapped" and (angle == 0.0 or told)
    return made if known else replace(made, forward=None)


KINDS_MADE = ("differential_drive", "skid_steer", "mecanum", "omni", "tracked", *LAYOUTS)

"""Numbers that are missing, no numbers, not finite, not as many as needed, or negative where they are sizes."""

from __future__ import annotations

import math
from collections.abc import Iterator
from functools import lru_cache

from lxml import etree

from .finding import Finding, finding
from .reading import NUMBER, Own, numbers, read_numbers
from .xml import XACRO_FIX

# Attributes that hold numbers: how many, by element; those in REQUIRED must be there.
NUMBERS: dict[str, dict[str, int]] = {
    "origin": {"xyz": 3, "rpy": 3},
    "axis": {"xyz": 3},
    "mass": {"value": 1},
    "inertia": dict.fromkeys(("ixx", "ixy", "ixz", "iyy", "iyz", "izz"), 1),
    "limit": dict.fromkeys(("lower", "upper", "effort", "velocity"), 1),
    "dynamics": {"damping": 1, "friction": 1},
    "mimic": {"multiplier": 1, "offset": 1},
    "safety_controller": dict.fromkeys(("soft_lower_limit", "soft_upper_limit", "k_position", "k_velocity"), 1),
    "calibration": {"rising": 1, "falling": 1},
    "cylinder": {"radius": 1, "length": 1},
    "capsule": {"radius": 1, "length": 1},
    "sphere": {"radius": 1},
    "box": {"size": 3},
    "mesh": {"scale": 3},
    "color": {"rgba": 4},
}
REQUIRED: dict[str, tuple[str, ...]] = {
    "axis": ("xyz",),
    "mass": ("value",),
    "inertia": tuple(NUMBERS["inertia"]),
    "limit": ("effort", "velocity"),
    "safety_controller": ("k_velocity",),
    "cylinder": ("radius", "length"),
    "capsule": ("radius", "length"),
    "sphere": ("radius",),
    "box": ("size",),
    "mesh": ("filename",),
    "mimic": ("joint",),
}
SIZES = {"cylinder": ("radius", "length"), "capsule": ("radius", "length"), "sphere": ("radius",), "box": ("size",)}


def bad_numbers(own: Own) -> Iterator[Finding]:
    """Attributes that should hold finite numbers and do not; the others are left with single blanks, none around them.

    Pinocchio's parser drops a whole `<inertial>` over a blank after a mass, a tab or a no-break space.
    """
    for tag, needed in REQUIRED.items():
        for element in own[tag]:
            for key in needed:
                if element.get(key) is None:
                    yield finding("missing-value", element, f"{key} of <{tag}> is missing", why(tag), "state it")
    for element, tag, items in own.texts:
        counts = NUMBERS.get(tag, {})
        for key, text in items:
            if key not in counts or "$" in text:
                continue
            problem, plain = number_problem(text, counts[key]), plainly(text)
            if problem:
                code = "vector-length" if "number(s)" in problem else "number"
                fix = f"give {counts[key]} finite number(s) in SI units"
                yield finding(code, element, f"{key} of <{tag}> {problem}", why(tag), fix)
            elif plain != text:
                element.set(key, plain)


@lru_cache(maxsize=8192)
def plainly(text: str) -> str:
    """Words with single blanks between them."""
    return " ".join(text.split())


def unexpanded(own: Own) -> Iterator[Finding]:
    """`${...}` and `$(...)`, which xacro would have expanded."""
    for element, _, items in own.texts:
        for key, text in items:
            if "$" in text and ("${" in text or "$(" in text):
                what = f"{key} '{text}' is an unexpanded xacro expression"
                yield finding("xacro", element, what, fix=XACRO_FIX)


def incomplete(own: Own) -> Iterator[Finding]:
    """`<inertial>` without mass or inertia, and empty `<dynamics>`, both of which loaders trip over."""
    for inertial in own["inertial"]:
        for tag in ("mass", "inertia"):
            if inertial.find(tag) is None:
                yield finding("missing-value", inertial, f"<{tag}> is missing", why(tag), f"add <{tag}>")
    for dynamics in own["dynamics"]:
        if dynamics.get("damping") is None and dynamics.get("friction") is None:
            reason, fix = "Pinocchio's parser refuses the joint", "state damping or friction, or delete it"
            yield finding("missing-value", dynamics, "<dynamics> states nothing", reason, fix)


def why(tag: str) -> str:
    """What a bad number in an element leads to."""
    return "the whole inertial would be dropped" if tag in ("mass", "inertia") else ""


@lru_cache(maxsize=8192)
def number_problem(text: str, count: int) -> str:
    """What is wrong with a list of numbers, empty when nothing is."""
    values = read_numbers(text)
    for word, value in zip(text.split(), values, strict=True):
        if math.isnan(value) and NUMBER.fullmatch(word):
            return f"is '{text}': '{word}' is beyond what a double holds"
        if math.isnan(value):
            hint = " (decimal comma?)" if "," in word else ""
            return f"is '{text}': '{word}' is not a finite number{hint}"
    return "" if len(values) == count else f"is '{text}': {len(values)} number(s) where {count} are needed"


def bad_shapes(own: Own) -> Iterator[Finding]:
    """Shapes without a size, with a negative one, or without a shape."""
    for holder in (*own["visual"], *own["collision"]):
        shapes = (body.tag for geometry in holder.iterchildren("geometry") for body in geometry)
        if not any(tag in SIZES or tag == "mesh" for tag in shapes):
            reason, fix = "it is left out", "give a box, cylinder, sphere or mesh"
            yield finding("no-shape", holder, f"<{holder.tag}> has no shape that URDF knows", reason, fix)
    for tag in (*SIZES, "mesh"):
        for body in own[tag]:
            yield from bad_sizes(body)


def bad_sizes(body: etree._Element) -> Iterator[Finding]:
    """Negative and zero sizes of one shape."""
    for key in SIZES.get(body.tag, ()):
        least = min(numbers(body, key, (1.0,) * NUMBERS[body.tag][key]))
        what, fix = f"{key} of <{body.tag}> is '{body.get(key)}'", "give a positive size [m]"
        if least < 0:
            yield finding("negative-size", body, f"{what}: negative", "a size is at least 0", fix)
        elif least == 0:
            yield finding("zero-size", body, f"{what}: zero", "taken as it is", fix)
    if body.tag == "mesh" and 0 in numbers(body, "scale", (1.0, 1.0, 1.0)):
        yield finding("zero-size", body, "scale of <mesh> is zero", "taken as it is", "give a scale other than 0")

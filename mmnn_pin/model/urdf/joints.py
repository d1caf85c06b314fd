"""Joints: types, axes, limits, friction, mimics."""

from __future__ import annotations

import math
from collections.abc import Iterator

from lxml import etree

from .finding import Finding, finding
from .reading import number, numbers
from .tags import nearest
from .tree import circles

JOINT_TYPES = ("revolute", "continuous", "prismatic", "fixed", "floating", "planar")
NOT_UNIT = 1e-3  # axes are printed with a few digits


def bad_joints(root: etree._Element) -> Iterator[Finding]:
    """What is wrong with each joint taken alone."""
    for joint in root.iterchildren("joint"):
        kind = joint.get("type")
        if kind not in JOINT_TYPES:
            meant = nearest(kind or "", frozenset(JOINT_TYPES))
            fix = f"did you mean '{meant}'?" if meant else f"one of {', '.join(JOINT_TYPES)}"
            why = f"known are {', '.join(JOINT_TYPES)}" if meant else ""
            yield finding("joint-type", joint, f"type '{kind}' is unknown" if kind else "has no type", why, fix)
        if kind in ("revolute", "continuous", "prismatic", "planar"):
            yield from bad_axis(joint)
        yield from bad_limit(joint, kind or "")
        dynamics = joint.find("dynamics")
        for key in ("damping", "friction"):
            if number(dynamics, key, 0.0) < 0:
                why, fix = "it would feed energy into the robot", "give a value of at least 0"
                yield finding("negative-friction", dynamics, f"{key} is negative", why, fix)


def bad_axis(joint: etree._Element) -> Iterator[Finding]:
    """An axis that is zero, not a unit vector, or not stated."""
    axis = joint.find("axis")
    if axis is None and joint.get("type") != "planar":
        yield finding("no-axis", joint, "has no <axis>", "assumed 1 0 0, as URDF has it", "state it")
    if axis is None:
        return
    length = math.hypot(*numbers(axis, "xyz"))
    if length < 1e-9:
        yield finding("zero-axis", axis, "axis is zero", "the mass matrix would be singular", "give its direction")
    elif abs(length - 1) > NOT_UNIT:
        what = f"axis '{axis.get('xyz')}' has length {length:.4g}"
        yield finding("axis-not-unit", axis, what, "assumed: its direction alone", "give a unit vector")


def bad_limit(joint: etree._Element, kind: str) -> Iterator[Finding]:
    """Limits that are missing, reversed, empty, negative, or zero."""
    limit = joint.find("limit")
    limited = kind in ("revolute", "prismatic")
    if limit is None:
        if limited:
            yield finding("no-limit", joint, "<limit> is missing", f"a {kind} joint needs it", "add it")
        return
    lower, upper = number(limit, "lower", 0.0), number(limit, "upper", 0.0)
    if limited and lower > upper:
        what = f"lower limit {lower:g} is above the upper one, {upper:g}"
        yield finding("limit-order", limit, what, "no position is allowed", "swap them")
    if limited and lower == upper:
        what = f"lower and upper limit are both {lower:g}"
        fix = "state lower and upper, or make the joint continuous or fixed"
        yield finding("limit-empty", limit, what, "taken as it is: the joint cannot move", fix)
    for key in ("effort", "velocity"):
        if number(limit, key, 0.0) < 0:
            yield finding("limit-negative", limit, f"{key} is negative", "a limit is at least 0", "give its magnitude")
    if kind != "fixed" and limit.get("effort") is not None and number(limit, "effort", 0.0) == 0:
        why = "assumed: no limit, a motor of 0 could not move it"
        yield finding("zero-effort", limit, "effort limit is 0", why, "state the largest torque or force")


def bad_mimics(root: etree._Element) -> Iterator[Finding]:
    """Mimics of a joint that is not there, of themselves, or in a circle."""
    mimics = {joint.get("name", ""): joint.find("mimic") for joint in root.iterchildren("joint")}
    masters = {name: mimic.get("joint", "") for name, mimic in mimics.items() if mimic is not None}
    for name, master in masters.items():
        if master and master not in mimics:
            what = f"mimics joint '{master}', which does not exist"
            yield finding("mimic-ghost", mimics[name], what, "nothing would move it", "name an existing joint")
        elif master == name:
            why = "nothing would move it"
            yield finding("mimic-self", mimics[name], "mimics itself", why, "name another joint, or delete <mimic>")
    for circle in circles({name: master for name, master in masters.items() if name != master}):
        at = min((mimics[name] for name in circle), key=lambda mimic: mimic.sourceline)
        what = f"joints mimic each other in a circle: {', '.join(map(repr, circle))}"
        yield finding("mimic-circle", at, what, "nothing would move them", "let one of them move on its own")

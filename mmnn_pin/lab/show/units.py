"""Unit of every single column of a recorded signal."""

from __future__ import annotations

import xml.etree.ElementTree as ElementTree

from ...recording.recording import Recording


def column_units(recording: Recording, name: str) -> list[str]:
    """Unit of every column of a signal: those of the base, then those of the arm by the types of its joints."""
    labels = recording.labels(name)
    if name in ("position", "motor_torque", "applied"):
        return [of_joint(name, label, prismatic_joints(recording.urdf)) for label in labels]
    base, _, arm = recording.unit(name).partition("; ")
    if " or " in base:
        base, arm = "", base
    count = len(labels) if not arm else len(recording.labels("z")) if base else 0
    units = base.split(", ")[:count]
    if len(units) < count:  # vx and vy share the first unit
        units = [units[0]] * (count - len(units)) + units
    turning, _, sliding = arm.partition(" or ")
    slides = prismatic_joints(recording.urdf)
    return units + [sliding if label in slides else turning for label in labels[count:]]


def of_joint(name: str, label: str, slides: set[str]) -> str:
    """Unit of one joint's position, or of one motor's torque; the base is pushed along x and y and turned."""
    sliding = label in slides or label in (("x", "y") if name == "position" else ("base_x", "base_y"))
    return (("rad", "m") if name == "position" else ("N m", "N"))[sliding]


def milli(unit: str) -> str:
    """The unit in which errors are shown: a thousandth."""
    return f"m{unit}" if unit else ""


def prismatic_joints(urdf: str) -> set[str]:
    """Names of the sliding joints in the text of a URDF; none without a text."""
    joints = ElementTree.fromstring(urdf).iter("joint") if urdf else ()
    return {joint.get("name", "") for joint in joints if joint.get("type") == "prismatic"}

"""Metrics of rows by name: patterns, units, and what a run without a number counts for."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from fnmatch import fnmatchcase

from ...errors import UnknownName
from ...model.robot import Robot
from .keys import near

DEFAULT = ("pose_error.[xy].peak", "pose_error.phi.peak", "e.*.peak", "effort")


def value_of(metrics: Mapping[str, float], pattern: str) -> float:
    """The largest metric that a pattern names; inf where one is no number, nan where there is none."""
    found = [value for name, value in metrics.items() if fnmatchcase(name, pattern)]
    if not found:
        return math.nan
    return max(math.inf if math.isnan(value) else value for value in found)


def require_patterns(patterns: Iterable[str], names: Iterable[str], key: str) -> None:
    """Refuse patterns that name no metric.

    Args:
        patterns: Names, in which `*` and `[xy]` are as in a shell.
        names: Metrics that there are.
        key: Where the patterns were given.

    Raises:
        UnknownName: With the names that are near.
    """
    known = list(names)
    for pattern in patterns:
        if not any(fnmatchcase(name, pattern) for name in known):
            raise UnknownName("metric", pattern, near(pattern, known), key=key)


def units_of(names: Iterable[str], robot: Robot) -> dict[str, str]:
    """Unit of every metric of a robot; empty for a pure number."""
    joints = {name: robot.model.joints[robot.model.getJointId(name)] for name in robot.joint_names}
    slides = {name for name, joint in joints.items() if joint.shortname().startswith("JointModelP")}
    return {name: unit_of(name, slides) for name in names}


def unit_of(name: str, slides: set[str]) -> str:
    """Unit of one metric.

    Args:
        name: `signal.label.statistic`.
        slides: Arm joints that slide.
    """
    signal, _, rest = name.partition(".")
    label = rest.rpartition(".")[0]
    if signal == "pose_error":
        return "rad" if label == "phi" else "m"
    if signal == "z":
        return "rad/s" if label == "w" else "m/s"
    if signal == "e":
        return "m" if label in slides else "rad"
    return {"effort": "N^2 m^2 s", "slip": "m/s", "constraint_residual": "m/s", "energy_residual": "J"}.get(signal, "")


def common_unit(units: Mapping[str, str], pattern: str) -> str:
    """Unit of all metrics that a pattern names; empty where they have several."""
    found = {unit for name, unit in units.items() if fnmatchcase(name, pattern)}
    return found.pop() if len(found) == 1 else ""

"""What the loader understood of a robot, as lists and names: what `mmnn inspect` shows."""

from __future__ import annotations

import hashlib
import math
from pathlib import Path
from typing import Any

from mmnn_pin.errors import RobotError
from mmnn_pin.model.robot import Robot

from .base.base import Base, Reading, Undecided, Unsupported
from .base.overrides import Overrides, folders_of, said_of
from .urdf.parsing import AuditError, Finding, audit_file


def inspection_of(robot: Robot) -> dict[str, Any]:
    """A robot that was understood."""
    return {
        "file": str(robot.path),
        "sha256": robot.sha256,
        "ok": True,
        "findings": [as_dict(finding) for finding in robot.findings],
        "base": base_of(robot.base),
        "arm": arm_of(robot),
        "locked": list(robot.arm.locked),
        "locked_at": {name: {"position": at, "why": robot.arm.reasons[name]} for name, at in robot.arm.locked.items()},
        "mass": float(sum(body.mass for body in robot.model.inertias)),
    }


def refusal_of(error: RobotError, path: Path, said: Overrides) -> dict[str, Any]:
    """A robot that was not: what the audit found, and why it was refused."""
    findings = list(error.findings) if isinstance(error, AuditError) else audited(path, said)
    if not isinstance(error, AuditError):
        code = {Undecided: "base-undecided", Unsupported: "base-unsupported"}.get(type(error), "robot")
        file = str(error.file or path)
        findings.append(Finding("error", code, file, error.line or 1, "", error.what, error.why, error.fix))
    base: dict[str, Any] | None = None
    if isinstance(error, Undecided):
        base = {"kind": "undecided", "candidates": [reading_of(r) for r in error.readings]}
        base["wheel_candidates"] = list(error.candidates)
    elif isinstance(error, Unsupported):
        base = {"kind": "unsupported", "machine": error.machine}
    return {
        "file": str(path),
        "sha256": hash_of(path),
        "ok": False,
        "findings": [as_dict(finding) for finding in findings],
        "base": base,
        "arm": None,
        "locked": [],
        "mass": None,
    }


def hash_of(path: Path) -> str | None:
    """Hash of a file, None where it cannot be read."""
    try:
        return hashlib.sha256(path.read_bytes()).hexdigest() if path.is_file() else None
    except OSError:
        return None


def audited(path: Path, said: Overrides) -> list[Finding]:
    """What there is to say about a file that the audit accepts, beside what the robot was refused for."""
    said, notes = said_of(path, said)
    return [*audit_file(path, said.strict, folders_of(path, said))[1], *notes]


def as_dict(finding: Finding) -> dict[str, Any]:
    """A finding by names, and as the line a terminal shows."""
    names = ("severity", "code", "file", "line", "element", "message", "why", "fix")
    return {name: getattr(finding, name) for name in names} | {"text": str(finding)}


def reading_of(reading: Reading) -> dict[str, Any]:
    """One way to read a base, by names."""
    return {"kind": reading.kind, "for": list(reading.reasons), "against": list(reading.objections)}


def base_of(base: Base) -> dict[str, Any]:
    """A base by names."""
    wheels = [
        {"joint": w.joint, "radius": w.radius, "sign": int(w.sign), "x": w.x, "y": w.y}
        | {"heading": w.heading, "roller": w.roller}
        for w in base.wheels
    ]
    return {
        "kind": base.kind,
        "wheels": wheels,
        "track": base.track,
        "axle_x": base.axle_x,
        "frame": base.frame.tolist(),
        "floor": base.floor,
        "casters": list(base.casters),
        "suspensions": list(base.suspensions),
    }


def arm_of(robot: Robot) -> dict[str, Any]:
    """The manipulator by names, with its limits; null where there is none."""
    limits = {}
    for name, at in zip(robot.joint_names, robot.arm_index, strict=True):
        effort = robot.effort_limits[robot.actuator_names.index(name)]
        limits[name] = {
            "lower": finite_or_none(robot.lower[at]),
            "upper": finite_or_none(robot.upper[at]),
            "effort": finite_or_none(effort),
        }
    slaves = {
        name: {"master": slave.master, "multiplier": slave.multiplier, "offset": slave.offset}
        for name, slave in robot.arm.slaves.items()
    }
    return {"joints": list(robot.joint_names), "limits": limits, "slaves": slaves}


def finite_or_none(value: float) -> float | None:
    """The number, None for infinity, which JSON does not know."""
    return float(value) if math.isfinite(value) else None

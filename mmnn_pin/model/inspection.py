"""A robot as lists and names: what the loader understood (`mmnn inspect`), and its model at a state (`mmnn model`)."""

from __future__ import annotations

import hashlib
import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
from lxml import etree

from ..elementary import cos_sin
from ..errors import ConfigError, InputError, RobotError, UnknownName
from ..files import read_bytes, reason
from ..settings import Settings, finite
from ..settings.arguments import unknown_key, wrong_type
from ..signals import Array
from .base.overrides import Overrides, folders_of, with_file
from .base.report import SPEAKS, BaseReading, Undecided, Unsupported
from .base.steered import SteeredBase
from .dynamics import Dynamics
from .robot import Robot, revolute
from .urdf.expansion import Unexpanded
from .urdf.finding import AuditError, Finding
from .urdf.reading import MAX_BYTES, audit_file


def inspection_of(robot: Robot) -> dict[str, Any]:
    """A robot that was understood."""
    return {
        "file": str(robot.path),
        "sha256": robot.sha256,
        "ok": True,
        "findings": [as_dict(finding) for finding in robot.findings],
        "base": base_of(robot),
        "arm": arm_of(robot),
        **interfaces_of(robot),
        "locked": list(robot.arm.locked),
        "locked_at": {name: {"position": at, "why": robot.arm.reasons[name]} for name, at in robot.arm.locked.items()},
        "mass": float(sum(body.mass for body in robot.model.inertias)),
    }


def refusal_of(error: RobotError, path: Path, overrides: Overrides) -> dict[str, Any]:
    """A robot that was not: what the audit found, and why it was refused.

    Raises:
        Unexpanded: The error itself, where there is no URDF to audit.
    """
    if isinstance(error, Unexpanded):
        raise error
    findings = list(error.findings) if isinstance(error, AuditError) else audited(path, overrides)
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
        return hashlib.sha256(read_bytes(path, MAX_BYTES)).hexdigest()
    except (OSError, ValueError):
        return None


def audited(path: Path, overrides: Overrides) -> list[Finding]:
    """Findings about a file that the audit accepts, beside what the robot was refused for."""
    overrides, notes = with_file(path, overrides)
    return [
        *audit_file(path, overrides.strict, folders_of(path, overrides), overrides.xacro, overrides.without)[1],
        *notes,
    ]


def as_dict(finding: Finding) -> dict[str, Any]:
    """A finding by names, and as the line a terminal shows."""
    names = ("severity", "code", "file", "line", "element", "message", "why", "fix")
    return {name: getattr(finding, name) for name in names} | {"text": str(finding)}


def reading_of(reading: BaseReading) -> dict[str, Any]:
    """One way to read a base, by names."""
    return {"kind": reading.kind, **{word: reading.told(side) for word, side in SPEAKS.items()}}


def base_of(robot: Robot) -> dict[str, Any]:
    """A base by names; where its wheels and pivots stand in the control frame at rest."""
    base = robot.base
    carriers, wheels = base.carriers((0.0, 0.0, 0.0), robot.rest[robot.shape_index].tolist()), []
    for w in base.wheels:
        x, y, heading = carriers[w.pivot + 1]
        c, s = cos_sin(heading)
        place = {"x": x + c * w.x - s * w.y, "y": y + s * w.x + c * w.y, "heading": heading + w.heading}
        wheels.append({"joint": w.joint, "radius": w.radius, "sign": int(w.sign)} | place | {"roller": w.roller})
        if robot.steers:
            wheels[-1] |= {"on": base.shape[w.pivot] if w.pivot >= 0 else None, "driven": w.driven}
    return {
        "kind": base.kind,
        "wheels": wheels,
        "track": base.track,
        "axle_x": float(base.frame[0]),
        "frame": base.frame.tolist(),
        "floor": base.floor,
        "casters": list(base.casters),
        "suspensions": list(base.suspensions),
    } | ({"pivots": pivots_of(base, carriers), "length": base.length} if isinstance(base, SteeredBase) else {})


def pivots_of(base: SteeredBase, carriers: Sequence[Sequence[float]]) -> list[dict[str, Any]]:
    """Pivots of a base by names, with what carries them: another one, or null for its body."""
    return [
        {"joint": p.joint, "role": p.role, "x": at[0], "y": at[1], "sign": int(p.sign)}
        | {"lower": finite(p.lower), "upper": finite(p.upper), "rate": finite(p.rate)}
        | {"motor": p.motor, "on": base.shape[p.parent] if p.parent >= 0 else None}
        for p, at in zip(base.pivots, carriers[1:], strict=True)
    ]


def arm_of(robot: Robot) -> dict[str, Any]:
    """The manipulator by names, with its limits; null where there is none."""
    limits = {}
    for name, at in zip(robot.joint_names, robot.arm_index, strict=True):
        effort = robot.effort_limits[robot.actuator_names.index(name)]
        limits[name] = {
            "lower": finite(robot.lower[at]),
            "upper": finite(robot.upper[at]),
            "effort": finite(effort),
        }
    slaves = {
        name: {"master": slave.master, "multiplier": slave.multiplier, "offset": slave.offset}
        for name, slave in robot.arm.slaves.items()
    }
    hands = [{"frame": hand.frame, "joints": list(hand.joints), "why": hand.why} for hand in robot.arm.hands]
    return {"joints": list(robot.joint_names), "limits": limits, "slaves": slaves, "hands": hands}


INTERFACES = ("effort", "velocity", "position")  # the first that a joint offers is used


def interfaces_of(robot: Robot) -> dict[str, Any]:
    """Command interfaces of every motor's joint, by `ros2_control` and transmission tags, and the one that is used.

    A torque where it is offered, or where nothing is stated; else a velocity, else a position.
    """
    root = etree.fromstring(robot.urdf.encode())
    offered: dict[str, set[str]] = {name: set() for name in robot.actuator_names}
    for joint in root.iterfind("ros2_control/joint"):
        stated = {tag.get("name", "").rpartition("/")[2] for tag in joint.iterfind("command_interface")}
        offered.get(joint.get("name", ""), set()).update(stated.intersection(INTERFACES))
    for joint in root.iterfind("transmission/joint"):
        words = " ".join(tag.text or "" for tag in joint.iter("hardwareInterface")).lower()
        offered.get(joint.get("name", ""), set()).update(name for name in INTERFACES if f"{name}joint" in words)
    listed = {name: [kind for kind in INTERFACES if kind in some] for name, some in offered.items()}
    used = {name: (some or ["effort"])[0] for name, some in listed.items()}
    return {"interfaces": used, "interfaces_offered": listed}


# -- the model at a state ----------------------------------------------------------------------------------------------


class NamedState(Settings, frozen=True):
    """A state by names; what is left out is at rest (a position of 0 clipped into the limits) and standing still.

    Args:
        pose: `(x, y, phi)` of the control frame [m, m, rad].
        base_velocity: One number per base velocity, `(v, w)` for a differential drive [m/s, rad/s].
        joints: Position of joints, of the arm or not [rad or m].
        joint_velocities: Velocity of arm joints [rad/s or m/s]; wheels follow from the base velocity.
    """

    pose: tuple[float, float, float] | None = None
    base_velocity: tuple[float, ...] | None = None
    joints: Mapping[str, float] = {}
    joint_velocities: Mapping[str, float] = {}

    def of(self, robot: Robot) -> tuple[Array, Array]:
        """Position (nv,) and nu (p,) of a robot.

        Raises:
            UnknownName: A joint that the robot does not have.
            ConfigError: A pose or base velocity that its base does not have, or a number that is not finite.
        """
        base, position, nu = robot.dimensions.base, robot.neutral_position(), np.zeros(robot.dimensions.dof)
        for key, given, size in (
            ("pose", self.pose, robot.dimensions.pose),
            ("base_velocity", self.base_velocity, base),
        ):
            if given is not None and len(given) != size:
                fix = f"give {', '.join(robot.base.velocity_names)}" if base else "leave it out: the arm is fixed"
                raise ConfigError(f"{len(given)} numbers where the base has {size}", fix=fix, key=key)
        if self.pose is not None:
            position[: robot.dimensions.pose] = self.pose
        if self.base_velocity is not None:
            nu[:base] = self.base_velocity
        joints = robot.position_names[robot.dimensions.pose :]
        fill(position[robot.dimensions.pose :], self.joints, joints, "joints")
        fill(nu[base:], self.joint_velocities, robot.joint_names, "joint_velocities")
        if not (np.isfinite(position).all() and np.isfinite(nu).all()):
            raise ConfigError("a number is not finite", fix="give finite numbers in SI units")
        return robot.follow(position), nu


def fill(values: Array, given: Mapping[str, float], names: tuple[str, ...], key: str) -> None:
    """Put named numbers in their places.

    Raises:
        UnknownName: A name without a place.
    """
    for name, value in given.items():
        if name not in names:
            kind = "joint" if key == "joints" else "arm joint"
            raise UnknownName(kind, name, names, key=key)
        values[names.index(name)] = value


def read_state(path: str | Path, robot: Robot) -> tuple[Array, Array]:
    """Position (nv,) and nu (p,) from a JSON file with the keys of `NamedState`.

    Raises:
        ConfigError: The file cannot be read, is not JSON, or a value is of the wrong type.
        UnknownName: A key or a joint that does not exist.
    """
    path = Path(path)
    try:
        return msgspec.json.decode(read_bytes(path), type=NamedState).of(robot)
    except OSError as error:
        fix = "name a JSON file, as in `mmnn model --help`"
        raise ConfigError("cannot be read", why=reason(error), fix=fix, file=path) from error
    except msgspec.ValidationError as error:
        message, _, where = str(error).partition(" - at ")
        key = where.strip("`").removeprefix("$").removeprefix(".") or None
        if (unknown := unknown_key(error)) is not None:
            raise UnknownName("key", unknown, NamedState.__struct_fields__, file=path) from error
        what, fix = wrong_type(message)
        raise ConfigError(what, fix=fix, file=path, key=key) from error
    except (msgspec.DecodeError, UnicodeDecodeError) as error:
        raise ConfigError("not valid JSON", why=str(error), file=path) from error
    except InputError as error:
        raise error.but(file=error.file or path) from error


A_TURN = 2 * math.pi  # an angle beyond this looks like degrees, but a wheel's


def doubtful(robot: Robot, position: Array) -> list[str]:
    """Doubts about a position (nv,): beyond a joint's limits, or angles in degrees."""
    rest, doubts, wheels = robot.neutral_position(), [], {wheel.joint for wheel in robot.base.wheels}
    rows = zip(robot.position_names, position, rest, robot.lower, robot.upper, revolute(robot), strict=True)
    for name, q, at, low, high, turns in rows:
        unit = "rad" if turns else "m"
        many = bool(turns and abs(q) > A_TURN and name not in wheels)
        beyond = q != at and not low <= q <= high
        if beyond or many:
            limits = f"beyond its limits {low:.4g} to {high:.4g} {unit}" if beyond else "more than a turn"
            degrees = f": if these are degrees, give {math.radians(q):.4g}" if many else ""
            doubts.append(f"{name} = {q:.4g} {unit} is {limits}{degrees}")
    return doubts


def model_at(robot: Robot, position: Array, nu: Array) -> dict[str, Any]:
    """Reduced model at a state, `M nudot + C nu + gravity + friction = E u`, as lists and names for JSON.

    Rows of M, C, E are in the order of velocity_names; T maps them to full_velocity_names, and `A T = 0`.

    Raises:
        ConfigError: A number of it is not finite there.
    """
    dynamics = Dynamics(robot)
    with np.errstate(all="ignore"):
        M, C = dynamics.mass_matrix(position), dynamics.coriolis_matrix(position, nu)
        g, f = dynamics.gravity(position), dynamics.friction(nu, position)
    if not all(np.isfinite(term).all() for term in (M, C, g, f)):
        raise ConfigError("the model is not finite at this state", fix="give positions and velocities that a robot has")
    return {
        "robot": robot.name,
        "base": robot.base.kind,
        "velocity_names": list(robot.velocity_names),
        "M": M.tolist(),
        "C": C.tolist(),
        "gravity": g.tolist(),
        "friction": f.tolist(),
        "T": robot.T_at(position).tolist(),
        "full_velocity_names": list(robot.full_velocity_names),
        "A": robot.A_at(position).tolist(),
        "E": robot.E_at(position).tolist(),
        "actuator_names": list(robot.actuator_names),
    }

"""The files of an identification: a corrected URDF, a TOML for what a URDF cannot hold, a JSON with all numbers.

A body of the model may be several links, fixed to each other or locked. Its new pseudo-inertia P+ is laid on its links
by `P_link+ = G P_link G'` with `G = P^1/2 (P^-1/2 P+ P^-1/2)^1/2 P^-1/2`, the map nearest to the identity with
`G P G' = P+`: their sum is exactly P+, and what was possible stays possible.
"""

from __future__ import annotations

import json
import re
from collections.abc import Mapping
from datetime import UTC, datetime
from itertools import combinations_with_replacement
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
from lxml import etree

from ...errors import RecordingError
from ...files import quoted, read_bytes, whole_folder
from ...model.arm import WHY
from ...model.base.overrides import Overrides
from ...model.limbs import STILL
from ...model.loading import load_with
from ...model.robot import Robot
from ...model.tree.body import parameters
from ...model.urdf.audit import BodyPart
from ...model.urdf.reading import MAX_BYTES, is_xacro
from ...shown import shows
from ...signals import Array
from ...torque.pseudo_inertia import pseudo_inertias
from .identification import Identification
from .odometry import Wheels
from .programme import thickened
from .report import inertia_of, links_of, report_of

HARDWARE = b"# The loop of the robot as its log has it: delays and lags [s].\n"
LEAST_MU, MOST_MU = 1e-3, 10.0  # friction coefficient between floor and wheels that is written
CHANGED = 1e-9  # relative change of a body below which its links stay as they are


# -- bodies and their links --------------------------------------------------------------------------------------------


def transport(before: Array, after: Array) -> Array:
    """G with `G before G' = after`, both (4, 4) and positive, nearest to the identity."""
    values, vectors = np.linalg.eigh(before)
    root, inverse = (vectors * np.sqrt(values)) @ vectors.T, (vectors / np.sqrt(values)) @ vectors.T
    values, vectors = np.linalg.eigh(inverse @ after @ inverse)
    return np.asarray(root @ (vectors * np.sqrt(values)) @ vectors.T @ inverse)


def pseudo_inertia_of(link: etree._Element) -> Array:
    """Pseudo-inertia of a link's `<inertial>` in the link's frame, (4, 4)."""
    part = BodyPart.of(link, np.eye(4))
    R, centre = part.frame[:3, :3], part.frame[:3, 3]
    inertia = R @ part.inertia @ R.T
    P = np.zeros((4, 4))
    P[:3, :3] = 0.5 * np.trace(inertia) * np.eye(3) - inertia + part.mass * np.outer(centre, centre)
    P[:3, 3] = P[3, :3] = part.mass * centre
    P[3, 3] = part.mass
    return P


def new_links(of: Identification) -> dict[str, Array]:
    """New pseudo-inertia of every link of the bodies that changed, in the link's frame."""
    root = etree.fromstring(of.robot.urdf.encode())
    elements = {link.get("name"): link for link in root.iterchildren("link")}
    first, bodies = of.unknowns.regressor.inertial, of.unknowns.regressor.bodies
    after, made = pseudo_inertias(of.theta[:first]), {}
    links = links_of(of.robot)
    for name, P_new in zip(bodies, after, strict=True):
        parts = [(link, H, pseudo_inertia_of(elements[link])) for link, H in links.get(name, [])]
        before = np.sum([np.zeros((4, 4)), *(H @ own @ H.T for _, H, own in parts)], axis=0)
        start = thickened(before)
        if not parts or np.abs(P_new - start).max() <= CHANGED * np.abs(start).max():
            continue
        heaviest = max(range(len(parts)), key=lambda i: parts[i][2][3, 3])  # it takes what makes a thin body thick
        G = transport(start, P_new)
        for i, (link, H, own) in enumerate(parts):
            inside = H @ own @ H.T + (start - before if i == heaviest else 0.0)
            back = np.linalg.inv(H)
            if inside[3, 3] > 0:
                made[link] = back @ G @ inside @ G.T @ back.T
    return made


# -- the files ---------------------------------------------------------------------------------------------------------


def corrected_urdf(of: Identification) -> bytes:
    """The URDF with new inertias, damping and friction; all else, comments included, as it was."""
    robot = of.robot
    data = read_bytes(robot.path, MAX_BYTES)
    if is_xacro(robot.path, data):
        data = robot.urdf.encode()
    root = etree.fromstring(data, etree.XMLParser(remove_blank_text=False, resolve_entities=False))
    changed = new_links(of)
    for link in root.iterchildren("link"):
        if link.get("name") in changed:
            set_inertial(link, changed[link.get("name")])
    for joint in root.iterchildren("joint"):
        if (friction := joint_friction(of).get(joint.get("name"))) is not None:
            set_dynamics(joint, *friction)
    start, end = robot_element(data)
    words = " ".join(header(of, changed).replace("--", "- -").split())
    robot_text = etree.tostring(root, encoding="utf-8", with_tail=False)
    return data[:start] + f"<!-- {words} -->\n".encode() + robot_text + data[end:]


def robot_element(data: bytes) -> tuple[int, int]:
    """Where the `<robot>` element of a file begins, and where it ends; not those in comments."""
    marks = [
        m for m in re.finditer(rb"(?s)<!--.*?-->|<robot(?=[\s>/])|</robot\s*>", data) if not m[0].startswith(b"<!--")
    ]
    return marks[0].start(), marks[-1].end()


def header(of: Identification, changed: Mapping[str, Array]) -> str:
    """The comment at the head of the URDF: logs, links, joints and held-out errors."""
    followed = ", ".join(name for name, follows in zip(of.names, of.follows, strict=True) if follows)
    when = datetime.now(UTC).strftime("%Y-%m-%d")
    with_all, without, before = (f"{100 * of.error(model):.1f} %" for model in ("identified", "urdf_file", "urdf"))
    logs = ", ".join(Path(log.name).name for log in of.logs)
    return (
        f"Identified by mmnn_pin on {when} from {logs} ({len(of.training)} rows, below {of.training.cutoff:.3g} Hz): "
        f"inertias of {', '.join(changed) or 'none'}; friction of {', '.join(joint_friction(of)) or 'none'}; "
        f"from the torques of {followed}. Held-out torque error {with_all} with the constants and rotors of the TOML "
        f"file beside it, {without} without, {before} before."
    )


def set_inertial(link: etree._Element, P: Array) -> None:
    """Write a pseudo-inertia into a link's `<inertial>`; the principal axes' rotation becomes 0."""
    mass, centre, inertia = inertia_of(P)
    inertial = link.find("inertial")
    origin = inertial.find("origin")
    if origin is None:
        origin = etree.Element("origin")
        origin.tail = inertial.text
        inertial.insert(0, origin)
    origin.set("xyz", " ".join(map(repr, map(float, centre))))
    origin.set("rpy", "0 0 0")
    inertial.find("mass").set("value", repr(mass))
    for i, j in combinations_with_replacement(range(3), 2):
        inertial.find("inertia").set(f"i{'xyz'[i]}{'xyz'[j]}", repr(float(inertia[i, j])))


def set_dynamics(joint: etree._Element, viscous: float, coulomb: float) -> None:
    """Write a joint's friction."""
    dynamics = joint.find("dynamics")
    if dynamics is None:
        dynamics = etree.SubElement(joint, "dynamics")
        before = dynamics.getprevious()
        if before is not None:
            dynamics.tail, before.tail = before.tail, joint.text
    dynamics.set("damping", repr(viscous))
    dynamics.set("friction", repr(coulomb))


def joint_friction(of: Identification) -> dict[str, tuple[float, float]]:
    """Viscous and dry friction of every joint that was identified; followers (mimic joints) keep theirs."""
    rows = of.unknowns.joint_rows[:, list(of.unknowns.rows)]
    moved = (np.abs(rows) @ of.follows.astype(float)) > 0
    labels, found = of.unknowns.labels, {}
    for joint, there in zip(of.unknowns.regressor.joints, moved, strict=True):
        if there:
            at = (labels.index(f"{joint}.viscous"), labels.index(f"{joint}.coulomb"))
            found[joint] = (float(max(of.theta[at[0]], 0.0)), float(max(of.theta[at[1]], 0.0)))
    return found


def beyond_urdf(of: Identification) -> dict[str, dict[str, float]]:
    """Rotors, constants and Stribeck friction by kind and joint."""
    found: dict[str, dict[str, float]] = {}
    for i in of.unknowns.columns("rotor", "offset", "stribeck"):
        name, _, kind = of.unknowns.labels[i].rpartition(".")
        if of.theta[i]:
            found.setdefault(kind, {})[name] = float(of.theta[i])
    return found


def toml_of(of: Identification) -> bytes:
    """The TOML file of rotors, constants and Stribeck friction, with the held-out errors with and without them."""
    about = {"robot": of.robot.name, "held_out_with": of.error("identified"), "held_out_without": of.error("urdf_file")}
    if of.unknowns.stribeck:
        about["stribeck_speed"] = of.unknowns.stribeck
    head = (
        "# Beside the URDF: rotor inertias [kg m^2 or kg], constant efforts (offset) [N m or N], Stribeck friction.\n"
    )
    return head.encode() + as_toml(about | beyond_urdf(of) | {"timing": of.timing})


def hardware_of(of: Identification) -> dict[str, Any]:
    """The table of hardware (`ROBOT.hardware.toml`) that the delays and lags make; empty where none was seen.

    The delay is the mean of all motors', the filter's bandwidth one over the mean lag of the rates: one for all joints.
    """
    found, timing = dict[str, Any](), of.timing
    if delays := [one["command_delay"] for one in timing.values() if "command_delay" in one]:
        found["delay"] = float(np.mean(delays))
    if filters := [one["velocity_lag"] for one in timing.values() if one.get("velocity_lag", 0.0) > 0]:
        found |= {"velocity": "filtered", "filter": float(1 / np.mean(filters))}
    lags = {joint: {"lag": one["motor_lag"]} for joint, one in timing.items() if one.get("motor_lag", 0.0) > 0}
    return found | ({"joints": lags} if lags else {})


def as_toml(table: Mapping[str, Any], path: tuple[str, ...] = ()) -> bytes:
    """A table, whose values may be tables, as TOML."""
    plain = [(key, value) for key, value in table.items() if not isinstance(value, Mapping)]
    lines = [f"[{'.'.join(map(quoted, path))}]"] if path and plain else []
    lines += [f"{quoted(key)} = {in_toml(value)}" for key, value in plain]
    text = "\n".join(lines) + "\n" if lines or not path else ""
    inner = (as_toml(value, (*path, key)) for key, value in table.items() if isinstance(value, Mapping))
    return text.encode() + b"".join(inner)


def in_toml(value: Any) -> str:
    """A value as TOML: JSON has the same numbers."""
    if isinstance(value, list | tuple):
        return f"[{', '.join(map(in_toml, value))}]"
    return quoted(value) if isinstance(value, str) else json.dumps(value)


def said_of(of: Identification) -> Overrides:
    """The overrides with which the corrected file loads as the robot did, wherever it lies.

    Radius and track are those that odometry found, where it did.
    """
    robot = of.robot
    known: dict[str, Any] = {"base": robot.base.kind, "controllers_file": None, "xacro": ()}
    known["package_dirs"] = tuple(str(Path(folder).resolve()) for folder in robot.overrides.package_dirs)
    reasons, locks = robot.arm.reasons, robot.overrides.lock
    chosen = [WHY[name] for name in ("tip", *STILL, "rigid")]  # by bodies that are other ones there
    known["lock"] = (*locks, *(name for name, why in reasons.items() if why in chosen))
    if robot.base.wheels:
        known |= {"wheels": tuple(wheel.joint for wheel in robot.base.wheels), "track": robot.base.track}
        radii = {wheel.radius for wheel in robot.base.wheels}
        known["radius"] = radii.pop() if len(radii) == 1 else None
    if of.wheels is not None:
        known |= found_wheels(robot, of.wheels)
    return msgspec.structs.replace(robot.overrides, **known)


def found_wheels(robot: Robot, wheels: Wheels) -> dict[str, Any]:
    """Overrides of the radii and the track that odometry found; one radius where both sides have the same."""
    (left, right), (ratio, sd) = map(float, wheels.value[:2]), wheels.ratio
    found: dict[str, Any] = {"track": float(wheels.value[2]), "radius": (left + right) / 2, "wheel_radii": ()}
    if abs(ratio - 1) > 1.96 * sd:
        radii = tuple(f"{wheel.joint}={left if wheel.y > 0 else right!r}" for wheel in robot.base.wheels)
        found |= {"radius": None, "wheel_radii": radii}
    return found


def with_turning(of: Identification, urdf: Path, said: Overrides) -> Overrides:
    """Overrides with the friction coefficient at which a base that scrubs turns as it was found to; others as said."""
    if not of.robot.base.scrubs:
        return said
    found, stated = of.theta[of.unknowns.labels.index("w.coulomb")], load_with(urdf, said).coulomb[2]
    mu = (said.mu or 1.0) * found / max(stated, 1e-12)
    return msgspec.structs.replace(said, mu=float(np.clip(mu, LEAST_MU, MOST_MU)))


@shows(Identification, "files")
def write(of: Identification, out: str | Path, force: bool = False) -> dict[str, Path]:
    """Write the corrected URDF and what belongs to it; all files or none.

    Args:
        of: What was identified.
        out: A folder, or the name of the URDF.
        force: Replace existing files.

    Returns:
        `urdf`, `toml`, `json`, `curves`, `overrides`, and `hardware` where delays or lags were seen.

    Raises:
        RecordingError: A file exists, cannot be written, or the written URDF does not load as the robot that it
            describes.
    """
    files = files_of(of.robot, Path(out))
    require_free(files, of.robot, force)
    if not hardware_of(of):
        del files["hardware"]
    urdf = files["urdf"]
    said, curves = said_of(of), curves_of(of)
    with whole_folder(urdf.parent, "file", force) as folder:
        parts = {kind: folder / file.name for kind, file in files.items()}
        parts["urdf"].write_bytes(corrected_urdf(of))
        said = with_turning(of, parts["urdf"], said)
        parts["overrides"].write_bytes(as_toml(said.stated()))
        require_same(of, parts["urdf"], said)
        parts["toml"].write_bytes(toml_of(of))
        if "hardware" in parts:
            parts["hardware"].write_bytes(HARDWARE + as_toml(hardware_of(of)))
        report = report_of(of) | {"file": str(urdf)}
        parts["json"].write_text(json.dumps(report, allow_nan=False, indent=1), "utf-8")
        np.savez_compressed(parts["curves"], **curves)
    return files


def files_of(robot: Robot, out: Path) -> dict[str, Path]:
    """The files that are written for a robot: `urdf`, `toml`, `json`, `curves`, `overrides`."""
    urdf = out if out.suffix == ".urdf" else out / f"{robot.path.stem}.urdf"
    names = {"toml": "identified.toml", "json": "identified.json", "curves": "identified.npz", "overrides": "mmnn.toml"}
    names["hardware"] = "hardware.toml"
    return {"urdf": urdf} | {kind: Path(f"{urdf.with_suffix('')}.{name}") for kind, name in names.items()}


def require_free(files: Mapping[str, Path], robot: Robot, force: bool) -> None:
    """Refuse to replace files unasked, and the robot's own URDF at all (`RecordingError`)."""
    if files["urdf"].resolve() == robot.path.resolve():
        raise RecordingError("would replace the URDF itself", fix="choose another place with --out", file=files["urdf"])
    for file in files.values():
        if file.exists() and not force:
            raise RecordingError("the file exists", fix="choose another place, or replace it with --force", file=file)


def require_same(of: Identification, urdf: Path, said: Overrides) -> None:
    """Load a written URDF and compare its parameters with those that were meant.

    Raises:
        RecordingError: They differ.
    """
    as_fitted = (
        msgspec.structs.replace(said, radius=None, track=None, wheel_radii=()) if of.wheels is not None else said
    )
    read, meant = parameters(load_with(urdf, as_fitted)), of.in_urdf[: of.unknowns.regressor.size]
    kept = np.setdiff1d(np.arange(meant.size), of.unknowns.columns("rotor"))
    if read.size != meant.size:
        raise RecordingError("the written URDF loads with other moving joints", fix="please report it", file=urdf)
    scale = np.abs(of.prior.B).max(axis=1)[: meant.size]
    inertial = of.unknowns.regressor.inertial
    off = np.abs(read - meant)[kept[kept < inertial]] / np.maximum(scale, 1e-12)[kept[kept < inertial]]
    if off.max(initial=0.0) > 1e-6:
        name = of.unknowns.labels[kept[int(np.argmax(off))]]
        raise RecordingError(
            f"the written URDF has another {name} than was identified", fix="please report it", file=urdf
        )


def curves_of(of: Identification) -> dict[str, Any]:
    """Measured and predicted efforts of the motion held out, for pictures."""
    test = of.held_out
    found = {"time": test.time, "measured": test.y, "use": test.use, "run": test.run, "names": np.array(of.names)}
    return found | {model: of.predicted(model, test) for model in ("identified", "urdf", "friction")}

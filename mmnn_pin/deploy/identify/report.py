"""The report of an identification: bodies in their links' frames, friction, errors, covariances, by name."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
import pinocchio as pin
from lxml import etree

from ...model.robot import Robot
from ...model.tree.tree import carriers
from ...shown import shows
from ...signals import Array
from ...torque.pseudo_inertia import BODY, pseudo_inertias, vector_of
from .identification import Identification
from .programme import BELIEVED, positive_bodies


def links_of(robot: Robot) -> dict[str, list[tuple[str, Array]]]:
    """Links with an inertia of every body of the regressor, and each one's placement in the body's frame, (4, 4).

    Bodies by the joint that carries them, `root` for the base; links in the file's order.
    """
    model, names = robot.model, robot.full_velocity_names
    where = carriers(model, np.array(robot.T), robot.neutral_position())
    moving = [i for i in range(3 if robot.dimensions.base else 0, model.nv) if robot.T[i].any()]
    bodies = ["root", *(names[i] for i in moving)]
    found: dict[str, list[tuple[str, Array]]] = {}
    for link in etree.fromstring(robot.urdf.encode()).iterchildren("link"):
        if link.find("inertial") is None:
            continue
        frame = model.frames[model.getFrameId(link.get("name"), pin.FrameType.BODY)]
        if frame.parentJoint == 0:
            continue
        body, at = where[frame.parentJoint - 1]
        placement = at @ frame.placement.homogeneous
        if body or robot.dimensions.base:
            found.setdefault(bodies[body], []).append((link.get("name"), placement))
    return found


def inertia_of(P: Array) -> tuple[float, Array, Array]:
    """Mass [kg], centre (3,) [m] and inertia about it (3, 3) [kg m^2] of a pseudo-inertia."""
    mass = float(P[3, 3])
    centre = P[:3, 3] / mass
    second = P[:3, :3] - mass * np.outer(centre, centre)
    return mass, centre, np.trace(second) * np.eye(3) - second


HELD_OUT = {  # key of the error that a model makes on motion held out
    "held_out": "identified",
    "urdf_held_out": "urdf",
    "friction_held_out": "friction",
    "least_squares_held_out": "least_squares",
    "without_toml_held_out": "urdf_file",
}


@shows(Identification, "report")
def report_of(of: Identification) -> dict[str, Any]:
    """All numbers, for JSON: the contract of `mmnn identify --json`, and covariances."""
    regressor, labels = of.unknowns.regressor, of.unknowns.labels
    errors = {key: of.errors(model) for key, model in HELD_OUT.items()}
    joints: dict[str, Any] = {}
    for i, name in enumerate(of.names):
        why = of.why.get(name, "its effort follows the rigid body")
        joints[name] = {key: number(errors[key][i]) for key in HELD_OUT}
        joints[name] |= {"identified": bool(of.follows[i]), "why": why}
    base = of.fit.base
    return {
        "robot": of.robot.name,
        "rows": len(of.training),
        "cutoff": of.training.cutoff,
        "joints": joints,
        **{key: number(of.error(model)) for key, model in HELD_OUT.items()},
        "better": of.better,
        "plausible": of.plausible,
        "condition": number(of.fit.condition),
        "prior_weight": of.consistent.weight,
        "base_parameters": [
            {
                "combination": base.name(i, labels),
                "value": number(of.fit.value[i]),
                "sd": number(of.fit.sd[i]),
                "urdf": number(base.combination[i] @ of.unknowns.prior),
                "identified": bool(of.fit.seen[i]),
            }
            for i in range(len(of.fit.value))
        ],
        "bodies": dict(bodies_of(of)),
        "total": total_of(of),
        "friction": friction_of(of),
        "rotors": of.rotors,
        "timing": of.timing,
        "findings": [one.to_dict() for one in of.findings],
        "wheels": None if of.wheels is None else of.wheels.to_dict(),
        "not_identified": not_identified(of),
        "labels": list(labels),
        "theta": of.theta.tolist(),
        "covariance": of.consistent.covariance.tolist(),
        "regressor_size": regressor.size,
        "warnings": list(of.warnings),
        "notes": [
            *(f"{log.name}: {note}" for log in of.logs for note in log.notes),
            *(str(one) for one in of.findings if one.grade == "mended"),
            *of.notes,
        ],
    }


def bodies_of(of: Identification) -> Iterator[tuple[str, dict[str, Any]]]:
    """Mass, centre and inertia of every body, in the frame of its first link, with standard deviations."""
    regressor, links = of.unknowns.regressor, links_of(of.robot)
    theta = of.theta[: regressor.inertial]
    least = list(positive_bodies(of.theta, regressor.inertial))
    for b, (name, P) in enumerate(zip(regressor.bodies, pseudo_inertias(theta), strict=True)):
        back = np.linalg.inv(links[name][0][1]) if links.get(name) else np.eye(4)
        mass, centre, inertia = inertia_of(back @ P @ back.T)
        at = slice(BODY * b, BODY * b + 4)
        C = of.consistent.covariance[at, at]
        lever = P[:3, 3] / P[3, 3]
        to_centre = np.column_stack((-lever, np.eye(3))) / P[3, 3]
        spread = back[:3, :3] @ to_centre @ C @ to_centre.T @ back[:3, :3].T
        yield (
            name,
            {
                "link": links[name][0][0] if links.get(name) else "",
                "mass": mass,
                "mass_sd": float(np.sqrt(max(C[0, 0], 0.0))),
                "urdf_mass": float(of.unknowns.prior[BODY * b]),
                "com": centre.tolist(),
                "com_sd": np.sqrt(np.maximum(np.diag(spread), 0.0)).tolist(),
                "inertia": inertia.tolist(),
                "min_eigenvalue": least[b],
                "known": float(of.consistent.known[BODY * b : BODY * (b + 1)].max()),
            },
        )


def total_of(of: Identification) -> dict[str, Any]:
    """Mass, centre and inertia of the whole robot at rest, in its root's frame, with standard deviations.

    Of an arm that stands on the floor these are those of all links that move.
    """
    robot, regressor = of.robot, of.unknowns.regressor
    model, data = robot.model, robot.model.createData()
    pin.forwardKinematics(model, data, robot.configuration(robot.rest))
    moving = [i for i in range(3 if robot.dimensions.base else 0, model.nv) if robot.T[i].any()]
    joint = {name: model.getJointId(name) for name in (robot.full_velocity_names[i] for i in moving)}
    names = [name for name in regressor.bodies if name != "root"]
    frames = {name: data.oMi[joint[name]].homogeneous for name in names} | {"root": data.oMi[1].homogeneous}
    if not robot.dimensions.base:
        frames["root"] = np.eye(4)
    maps = [linear_map(frames[name]) for name in regressor.bodies]
    L = np.hstack(maps)
    first = regressor.inertial
    P, before = (pseudo_inertias(L @ theta[:first])[0] for theta in (of.theta, of.unknowns.prior))
    C = L[:4] @ of.consistent.covariance[:first, :first] @ L[:4].T
    mass, centre, inertia = inertia_of(P)
    to_centre = np.column_stack((-centre, np.eye(3))) / mass
    spread = to_centre @ C @ to_centre.T
    return {
        "mass": mass, "mass_sd": float(np.sqrt(max(C[0, 0], 0.0))), "urdf_mass": float(before[3, 3]),
        "com": centre.tolist(), "com_sd": np.sqrt(np.maximum(np.diag(spread), 0.0)).tolist(),
        "inertia": inertia.tolist(),
    } | (driven_of(of) if robot.dimensions.base else {})  # fmt: skip


def driven_of(of: Identification) -> dict[str, float]:
    """Mass that a base accelerates straight ahead [kg]: its own, and that of rotors and wheels over their lever^2."""
    regressor, p = of.unknowns.regressor, of.robot.dimensions.dof
    q, nudot = np.tile(of.robot.rest[of.robot.arm_index], (2, 1)), np.eye(2, p, k=-1)
    still, ahead = regressor.along(q, np.zeros((2, p)), nudot)[:, 0]
    y, k = ahead - still, regressor.size
    spread = float(y @ of.consistent.covariance[:k, :k] @ y)
    return {"driven": float(y @ of.theta[:k]), "driven_sd": float(np.sqrt(max(spread, 0.0)))}


def linear_map(H: Array) -> Array:
    """The map (10, 10) of a body's parameters into a frame in which it stands at H (4, 4)."""
    columns = [vector_of(H @ pseudo_inertias(row)[0] @ H.T) for row in np.eye(BODY)]
    return np.column_stack(columns)


def friction_of(of: Identification) -> dict[str, dict[str, dict[str, float | None]]]:
    """Rotors, friction and constants by joint, each with its standard deviation."""
    found: dict[str, dict[str, dict[str, float | None]]] = {}
    sd = np.sqrt(np.maximum(np.diag(of.consistent.covariance), 0.0))
    for i in of.unknowns.columns("rotor", "viscous", "coulomb", "offset", "stribeck"):
        name, _, kind = of.unknowns.labels[i].rpartition(".")
        if of.consistent.known[i] > BELIEVED and (
            kind not in ("rotor", "offset") or of.theta[i] != of.unknowns.prior[i]
        ):
            found.setdefault(name, {})[kind] = {"value": number(of.theta[i]), "sd": number(sd[i])}
    return found


def not_identified(of: Identification) -> dict[str, str]:
    """Bodies and joints that stay at the URDF, and why."""
    found = dict(of.why)
    for b, name in enumerate(of.unknowns.regressor.bodies):
        if of.consistent.known[BODY * b : BODY * (b + 1)].max() <= BELIEVED:
            found[f"body of {name}"] = "the motion does not tell its inertia"
    return found


def number(value: float) -> float | None:
    """A number for JSON; None for what is not finite."""
    return float(value) if np.isfinite(value) else None

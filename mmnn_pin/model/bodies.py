"""The moving bodies of a Pinocchio model, each named by the joint that carries it."""

from __future__ import annotations

import pinocchio as pin


def bodies_of(model: pin.Model) -> list[str]:
    """Joint that carries each moving body, `root` for a planar base."""
    names = list(model.names)[1:]
    return ["root", *names[1:]] if names and model.joints[1].shortname() == "JointModelPlanar" else names


def scale_body(model: pin.Model, joint: int, factor: float) -> None:
    """Scale the mass and the rotational inertia of the body that a joint carries."""
    body = model.inertias[joint]
    model.inertias[joint] = pin.Inertia(body.mass * factor, body.lever, body.inertia * factor)

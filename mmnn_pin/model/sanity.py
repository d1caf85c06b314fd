"""Is a Pinocchio model fit to be driven: mass matrix and forward dynamics at rest and at random states.

The audit judges bodies one by one; what only shows in the whole (a body that turns about its own centre of mass with an
inertia of almost nothing, numbers too far apart for a double) is found here, before anyone integrates it.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pinocchio as pin

from mmnn_pin.errors import RobotError
from mmnn_pin.signals import Array

from .urdf.document import Document

if TYPE_CHECKING:
    from mmnn_pin.model.robot import Robot

STATES = 8
SINGULAR = 1e-12  # smallest eigenvalue of the mass matrix scaled to a unit diagonal
INDISTINCT = 1e-15  # smallest eigenvalue over the largest entry, unscaled: less is lost in a double


def require_sane(document: Document, model: pin.Model) -> None:
    """Hold M and the forward dynamics against non-finite numbers and singularity at rest and random states.

    Args:
        document: The URDF, for the line of the body to blame.
        model: Its full model.

    Raises:
        RobotError: M or the acceleration is not finite, or M is not positive definite; names the body.
    """
    data, rng = model.createData(), np.random.default_rng(0)
    q0, still = pin.neutral(model), np.zeros(model.nv)
    for k in range(STATES):
        q = pin.integrate(model, q0, rng.uniform(-np.pi, np.pi, model.nv)) if k else q0
        velocity = rng.uniform(-1.0, 1.0, model.nv) if k else still
        M = pin.crba(model, data, q)
        M = np.triu(M) + np.triu(M, 1).T
        if not np.isfinite(M).all():
            raise blame(document, model, ~np.isfinite(M).all(axis=1), "the mass matrix is not finite")
        for matrix, least in ((scaled(M), SINGULAR), (M, INDISTINCT * np.abs(M).max(initial=0.0))):
            values, vectors = np.linalg.eigh(matrix)
            if values.min(initial=np.inf) <= least:
                what = f"the mass matrix is singular or not positive definite (smallest eigenvalue {values[0]:.3g})"
                raise blame(document, model, np.abs(vectors[:, 0]), what)
        acceleration = pin.aba(model, data, q, velocity, still)
        if not np.isfinite(acceleration).all():
            raise blame(document, model, ~np.isfinite(acceleration), "the forward dynamics are not finite")


def require_finite(document: Document, robot: Robot) -> None:
    """Hold the reduced mass matrix and the reduced forces at rest against numbers that are not finite.

    Radii, mimic multipliers and what they multiply enter only there.

    Raises:
        RobotError: One is not finite, or the mass matrix is not positive definite.
    """
    model, T, p = robot.model, robot.T, robot.layout.dof
    data, q = model.createData(), robot.configuration(robot.neutral_position())
    with np.errstate(all="ignore"):
        M = np.triu(pin.crba(model, data, q))
        M = T.T @ (M + np.triu(M, 1).T) @ T
        forces = T.T @ pin.nonLinearEffects(model, data, q, T @ np.ones(p))
    if not (np.isfinite(M).all() and np.isfinite(forces).all()):
        what = "the dynamics of base and arm are not finite"
    elif np.linalg.eigvalsh(scaled(M)).min(initial=np.inf) <= SINGULAR:
        what = "the mass matrix of base and arm is singular"
    else:
        return
    why = "a wheel's radius, a mimic multiplier or a mass is beyond what a double holds"
    raise RobotError(what, why=why, fix="check them", file=document.path)


def scaled(M: Array) -> Array:
    """M with a unit diagonal where it is positive, so that kg and g m^2 count alike."""
    diagonal = np.diag(M)
    scale = 1 / np.sqrt(np.where(diagonal > 0, diagonal, 1.0))
    with np.errstate(over="ignore", invalid="ignore"):
        result = M * scale * scale[:, None]
    return np.where(np.isfinite(result), result, 0.0)


def blame(document: Document, model: pin.Model, guilt: Array, what: str) -> RobotError:
    """The error that names the body of the velocity with the most guilt, the last of equals.

    Args:
        document: The URDF.
        model: Its full model.
        guilt: (nv,) how much each velocity is to blame.
        what: What is wrong.
    """
    index = len(guilt) - 1 - int(np.argmax(np.asarray(guilt, dtype=float)[::-1]))
    name = next(
        n for n, joint in zip(model.names, model.joints, strict=True) if joint.idx_v <= index < joint.idx_v + joint.nv
    )
    joint = document.joints.get(name)
    body = "the root's body" if joint is None else f"link '{joint.child}', moved by joint '{name}'"
    link = document.links[document.root_link if joint is None else joint.child]
    return RobotError(
        f"{body}: {what}",
        why="its inertia is zero, next to nothing or beyond what a double holds",
        fix="check its <inertial>, and those of what hangs on it",
        file=document.path,
        line=link.sourceline,
    )

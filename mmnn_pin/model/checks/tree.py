"""The check of a flattened tree against Pinocchio at random states."""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from mmnn_pin.errors import RobotError

from ..tree.dynamics import psi_again, terms
from ..tree.motion import Array, Tree, Vector, new_scratch

TOLERANCE = 1e-10


def verify(tree: Tree, model: pin.Model, T: Array, position_rest: Array, samples: int = 5, seed: int = 0) -> None:
    """Compare a tree with Pinocchio at random states.

    Raises:
        RobotError: M, h or Psi differ by more than 1e-10, relative; it names the joint that differs most.
    """
    worst = residual(tree, model, T, position_rest, samples, seed)
    row = int(np.argmax(worst))
    if worst[row] <= TOLERANCE:
        return
    joint = next(j for j in range(1, model.njoints) if T[model.idx_vs[j] : model.idx_vs[j] + model.nvs[j], row].any())
    raise RobotError(
        f"the compiled dynamics differ from Pinocchio's at joint '{model.names[joint]}' by {worst[row]:.1e}, relative",
        why=f"at most {TOLERANCE:.0e} is accepted",
        fix="look for masses or inertias of that joint that are far apart in size, or not physical",
    )


def residual(tree: Tree, model: pin.Model, T: Array, position_rest: Array, samples: int = 5, seed: int = 0) -> Array:
    """Largest difference of M, h and Psi from Pinocchio's in every row, relative, shape (p,).

    An entry of M counts relative to `sqrt(M_ii M_jj)` and a force relative to `sqrt(M_ii)` times the largest force in
    that measure, so that a finger counts as much as the base that carries it. What is not a number counts as inf.
    """
    rng, p = np.random.default_rng(seed), T.shape[1]
    scratch, data = new_scratch(tree), model.createData()
    worst, M, h, psi = np.zeros(p), np.zeros((p, p)), np.zeros(p), np.zeros(p)
    for _ in range(samples):
        position = _random_position(model, T, position_rest, rng)
        nu, nu_ref, nudot_ref = rng.standard_normal((3, p))
        terms(tree, position, nu, scratch, M, h)
        psi_again(tree, position, nu_ref, nudot_ref, scratch, psi)
        q = configuration(model, position, tree.frame)
        M_pin, h_pin, psi_pin = _by_pinocchio(model, data, T, q, nu, nu_ref, nudot_ref)
        root = np.sqrt(np.diag(M_pin))
        root = np.maximum(root, 1e-8 * root.max())
        errors = np.abs(M - M_pin) / np.outer(root, root)
        for ours, theirs in ((h, h_pin), (psi, psi_pin)):
            scale = np.max(np.abs(theirs / root)) + root.max()
            errors = np.column_stack((errors, np.abs(ours - theirs) / (root * scale)))
        worst = np.maximum(worst, np.nan_to_num(errors, nan=np.inf).max(axis=1))
    return worst


def _by_pinocchio(
    model: pin.Model, data: pin.Data, T: Array, q: Array, nu: Array, nu_ref: Array, nudot_ref: Array
) -> tuple[Array, Array, Array]:
    """The same M, h and Psi by the full matrices of Pinocchio."""
    M = T.T @ pin.crba(model, data, q) @ T
    h = T.T @ pin.nonLinearEffects(model, data, q, T @ nu)
    g = T.T @ pin.computeGeneralizedGravity(model, data, q)
    C = pin.computeCoriolisMatrix(model, data, q, T @ nu)
    return M, h, M @ nudot_ref + T.T @ C @ T @ nu_ref + g


def configuration(model: pin.Model, position: Array, frame: Vector) -> Array:
    """Pinocchio's q, shape (nq,), of a position (nv,) that begins with the pose of the control frame."""
    q = pin.neutral(model)
    for joint in list(model.joints)[1:]:
        i, k = joint.idx_q, joint.idx_v
        if joint.nv == 3:
            x, y, phi = position[k : k + 3]
            phi -= frame[2]
            c, s = np.cos(phi), np.sin(phi)
            q[i : i + 4] = x - c * frame[0] + s * frame[1], y - s * frame[0] - c * frame[1], c, s
        elif joint.nq == 2:
            q[i : i + 2] = np.cos(position[k]), np.sin(position[k])
        else:
            q[i] = position[k]
    return q


def _random_position(model: pin.Model, T: Array, rest: Array, rng: np.random.Generator) -> Array:
    """Position within the limits, or within one turn (or 3 m); what stands still stays at rest."""
    position = rng.uniform(-np.pi, np.pi, model.nv)
    for joint in list(model.joints)[1:]:
        low, high = model.lowerPositionLimit[joint.idx_q], model.upperPositionLimit[joint.idx_q]
        if joint.nq == 1 and -1e3 < low < high < 1e3:
            position[joint.idx_v] = rng.uniform(low, high)
        if joint.nv == 1 and not T[joint.idx_v].any():
            position[joint.idx_v] = rest[joint.idx_v]
    return position

"""How large the input of the networks may become in a box of errors: every signal that they may see, by intervals."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from ...signals import Array
from .motion_bound import Drive

if TYPE_CHECKING:
    from .certified_loop import CertifiedLoop


def input_norm(loop: CertifiedLoop, added: Drive, pose: float, arm: Array, s: Array) -> float:
    """Largest |x|, for a size of the pose error [m], arm errors (n,), velocity errors (p,) and what they drive."""
    assert loop.learner is not None
    inputs, layout = loop.learner.own.inputs, loop.robot.layout
    row = layout.new_row()
    for name, value in signal_bounds(loop, added, pose, arm, s).items():
        row[layout.where(name)] = value
    scale, offset = inputs.affine(layout)
    return float(np.linalg.norm(np.abs(scale) * row[inputs.rows(layout)] + np.abs(offset)))


def signal_bounds(loop: CertifiedLoop, added: Drive, pose: float, arm: Array, s: Array) -> dict[str, Array]:
    """Largest absolute value of every signal that a network may see."""
    along, reach = loop.along, loop.pose.reach(pose)
    ref = {name: np.abs(getattr(along, name)).max(axis=0) for name in along.__dataclass_fields__}
    nu = np.abs(along.nu).max(axis=0) + added.nu
    nudot = np.abs(along.nudot).max(axis=0) + np.concatenate((added.nudot, loop.K**2 * arm))
    nudot += (np.abs(added.middle) + added.half) @ s
    away = pose / np.sqrt(1 - loop.pose.eps)  # |(ex, ey)| at most: the smallest eigenvalue of the metric is 1 - eps
    error = np.array([reach.ex, reach.ey, reach.heading])
    edot = s[2:] + loop.K * arm
    return {
        "pose_ref": ref["pose_ref"],
        "velocity_ref": ref["v_ref"],
        "acceleration_ref": ref["a_ref"],
        "q_ref": ref["q_ref"],
        "qdot_ref": ref["qdot_ref"],
        "qddot_ref": ref["qddot_ref"],
        "pose": ref["pose_ref"] + np.array([away, away, reach.heading]),
        "velocity": nu[:2] + s[:2],
        "q": ref["q_ref"] + arm,
        "qdot": ref["qdot_ref"] + edot,
        "alpha": nu[:2],
        "alphadot": nudot[:2],
        "pose_error": error,
        "world_error": np.array([away, away, reach.heading]),
        "z": s[:2],
        "e": arm,
        "edot": edot,
        "r": s[2:],
        "nu_ref": nu,
        "nudot_ref": nudot,
    }

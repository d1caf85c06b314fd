"""The exact sensor: everything is measured as it is at its sampling instants."""

from __future__ import annotations

from ..compiled import compiled
from ..signals import INDEX, Array, IntArray

POSE, VELOCITY, Q, QDOT = INDEX["pose"], INDEX["velocity"], INDEX["q"], INDEX["qdot"]


@compiled
def exact(row: Array, at: IntArray, position: Array, nu: Array, arm: IntArray) -> None:
    """Exact measurement of pose, base velocity, arm joints and their rates.

    Args:
        row: (width,) row of signals; pose, velocity, q, qdot are written.
        at: Offsets of the signals.
        position: (nv,) true position.
        nu: (p,) true velocity.
        arm: (n,) places of the arm joints in the position.
    """
    pose, velocity, q, qdot = (
        row[at[POSE] : at[POSE + 1]],
        row[at[VELOCITY] : at[VELOCITY + 1]],
        row[at[Q] : at[Q + 1]],
        row[at[QDOT] : at[QDOT + 1]],
    )
    for i in range(pose.size):
        pose[i] = position[i]
    for i in range(velocity.size):
        velocity[i] = nu[i]
    for i in range(q.size):
        q[i] = position[arm[i]]
        qdot[i] = nu[velocity.size + i]

"""Which joints have a rotor, and whether a base has a constant force: those whose motion asks for one.

Mass belongs in links before it belongs in motors, and a URDF holds neither. With x the coordinates of `Prior`, R and z
the weighted equations and f how many of them say as much as one,

    J(S) = min over x  |R x - z|^2 / f + |D x|^2,     rotors and constants only in S,

D that of the prior, `1 / DOUBT` for bodies. A rotor or a constant joins S where that lowers J by `ASKED`, the largest
first: links would have to be further from the URDF, or efforts further from the motion, than chance explains. The
prior of a rotor that is there is as weak as that of friction, or links would take a part of it. A wheel's rotor says
what the base's mass says, so a base that is heavier than its file is found heavier, and no rotor is made up. What the
data leave open between the two is in the bands, which allow for every rotor.
"""

from __future__ import annotations

from typing import Literal

import numpy as np

from ...signals import Array
from ...torque.prior import DOUBT
from ...torque.pseudo_inertia import BODY
from .equations import Bools
from .programme import Prior

ASKED = 20.0  # fall of J from which a rotor is believed: odds of 22,000 to one
LOOSE = 1e-3  # of D, for friction and constants
RotorChoice = Literal["no", "yes", "auto"]


def rotors_of(R: Array, z: Array, prior: Prior, inflation: float, choice: RotorChoice) -> tuple[Bools, dict[str, str]]:
    """Coordinates (m,) that a fit may move, all but what nothing asks for; and why each joint has a rotor or none.

    Args:
        R: (m, m) and
        z: (m,) of `programme.compressed`.
        prior: Its coordinates.
        inflation: How many equations say as much as one.
        choice: `"no"` rotor beyond the URDF's, one in every joint, or `"auto"`.
    """
    unknowns, allowed = prior.unknowns, np.ones(prior.B.shape[1], bool)
    rotors, free = unknowns.columns("rotor").tolist(), unknowns.robot.velocity_names[: unknowns.robot.dimensions.base]
    constants = [int(i) for i in unknowns.columns("offset") if unknowns.labels[i].rpartition(".")[0] in free]
    allowed[constants] = False
    allowed[rotors] = choice == "yes"
    left = [*constants, *(rotors if choice == "auto" else ())]
    why: dict[str, str] = {}
    while left:
        gains = {i: gain(R, z, prior, inflation, allowed, i) for i in left}
        best = max(gains, key=lambda i: gains[i])
        if gains[best] < ASKED:
            break
        allowed[best] = True
        left.remove(best)
        if best in rotors:
            name = unknowns.labels[best].rpartition(".")[0]
            why[name] = "a rotor: without it links would be too far from the URDF"
    for i in set(left) & set(rotors):
        why[unknowns.labels[i].rpartition(".")[0]] = "no rotor: links near the URDF explain the motion as well"
    return allowed, why


def gain(R: Array, z: Array, prior: Prior, inflation: float, allowed: Bools, i: int) -> float:
    """By how much J falls when coordinate i is free, too; 0 where it would be negative and may not."""
    weight = np.where(np.arange(len(allowed)) < BODY * prior.bodies, 1.0 / DOUBT, LOOSE) ** 2
    S, column = R[:, allowed], R[:, i]
    A = S.T @ S / inflation + np.diag(weight[allowed])
    x = np.linalg.solve(A, np.column_stack((S.T @ z, S.T @ column)) / inflation)
    slope = float(column @ (z - S @ x[:, 0])) / inflation
    curvature = float(column @ (column - S @ x[:, 1])) / inflation + weight[i]
    return slope**2 / curvature if slope > 0 or not np.isfinite(prior.positive[i - BODY * prior.bodies]) else 0.0

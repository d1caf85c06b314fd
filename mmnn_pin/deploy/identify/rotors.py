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

from collections.abc import Sequence
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
        gains = gains_of(R, z, prior, inflation, allowed, left)
        if gains.max() < ASKED:
            break
        best = left[int(np.argmax(gains))]
        allowed[best] = True
        left.remove(best)
        if best in rotors:
            name = unknowns.labels[best].rpartition(".")[0]
            why[name] = "a rotor: without it links would be too far from the URDF"
    for i in set(left) & set(rotors):
        why[unknowns.labels[i].rpartition(".")[0]] = "no rotor: links near the URDF explain the motion as well"
    return allowed, why


def gains_of(R: Array, z: Array, prior: Prior, inflation: float, allowed: Bools, left: Sequence[int]) -> Array:
    """By how much J falls when one more coordinate is free, for each that is left; 0 where it may not be negative.

    The normal equations of an exact log are singular in floating point, so columns are made orthogonal to those that
    are free: with c and y what is left of one and of the right-hand side, J falls by `(c'y)^2 / c'c`.
    """
    weight = np.where(np.arange(len(allowed)) < BODY * prior.bodies, 1.0 / DOUBT, LOOSE)
    A = np.vstack((R / np.sqrt(inflation), np.diag(weight)))
    y = np.concatenate((z / np.sqrt(inflation), np.zeros(len(weight))))
    Q, c = np.linalg.qr(A[:, allowed])[0], A[:, left]
    c, y = c - Q @ (Q.T @ c), y - Q @ (Q.T @ y)
    slope = c.T @ y
    bounded = np.isfinite(prior.positive[np.array(left) - BODY * prior.bodies])
    return np.asarray(np.where(bounded, np.maximum(slope, 0.0), slope) ** 2 / (c**2).sum(axis=0))

"""The thesis's own bounds (3.44)-(3.65), as printed, in numbers; they are not proved (docs/theory.md, section 7).

Per network, with the error that drives it of gain k (the smallest of its velocities), |Z*| <= ZB, |x| <= qB + c2 |s|:

    C0 = eps_N + dB + sqrt(h) ZB        C1 = sqrt(2)/4 ZB qB        C2 = sqrt(2)/4 ZB c2
    C6 = ZB + C1/kappa      b = (C0 + kappa C6^2/4)/k      bZ = C6/2 + sqrt(C0/kappa + C6^2/4)      Kz > C2

The thesis leaves c0, c2, qB and dB open. Here c0 = 0, dB is the external force of the run, c2 is how strongly x follows
s (by itself and through alphadot), and qB the largest |x| - c2 |s| along the run. eps_N and |Z*| are those of the ideal
weights.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from ...model.base import BY_SIZE
from ...signals import Array
from ...torque.neural import Robust
from .ideal import Ideal
from .learner import Networks, seen
from .subject import Subject


@dataclass(frozen=True)
class Printed:
    """One network's bounds as printed.

    Attributes:
        C: C0, C1, C2, C6 of the base or C3, C4, C5, C7 of the arm.
        error: Ultimate bound printed for |z| or |r|, (3.59) or (3.62).
        weights: Ultimate bound printed for |Ztilde|, (3.60) or (3.63).
        half_width: Where the two braces together may stop V from falling: half-width in |z| or |r| (gap a).
        robust: Smallest Kz of the run, which (3.51) or (3.52) wants above C2 or C5.
        reached: Largest |z| or |r| over the last half of the run.
    """

    C: tuple[float, float, float, float]
    error: float
    weights: float
    half_width: float
    robust: float
    reached: float

    @property
    def gain_holds(self) -> bool:
        """(3.51) or (3.52)."""
        return self.robust > self.C[2]


def printed(subject: Subject, learner: Networks, ideal: dict[int, Ideal], force: Array) -> dict[int, Printed]:
    """The printed bounds of every network (1 the base's, 2 the arm's); empty where kappa is 0; force (p,) is d."""
    controller, h = learner.own, learner.own.network.hidden
    x = np.linalg.norm(seen(learner, learner.start, subject.rows).inputs, axis=1)
    gain, parts = controller.feedback.vector(subject.layout), dict(learner.networks)
    s = {i: np.linalg.norm(subject.signal("z" if i == 1 else "r"), axis=1) for i in parts}
    numbers: dict[int, tuple[tuple[float, float, float, float], float, float]] = {}
    for i, part in parts.items():
        _, _, kappa = controller.network.rates(i - 1, controller.leakage)
        if not kappa > 0:
            return {}
        ZB, c2 = ideal[i].norm, follows(subject, learner, i)
        qB = float((x - c2 * s[i]).max())
        C0 = ideal[i].eps_N + float(np.linalg.norm(force[part])) + math.sqrt(h) * ZB
        C1, C2 = math.sqrt(2) / 4 * ZB * max(qB, 0.0), math.sqrt(2) / 4 * ZB * c2
        C6 = ZB + C1 / kappa
        numbers[i] = (C0, C1, C2, C6), C0 + kappa * C6**2 / 4, C6 / 2 + math.sqrt(C0 / kappa + C6**2 / 4)
    found = {}
    for i, part in parts.items():
        C, D, bZ = numbers[i]
        k, other = float(gain[part].min()), next((j for j in parts if j != i), None)
        rest = numbers[other][1] ** 2 / (4 * k * gain[parts[other]].min()) if other else 0.0
        half = D / (2 * k) + math.sqrt(D**2 / (4 * k**2) + rest)
        term = controller.robust or Robust(0.0, 0.0)
        robust = term.base if i == 1 else term.arm
        last = float(s[i][len(s[i]) // 2 :].max())
        found[i] = Printed(C, D / k, bZ, half, float(np.min(robust)), last)
    return found


def follows(subject: Subject, learner: Networks, i: int) -> float:
    """c2 of the base's or c10 of the arm's network: largest factor from z, or r, to the input that depends on it."""
    signals, scale, k = learner.own.inputs.signals, learner.own.inputs.scale, subject.kinematic
    K, nb = k.arm_gains(subject.layout), subject.layout.base
    if i == 1:
        v = float(np.abs(subject.signal("velocity_ref")).max(initial=0.0))
        Az = BY_SIZE[nb].largest_gain(k.base_gains(nb), v)
    else:
        Az = float(K.max())
    base = {"z": 1.0, "velocity": 1.0, "alphadot": Az, "nudot_ref": Az}
    own = base if i == 1 else {"r": 1.0, "edot": 1.0, "qdot": 1.0, "nudot_ref": Az}
    return scale * math.sqrt(sum(own.get(name, 0.0) ** 2 for name in signals))

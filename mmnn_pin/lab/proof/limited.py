"""What the motors' limits take from Psi_hat along a run: a term of the Lyapunov function's derivative.

Its weights' part speaks of what the weights say, the torque has the Psi_hat that `torque.law` left of that:

    s' (Psi - Psi_hat) = s' (Psi - said) + s' (said - Psi_hat)
"""

from __future__ import annotations

import numpy as np

from ...signals import Array, IntArray
from .learner import Learner, Stepper


def taken(learner: Learner, rows: Array, at: IntArray) -> Array:
    """`s' (said - Psi_hat)` at some rows of a run, (k,) [W]; zeros for a learner that is not limited.

    Args:
        learner: The learner; it is stepped again over all rows.
        rows: (N, width) rows of its run.
        at: (k,) which of them.
    """
    layout, limits, found = learner.context.layout, learner.context.limits, np.zeros(len(rows))
    if limits is None:
        return found[at]
    stepper = Stepper(learner, learner.start.snapshot())
    for n, row in enumerate(rows):
        psi_hat = stepper.step(row)
        s = np.concatenate((row[layout.where("z")], row[layout.where("r")]))
        found[n] = s @ (stepper.known - psi_hat)
    return found[at]

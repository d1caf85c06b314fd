"""The best fixed weights of a learner that is linear in them, `Psi_hat = Psi_0 + Phi W`.

With a regressor of the robot they are its true parameters (`truth.true_weights`), where the weights are those. Else
they are found offline: least squares of the true Psi on the features of the run, every component over its variance.
Where all components share the weights it is the shortest of all that are best; where each has its own, as random
features have, far more of them than a run tells apart, there is a small penalty as for networks (`ideal`),

    FVU_i + PENALTY mean over j of (W_ij / unit_ij)^2   ->   min over W_i

with the standard deviations of the learner's prior as units, or, without a prior, those that bring all features and Psi
to one size. What the weights leave is what no learning of them could explain there; outside the visited set it bounds
nothing.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.linalg import cho_factor, cho_solve

from ...errors import InputError
from ...signals import Array
from ...torque.controller import CompiledController
from .features import along
from .ideal import PENALTY, variances
from .learner import Learner
from .subject import Subject
from .truth import true_weights

CUT = 1e-9  # singular values below this share of the largest count as zero


@dataclass(frozen=True, eq=False)
class LinearFit:
    """The best fixed weights of a linear learner on the visited set.

    Attributes:
        W: (k, m) weights; m is 1 where all components share them, else p.
        norm: |W|.
        eps: (p,) largest `|Psi - Psi_0 - Phi W|` on the visited set [N, N m].
        unexplained: (p,) fraction of variance that they leave.
        true: Whether they are the robot's parameters, not a fit.
        distance: How far the run's weights are from them at its start and end, (2,): RMS of `Phi (W - W_run)` over the
            standard deviation of Psi; NaN where the weights are kept otherwise.
    """

    W: Array
    norm: float
    eps: Array
    unexplained: Array
    distance: Array
    true: bool = False


def linear_fit(subject: Subject, learner: Learner) -> LinearFit | None:
    """The best fixed weights of a run's learner, its true ones where they are known; None without features."""
    told = along(learner, subject.rows)
    if told is None:
        return None
    psi, rows = subject.signal("psi")[told.at], told.Phi.shape[1]
    m = 1 if rows > 1 else psi.shape[1]
    weights = map(learner.controller.weights, (learner.start, learner.end))
    ends = [of_shape(arrays, told.Phi.shape[2], m) for arrays in weights]
    known = 0.0 if ends[1] is None else told.psi_hat - (told.Phi @ ends[1]).reshape(psi.shape)
    target, scale = psi - known, np.sqrt(variances(psi))
    true = true_or_none(subject, learner)
    if true is not None:
        W = true[:, None]
    elif rows == 1:
        W = penalised(told.Phi[:, 0], target, variances(psi), units(learner, told.Phi[:, 0], scale))
    else:
        table = (told.Phi / scale[:, None]).reshape(-1, told.Phi.shape[2])
        W = least_squares(table, (target / scale).reshape(-1, 1))
    left = target - (told.Phi @ W).reshape(psi.shape)
    return LinearFit(
        W=W,
        norm=float(np.linalg.norm(W)),
        eps=np.abs(left).max(axis=0),
        unexplained=(left**2).mean(axis=0) / variances(psi),
        true=true is not None,
        distance=np.array([np.nan if W_run is None else away(told.Phi @ (W - W_run), scale) for W_run in ends]),
    )


def true_or_none(subject: Subject, learner: Learner) -> Array | None:
    """The true weights (k,), where they are known."""
    try:
        return true_weights(subject, learner)
    except InputError:
        return None


def units(learner: Learner, Phi: Array, scale: Array) -> Array:
    """What a weight of every feature and component counts as one, (k, p); 0 for one that the prior does not let be."""
    controller = learner.controller
    deviation = controller.prior_deviation(learner.start) if isinstance(controller, CompiledController) else None
    if deviation is not None:
        return np.asarray(deviation)
    size = np.sqrt((Phi**2).mean(axis=0))
    return np.divide(1.0, size, out=np.zeros_like(size), where=size > 0)[:, None] * scale


def penalised(Phi: Array, target: Array, variance: Array, unit: Array) -> Array:
    """Weights (k, p) of least penalised squares for features (n, k), target (n, p), variances (p,) and units (k, p)."""
    gram, cross, k = Phi.T @ Phi / len(Phi), Phi.T @ target / len(Phi), Phi.shape[1]
    columns = []
    for i, one in enumerate(unit.T):
        factor = cho_factor(gram * np.outer(one, one) + PENALTY * variance[i] / k * np.eye(k))
        columns.append(one * cho_solve(factor, one * cross[:, i]))
    return np.column_stack(columns)


def away(difference: Array, scale: Array) -> float:
    """RMS of a difference in Psi_hat (n, rows, m), each component over its scale (p,)."""
    return float(np.sqrt(((difference.reshape(-1, scale.size) / scale) ** 2).mean()))


def least_squares(table: Array, target: Array) -> Array:
    """The shortest weights (k, m) of least squares, in units in which all features are of one size."""
    size = np.sqrt((table**2).mean(axis=0))
    size[size == 0] = 1.0
    return np.asarray(np.linalg.lstsq(table / size, target, rcond=CUT)[0] / size[:, None])


def of_shape(weights: dict[str, Array], k: int, m: int) -> Array | None:
    """The one array of weights with k m numbers, as (k, m); None without exactly one."""
    found = [array for array in weights.values() if array.size == k * m]
    if len(found) != 1:
        return None
    return found[0].T if found[0].shape == (m, k) and m > 1 else found[0].reshape(k, m)

"""What a learner's weights are multiplied with along a run, and how well that was excited; networks, or a regressor.

The excitation of a regressor counts in the combinations of parameters that change Psi on some motion, against what
random motion of unit speed excites: 1 in every direction for such a motion.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..signals import Array
from ..torque.adaptive import EXCITED, Adaptive
from ..torque.network import numerical_rank
from .learner import Learner, Stepper
from .networks import Networks, seen
from .rank import Excitation, effective_rank, excitation

MOST = 2000  # rows that are looked at, evenly spread


@dataclass(frozen=True, eq=False)
class Network:
    """The weights of one network or regressor at the end, and what they were multiplied with along the run.

    Attributes:
        name: `base`, `arm`, or `all` for one that serves all velocities.
        what: What the weights are multiplied with, in a word.
        ranks: Effective rank of W, V and what else there is of weights that are matrices.
        numerical: Numerical rank of the same.
        singular: Singular values of the same.
        excitation: Of what they are multiplied with.
    """

    name: str
    what: str
    ranks: dict[str, float]
    numerical: dict[str, int]
    singular: dict[str, Array]
    excitation: Excitation

    @classmethod
    def of(cls, name: str, what: str, weights: dict[str, Array], excited: Excitation) -> Network:
        """With the ranks of the weights that are matrices of more than one column and row."""
        matrices = {key: W for key, W in weights.items() if W.ndim == 2}
        return cls(
            name=name,
            what=what,
            ranks={key: effective_rank(W) for key, W in matrices.items()},
            numerical={key: numerical_rank(W) for key, W in matrices.items()},
            singular={key: np.asarray(np.linalg.svd(W, compute_uv=False), float) for key, W in matrices.items()},
            excitation=excited,
        )


def features_of(learner: Learner, rows: Array) -> list[Network]:
    """What a learner's weights were multiplied with along rows (N, width); empty where it does not tell."""
    if isinstance(learner, Networks):
        told = seen(learner, learner.end, rows)
        return [network_of(learner, i, told.activations[i]) for i, _ in learner.networks]
    if isinstance(learner.controller, Adaptive):
        return [regressor_of(learner, learner.controller, rows)]
    return []


def network_of(learner: Networks, i: int, activations: Array) -> Network:
    """Ranks and excitation of the i-th network."""
    weights = {name[0]: W for name, W in learner.controller.weights(learner.end).items() if name.endswith(str(i))}
    return Network.of({1: "base", 2: "arm"}[i], "activations", weights, excitation(activations))


def regressor_of(learner: Learner, controller: Adaptive, rows: Array) -> Network:
    """Excitation of the regressor in the combinations that matter, against that of random motion."""
    mean, basis = controller.identifiable
    white = basis @ np.linalg.inv(np.linalg.cholesky(basis.T @ mean @ basis)).T
    stepper = Stepper(learner, learner.end.snapshot(), learning=False)
    known = stepper.torque.law.adaptation.known  # type: ignore[union-attr]
    found = []
    for row in rows[:: -(-len(rows) // MOST)]:
        stepper.step(row)
        found.append(known.Y @ white)
    stacked = np.vstack(found) * np.sqrt(len(found[0]))  # the mean is over samples, not over the p rows of each
    return Network.of("all", "regressor", {}, excitation(stacked, EXCITED))

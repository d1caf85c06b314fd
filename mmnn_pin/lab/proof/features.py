"""What a learner's weights are multiplied with along a run, and how well that was excited; networks, or a regressor.

The excitation of a regressor counts in the combinations of parameters that change Psi on some motion, against what
random motion of unit speed excites: 1 in every direction for such a motion.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...model.regressor import Regressor
from ...signals import Array, IntArray
from ...torque.adaptive import EXCITED
from ...torque.two_layer import numerical_rank
from .excitation import MOST as FEW
from .excitation import Excitation, Unknown, effective_rank, excitation, network_in, tangents, unknown
from .learner import NAMES, Learner, Networks, Stepper, seen

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
        unknown: What the run leaves undetermined on random motion; None for a learner that judges it itself.
    """

    name: str
    what: str
    ranks: dict[str, float]
    numerical: dict[str, int]
    singular: dict[str, Array]
    excitation: Excitation
    unknown: Unknown | None = None

    @classmethod
    def of(
        cls, name: str, what: str, weights: dict[str, Array], excited: Excitation, unknown: Unknown | None = None
    ) -> Network:
        """With the ranks of the weights that are matrices of more than one column and row."""
        matrices = {key: W for key, W in weights.items() if W.ndim == 2}
        return cls(
            name=name,
            what=what,
            ranks={key: effective_rank(W) for key, W in matrices.items()},
            numerical={key: numerical_rank(W) for key, W in matrices.items()},
            singular={key: np.asarray(np.linalg.svd(W, compute_uv=False), float) for key, W in matrices.items()},
            excitation=excited,
            unknown=unknown,
        )


def features_of(learner: Learner, rows: Array) -> list[Network]:
    """What a learner's weights were multiplied with along rows (N, width); empty where it does not tell."""
    left = unknown(learner, rows)
    if isinstance(learner, Networks):
        told = seen(learner, learner.end, rows)
        return [network_of(learner, i, told.activations[i], left) for i, _ in learner.networks]
    own = network_in(learner.controller)
    if own is not None:  # behind a nominal model
        found = tangents(learner, own, rows[:: -(-len(rows) // FEW)])
        return [network_of(learner, i, one.activations, left) for i, one in found.items()]
    linear = along(learner, rows)
    return [] if linear is None else [linear_of(learner, linear.Phi, left.get("all"))]


def network_of(learner: Learner, i: int, activations: Array, left: dict[str, Unknown]) -> Network:
    """Ranks and excitation of the i-th network."""
    weights = {name[0]: W for name, W in learner.controller.weights(learner.end).items() if name.endswith(str(i))}
    return Network.of(NAMES[i], "activations", weights, excitation(activations), left.get(NAMES[i]))


@dataclass(frozen=True, eq=False)
class Along:
    """A linear learner with fixed weights along a run.

    Attributes:
        at: (n,) the rows that are looked at.
        Phi: (n, rows, k) features there.
        psi_hat: (n, p) what it says there [N, N m].
    """

    at: IntArray
    Phi: Array
    psi_hat: Array


def along(learner: Learner, rows: Array) -> Along | None:
    """Features along a run (N, width); None where the learner does not tell them."""
    stepper, found = Stepper(learner, learner.end.snapshot(), learning=False), list[tuple[Array, Array]]()
    at = np.arange(0, len(rows), -(-len(rows) // MOST))
    for row in rows[at]:
        psi_hat = stepper.step(row).copy()
        Phi = stepper.features()
        if Phi is None:
            return None
        found.append((Phi, psi_hat))
    features, said = zip(*found, strict=True)
    return Along(at, np.array(features), np.array(said))


def linear_of(learner: Learner, Phi: Array, left: Unknown | None) -> Network:
    """Excitation of features (n, rows, k); of a regressor in the combinations that matter, against random motion."""
    _, rows, k = Phi.shape
    table = Phi.reshape(-1, k) * np.sqrt(rows)  # the mean is over samples, not over the rows of each
    weights = learner.controller.weights(learner.end)
    regressor = learner.context.regressor or getattr(learner.controller, "regressor", None)
    if not isinstance(regressor, Regressor) or regressor.size != k or rows == 1:
        return Network.of("all", "features", weights, excitation(table), left)
    return Network.of("all", "regressor", weights, excitation(table @ regressor.unit(), EXCITED), left)

"""Was the learner excited? Ranks of its weights and activations, and what the run leaves undetermined of them.

Excitation is that of the activations over the run: where the Gram matrix `mean sigma sigma'` has a small eigenvalue,
weights leave no trace in the output. That of a regressor counts in the combinations of parameters that change Psi on
some motion, against what random motion of unit speed excites: 1 in every direction for such a motion. What a run leaves
*undetermined* is measured on random motion instead. To first order a change dw of the weights moves the output by `J
dw`: for a network `J = [sigma, sigma' W x]`, W's part and V's; for a learner that is linear in its weights its
features. Weights are measured by their rates, as the thesis's V measures them (`tr(Wt' F^-1 Wt)`), so one that is not
learned has no part, and outputs by their deviation on random motion. There, the mean taken out, J shows some directions
of the weights (`VISIBLE`), in which it is scaled to one: `E_random[Jc' Jc] = 1`. What a run leaves of a variance of 1
in each of them is

    P = (1 + E_run[J' J] / NOISE)^-1,      undetermined = trace P / directions,

0 for a run that determines all of them and 1 for one that determines none. E_run is a mean over the run: a longer one
of the same motion says no more. It is about what could be known of the motion, not about what was learned.

A network whose units act as few on random motion (`acting`) is another case: no motion determines its weights.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...model.base.steered import SteeredBase
from ...model.regressor import Regressor
from ...model.robot import Robot
from ...settings import finite
from ...signals import Array, Layout
from ...torque.adaptive import EXCITED
from ...torque.neural import Neural, channels
from ...torque.two_layer import numerical_rank
from .learner import NAMES, Learner, LearnerStepper, NetworkLearner, seen

NOISE = 1e-3  # of what random motion does: less does not count as excited, as in `torque.adaptive`
VISIBLE = 1e-6  # share of the largest eigenvalue on random motion from which a direction counts
UNKNOWN = 0.25  # share of the directions left above which a run did not excite
SAMPLES = 200  # of random motion
FEW = 500  # rows of a run at which it is asked what they leave undetermined, evenly spread
MOST = 2000  # rows whose features are looked at, evenly spread


def effective_rank(matrix: Array) -> float:
    """Effective rank after Roy and Vetterli (2007): the exponential of the entropy of the singular values.

    From 1 for a matrix of rank one to n for n equal singular values; 0 for a zero matrix.
    """
    return rank_of(np.linalg.svd(matrix, compute_uv=False))


def rank_of(singular: NDArray[np.floating[Any]]) -> float:
    """Effective rank of a matrix with these singular values, largest first."""
    if not singular.size or singular[0] == 0:
        return 0.0
    share = singular / singular.sum()
    share = share[share > 0]
    return float(np.exp(-(share * np.log(share)).sum()))


@dataclass(frozen=True, eq=False)
class Excitation:
    """How well the activations of one network were excited."""

    # smallest eigenvalue of the Gram matrix `mean sigma sigma'`: weights along its direction leave no trace in the
    # output, however long one learns
    smallest: float
    largest: float  # its largest eigenvalue
    directions: int  # eigenvalues above a share of the largest: directions in which weights can be told apart
    units: int  # number of units
    rank: float  # effective rank of the activations (N, h)
    singular: Array  # their singular values, largest first
    visible: float  # share of the largest eigenvalue above which a direction counts


def excitation(activations: Array, visible: float = 1e-6) -> Excitation:
    """Excitation of activations (N, h) over the visited set."""
    singular = np.linalg.svd(activations, compute_uv=False)
    values = np.pad(singular, (0, activations.shape[1] - len(singular))) ** 2 / len(activations)
    return Excitation(
        smallest=float(values[-1]),
        largest=float(values[0]),
        directions=int((values > visible * values[0]).sum()),
        units=len(values),
        rank=rank_of(singular),
        singular=np.asarray(singular, float),
        visible=visible,
    )


def signals_for(controller: Any) -> tuple[str, ...]:
    """Signals of a run that `unknown` needs; empty for a controller of which it says nothing."""
    return getattr(controller, "excited_by", ())


@dataclass(frozen=True)
class Unknown:
    """The part of one network's weights, or of all, that a run leaves undetermined."""

    share: float  # of the directions that random motion shows
    directions: int  # how many there are
    acting: int = 0  # as how many units a network's units act on random motion: directions of their activations there
    units: int = 0  # how many it has; 0 for a learner that has none

    @property
    def excited(self) -> bool:
        """Whether the run, or any motion, could determine it."""
        return self.share <= UNKNOWN and 2 * self.acting >= self.units


def unknown(learner: Learner, rows: Array) -> dict[str, Unknown]:
    """Network (`base`, `arm`, or `all`) to the part of its weights that rows (N, width) leave undetermined.

    Empty for learners that judge it themselves from what they keep (`findings`), for one that is not linear in its
    weights or does not give its features, and for one that did not learn.
    """
    if not len(rows) or not signals_for(learner.controller) or not learner.controller.learning:
        return {}
    some, motion = rows[:: -(-len(rows) // FEW)], random_motion(learner.robot, learner.context.layout)
    if (own := learner.controller.networks) is None:
        visited, anywhere = along(learner, some), along(learner, motion)
        return {} if visited is None or anywhere is None else {"all": Unknown(*left(visited[0], anywhere[0]))}
    run, random, result = tangents(learner, own, some), tangents(learner, own, motion), {}
    for i, (J, activations) in random.items():
        acting = excitation(activations, VISIBLE)
        result[NAMES[i]] = Unknown(*left(run[i][0], J), acting.directions, acting.units)
    return result


def left(run: Array, random: Array) -> tuple[float, int]:
    """`unknown` for J (n, outputs, weights) along a run and on random motion, and the number of directions."""
    centred = random - random.mean(axis=0)
    size = np.sqrt((centred**2).sum(axis=2).mean(axis=0))
    counts = size > 0
    if not counts.any():
        return 0.0, 0
    table, shown = ((J[:, counts] / size[counts, None]).reshape(-1, J.shape[2]) for J in (run, centred))
    values, vectors = np.linalg.eigh(shown.T @ shown / len(random))
    seen = values > VISIBLE * values[-1]
    table = table @ (vectors[:, seen] / np.sqrt(values[seen]))
    excited = np.linalg.eigvalsh(table.T @ table / len(run))
    return float(np.mean(1.0 / (1.0 + np.maximum(excited, 0.0) / NOISE))), int(seen.sum())


def tangents(learner: Learner, own: Neural, rows: Array) -> dict[int, tuple[Array, Array]]:
    """Network to the derivative of its output by its final weights along rows (n, width), and hidden outputs (n, h).

    The first is J (n, outputs, weights): each weight over the root of its rate.
    """
    stepper = LearnerStepper(learner, learner.end.snapshot(), learning=False)
    state = stepper.state
    found: dict[int, list[tuple[Array, Array]]] = {i: [] for i, _ in channels(learner.context.layout)}
    for row in rows:
        stepper.step(row)
        for i, m in channels(learner.context.layout):
            W, sigma, rates = state[f"W{i}"], state[f"sigma{i}"].copy(), np.sqrt(own.network.rates(i - 1, False))
            J = [np.kron(np.eye(m), rates[0] * sigma)]
            if own.network.hidden_learns:
                hidden = (sigma * (1 - sigma))[:, None] * W  # (h, m)
                J.append(rates[1] * np.einsum("hm,x->mhx", hidden, state["x"]).reshape(m, -1))
            found[i].append((np.hstack(J), sigma))
    return {i: (np.array([J for J, _ in all_]), np.array([sigma for _, sigma in all_])) for i, all_ in found.items()}


def along(learner: Learner, rows: Array) -> tuple[Array, Array] | None:
    """Features (n, rows, k) of a linear learner, and what its final weights say (n, p) [N, N m], along rows (n, width).

    None where it does not give its features.
    """
    stepper, found = LearnerStepper(learner, learner.end.snapshot(), learning=False), list[tuple[Array, Array]]()
    for row in rows:
        psi_hat = stepper.step(row).copy()
        if (Phi := stepper.features()) is None:
            return None
        found.append((Phi, psi_hat))
    return np.array([Phi for Phi, _ in found]), np.array([psi_hat for _, psi_hat in found])


def random_motion(robot: Robot, layout: Layout, seed: int = 0) -> Array:
    """Rows (SAMPLES, width) of random motion without errors, of 1 in every unit (m, s, rad), the arm anywhere."""
    rng, nb = np.random.default_rng(seed), layout.base
    rows = np.zeros((SAMPLES, layout.width))
    lower, upper = robot.lower[robot.arm_index], robot.upper[robot.arm_index]
    limited = np.isfinite(upper - lower)
    q = rng.uniform(np.where(limited, lower, -np.pi), np.where(limited, upper, np.pi), (SAMPLES, layout.arm))
    pose, nu, nudot = (rng.standard_normal((SAMPLES, size)) for size in (layout.pose, layout.dof, layout.dof))
    shape, twist, change = steered_motion(robot, nu, nudot, rng)
    signals = {
        "pose": pose, "pose_ref": pose, "q": q, "q_ref": q, "shape": shape,
        "velocity": nu[:, :nb], "velocity_ref": twist, "alpha": nu[:, :nb], "qdot": nu[:, nb:],
        "qdot_ref": nu[:, nb:], "nu_ref": nu, "nu": nu, "acceleration_ref": change, "alphadot": nudot[:, :nb],
        "qddot_ref": nudot[:, nb:], "nudot_ref": nudot,
    }  # fmt: skip
    for name, values in signals.items():
        rows[:, layout.where(name)] = values
    return rows


def steered_motion(robot: Robot, nu: Array, nudot: Array, rng: np.random.Generator) -> tuple[Array, Array, Array]:
    """Random angles of a base's pivots (n, shape), its twists and their rates (n, twist) where it moves with nu (n, p).

    The base velocities themselves where nothing steers.
    """
    nb, base = robot.dimensions.base, robot.base
    if not isinstance(base, SteeredBase):
        return np.zeros((len(nu), 0)), nu[:, :nb], nudot[:, :nb]
    shape, twist, change = np.zeros((len(nu), robot.dimensions.shape)), *np.zeros((2, len(nu), robot.dimensions.twist))
    for i in range(len(nu)):
        position = robot.neutral_position()
        position[robot.shape_index] = base.random_angles(rng)
        shape[i] = robot.follow(position)[robot.shape_index]
        maps = robot.maps_at(position, nu[i])
        V, Vdot = maps.V[0][base.columns], maps.Vdot[0][base.columns]
        twist[i], change[i] = V @ nu[i, :nb], V @ nudot[i, :nb] + Vdot @ nu[i, :nb]
    return shape, twist, change


@dataclass(frozen=True, eq=False)
class Network:
    """The weights of one network or regressor at the end, and what they were multiplied with along the run."""

    name: str  # `base`, `arm`, or `all` for one that serves all velocities
    what: str  # what the weights are multiplied with, in a word
    ranks: dict[str, float]  # effective rank of W, V and what else there is of weights that are matrices
    numerical: dict[str, int]  # numerical rank of the same
    singular: dict[str, Array]  # singular values of the same
    excitation: Excitation  # of what they are multiplied with
    # what the run leaves undetermined on random motion; None for a learner that judges it itself
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

    def to_dict(self) -> dict[str, Any]:
        """Ranks and excitation for JSON."""
        return {
            "effective_rank": {**self.ranks, self.what: self.excitation.rank},
            "numerical_rank": self.numerical,
            "units": self.excitation.units,
            "gram_smallest": finite(self.excitation.smallest),
            "gram_largest": finite(self.excitation.largest),
            "excited_directions": self.excitation.directions,
            "undetermined": None if self.unknown is None else finite(self.unknown.share),
            "acting_units": self.unknown.acting if self.unknown is not None and self.unknown.units else None,
        }


def features_of(learner: Learner, rows: Array) -> list[Network]:
    """Excitation of a learner's weights by their features along rows (N, width); empty where it does not tell them."""
    lacks, weights = unknown(learner, rows), learner.controller.weights(learner.end)
    if isinstance(learner, NetworkLearner):
        activations, found = seen(learner, learner.end, rows).activations, []
        for i, name in ((i, NAMES[i]) for i, _ in learner.networks):
            own = {key[0]: W for key, W in weights.items() if key.endswith(str(i))}
            found.append(Network.of(name, "activations", own, excitation(activations[i]), lacks.get(name)))
        return found
    if (linear := along(learner, rows[:: -(-len(rows) // MOST)])) is None:
        return []
    _, outputs, k = linear[0].shape
    table = linear[0].reshape(-1, k) * np.sqrt(outputs)  # the mean is over samples, not over the rows of each
    regressor = learner.context.regressor or getattr(learner.controller, "regressor", None)
    if not isinstance(regressor, Regressor) or regressor.size != k or outputs == 1:
        return [Network.of("all", "features", weights, excitation(table), lacks.get("all"))]
    return [Network.of("all", "regressor", weights, excitation(table @ regressor.unit(), EXCITED), lacks.get("all"))]

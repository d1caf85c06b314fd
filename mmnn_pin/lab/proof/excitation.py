"""Was the learner excited? Ranks of its weights and activations, and what the run leaves undetermined of them.

Excitation is that of the activations over the run: where the Gram matrix `mean sigma sigma'` has a small eigenvalue,
weights leave no trace in the output. What a run leaves *undetermined* is measured on random motion instead. To first
order a change dw of the weights moves the output by `J dw`: for a network `J = [sigma, sigma' W x]`, W's part and V's;
for a learner that is linear in its weights its features. Weights are measured by their rates, as the thesis's V
measures them (`tr(Wt' F^-1 Wt)`), so one that is not learned has no part, and outputs by their deviation on random
motion. There, the mean taken out, J shows some directions of the weights (`VISIBLE`), in which it is scaled to one:
`E_random[Jc' Jc] = 1`. What a run leaves of a variance of 1 in each of them is

    P = (1 + E_run[J' J] / NOISE)^-1,      undetermined = trace P / directions,

0 for a run that determines all of them and 1 for one that determines none. E_run is a mean over the run: a longer one
of the same motion says no more. It is about what could be known of the motion, not about what was learned.

A network whose units act as few on random motion (`acting`) is another case: no motion determines its weights.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from ...model.robot import Robot
from ...signals import Array, Layout
from ...torque.controller import ControllerState
from ...torque.learning_law import LearningLaw
from ...torque.neural import MEASURED, Neural, channels
from ...torque.one_layer import OneLayer
from ...torque.two_layer import TwoLayer
from ...torque.two_layer_residual import TwoLayerResidual
from .learner import NAMES, Learner, Stepper

NOISE = 1e-3  # of what random motion does: less does not count as excited, as in `torque.adaptive`
VISIBLE = 1e-6  # share of the largest eigenvalue on random motion from which a direction counts
UNKNOWN = 0.25  # share of the directions left above which a run did not excite
SAMPLES = 200  # of random motion
MOST = 500  # rows of a run that are looked at, evenly spread
SEEN = (*MEASURED, "world_error")  # all that a law in plain Python may look at


def effective_rank(matrix: Array) -> float:
    """Effective rank after Roy and Vetterli (2007): the exponential of the entropy of the singular values.

    From 1 for a matrix of rank one to n for n equal singular values; 0 for a zero matrix.
    """
    singular = np.linalg.svd(matrix, compute_uv=False)
    if not singular.size or singular[0] == 0:
        return 0.0
    share = singular / singular.sum()
    share = share[share > 0]
    return float(np.exp(-(share * np.log(share)).sum()))


@dataclass(frozen=True, eq=False)
class Excitation:
    """How well the activations of one network were excited.

    Attributes:
        smallest: Smallest eigenvalue of the Gram matrix `mean sigma sigma'`: weights along its direction leave no trace
            in the output, however long one learns.
        largest: Its largest eigenvalue.
        directions: Eigenvalues above a share of the largest: directions in which weights can be told apart.
        units: Number of units.
        rank: Effective rank of the activations (N, h).
        singular: Their singular values, largest first.
        visible: Share of the largest eigenvalue above which a direction counts.
    """

    smallest: float
    largest: float
    directions: int
    units: int
    rank: float
    singular: Array
    visible: float


def excitation(activations: Array, visible: float = 1e-6) -> Excitation:
    """Excitation of activations (N, h) over the visited set."""
    singular = np.linalg.svd(activations, compute_uv=False)
    values = np.pad(singular, (0, activations.shape[1] - len(singular))) ** 2 / len(activations)
    return Excitation(
        smallest=float(values[-1]),
        largest=float(values[0]),
        directions=int((values > visible * values[0]).sum()),
        units=len(values),
        rank=effective_rank(activations),
        singular=np.asarray(singular, float),
        visible=visible,
    )


def signals_for(controller: Any) -> tuple[str, ...]:
    """Signals of a run that `unknown` needs; empty for a controller of which it says nothing."""
    own = network_in(controller)
    if own is not None:
        return own.inputs.signals
    tells = isinstance(controller, LearningLaw) and type(controller).features is not LearningLaw.features
    return SEEN if tells else ()


def hidden_learns(network: TwoLayer | OneLayer) -> bool:
    """Whether the hidden weights of a network learn, too."""
    return isinstance(network, TwoLayer)


def network_in(controller: Any) -> Neural | None:
    """The thesis's controller, where one is it or has one inside and does not judge its excitation itself."""
    if isinstance(controller, TwoLayerResidual):
        return controller.learner
    return controller if isinstance(controller, Neural) else None


@dataclass(frozen=True)
class Unknown:
    """What a run leaves undetermined of one network, or of all.

    Attributes:
        share: Of the directions that random motion shows.
        directions: How many there are.
        acting: As how many units a network's units act on random motion: directions of their activations there.
        units: How many it has; 0 for a learner that has none.
    """

    share: float
    directions: int
    acting: int = 0
    units: int = 0

    @property
    def excited(self) -> bool:
        """Whether the run, or any motion, could determine it."""
        return self.share <= UNKNOWN and 2 * self.acting >= self.units


def unknown(learner: Learner, rows: Array) -> dict[str, Unknown]:
    """What rows (N, width) leave undetermined, by network: `base`, `arm`, or `all`.

    Empty for learners that judge it themselves from what they keep (`findings`), for one that is not linear in its
    weights or does not give its features, and for one that did not learn.
    """
    if not len(rows) or not signals_for(learner.controller) or not learner.controller.learning:
        return {}
    own, some = network_in(learner.controller), rows[:: -(-len(rows) // MOST)]
    motion = random_motion(learner.robot, learner.context.layout)
    if own is None:
        visited, anywhere = features(learner, some), features(learner, motion)
        return {} if visited is None or anywhere is None else {"all": Unknown(*left(visited, anywhere))}
    run, random = (tangents(learner, own, table) for table in (some, motion))
    result = {}
    for i, _ in channels(learner.context.layout):
        acting = excitation(random[i].activations, VISIBLE)
        result[NAMES[i]] = Unknown(*left(run[i].J, random[i].J), acting.directions, acting.units)
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


@dataclass(frozen=True, eq=False)
class Tangents:
    """What a network's output does with its weights along n rows.

    Attributes:
        J: (n, outputs, weights) each weight over the root of its rate.
        activations: (n, h) hidden outputs.
    """

    J: Array
    activations: Array


def tangents(learner: Learner, own: Neural, rows: Array) -> dict[int, Tangents]:
    """Those of every network with the final weights at rows (n, width)."""
    state: ControllerState = learner.end.snapshot()
    stepper, parts = Stepper(learner, state, learning=False), channels(learner.context.layout)
    result: dict[int, list[Array]] = {i: [] for i, _ in parts}
    activations = {i: np.zeros((len(rows), state[f"sigma{i}"].size)) for i, _ in parts}
    rates = {i: np.sqrt(own.network.rates(i - 1, False)) for i, _ in parts}
    x = state["x"]
    for n, row in enumerate(rows):
        stepper.step(row)
        for i, m in parts:
            W, sigma = state[f"W{i}"], state[f"sigma{i}"]
            activations[i][n] = sigma
            J = [np.kron(np.eye(m), rates[i][0] * sigma)]
            if hidden_learns(own.network):
                hidden = (sigma * (1 - sigma))[:, None] * W  # (h, m)
                J.append(rates[i][1] * np.einsum("hm,x->mhx", hidden, x).reshape(m, -1))
            result[i].append(np.hstack(J))
    return {i: Tangents(np.array(J), activations[i]) for i, J in result.items()}


def features(learner: Learner, rows: Array) -> Array | None:
    """J of a learner that is linear in its weights, (n, rows, k); None where it gives no features."""
    stepper, result = Stepper(learner, learner.end.snapshot(), learning=False), list[Array]()
    for row in rows:
        stepper.step(row)
        Phi = stepper.features()
        if Phi is None:
            return None
        result.append(Phi)
    return np.array(result)


def random_motion(robot: Robot, layout: Layout, seed: int = 0) -> Array:
    """Rows (SAMPLES, width) of random motion without errors, of 1 in every unit (m, s, rad), the arm anywhere."""
    rng, nb = np.random.default_rng(seed), layout.base
    rows = np.zeros((SAMPLES, layout.width))
    lower, upper = robot.lower[robot.arm_index], robot.upper[robot.arm_index]
    limited = np.isfinite(upper - lower)
    q = rng.uniform(np.where(limited, lower, -np.pi), np.where(limited, upper, np.pi), (SAMPLES, layout.arm))
    pose, nu, nudot = (rng.standard_normal((SAMPLES, size)) for size in (layout.pose, layout.dof, layout.dof))
    signals = {
        "pose": pose, "pose_ref": pose, "q": q, "q_ref": q,
        "velocity": nu[:, :nb], "velocity_ref": nu[:, :nb], "alpha": nu[:, :nb], "qdot": nu[:, nb:],
        "qdot_ref": nu[:, nb:], "nu_ref": nu, "nu": nu, "acceleration_ref": nudot[:, :nb], "alphadot": nudot[:, :nb],
        "qddot_ref": nudot[:, nb:], "nudot_ref": nudot,
    }  # fmt: skip
    for name, values in signals.items():
        rows[:, layout.where(name)] = values
    return rows


def not_excited(name: str, result: dict[str, Unknown]) -> list[str]:
    """A finding on the worst network of a learner that its run did not excite; none where it did."""
    weak = [one for one in result.items() if not one[1].excited]
    if not weak:
        return []
    part, worst = max(weak, key=lambda one: (2 * one[1].acting < one[1].units, one[1].share))
    whose = "" if part == "all" else f" of its {part}'s network"
    if 2 * worst.acting < worst.units:
        return [
            f"{name}: not excited: the {worst.units} units{whose} act as {worst.acting} on random motion, so no motion "
            "determines its weights"
        ]
    return [
        f"{name}: not excited: the run leaves {worst.share:.0%} of what random motion shows{whose} undetermined; what "
        "it learned tracks the motions of this run and is no knowledge of others"
    ]

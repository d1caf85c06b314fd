"""The compiled step of what learns beside the networks: one slot for all of it, of which a run compiles what it has."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

from ..compiled import compiled
from ..model.tree.regressor import Massless, measured, regress
from ..signals import INDEX, Array, IntArray
from .adaptation import Adaptation, adapt
from .filtered import low_pass, period, remember
from .linear import Linear, keep_torque, learn
from .prediction import Prediction, gather
from .recall import History, keep, recall
from .replay import Replay, keep_held, replay

if TYPE_CHECKING:
    from .controller import Law

POSE, VELOCITY, Q, QDOT = (INDEX[name] for name in ("pose", "velocity", "q", "qdot"))
NU_REF, NUDOT_REF = INDEX["nu_ref"], INDEX["nudot_ref"]


class Learners(NamedTuple):
    """The numbers of a law that learns; all but one are None, and nothing is compiled for those.

    Attributes:
        adaptation: Of an adaptive controller.
        linear: Of a linear learner.
        history: Of a concurrent learner.
        replay: Of a network's prediction error.
    """

    adaptation: Adaptation | None
    linear: Linear | None
    history: History | None
    replay: Replay | None


def learners_of(law: Law) -> Learners | None:
    """All of a law that learns in one; None where nothing does."""
    own = (law.adaptation, law.linear, law.history, law.replay)
    return None if all(one is None for one in own) else Learners(*own)


@compiled
def estimate(row: Array, at: IntArray, learners: Learners, memory: Array) -> None:
    """Psi_hat at the measured state and the update of what it comes from."""
    by_adaptation(row, at, learners.adaptation, memory)
    by_linear(row, at, learners.linear, memory)
    by_history(row, at, learners.history, memory)
    by_replay(row, at, learners.replay, memory)


@compiled
def settle(row: Array, at: IntArray, learners: Learners, memory: Array) -> None:
    """The torque in the row is the one that is held from here on: keep it, to look back at it."""
    kept_by_adaptation(row, at, learners.adaptation, memory)
    kept_by_linear(row, at, learners.linear, memory)
    kept_by_history(row, at, learners.history, memory)
    kept_by_replay(row, at, learners.replay, memory)


@compiled
def by_adaptation(row: Array, at: IntArray, adaptation: Adaptation | None, memory: Array) -> None:
    """`estimate` of an adaptive controller."""
    if adaptation is not None:
        known = adaptation.known
        look_back(row, at, known, adaptation.prediction, memory)
        velocity, q = row[at[VELOCITY] : at[Q]], row[at[Q] : at[QDOT]]
        measured(known, row[at[POSE] : at[POSE + 1]], velocity, q, row[at[QDOT] : at[QDOT + 1]])
        regress(known, row[at[NU_REF] : at[NU_REF + 1]], row[at[NUDOT_REF] : at[NUDOT_REF + 1]])
        adapt(row, at, adaptation, memory)


@compiled
def look_back(row: Array, at: IntArray, known: Massless, prediction: Prediction | None, memory: Array) -> None:
    """What the control period before this sample says of the dynamics, into the memory."""
    if prediction is not None:
        f, nb = prediction.filter, known.base
        seen = memory[prediction.first :]
        if period(row, at, f, seen):
            measured(known, f.pose, f.nu[:nb], f.q, f.nu[nb:])
            regress(known, f.nu, f.nudot)
            low_pass(f, known.Y, seen)
            if int(memory[prediction.gradient.size]) % prediction.every == 0:
                gather(prediction, memory)


@compiled
def by_linear(row: Array, at: IntArray, linear: Linear | None, memory: Array) -> None:
    """`estimate` of a linear learner."""
    if linear is not None:
        learn(row, at, linear, linear.known, linear.random, memory)


@compiled
def by_history(row: Array, at: IntArray, history: History | None, memory: Array) -> None:
    """`estimate` of a concurrent learner."""
    if history is not None:
        recall(row, at, history, memory)


@compiled
def kept_by_adaptation(row: Array, at: IntArray, adaptation: Adaptation | None, memory: Array) -> None:
    """`settle` of an adaptive controller."""
    if adaptation is not None:
        kept_by_prediction(row, at, adaptation.prediction, memory)


@compiled
def kept_by_prediction(row: Array, at: IntArray, prediction: Prediction | None, memory: Array) -> None:
    """Likewise of its prediction error."""
    if prediction is not None:
        remember(row, at, memory[prediction.first :])


@compiled
def kept_by_linear(row: Array, at: IntArray, linear: Linear | None, memory: Array) -> None:
    """`settle` of a linear learner."""
    if linear is not None:
        keep_torque(row, at, linear, memory)


@compiled
def kept_by_history(row: Array, at: IntArray, history: History | None, memory: Array) -> None:
    """`settle` of a concurrent learner."""
    if history is not None:
        keep(row, at, history, memory)


@compiled
def by_replay(row: Array, at: IntArray, numbers: Replay | None, memory: Array) -> None:
    """A network's prediction error; its output is the network's own step."""
    if numbers is not None:
        replay(row, at, numbers, memory)


@compiled
def kept_by_replay(row: Array, at: IntArray, numbers: Replay | None, memory: Array) -> None:
    """`settle` of a network's prediction error."""
    if numbers is not None:
        keep_held(row, at, numbers, memory)

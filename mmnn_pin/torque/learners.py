"""The compiled step of what learns beside the networks: one slot for all of it, of which a run compiles what it has."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

from ..compiled import compiled
from ..model.regressor import Massless, measured, regress
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
def estimate(row: Array, at: IntArray, learners: Learners, state: Array) -> None:
    """Psi_hat at the measured state and the update of what it comes from."""
    by_adaptation(row, at, learners.adaptation, state)
    by_linear(row, at, learners.linear, state)
    by_history(row, at, learners.history, state)
    by_replay(row, at, learners.replay, state)


@compiled
def settle(row: Array, at: IntArray, learners: Learners, state: Array) -> None:
    """The torque in the row is the one that is held from here on: keep it, to look back at it."""
    kept_by_adaptation(row, at, learners.adaptation, state)
    kept_by_linear(row, at, learners.linear, state)
    kept_by_history(row, at, learners.history, state)
    kept_by_replay(row, at, learners.replay, state)


@compiled
def by_adaptation(row: Array, at: IntArray, adaptation: Adaptation | None, state: Array) -> None:
    """`estimate` of an adaptive controller."""
    if adaptation is not None:
        known = adaptation.known
        look_back(row, at, known, adaptation.prediction, state)
        velocity, q = row[at[VELOCITY] : at[Q]], row[at[Q] : at[QDOT]]
        measured(known, row[at[POSE] : at[POSE + 1]], velocity, q, row[at[QDOT] : at[QDOT + 1]])
        regress(known, row[at[NU_REF] : at[NU_REF + 1]], row[at[NUDOT_REF] : at[NUDOT_REF + 1]])
        adapt(row, at, adaptation, state)


@compiled
def look_back(row: Array, at: IntArray, known: Massless, prediction: Prediction | None, state: Array) -> None:
    """What the control period before this sample says of the dynamics, into the memory."""
    if prediction is not None:
        f, nb = prediction.filter, known.base
        seen = state[prediction.first :]
        if period(row, at, f, seen):
            measured(known, f.pose, f.nu[:nb], f.q, f.nu[nb:])
            regress(known, f.nu, f.nudot)
            low_pass(f, known.Y, seen)
            if int(state[prediction.gradient.size]) % prediction.every == 0:
                gather(prediction, state)


@compiled
def by_linear(row: Array, at: IntArray, linear: Linear | None, state: Array) -> None:
    """`estimate` of a linear learner."""
    if linear is not None:
        learn(row, at, linear, linear.known, linear.random, state)


@compiled
def by_history(row: Array, at: IntArray, history: History | None, state: Array) -> None:
    """`estimate` of a concurrent learner."""
    if history is not None:
        recall(row, at, history, state)


@compiled
def kept_by_adaptation(row: Array, at: IntArray, adaptation: Adaptation | None, state: Array) -> None:
    """`settle` of an adaptive controller."""
    if adaptation is not None:
        kept_by_prediction(row, at, adaptation.prediction, state)


@compiled
def kept_by_prediction(row: Array, at: IntArray, prediction: Prediction | None, state: Array) -> None:
    """Likewise of its prediction error."""
    if prediction is not None:
        remember(row, at, state[prediction.first :])


@compiled
def kept_by_linear(row: Array, at: IntArray, linear: Linear | None, state: Array) -> None:
    """`settle` of a linear learner."""
    if linear is not None:
        keep_torque(row, at, linear, state)


@compiled
def kept_by_history(row: Array, at: IntArray, history: History | None, state: Array) -> None:
    """`settle` of a concurrent learner."""
    if history is not None:
        keep(row, at, history, state)


@compiled
def by_replay(row: Array, at: IntArray, numbers: Replay | None, state: Array) -> None:
    """A network's prediction error; its output is the network's own step."""
    if numbers is not None:
        replay(row, at, numbers, state)


@compiled
def kept_by_replay(row: Array, at: IntArray, numbers: Replay | None, state: Array) -> None:
    """`settle` of a network's prediction error."""
    if numbers is not None:
        keep_held(row, at, numbers, state)

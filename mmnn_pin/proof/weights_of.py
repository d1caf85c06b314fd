"""Which weights' part of the Lyapunov function a run's learner has."""

from __future__ import annotations

import math
from functools import partial
from typing import NamedTuple

from ..torque.adaptive import Adaptive
from ..torque.composite import CompositeNetwork
from ..torque.concurrent import ConcurrentLearner
from ..torque.kalman import KalmanLearner
from ..torque.learning_law import LearningLaw
from .covariance_part import covariance_part
from .estimate_part import estimate_part
from .ideal import Ideal
from .linear_fit import LinearFit
from .lyapunov import MOST, Part
from .network_part import network_part
from .networks import Networks
from .own_part import own_part
from .stack_part import stack_part
from .subject import Subject
from .truth import Truth

BY_WEIGHTS = {KalmanLearner: covariance_part, LearningLaw: own_part}


class Kept(NamedTuple):
    """The weights' part of a learner.

    Attributes:
        part: What gives it at rows.
        most: Samples to look at: all where the weights do not move at every sample.
    """

    part: Part
    most: float


def weights_of(subject: Subject, ideal: dict[int, Ideal] | Truth | LinearFit) -> Kept | None:
    """The weights' part of a run's learner with its ideal weights; None where nothing was learned."""
    learner = subject.learner
    if learner is None or not learner.controller.learning:
        return None
    controller = learner.controller
    if isinstance(learner, Networks) and isinstance(ideal, dict):
        lumps = isinstance(controller, CompositeNetwork)
        whole = partial(network_part, learner, ideal, subject.rows)
        return Kept(whole, math.inf if lumps else MOST)
    if isinstance(controller, Adaptive) and isinstance(ideal, Truth):
        lumps = controller.predicting is not None
        return Kept(partial(estimate_part, subject, learner, ideal), math.inf if lumps else MOST)
    if not isinstance(ideal, LinearFit):
        return None
    if isinstance(controller, ConcurrentLearner):
        return Kept(partial(stack_part, subject, learner, ideal.W[:, 0]), math.inf)
    for kind, part in BY_WEIGHTS.items():
        if isinstance(controller, kind):
            return Kept(partial(part, subject, learner, ideal.W), math.inf)
    return None

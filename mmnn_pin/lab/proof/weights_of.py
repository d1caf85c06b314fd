"""Which weights' part of the Lyapunov function a run's learner has."""

from __future__ import annotations

import math
from functools import partial
from typing import NamedTuple

from ...torque.adaptive import Adaptive
from ...torque.concurrent import ConcurrentLearner
from ...torque.kalman import KalmanLearner
from ...torque.learning_law import LearningLaw
from .covariance_part import covariance_part
from .estimate_part import estimate_part
from .ideal import Ideal, LinearFit
from .lyapunov import MOST, Part
from .network_part import network_part
from .networks import Networks
from .own_part import own_part
from .stack_part import stack_part
from .subject import Subject
from .truth import Truth, adaptation_of


class Kept(NamedTuple):
    """The weights' part of a learner.

    Attributes:
        part: What gives it at rows.
        most: Samples to look at.
        every: Control periods from one update of the weights to the next.
    """

    part: Part
    most: float = math.inf
    every: int = 1


def weights_of(subject: Subject, ideal: dict[int, Ideal] | Truth | LinearFit) -> Kept | None:
    """The weights' part of a run's learner with its ideal weights; None where nothing was learned."""
    learner = subject.learner
    if learner is None or not learner.controller.learning:
        return None
    controller = learner.controller
    if isinstance(learner, Networks) and isinstance(ideal, dict):
        return Kept(partial(network_part, learner, ideal, subject.rows), MOST)
    if isinstance(controller, Adaptive) and isinstance(ideal, Truth):
        prediction = adaptation_of(learner).prediction
        return Kept(partial(estimate_part, subject, learner, ideal), MOST, prediction.every if prediction else 1)
    if not isinstance(ideal, LinearFit):
        return None
    if isinstance(controller, LearningLaw):
        return Kept(partial(own_part, subject, learner, ideal.W))
    numbers = controller.law(learner.context)
    if isinstance(controller, ConcurrentLearner):
        return Kept(partial(stack_part, subject, learner, ideal.W[:, 0]), every=numbers.history.every)
    if isinstance(controller, KalmanLearner):
        return Kept(partial(covariance_part, subject, learner, ideal.W), every=numbers.linear.every)
    return None

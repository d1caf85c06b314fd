"""The weights' part of V of every learner beyond the thesis: its value in a second way, its terms from their formulas.

What moves the weights is measured here by other means than in the package: P and L by dense matrices and textbook
updates, the prediction step by its own differential equation, a network's by the weights that the run recorded.
"""

from __future__ import annotations

from dataclasses import replace
from functools import cache, partial

import numpy as np
import pytest
import sympy as sp
from hypothesis import given, settings
from hypothesis import strategies as st
from learning import made
from proofs import SLOW, loop_of, robot_of_kind
from robots import feedback

from mmnn_pin import LearningLaw, Memory, Regressor
from mmnn_pin.errors import RecordingError
from mmnn_pin.model.parameters import parameters
from mmnn_pin.proof.estimate_part import metric, prediction_step
from mmnn_pin.proof.learner import Stepper
from mmnn_pin.proof.linear_fit import linear_fit
from mmnn_pin.proof.lyapunov import TERMS
from mmnn_pin.proof.networks import Networks
from mmnn_pin.proof.proof import Proof
from mmnn_pin.proof.subject import Subject
from mmnn_pin.proof.truth import adaptation_of, distances, true_parameters, true_weights
from mmnn_pin.proof.weights_of import weights_of

slow = pytest.mark.skipif(SLOW, reason="too long for uncompiled code")
COVARIANCE = ("kalman_regressor", "kalman_bilinear", "kalman_features", "kalman_residual")
LEARNERS = (*COVARIANCE, "concurrent", "adaptive_composite", "two_layer_composite", "two_layer_residual")
SMALL = {
    "kalman_bilinear": ("kalman.bilinear.hidden=5",),
    "kalman_features": ("kalman.features.hidden=20",),
    "kalman_residual": ("kalman.residual.hidden=5",),
    "two_layer_composite": ("replay.entries=20",),
}


@cache
def proof_of(name: str, *more: str) -> Proof:
    loop = made(name, *SMALL.get(name, ()), *more, duration=0.4)
    return Proof(loop.run(meta=META[name] if name in META else None))


META: dict[str, dict] = {}


def test_all_learners_have_a_part() -> None:
    assert len(LEARNERS) == 8

"""What a law tells for its proof, beyond what every controller has: methods that it may have, and its part of V.

A law imports nothing of this: a method of that name is enough.
"""

from __future__ import annotations

from typing import Any, Protocol, runtime_checkable

from numpy.typing import ArrayLike

from mmnn_pin.signals import Array
from mmnn_pin.torque.adaptive import Adaptive
from mmnn_pin.torque.concurrent import Concurrent
from mmnn_pin.torque.controller import Context, ControllerState
from mmnn_pin.torque.kalman import Kalman
from mmnn_pin.torque.neural import Neural
from mmnn_pin.torque.two_layer_residual import TwoLayerResidual


@runtime_checkable
class TellsGain(Protocol):
    """A law that follows s by `W' = Gamma Phi' s + ...`, if it has features Phi."""

    def learning_gain(self, state: ControllerState, context: Context) -> ArrayLike | None:
        """Gamma: one number, (k,) for a diagonal or (k, k), positive definite; W' is per second. None for none."""


@runtime_checkable
class TellsPrior(Protocol):
    """A law with a prior of its weights."""

    def prior_deviation(self, state: ControllerState) -> Array | None:
        """Standard deviation of every weight (k, m) before anything was learned; None without a prior."""


@runtime_checkable
class TellsTruth(Protocol):
    """A law whose weights can say the true parameters of a robot."""

    def true_weights(self, theta: Array, start: ControllerState) -> Array | None:
        """The weights (k,) that say true parameters theta (k0,), from a state before a run; None if they say others."""


PARTS: dict[type, str] = {  # the weights' part of V of a law, a name of `proof.WEIGHTS_PARTS`; of others that of a gain
    Neural: "networks",
    TwoLayerResidual: "networks",
    Adaptive: "estimate",
    Concurrent: "stack",
    Kalman: "covariance",
}


def weights_part_of(controller: Any) -> str | None:
    """The kind of the weights' part of V of a law; None where it has none."""
    of_gain = "gain" if isinstance(controller, TellsGain) else None
    return next((PARTS[kind] for kind in type(controller).__mro__ if kind in PARTS), of_gain)

"""The controllers of experiments by name, and the switches of the learners."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Literal

from ...settings import Settings, require_numbers
from ...torque.neural_settings import Robust

# PD at a learner's effective gain: the learner whose gain it takes, see also `effective`.
EFFECTIVE = {"pd_effective": "two_layer", "pd_effective_one_layer": "one_layer"}
CONTROLLERS = {
    "two_layer": "the thesis's two-layer network, both layers learn (3.39), (3.48)-(3.50)",
    "two_layer_zero": "the same with all weights from zero, whatever two_layer.initial says",
    "two_layer_random": "the same with W = 0 and V random",
    "one_layer": "one-layer Gaussian network of reference [9], its law reconstructed",
    "pd": "the feedback alone",
    "pd_effective": "PD at the effective gain of two_layer (or two_layer_zero): its gain without its network",
    "pd_effective_one_layer": "PD at the effective gain of one_layer",
    "adaptive": "Slotine-Li adaptive control: knows the kinematics, learns masses, inertias and friction",
    "adaptive_composite": "the same with the prediction error of filtered torque: its estimate is knowledge",
    "concurrent": "knows the kinematics; a stack of chosen equations, so that knowledge outlasts the excitation",
    "two_layer_composite": "the two-layer network with the prediction error of filtered torque and a memory",
    "two_layer_residual": "a nominal model with wrong masses, and the two-layer network on the difference",
    "nominal": "feedback and that nominal model, nothing learned: what two_layer_residual has to beat",
    "kalman_regressor": "knows the kinematics; least squares with a covariance on filtered torque",
    "kalman_bilinear": "knows the form of the equations: random functions of the arm's joints, the same least squares",
    "kalman_features": "knows nothing: random functions of states and references, the same least squares",
    "kalman_residual": "a nominal model with wrong masses, and kalman_bilinear for what it does not say",
    "computed_torque": "feedback and the true model: the oracle",
}
ORACLES = ("computed_torque",)
# Two-layer networks: how their weights start, None for what `two_layer.initial` says.
TWO_LAYERS: dict[str, Literal["zero", "random"] | None] = {
    "two_layer": None,
    "two_layer_zero": "zero",
    "two_layer_random": "random",
}
LEARNERS = (*TWO_LAYERS, "one_layer")
KALMAN = {f"kalman_{table}": table for table in ("regressor", "bilinear", "features", "residual")}
# What an experiment runs unless it says.
DEFAULT = ("two_layer", "one_layer", "pd", *EFFECTIVE, "computed_torque")


def effective(controllers: Iterable[str]) -> dict[str, str]:
    """`EFFECTIVE` for controllers that run together: `pd_effective` goes with the first of `TWO_LAYERS` among them."""
    names = set(controllers)
    return EFFECTIVE | {"pd_effective": next((name for name in TWO_LAYERS if name in names), "two_layer")}


class RobustOf(Settings, frozen=True):
    """Robust terms of single learners in place of the common one; with them a comparison is no longer fair.

    Args:
        two_layer: Kz, ZB of the two-layer controller; None for the common ones.
        one_layer: Kz, ZB of the one-layer controller; None for the common ones.
    """

    two_layer: Robust | None = None
    one_layer: Robust | None = None


class Learning(Settings, frozen=True):
    """Conventions and switches of the learners.

    Args:
        rates: "per_sample" (Appendix B) or "per_second".
        update: "after_output", or "before_output" as in Appendix B.
        learning: Off keeps the initial weights.
        leakage: Off drops the e-modification.
        robust_term: Off drops the robust term (3.50).
        projection: Bound on |W|_F in units (what the feedback answers to 0.1 m/s or rad/s) and on |V|_F of every
            network: larger ones are scaled back onto it. Without it 100 for `two_layer_residual` and none for the
            thesis's networks; `two_layer_composite` has `replay.bound`.
        within_limits: Whether robust term and Psi_hat take of every motor's limit only what the feedback leaves, of all
            controllers; without it of the learners beyond the thesis, not of its networks.

    Raises:
        ConfigError: A projection that is not above 0 or not finite.
    """

    rates: Literal["per_sample", "per_second"] = "per_sample"
    update: Literal["after_output", "before_output"] = "after_output"
    learning: bool = True
    leakage: bool = True
    robust_term: bool = True
    projection: float | None = None
    within_limits: bool | None = None

    def __post_init__(self) -> None:
        require_numbers(self, "learning", ("projection",))

"""What networks see: measured and commanded signals, and what is computed from them."""

from __future__ import annotations

from typing import Literal

import numpy as np

from ..errors import ConfigError, UnknownName
from ..settings import Settings
from ..signals import Array, Layout

# Input of the networks in the order of (3.24) and of Appendix B.
THESIS_INPUT = ("pose_ref", "alpha", "alphadot", "pose_error", "z", "e", "r", "q_ref", "qdot_ref", "qddot_ref")
# What a network may see: the reference, the measurement and what is computed from them.
MEASURED = (
    *("pose_ref", "velocity_ref", "acceleration_ref", "q_ref", "qdot_ref", "qddot_ref"),
    *("pose", "velocity", "q", "qdot"),
    *("alpha", "alphadot", "pose_error", "z", "e", "edot", "r", "nu_ref", "nudot_ref"),
)


class Inputs(Settings, frozen=True):
    """What the networks see.

    Args:
        signals: Names of signals, each one measured or computed from measured ones; default (3.24).
        pose_error: Frame of the signal `pose_error`, which (3.24) does not state: "body" (3.1) or "world".
        scale: Factor on every input (180/pi puts joint angles in degrees).
        error_scale: Factor on the error s that teaches, undone at the output: with 180/pi for both the whole network
            works in degrees, and so do its leakage and the norm of its weights.
        bias: One more input that never changes, which (3.24) lacks: without it the hidden units see no constant; 0 for
            none.
        constant_yaw_rate: Appendix B's slip `wd = (5)`: this number in place of the second component of alpha.

    Raises:
        UnknownName: A signal that does not exist or that a controller may not know.
        ConfigError: A number is not finite, or an error_scale that is not positive.
    """

    signals: tuple[str, ...] = THESIS_INPUT
    pose_error: Literal["body", "world"] = "body"
    scale: float = 1.0
    error_scale: float = 1.0
    bias: float = 0.0
    constant_yaw_rate: float | None = None

    def __post_init__(self) -> None:
        for name in self.signals:
            if name not in MEASURED:
                raise UnknownName("network input", name, MEASURED, key="inputs.signals")
        for name in ("scale", "error_scale", "bias", "constant_yaw_rate"):
            value = getattr(self, name)
            if value is not None and not np.isfinite(value):
                raise ConfigError(f"{value} is not finite", fix="use a finite number", key=f"inputs.{name}")
        if self.error_scale <= 0:
            raise ConfigError(f"{self.error_scale}", fix="use a number > 0", key="inputs.error_scale")

    def rows(self, layout: Layout) -> np.ndarray:
        """Places of the inputs in a row, (nx,) int64."""
        frames = {"pose_error": "world_error"} if self.pose_error == "world" else {}
        places = [np.arange(layout.width)[layout.where(frames.get(name, name))] for name in self.signals]
        places += [np.zeros(1, np.int64)] if self.bias else []
        return np.concatenate(places).astype(np.int64)

    def affine(self, layout: Layout) -> tuple[Array, Array]:
        """Scale and offset of every input, (nx,) each."""
        rows = self.rows(layout)
        scale, offset = np.full(rows.size, self.scale), np.zeros(rows.size)
        if self.constant_yaw_rate is not None and layout.base == 2:
            wd = rows == layout.where("alpha").start + 1
            scale[wd], offset[wd] = 0.0, self.constant_yaw_rate
        if self.bias:
            scale[-1], offset[-1] = 0.0, self.bias
        return scale, offset

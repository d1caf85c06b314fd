"""How velocities are made of encoders, in the linearised loop: the filters and observers of `sensing.effects.Rates`."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ..sensing import Sensor
from ..signals import Array


class VelocityFilter(NamedTuple):
    """Velocities that are made of encoders by `sensing.effects.Rates`, as they are used once in a control period.

    The rate v and the tracked angle, off by w, follow the mean velocity m of a measurement's period,
    `(w, v)_next = A (w, v) + b m`; of a filter w is zero.
    """

    period: float  # between two measurements [s]
    alpha: float  # share of a new difference, 1 for plain ones; or the observer's correction of the angle
    beta: float = 0.0  # the observer's correction of the rate, 0 for a filter [1/s]

    def over(self, h: float) -> tuple[Array, Array]:
        """A (2, 2) and b (2,) of all measurements of a control period h [s]."""
        left, T = 1.0 - self.alpha, self.period
        if self.beta:
            A, b = np.array([[left, -left * T], [self.beta, 1.0 - self.beta * T]]), np.array([left * T, self.beta * T])
        else:
            A, b = np.array([[0.0, 0.0], [0.0, left]]), np.array([0.0, self.alpha])
        whole, total = np.eye(2), np.zeros(2)
        for _ in range(max(1, round(h / T))):
            whole, total = A @ whole, A @ total + b
        return whole, total

    @classmethod
    def of(cls, sensor: Sensor, period: float) -> VelocityFilter | None:
        """That of sensors which measure at a period [s]; None for exact velocities, and an observer on a model.

        That observer expects what torques do: a loop hardly notices it. `Sensor.smoothing` says what an integral does.
        """
        if sensor.velocity in ("true", "model"):
            return None
        alpha, beta, _ = sensor.derivative(period)
        return cls(period, alpha, beta)

    @classmethod
    def late(cls, filtered: float, period: float) -> VelocityFilter | None:
        """That of a filter of first order of which only the time constant is known [s]; None for none."""
        return cls(period, period / (filtered + period)) if filtered > 0.0 else None

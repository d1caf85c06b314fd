"""An observer of an extended state: velocity and disturbance together, both poles at one bandwidth.

    tau = K s + m nudot_ref + d_hat,      x' = (u - d_hat) / m + 2 w (nu - x),      d_hat' = -w^2 m (nu - x)

(Han 2009, IEEE Trans. Ind. Electron. 56(3), active disturbance rejection control; linear, with one bandwidth for all
its poles: Gao 2003, Proc. American Control Conference.) A velocity is a system of first order, so the observer has two
states. Of a sampled loop it is the current estimator (Miklosovic, Radke and Gao 2006, Proc. ACC): with `b = exp(-w h)`
a prediction by the model that is corrected by `1 - b^2` of its error and, for d_hat, by `-(1 - b)^2 m / h` of it, which
has both poles at b. From d to d_hat it is `w^2 / (p + w)^2`: it smooths velocities once more than `time_delay`, for a
phase that a loop with delay has to pay.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import ClassVar, NamedTuple

from ..by_address import by_address
from ..compiled import linked
from ..elementary import exp
from ..settings import Settings, require_numbers
from ..signals import Array, IntArray
from .law import KERNELS, Kernels
from .observer import DisturbanceObserver, Model, answer, follows, keep, seen_of, speed


class ExtendedStateSettings(Settings, frozen=True):
    """How fast an observer of an extended state is.

    Args:
        bandwidth: w, of both poles [1/s]; None for what its loop bears (`loop.rates`).

    Raises:
        ConfigError: A number that is negative or not finite.
    """

    bandwidth: float | None = None

    def __post_init__(self) -> None:
        require_numbers(self, "extended_state", ())


@by_address
class Extended(NamedTuple):
    """The numbers of the observer: its model, and the pole `b = exp(-w h)` of a period."""

    model: Model
    pole: float


@linked
def estimate(row: Array, at: IntArray, a: Extended, state: Array) -> None:
    """The estimate of one sample and Psi_hat; arguments as of `law.estimate`."""
    o, m, h = seen_of(state, a.model.layout), a.model.inertia, a.model.h
    if follows(row, at, a.model, o):
        for i in range(o.d.size):
            predicted = o.x[i] + h / m[i] * (o.torque[i] - o.d[i])
            error = speed(row, at, i) - predicted
            o.x[i] = predicted + (1.0 - a.pole * a.pole) * error
            o.d[i] -= (1.0 - a.pole) * (1.0 - a.pole) * m[i] / h * error
    answer(row, at, a.model, o)


@linked
def settle(row: Array, at: IntArray, a: Extended, state: Array) -> None:
    """Keep what was sent; arguments as of `law.settle`."""
    keep(row, at, a.model, state)


KERNELS[Extended] = Kernels(estimate, settle)


@dataclass(frozen=True, eq=False)
class ExtendedState(DisturbanceObserver):
    """An observer of an extended state; arguments as of `DisturbanceObserver`."""

    settings: ExtendedStateSettings = field(default_factory=ExtendedStateSettings)
    name: str = "extended_state"

    rate_factor: ClassVar[float] = 2.0  # of second order: at low frequencies that of first order with half of it

    def observer(self, model: Model) -> Extended:
        """Numbers of this observer; see `DisturbanceObserver`."""
        return Extended(model, exp(-self.rate * model.h))

"""Time-delay control: the disturbance is that of a moment ago, torque that was sent less inertia times acceleration.

    tau = K s + m nudot_ref + d_hat,      d_hat' = w (u - m nudot - d_hat)

(Youcef-Toumi and Ito 1990, J. Dyn. Sys. Meas. Control 112(1); Hsia and Gao 1990, IEEE ICRA.) Over the period that has
just ended u is the torque that was sent at its beginning and `nudot = (nu - nu_last) / h`. Without the low-pass w the
delay is one period, and velocities are differenced as they are: noise, and gains of a bandwidth near 1 / h. With it the
law is a PI controller with the gain `K + w m`, so w has to be as low as the delay of the loop asks (`loop.rates`).
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import NamedTuple

from ..by_address import by_address
from ..compiled import linked
from ..elementary import exp
from ..settings import Settings, require_numbers
from ..signals import Array, IntArray
from .law import KERNELS, Kernels
from .observer import DisturbanceObserver, Model, answer, follows, keep, seen_of, speed


class TimeDelaySettings(Settings, frozen=True):
    """How fast time-delay control follows a disturbance.

    Args:
        bandwidth: w [1/s]; None for what its loop bears (`loop.rates`).

    Raises:
        ConfigError: A number that is negative or not finite.
    """

    bandwidth: float | None = None

    def __post_init__(self) -> None:
        require_numbers(self, "time_delay", ())


@by_address
class Delayed(NamedTuple):
    """The numbers of time-delay control: its model, and what a period changes of the estimate, `1 - exp(-w h)`."""

    model: Model
    share: float


@linked
def estimate(row: Array, at: IntArray, a: Delayed, state: Array) -> None:
    """The estimate of one sample and Psi_hat; arguments as of `law.estimate`."""
    o, m = seen_of(state, a.model.layout), a.model.inertia
    if follows(row, at, a.model, o):
        for i in range(o.d.size):
            now = o.torque[i] - m[i] * (speed(row, at, i) - o.nu[i]) / a.model.h
            o.d[i] += a.share * (now - o.d[i])
    answer(row, at, a.model, o)


@linked
def settle(row: Array, at: IntArray, a: Delayed, state: Array) -> None:
    """Keep what was sent; arguments as of `law.settle`."""
    keep(row, at, a.model, state)


KERNELS[Delayed] = Kernels(estimate, settle)


@dataclass(frozen=True, eq=False)
class TimeDelay(DisturbanceObserver):
    """Time-delay control; arguments as of `DisturbanceObserver`."""

    settings: TimeDelaySettings = field(default_factory=TimeDelaySettings)
    name: str = "time_delay"

    def observer(self, model: Model) -> Delayed:
        """Numbers of this observer; see `DisturbanceObserver`."""
        return Delayed(model, 1.0 - exp(-self.rate * model.h))

"""L1 adaptive control: an estimate as fast as sampling allows, and a low-pass before it acts.

    tau = K s + m nudot_ref + d_hat,      d_hat' = w (-m sigma - d_hat),
    x' = u / m + sigma - a (x - nu),      sigma = -(exp(-a h) / Phi) (x - nu),      Phi = (1 - exp(-a h)) / a

(Hovakimyan and Cao 2010, L1 Adaptive Control Theory, SIAM, 3.3, the piecewise-constant law of adaptation; Xargay,
Hovakimyan and Cao 2010, Proc. ACC.) sigma is what the prediction x of a period lacks, adapted within one sample; only
the low-pass w decides what of it reaches the motors, so robustness does not depend on how fast it is adapted. Of a
disturbance that stays a part `1 - exp(-a h)` is left to the feedback, so the predictor's pole a is slow.
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


class L1AdaptiveSettings(Settings, frozen=True):
    """How fast L1 adaptive control is.

    Args:
        bandwidth: w of the low-pass [1/s]; None for what its loop bears (`loop.rates`).
        predictor: a, pole of the predictor [1/s].

    Raises:
        ConfigError: A number that is negative, not finite or 0 where it must not be.
    """

    bandwidth: float | None = None
    predictor: float = 1.0

    def __post_init__(self) -> None:
        require_numbers(self, "l1_adaptive", ("predictor",))


@by_address
class Adapted(NamedTuple):
    """The numbers of L1 adaptive control."""

    model: Model  # of every velocity
    share: float  # what a period changes of the estimate, `1 - exp(-w h)`
    stays: float  # exp(-a h)
    answers: float  # phi [s]


@linked
def estimate(row: Array, at: IntArray, a: Adapted, state: Array) -> None:
    """The estimate of one sample and Psi_hat; arguments as of `law.estimate`."""
    o, m = seen_of(state, a.model.layout), a.model.inertia
    if follows(row, at, a.model, o):
        for i in range(o.d.size):
            error = o.x[i] - o.nu[i]
            o.x[i] = o.nu[i] + a.stays * error + a.answers * (o.torque[i] / m[i] + o.sigma[i])
            o.sigma[i] = -a.stays / a.answers * (o.x[i] - speed(row, at, i))
            o.d[i] += a.share * (-m[i] * o.sigma[i] - o.d[i])
    answer(row, at, a.model, o)


@linked
def settle(row: Array, at: IntArray, a: Adapted, state: Array) -> None:
    """Keep what was sent; arguments as of `law.settle`."""
    keep(row, at, a.model, state)


KERNELS[Adapted] = Kernels(estimate, settle)


@dataclass(frozen=True, eq=False)
class L1Adaptive(DisturbanceObserver):
    """L1 adaptive control; arguments as of `DisturbanceObserver`."""

    settings: L1AdaptiveSettings = field(default_factory=L1AdaptiveSettings)
    name: str = "l1_adaptive"

    def observer(self, model: Model) -> Adapted:
        """Numbers of this observer; see `DisturbanceObserver`."""
        a, h = float(self.settings.predictor), model.h
        stays = exp(-a * h)
        return Adapted(model, 1.0 - exp(-self.rate * h), stays, (1.0 - stays) / a)

"""Super-twisting: a sliding mode of second order whose torque is continuous, beside the feedback.

    tau = K s + w m sqrt(layer |s|) sign(s) + I,      I' = w K layer sign(s)

(Levant 1993, Int. J. Control 58(6); strict Lyapunov functions: Moreno and Osorio 2012, IEEE Trans. Automatic Control
57(4).) In continuous time s and s' reach zero in finite time whatever disturbance has a bounded derivative. In a
sampled loop with delay the infinite slope of the root at s = 0 makes a limit cycle, so both terms are linear within a
layer,

    w m s,      I' = w K s          for |s| < layer,

a PI controller with the slopes that delay allows (`loop.rates`), and have less slope than that without. The integral is
that of `pid` (`classical.integrate_within`), with its anti-windup.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import ClassVar, Literal, NamedTuple

from ..by_address import by_address
from ..compiled import linked
from ..parts import layout_of
from ..settings import Settings, require_numbers
from ..signals import INDEX, Array, IntArray
from .classical import Integral, Integrator, go_on, integral_of, integrate_within, new_integrator
from .controller import Context, Law
from .law import KERNELS, Kernels, constant_gain
from .observer import ByInertia, masses_of

Z, R, PSI_HAT = INDEX["z"], INDEX["r"], INDEX["psi_hat"]
EFFECTIVE_GAIN, WEIGHT_NORM = INDEX["effective_gain"], INDEX["weight_norm"]


class SuperTwistingSettings(Settings, frozen=True):
    """How steep super-twisting is.

    Args:
        bandwidth: w, slope within the layer [1/s]; None for what its loop bears (`loop.rates`).
        layer: |s| up to which it is linear [m/s, rad/s]. The integral goes at most at `w K layer`: gravity, which PD
            answers with an s of some rad/s, would take seconds with one far smaller.

    Raises:
        ConfigError: A number that is negative, not finite or 0 where it must not be.
    """

    bandwidth: float | None = None
    layer: float = 0.5

    def __post_init__(self) -> None:
        require_numbers(self, "super_twisting", ("layer",))


@by_address
class Twisting(NamedTuple):
    """The numbers of super-twisting: `w m` (p,), the layer, and the integral with the root beside it."""

    slope: Array
    layer: float
    integrator: Integrator


@linked
def twist(row: Array, at: IntArray, a: Twisting, state: Array) -> None:
    """Psi_hat of one sample, root and integral, and the gain; arguments as of `law.estimate`."""
    own, squares = a.integrator, 0.0
    o, z, r = integral_of(state, own.layout), row[at[Z] : at[Z + 1]], row[at[R] : at[R + 1]]
    go_on(row, at, own, o)
    for i in range(o.used.size):
        s = z[i] if i < z.size else r[i - z.size]
        own.beside[i] = a.slope[i] * s * math.sqrt(a.layer / max(abs(s), a.layer))
        row[at[PSI_HAT] + i], row[at[EFFECTIVE_GAIN] + i] = own.beside[i] + o.used[i], own.K[i]
        squares += o.used[i] * o.used[i]
    row[at[WEIGHT_NORM]] = math.sqrt(squares)


@linked
def follow(row: Array, at: IntArray, a: Twisting, state: Array) -> None:
    """The integral of the next sample; arguments as of `law.settle`."""
    integrate_within(row, at, a.integrator, state, a.layer)


KERNELS[Twisting] = Kernels(twist, follow)


@dataclass(frozen=True, eq=False)
class SuperTwisting(ByInertia):
    """`tau = K s + w m sqrt(layer |s|) sign(s) + I`, linear within the layer. Args are those of `ByInertia`."""

    settings: SuperTwistingSettings = field(default_factory=SuperTwistingSettings)
    name: str = "super_twisting"

    kind: ClassVar[Literal["integral", "model", "observer", "sliding"]] = "sliding"

    def law(self, context: Context) -> Law:
        """The numbers of the law; errors as of `positive_gains` and `rate`."""
        K, layout = self.positive_gains(context.layout), layout_of(Integral, self.shapes(context))
        slope = self.rate * masses_of(self.inertia, context.layout.dof, self.name)
        integrator = new_integrator(context, K, self.rate * self.learning, layout)
        return Law(constant_gain(K), Twisting(slope, float(self.settings.layer), integrator))

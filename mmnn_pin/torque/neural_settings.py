"""Settings of the thesis's networks and of their robust term."""

from __future__ import annotations

from typing import ClassVar, Literal

import numpy as np

from ..errors import ConfigError
from ..settings import Settings, require_at_most, require_gains
from ..signals import Array, Layout
from . import law
from .controller import per_velocity, split

MOST_HIDDEN = 10_000  # hidden units of a network


class TwoLayer(Settings, frozen=True):
    """Two-layer network with sigmoid units; both layers learn (3.23)-(3.28), (3.48), (3.49).

    Args:
        hidden: Hidden units per network.
        F: Rates of the output weights, (base, arm).
        G: Rates of the hidden weights, (base, arm).
        kappa: Leakage, e-modification.
        initial: "random" draws V uniform in +-v_range and sets W = 0 (Lewis's practice); "zero" is the thesis's
            section 5.2 and keeps both layers at rank one for ever.
        v_range: Half-width of the initial V.

    Raises:
        ConfigError: A rate is negative or not finite, or there are no hidden units or too many.
    """

    hidden: int = 22
    F: tuple[float, float] = (1.0, 0.2)
    G: tuple[float, float] = (1.0, 0.2)
    kappa: float = 1.0
    initial: Literal["random", "zero"] = "random"
    v_range: float = 1.0

    kind: ClassVar[int] = law.TWO_LAYER
    name: ClassVar[str] = "two_layer"

    def __post_init__(self) -> None:
        require_hidden(self, "two_layer")
        require_gains(self, "two_layer", "F", "G", "kappa", "v_range")
        require_width(self.v_range, "two_layer.v_range")

    def rates(self, which: int, leakage: bool) -> tuple[float, float, float]:
        """Rate of W, rate of V, leakage of the base's (0) or the arm's (1) network."""
        return self.F[which], self.G[which], self.kappa if leakage else 0.0

    def initialise(self, W: Array, V: Array, rng: np.random.Generator) -> None:
        """Initial weights, in place."""
        W[:] = 0.0
        V[:] = rng.uniform(-self.v_range, self.v_range, V.shape) if self.initial == "random" else 0.0


class OneLayer(Settings, frozen=True):
    """One-layer network with fixed Gaussian units: reference [9] of the thesis, reconstructed (see `torque.network`).

    Args:
        hidden: Gaussian units per network.
        beta: Rates of the output weights, (base, arm).
        mu: Leakage.
        width: Width of the Gaussians.
        centre_range: Centres lie in [-centre_range, centre_range] in every input.
        centres: "diagonal" spaces them evenly along the diagonal of the input space, "random" draws them uniformly.

    Raises:
        ConfigError: A rate is negative or not finite, the width is not positive, or there are no units or too many.
    """

    hidden: int = 22
    beta: tuple[float, float] = (0.5, 0.5)
    mu: float = 0.35
    width: float = 4.5
    centre_range: float = 10.0
    centres: Literal["diagonal", "random"] = "diagonal"

    kind: ClassVar[int] = law.ONE_LAYER
    name: ClassVar[str] = "one_layer"

    def __post_init__(self) -> None:
        require_hidden(self, "one_layer")
        require_gains(self, "one_layer", "beta", "mu", "width", "centre_range")
        if self.width == 0:
            raise ConfigError("width 0", why="Gaussians need one", fix="use a number > 0", key="one_layer.width")
        require_width(self.centre_range, "one_layer.centre_range")

    def rates(self, which: int, leakage: bool) -> tuple[float, float, float]:
        """Rate of W, width, leakage of the base's (0) or the arm's (1) network."""
        return self.beta[which], self.width, self.mu if leakage else 0.0

    def initialise(self, W: Array, V: Array, rng: np.random.Generator) -> None:
        """Zero weights and the fixed centres, in place."""
        W[:] = 0.0
        if self.centres == "diagonal":
            V[:] = np.linspace(-self.centre_range, self.centre_range, V.shape[1])
        else:
            V[:] = rng.uniform(-self.centre_range, self.centre_range, V.shape)


class Robust(Settings, frozen=True):
    """Robust term `Kz (|Z_hat|_F + ZB) s` (3.50).

    Args:
        base: Kz of the base, one number or one per velocity.
        arm: Kz of the arm, likewise.
        ZB: Bound assumed on the norm of the ideal weights, (base, arm).

    Raises:
        ConfigError: A number is negative or not finite.
    """

    base: float | tuple[float, ...] = 5.0
    arm: float | tuple[float, ...] = 0.2
    ZB: tuple[float, float] = (5.0, 5.0)

    def __post_init__(self) -> None:
        require_gains(self, "robust")

    def scaled(self, layout: Layout, inertia: Array) -> Robust:
        """The term with every Kz multiplied with an effective inertia (p,), as `Feedback.scaled` does with k."""
        Kz = per_velocity(self.base, self.arm, layout, "robust") * inertia
        return Robust(*split(Kz, layout), self.ZB)


def require_hidden(network: TwoLayer | OneLayer, section: str) -> None:
    """Refuse a network without hidden units, and one that no memory holds.

    Raises:
        ConfigError: With the key.
    """
    if network.hidden < 1:
        raise ConfigError(f"{network.hidden} hidden units", fix="use at least one", key=f"{section}.hidden")
    require_at_most(network, section, {"hidden": MOST_HIDDEN})


def require_width(half: float, key: str) -> None:
    """Refuse a range from -half to half whose width is not finite.

    Raises:
        ConfigError: With the key.
    """
    if not np.isfinite(2 * half):
        raise ConfigError(f"{half}", why="the range's width is no finite number", fix="use a smaller one", key=key)

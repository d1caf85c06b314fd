"""A factor of a study: what it varies, and how a number from 0 to 1 becomes its value."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from ...elementary import exp, log
from ...elementary.normals import probability, quantile
from ...errors import ConfigError
from ...settings import Settings
from ...signals import Array, IntArray

DRAWN = ("uniform", "log_uniform", "normal", "log_normal", "triangular", "integer", "choice")
KINDS = ("grid", *DRAWN)


class Factor(Settings, frozen=True):
    """A factor of a study: the keys that it varies, and exactly one of `grid` and the distributions.

    Args:
        grid: Every one of these values, with every other setting.
        uniform: (lower, upper).
        log_uniform: (lower, upper), uniform in the logarithm.
        normal: (mean, standard deviation).
        log_normal: (median, standard deviation of the natural logarithm).
        triangular: (lower, mode, upper).
        integer: (lower, upper), every whole number between them equally likely, both included.
        choice: Values, equally likely.
        within: Cuts `normal` and `log_normal` off outside these bounds.
        keys: Key paths of the experiment that get the value; the factor's name if there are none.
        relative: Multiply the experiment's value by this one instead of replacing it.
        unit: Unit for tables and pictures.

    Raises:
        ConfigError: None or several distributions, or one that cannot be; the key is the argument.
    """

    grid: tuple[Any, ...] | None = None
    uniform: tuple[float, float] | None = None
    log_uniform: tuple[float, float] | None = None
    normal: tuple[float, float] | None = None
    log_normal: tuple[float, float] | None = None
    triangular: tuple[float, float, float] | None = None
    integer: tuple[int, int] | None = None
    choice: tuple[Any, ...] | None = None
    within: tuple[float, float] | None = None
    keys: tuple[str, ...] = ()
    relative: bool = False
    unit: str = ""

    def __post_init__(self) -> None:
        given = [kind for kind in KINDS if getattr(self, kind) is not None]
        if len(given) != 1:
            what = f"{' and '.join(given)} at once" if given else "neither values nor a distribution"
            raise ConfigError(what, fix=f"give one of: {', '.join(KINDS)}")
        kind = given[0]
        numbers = getattr(self, kind)
        if kind in ("grid", "choice"):
            require_values(kind, numbers, self.relative)
        elif not all(math.isfinite(number) for number in numbers):
            raise ConfigError(f"{list(numbers)} is not finite", fix="use finite numbers", key=kind)
        elif reason := impossible(kind, numbers):
            raise ConfigError(f"{list(numbers)} is no {kind.replace('_', '-')} distribution", why=reason, key=kind)
        if self.within is not None:
            self._require_within(kind)

    def _require_within(self, kind: str) -> None:
        assert self.within is not None
        lower, upper = self.within
        if kind not in ("normal", "log_normal"):
            raise ConfigError(f"bounds for {kind}", fix="use them with normal or log_normal", key="within")
        if math.isnan(lower) or math.isnan(upper) or not lower < upper:
            raise ConfigError(f"{[lower, upper]} are no bounds", fix="give a lower and a higher number", key="within")
        inside = self._cut()
        if not inside[1] - inside[0] > 1e-12:
            why = "the distribution has nothing between them"
            raise ConfigError(f"nothing within {[lower, upper]}", why=why, fix="widen them", key="within")

    @property
    def kind(self) -> str:
        """Name of its distribution, or "grid"."""
        return next(kind for kind in KINDS if getattr(self, kind) is not None)

    def paths(self, name: str) -> tuple[str, ...]:
        """Key paths of the experiment that get the value of a factor of this name."""
        return self.keys or (name,)

    @property
    def drawn(self) -> bool:
        """Whether it is drawn, not gone through."""
        return self.grid is None

    @property
    def numeric(self) -> bool:
        """Whether its values are numbers that have an order, more than two of them."""
        values = self.grid or self.choice
        return values is None or (len(values) > 2 and all(map(is_number, values)))

    @property
    def on_log_scale(self) -> bool:
        """Whether it is spread over a logarithm."""
        return self.kind in ("log_uniform", "log_normal")

    def value(self, u: float) -> Any:
        """Its value at a probability u in [0, 1): the inverse of its distribution function."""
        if self.choice is not None:
            return self.choice[min(int(u * len(self.choice)), len(self.choice) - 1)]
        if self.integer is not None:
            lower, upper = self.integer
            return min(lower + int(u * (upper - lower + 1)), upper)
        if self.kind in ("normal", "log_normal"):  # within the bounds, and never at 0 or 1 of an endless distribution
            low, high = self._cut()
            u = min(max(low + u * (high - low), 1e-300), 1.0 - 2.0**-53)
        return float(QUANTILES[self.kind](getattr(self, self.kind), u))

    def _cut(self) -> tuple[float, float]:
        """Probabilities below the bounds."""
        if self.within is None:
            return 0.0, 1.0
        middle, deviation = getattr(self, self.kind)
        lower, upper = self.within
        if self.kind == "log_normal":
            middle = log(middle)
            lower, upper = (log(bound) if bound > 0 else -math.inf for bound in (lower, upper))
        return probability((lower - middle) / deviation), probability((upper - middle) / deviation)


def impossible(kind: str, numbers: tuple[float, ...]) -> str:
    """Why these numbers make no distribution of a kind; empty if they do."""
    return next((why for kinds, holds, why in RULES if kind in kinds and not holds(numbers)), "")


RULES: tuple[tuple[tuple[str, ...], Callable[[tuple[float, ...]], bool], str], ...] = (
    (
        ("uniform", "log_uniform", "triangular"),
        lambda numbers: numbers[0] < numbers[-1],
        "the lower end must be below the upper one",
    ),
    (("integer",), lambda numbers: numbers[0] <= numbers[1], "the lower end must not be above the upper one"),
    (("triangular",), lambda numbers: numbers[0] <= numbers[1] <= numbers[2], "the mode must lie between the ends"),
    (("log_uniform", "log_normal"), lambda numbers: numbers[0] > 0, "a logarithm needs numbers > 0"),
    (("normal", "log_normal"), lambda numbers: numbers[1] > 0, "the standard deviation must be > 0"),
)


def require_values(kind: str, values: tuple[Any, ...], relative: bool) -> None:
    """Refuse lists of nothing, of what is no setting, or with the same value twice (`ConfigError`)."""
    if not values:
        raise ConfigError("no values, so no runs", fix="give at least one", key=kind)
    before = set[Any]()
    for i, value in enumerate(values):
        if not isinstance(value, (bool, int, float, str, list, tuple)):
            what = f"{value!r} is no setting"
            raise ConfigError(what, fix="use numbers, texts, true, false or lists of them", key=f"{kind}.{i}")
        if is_number(value) and not math.isfinite(float(value)):  # type: ignore[arg-type]
            raise ConfigError(f"{value} is not finite", fix="use finite numbers", key=f"{kind}.{i}")
        if hashable(value) in before:
            raise ConfigError(f"{value!r} comes twice", fix="name each value once", key=kind)
        before.add(hashable(value))
        if relative and not is_number(value):
            raise ConfigError(f"{value!r} multiplies nothing", fix="use numbers with relative", key=f"{kind}.{i}")


def hashable(value: Any) -> Any:
    """A value of TOML in a form for sets; equal ones are equal."""
    if isinstance(value, dict):
        return frozenset((key, hashable(part)) for key, part in value.items())
    return tuple(map(hashable, value)) if isinstance(value, (list, tuple)) else value


def is_number(value: Any) -> bool:
    """Whether a value is a number; true and false are none."""
    return isinstance(value, (int, float)) and not isinstance(value, bool)


def triangular(numbers: tuple[float, float, float], u: float) -> float:
    """Quantile of the triangular distribution of a lower end, a mode and an upper end."""
    lower, mode, upper = numbers
    at_mode = (mode - lower) / (upper - lower)
    if u < at_mode:
        return lower + math.sqrt(u * (upper - lower) * (mode - lower))
    return upper - math.sqrt((1.0 - u) * (upper - lower) * (upper - mode))


QUANTILES: dict[str, Callable[[Any, float], float]] = {
    "uniform": lambda ends, u: ends[0] + u * (ends[1] - ends[0]),
    "log_uniform": lambda ends, u: ends[0] * exp(u * log(ends[1] / ends[0])),
    "normal": lambda numbers, u: numbers[0] + numbers[1] * quantile(u),
    "log_normal": lambda numbers, u: numbers[0] * exp(numbers[1] * quantile(u)),
    "triangular": triangular,
}


def draws_of(factors: Mapping[str, Factor], runs: Sequence[tuple[Mapping[str, Any], int]]) -> IntArray:
    """Number of the draw of every run, (n,): runs for which the same was drawn, of one seed where nothing is drawn.

    Args:
        factors: Of the study.
        runs: Values of the factors, and the seed.
    """
    drawn = [name for name, factor in factors.items() if factor.drawn]
    keys = [repr([values[name] for name in drawn] if drawn else seed) for values, seed in runs]
    number = {key: i for i, key in enumerate(dict.fromkeys(keys))}
    return np.array([number[key] for key in keys], np.int64)


def unit_cube(method: str, points: int, size: int, seed: int) -> Array:
    """Points in the unit cube, (points, size), every entry in [0, 1).

    Args:
        method: "random"; "lhs", Latin hypercube: one point in each of `points` slices of every axis; "sobol",
            Owen-scrambled Sobol sequence, most even where `points` is a power of 2.
        points: How many.
        size: Number of axes.
        seed: Of the draws.
    """
    from scipy.stats import qmc

    if not size:
        return np.zeros((points, 0))
    rng = np.random.default_rng(seed)
    if method == "random":
        return rng.random((points, size))
    if method == "lhs":
        return np.asarray(qmc.LatinHypercube(size, seed=rng).random(points))
    power = max(points - 1, 0).bit_length()
    return np.asarray(qmc.Sobol(size, seed=rng).random_base2(power)[:points])

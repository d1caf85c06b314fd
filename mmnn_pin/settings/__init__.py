"""Settings: frozen msgspec structs, the same in Python and in a TOML config, which knows no unknown keys.

Here are their base, the checks that they share, and the settings that every block needs: the periods of a run.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence
from typing import Any, Literal

import msgspec
import numpy as np
from numpy.typing import ArrayLike

from ..errors import LENGTH, ConfigError, InputError
from ..signals import Array
from .arguments import is_numeric, require_fit, require_known, shortly

LARGEST = 1e12  # of a number that is squared somewhere
Numbers = float | tuple[float, ...]  # one for all, or one for each; see `one_or_each`
MOST_PERIODS = 1e8  # in one another; a run keeps some 100 bytes of its reference for each
TIDY_WITHIN = 0.15  # how far a period that is advised may be from the one that was given, where a round one is there


class Typed(msgspec.StructMeta):
    """Settings made in Python: a value of a wrong type is the same error as in a file."""

    def __call__(cls, *args: Any, **kwargs: Any) -> Any:
        """New settings.

        Raises:
            ConfigError: A value that cannot be used, with the class and the field as its key.
            UnknownArgument: One that does not exist.
            TypeError: One that is missing, or too many.
        """
        require_known(cls, kwargs, cls.__struct_fields__)
        given = dict(zip(cls.__struct_fields__, args, strict=False)) | kwargs
        require_fit(cls, given)
        try:
            return super().__call__(*args, **kwargs)
        except InputError:
            raise
        except (TypeError, ValueError, AttributeError, LookupError, OverflowError) as error:
            required = [field.name for field in msgspec.structs.fields(cls) if field.required]  # type: ignore[arg-type]
            if len(args) > len(cls.__struct_fields__) or not set(required) <= set(given):
                raise
            values = ", ".join(f"{name} = {shortly(value)}" for name, value in given.items())
            why = " ".join(str(error).split())
            raise ConfigError(f"{values} cannot be used", why=why, key=cls.__name__) from error


class Settings(msgspec.Struct, metaclass=Typed, frozen=True, forbid_unknown_fields=True):
    """Base of all settings; a child checks its own values in `__post_init__`."""


def plain(settings: Any) -> Any:
    """Settings as JSON has them; numbers of numpy become numbers."""
    return msgspec.to_builtins(settings, enc_hook=lambda value: np.asarray(value).tolist())


def finite(value: float | None) -> float | None:
    """A number for JSON: nothing where there is none, or an infinite one."""
    return float(value) if value is not None and math.isfinite(value) else None


def require_at_most(settings: Settings, section: str, most: Mapping[str, int]) -> None:
    """Refuse sizes with which memory and time would explode.

    Args:
        settings: Where the sizes are.
        section: First part of the key path in an error.
        most: Field to its largest value.

    Raises:
        ConfigError: With the key path.
    """
    for name, largest in most.items():
        if getattr(settings, name) > largest:
            why, fix = "memory and time grow with it", f"use at most {largest}"
            raise ConfigError(f"{getattr(settings, name)}", why=why, fix=fix, key=f"{section}.{name}")


def require_gains(settings: Settings, section: str, *names: str) -> None:
    """Refuse numbers that are negative or not finite.

    Args:
        settings: Where the numbers are.
        section: First part of the key path in an error.
        names: Fields to check; all if none are named.

    Raises:
        ConfigError: With the key path.
    """
    for name in names or settings.__struct_fields__:
        if not isinstance(value := getattr(settings, name), str):
            require_gain(value, f"{section}.{name}")


def require_gain(value: Any, key: str) -> None:
    """Refuse a number, or numbers, negative or not finite (`ConfigError`)."""
    if isinstance(value, int | float) and 0.0 <= value < math.inf:
        return  # most numbers, and numpy takes longer
    if not np.all(np.isfinite(value)) or np.any(np.asarray(value) < 0):
        raise ConfigError(f"{value} is negative or not finite", fix="use a finite number >= 0", key=key)


def require_numbers(settings: Settings, section: str, positive: Collection[str]) -> None:
    """Refuse fields with numbers that are negative, not finite or huge, or 0 where they must not be.

    Fields that are None or a text are let pass.

    Args:
        settings: Where the numbers are.
        section: First part of the key path in an error.
        positive: Fields whose numbers must be > 0.

    Raises:
        ConfigError: With the key path.
    """
    for name in settings.__struct_fields__:
        value, key = getattr(settings, name), f"{section}.{name}"
        if value is None or isinstance(value, str):
            continue
        if isinstance(value, int | float) and (0 < value <= LARGEST or (value == 0 and name not in positive)):
            continue  # most numbers, and numpy takes longer
        if name in positive and np.any(np.asarray(value) <= 0):
            raise ConfigError(f"{value}", fix="use a number > 0", key=key)
        require_gain(value, key)
        if np.any(np.asarray(value) > LARGEST):
            raise ConfigError(f"{value}", fix=f"use a number up to {LARGEST:g}", key=key)


def one_or_each(
    value: ArrayLike,
    count: int,
    kind: str,
    key: str | None = None,
    least: float | None = None,
    names: Sequence[str] = (),
) -> Array:
    """One number for all, or one for each, as one for each, (count,).

    Args:
        value: One number, or `count` of them.
        count: How many there are.
        kind: What there are, for messages: `joint`, `motor`, `velocity`.
        key: Key path of the value, for messages.
        least: Smallest number that is allowed; the numbers must then be finite. None allows all numbers.
        names: Their names, for messages.

    Raises:
        ConfigError: Another number of numbers, or one that is not allowed.
    """
    fix = f"give one number or one per {kind}" + (f": {', '.join(names)}" if names else "")
    if not is_numeric(value):
        raise ConfigError(f"{shortly(value)} is no number", fix=fix, key=key)
    values = np.asarray(value, float)
    if values.shape not in ((), (count,)):
        kinds = f"{kind[:-1]}ies" if kind.endswith("y") else f"{kind}s"
        raise ConfigError(f"{values.size} numbers for {count} {kinds}", fix=fix, key=key, code=LENGTH)
    if least is not None and not (np.isfinite(values) & (values >= least)).all():
        raise ConfigError(f"{values.tolist()} cannot be used", fix=f"{fix}, finite and >= {least:g}", key=key)
    return np.full(count, values)


def given_array(key: str, values: Any, shape: tuple[int, ...], *, finite: bool = True, endless: bool = False) -> Array:
    """Copy of an array of a shape, finite (`endless`: with infinite numbers, but numbers) unless it may be otherwise.

    Raises:
        ConfigError: It is not.
    """
    if not is_numeric(values):
        raise ConfigError(f"{shortly(values)} is no array", fix=f"give finite numbers of shape {shape}", key=key)
    array = np.array(values, float)
    if array.shape != shape or (finite and not (~np.isnan(array) if endless else np.isfinite(array)).all()):
        what = f"of shape {array.shape}" if array.shape != shape else "not finite"
        raise ConfigError(f"an array that is {what}", fix=f"give finite numbers of shape {shape}", key=key)
    return array


class Timing(Settings, frozen=True):
    """Periods of a run. Torque is held between control samples, a measurement between sensor samples.

    Args:
        duration: Length of the run [s].
        control_period: Time between control samples [s].
        plant_step: Integration step of the plant [s].
        sensor_period: Time between measurements [s]; None measures at every control sample.
        integrator: "rk4", "semi_implicit_euler", "implicit_friction" for friction too stiff for these, or "stick" for
            dry friction that really holds a joint; "auto" takes rk4, or implicit_friction where a `Loop` finds the
            viscous friction of its robot too stiff for the plant step.

    Raises:
        ConfigError: A period is not positive and finite, or the plant step does not divide the others.

    >>> Timing(duration=2.0, control_period=0.005, plant_step=0.001).samples
    400
    """

    duration: float = 5.0
    control_period: float = 0.002
    plant_step: float = 0.001
    sensor_period: float | None = None
    integrator: Literal["auto", "rk4", "semi_implicit_euler", "implicit_friction", "stick"] = "auto"

    def __post_init__(self) -> None:
        for name in ("duration", "control_period", "plant_step", "sensor_period"):
            value = getattr(self, name)
            if value is not None and not (math.isfinite(value) and value > 0):
                raise ConfigError(f"{value} s", fix="use a finite number of seconds > 0", key=f"time.{name}")
        divide(self.duration, self.control_period, "control_period", self.plant_step)
        divide(self.control_period, self.plant_step, "plant_step")
        divide(self.sensor_period or self.control_period, self.plant_step, "plant_step")

    @property
    def samples(self) -> int:
        """Number of control samples."""
        return divide(self.duration, self.control_period, "control_period")

    @property
    def measurements(self) -> int:
        """Number of measurements."""
        return -(-self.samples * self.steps_per_control // self.steps_per_measurement)

    @property
    def measurement_period(self) -> float:
        """Time between two measurements [s]."""
        return self.sensor_period or self.control_period

    @property
    def steps_per_control(self) -> int:
        """Plant steps per control sample."""
        return divide(self.control_period, self.plant_step, "plant_step")

    @property
    def steps_per_measurement(self) -> int:
        """Plant steps per measurement."""
        return divide(self.sensor_period or self.control_period, self.plant_step, "plant_step")


def divide(whole: float, period: float, name: str, step: float = 0.0) -> int:
    """How many periods make the whole.

    Args:
        whole: What they make [s].
        period: The period [s].
        name: Key of the period in `[time]`.
        step: What divides the period that an error advises [s]; 0 for nothing.

    Raises:
        ConfigError: It is not a whole number of them, or more than can be handled.
    """
    if whole / period > MOST_PERIODS:
        what = f"{whole:g} s hold more than {MOST_PERIODS:.0e} periods of {period:g} s"
        raise ConfigError(
            what,
            fix="shorten the run, or lengthen the period",
            key=f"time.{'duration' if name == 'control_period' else name}",
        )
    count = round(whole / period)
    if count < 1 or abs(count * period - whole) > 1e-9 * whole:
        raise ConfigError(
            f"{period} s does not divide {whole} s",
            why=f"{whole} / {period} = {whole / period:.6g}",
            fix=f"for example {round_period(whole, period, step):.12g}",
            key=f"time.{name}",
        )
    return count


def round_period(whole: float, period: float, step: float = 0.0) -> float:
    """A period near one that does not divide a whole, which does: one of few digits, where there is one near enough.

    Where so many steps make the whole, some of them make the period.
    """
    steps = round(whole / step) if step else 0
    if steps and abs(steps * step - whole) <= 1e-9 * whole:
        low = [k for k in range(1, math.isqrt(steps) + 1) if steps % k == 0]
        return step * min((*low, *(steps // k for k in low)), key=lambda k: abs(k * step - period))
    unit = float(f"1e{format(period, 'e').partition('e')[2]}")  # of its first digit
    for digits in range(3):
        step = unit / 10**digits
        near = (round(period / step) + np.arange(-5, 6)) * step
        fits = [one for one in near if one > 0 and abs(round(whole / one) * one - whole) <= 1e-9 * whole]
        fits = [one for one in fits if abs(one - period) <= TIDY_WITHIN * period]
        if fits:
            return float(min(fits, key=lambda one: abs(one - period)))
    return whole / max(1, round(whole / period))

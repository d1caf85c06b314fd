"""When things happen: control, plant and sensor periods in seconds, which must divide."""

from __future__ import annotations

import math
from typing import Literal

from .errors import ConfigError
from .settings import Settings

MOST = 1e9  # periods in one another


class Timing(Settings, frozen=True):
    """Periods of a run. Torque is held between control samples, a measurement between sensor samples.

    Args:
        duration: Length of the run [s].
        control_period: Time between control samples [s].
        plant_step: Integration step of the plant [s].
        sensor_period: Time between measurements [s]; None measures at every control sample.
        integrator: "rk4", "semi_implicit_euler", "implicit_friction" for friction too stiff for these, or "stick" for
            dry friction that really holds a joint.

    Raises:
        ConfigError: A period is not positive and finite, or the plant step does not divide the others.
    """

    duration: float = 5.0
    control_period: float = 0.002
    plant_step: float = 0.001
    sensor_period: float | None = None
    integrator: Literal["rk4", "semi_implicit_euler", "implicit_friction", "stick"] = "rk4"

    def __post_init__(self) -> None:
        for name in ("duration", "control_period", "plant_step", "sensor_period"):
            value = getattr(self, name)
            if value is not None and not (math.isfinite(value) and value > 0):
                raise ConfigError(f"{value} s", fix="use a finite number of seconds > 0", key=f"time.{name}")
        for name, whole in (("control_period", self.duration), ("plant_step", self.control_period)):
            divide(whole, getattr(self, name), name)
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


def divide(whole: float, period: float, name: str) -> int:
    """How many periods make the whole.

    Raises:
        ConfigError: It is not a whole number of them, or more than can be handled.
    """
    if whole / period > MOST:
        raise ConfigError(f"{whole} s hold more than {MOST:.0e} periods of {period} s", key=f"time.{name}")
    count = round(whole / period)
    if count < 1 or abs(count * period - whole) > 1e-9 * whole:
        raise ConfigError(
            f"{period} s does not divide {whole} s",
            why=f"{whole} / {period} = {whole / period:.6g}",
            fix=f"for example {whole / max(1, count):.12g}",
            key=f"time.{name}",
        )
    return count

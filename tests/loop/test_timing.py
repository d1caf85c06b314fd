"""Periods divide, or the run is refused with a number that would."""

from __future__ import annotations

from typing import Any

import hypothesis
import pytest
from hypothesis import strategies as st

from mmnn_pin.errors import ConfigError
from mmnn_pin.settings import Timing, divide, round_period


@pytest.mark.parametrize(
    ("whole", "period", "count"),
    [(5.0, 0.002, 2500), (0.002, 0.001, 2), (1.0, 1.0, 1), (0.3, 0.1, 3), (0.7, 0.1, 7), (8.0, 1 / 200, 1600)],
)
def test_accepted_pairs(whole: float, period: float, count: int) -> None:
    assert divide(whole, period, "plant_step") == count


@hypothesis.given(st.integers(1, 100_000), st.floats(1e-5, 1.0))
def test_multiples_divide_whatever_their_rounding(count: int, period: float) -> None:
    assert divide(count * period, period, "plant_step") == count
    assert divide(count * period * (1 + 1e-15), period, "plant_step") == count


@hypothesis.given(st.integers(1, 1000), st.floats(1e-3, 1.0), st.floats(0.001, 0.999))
def test_what_lies_between_does_not(count: int, period: float, more: float) -> None:
    with pytest.raises(ConfigError):
        divide((count + more) * period, period, "plant_step")


@pytest.mark.parametrize(("whole", "period"), [(0.005, 0.002), (0.001, 0.002), (1.0, 0.3), (1e-9, 1.0)])
def test_refused_pairs_name_a_period_that_divides(whole: float, period: float) -> None:
    with pytest.raises(ConfigError, match=r"^time.plant_step: error: .* does not divide") as refused:
        divide(whole, period, "plant_step")
    advice = float(refused.value.fix.rsplit(" ", 1)[1])
    assert divide(whole, advice, "plant_step") >= 1


def test_counts_of_a_run() -> None:
    timing = Timing(duration=1.0, control_period=0.004, plant_step=0.0005, sensor_period=0.002)
    assert (timing.samples, timing.steps_per_control, timing.steps_per_measurement) == (250, 8, 4)
    assert Timing(control_period=0.004, plant_step=0.0005).steps_per_measurement == 8
    assert Timing(sensor_period=0.01).steps_per_measurement == 10  # slower than control


@pytest.mark.parametrize(
    ("given", "key"),
    [
        ({"duration": 1.0, "control_period": 0.3}, "control_period"),
        ({"control_period": 0.002, "plant_step": 0.0015}, "plant_step"),
        ({"control_period": 0.002, "plant_step": 0.004}, "plant_step"),
        ({"sensor_period": 0.0025}, "plant_step"),
        ({"plant_step": 0.0}, "plant_step"),
        ({"duration": -1.0}, "duration"),
        ({"control_period": float("nan")}, "control_period"),
        ({"sensor_period": 0.0}, "sensor_period"),
        ({"duration": float("inf")}, "duration"),
    ],
)
def test_periods_that_do_not_fit_are_refused(given: dict[str, Any], key: str) -> None:
    with pytest.raises(ConfigError) as refused:
        Timing(**given)
    assert refused.value.key == f"time.{key}"


@hypothesis.given(st.floats(1e-4, 0.1), st.sampled_from([1.0, 2.5, 10.0, 30.0]))
def test_the_period_that_is_advised_divides_and_is_near(period: float, whole: float) -> None:
    advised = round_period(whole, period)
    assert abs(round(whole / advised) * advised - whole) <= 1e-9 * whole
    assert 0.5 <= advised / period <= 2.0
    if whole == 10.0 and abs(period - 0.0007) < 1e-9:
        assert advised == 0.0008


@hypothesis.given(
    st.floats(1e-3, 0.1), st.sampled_from([1.0, 2.5, 10.0, 30.0]), st.sampled_from([0.0005, 0.001, 0.0002, 0.0003])
)
def test_a_control_period_that_is_advised_is_taken_as_it_stands(period: float, duration: float, step: float) -> None:
    """One that the plant's step does not divide would be refused the next time, where another can be had."""
    try:
        Timing(duration=duration, control_period=period, plant_step=step)
    except ConfigError as error:
        key = error.key
        advised = float(str(error.fix).rsplit(" ", 1)[1])
        if key != "time.control_period" or round(duration / step) * step != pytest.approx(duration, rel=1e-9):
            return
        assert Timing(duration=duration, control_period=advised, plant_step=step).control_period == advised
        assert 0.4 <= advised / period <= 2.5

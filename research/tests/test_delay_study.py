"""The delay that loses a robot, against its margin."""

from __future__ import annotations

import pytest
from numba import config

from mmnn_pin import load
from mmnn_pin.model.robots import extra
from research.studies.delay import FIVE, TENFOLD, study, swaying, variation

PLAIN = bool(config.DISABLE_JIT)


@pytest.mark.skipif(PLAIN, reason="runs of seconds")
@pytest.mark.parametrize("name", ["platform_arm", *(pytest.param(name, marks=pytest.mark.long) for name in FIVE[1:])])
def test_the_margin_is_within_a_tenth_of_the_delay_at_which_errors_grow_tenfold_in_five_seconds(name: str) -> None:
    """Robots as they are, gravity and dry friction included; `research.studies.delay` bisects between these."""
    if name not in ("platform_arm", "two_axis_arm") and name not in extra():
        pytest.skip("example-robot-data is not installed")
    robot = load(name)
    margin, (rest, _) = swaying(robot, 0.0).delay_margin(), variation(swaying(robot, 0.0))
    below, above = (variation(swaying(robot, share * margin))[0] for share in (0.9, 1.1))
    assert below <= TENFOLD * rest < above


@pytest.mark.long
@pytest.mark.skipif(PLAIN, reason="runs of seconds")
@pytest.mark.parametrize("name", [name for name in FIVE if name in ("platform_arm", "two_axis_arm") or name in extra()])
def test_the_bisected_delay_is_within_a_tenth_of_the_margin(name: str) -> None:
    found = study(name)
    assert found.ratio == pytest.approx(1.0, abs=0.1)

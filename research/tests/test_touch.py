"""Learners that were pressed against a wall are not thrown when it goes away."""

from __future__ import annotations

import pytest

from mmnn_pin.touch import Touch
from research.studies.touch import against_a_wall, thrown

LEARNERS = ("learned", "feedforward", "adaptive", "adaptive_composite", "concurrent", "two_layer")
LEARNERS += ("kalman_bilinear", "super_twisting", "pid")
SELDOM = "super_twisting", "pid"  # feel the wall for 86 % of the time


@pytest.fixture(scope="module")
def right() -> float:
    """How far the release moves the hand under the right model, which learns nothing [m]."""
    return thrown(against_a_wall("computed_torque", None))[0]


@pytest.mark.parametrize("name", LEARNERS)
def test_a_release_moves_the_hand_no_more_than_half_as_far_again(name: str, right: float) -> None:
    far, _, felt, failed = thrown(against_a_wall(name, Touch()))
    assert not failed and felt > (0.8 if name in SELDOM else 0.9) and far < 1.5 * right

"""How far robots go unseen, as the study of it tells."""

from __future__ import annotations

from mmnn_pin import load
from research.studies.blind import window


def test_a_silence_is_seen_before_the_robot_has_gone_far_and_half_a_second_is_too_late() -> None:
    robot = load("platform_arm")
    seen, late = window(robot, "adaptive", None), window(robot, "adaptive", 0.5)
    assert 0.02 < seen.time < 0.2 and 0.0 < seen.base < 0.05 and 0.0 < seen.joint < 0.2
    assert late.time > 0.49 and late.base > 0.3 and late.joint > 2.0 and late.speed > 10.0 > seen.speed

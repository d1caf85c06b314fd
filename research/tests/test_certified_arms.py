"""An arm of seven joints on a base, certified: the study's robot and loop at one box."""

from __future__ import annotations

import numpy as np
import pytest

from mmnn_pin import load
from mmnn_pin.model.dynamics import Dynamics
from mmnn_pin.model.robots import extra
from research.proof.boxes import Box, Boxes
from research.studies.certified_arms import HELD, READY, loop_of, platform_panda, study

needs_data = pytest.mark.skipif("panda" not in extra(), reason="example-robot-data is not installed")
BANDWIDTH, BOX = 178.0, Box(4.3e-3, 6.3e-3, 1.0e-4)


def test_a_base_without_an_arm_is_certified() -> None:
    found = study(load("platform_arm", lock=["arm_1_joint", "arm_2_joint"]), 0.1)
    assert found.certificate.holds and found.verdict == "holds" and not len(found.certificate.bound.joints)


@needs_data
def test_seven_joints_on_a_base_are_certified_with_gravity_added_and_not_without() -> None:
    """The box that the table of section 11 begins from; every posture of it by Pinocchio within the bounds."""
    robot = platform_panda()
    assert robot.dimensions.arm == 7 and robot.dimensions.base == 2 and Dynamics(robot).feels_gravity
    for weighs in (True, False):
        loop = loop_of(robot, 0.1, READY["platform_panda"], weighs)
        cover = loop.cover(BOX.arm)
        gain = BANDWIDTH / np.einsum("nii->ni", np.linalg.inv(cover.postures.M)).mean(axis=0)
        tuned = loop.tuned(gain=gain, period=HELD / cover.fastest(gain))
        assert Boxes(tuned, BOX).faces(BOX).invariant == weighs
    assert 1e-4 < tuned.period < 1e-3 and cover.mass_off.max() < 0.15
    rng, dynamics, position = np.random.default_rng(0), Dynamics(robot), robot.neutral_position()
    for _ in range(200):
        k = rng.integers(len(cover.nu))
        position[robot.arm_index] = cover.postures.q[k] + cover.postures.half[k] * rng.choice((-1, 1), 7)
        M = cover.L_inv[k] @ dynamics.mass_matrix(robot.follow(position)) @ cover.L_inv[k].T
        assert np.abs(np.linalg.eigvalsh(M) - 1).max() <= cover.mass_off[k]

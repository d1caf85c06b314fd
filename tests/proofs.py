"""Runs for the tests of what a run proves: small robots of every kind, learners that learn in half a second."""

from __future__ import annotations

from functools import cache

import numpy as np
from numba import config
from robots import feedback, fixed_arm, mobile_arm
from test_holonomic import PATHS, mecanum

from mmnn_pin import PD, Hold, Loop, Neural, Sine, Timing, Trajectory
from mmnn_pin.kinematic import Kinematic
from mmnn_pin.lab.psi.subject import Subject
from mmnn_pin.loop.before_run import Start
from mmnn_pin.model.robot import Robot
from mmnn_pin.recording.recording import Recording
from mmnn_pin.reference import HolonomicPath
from mmnn_pin.torque.neural import Robust
from mmnn_pin.torque.one_layer import OneLayer
from mmnn_pin.torque.two_layer import TwoLayer

KINDS = ("differential", "holonomic", "fixed")
MAKE = {"differential": mobile_arm, "holonomic": mecanum, "fixed": fixed_arm}
PERIOD = 1e-3
SLOW = bool(config.DISABLE_JIT)  # uncompiled code, for coverage: runs as short as they can be


@cache
def robot_of_kind(kind: str) -> Robot:
    """Two joints in any directions, gravity, friction."""
    robot = MAKE[kind](2)
    return robot.with_friction(0.02 * np.arange(1, robot.dimensions.dof + 1))


def loop_of(
    kind: str, controller: object = None, period: float = PERIOD, duration: float = 0.1, **more: object
) -> Loop:
    """A loop that starts off its reference."""
    robot = robot_of_kind(kind)
    base = {0: None, 2: PATHS["eight"], 3: HolonomicPath(PATHS["eight"], Sine(0.5, 4.0))}[robot.dimensions.base]
    start = Start(pose_offset=(0.05, -0.04, 0.2) if base else (0.0, 0.0, 0.0), joint_offset=0.1, moving=True)
    settings = {
        "robot": robot,
        "trajectory": Trajectory(base, (Sine(0.4, 2.0), Hold(0.2))),
        "controller": PD(feedback(robot, 0.002)) if controller is None else controller,
        "kinematic": Kinematic(kx=3.0, ky=20.0, kth=5.0, K=4.0, holonomic=(2.0, 3.0, 4.0)),
        "timing": Timing(duration, period, period),
        "start": start,
        "check_gains": False,
    }
    return Loop(**(settings | more))  # type: ignore[arg-type]


def learner(kind: str, which: str = "two_layer", **more: object) -> Neural:
    """A learner for a robot of a kind."""
    network = {
        "two_layer": TwoLayer(hidden=6, F=(2.0, 1.0), G=(1.5, 0.7), kappa=0.3, v_range=0.5),
        "one_layer": OneLayer(hidden=5, beta=(1.0, 0.6), mu=0.2),
    }[which]
    gains = feedback(robot_of_kind(kind), 0.002)
    return Neural(**{"network": network, "feedback": gains, "robust": Robust(0.5, 0.1, (2.0, 3.0)), **more})


def subject_of(kind: str, recording: Recording) -> Subject:
    """The subject of a run of a robot that may have no URDF (the mecanum base)."""
    if kind != "holonomic":
        return Subject.of(recording)
    subject = Subject.of.__func__  # the classmethod, around the robot of the test
    import mmnn_pin.lab.psi.subject as module

    original, module.recorded_robot = module.recorded_robot, lambda recording: robot_of_kind(kind)
    try:
        return subject(Subject, recording)
    finally:
        module.recorded_robot = original

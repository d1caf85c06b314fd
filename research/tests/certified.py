"""A loop for the tests of the certificate: chapter 4's robot along a line, its arm swinging, gains that certify."""

from __future__ import annotations

from functools import cache

import numpy as np

from mmnn_pin import Feedback, Hold, Line, Loop, Neural, Sine, Timing, Trajectory, load
from mmnn_pin.kinematic import Kinematic
from mmnn_pin.lab.psi.learner import NetworkLearner
from mmnn_pin.loop.before_run import Start
from mmnn_pin.model.robot import Robot
from mmnn_pin.signals import Layout
from mmnn_pin.torque.controller import Context
from mmnn_pin.torque.neural import Robust
from mmnn_pin.torque.two_layer import TwoLayer
from research.proof.certified_loop import CertifiedLoop
from research.proof.cover import Along

PERIOD = 2e-4
DIAGONAL = np.array([115.0, 9.9, 1.7, 0.21])  # of the mass matrix, about


@cache
def certified_robot() -> Robot:
    return load("platform_arm").with_friction(np.array([10.0, 2.0, 0.2, 0.1]))


def controller(bandwidth: float = 100.0, **more: object) -> Neural:
    gain = tuple((bandwidth * DIAGONAL).tolist())
    network = TwoLayer(**({"hidden": 8, "F": (0.1, 0.1), "G": (0.1, 0.1), "kappa": 10.0} | more))  # type: ignore[arg-type]
    return Neural(network, Feedback(gain[:2], gain[2:]), Robust(1.0, 0.02, (1.0, 1.0)))


def kinematic(K: float | tuple[float, ...] = 3.0) -> Kinematic:
    return Kinematic(kx=1.0, ky=8.0, kth=2 * 8**0.5, K=K)


TRAJECTORY = Trajectory(Line(speed=0.3), (Sine(amplitude=0.3, period=6.0), Hold(0.8)))


def loop_of(start: Start, duration: float = 0.5, **more: object) -> Loop:
    """The loop in simulation."""
    settings = {
        "robot": certified_robot(),
        "trajectory": TRAJECTORY,
        "controller": controller(),
        "kinematic": kinematic(),
        "timing": Timing(duration, PERIOD, PERIOD),
        "start": start,
        "check_gains": False,
    }
    return Loop(**(settings | more))  # type: ignore[arg-type]


def learner_loop(
    K: float | tuple[float, ...] = 3.0, disturbance: np.ndarray | None = None, period: float = PERIOD, **network: object
) -> CertifiedLoop:
    """The same as the certificate takes it."""
    robot, control = certified_robot(), controller(**network)
    layout = Layout.of(robot.dimensions)
    table = TRAJECTORY.table(np.arange(600) * 0.01, layout)
    pose, v, a, q, qdot, qddot = np.split(table, np.cumsum([3, 2, 2, 2, 2]), axis=1)
    context = Context(layout, period, 10, np.random.default_rng(np.random.SeedSequence(0).spawn(1)[0]))
    state = control.init(context)
    return CertifiedLoop(
        robot=robot,
        kinematic=kinematic(K),
        along=Along(v, a, q, qdot, qddot, pose),
        period=period,
        gain=control.feedback.vector(layout),
        learner=NetworkLearner(control, context, state, state.snapshot(), 0.0, robot),
        disturbance=np.zeros(layout.dof) if disturbance is None else disturbance,
    )

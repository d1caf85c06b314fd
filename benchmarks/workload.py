"""The robots and closed loops that are measured: 1 kHz plant and control, two-layer law, Psi, semi-implicit Euler."""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from mmnn_pin import Feedback, Line, Loop, Neural, Robot, Sine, Timing, Trajectory, load
from mmnn_pin.lab.experiments.config import load_experiment
from mmnn_pin.model.dynamics import Dynamics
from mmnn_pin.signals import Array
from mmnn_pin.torque.neural import Robust
from mmnn_pin.torque.two_layer import TwoLayer

PERIOD = 0.001  # [s] of plant and control
TIAGO = "cmeel.prefix/share/example-robot-data/robots/tiago_description/robots/tiago_no_hand.urdf"
DENSITY = 40.0  # [kg/m] of the arms made here


def thesis_loop(duration: float, **changes: Any) -> Loop:
    """Chapter 4 of the thesis under the two-layer law, with the periods and the integrator of the benchmark.

    Args:
        duration: Simulated time [s].
        changes: Other attributes of the loop, such as `engine`.
    """
    times = (f"time.duration={duration}", f"time.control_period={PERIOD}", "time.integrator='semi_implicit_euler'")
    experiment = load_experiment("chapter4", times)
    return replace(experiment.loop(experiment.load_robot(), experiment.controller("two_layer")), **changes)


def arm_loop(robot: Robot, duration: float) -> Loop:
    """A differential drive with any arm on a line, the arm swinging a little; gains a twentieth of their limits.

    Without the friction that the URDF declares: that of TIAGo's wrist (1 N m s on some 1e-4 kg m^2) is too stiff for an
    explicit step of 1 ms.
    """
    still = np.zeros_like(robot.damping)
    robot = replace(robot, damping=still, coulomb=still)
    position, limit = robot.neutral_position(), 2.0 / PERIOD
    gains = 0.05 * limit / np.diag(np.linalg.inv(Dynamics(robot).mass_matrix(position)))
    nb, rest = robot.dimensions.base, position[robot.arm_index]
    controller = Neural(
        network=TwoLayer(F=(0.1, 0.01), G=(0.1, 0.01)),
        feedback=Feedback(base=tuple(gains[:nb]), arm=tuple(gains[nb:])),
        robust=Robust(0.0, 0.0, (0.0, 0.0)),
        rates="per_second",
    )
    arm = [Sine(amplitude=0.02, period=4.0, offset=float(q)) for q in rest]
    timing = Timing(duration=duration, control_period=PERIOD, plant_step=PERIOD, integrator="semi_implicit_euler")
    return Loop(robot, Trajectory(Line(speed=0.3), arm), controller, timing=timing, check_gains=False)


def find_tiago(given: Path | None) -> Path | None:
    """URDF of TIAGo without hand: the one given, or that of an installed example-robot-data."""
    places = [given] if given else [Path(entry) / TIAGO for entry in sys.path]
    return next((path for path in places if path.is_file()), None)


def chain(joints: int, folder: Path) -> Robot:
    """A differential drive with an arm of many joints, which hangs from a mast like a crane's rope.

    Axes point in turn along z, y and oblique, so that no joint is a special case. Links are 0.1 m long.
    """
    file = folder / f"chain_{joints}.urdf"
    file.write_text(chain_urdf(joints), encoding="utf-8")
    return load(file)


def chain_urdf(joints: int) -> str:
    """URDF text of `chain`."""
    wheels = "".join(
        f'<link name="{side}"><inertial><mass value="5"/>'
        '<inertia ixx="0.008" ixy="0" ixz="0" iyy="0.014" iyz="0" izz="0.008"/></inertial>'
        '<collision><origin xyz="0 0 0" rpy="1.5707963267948966 0 0"/>'
        '<geometry><cylinder radius="0.075" length="0.04"/></geometry></collision></link>'
        f'<joint name="{side}_joint" type="continuous"><parent link="base"/><child link="{side}"/>'
        f'<origin xyz="0 {y} 0"/><axis xyz="0 1 0"/></joint>'
        for side, y in (("wheel_left", 0.2), ("wheel_right", -0.2))
    )
    base = (
        '<link name="base"><inertial><origin xyz="0 0 0.1"/><mass value="400"/>'
        '<inertia ixx="20" ixy="0" ixz="0" iyy="20" iyz="0" izz="30"/></inertial></link>'
    )
    return f'<robot name="chain_{joints}">{base}{wheels}{"".join(link_urdf(i, joints) for i in range(joints))}</robot>'


def link_urdf(i: int, joints: int) -> str:
    """Link i of an arm and the joint that carries it."""
    axis = ("0 0 1", "0 1 0", "0.6 0.8 0")[i % 3]
    parent, height = ("base", 0.1 * joints + 0.5) if i == 0 else (f"link_{i - 1}", -0.1)
    return (
        f'<link name="link_{i}"><inertial><origin xyz="0.01 0 -0.05"/><mass value="{0.1 * DENSITY}"/>'
        '<inertia ixx="0.05" ixy="0.001" ixz="0" iyy="0.05" iyz="0.001" izz="0.04"/></inertial></link>'
        f'<joint name="joint_{i}" type="revolute"><parent link="{parent}"/><child link="link_{i}"/>'
        f'<origin xyz="0 0 {height}"/><axis xyz="{axis}"/>'
        '<limit lower="-3" upper="3" effort="1000" velocity="10"/></joint>'
    )


def peer_work(duration: float) -> dict[str, Array]:
    """All that a peer needs to do the same run with a controller of its own, and what ours gave.

    The peers' controller starts from our initial weights.
    """
    loop = thesis_loop(duration, engine="compiled")
    controller, layout = loop.controller, loop.layout
    assert isinstance(controller, Neural) and isinstance(controller.network, TwoLayer) and controller.robust
    state, network, nb = controller.init(loop.context()), controller.network, layout.base
    run = loop.run()
    position = run.final["position"]
    end = np.concatenate((position[:3], position[loop.robot.arm_index]))
    references = ("pose_ref", "velocity_ref", "acceleration_ref", "q_ref", "qdot_ref", "qddot_ref")
    measured = {"pose": run["pose"], "q": run["q"], "nu": run["nu"], "torque": run["torque"], "end": end}
    weights = {name: state[name] for name in ("W1", "V1", "W2", "V2")}
    robust = np.array([controller.robust.base] * nb + [controller.robust.arm] * layout.arm, float)
    numbers = {
        "period": PERIOD,
        "kanayama": loop.kinematic.base_gains(layout),
        "K": loop.kinematic.arm_gains(layout),
        "k": controller.feedback.vector(layout),
        "Kz": robust,
        "ZB": controller.robust.ZB,
        "F": network.F,
        "G": network.G,
        "kappa": network.kappa,
        "viscous": loop.robot.viscous,
    }
    arrays = {name: np.array(value, float) for name, value in numbers.items()}
    return {name: run[name] for name in references} | measured | weights | arrays

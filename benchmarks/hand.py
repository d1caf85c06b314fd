"""Times the program of the hand, beside pink and mink on the same robot and path: `python benchmarks/hand.py`.

A line of 0.5 m and a circle of 0.1 m, drawn by the hand of the thesis's robot at 500 Hz. Both peers have a penalty on
what a rolling base cannot do: pink a rolling task per wheel, mink a row on the sideways speed of slides and a hinge.
Told are microseconds per step, the hand's largest distance from its path, and the largest sideways speed commanded.
Peers that are not installed are left out: pip install pin-pink mink qpsolvers daqp, in an environment of their own.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Callable, Mapping
from statistics import median
from time import perf_counter
from typing import Any

import numpy as np

from mmnn_pin import load
from mmnn_pin.reference.hand import HandCircle, HandLine, Pieces, Task, WholeBody

H = 0.002
START = np.array([0.4, 1.0])
PATH = Pieces((HandLine((0.5, 0.0, 0.0), speed=0.2), HandCircle(0.1, speed=0.2)))


def ours(name: str, seconds: float) -> Mapping[str, float]:
    """The whole-body program, and the share of its time that the solver takes."""
    robot = load(name)
    turned = 0.1 if robot.dimensions.arm >= 6 else 0.0
    body = WholeBody(robot, [Task(orientation=turned)], period=H)
    body.put(np.zeros(robot.dimensions.pose), START if name == "platform_arm" else body.bounds.ends.mean(axis=0))
    begin, R = body.places[0, 9:].copy(), body.places[0, :9].reshape(3, 3)
    t = np.arange(round(seconds / H)) * H
    samples = PATH.sample(t)
    rows = np.hstack(
        (samples.position + begin, samples.velocity, samples.acceleration, np.tile(R.ravel(), (len(t), 1)))
    )
    rows = np.hstack((rows, np.zeros((len(t), 6))))
    steps, programs, gaps = [], [], []
    program = body._program

    def timed() -> Any:
        began = perf_counter()
        found = program()
        programs.append(perf_counter() - began)
        return found

    body._program = timed  # type: ignore[method-assign]
    for row in rows:
        began = perf_counter()
        body.step(row[None])
        steps.append(perf_counter() - began)
        gaps.append(np.linalg.norm(body.errors[0, :3]))
    slip = [float(np.abs(robot.base.slip_rows @ robot.T[:3] @ body.nu).max(initial=0.0))]
    return told(steps, gaps, slip) | {"program_us": 1e6 * median(programs), "variables": len(body.nu)}


def told(steps: list[float], gaps: list[Any], slips: list[float]) -> dict[str, float]:
    """What is told of a run."""
    return {"step_us": 1e6 * median(steps), "hand_mm": 1e3 * float(max(gaps)), "sideways_mm_s": 1e3 * float(max(slips))}


def with_pink(name: str, seconds: float) -> Mapping[str, float]:
    """pink: a frame task, a rolling task per wheel, a weak posture task; velocity limits of the model."""
    import pink
    import pinocchio as pin
    from pink.tasks import FrameTask, PostureTask, RollingTask

    robot = load(name)
    model, offset = robot.model.copy(), robot.neutral_position()
    floor = pin.SE3(np.eye(3), np.array([0.0, 0.0, robot.base.floor]))
    model.addFrame(pin.Frame("floor", 0, 0, floor, pin.FrameType.OP_FRAME))
    offset[robot.arm_index] = START
    frame = body_frame(robot)
    hand = FrameTask(frame, position_cost=1.0, orientation_cost=0.0)
    rolling = [RollingTask(hub(robot, w.joint), "floor", w.radius, cost=10.0) for w in robot.base.wheels]
    posture = PostureTask(cost=1e-3)
    tasks, now = [hand, *rolling, posture], pink.Configuration(model, model.createData(), robot.configuration(offset))
    posture.set_target(now.q)
    begin = now.get_transform_frame_to_world(frame).copy()
    t = np.arange(round(seconds / H)) * H
    path, steps, gaps, slips = PATH.sample(t + H).position, [], [], []
    for point in path:
        target = begin.copy()
        target.translation = begin.translation + point
        hand.set_target(target)
        started = perf_counter()
        v = pink.solve_ik(now, tasks, H, solver="daqp", safety_break=False)
        steps.append(perf_counter() - started)
        now.integrate_inplace(v, H)
        gaps.append(np.linalg.norm(now.get_transform_frame_to_world(frame).translation - target.translation))
        slips.append(float(np.abs(robot.base.slip_rows @ v[:3]).max()))
    return told(steps, gaps, slips)


def body_frame(robot: Any) -> str:
    """The hand's frame."""
    return WholeBody(robot, [Task(orientation=0.0)]).frames[0]


def hub(robot: Any, joint: str) -> str:
    """A link that a wheel's joint carries."""
    j = robot.model.getJointId(joint)
    return next(f.name for f in robot.model.frames if f.parentJoint == j and "joint" not in f.name)


def with_mink(name: str, seconds: float) -> Mapping[str, float]:
    """mink: slides and a hinge for the base, with a penalty on what is sideways."""
    import mink
    import mujoco

    class Sideways(mink.Task):
        """No speed across the base's heading."""

        def __init__(self) -> None:
            super().__init__(cost=np.array([10.0]))
            self.row = np.zeros(mj.nv)

        def compute_error(self, configuration: Any) -> Any:
            return np.zeros(1)

        def compute_jacobian(self, configuration: Any) -> Any:
            return self.row[None]

    arm = """<mujoco><worldbody><body><joint name='x' type='slide' axis='1 0 0'/><joint name='y' type='slide'
    axis='0 1 0'/><joint name='w' type='hinge' axis='0 0 1'/><geom size='.1'/>{}</body></worldbody></mujoco>"""
    robot = load(name)
    rows, model = [], robot.model
    for joint in robot.joint_names:
        place = model.jointPlacements[model.getJointId(joint)]
        at = " ".join(map(str, place.translation))
        rows.append(f"<body pos='{at}'><joint name='{joint}' type='hinge' axis='0 0 1'/><geom size='.02'/>")
    tip = model.frames[model.getFrameId(body_frame(robot))].placement.translation
    site = f"<site name='hand' pos='{' '.join(map(str, tip))}'/>"
    mj = mujoco.MjModel.from_xml_string(arm.format("".join(rows) + site + "</body>" * len(rows)))
    now = mink.Configuration(mj, q=np.hstack((np.zeros(3), START)))
    hand = mink.FrameTask("hand", "site", position_cost=1.0, orientation_cost=0.0)
    side, calm = Sideways(), mink.DampingTask(mj, 1e-3)
    begin = now.get_transform_frame_to_world("hand", "site")
    t = np.arange(round(seconds / H)) * H
    steps, gaps, slips = [], [], []
    for point in PATH.sample(t + H).position:
        target = mink.SE3.from_rotation_and_translation(begin.rotation(), begin.translation() + point)
        hand.set_target(target)
        c, s = np.cos(now.q[2]), np.sin(now.q[2])
        side.row[:2] = -s, c
        started = perf_counter()
        v = mink.solve_ik(now, [hand, side, calm], H, "daqp")
        steps.append(perf_counter() - started)
        slips.append(abs(c * v[1] - s * v[0]))
        now.integrate_inplace(v, H)
        gaps.append(
            np.linalg.norm(now.get_transform_frame_to_world("hand", "site").translation() - target.translation())
        )
    return told(steps, gaps, slips)


PEERS: dict[str, Callable[[str, float], Mapping[str, float]]] = {"pink": with_pink, "mink": with_mink}


def main() -> None:
    """Parse the command line, measure, print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--json", action="store_true", help="one JSON object")
    parser.add_argument("--seconds", type=float, default=6.0, help="of the path (6)")
    parser.add_argument("--robots", nargs="+", default=["platform_arm", "tiago"], help="for our own times")
    options = parser.parse_args()
    found: dict[str, Mapping[str, float] | str] = {f"ours, {n}": ours(n, options.seconds) for n in options.robots}
    for peer, run in PEERS.items():
        try:
            found[f"{peer}, platform_arm"] = run("platform_arm", options.seconds)
        except ImportError as error:
            found[peer] = f"left out: {error}"
    if options.json:
        print(json.dumps(found))
        return
    for name, numbers in found.items():
        shown = numbers if isinstance(numbers, str) else "  ".join(f"{k} {v:.4g}" for k, v in numbers.items())
        print(f"{name:22}{shown}")


if __name__ == "__main__":
    main()

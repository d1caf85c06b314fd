"""The delay that loses a robot, against its delay margin before the run: `python -m research.studies.delay`.

PD of 60 1/s at 500 Hz holds its posture, a base drives along a line, from a small offset, on robots as they are, with
gravity and dry friction. Commands are late; the delay is bisected, in steps of the plant, at which the errors of the
last of five seconds vary more than ten times as much as they do without delay.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from mmnn_pin.kinematic import Kinematic
from mmnn_pin.lab.show.table import Column, Table, number, row_of, terminal_text
from mmnn_pin.loop.before_run import Start
from mmnn_pin.loop.latency import Latency
from mmnn_pin.loop.loop import Loop
from mmnn_pin.loop.suited import LoopToSuit, suited
from mmnn_pin.model import Robot, load
from mmnn_pin.reference import Hold, Line, Trajectory
from mmnn_pin.settings import Timing
from mmnn_pin.torque.controller import Feedback
from mmnn_pin.torque.model_based import PD

FIVE = ("platform_arm", "two_axis_arm", "tiago", "ur5", "panda")
TENFOLD, SECONDS, STEP = 10.0, 5.0, 0.00025  # [s], of the plant [s]
OFFSET = 0.001  # at the start [m, rad]


@dataclass(frozen=True)
class Found:
    """One robot: delay margin and the delay that loses it [s], and how far joints are off where it rests [rad or m]."""

    robot: str
    margin: float
    lost: float
    sag: float

    @property
    def ratio(self) -> float:
        """The delay that loses it over the margin."""
        return self.lost / self.margin


def swaying(robot: Robot, delay: float) -> Loop:
    """PD at rest, or along a line, from a small offset, its commands late by a delay [s]."""
    timing, d = Timing(SECONDS, 0.002, STEP, integrator="implicit_friction"), robot.dimensions
    arm = tuple(Hold(value) for value in robot.neutral_position()[robot.arm_index])
    controller = suited(
        PD(Feedback(base=60.0, arm=60.0, scaling="inertia")), robot, lambda: LoopToSuit(Kinematic(), 0.002)
    )
    start = Start(pose_offset=(OFFSET,) * 3, joint_offset=OFFSET)
    kinematic = Kinematic(kx=3.0, ky=16.0, kth=8.0, K=5.0)
    line = Trajectory(Line(speed=0.3) if d.base else None, arm)
    return Loop(robot, line, controller, kinematic, timing, start, latency=Latency(command=delay), check_gains=False)


def variation(loop: Loop) -> tuple[float, float]:
    """How far `[z; r]` vary in the last second, inf where the run is lost; and how far the joints are off."""
    run = loop.run()
    if run.outcome.status != "completed":
        return np.inf, np.inf
    late = run.time > SECONDS - 1.0
    errors = np.hstack([run[name].reshape(len(run), -1) for name in ("z", "r") if name in run])[late]
    return float(np.abs(errors - errors.mean(axis=0)).max() + 0.01 * OFFSET), float(np.abs(run["e"][late]).max())


def study(name: str, low: float = 0.5, high: float = 2.0) -> Found:
    """Bisect between two shares of the margin; the robot has to bear the lower and to be lost at the higher."""
    robot = load(name)
    margin = swaying(robot, 0.0).delay_margin()
    rest, sag = variation(swaying(robot, 0.0))
    borne, lost = int(low * margin / STEP), int(np.ceil(high * margin / STEP))

    def is_lost(steps: int) -> bool:
        return variation(swaying(robot, steps * STEP))[0] > TENFOLD * rest

    if is_lost(borne) or not is_lost(lost):
        return Found(name, margin, np.nan, sag)
    while lost - borne > 1:
        middle = (lost + borne) // 2
        borne, lost = (borne, middle) if is_lost(middle) else (middle, lost)
    return Found(name, margin, (lost - 0.5) * STEP, sag)


def main(arguments: Sequence[str] | None = None) -> None:
    """Parse the command line, bisect, print."""
    parser = argparse.ArgumentParser(prog="python -m research.studies.delay", description=__doc__)
    parser.add_argument("robots", nargs="*", default=FIVE)
    rows = []
    for name in parser.parse_args(arguments).robots:
        one = study(name)
        rows.append(row_of(name, *(number(x) for x in (1e3 * one.margin, 1e3 * one.lost, one.ratio, one.sag))))
    heads = (
        Column(text=True),
        Column("margin\n", "ms"),
        Column("lost at\n", "ms"),
        Column("ratio\n", ""),
        Column("off\n", "rad"),
    )
    print(terminal_text([Table("delay", heads, tuple(rows))], False, 120))


if __name__ == "__main__":
    main()

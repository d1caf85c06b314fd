"""How long one control sample takes where it must be in time, and whether garbage is collected in it.

    python benchmarks/cycle.py                        100,000 samples of four controllers, some minutes
    python benchmarks/cycle.py --samples 2000 --json

The closed loop of `examples/udp/task.toml` at 200 Hz: `Stepper.step` is timed, the ideal plant between two samples
is not. Wall clock and processor time of the thread, in us; a collection counts when it began inside a step.
"""

from __future__ import annotations

import argparse
import gc
import json
import os
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from mmnn_pin import Loop, Stepper, load_experiment
from mmnn_pin.lab.experiments.experiment import Experiment
from mmnn_pin.plant.ideal import IdealPlant
from mmnn_pin.reference.wishes import BaseVelocity, JointGoal
from mmnn_pin.signals import Measurement, Setpoint

TASK = Path(__file__).parents[1] / "examples/udp/task.toml"
CONTROLLERS = ("two_layer", "one_layer", "pd", "computed_torque")
PERIOD = 0.005  # [s]


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--samples", type=int, default=100_000)
    parser.add_argument("--json", action="store_true")
    given = parser.parse_args()
    times = f"time.duration={given.samples * PERIOD!r}", f"time.plant_step={PERIOD}"
    experiment = load_experiment(TASK, [*times, "weights_interval=1e9"])
    load = os.getloadavg()[0]
    asked = [(name, "motion") for name in CONTROLLERS] + [
        ("two_layer", kind) for kind in ("samples", "velocity and goals")
    ]
    found = {f"{name}, {kind}": measure(experiment, name, kind) for name, kind in asked}
    result = {"samples": given.samples, "us": found, "load_before_after": [load, os.getloadavg()[0]]}
    print(json.dumps(result) if given.json else table(result))


def wishes_of(kind: str, cycle: Stepper, loop: Loop) -> Callable[[int], Any]:
    """What comes with a sample: a motion at the start, full samples, or a velocity and now and then a joint goal."""
    if kind == "motion":
        motion = cycle.plan(loop.trajectory, loop.timing.duration)
        return lambda k: motion if k == 0 else None
    table = loop.table()
    if kind == "samples":
        return lambda k: Setpoint.side_by_side(table[k], loop.layout)
    goals = [JointGoal(np.full(loop.layout.arm, place)) for place in (0.3, -0.3)]
    drive = BaseVelocity((0.2, 0.1))
    return lambda k: (drive, goals[k // 1000 % 2]) if k % 1000 == 0 else drive if k % 20 == 0 else None


def measure(experiment: Experiment, name: str, kind: str) -> dict[str, Any]:
    """Times of all samples under one controller and a kind of setpoints, and what they left behind."""
    robot = experiment.load_robot()
    loop = experiment.loop(robot, experiment.controller(name, robot=robot))
    cycle, plant = Stepper.of(loop), IdealPlant(robot, PERIOD, experiment.time.integrator)
    plant.start(*loop.start.state(robot, loop.table()[0]))
    wishes = wishes_of(kind, cycle, loop)
    nb, arm = robot.dimensions.base, robot.arm_index
    measured = Measurement(plant.position[: robot.dimensions.pose], plant.nu[:nb], np.zeros(arm.size), plant.nu[nb:])
    wall, cpu = np.zeros(loop.timing.samples), np.zeros(loop.timing.samples)
    inside, began = [False], [0]
    collecting = lambda phase, _: began.append(1) if phase == "start" and inside[0] else None  # noqa: E731
    gc.collect()
    gc.callbacks.append(collecting)
    blocks = sys.getallocatedblocks()
    try:
        for k in range(loop.timing.samples):
            measured.q[:] = plant.position[arm]
            inside[0] = True
            start, start_cpu = time.perf_counter_ns(), time.thread_time_ns()
            tau = cycle.step(k * PERIOD, measured, wishes(k)).effort
            cpu[k], wall[k] = time.thread_time_ns() - start_cpu, time.perf_counter_ns() - start
            inside[0] = False
            plant.step(tau)
            plant.refresh()
            if cycle.tripped:
                raise RuntimeError(f"{name} tripped at t = {k * PERIOD:g} s")
    finally:
        gc.callbacks.remove(collecting)
    grown = sys.getallocatedblocks() - blocks
    shares = {"median": 50, "p99.9": 99.9, "max": 100}
    numbers = {f"wall {share}": np.percentile(wall, at) / 1e3 for share, at in shares.items()}
    numbers |= {f"cpu {share}": np.percentile(cpu, at) / 1e3 for share, at in shares.items()}
    return {**numbers, "collections": len(began) - 1, "blocks more": grown}


def table(result: dict[str, Any]) -> str:
    """The numbers as a Markdown table."""
    rows = result["us"]
    columns = list(next(iter(rows.values())))
    lines = [f"| us | {' | '.join(columns)} |", "|---|" + "---|" * len(columns)]
    for name, numbers in rows.items():
        lines.append(f"| {name} | {' | '.join(f'{numbers[column]:.4g}' for column in columns)} |")
    before, after = result["load_before_after"]
    about = f"{result['samples']:,} samples each; load average {before:.1f} before, {after:.1f} after"
    return "\n".join([*lines, about])


if __name__ == "__main__":
    main()

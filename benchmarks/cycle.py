"""How long one control sample takes where it must be in time, and whether garbage is collected in it.

    python benchmarks/cycle.py                        100,000 samples of four controllers, some minutes
    python benchmarks/cycle.py --samples 2000 --json

The closed loop of `examples/realtime/task.toml` at 200 Hz: `Stepper.step` is timed, the ideal plant between two samples
is not. Wall clock and processor time of the thread, in us; a collection counts when it began inside a step.
"""

from __future__ import annotations

import argparse
import gc
import json
import os
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np

from mmnn_pin import load_experiment
from mmnn_pin.lab.experiments.experiment import Experiment
from mmnn_pin.loop.stepper import Stepper
from mmnn_pin.plant.ideal import IdealPlant
from mmnn_pin.signals import Measurement

TASK = Path(__file__).parents[1] / "examples/realtime/task.toml"
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
    found = {name: measure(experiment, name) for name in CONTROLLERS}
    result = {"samples": given.samples, "us": found, "load_before_after": [load, os.getloadavg()[0]]}
    print(json.dumps(result) if given.json else table(result))


def measure(experiment: Experiment, name: str) -> dict[str, Any]:
    """Times of all samples under one controller, and what they left behind."""
    robot = experiment.load_robot()
    loop = experiment.loop(robot, experiment.controller(name, robot=robot))
    cycle, plant = Stepper(loop), IdealPlant(robot, PERIOD, experiment.time.integrator)
    plant.start(*loop.start.state(robot, cycle.table[0]))
    nb, arm = robot.dimensions.base, robot.arm_index
    measured = Measurement(plant.position[: robot.dimensions.pose], plant.nu[:nb], np.zeros(arm.size), plant.nu[nb:])
    wall, cpu = np.zeros(cycle.samples), np.zeros(cycle.samples)
    inside, began = [False], [0]
    collecting = lambda phase, _: began.append(1) if phase == "start" and inside[0] else None  # noqa: E731
    gc.collect()
    gc.callbacks.append(collecting)
    blocks = sys.getallocatedblocks()
    try:
        for k in range(cycle.samples):
            measured.q[:] = plant.position[arm]
            inside[0] = True
            start, start_cpu = time.perf_counter_ns(), time.thread_time_ns()
            tau = cycle.step(k * PERIOD, measured)
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

"""Sizes and instructions of exported controllers on an emulated Cortex-M7: `python benchmarks/embedded.py`.

    python benchmarks/embedded.py --robots platform_arm --controllers two_layer adaptive --steps 300

Code and constants are those of `arm-none-eabi-gcc -O2`. QEMU counts the instructions of every sample (40 at a time);
the stack is what is overwritten below the caller. Needs gcc-arm-none-eabi, libnewlib-arm-none-eabi and qemu-system-arm.
"""

from __future__ import annotations

import argparse
import tempfile
from pathlib import Path

import msgspec

from mmnn_pin import load_experiment
from mmnn_pin.deploy.embed import embed
from mmnn_pin.deploy.embed.export import supervised
from mmnn_pin.deploy.embed.instructions import counted

CONTROLLERS = (
    "pd", "computed_torque", "one_layer", "two_layer", "adaptive", "adaptive --no-diagnostics", "adaptive_composite",
    "kalman_regressor",
)  # fmt: skip
ROBOTS = ("platform_arm", "two_axis_arm", "tiago")


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--robots", nargs="+", default=ROBOTS)
    parser.add_argument("--controllers", nargs="+", default=CONTROLLERS)
    parser.add_argument("--steps", type=int, default=300)
    given = parser.parse_args()
    print("| robot | controller | code, constants | initial values | RAM | stack | instructions, mean / worst |")
    print("|---|---|---|---|---|---|---|")
    for robot in given.robots:
        experiment = msgspec.structs.replace(load_experiment("track"), robot=robot)
        loaded = experiment.load_robot()
        for name in given.controllers:
            controller, _, option = name.partition(" ")
            loop = supervised(experiment.loop(loaded, experiment.controller(controller, robot=loaded)))
            with tempfile.TemporaryDirectory() as made:
                folder = Path(made) / "c"
                told = embed(loop, folder, steps=given.steps, diagnostics=not option)
                mean, worst, stack, ram = counted(folder)
            code = ((told.code_bytes or 0) - told.initial_bytes) / 1000
            sizes = f"{code:.1f} | {told.initial_bytes / 1000:.1f} | {ram / 1000:.1f} | {stack / 1000:.1f}"
            print(f"| {robot} | `{name}` | {sizes} | {mean:,} / {worst:,} |", flush=True)


if __name__ == "__main__":
    main()

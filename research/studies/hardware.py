"""Robots of `mmnn list` on profiles of hardware: which run, and what the others are told.

    python -m research.studies.hardware [ROBOT ...] [--hardware NAME ...]

All of them are many: each is read, its motion made, its loop judged.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Iterator

from mmnn_pin import load, load_experiment
from mmnn_pin.errors import InputError
from mmnn_pin.lab.experiments.hardware import proposed
from mmnn_pin.lab.experiments.hardware_table import profiles
from mmnn_pin.lab.experiments.runner import require_runnable
from mmnn_pin.model.robots import bundled, extra


def judged(robot: str, hardware: str) -> str:
    """Why a robot on hardware is refused before it runs; empty where it runs."""
    try:
        changes = [f'robot="{robot}"', f'hardware="{hardware}"', "controllers=['computed_torque']"]
        experiment = load_experiment("track", changes)
        require_runnable(experiment, experiment.load_robot())
    except InputError as error:
        return str(error)
    return ""


def rows(robots: list[str], hardware: list[str]) -> Iterator[tuple[str, str, str, float]]:
    """Robot, hardware, why it is refused, and how long that took [s]."""
    for robot in robots:
        try:
            own = proposed(load(robot))
        except InputError as error:
            yield robot, "-", str(error), 0.0
            continue
        for name in hardware or [own]:
            began = time.perf_counter()
            yield robot, name, judged(robot, name), time.perf_counter() - began


def main() -> None:
    """Print the matrix."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("robots", nargs="*", help="default: all")
    parser.add_argument("--hardware", nargs="*", default=[], help="default: what mmnn inspect proposes; all for all")
    options = parser.parse_args()
    hardware = list(profiles()) if options.hardware == ["all"] else options.hardware
    counts = [0, 0]
    for robot, name, why, took in rows(options.robots or [*bundled(), *extra()], hardware):
        counts[bool(why)] += 1
        print(f"{robot:20} {name:16} {took:5.1f} s  {why or 'runs'}", flush=True)
    print(f"{counts[0]} run, {counts[1]} are refused")


if __name__ == "__main__":
    main()

"""Robots of `mmnn list` on profiles of hardware: which run, and what the others are told.

    python -m research.studies.hardware [ROBOT ...] [--hardware NAME ...]

A pair is read and checked as `mmnn run track` does it, then `pd` runs the first two seconds. What a refusal says is
done: the pair that its line names runs.
"""

from __future__ import annotations

import argparse
import re
import time
from collections.abc import Iterator
from dataclasses import replace
from functools import cache
from typing import NamedTuple

import msgspec

from mmnn_pin import load, load_experiment
from mmnn_pin.errors import InputError
from mmnn_pin.lab.experiments.hardware import proposed
from mmnn_pin.lab.experiments.hardware_table import profiles
from mmnn_pin.lab.experiments.runner import require_runnable
from mmnn_pin.model.robots import bundled, extra

SECONDS = 2.0  # of every run
NAMED = re.compile(r"--hardware ([\w-]+)")  # in a line that says what to do


class Verdict(NamedTuple):
    """What a pair came to.

    Attributes:
        runs: Whether it does.
        line: How it ended, or why it was refused.
        way_out: Hardware that the refusal names.
    """

    runs: bool
    line: str
    way_out: str = ""


@cache
def judged(robot: str, hardware: str) -> Verdict:
    """A robot on hardware."""
    try:
        experiment = load_experiment("track", [f'robot="{robot}"', f'hardware="{hardware}"', "controllers=['pd']"])
        true = experiment.load_robot()
        require_runnable(experiment, true)
    except InputError as error:
        named = NAMED.search(error.fix or "")
        return Verdict(False, str(error), named[1] if named else "")
    loop = experiment.loop(true, "pd")
    period = loop.timing.control_period
    short = msgspec.structs.replace(loop.timing, duration=round(SECONDS / period) * period)
    outcome = replace(loop, timing=short).run().outcome
    return Verdict(outcome.status == "completed", "runs" if outcome.status == "completed" else outcome.message)


def rows(robots: list[str], hardware: list[str]) -> Iterator[tuple[str, str, Verdict, str]]:
    """Robot, hardware, what they came to, and what following a refusal's line did."""
    for robot in robots:
        try:
            own = proposed(load(robot))
        except InputError as error:
            yield robot, "-", Verdict(False, str(error)), "no robot"
            continue
        for name in hardware or [own]:
            found = judged(robot, name)
            followed = judged(robot, found.way_out).runs if found.way_out else False
            yield robot, name, found, "" if found.runs else "followed: runs" if followed else "NO WAY OUT"


def main() -> None:
    """Print the matrix."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("robots", nargs="*", help="default: all")
    parser.add_argument("--hardware", nargs="*", default=[], help="default: what mmnn inspect proposes; all for all")
    options = parser.parse_args()
    hardware = list(profiles()) if options.hardware == ["all"] else options.hardware
    counts, began = dict[str, int](), time.perf_counter()
    for robot, name, found, followed in rows(options.robots or [*bundled(), *extra()], hardware):
        counts[followed or "run"] = counts.get(followed or "run", 0) + 1
        now = time.perf_counter()
        print(f"{robot:20} {name:16} {now - began:5.1f} s  {found.line} {followed}".rstrip(), flush=True)
        began = now
    print(", ".join(f"{count} {word}" for word, count in counts.items()))


if __name__ == "__main__":
    main()

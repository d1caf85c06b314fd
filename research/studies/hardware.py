"""Robots of `mmnn list` on profiles of hardware: which run, and what the others are told.

    python -m research.studies.hardware [ROBOT ...] [--hardware NAME ...]

A pair is read and checked as `mmnn run track` does it, then `pd` runs the first two seconds. What a refusal says is
done, until what its line names runs.
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
from mmnn_pin.lab.experiments.hardware_table import profiles, proposed
from mmnn_pin.lab.experiments.runner import require_runnable
from mmnn_pin.model.robots import bundled, extra

SECONDS = 2.0  # of every run
NAMED = re.compile(r"--hardware ([\w-]+)|--set '([^']+)'")  # in a line that says what to do
STEPS = 3  # lines that are followed at most, one after the other


class Verdict(NamedTuple):
    """What a pair came to.

    Attributes:
        runs: Whether it does.
        line: How it ended, or why it was refused.
        hardware: What the refusal names.
        setting: Likewise.
    """

    runs: bool
    line: str
    hardware: str = ""
    setting: str = ""


@cache
def judged(robot: str, hardware: str, *said: str) -> Verdict:
    """A robot on hardware, with settings."""
    try:
        changes = [f'robot="{robot}"', f'hardware="{hardware}"', "controllers=['pd']", *said]
        experiment = load_experiment("track", changes)
        true = experiment.load_robot()
        require_runnable(experiment, true)
    except InputError as error:
        named = NAMED.search(error.fix or "")
        return Verdict(False, str(error), *(text or "" for text in named.groups()) if named else ())
    loop = experiment.loop(true, "pd")
    period = loop.timing.control_period
    short = msgspec.structs.replace(loop.timing, duration=round(SECONDS / period) * period)
    outcome = replace(loop, timing=short, check_gains=False).run().outcome  # judged along the whole motion
    return Verdict(outcome.status == "completed", "runs" if outcome.status == "completed" else outcome.message)


def followed(robot: str, hardware: str) -> bool:
    """Whether a robot runs on hardware once what refusals say is done."""
    said = list[str]()
    for _ in range(STEPS):
        found = judged(robot, hardware, *said)
        if found.runs or not (found.hardware or found.setting):
            return found.runs
        hardware, said = found.hardware or hardware, [*said, found.setting] if found.setting else said
    return judged(robot, hardware, *said).runs


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
            way = "" if found.runs else "followed: runs" if followed(robot, name) else "NO WAY OUT"
            yield robot, name, found, way


def main() -> None:
    """Print the matrix."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("robots", nargs="*", help="default: all")
    parser.add_argument("--hardware", nargs="*", default=[], help="default: what mmnn inspect proposes; all for all")
    options = parser.parse_args()
    hardware = list(profiles()) if options.hardware == ["all"] else options.hardware
    counts, began = dict[str, int](), time.perf_counter()
    for robot, name, found, way in rows(options.robots or [*bundled(), *extra()], hardware):
        counts[way or "run"] = counts.get(way or "run", 0) + 1
        now = time.perf_counter()
        print(f"{robot:20} {name:16} {now - began:5.1f} s  {found.line} {way}".rstrip(), flush=True)
        began = now
    print(", ".join(f"{count} {word}" for word, count in counts.items()))


if __name__ == "__main__":
    main()

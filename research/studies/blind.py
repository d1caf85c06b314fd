"""How far robots go once their sensors are silent, until they are stopped: `python -m research.studies.blind`.

The task is `track`'s. Every controller runs with the supervisor as it is, and with a timeout of 0.5 s alone, as
ros2_controllers have it; what is told is of the true robot, from the last measurement to the trip.
"""

from __future__ import annotations

import argparse
import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from mmnn_pin import load_experiment
from mmnn_pin.lab.show.table import Column, Row, Table, number, row_of, terminal_text
from mmnn_pin.model import Robot, load
from mmnn_pin.recording.recording import Recording

ROBOTS = ("platform_arm", "panda", "swerve_arm")
HEADS = (("after\n", "ms"), ("base\n", "mm"), ("arm\n", "rad"), ("speed\n", "rad/s"))
SILENT, SECONDS = 0.5, 0.6  # when, and how long it is looked at [s]
STOPS = 2.0  # of the signal `safety`: from here on it stops


@dataclass(frozen=True)
class Window:
    """One run: time from the last measurement to the trip [s], how far it went [m, rad], and how fast it was [rad/s].

    Without a trip it is what it was at the end.
    """

    time: float
    base: float
    joint: float
    speed: float


def window(robot: Robot, controller: str, timeout: float | None, more: Sequence[str] = ()) -> Window:
    """A run whose sensors fall silent, unless more settings say otherwise."""
    lost = f'disturbances=[{{type="messages", fault="lost", start={SILENT}}}]'
    limits = "safety.stop_time=0.05" if timeout is None else f"safety.timeout={timeout}"
    experiment = load_experiment("track", overrides=[f"time.duration={SILENT + SECONDS}", lost, limits, *more])
    return measured(robot, experiment.loop(robot, controller).run())


def measured(robot: Robot, run: Recording) -> Window:
    """What is told of a run."""
    heard, stops = int(np.searchsorted(run.time, SILENT - 1e-9)) - 1, run["safety"].ravel() >= STOPS
    seen = int(np.argmax(stops)) if stops.any() else len(run) - 1
    step, nb = run["position"][seen] - run["position"][heard], robot.dimensions.base
    base = math.hypot(step[0], step[1]) if nb else 0.0
    joint, speed = (float(np.abs(array).max(initial=0.0)) for array in (step[robot.arm_index], run["nu"][seen, nb:]))
    return Window(float(run.time[seen] - run.time[heard]), base, joint, speed)


def table_of(robot: str, controllers: Sequence[str], more: Sequence[str]) -> Table:
    """What the controllers do on a robot."""
    model, rows = load(robot), list[Row]()
    columns = [Column(robot, text=True)]
    for group in ("as it is", "timeout = 0.5"):
        columns += [Column(head, unit, group) for head, unit in HEADS]
    for name in controllers:
        both = [window(model, name, timeout, more) for timeout in (None, 0.5)]
        cells = ((1e3 * one.time, 1e3 * one.base, one.joint, one.speed) for one in both)
        rows.append(row_of(name, *(number(value) for each in cells for value in each)))
    return Table(robot, tuple(columns), tuple(rows))


def main(arguments: list[str] | None = None) -> None:
    """Print a table for each robot."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--robots", nargs="+", default=ROBOTS)
    parser.add_argument("--controllers", nargs="+", default=("pd", "pd_gravity", "two_layer", "adaptive", "learned"))
    parser.add_argument("--set", nargs="+", default=[], help="settings, such as other disturbances")
    given = parser.parse_args(arguments)
    print(terminal_text([table_of(robot, given.controllers, given.set) for robot in given.robots], False, 120))


if __name__ == "__main__":
    main()

"""Processes of real ROS 2 on this machine: our node, a robot that knows nothing of this package, who asks for things.

`MMNN_ROS` names a folder with an environment per distribution that has rclpy and this package, each made by `MAKE`.
Transports and discovery are ROS 2's own defaults, but that nothing leaves the machine.
"""

from __future__ import annotations

import fcntl
import itertools
import json
import os
import re
import select
import signal
import subprocess
import tempfile
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from places import ROOT

HERE = Path(__file__).parent
LONG = 1500.0  # patience with a process on a busy machine, which may have to compile [s]
ENVIRONMENTS = Path(os.environ.get("MMNN_ROS", ROOT / "build/ros"))
MAKE = f"bash {HERE}/make_environment.sh {ENVIRONMENTS} {{}}"
MAIN = "import sys; from mmnn_pin.cli import main; sys.exit(main(sys.argv[1:]))"
SETTINGS = """/**:
  ros__parameters:
    robot: platform_arm
    rate: 100.0
    latency: 0.005
    end_after_trip: true
    set:
      feedback: {scaling: inertia, base: 10.0, arm: 10.0}
      kinematic: {kx: 2.0, ky: 16.0, kth: 8.0, K: 3.0}
      safety: {torque: urdf, joint_error: 0.5, timeout: 0.8, stop_time: 1.0}
    joint_states: {age: 0.3}
    odometry: {age: 0.3, at: [0.0, 0.0, 0.0]}
    path: {speed: 0.25}
    commands:
      diff_drive_controller: {type: TwistStamped}
      effort_controller: {joints: [arm_1_joint, arm_2_joint]}
"""


DOMAINS = itertools.cycle((os.getpid() + i) % 100 + 1 for i in range(100))


@contextmanager
def claimed() -> Iterator[int]:
    """A domain that is another for each test, and that no other process has claimed: nobody hears another's robot."""
    while True:
        number = next(DOMAINS)
        with (Path(tempfile.gettempdir()) / f"mmnn-ros-domain-{number}").open("a") as file:
            try:
                fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError:
                continue
            yield number
            return


def python_of(distribution: str) -> Path:
    """Python of a distribution; skips the test where it is not there."""
    found = ENVIRONMENTS / distribution / "bin/python"
    if not found.is_file():
        pytest.skip(f"no ROS 2 to test with: {MAKE.format(distribution)}")
    return found


def of_ros(distribution: str, domain: int) -> dict[str, str]:
    """Surroundings of a process of ROS 2."""
    own = {name: value for name, value in os.environ.items() if not name.startswith(("_ROS_", "LD_LIBRARY", "AMENT_"))}
    here = {"AMENT_PREFIX_PATH": str(ENVIRONMENTS / distribution), "PYTHONPATH": str(ROOT)}
    return own | here | {"ROS_DOMAIN_ID": str(domain), "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"}


def start(distribution: str, domain: int, script: str, *arguments: Any) -> subprocess.Popen[str]:
    """A process of ROS 2."""
    command = [str(python_of(distribution)), str(HERE / script), *map(str, arguments)]
    pipe = subprocess.PIPE
    return subprocess.Popen(command, env=of_ros(distribution, domain), stdout=pipe, stderr=pipe, text=True)


def mmnn(distribution: str, domain: int, *arguments: Any, cwd: Path = ROOT, **own: str) -> subprocess.Popen[str]:
    """`mmnn ros2` as a process, in a folder, in surroundings with some more of its own."""
    command = [str(python_of(distribution)), "-c", MAIN, "ros2", *map(str, arguments)]
    pipe, here = subprocess.PIPE, of_ros(distribution, domain) | own
    return subprocess.Popen(command, stdout=pipe, stderr=pipe, text=True, cwd=cwd, env=here)


def said(distribution: str, domain: int, *arguments: Any, **own: str) -> tuple[int, str]:
    """Exit code and lines of `mmnn ros2` that ends by itself, in surroundings with some more of its own."""
    node = mmnn(distribution, domain, *arguments, **own)
    out, err = node.communicate(timeout=LONG)
    return node.returncode, out + err


@dataclass
class Drive:
    """What came of a run: exit code, lines of our node, what the robot tells."""

    code: int
    lines: str
    robot: dict[str, Any] = field(default_factory=dict)

    @property
    def rows(self) -> np.ndarray:
        """(N, 14) time since the first command, pose, v, w, q, qdot: the truth; (v, w) and efforts that it is told."""
        return np.array(self.robot["rows"])

    @property
    def commands(self) -> np.ndarray:
        """(N, 4) when the robot heard a base velocity, its stamp, and (v, w), of all that reached it."""
        return np.array(self.robot["commands"]).reshape(-1, 4)

    def at(self, time: float) -> np.ndarray:
        """The row of a time."""
        return self.rows[min(np.searchsorted(self.rows[:, 0], time), len(self.rows) - 1)]

    @property
    def trip(self) -> float:
        """When it tripped, by its line [s]."""
        found = re.search(r"(?:tripped|stopped from outside) at t = ([\d.]+) s", self.lines)
        return float(found[1]) if found else float("nan")


def drive(
    folder: Path,
    distribution: str,
    domain: int,
    *faults: str,
    seconds: float = 6.0,
    robot_domain: int | None = None,
    wait: float = 30.0,
    changes: tuple[str, ...] = (),
    planner: str = "",
    text: str = SETTINGS,
    when_it_drives: Callable[[subprocess.Popen[str]], None] | None = None,
) -> Drive:
    """Drive the robot of `robot_node.py` through its faults, with changed parameters; do something when it drives.

    The node is stopped by Ctrl-C when the planner has ended, the robot when the node has.
    """
    settings = folder / "robot.yaml"
    settings.write_text(text)
    there = domain if robot_domain is None else robot_domain
    robot = start(distribution, there, "robot_node.py", LONG, *faults)
    options = [part for change in changes for part in ("-p", change)]
    own = ["--seconds", seconds, "--wait", wait, "--out", folder / "run.h5", "--force"]
    remapped = ["-r", "diff_drive_controller/odom:=odom"]
    node = mmnn(distribution, domain, settings, *own, "--ros-args", *remapped, *options)
    others = [start(distribution, domain, planner)] if planner else []
    plans, pool = list[str](), ThreadPoolExecutor(1)
    lines = pool.submit(node.communicate, timeout=LONG)  # a pipe that nobody reads stops who writes
    try:
        if when_it_drives is not None:
            while node.poll() is None and not select.select([robot.stdout], [], [], 0.1)[0]:
                pass
            when_it_drives(node)
        for one in others:
            while one.poll() is None and node.poll() is None:
                time.sleep(0.05)
            node.send_signal(signal.SIGINT)
            if one.poll() is not None:
                plan, complaint = one.communicate()
                assert plan, complaint
                plans.append(plan)
        out, err = lines.result()
        robot.send_signal(signal.SIGTERM)
        told, _ = robot.communicate(timeout=LONG) if robot_domain is None and node.returncode != 2 else ("", "")
    finally:
        for one in (node, robot, *others):
            one.kill()
    last = [line for line in told.splitlines() if line.startswith("{")] or ["{}"]
    made = Drive(node.returncode, out + err, json.loads(last[0]))
    made.robot |= {"planner": json.loads(plans[0])} if plans else {}
    return made

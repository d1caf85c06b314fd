"""Two processes on the loopback: our node, and a robot of real ROS 2 (rclpy) from an environment of its own.

`MMNN_ROS` names a folder with an environment per distribution, each made by `make`.
"""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from places import ROOT

HERE = Path(__file__).parent
ENVIRONMENTS = Path(os.environ.get("MMNN_ROS", ROOT / "build/ros"))
PACKAGES = ("sensor-msgs", "nav-msgs", "geometry-msgs", "trajectory-msgs", "diagnostic-msgs", "std-srvs")
MAKE = "python3.11 -m venv {0}; {0}/bin/pip install 'ros-{1}-rclpy[fastrtps]' " + " ".join(
    f"ros-{{1}}-{name}" for name in PACKAGES
)
MAIN = "import sys; from mmnn_pin.cli import main; sys.exit(main(sys.argv[1:]))"
SETTINGS = """robot = "platform_arm"
rate = 100.0
latency = 0.005
[set]
feedback = {{ scaling = "inertia", base = 10.0, arm = 10.0 }}
kinematic = {{ kx = 2.0, ky = 16.0, kth = 8.0, K = 3.0 }}
safety = {{ torque = "urdf", joint_error = 0.5, timeout = 0.8, stop_time = 1.0 }}
[network]
domain = {domain}
[joint_states]
age = 0.3
reliability = "{reliability}"
[odometry]
age = 0.3
at = [0.0, 0.0, 0.0]
[velocity]
topic = "/cmd_vel"
[trajectory]
topic = "/mmnn/joint_trajectory"
[action]
name = "/mmnn/follow_joint_trajectory"
[[commands]]
topic = "/diff_drive_controller/cmd_vel"
type = "TwistStamped"
[[commands]]
topic = "/effort_controller/commands"
joints = ["arm_1_joint", "arm_2_joint"]
"""


def python_of(distribution: str) -> Path:
    """Python of a distribution; skips the test where it is not there."""
    found = ENVIRONMENTS / distribution / "bin/python"
    if not found.is_file():
        pytest.skip(f"no ROS 2 to test against: {MAKE.format(ENVIRONMENTS / distribution, distribution)}")
    return found


def of_ros(distribution: str, domain: int) -> dict[str, str]:
    """Surroundings of a process of ROS 2 that speaks on the loopback only."""
    here = ENVIRONMENTS / distribution
    own = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}
    built = ENVIRONMENTS / f"control_msgs_{distribution}"  # of `make_control_msgs.sh`; there are no wheels of it
    own |= {"AMENT_PREFIX_PATH": f"{here}:{built}", "LD_LIBRARY_PATH": f"{here}/lib:{built}/lib"}
    own |= {"PYTHONPATH": f"{built}/lib/python3.11/site-packages", "ROS_DOMAIN_ID": str(domain)}
    profile = str(HERE / "loopback.xml")
    own |= {"FASTRTPS_DEFAULT_PROFILES_FILE": profile, "FASTDDS_DEFAULT_PROFILES_FILE": profile}
    return own | {"ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST", "RMW_IMPLEMENTATION": "rmw_fastrtps_cpp"}


def start(distribution: str, domain: int, script: str, *arguments: Any) -> subprocess.Popen[str]:
    """A process of ROS 2."""
    command = [str(python_of(distribution)), str(HERE / script), *map(str, arguments)]
    pipe = subprocess.PIPE
    return subprocess.Popen(command, env=of_ros(distribution, domain), stdout=pipe, stderr=pipe, text=True)


def require_control_msgs(distribution: str) -> None:
    """Skips the test where the messages of the action are not there."""
    python_of(distribution)
    if not (ENVIRONMENTS / f"control_msgs_{distribution}/lib").is_dir():
        pytest.skip(f"no control_msgs: bash {HERE}/make_control_msgs.sh {ENVIRONMENTS} {distribution}")


def own_node(settings: Path, out: Path, *options: Any) -> subprocess.Popen[str]:
    """`mmnn ros2` as a process."""
    command = [sys.executable, "-c", MAIN, "ros2", str(settings), "--out", str(out), "--force", *map(str, options)]
    return subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, cwd=ROOT)


@dataclass
class Drive:
    """What came of a run: exit code, lines of our node, what the robot tells."""

    code: int
    lines: str
    robot: dict[str, Any] = field(default_factory=dict)

    @property
    def rows(self) -> np.ndarray:
        """(N, 12) time since the first command, pose, v, w, q, qdot: the truth; the (v, w) that is commanded."""
        return np.array(self.robot["rows"])

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
    reliability: str = "best_effort",
    robot_domain: int | None = None,
    wait: float = 30.0,
    changes: tuple[str, ...] = (),
    planner: str = "",
    text: str = SETTINGS,
) -> Drive:
    """Drive the robot of `robot_node.py` through its faults."""
    settings = folder / "robot.toml"
    settings.write_text(text.format(domain=domain, reliability=reliability))
    robot = start(
        distribution, domain if robot_domain is None else robot_domain, "robot_node.py", seconds + 1.5, *faults
    )
    options = [part for change in changes for part in ("--set", change)]
    node = own_node(settings, folder / "run.h5", "--seconds", seconds, "--wait", wait, *options)
    others = [start(distribution, domain, planner)] if planner else []
    try:
        out, err = node.communicate(timeout=300)
        told, _ = robot.communicate(timeout=60) if robot_domain is None and node.returncode != 2 else ("", "")
    finally:
        for one in (node, robot, *others):
            one.kill()
    plans = [one.communicate()[0] for one in others]
    last = told.strip().splitlines()[-1:] or ["{}"]
    made = Drive(node.returncode, out + err, json.loads(last[0]))
    made.robot |= {"planner": json.loads(plans[0])} if plans and plans[0] else {}
    return made

"""A base under a joystick while the arm follows a trajectory, over ROS 2, on a robot that MuJoCo is; PD and a learner.

    python examples/robot/run.py [--seconds 30] [--controllers pd two_layer]

It starts `robot.py` and `mmnn ros2 robot.toml` as processes and plays joystick and planner itself: three participants
of one ROS 2 graph on the loopback. `ros2 topic list` shows it where ROS 2 is installed (ROS_DOMAIN_ID=42).
"""

import argparse
import math
import subprocess
import sys
import time
from pathlib import Path

import numpy as np

from mmnn_pin.deploy.ros2 import messages as msg
from mmnn_pin.deploy.ros2.link import Inlet, Link, Outlet
from mmnn_pin.deploy.ros2.settings import Network, Topic
from mmnn_pin.recording.recording import Recording

HERE = Path(__file__).parent
DOMAIN, SETTLED = 42, 5.0  # [s] after which errors count
NODE = "import sys; from mmnn_pin.cli import main; sys.exit(main(sys.argv[1:]))"


def arm_motion(seconds):
    """What a planner sends: points every quarter of a second, from rest to rest."""
    points = []
    for t in np.arange(1.0, seconds, 0.25):
        share = math.sin(math.pi * min(t / seconds, 1.0)) ** 2  # from rest to rest
        q = share * 0.7 * math.sin(0.9 * t), share * 0.5 * math.sin(1.4 * t + 1.0)
        points.append(msg.JointTrajectoryPoint(list(q), [], [], [], msg.Duration(int(t), int(1e9 * (t % 1)))))
    return msg.JointTrajectory(msg.Header(msg.Time()), ["arm_1_joint", "arm_2_joint"], points)


def drive(controller, seconds, out):
    """One run; its recording, or None where the node failed."""
    robot = subprocess.Popen([sys.executable, str(HERE / "robot.py"), "--domain", str(DOMAIN)])
    asked = [
        "--seconds",
        str(seconds),
        "--wait",
        "30",
        "--set",
        f"controller={controller}",
        "--out",
        str(out),
        "--force",
    ]
    node = subprocess.Popen([sys.executable, "-P", "-c", NODE, "ros2", str(HERE / "robot.toml"), *asked])
    link = Link(Network(domain=DOMAIN))
    joystick = Outlet(link, "/cmd_vel", msg.Twist, Topic("/cmd_vel", "reliable"))
    planner = Outlet(link, "/mmnn/joint_trajectory", msg.JointTrajectory, Topic("/plan", "reliable"))
    efforts = Inlet(link, "/effort_controller/commands", msg.Float64MultiArray, Topic("/commands"))
    begun = None
    while node.poll() is None:
        now = time.monotonic()
        if begun is None and efforts.newest(now) is not None:
            begun = now
            planner.send(arm_motion(seconds - 3.0))
        if begun is not None:
            t = now - begun
            joystick.send(msg.Twist(msg.Vector3(0.25 * math.sin(0.5 * t)), msg.Vector3(z=0.5 * math.sin(0.9 * t))))
        time.sleep(0.05)
    robot.terminate()
    robot.wait()
    link.close()
    return Recording.open(out) if node.returncode == 0 else None


def main():
    """Drive with every controller, and print the errors."""
    options = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    options.add_argument("--seconds", type=float, default=30.0)
    options.add_argument("--controllers", nargs="+", default=["pd", "two_layer"])
    options.add_argument("--out", type=Path, default=Path("runs/robot"))
    options = options.parse_args()
    rows, failed = [], False
    for controller in options.controllers:
        run = drive(controller, options.seconds, options.out / f"{controller}.h5")
        if run is None:
            failed = True
            continue
        counted = run["time"].ravel() > SETTLED
        rows.append((controller, 1e3 * np.sqrt((run["e"][counted] ** 2).mean(axis=0)), run["z"][counted]))
    print(f"\n{'':22}arm_1 [mrad]  arm_2 [mrad]  base v [mm/s]  base w [mrad/s]   RMS after {SETTLED:g} s")
    for controller, e, z in rows:
        v, w = 1e3 * np.sqrt((z**2).mean(axis=0))
        print(f"{controller:22}{e[0]:12.2f}{e[1]:14.2f}{v:15.1f}{w:17.1f}")
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())

"""How punctual `mmnn ros2` is at 500 Hz, with a robot in another process and bare loops beside it.

    python benchmarks/ros2.py [--rate 500] [--seconds 60] [--priority 50]        with rclpy and MuJoCo

The robot is MuJoCo in a process of its own (examples/robot/robot.py), which tells how long after a measurement the next
command came. One bare loop only sleeps, one is rclpy's: it reads
and sends what the node does. A cycle is late that starts after its successor's tick, so that a tick is skipped.
"""

import argparse
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

from mmnn_pin.recording.recording import Recording

ROBOT = Path(__file__).parent.parent / "examples/robot"
NODE = "import sys; from mmnn_pin.cli import main; sys.exit(main(sys.argv[1:]))"
BARE = """import sys, time
period, seconds, work = float(sys.argv[1]), float(sys.argv[2]), lambda: None
if sys.argv[3] == "rclpy":
    import rclpy
    from geometry_msgs.msg import TwistStamped
    from nav_msgs.msg import Odometry
    from sensor_msgs.msg import JointState
    from std_msgs.msg import Float64MultiArray
    rclpy.init()
    node = rclpy.create_node("bare")
    topics = (JointState, "/joint_states"), (Odometry, "/diff_drive_controller/odom")
    inlets = [(node.create_subscription(kind, name, print, 1).handle, kind) for kind, name in topics]
    messages = TwistStamped(), Float64MultiArray(data=[0.0, 0.0])
    outlets = [(node.create_publisher(type(one), f"bare/outlet_{i}", 1), one) for i, one in enumerate(messages)]
    def work():
        for handle, kind in inlets:
            with handle:
                handle.take_message(kind, False)
        for publisher, message in outlets:
            publisher.publish(message)
start = time.monotonic()
count = skipped = tick = 0
late = []
while time.monotonic() < start + seconds:
    passed = int((time.monotonic() - start) / period)
    if passed > tick:
        skipped, tick = skipped + passed - tick, passed
    time.sleep(max(0.0, start + tick * period - time.monotonic()))
    late.append(time.monotonic() - start - tick * period)
    work()
    count, tick = count + 1, tick + 1
print(count, skipped, sorted(late)[count // 2], max(late), flush=True)
import os
os._exit(0)
"""


def main():
    """Run both, and print what share of the ticks was missed."""
    options = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    options.add_argument("--rate", type=float, default=500.0)
    options.add_argument("--seconds", type=float, default=60.0)
    options.add_argument("--controller", default="pd")
    options.add_argument("--priority", type=int, default=50, help="thread_priority of the node")
    options = options.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        out, python = Path(folder) / "run.h5", sys.executable
        robot = subprocess.Popen([python, str(ROBOT / "robot.py"), "--rate", str(options.rate)])
        changes = ["--ros-args", "-p", f"rate:={options.rate}", "-p", f"controller:={options.controller}"]
        changes += ["-p", f"thread_priority:={options.priority}"]
        asked = ["--seconds", str(options.seconds), "--wait", "60", "--out", str(out)]
        node = subprocess.Popen([python, "-c", NODE, "ros2", str(ROBOT / "robot.yaml"), *asked, *changes])
        while not out.exists() and node.poll() is None:
            time.sleep(0.2)
        time.sleep(3.0)
        command = [python, "-c", BARE, str(1 / options.rate), str(options.seconds - 5.0)]
        pipe = {"stdout": subprocess.PIPE, "text": True}
        loops = {name: subprocess.Popen([*command, name], **pipe) for name in ("bare", "rclpy")}
        bare = {name: tuple(map(float, one.communicate()[0].split())) for name, one in loops.items()}
        node.wait()
        robot.send_signal(signal.SIGTERM)
        robot.wait()
        if node.returncode:
            return node.returncode
        late = Recording.open(out).final["late"]
        steps = Recording.open(out).step_times
    missed = round(options.seconds * options.rate) - len(late)
    rows = {
        "node": (len(late), missed, np.nanmedian(late), np.nanmax(late)),
        "bare loop": bare["bare"],
        "bare rclpy": bare["rclpy"],
    }
    print(f"\n{'':10}  cycles       late   median after its tick    worst")
    for name, (count, skipped, median, worst) in rows.items():
        share = 100.0 * skipped / (count + skipped)
        print(f"{name:10}{count:8,.0f}   {share:6.3f} %   {1e6 * median:18.0f} us  {1e3 * worst:6.1f} ms")
    middle, tail = 1e6 * np.percentile(steps, (50, 99))
    print(f"step of the controller: median {middle:.0f} us, 99 % within {tail:.0f} us")
    return 0


if __name__ == "__main__":
    sys.exit(main())

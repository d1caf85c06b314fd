"""How punctual `mmnn ros2` is: 500 Hz with a robot in another process, and a bare loop that only sleeps beside it.

    python benchmarks/ros2.py [--rate 500] [--seconds 60]        with rclpy and MuJoCo

The robot is MuJoCo in a process of its own (examples/robot/robot.py), which tells how long after a measurement the next
command came. A cycle is late that starts after its successor's tick, so that a tick is skipped.
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
period, seconds, start = float(sys.argv[1]), float(sys.argv[2]), time.monotonic()
count = skipped = tick = 0
late = []
while time.monotonic() < start + seconds:
    passed = int((time.monotonic() - start) / period)
    if passed > tick:
        skipped, tick = skipped + passed - tick, passed
    time.sleep(max(0.0, start + tick * period - time.monotonic()))
    late.append(time.monotonic() - start - tick * period)
    count, tick = count + 1, tick + 1
print(count, skipped, sorted(late)[count // 2], max(late))
"""


def main():
    """Run both, and print what share of the ticks was missed."""
    options = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    options.add_argument("--rate", type=float, default=500.0)
    options.add_argument("--seconds", type=float, default=60.0)
    options.add_argument("--controller", default="pd")
    options = options.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        out, python = Path(folder) / "run.h5", sys.executable
        robot = subprocess.Popen([python, str(ROBOT / "robot.py"), "--rate", str(options.rate)])
        changes = ["--ros-args", "-p", f"rate:={options.rate}", "-p", f"controller:={options.controller}"]
        asked = ["--seconds", str(options.seconds), "--wait", "60", "--out", str(out)]
        node = subprocess.Popen([python, "-c", NODE, "ros2", str(ROBOT / "robot.yaml"), *asked, *changes])
        while not out.exists() and node.poll() is None:
            time.sleep(0.2)
        time.sleep(3.0)
        command = [python, "-c", BARE, str(1 / options.rate), str(options.seconds - 5.0)]
        bare = subprocess.run(command, capture_output=True, text=True, check=True).stdout.split()
        node.wait()
        robot.send_signal(signal.SIGTERM)
        robot.wait()
        if node.returncode:
            return node.returncode
        late = Recording.open(out).final["late"]
        steps = Recording.open(out).step_times
    missed = round(options.seconds * options.rate) - len(late)
    rows = {"node": (len(late), missed, np.nanmedian(late), np.nanmax(late)), "bare loop": tuple(map(float, bare))}
    print(f"\n{'':10}  cycles       late   median after its tick    worst")
    for name, (count, skipped, median, worst) in rows.items():
        share = 100.0 * skipped / (count + skipped)
        print(f"{name:10}{count:8,.0f}   {share:6.3f} %   {1e6 * median:18.0f} us  {1e3 * worst:6.1f} ms")
    middle, tail = 1e6 * np.percentile(steps, (50, 99))
    print(f"step of the controller: median {middle:.0f} us, 99 % within {tail:.0f} us")
    return 0


if __name__ == "__main__":
    sys.exit(main())

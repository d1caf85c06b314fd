"""Ten minutes of a seven-joint arm at 1 kHz through `mmnn identify`: how long it takes, and how much memory.

python -m research.studies.long_log --robot panda
"""

from __future__ import annotations

import argparse
import resource
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from mmnn_pin import load
from mmnn_pin.cli import main as mmnn
from mmnn_pin.model.regressor import Regressor
from mmnn_pin.model.robot import Robot
from mmnn_pin.model.tree.body import parameters
from research.studies.damaged_logs import sines

RATE, FREQUENCIES = 1000.0, 2 * np.pi * np.array([0.07, 0.13, 0.29, 0.41])


def write_log(robot: Robot, seconds: float, path: Path) -> None:
    """A CSV of sines of every joint, with friction that the file lacks and 1 % of noise on the efforts."""
    t, n, rng = np.arange(0.0, seconds, 1 / RATE), robot.dimensions.arm, np.random.default_rng(0)
    x, v, a = sines(t, FREQUENCIES, n, rng, 0.6, 3)
    x += (robot.lower + robot.upper)[robot.arm_index] / 2
    regressor, theta = Regressor.of(robot), parameters(robot)
    parts = [slice(i, i + 20000) for i in range(0, len(t), 20000)]
    u = np.vstack([regressor.along(x[part], v[part], a[part]) @ theta for part in parts])
    u += 0.3 * v + 0.2 * np.tanh(v / 0.01)
    u += 0.01 * u.std(axis=0) * rng.standard_normal(u.shape)
    header = ["time", *(f"{kind}.{name}" for kind in ("position", "velocity", "effort") for name in robot.joint_names)]
    np.savetxt(path, np.column_stack((t, x, v, u)), "%.7g", ",", header=",".join(header), comments="")


def main(args: Sequence[str] | None = None) -> int:
    """The command's own output, then processor time, wall time and peak memory."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--robot", default="panda")
    parser.add_argument("--seconds", type=float, default=600.0)
    how = parser.parse_args(args)
    with tempfile.TemporaryDirectory() as folder:
        log = Path(folder) / "log.csv"
        write_log(load(how.robot), how.seconds, log)
        size, began, used = log.stat().st_size / 1e6, time.monotonic(), time.process_time()
        code = mmnn(["identify", str(log), "--robot", how.robot, "--out", str(Path(folder) / "found")])
        spent, wall = time.process_time() - used, time.monotonic() - began
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    print(f"{size:.0f} MB, {spent:.0f} s of processor time, {wall:.0f} s of wall time, at most {peak:.0f} MB of memory")
    return code


if __name__ == "__main__":
    raise SystemExit(main())

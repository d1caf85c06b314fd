"""Wheels of a real robot from its own drives: radii, ratio and track against motion capture, judged on other drives.

    git clone --depth 1 https://github.com/sousarbarb/optiodom      # MIT, 100 MB
    python benchmarks/odometry.py optiodom [--json]

The data (Sousa, Petry, Costa, Moreira 2022, "OptiOdom: a generic approach for odometry calibration of wheeled mobile
robots", J. Intelligent & Robotic Systems 105) are ticks of both wheels every 50 ms and poses of OptiTrack: squares,
circles, and drives by hand. Of each kind of path the first half of the recordings is fitted, and the rest predicted,
each drive from its first pose, with the track and the radii of the data sheet and with those that were found.
"""

from __future__ import annotations

import argparse
import csv
import json
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from mmnn_pin import load
from mmnn_pin.deploy.identify.log import Log
from mmnn_pin.deploy.identify.odometry import NAMES, Wheels, driven, has_reference, seen, stretches, wheel_findings
from mmnn_pin.deploy.identify.quality import sound
from mmnn_pin.model.robot import Robot
from mmnn_pin.signals import Array

KINDS = ("square", "circular", "free")
LINK = '<link name="{}"><inertial><mass value="{}"/><inertia ixx="0.01" iyy="0.01" izz="0.01" ixy="0" ixz="0" iyz="0"/>'
WHEEL = '<collision><origin rpy="1.5708 0 0"/><geometry><cylinder radius="{}" length="0.02"/></geometry></collision>'
JOINT = (
    '<joint name="{0}_wheel_joint" type="continuous"><parent link="base"/><child link="{0}"/>'
    '<origin xyz="0 {1} {2}"/><axis xyz="0 1 0"/></joint>'
)


def robot_of(about: dict[str, list[float]]) -> Robot:
    """The base of a data sheet: diameters `Di` and track `Li` [m]."""
    radius, half = about["Di"][0] / 2, about["Li"][0] / 2
    parts = [LINK.format("base", 5.0) + "</inertial></link>"]
    for side, y in (("left", half), ("right", -half)):
        parts += [LINK.format(side, 0.2) + f"</inertial>{WHEEL.format(radius)}</link>", JOINT.format(side, y, radius)]
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "robot.urdf"
        file.write_text(f'<robot name="optiodom">{"".join(parts)}</robot>')
        return load(file, base="differential_drive", wheels=("left_wheel_joint", "right_wheel_joint"))


def about_of(recording: Path) -> dict[str, list[float]]:
    """Numbers of a recording's data sheet by name."""
    with (recording / f"{recording.name}_metadata.csv").open(encoding="utf-8-sig") as file:
        rows = [(row[0].strip(), [cell for cell in row[1:] if cell.strip()]) for row in csv.reader(file) if row]
    return {name: [float(cell) for cell in cells] for name, cells in rows if name != "type"}


def logs_of(recording: Path, about: dict[str, list[float]]) -> Iterator[Log]:
    """Its drives: time, pose, ticks of the right and of the left wheel since the row before."""
    turn = 2 * np.pi / (about["ngear"][0] * about["encRes"][0])
    for file in sorted(recording.glob(f"{recording.name}_run-??.csv")):
        table = np.loadtxt(file, delimiter=",", encoding="utf-8-sig")
        right, left = np.cumsum(table[:, 4:6], axis=0).T * turn
        position = {"left_wheel_joint": left, "right_wheel_joint": right}
        pose = dict(zip(("x", "y", "phi"), table[:, 1:4].T, strict=True))
        yield Log.of(table[:, 0], position, {}, reference=pose, name=file.stem)


def ends(robot: Robot, logs: list[Log], numbers: Array, found: Wheels) -> Array:
    """Distance from the reference at the end of every drive, over its length, (drives,)."""
    errors = []
    for log in logs:
        for one in stretches(log, robot, len(log.time)):
            way = float(np.linalg.norm(np.diff(one.pose[:, :2], axis=0), axis=1).sum())
            if way < 1.0:
                continue
            turned = one.pose[0, 2] - found.marker[2]
            c, s = np.cos(turned), np.sin(turned)
            begin = np.array([*(one.pose[0, :2] - np.array([[c, -s], [s, c]]) @ found.marker[:2]), turned])
            made = seen(driven(one, numbers, begin, found.late[0]), found.marker)
            errors.append(float(np.linalg.norm(made[-1, :2] - one.pose[-1, :2])) / way)
    return np.array(errors)


def judged(folder: Path) -> Iterator[dict[str, Any]]:
    """What is found of each kind of path, and how well it predicts the drives that were not fitted."""
    for kind in KINDS:
        recordings = sorted(one for one in (folder / "data" / "diff" / kind).iterdir() if one.is_dir())
        about = [about_of(one) for one in recordings]
        robot = robot_of(about[0])
        drives = [[sound(log, robot) for log in logs_of(*pair)] for pair in zip(recordings, about, strict=True)]
        half = (len(drives) + 1) // 2
        fitted, others = ([log for some in part for log in some] for part in (drives[:half], drives[half:]))
        assert all(has_reference(log, robot) for log in fitted)
        found, told = wheel_findings(robot, fitted)
        row: dict[str, Any] = {"path": kind, "fitted": len(fitted), "told": [str(one) for one in told]}
        if found is not None:
            before, after = (ends(robot, others, numbers, found) for numbers in (found.urdf, found.value))
            row |= {"predicted": len(before), "end_before": float(before.mean()), "end_after": float(after.mean())}
            row |= found.to_dict() | {"late": found.late, "marker": found.marker.tolist()}
        yield row


def main() -> None:
    """Print a line for each kind of path, or JSON."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--json", action="store_true")
    given = parser.parse_args()
    for row in judged(given.folder):
        if given.json:
            print(json.dumps(row), flush=True)
            continue
        print(f"{row['path']}: {row['fitted']} drives fitted")
        for name in NAMES if "track" in row else ():
            print(f"  {name} {1e3 * row[name]['value']:.3f} +- {1.96e3 * row[name]['sd']:.3f} mm")
        if "track" in row:
            before, after = (f"{100 * row[name]:.2f} %" for name in ("end_before", "end_after"))
            print(f"  at the end of {row['predicted']} other drives {before} of the way off, then {after}")
        print(*(f"  {one}" for one in row["told"]), sep="\n", flush=True)


if __name__ == "__main__":
    main()

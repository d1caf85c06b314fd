"""One sound file of every kind, small, for tests that break them: recordings, databases, folders, TOML, JSON, YAML."""

from __future__ import annotations

import gzip
import json
from contextlib import redirect_stdout
from io import StringIO
from pathlib import Path

import numpy as np
import trimesh
from motions import simulated
from PIL import Image
from places import ROOT
from study_files import SHORT, planned

from mmnn_pin import load
from mmnn_pin.cli import main
from mmnn_pin.lab.study.execution import missing_trials, probe
from mmnn_pin.lab.study.store import NAME, writing

EXPERIMENT = """
experiment = "track"
title = "Broken"
controllers = ["pd"]
windows = [[0.0, 0.002], [0.002, 0.004]]

[time]
duration = 0.004
control_period = 0.002
plant_step = 0.002

[masses]
arm_2_joint = 1.5

[sensor]
pose_noise = [0.001, 0.001, 0.001]
"""
STUDY = SHORT.replace("time.duration = 0.04", "time.duration = 0.004").replace("points = 4", "points = 2")
STUDY = STUDY.replace('"time.control_period" = { grid = [0.001, 0.002] }\n', "")
STUDY = STUDY.replace("windows = [[0.0, 0.02], [0.02, 0.04]]", "windows = [[0.0, 0.002], [0.002, 0.004]]")
TUNING = """
experiment = "chapter4"
controllers = ["pd"]
[set]
time.duration = 0.004
windows = [[0.0, 0.002], [0.002, 0.004]]
[sampling]
points = 2
[factors]
"masses" = { uniform = [0.5, 1.5] }
[tune]
controller = "pd"
objective = "e.*.peak"
trials = 2
check = 2
[tune.gains]
"feedback.arm" = { log_uniform = [5.0, 60.0] }
"""
STATE = {"pose": [0.1, 0.2, 0.3], "base_velocity": [0.1, 0.2], "joints": {"arm_1_joint": 0.4}, "joint_velocities": {}}
YAML = "controller:\n  type: diff_drive_controller/DiffDriveController\n  wheel_radius: 0.1\n  wheel_separation: 0.5\n"
HARDWARE = """
profile = "tiago"
rate = 250.0
delay = 0.004
velocity = "difference"

[arm]
interface = "position"
bandwidth = 25.0
encoder = 0.0015

[slides]
interface = "position"

[steering]
interface = "position"
bandwidth = 15.0

[joints."arm_1_*"]
bandwidth = 20.0
lag = 0.002

[base]
odometry = "wheels"
rate = 50.0
"""
OVERRIDES = 'base = "differential_drive"\nwheels = ["wheel_left_joint", "wheel_right_joint"]\nradius = 0.15\n'


ROBOTS = {"robot": "platform_arm", "armed": "platform_arm", "steered": "swerve_arm", "trailing": "truck_trailer_arm"}


def sound_files(
    folder: Path, controllers: tuple[str, ...] = ("two_layer", "pd", "adaptive"), tuned: bool = True
) -> Path:
    """Files of every kind in a new folder.

    Args:
        folder: The folder.
        controllers: One new recording each, beside one of an old version.
        tuned: Whether there is the database of a tuning, too.
    """
    folder.mkdir()
    old_recording(folder / "run_old.h5")
    for name in controllers:
        command(f"run track --controller {name} --set time.duration=0.02 --out {folder / name}")
        (folder / name / f"{name}.h5").rename(folder / f"run_{name}.h5")
        for file in (folder / name).iterdir():
            file.unlink()
        (folder / name).rmdir()
    for name, text in {
        "x.toml": EXPERIMENT,
        "tuning.toml": TUNING,
        "armed.hardware.toml": HARDWARE,
        "c.yaml": YAML,
        "robot.mmnn.toml": OVERRIDES,
    }.items():
        (folder / name).write_text(text)
    (folder / "state.json").write_text(json.dumps(STATE))
    for name, robot in ROBOTS.items():
        (folder / f"{name}.urdf").write_bytes((ROOT / "urdf" / f"{robot}.urdf").read_bytes())
    planned_motions(folder)
    meshes(folder / "meshes")
    study(folder)
    logs(folder)
    if tuned:
        command(f"tune {folder / 'tuning.toml'} --out {folder / 'tuned'}")
    return folder


def meshes(folder: Path) -> None:
    """A ball in every format of meshes, one with a material and a picture on it."""
    folder.mkdir()
    ball = trimesh.creation.icosphere(subdivisions=1, radius=0.1)
    for kind in ("stl", "dae", "glb", "ply"):
        ball.export(folder / f"m.{kind}")
    corners = "".join(f"v {x} {y} {z}\n" for x, y, z in ball.vertices.round(4))
    faces = "".join(f"f {a}/1 {b}/2 {c}/3\n" for a, b, c in ball.faces + 1)
    (folder / "m.obj").write_text(f"mtllib m.mtl\n{corners}vt 0 0\nvt 1 0\nvt 0 1\nusemtl a\n{faces}")
    (folder / "m.mtl").write_text("newmtl a\nKd 1 0 0\nmap_Kd t.png\n")
    Image.new("RGB", (8, 8), "red").save(folder / "t.png")


def planned_motions(folder: Path) -> None:
    """What planners give: poses and joints ten times a second, and points alone."""
    t = np.arange(0.0, 3.05, 0.1)
    swing = 0.1 * (1 - np.cos(t))
    table = np.column_stack((t, 0.1 * t**2, np.zeros((len(t), 2)), swing, -swing))
    head = "t,x,y,phi,position.arm_1_joint,position.arm_2_joint"
    np.savetxt(folder / "path.csv", table, "%.6g", ",", header=head, comments="")
    (folder / "points.csv").write_text("x,y\n0,0\n1,0\n1,1\n2,1.5\n")


def motion(file: Path) -> None:
    """Three seconds of an arm's motion as CSV."""
    log = simulated(load("two_axis_arm"), 3.0)
    columns = {"time": log.time, **log.signals}
    np.savetxt(file, np.column_stack(list(columns.values())), "%.6g", ",", header=",".join(columns), comments="")


def logs(folder: Path) -> None:
    """A short motion of an arm as CSV with its columns, a recording as MCAP, what was identified."""
    motion(folder / "log.csv")
    (folder / "columns.toml").write_text('time = "time"\n"position.{joint}" = "position.{joint}"\n')
    recording = sorted(folder.glob("run_*.h5"))[0]
    command(f"export {recording} --to mcap --out {folder / 'log.mcap'}")
    command(f"identify {folder / 'log.csv'} --robot two_axis_arm --even-if-worse --out {folder / 'identified'}")


def old_recording(file: Path) -> Path:
    """The recording of a version before 0.2: ten rows of `two_layer`."""
    packed = ROOT / "tests" / "recording" / "data" / "before_0_2.h5.gz"
    file.write_bytes(gzip.decompress(packed.read_bytes()))
    return file


def command(line: str) -> None:
    """A command of ours that must succeed."""
    with redirect_stdout(StringIO()):
        assert main(line.split()) == 0


def study(folder: Path) -> None:
    """A study's file, and results with invented numbers."""
    plan = planned(folder, STUDY)
    found = probe(plan)
    with writing(folder / "db" / NAME) as store:
        for number in missing_trials(store, plan, found, False):
            status, metrics = ("completed", "diverged")[number % 4 == 3], dict.fromkeys(found.units, 0.01 * number)
            store.add(plan.trial(number).result(status, time=0.004, metrics=metrics, seconds=0.1))

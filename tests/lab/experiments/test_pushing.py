"""What a run tells of the things that its hand touched: numbers, table, replay."""

from __future__ import annotations

import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest
from places import ROOT

from mmnn_pin import load
from mmnn_pin.lab.experiments.config import load_experiment
from mmnn_pin.lab.experiments.pushing import OPEN
from mmnn_pin.lab.experiments.runner import run_experiment
from mmnn_pin.lab.show.comparison import render, render_brief
from mmnn_pin.lab.show.replay import page
from mmnn_pin.lab.show.report.verdict import headline
from mmnn_pin.model.chain import chain_of, track
from mmnn_pin.recording.recording import recorded_position, recorded_robot

SHORT = ["plant='ideal'", "controllers=['computed_torque']", "weights_interval=1.0"]


@pytest.fixture(scope="module")
def door():
    wait = "reference.hand.path=[{type='wait', seconds=2.0}]"
    held = "disturbances=[{type='door', hinge=[0.0, -0.7], inertia=4.0, friction=2.0}]"
    said = [*SHORT, "time.duration=2.0", wait, "force.start=0.0", held, "windows=[[0.5, 2.0]]"]
    return run_experiment(load_experiment("door", said), "door")


def test_a_door_is_judged_by_the_way_that_its_handle_takes(door):
    """The second answer is the hand, which holds the handle: its way by finite differences."""
    run, numbers = door["computed_torque"], door.pushes["computed_torque"]
    robot = recorded_robot(run)
    places = track(chain_of(robot, "arm_tip"), recorded_position(run, robot))[:, 9:]
    moving = np.ravel(run["opening"]) > 0.02
    way = np.gradient(places, axis=0)[moving]
    way /= np.linalg.norm(way, axis=1)[:, None]
    force = run["hand_force"][moving]
    across = np.linalg.norm(force - np.sum(force * way, axis=1)[:, None] * way, axis=1)
    assert numbers["side_force_peak_N"] == pytest.approx(across.max(), abs=0.3)
    turned = places[-1] - (places[0] + [0.0, -0.7, 0.0])
    angle = np.degrees(np.arctan2(-turned[0], turned[1]))
    assert numbers["door_deg"] == pytest.approx(angle, abs=0.2)
    assert angle > 5.0
    assert angle < OPEN
    assert numbers["open_after_s"] is None


def test_the_verdict_is_of_what_the_hand_was_to_do(door):
    assert headline(door).startswith("The door is opened by none; computed_torque comes farthest, ")
    assert "base [mm]" not in render_brief(door)  # the reference of a hand that follows is no measure
    wide = {"side_force_peak_N": 4.0, "open_after_s": 3.0, "door_deg": 66.0}
    pushes = {"computed_torque": wide, "pd": wide | {"side_force_peak_N": 9.5}}
    told = headline(replace(door, pushes=pushes | {"pid": wide | {"open_after_s": None}}))
    assert told == "The door is opened by computed_torque and pd; pd has the least force across: 9.50 N."
    wiped = {"pd": {"force_error_rms_N": 0.31}, "pid": {"force_error_rms_N": 0.2}}
    assert headline(replace(door, pushes=wiped)) == "pid holds the force best: 0.200 N of RMS error."


def test_table_and_replay_show_it(door):
    for text in (render(door), render_brief(door)):
        assert "door opened [deg]" in text
        assert "force across its way [N] peak" in " ".join(text.split())
    assert door.to_dict()["comparison"]["pushes"] == door.pushes
    assert page({"run": door["computed_torque"]}).frames > 100


def test_a_surface_is_judged_by_the_force_on_it():
    wait = "reference.hand.path=[{type='wait', seconds=2.5}]"
    said = [*SHORT, "time.duration=2.5", wait, "force.start=0.5", "windows=[[0.5, 2.5]]"]
    result = run_experiment(load_experiment("wipe", said), "wipe")
    pressed = -result["computed_torque"]["hand_force"][:, 1]  # a wall at the left of platform_arm
    kept = pressed[result["computed_torque"].time >= 2.0]
    numbers = result.pushes["computed_torque"]
    assert numbers["force_mean_N"] == pytest.approx(kept.mean())
    assert numbers["force_error_rms_N"] == pytest.approx(np.sqrt(np.mean((kept - 20.0) ** 2)))
    assert numbers["force_error_rms_N"] < 2.0


def test_the_example_on_a_base_makes_a_robot_with_two_wheels(tmp_path):
    """examples/on_a_base.py, whose robots the page of contact has numbers of."""
    file = tmp_path / "arm_on_base.urdf"
    subprocess.run([sys.executable, ROOT / "examples/on_a_base.py", "two_axis_arm", str(file)], check=True)
    robot = load(file)
    assert robot.base.kind == "differential_drive"
    assert robot.wheel_names == ("wheel_left_joint", "wheel_right_joint")
    assert robot.dimensions.arm == 2

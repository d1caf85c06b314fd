"""Joints of light links without rotors are told, and what is printed mends them."""

from __future__ import annotations

import re

import pytest
from closed_form import inertial, joint

from mmnn_pin import load, load_experiment
from mmnn_pin.lab.experiments.runner import rotor_notes, run_experiment
from mmnn_pin.model.robot import lacking_rotors


@pytest.mark.parametrize(("speed", "lacks"), [(2.0, True), (100.0, False), (0.0, False)])
def test_a_light_joint_without_a_rotor_is_told_with_one_that_mends_it(speed, lacks, tmp_path):
    """A link of J = 1e-4 kg m^2 is at speed w by 3 N m after J w / 3, with the rotor that is printed after 10 ms."""
    limit = f'<limit lower="-1" upper="1" effort="3" velocity="{speed}"/>'
    tip = f'<link name="tip">{inertial(0.05, (1e-4,) * 3)}</link>'
    text = f'<link name="base"/>{tip}{joint("last", "base", "tip", "", "0 0 1", limit, "revolute")}'
    file = tmp_path / "light.urdf"
    file.write_text(f'<robot name="light">{text}</robot>')
    found = [finding for finding in load(file).findings if finding.code == "no-rotor"]
    assert [finding.severity for finding in found] == ["note"] * lacks
    if lacks:
        within = f"is at its top speed within {1e6 * 1e-4 * speed / 3:.3g} us"
        assert f"'last' (0.0001 kg m^2, 3 N m) {within}" in str(found[0])
        (said,) = re.findall(r"--set '(armature=\[.*\])'", found[0].fix)
        settings = [f"robot={file}", "time.duration=0.002", "controllers=['pd']"]
        before, mended = (load_experiment("track", [*settings, *more]) for more in ([], [said]))
        robot = mended.load_robot()
        assert robot.model.armature[-1] == pytest.approx(0.01 * 3 / speed) and lacking_rotors(robot) == ("", "")
        told = [[note for note in run_experiment(one, "track").notes if "rotors" in note] for one in (before, mended)]
        assert [len(notes) for notes in told] == [1, 0] and said in told[0][0]


@pytest.mark.parametrize(("effort", "way"), [(50, True), (1000, False)])
def test_no_rotor_is_made_of_limits_that_no_motor_gives(effort, way, tmp_path):
    """Three joints of 1 kg each: 50 N m per kg are what the densest servos give, 1000 what files have by habit."""
    links = "".join(f'<link name="l{i}">{inertial(1.0, (1e-4,) * 3)}</link>' for i in range(3))
    limit = f'<limit lower="-1" upper="1" effort="{effort}" velocity="10"/>'
    parents = ("base", "l0", "l1")
    joints = "".join(joint(f"j{i}", parents[i], f"l{i}", "", "0 0 1", limit, "revolute") for i in range(3))
    file = tmp_path / "strong.urdf"
    file.write_text(f'<robot name="strong"><link name="base"/>{links}{joints}</robot>')
    robot = load(file)
    (found,) = [finding for finding in robot.findings if finding.code == "no-rotor"]
    placeholders = "its effort limits are placeholders: no motors of an arm of 3 kg give 3000 N m together"
    assert ("--set 'armature=[" in found.fix) == way and (placeholders in str(found)) != way
    (told,) = rotor_notes(robot)
    assert ("--set 'armature=[" in told) == way and ("state the effort limits of its motors" in told) != way
    stated = robot.with_limits([3.0] * 3, 0.0)
    assert "--set 'armature=[0.003" in lacking_rotors(stated)[1]


def test_gains_are_those_of_link_and_rotor(tmp_path):
    """Suited gains are proportional to what a joint weighs: a tenth of it without the nine that a rotor adds."""
    text = f'<link name="base"/><link name="tip">{inertial(1.0, (0.1,) * 3)}</link>'
    text += joint(
        "last", "base", "tip", "", "0 0 1", '<limit lower="-1" upper="1" effort="9" velocity="9"/>', "revolute"
    )
    file = tmp_path / "one.urdf"
    file.write_text(f'<robot name="one">{text}</robot>')
    gains = []
    for rotor in (0.0, 0.9):
        experiment = load_experiment("track", [f"robot={file}", f"armature={rotor}", "time.duration=0.002"])
        robot = experiment.load_robot()
        gains.append(float(experiment.loop(robot, "pd").run()["effective_gain"][0]))
    assert gains[1] == pytest.approx(10 * gains[0], rel=1e-6)

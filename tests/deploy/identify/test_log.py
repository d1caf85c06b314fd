"""Reading motion: tables, bags, arrays, and every bad one in one line."""

from __future__ import annotations

import re
import shlex
from pathlib import Path
from random import Random
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from motions import simulated
from robots import fixed_arm

from mmnn_pin import PD, Line, Loop, Sine, Timing, Trajectory, load
from mmnn_pin.cli import main
from mmnn_pin.deploy.identify.log import Log, from_signals
from mmnn_pin.deploy.identify.quality import saturated, sound, without_turns
from mmnn_pin.deploy.identify.reading import found_columns, from_recording, read_columns, read_logs
from mmnn_pin.errors import InputError, RecordingError, UnknownName
from mmnn_pin.model.robot import Robot
from mmnn_pin.sensing import Sensor

JOINTS = ("arm_1_joint", "arm_2_joint")


@pytest.fixture(scope="module")
def arm() -> Robot:
    return load("two_axis_arm")


@pytest.fixture(scope="module")
def log(arm: Robot) -> Log:
    return simulated(arm, 10.0)


def table(log: Log, headers: dict[str, str] | None = None) -> str:
    """A log as CSV, its headers renamed."""
    names = {"time": log.time, **log.signals}
    rows = [",".join((headers or {}).get(name, name) for name in names)]
    rows += [",".join(map(repr, map(float, row))) for row in np.column_stack(list(names.values()))]
    return "\n".join(rows) + "\n"


def read(text: str, folder: Path, arm: Robot, **how: Any) -> Log:
    (folder / "log.csv").write_text(text)
    return read_logs([folder / "log.csv"], arm, **how)[0]


def assert_same(one: Log, other: Log) -> None:
    assert set(one.signals) == set(other.signals)
    for name, values in one.signals.items():
        np.testing.assert_array_equal(values, other.signals[name])


@pytest.mark.parametrize("mark", [",", ";", "\t"])
def test_a_table_with_our_names_is_read_as_it_is(mark: str, log: Log, arm: Robot, tmp_path: Path) -> None:
    found = read(table(log).replace(",", mark), tmp_path, arm)
    assert_same(found, log)
    np.testing.assert_array_equal(found.time, log.time)


def test_headers_with_other_words_are_understood(log: Log, arm: Robot, tmp_path: Path) -> None:
    words = {"time": "t"}
    for joint in JOINTS:
        words |= {f"position.{joint}": f"- {joint}_position", f"velocity.{joint}": f"{joint} dq"}
        words |= {f"effort.{joint}": f"tau[{joint}]"}
    assert_same(read(table(log, words), tmp_path, arm), log)


def test_bare_names_of_joints_are_their_positions_as_in_a_reference(log: Log, arm: Robot, tmp_path: Path) -> None:
    assert_same(read(table(log, {f"position.{joint}": joint for joint in JOINTS}), tmp_path, arm), log)


NUMBERED = {
    "from 1": ("t", "q_{}", "dq_{}", "tau_{}", 1),
    "from 0": ("time [s]", "q[{}]", "dq[{}]", "tau_J[{}]", 0),
    "words": ("Timestamp (s)", "joint{}_pos [rad]", "joint{}_vel [rad/s]", "joint{}_torque (Nm)", 1),
    "interface": ("timestamp", "actual_q_{}", "actual_qd_{}", "actual_current_{}", 0),
}


@pytest.mark.parametrize("how", NUMBERED)
def test_numbered_columns_are_the_joints_in_order(how: str, log: Log, arm: Robot, tmp_path: Path) -> None:
    """And what is wished, or of another robot, is not taken for what is measured."""
    time, *names, first = NUMBERED[how]
    words = {"time": time}
    for kind, name in zip(("position", "velocity", "effort"), names, strict=True):
        words |= {f"{kind}.{joint}": name.format(first + i) for i, joint in enumerate(JOINTS)}
    found = read(table(log, words), tmp_path, arm)
    assert_same(found, log)
    assert f"{names[0].format(first)} to {names[0].format(first + 1)} are taken for positions" in found.notes[0]
    wished = {f"effort.{joint}": f"target_{names[2]}".format(first + i) for i, joint in enumerate(JOINTS)}
    with pytest.raises(RecordingError, match="no effort of a joint"):
        read(table(log, words | wished), tmp_path, arm)
    twice = {f"velocity.{joint}": f"motor_torque_{first + i}" for i, joint in enumerate(JOINTS)}
    with pytest.raises(RecordingError, match=r"several sets of columns for efforts: .* choose with --columns"):
        read(table(log, words | twice), tmp_path, arm)
    chosen = read_columns(["effort.{joint}=" + names[2].format("{number}" if first else "{index}")])
    np.testing.assert_array_equal(
        read(table(log, words | twice), tmp_path, arm, columns=chosen).effort[JOINTS[1]], log.effort[JOINTS[1]]
    )


def test_arrays_without_names_are_refused(arm: Robot, tmp_path: Path) -> None:
    np.savez(tmp_path / "log.npz", q=np.zeros((5, 2)))
    with pytest.raises(RecordingError, match=r"Log.of\(time, position, effort\)"):
        read_logs([tmp_path / "log.npz"], arm)


def test_columns_are_mapped_by_pattern_name_and_file(log: Log, arm: Robot, tmp_path: Path) -> None:
    words = {f"position.{joint}": f"a{joint}" for joint in JOINTS} | {f"effort.{JOINTS[0]}": "m0"}
    words |= {f"effort.{JOINTS[1]}": "m1", "time": "clock"}
    (tmp_path / "map.toml").write_text(f'time = "clock"\n[effort]\n{JOINTS[0]} = "m0"\n{JOINTS[1]} = "m1"\n')
    columns = read_columns(["position.{joint}=a{joint}", str(tmp_path / "map.toml")])
    assert_same(read(table(log, words), tmp_path, arm, columns=columns), log)


def test_tables_with_the_same_times_are_one_motion(log: Log, arm: Robot, tmp_path: Path) -> None:
    parts = [
        {k: v for k, v in log.signals.items() if k.startswith(kind)} for kind in ("position", "velocity", "effort")
    ]
    for i, part in enumerate(parts):
        rows = np.column_stack([log.time, *part.values()])
        np.savetxt(tmp_path / f"{i}.csv", rows, "%.17g", ",", header=",".join(["time", *part]), comments="")
    found = read_logs([tmp_path / f"{i}.csv" for i in range(3)], arm)
    assert len(found) == 1
    assert_same(found[0], log)


def test_degrees_become_radians_and_are_noticed_without(log: Log, arm: Robot, tmp_path: Path) -> None:
    turned = {k: np.rad2deg(v) if not k.startswith("effort") else v for k, v in log.signals.items()}
    text = table(log.with_signals(turned))
    found = read(text, tmp_path, arm, degrees=True)
    np.testing.assert_allclose(found.position[JOINTS[0]], log.position[JOINTS[0]], rtol=1e-12)
    mixed = log.with_signals(turned | {f"position.{JOINTS[0]}": log.position[JOINTS[0]]})
    (one,) = (one for one in sound(mixed, arm).findings if "arm_1" in one.what)
    assert "velocity in degrees" in one.what and one.mends == (("velocity.arm_1_joint", "deg"),)


def test_a_table_without_times_needs_a_rate(log: Log, arm: Robot, tmp_path: Path) -> None:
    lines = [line.partition(",")[2] for line in table(log).splitlines()]
    with pytest.raises(RecordingError, match=r"log.csv:1: error: no column of times.*--rate HZ"):
        read("\n".join(lines), tmp_path, arm)
    np.testing.assert_allclose(read("\n".join(lines), tmp_path, arm, rate=100.0).time, log.time, atol=1e-9)


BAD = {
    "empty": (lambda text: "", "no header"),
    "numbers only": (lambda text: "\n".join(text.splitlines()[1:]), "no header"),
    "a word among numbers": (lambda text: text.replace("\n0.02,", "\nsoon,", 1), ":4: error: not a number: 'soon'"),
    "a short row": (lambda text: text.replace("\n0.02,", "\n", 1), ":4: error: 6 cells under 7 headers"),
    "no rows": (lambda text: text.splitlines()[0], "0 rows"),
    "other joints": (lambda text: text.replace("arm_", "leg_"), "no position of a joint of two_axis_arm"),
    "no efforts": (lambda text: text.replace("effort.", "warmth."), "no effort of a joint"),
    "twice": (lambda text: text.replace("velocity.arm_1_joint", "position.arm_1_joint [rad]", 1), "two columns for"),
    "twice in other words": (
        lambda text: text.replace("velocity.arm_1_joint", "arm_1_joint q", 1).replace("position.arm_1", "pos_arm_1", 1),
        "two columns for position.arm_1_joint: 'pos_arm_1_joint' and 'arm_1_joint q'",
    ),
}


@pytest.mark.parametrize("what", BAD)
def test_bad_tables_are_refused_in_one_line(what: str, log: Log, arm: Robot, tmp_path: Path) -> None:
    change, message = BAD[what]
    with pytest.raises(InputError) as error:
        read(change(table(log)), tmp_path, arm)
    assert message in str(error.value) and "\n" not in str(error.value) and "log.csv" in str(error.value)


def test_a_name_of_ours_stands_before_what_words_may_mean(log: Log, arm: Robot, tmp_path: Path) -> None:
    text = table(log).replace("velocity.arm_1_joint", "q_ref.arm_1_joint [rad]", 1)
    found = read(text.replace("position.arm_1_joint", "position.arm_1_joint [rad]"), tmp_path, arm)
    np.testing.assert_array_equal(found.position[JOINTS[0]], read(table(log), tmp_path, arm).position[JOINTS[0]])
    assert JOINTS[0] not in found.velocity


@pytest.mark.parametrize("name", ["two_axis_arm", "platform_arm"])
def test_a_csv_of_mmnn_export_is_read_as_its_recording_is(name: str, tmp_path: Path) -> None:
    robot = load(name)
    path = Trajectory.of(robot, base=Line(0.3) if name == "platform_arm" else None, arm={JOINTS[0]: Sine(0.5, 2.0)})
    noisy = Sensor(noise=1e-3)  # what the sensors say is not the truth
    run = Loop(robot, path, PD(), timing=Timing(duration=0.2), sensor=noisy).run(tmp_path / "run.h5")
    assert main(["export", str(tmp_path / "run.h5"), "--to", "csv"]) == 0
    ours, (csv,) = from_recording(run, robot), read_logs([tmp_path / "run.csv"], robot)
    assert csv.effort_delay == pytest.approx(ours.effort_delay)
    np.testing.assert_array_equal(csv.time, ours.time)
    assert list(csv.signals) == list(ours.signals) and len(ours.signals) >= 6
    for signal, values in ours.signals.items():
        np.testing.assert_array_equal(csv.signals[signal], values, err_msg=signal)
    assert not np.array_equal(csv.position[JOINTS[0]], run["position"][:, -2])
    with pytest.raises(RecordingError, match=r"run\.csv.*of a robot with the joint"):
        read_logs([tmp_path / "run.csv"], fixed_arm(joints=3))


def test_a_last_line_that_is_cut_short_is_left_out(log: Log, arm: Robot, tmp_path: Path) -> None:
    text = table(log).rstrip("\n")
    found = read(text[: text.rindex(",")], tmp_path, arm)
    lines = len(text.splitlines())
    assert len(found.time) == len(log.time) - 1 and f"line {lines} is cut short and left out" in found.notes
    assert read(text, tmp_path, arm).notes == () and len(read(text, tmp_path, arm).time) == len(log.time)
    with pytest.raises(RecordingError, match=f":{lines}: error: 6 cells under 7 headers"):
        read(text[: text.rindex(",")] + "\n", tmp_path, arm)


def test_unknown_columns_and_signals_are_refused(log: Log, arm: Robot, tmp_path: Path) -> None:
    with pytest.raises(UnknownName, match="unknown column 'q7'"):
        read(table(log), tmp_path, arm, columns={"position.arm_1_joint": "q7"})
    with pytest.raises(UnknownName, match=r"unknown signal 'position.arm_1'.*did you mean 'position.arm_1_joint'"):
        found_columns(["leg"], JOINTS, {"position.arm_1": "leg"}, tmp_path)
    with pytest.raises(InputError, match="is no mapping"):
        read_columns(["arm_1_joint"])


# -- what is wrong with a sound table ----------------------------------------------------------------------------------


def changed(log: Log, **signals: Any) -> Log:
    return log.with_signals(log.signals | {k.replace("__", "."): v for k, v in signals.items()})


def test_times_are_put_right(log: Log, arm: Robot) -> None:
    rows = np.sort(np.concatenate([np.arange(1000), [300, 300]]))
    rows = rows[(rows < 500) | (rows > 540)]
    found = sound(log.rows(rows).with_signals(log.rows(rows).signals, (7.0 + log.time[rows]) * 1e9), arm)
    text = "; ".join((*found.notes, *map(str, found.findings)))
    assert "counts ns" in text and "2 rows repeat" in text and "1 gaps, the longest 0.42 s at t = 4.99" in text
    np.testing.assert_allclose(found.time, log.time[np.unique(rows)], atol=1e-5)
    shaken = log.time + 0.002 * np.random.default_rng(0).uniform(-1, 1, 1000)
    notes = "; ".join(sound(log.with_signals(log.signals, shaken), arm).notes)
    assert "the period jitters by 16 %" in notes or "the period jitters by 17 %" in notes  # 2 ms sqrt(2 / 3) of 10 ms


def test_impossible_logs_are_refused(log: Log, arm: Robot) -> None:
    with pytest.raises(RecordingError, match="the time goes back"):
        sound(log.rows(np.random.default_rng(0).permutation(1000)), arm)
    with pytest.raises(RecordingError, match="time stands still"):
        sound(log.with_signals(log.signals, np.zeros(1000)), arm)
    for epoch, same in ((1.7e9, 91), (0.0, 91)):  # 1,000 rows at 100 Hz in whole seconds
        with pytest.raises(RecordingError, match=f"too coarse: {same} rows have the same one.*give --rate HZ"):
            sound(log.with_signals(log.signals, np.round(epoch + log.time)), arm)
    with pytest.raises(RecordingError, match=r"1.5 s of motion"):
        sound(log.rows(slice(0, 151)), arm)
    with pytest.raises(RecordingError, match="all efforts are zero"):
        sound(changed(log, effort__arm_1_joint=np.zeros(1000), effort__arm_2_joint=np.zeros(1000)), arm)


def test_spikes_constants_saturation_and_lag_are_told(log: Log, arm: Robot) -> None:
    effort = log.effort["arm_1_joint"] + 0.01 * np.random.default_rng(0).standard_normal(1000)
    spiked = effort.copy()
    spiked[[100, 400]] += 5 * np.ptp(effort)
    found = sound(changed(log, effort__arm_1_joint=spiked), arm)
    assert "effort.arm_1_joint: 2 spikes replaced, the first at t = 1 s" in found.notes
    assert np.abs(found.effort["arm_1_joint"] - effort).max() < 0.1
    assert (
        "effort.arm_2_joint is 3 all the time" in sound(changed(log, effort__arm_2_joint=np.full(1000, 3.0)), arm).notes
    )
    limit = 0.7 * np.abs(effort).max()
    clipped = np.clip(effort, -limit, limit)
    assert any("saturated" in note for note in sound(changed(log, effort__arm_1_joint=clipped), arm).notes)
    assert not saturated(effort).any() and (np.abs(clipped[saturated(clipped)]) == limit).all()


def test_arrays_make_a_log() -> None:
    log = Log.of([0, 1], {"a": [1, 2]}, {"a": [3, 4]}, base={"v": [0, 0]}, reference={"x": [5, 6]})
    assert sorted(log.signals) == ["base.v", "effort.a", "position.a", "reference.x"]
    with pytest.raises(RecordingError, match=r"effort.a has shape \(3,\)"):
        Log.of([0, 1], {"a": [1, 2]}, {"a": [3, 4, 5]})


@given(st.floats(-3.0, 3.0), st.floats(0.5, 8.0), st.floats(-np.pi, np.pi))
def test_encoders_that_wrap_give_the_angles_that_the_joint_had(start: float, speed: float, seam: float) -> None:
    """A wheel and a heading that turn on and on, read with a seam anywhere; numpy's own unwrap is the second answer."""
    robot, t = load("platform_arm"), np.arange(400) * 0.01
    angle = start + speed * t + 0.3 * np.sin(3.0 * t)
    read = (angle - seam) % (2 * np.pi) + seam
    wheel = robot.base.wheels[0].joint
    log = without_turns(from_signals("log", {"time": t, f"position.{wheel}": read, "reference.phi": read}), robot)
    for found in (log.position[wheel], log.reference["reference.phi"]):
        np.testing.assert_allclose(found - found[0], angle - angle[0], atol=1e-9)
        np.testing.assert_allclose(found, np.unwrap(read), atol=1e-9)
    if not np.array_equal(np.unwrap(read), read):
        assert any("whole turns" in one.what and wheel in one.what for one in log.findings)


STYLES = {  # time, position and effort of joint {j}, which has number {n} or {i}; and columns that must not be taken
    "rosbag2": ("/joint_states.header.stamp", "/joint_states/position[{i}]", "/joint_states/effort[{i}]", ()),
    "echo": ("%time", "field.position{i}", "field.effort{i}", ("field.header.seq",)),
    "plotjuggler": ("__time", "/joint_states/{j}/position", "/joint_states/{j}/effort", ("/joint_states/count",)),
    "moveit": ("time_from_start", "points.positions[{i}]", "points.effort[{i}]", ()),
    "ur": ("timestamp", "actual_q_{i}", "actual_current_{i}", ("target_q_{i}", "target_moment_{i}")),
    "franka": ("time [s]", "state.q[{i}]", "state.tau_J[{i}]", ("state.q_d[{i}]", "state.tau_J_d[{i}]")),
    "lerobot": ("timestamp", "observation.state.{j}.pos", "observation.{j}.load", ("action.{j}.pos", "frame_index")),
    "unknown": ("zeit", "enc_{n}", "amp_{n}", ()),
    "words": ("t", "axis {n} pos", "axis {n} torque", ()),
    "limbs": ("t", "leg_{n}_q", "leg_{n}_tau", ()),
    "named": ("clock", "{w} pos", "{w} torque", ()),
}


@settings(deadline=None, max_examples=40, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(style=st.sampled_from(sorted(STYLES)), random=st.randoms(use_true_random=False))
def test_headers_are_understood_or_the_guess_that_is_printed_works(style: str, random: Random, tmp_path: Path) -> None:
    """In any order of kinds; a guess is followed as it stands, until the file is read."""
    robot, t = load("two_axis_arm"), np.arange(50) / 100
    time, position, effort, others = STYLES[style]
    names = zip(robot.joint_names, ("shoulder", "elbow"), strict=True)
    joints = [{"j": j, "i": i, "n": i + 1, "w": w} for i, (j, w) in enumerate(names)]
    kinds = [position, effort, *others]
    if style != "unknown":  # of words that say nothing, positions are thought to come first
        random.shuffle(kinds)
    header = [time, *dict.fromkeys(kind.format(**joint) for kind in kinds for joint in joints)]
    values = np.column_stack([t, *(np.sin(t + k) for k in range(1, len(header)))])
    np.savetxt(tmp_path / "log.csv", values, delimiter=",", header=",".join(header), comments="")
    columns: dict[str, str] = {}
    for _ in range(4):
        try:
            (log,) = read_logs([tmp_path / "log.csv"], robot, columns)
            break
        except RecordingError as error:
            columns |= read_columns([shlex.split(guess)[1] for guess in re.findall(r"--columns '[^']*'", str(error))])
    for joint in joints:
        for kind, signals in ((position, log.position), (effort, log.effort)):
            np.testing.assert_allclose(signals[joint["j"]], values[:, header.index(kind.format(**joint))])

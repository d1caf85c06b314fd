"""The example in real time, with real processes: faults end in a recording, nothing hangs, errors are one line."""

from __future__ import annotations

import argparse
import json
import re
import signal
import socket
import subprocess
import sys
import time
from contextlib import suppress

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from places import ROOT

from mmnn_pin import Recording
from mmnn_pin.errors import InputError, RecordingError

EXAMPLE = ROOT / "examples/udp"
DEADLINE = 240.0  # [s] of any process here, however busy the machine is
# A busy machine must not trip what is to run to its end.
PATIENT = [
    f"--set={key}"
    for key in (
        "safety.timeout=60",
        "safety.position_error=1e6",
        "safety.heading_error=4",
        "safety.joint_error=1e6",
        "safety.speed=1e6",
        "safety.joint_speed=none",
        "safety.wheel_speed=none",
        "safety.jump=none",
        "safety.slowest=none",
        "safety.shaking=none",
        "safety.torque_time=60",
        "safety.weights=1e9",
    )
]


@pytest.fixture(scope="module")
def example():
    """The modules of the example."""
    sys.path.insert(0, str(EXAMPLE))
    try:
        import control
        import faults
        import link
        import task

        yield argparse.Namespace(control=control, faults=faults, link=link, task=task)
    finally:
        sys.path.remove(str(EXAMPLE))
        for name in ("control", "faults", "link", "task"):
            sys.modules.pop(name, None)


def start(script, out, *arguments):
    command = [sys.executable, str(EXAMPLE / script), "--out", str(out), *map(str, arguments)]
    pipe = subprocess.PIPE
    return subprocess.Popen(command, stdout=pipe, stderr=pipe, text=True, start_new_session=True)


def ended(process):
    """Exit code, standard output and error of a process."""
    try:
        out, err = process.communicate(timeout=DEADLINE)
    finally:
        process.kill()
    return process.returncode, out, err


def pair(out, *arguments):
    """A plant, and a controller for it in a process of its own."""
    plant = start("plant.py", out, "--port", 0, *arguments)
    port = plant.stdout.readline().split()[1]
    return plant, start("control.py", out, "--port", port, "--wait", DEADLINE, *arguments)


def until_recorded(path, rows):
    """Wait until a recording that is being written has so many rows."""
    end, found = time.monotonic() + DEADLINE, 0
    while found <= rows:
        assert time.monotonic() < end, f"{path} did not grow"
        time.sleep(0.05)
        with suppress(RecordingError):  # not there yet, or in the middle of a write
            found = len(Recording.open(path))


# -- whole runs, all of them at the same time --------------------------------------------------------------------------


@pytest.fixture(scope="module")
def runs(tmp_path_factory):
    """Processes of all runs, started together; a test takes what it needs."""
    folder = tmp_path_factory.mktemp("realtime")
    short = ("--seconds", 1.2)
    started = {
        "broken": start("run.py", folder / "broken", *short, *PATIENT, "--fault", "nan", "shuffle", "short"),
        "kill": start("run.py", folder / "kill", *short, "--seconds", 3, "--fault", "kill"),
        "late": start("run.py", folder / "late", *short, "--seconds", 3, "--fault", "late"),
    }
    yield folder, started
    for process in started.values():
        process.kill()
        process.wait()


def test_a_killed_controller_leaves_motors_without_torque(tmp_path):
    plant, control = pair(tmp_path, "--seconds", 60, *PATIENT)
    try:
        until_recorded(tmp_path / "controller.h5", 20)
        control.kill()
        code, out, _ = ended(plant)
    finally:
        plant.kill()
        control.kill()
    told = json.loads(out)
    assert code == 0 and told["received"] > 20
    assert told["ramped"] is not None and not told["dismissed"] and not any(told["motor_torque"])
    run = Recording.open(tmp_path / "plant.h5")
    assert run.complete and "stopped" in run.outcome.message
    since = run.time >= told["ramped"] + 0.25 + run.meta["control_period"]
    assert since.any() and not run["motor_torque"][since].any() and run["motor_torque"][~since].any()
    control.communicate()


def test_ctrl_c_keeps_the_recording(tmp_path):
    plant, control = pair(tmp_path, "--seconds", 60, *PATIENT)
    try:
        until_recorded(tmp_path / "controller.h5", 20)
        control.send_signal(signal.SIGINT)
        code, out, err = ended(control)
        plant_code, told, _ = ended(plant)
        assert plant_code == 0 and json.loads(told)["dismissed"]
    finally:
        plant.kill()
        control.kill()
    run = Recording.open(tmp_path / "controller.h5")
    assert code == 130 and err == "" and "interrupted" in out
    assert run.complete and run.outcome.status == "interrupted" and len(run) > 20
    assert "SIGINT" in run.outcome.message


def test_broken_packets_are_refused_and_the_run_goes_on(runs):
    folder, started = runs
    code, out, err = ended(started["broken"])
    run = Recording.open(folder / "broken/controller.h5")
    assert (code, run.outcome.status) == (0, "completed"), out + err
    for what in ("refused", "packets out of order dropped", "malformed packets dropped"):
        assert what in run.outcome.message
    assert all(np.isfinite(run[name]).all() for name in run.names)
    skipped = int(re.search(r"([\d,]+) skipped by overruns", out)[1].replace(",", ""))  # where the machine is busy
    assert len(run) + skipped == 240 and 1.0 < run.time[-1] < 1.196 and (np.diff(run.time) > 0).all()
    assert np.isfinite(run.final["late"]).sum() == len(run)
    plant = Recording.open(folder / "broken/plant.h5")
    assert plant.complete and "true_z" in plant and np.isfinite(plant["nu"]).all()
    assert np.abs(plant["torque"]).max() > 0.0  # commands came through
    for word in ("jitter", "step", "garbage collections", "skipped by overruns"):
        assert word in out


@pytest.mark.parametrize("fault", ["kill", "late"])
def test_a_sensor_that_falls_silent_ends_the_run_as_tripped(runs, fault):
    folder, started = runs
    code, out, err = ended(started[fault])
    run = Recording.open(folder / fault / "controller.h5")
    assert code == 1 and run.complete and run.outcome.status == "tripped", out + err
    pauses = run.time[1:][np.diff(run.time) > 1.5 * run.meta["control_period"]]  # of a busy machine
    braked_anew = run.time[-1] - pauses.max(initial=-np.inf) < 0.5  # by what comes late after one, and only so long
    assert len(run) > 0 and (braked_anew or not run["torque"][-1].any())
    assert Recording.open(folder / fault / "plant.h5").complete == (fault == "late")
    assert ("was killed" in out) == (fault == "kill")


# -- errors, one line each ---------------------------------------------------------------------------------------------


def one_line(process):
    code, out, err = ended(process)
    assert code == 2 and out == "" and err.count("\n") == 1, out + err
    return err


def test_a_busy_port_is_told(tmp_path):
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as taken:
        taken.bind(("127.0.0.1", 0))
        port = taken.getsockname()[1]
        error = one_line(start("plant.py", tmp_path, "--port", port))
    assert f"--port: error: cannot use port {port}: Address already in use: choose another" in error
    assert list(tmp_path.iterdir()) == []


def test_a_plant_that_is_not_there_is_told(tmp_path):
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    assert f"no plant at port {port}" in one_line(start("control.py", tmp_path, "--port", port, "--wait", 0.3))


def options(**changes):
    common = {"rate": 200.0, "seconds": 1.0, "controller": "pd", "set": [], "experiment": EXAMPLE / "task.toml"}
    return argparse.Namespace(**common | changes)


@pytest.mark.parametrize(
    "changes, message",
    [
        *[({"rate": rate}, "--rate: error") for rate in (0.0, -5.0, np.nan, np.inf, 1e9)],
        *[({"seconds": seconds}, "--seconds: error") for seconds in (0.0, -1.0, np.nan, np.inf)],
        ({"controller": "pdd"}, "did you mean 'pd'"),
        ({"set": ["safety.timeout=0"]}, "safety.timeout: error"),
        ({"set": ["safety.nothing=0"]}, "unknown key 'nothing'"),
        ({"experiment": "nothing"}, "unknown experiment 'nothing'"),
    ],
)
def test_bad_options_are_refused(example, changes, message):
    with pytest.raises(InputError, match=message):
        example.task.task(options(**changes))


@pytest.mark.parametrize("rate", [1.0, 30.0, 144.0, 200.0, 333.0, 1000.0, 7919.0])
def test_any_rate_has_periods_that_divide(example, rate):
    timing = example.task.task(options(rate=rate))[0].time
    assert timing.control_period == 1 / rate and timing.samples == rate and timing.plant_step <= 0.001 * (1 + 1e-9)


@pytest.mark.parametrize("port", [-1, 65536])
def test_ports_that_are_none_are_refused(example, port):
    with pytest.raises(InputError, match="--port: error"):
        example.link.Channel(1, 1, port)


# -- packets and ticks -------------------------------------------------------------------------------------------------


@pytest.fixture
def link(example):
    """Two ends of a link, four values one way and two the other."""
    one = example.link.Channel(4, 2)
    other = example.link.Channel(2, 4, peer=("127.0.0.1", one.port))
    other.send(example.link.HELLO)
    assert received(one) == example.link.HELLO
    yield one, other
    one.socket.close()
    other.socket.close()


def received(channel):
    """What came, once it is there."""
    end = time.monotonic() + DEADLINE
    while (kind := channel.receive()) is None and time.monotonic() < end:
        time.sleep(0.001)
    return kind


def test_values_arrive_as_they_were_sent(example, link):
    one, other = link
    values = np.array([1.5, -0.0, np.inf, 1e-300])
    before = time.monotonic_ns()
    one.send(example.link.MEASUREMENT, values)
    assert received(other) == example.link.MEASUREMENT
    assert other.values.tobytes() == values.tobytes() and before <= other.stamp <= time.monotonic_ns()


@settings(max_examples=30, deadline=None)
@given(order=st.permutations(range(6)), copies=st.integers(1, 2))
def test_only_newer_packets_count(example, order, copies):
    one = example.link.Channel(1, 1)
    other = example.link.Channel(1, 1, peer=("127.0.0.1", one.port))
    packets = [bytes(other.pack(example.link.COMMAND, [k])) for k in range(6)]
    for k in order:
        for _ in range(copies):
            other.put(packets[k])
    rising = [k for i, k in enumerate(order) if k == max(order[: i + 1])]
    seen = 0
    while seen < 6 * copies and received(one) is not None:
        seen = one.received + one.out_of_order
    assert (one.received, one.out_of_order) == (len(rising), 6 * copies - len(rising)) and one.values == 5
    one.socket.close()
    other.socket.close()


def test_torn_long_and_foreign_packets_are_dropped_and_counted(example, link):
    one, other = link
    whole = bytes(one.pack(example.link.MEASUREMENT, [1.0, 2.0, 3.0, 4.0]))
    wrong = [b"", b"x", whole[:-1], whole + b"x", whole + 10000 * b"x", b"nnnn" + whole[4:]]
    for packet in wrong:
        one.put(packet)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as stranger:
        stranger.sendto(bytes(one.pack(example.link.MEASUREMENT, [9.0] * 4)), ("127.0.0.1", other.port))
    one.put(whole)
    assert received(other) == example.link.MEASUREMENT
    assert (other.received, other.malformed, other.values.tolist()) == (1, len(wrong), [1.0, 2.0, 3.0, 4.0])


@pytest.mark.parametrize("kind", ["late", "nan", "shuffle", "short"])
def test_faults_begin_in_the_middle_and_keep_or_break_packets(example, kind):
    faults, packet = example.faults.Faults([kind], 1.0), bytes(range(64))
    assert faults.packets(0.99, packet) == [packet]
    sent = [faults.packets(1.0 + 0.01 * k, packet) for k in range(200)]
    count, whole = sum(map(len, sent)), sum(one == packet for some in sent for one in some)
    expected = {"late": (130, 130), "shuffle": (200, 200), "short": (600, 200)}
    assert (count, whole) == expected[kind] if kind != "nan" else count == 200 and 30 < whole < 110


def test_ticks_that_have_passed_are_skipped_and_counted(example, monkeypatch):
    now = [100.0]
    monkeypatch.setattr(example.control.clock, "monotonic", lambda: now[0])
    monkeypatch.setattr(example.control.clock, "sleep", lambda t: now.__setitem__(0, now[0] + t + 1e-4))
    pace, ticks = example.control.Pace(0.01, 10), []
    for work in (0.001, 0.001, 0.035, 0.001, 0.009, 0.001):
        ticks.append(pace.wait())
        now[0] += work
    assert ticks == [0, 1, 2, 5, 6, 7] and pace.skipped == 2
    late = np.full(10, np.nan)
    late[[0, 1, 2, 5, 6, 7]] = [1e-4, 1e-4, 1e-4, 0.0051 + 1e-4, 1e-4, 1e-4]
    np.testing.assert_allclose(pace.late, late, atol=1e-9)
    now[0] += 1.0
    assert pace.wait() >= 10 and pace.skipped == 4

"""Batches on processes: the runs of threads, bit for bit; Ctrl-C, errors and killed processes."""

from __future__ import annotations

import multiprocessing
import os
import pickle
import signal
import subprocess
import sys
import threading
import time
from contextlib import suppress
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numba import config
from robots import fixed_arm

from mmnn_pin import PD, Circle, Feedback, Hold, Line, Loop, Neural, Sine, Timing, Trajectory, load
from mmnn_pin.errors import BatchError, ConfigError, TrajectoryError, UnknownName
from mmnn_pin.loop import batch
from mmnn_pin.loop.batch import simulate_many
from mmnn_pin.loop.before_run import Bounds
from mmnn_pin.loop.latency import Latency
from mmnn_pin.torque.two_layer import TwoLayer

pytestmark = [
    pytest.mark.skipif(sys.platform != "linux", reason="batches fork on Linux only"),
    pytest.mark.skipif(config.DISABLE_JIT, reason="laws in plain Python stay in one process"),
]

ROBOT = load("platform_arm")
GAINS = Feedback(base=500.0, arm=10.0)
LINE = Trajectory(Line(0.3), (Sine(0.5, 2.0), Hold(0.4)))
TURN = Trajectory(Circle(1.0, 0.4), (Hold(0.2), Sine(0.3, 1.0)))
BASIC = Loop(ROBOT, LINE, Neural(TwoLayer(), GAINS), timing=Timing(duration=0.3), weights_interval=0.01)
LOOPS = [
    *(replace(BASIC, seed=seed) for seed in range(10)),
    replace(BASIC, robot=ROBOT.with_masses(1.3), trajectory=TURN),
    replace(BASIC, controller=PD(GAINS)),
    replace(BASIC, controller=PD(Feedback(base=500.0, arm=500.0)), bounds=Bounds(joint_speed=3.0)),  # diverges
    Loop(fixed_arm(3, 1), Trajectory(None, (Hold(0.1),) * 3), PD(Feedback(arm=5.0)), timing=Timing(duration=0.2)),
]


@pytest.fixture
def forked(monkeypatch):
    """Batches of any size fork, also beside the test runner's threads."""
    monkeypatch.setattr(batch, "forks", lambda loops, workers: workers > 1)


def test_processes_give_the_bits_of_threads(monkeypatch):
    monkeypatch.setattr(batch, "forks", lambda loops, workers: False)
    others = simulate_many(LOOPS, workers=2)
    monkeypatch.setattr(batch, "forks", lambda loops, workers: workers > 1)
    for one, other in zip(simulate_many(LOOPS, workers=2), others, strict=True):
        assert one.outcome == other.outcome and one.recording is None and other.recording is None
        assert one.metrics.keys() == other.metrics.keys() and one.final.keys() == other.final.keys()
        assert np.array_equal(list(one.metrics.values()), list(other.metrics.values()), equal_nan=True)
        assert all(np.array_equal(one.final[name], other.final[name]) for name in one.final)
    assert not multiprocessing.active_children()


def test_processes_make_the_runs(forked, monkeypatch):
    made = batch.simulate_group

    def told(runs, worth, cancelled):
        return [replace(run, metrics=run.metrics | {"pid": float(os.getpid())}) for run in made(runs, worth, cancelled)]

    monkeypatch.setattr(batch, "simulate_group", told)
    pids = [run.metrics["pid"] for run in simulate_many([BASIC] * 40, workers=2)]
    kept = simulate_many([BASIC] * 40, workers=2, keep=("z",))
    assert {run.metrics["pid"] for run in kept} == {os.getpid()}
    assert set(pids[:5]) == {os.getpid()} and os.getpid() not in pids[5:] and 1 <= len(set(pids[5:])) <= 2


@pytest.mark.parametrize(
    ("bad", "error", "text"),
    [
        (replace(BASIC, controller=PD(Feedback(base=500.0, arm=(1.0, 2.0, 3.0)))), ConfigError, "3 numbers for 2"),
        (replace(BASIC, trajectory=Trajectory(Line(0.3), (Hold(0.0),))), TrajectoryError, "1 arm profiles"),
    ],
)
def test_an_error_of_a_process_is_raised_as_it_was(forked, bad, error, text):
    with pytest.raises(error, match=rf"loops\[9\].*{text}"):
        simulate_many([*[BASIC] * 9, bad], workers=2)
    assert not multiprocessing.active_children()


@pytest.mark.parametrize(
    "error",
    [
        ConfigError("what", why="why", fix="fix", file="a.toml", line=3, key="time.duration"),
        UnknownName("robot", "tigao", ["tiago", "panda"], file="b.toml"),
        BatchError("no memory"),
    ],
)
def test_an_error_comes_back_from_a_process_as_it_was(error):
    back = pickle.loads(pickle.dumps(error))
    assert type(back) is type(error) and str(back) == str(error) and vars(back) == vars(error)
    assert back.args == error.args


@pytest.mark.parametrize("limit", [1, 5, 12])
def test_ctrl_c_gives_back_what_is_done(forked, limit):
    def progress(done, total):
        if done >= limit:
            raise KeyboardInterrupt

    longer = replace(BASIC, timing=Timing(duration=6.0))
    runs = simulate_many([*[BASIC] * 17, *[longer] * 40], workers=2, progress=progress)
    done = sum(run.outcome.status == "completed" for run in runs)
    assert limit <= done < 40 and runs[-1].outcome.message == "not started" and not multiprocessing.active_children()
    assert all(run.outcome.status in ("completed", "interrupted") for run in runs)


SCRIPT = """
import sys
from dataclasses import replace
from mmnn_pin import Line, Loop, Hold, Neural, Timing, Trajectory, load
from mmnn_pin.loop.batch import simulate_many
loop = Loop(load("platform_arm"), Trajectory(Line(0.3), (Hold(0.2), Hold(0.4))), Neural(), timing=Timing(duration=5.0))
def told(done, total):
    print(done, flush=True)
runs = simulate_many([replace(loop, seed=seed) for seed in range(4000)], workers=2, progress=told)
print("ended", sum(run.outcome.status == "completed" for run in runs), len(runs), flush=True)
"""


def children(pid: int) -> list[int]:
    """The processes that a process has started."""
    return [int(one) for one in Path(f"/proc/{pid}/task/{pid}/children").read_text().split()]


def begun(lines: int) -> subprocess.Popen[str]:
    """A batch in a process group of its own, once its processes have made some runs."""
    command = [sys.executable, "-c", SCRIPT]
    running = subprocess.Popen(command, text=True, stdout=-1, stderr=-1, start_new_session=True)
    assert running.stdout is not None
    for _ in range(lines):
        running.stdout.readline()
    return running


def test_ctrl_c_of_a_terminal_ends_all_processes_and_keeps_what_is_done():
    running = begun(6)
    os.killpg(running.pid, signal.SIGINT)
    out, err = running.communicate(timeout=120)
    word, done, total = out.split("\n")[-2].split()
    assert word == "ended" and 5 <= int(done) < 4000 and total == "4000" and not err and running.returncode == 0
    with pytest.raises(ProcessLookupError):
        os.killpg(running.pid, 0)


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGKILL])
def test_processes_end_with_their_parent_however_it_ends(number):
    running = begun(6)
    assert alive(running.pid)
    os.kill(running.pid, number)
    running.communicate(timeout=120)  # the output is closed once nobody has it
    for _ in range(100):
        if not alive(running.pid):
            break
        time.sleep(0.05)
    assert not alive(running.pid)


def alive(group: int) -> bool:
    """Whether a process group has processes other than ended ones whose parent, the system, has not looked yet."""
    for file in Path("/proc").glob("[0-9]*/stat"):
        with suppress(OSError):  # it ends meanwhile
            state, _, member = file.read_text().rpartition(")")[2].split()[:3]
            if int(member) == group and state != "Z":
                return True
    return False


def test_ctrl_c_in_a_second_run_that_is_made_alone_ends_the_batch(forked, monkeypatch):
    some, calls, me = batch.simulate_group, [], os.getpid()

    def pressed(runs, worth, cancelled):
        calls.append(runs)
        made = some(runs, worth, cancelled)
        return (
            made
            if os.getpid() != me or len(calls) < 2
            else [replace(one, outcome=batch.NOT_STARTED.outcome) for one in made]
        )

    monkeypatch.setattr(batch, "simulate_group", pressed)
    late = replace(BASIC, latency=Latency(command=0.002))
    runs = simulate_many([late] * 9, workers=2)
    assert [run.outcome.status for run in runs] == ["completed", *["interrupted"] * 8] and len(calls) == 2


def test_ctrl_c_while_processes_are_forked_waits_until_they_are(forked, monkeypatch):
    fork, me, forks = os.fork, os.getpid(), []

    def pressed():
        if os.getpid() == me and not forks:
            os.kill(me, signal.SIGINT)
        forks.append(1)
        return fork()

    monkeypatch.setattr(os, "fork", pressed)
    runs = simulate_many([BASIC] * 40, workers=3)
    assert len(forks) == 3 and not multiprocessing.active_children()
    assert {run.outcome.status for run in runs} <= {"completed", "interrupted"} and runs[-1] == batch.NOT_STARTED


def test_no_more_processes_are_forked_than_there_are_groups(forked, monkeypatch):
    fork, forks = os.fork, []
    monkeypatch.setattr(os, "fork", lambda: forks.append(1) or fork())
    simulate_many([replace(BASIC, latency=Latency(command=0.002))] * 6, workers=50)
    assert len(forks) == 4


def test_a_killed_process_is_told():
    running = begun(6)
    mine = [pid for pid in children(running.pid) if b"-c" in Path(f"/proc/{pid}/cmdline").read_bytes()]
    assert mine
    os.kill(mine[0], signal.SIGKILL)
    _, err = running.communicate(timeout=120)
    assert running.returncode == 1 and "a process of the batch was killed" in err and "use fewer workers" in err


def test_only_large_batches_of_compiled_laws_fork_and_only_where_it_is_safe(monkeypatch):
    monkeypatch.setattr(threading, "active_count", lambda: 1)
    large = [replace(BASIC, timing=Timing(duration=5.0))] * 200
    assert batch.forks(large, 2)
    assert not batch.forks(large, 1) and not batch.forks(large[:10], 2)
    other = (replace(large[0], engine="ordinary"), replace(large[0], controller=PD(GAINS)))
    other += (replace(large[0], latency=Latency(command=0.001)), replace(large[0], timing=Timing(duration=4.0)))
    other += (replace(large[0], robot=replace(ROBOT, effort_limits=np.full_like(ROBOT.effort_limits, np.inf))),)
    assert not any(batch.forks([*large, one], 2) for one in other)
    fitting = (replace(large[0], robot=ROBOT.with_masses(1.2), seed=3), replace(large[0], trajectory=TURN))
    assert all(batch.forks([*large, one], 2) for one in fitting)
    monkeypatch.setattr(threading, "active_count", lambda: 2)
    assert not batch.forks(large, 2)

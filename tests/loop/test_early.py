"""Runs before the loop is compiled: the bits of the compiled loop, whatever way their calls go."""

from __future__ import annotations

import fcntl
import io
import json
import os
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numba import config
from numba.core.registry import CPUDispatcher

from mmnn_pin import load_experiment
from mmnn_pin.compiled import Internal, Plain, copy_to, entry, run_compiled, run_plainly
from mmnn_pin.lab.experiments.runner import run_experiment
from mmnn_pin.loop import compiled
from mmnn_pin.loop import early as module
from mmnn_pin.loop.compiled import CompiledLoop
from mmnn_pin.loop.early import Calls, early, is_compiling, wait
from mmnn_pin.recording.recording import Recording
from mmnn_pin.torque import law

pytestmark = pytest.mark.skipif(bool(config.DISABLE_JIT), reason="plain Python is compared with plain Python")

SIX = ["two_layer", "one_layer", "pd", "pd_effective", "pd_effective_one_layer", "computed_torque"]
NOISE = ["sensor.noise=1e-4", "sensor.velocity_noise=2e-3", "actuator.lag=0.002", "latency.command=0.002"]
CASES: dict[str, tuple[str, list[str], list[str]]] = {
    "chapter 4": ("chapter4", SIX, ["time.duration=0.1"]),
    "chapter 5": ("chapter5", ["two_layer", "pd"], ["time.duration=0.1"]),
    "motors with limits": ("track", ["two_layer", "pd_gravity", "pid", "computed_torque"], ["time.duration=0.08"]),
    "imperfect hardware": ("track", ["two_layer", "disturbance_observer"], ["time.duration=0.06", *NOISE]),
    "learners": ("track", ["adaptive", "kalman_regressor"], ["time.duration=0.05"]),
    "no base": ("track", ["two_layer"], ["time.duration=0.05", "robot='two_axis_arm'"]),
}


@pytest.fixture(autouse=True)
def started(monkeypatch: pytest.MonkeyPatch) -> list[CompiledLoop]:
    """The engines for which a process would have been started."""
    engines: list[CompiledLoop] = []
    monkeypatch.setattr(module, "compile_beside", engines.append)
    return engines


@pytest.fixture
def alone(monkeypatch: pytest.MonkeyPatch) -> Iterator[list[Calls]]:
    """All `Calls` that are made."""
    made: list[Calls] = []

    class Known(Calls):
        def __init__(self, *arguments: Any) -> None:
            super().__init__(*arguments)
            made.append(self)

    monkeypatch.setattr(module, "Calls", Known)
    return made


def nothing(name: str) -> None:
    """Tell nobody."""


def short(*controllers: str, experiment: str = "chapter4", changes: tuple[str, ...] = ("time.duration=0.06",)) -> Any:
    """An experiment."""
    return load_experiment(experiment, [f"controllers={list(controllers)}", *changes])


def assert_same(one: Recording, other: Recording) -> None:
    """Two recordings have the same bits."""
    assert one.outcome == other.outcome and tuple(one) == tuple(other)
    for name in one:
        np.testing.assert_array_equal(np.asarray(one[name]), np.asarray(other[name]), err_msg=name)
    for kept in ("final", "weights"):
        before, now = getattr(one, kept), getattr(other, kept)
        assert before.keys() == now.keys()
        for name in before:
            np.testing.assert_array_equal(before[name], now[name], err_msg=name)


@pytest.mark.parametrize("name", CASES)
def test_recordings_have_the_bits_of_the_compiled_loop(name: str, alone: list[Calls]) -> None:
    experiment, controllers, changes = CASES[name]
    asked = short(*controllers, experiment=experiment, changes=tuple(changes))
    with early(nothing):
        begun = run_experiment(asked, name)
    made = run_experiment(asked, name)
    for controller in controllers:
        assert_same(begun.recordings[controller], made.recordings[controller])
    by_code = [calls.count for calls in alone if calls.ways]
    assert len(by_code) >= 2 * len(controllers) and min(by_code) >= 20


def test_runs_of_one_robot_share_their_code(alone: list[Calls]) -> None:
    with early(nothing):
        run_experiment(short("pd", "computed_torque", "pd_effective"), "shared")  # and two_layer for its gain
    by_name: dict[str, list[Calls]] = {}
    for calls in alone:
        by_name.setdefault(calls.function.__name__, []).append(calls)
    assert len(by_name["observe"]) == 4 and len({id(calls.ways) for calls in by_name["observe"]}) == 1
    assert all(calls.count == 30 for calls in by_name["observe"]) and len(by_name["observe"][0].ways) == 1


def test_a_function_that_goes_many_ways_is_compiled(monkeypatch: pytest.MonkeyPatch, alone: list[Calls]) -> None:
    monkeypatch.setattr(module, "WAYS", 0)
    monkeypatch.setattr(module, "PLAIN", 3)
    asked = short("two_layer")
    with early(nothing):
        begun = run_experiment(asked, "many")
        assert not isinstance(compiled.observe, Plain) and all(not calls.can_be_noted for calls in alone)
    assert_same(begun.recordings["two_layer"], run_experiment(asked, "many").recordings["two_layer"])


def test_calls_that_go_another_way_are_noted_too(alone: list[Calls]) -> None:
    asked = short("two_layer", changes=("time.duration=0.4", "friction.coulomb=0.5"))
    with early(nothing):
        begun = run_experiment(asked, "ways")
    assert max(len(calls.ways) for calls in alone) > 1
    assert_same(begun.recordings["two_layer"], run_experiment(asked, "ways").recordings["two_layer"])


def test_a_run_that_diverges_ends_as_the_compiled_one(alone: list[Calls]) -> None:
    asked = short("pd", changes=("time.duration=0.3", "bounds.speed=0.05"))
    with early(nothing):
        begun = run_experiment(asked, "lost").recordings["pd"]
    assert begun.outcome.status == "diverged"
    assert_same(begun, run_experiment(asked, "lost").recordings["pd"])


def test_a_long_run_waits_for_compiled_code(monkeypatch: pytest.MonkeyPatch, started: list[CompiledLoop]) -> None:
    waited: list[str] = []
    monkeypatch.setattr(module, "LONG", 20)
    monkeypatch.setattr(module, "wait", lambda tell: waited.append("waited"))
    asked = short("pd", changes=("time.duration=0.3",))
    with early(nothing):
        begun = run_experiment(asked, "long")
        assert CompiledLoop.instead is None and not isinstance(compiled.observe, module.Function)
    assert waited == ["waited"] and len(started) == 1
    assert_same(begun.recordings["pd"], run_experiment(asked, "long").recordings["pd"])


def test_ctrl_c_keeps_what_is_done_and_leaves_nothing_behind() -> None:
    def stop(controller: str, fraction: float) -> None:
        if fraction > 0.5:
            raise KeyboardInterrupt

    before = compiled.observe, law.networks, type(copy_to)
    with early(nothing):
        run = run_experiment(short("pd", changes=("time.duration=0.4",)), "stopped", progress=stop).recordings["pd"]
        assert isinstance(copy_to, Plain)
    assert run.outcome.status == "interrupted" and 0.2 < run.time[-1] < 0.4
    assert (compiled.observe, law.networks, type(copy_to)) == before and CompiledLoop.instead is None


def test_python_runs_a_function_itself_until_it_is_compiled_again() -> None:
    kinds = type(entry), type(compiled.observe)
    run_plainly()
    try:
        assert isinstance(entry, Plain)
        signatures = len(copy_to.signatures)  # type: ignore[attr-defined]
        copy_to(np.ones(3, np.float32), target := np.zeros(3, np.float32))  # types that it is not compiled for
        assert target.tolist() == [1.0, 1.0, 1.0] and len(copy_to.signatures) == signatures  # type: ignore[attr-defined]
        run_compiled(entry)
        assert type(entry) is kinds[0] and isinstance(copy_to, Plain)
    finally:
        run_compiled()
    assert (type(entry), type(compiled.observe)) == kinds == (CPUDispatcher, Internal)


def law_of(a: Any, b: Any, x: float) -> float:
    """A function with branches, whose result is a number."""
    for i in range(a.size):
        if a[i] > b[i]:
            a[i] = a[i] * b[i] - x
        elif a[i] != 0.0:
            b[i] = abs(a[i]) / (1.0 + x * x)
    return a[0] + b[-1]


@settings(max_examples=30, deadline=None)
@given(st.lists(st.lists(st.floats(-1e3, 1e3), min_size=4, max_size=4), min_size=12, max_size=40), st.floats(-10, 10))
def test_code_does_what_python_does_or_nothing(values: list[list[float]], x: float) -> None:
    a, b = np.zeros(2), np.zeros(2)
    calls = Calls(law_of, (a, b, x))
    for row in values:
        a[:], b[:] = row[:2], row[2:]
        expected = a.copy(), b.copy()
        answer = law_of(*expected, x + row[0])
        assert float(calls((a, b, x + row[0]))) == float(answer)
        np.testing.assert_array_equal((a, b), expected)
    assert calls.ways


def test_one_process_compiles_at_a_time_and_is_waited_for(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "cache_folder", lambda: tmp_path)
    assert not is_compiling()
    with (tmp_path / module.LOCK).open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        assert is_compiling()
        told: list[str] = []

        def tell(what: str) -> None:
            told.append(what)
            fcntl.flock(lock, fcntl.LOCK_UN)

        wait(tell)
    assert len(told) == 1 and not is_compiling()


def test_where_no_lock_can_be_had_nothing_is_compiled_beside_and_the_run_goes_on(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As on a full disk, or in a cache where another user compiled."""
    (tmp_path / module.LOCK).mkdir()
    asked = short("pd")
    engine = asked.loop(asked.load_robot(), "pd").engine_at()
    with monkeypatch.context() as patch:
        patch.setattr(module, "cache_folder", lambda: tmp_path)
        patch.setattr(subprocess, "Popen", None)  # none may be begun
        module.compile_beside(engine)
        assert not is_compiling()


def test_the_process_compiles_what_the_run_needs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """It is told of an engine with a learner and a hardware model, and calls the loop with the same types."""
    asked = short("adaptive", experiment="track", changes=("time.duration=0.05",))
    robot = asked.load_robot()
    engine = asked.loop(robot, asked.controller("adaptive", robot=robot)).engine_at()
    assert engine.step(0, 1, 0) == -1
    given: list[Any] = []

    class Process:
        def __init__(self, command: list[str], stdin: Any, pass_fds: tuple[int, ...], **others: Any) -> None:
            given.append((command, stdin.read(), is_compiling(), len(pass_fds), others["start_new_session"]))

    monkeypatch.undo()
    with monkeypatch.context() as patch:
        patch.setattr(module, "cache_folder", lambda: tmp_path)
        patch.setattr(subprocess, "Popen", Process)
        module.compile_beside(engine)
    ((command, text, locked, kept, apart),) = given
    assert command[:-1] == [sys.executable, "-P", "-m", "mmnn_pin.loop.early"] and locked and kept == 2 and apart
    done: list[str] = []
    before = len(compiled.advance.signatures)  # type: ignore[attr-defined]
    for name in ("call_control_blocks", "call_plant_blocks"):
        monkeypatch.setattr(module, name, lambda name=name: done.append(name))
    monkeypatch.setattr(module.os, "nice", lambda more: done.append(f"nicer by {more}"))
    monkeypatch.setattr(sys, "stdin", io.StringIO(text.decode()))
    watched, held = os.pipe()  # held open: its parent lives
    monkeypatch.setattr(sys, "argv", ["early", str(watched)])
    module.main()
    assert done == ["nicer by 5", "call_control_blocks", "call_plant_blocks"]
    assert json.loads(text)["form"] and len(compiled.advance.signatures) == before  # type: ignore[attr-defined]
    os.write(held, b".")

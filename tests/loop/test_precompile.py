"""The first run compiles in two processes: what it compiles ahead is what a run then uses."""

from __future__ import annotations

import gc
import os
import subprocess
import sys
from multiprocessing import get_context
from types import SimpleNamespace

import numba
import pytest
from numba import config
from numba.core import event
from numba.core.event import unregister

from mmnn_pin.loop import precompile as module
from mmnn_pin.loop.precompile import precompile

SCRIPT = """
import sys
from dataclasses import replace
from numba.core.registry import CPUDispatcher
import mmnn_pin as mm
from mmnn_pin.loop.batch import simulate_many
from mmnn_pin.loop import precompile
precompile.call_control_blocks()
precompile.call_plant_blocks()
def versions():
    found = {}
    for name, module in list(sys.modules.items()):
        for key, function in vars(module).items() if name.startswith("mmnn_pin") else ():
            if isinstance(function, CPUDispatcher) and function.py_func.__module__ == name:
                found[f"{name}.{key}"] = len(function.signatures)
    return found
before = versions()
experiment = mm.load_experiment("chapter4", ["time.duration=0.02", 'time.integrator="semi_implicit_euler"'])
robot = experiment.load_robot()
for controller in ("two_layer", "computed_torque"):
    simulate_many([replace(experiment.loop(robot, experiment.controller(controller)), engine="compiled")])
new = sorted(name.rsplit(".", 1)[1] for name, count in versions().items() if count and not before.get(name)
             and not name.startswith("mmnn_pin.loop.compiled."))
several = [name for name, count in versions().items() if count > 1]
print(new, several)
"""


@pytest.mark.skipif(config.DISABLE_JIT, reason="nothing is compiled")
def test_a_run_compiles_only_the_loop_itself_after_it():
    done = subprocess.run([sys.executable, "-c", SCRIPT], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[] []"


class Process:
    """Stands in for the second process, which lives for two looks at it."""

    def __init__(self, started: list, fails: bool = False) -> None:
        self.started, self.fails, self.looks = started, fails, 2

    def start(self) -> None:
        self.started.append("start")

    def is_alive(self) -> bool:
        self.looks -= 1
        return self.looks >= 0

    def join(self, seconds: float) -> None:
        self.started.append("join")
        if self.fails:
            raise KeyboardInterrupt

    def kill(self) -> None:
        self.started.append("kill")


@pytest.fixture
def started(monkeypatch, tmp_path):
    """What was done, on a machine with two cores and an empty cache."""
    done = []

    def process(target, args, daemon):
        done.append((target, args[0], daemon))
        return Process(done, fails=module.FAILS)

    monkeypatch.setattr(module, "FAILS", False, raising=False)
    monkeypatch.setattr(module, "is_warm", lambda: False)
    monkeypatch.setattr(module, "cache_folder", lambda: tmp_path)
    monkeypatch.setattr(module.os, "cpu_count", lambda: 2)
    monkeypatch.setattr(module, "call_control_blocks", lambda: done.append("control"))
    monkeypatch.setattr(module, "get_context", lambda _: SimpleNamespace(Process=process))
    return done


def test_two_processes_share_the_work_and_the_second_one_is_ended(started):
    precompile(started.append)
    plant = (module.quietly, module.call_plant_blocks, True)
    assert started == [plant, "start", "control", "join", "the dynamics", "join", "the dynamics", "kill"]


def test_ctrl_c_ends_the_second_process(started, monkeypatch):
    monkeypatch.setattr(module, "FAILS", True)
    with pytest.raises(KeyboardInterrupt):
        precompile()
    assert started[-2:] == ["join", "kill"]


def test_the_second_process_prints_nothing_and_works(tmp_path, capfd):
    def work():
        os.write(1, b"seen")
        os.write(2, b"seen")
        (tmp_path / "done").write_text("done")

    other = get_context("fork").Process(target=module.quietly, args=(work, os.getpid()))
    other.start()
    other.join(60.0)
    assert other.exitcode == 0 and (tmp_path / "done").exists() and capfd.readouterr() == ("", "")


def test_rings_of_objects_are_looked_for_again_afterwards():
    with pytest.raises(KeyboardInterrupt), module.no_collection():
        assert not gc.isenabled()
        raise KeyboardInterrupt
    assert gc.isenabled()


@pytest.mark.skipif(config.DISABLE_JIT, reason="nothing is compiled")
def test_what_is_compiled_is_told_by_name():
    told = []
    before = list(event._registered["numba:compile"])
    module.when_compiling(told.append)
    (mine,) = [one for one in event._registered["numba:compile"] if one not in before]
    try:
        numba.njit(lambda x: x + 1.0)(1.0)
    finally:
        unregister("numba:compile", mine)
    assert told == ["<lambda>"]


@pytest.mark.parametrize(
    ("name", "value"), [("is_warm", lambda: True), ("cache_folder", lambda: None), ("os.cpu_count", lambda: 1)]
)
def test_nothing_is_started_where_it_would_not_help(started, monkeypatch, name, value):
    monkeypatch.setattr(f"mmnn_pin.loop.precompile.{name}", value)
    precompile()
    assert started == []

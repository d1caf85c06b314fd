"""The first run compiles in two processes: what it compiles ahead is what a run then uses."""

from __future__ import annotations

import subprocess
import sys

import pytest
from numba import config

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
    """Stands in for the second process."""

    def __init__(self, fails: bool = False) -> None:
        self.fails, self.calls = fails, []

    def wait(self) -> int:
        self.calls.append("wait")
        if self.fails:
            raise KeyboardInterrupt
        return 1

    def kill(self) -> None:
        self.calls.append("kill")


@pytest.fixture
def started(monkeypatch, tmp_path):
    """Commands that were started, on a machine with two cores and an empty cache."""
    commands = []
    monkeypatch.setattr(module, "is_warm", lambda: False)
    monkeypatch.setattr(module, "cache_folder", lambda: tmp_path)
    monkeypatch.setattr(module.os, "cpu_count", lambda: 2)
    monkeypatch.setattr(module, "call_control_blocks", lambda: commands.append("control"))
    monkeypatch.setattr(module, "PROCESS", Process(), raising=False)
    monkeypatch.setattr(module.subprocess, "Popen", lambda command, **_: commands.append(command) or module.PROCESS)
    return commands


def test_two_processes_share_the_work_and_the_second_one_is_ended(started):
    precompile()
    assert started == [[sys.executable, "-m", "mmnn_pin.loop.precompile"], "control"]
    assert module.PROCESS.calls == ["wait", "kill"]


def test_ctrl_c_ends_the_second_process(started, monkeypatch):
    monkeypatch.setattr(module, "PROCESS", Process(fails=True))
    with pytest.raises(KeyboardInterrupt):
        precompile()
    assert module.PROCESS.calls == ["wait", "kill"]


@pytest.mark.parametrize(
    ("name", "value"), [("is_warm", lambda: True), ("cache_folder", lambda: None), ("os.cpu_count", lambda: 1)]
)
def test_nothing_is_started_where_it_would_not_help(started, monkeypatch, name, value):
    monkeypatch.setattr(f"mmnn_pin.loop.precompile.{name}", value)
    precompile()
    assert started == []

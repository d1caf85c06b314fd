"""Ctrl-C is one line and the exit code 130, whenever it comes."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import pytest
from places import ROOT
from study_files import written

from mmnn_pin.cli import main, mmnn
from mmnn_pin.cli import ros2 as node
from mmnn_pin.deploy import ros2 as graph_side
from mmnn_pin.recording.recording import Outcome

LINE = "error: stopped by Ctrl-C\n"
WHILE_IMPORTED = """
import os, signal, sys, time
class Presses:
    def find_spec(self, name, path=None, target=None):
        if name == {name!r}:
            os.kill(os.getpid(), signal.SIGINT)
            time.sleep(0.5)
sys.meta_path.insert(0, Presses())
from mmnn_pin.cli import main
sys.exit(main())
"""
IN_A_DESTRUCTOR = """
import os, signal, sys, time
from mmnn_pin.cli import main
from mmnn_pin.model import loading
class Presses:
    def __del__(self):
        os.kill(os.getpid(), signal.SIGINT)
        time.sleep(0.01)
def load(*given, **more):
    Presses()
    time.sleep(600)
loading.load = load
sys.exit(main())
"""
AT_THE_END = """
import atexit, os, signal, sys, time
from mmnn_pin.cli import main
@atexit.register
def press():
    os.kill(os.getpid(), signal.SIGINT)
    time.sleep(0.5)
sys.exit(main())
"""
IMPORTED = ("lazy_loader", "click", "mmnn_pin.cli.study", "numpy", "pinocchio")
TEXTS = {name: WHILE_IMPORTED.format(name=name) for name in IMPORTED}
TEXTS |= {"destructor": IN_A_DESTRUCTOR, "end": AT_THE_END}


@pytest.mark.parametrize("moment", TEXTS)
def test_the_program_says_so_in_one_line(moment: str, tmp_path: Path) -> None:
    (tmp_path / "mmnn").write_text(TEXTS[moment])  # as it is installed
    done = subprocess.run(
        [sys.executable, str(tmp_path / "mmnn"), "model", "platform_arm"],
        env=os.environ | {"PYTHONPATH": str(ROOT)}, capture_output=True, text=True, timeout=300,
    )  # fmt: skip
    assert (done.returncode, done.stderr.lstrip()) == (130, LINE)


def test_an_error_that_comes_of_it_is_none_of_ours(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def turned(*_: object, **__: object) -> None:
        try:
            raise KeyboardInterrupt
        except KeyboardInterrupt as error:
            raise RuntimeError("Error calling __set_name__") from error

    monkeypatch.setattr(mmnn.commands["list"], "callback", turned)
    assert main(["list"]) == 130 and capsys.readouterr().err == LINE


@pytest.mark.parametrize("command", ["study", "tune"])
def test_before_the_first_row_there_is_nothing_else_to_tell(
    command: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def pressed(*_: object, **__: object) -> None:
        raise KeyboardInterrupt

    name = "mmnn_pin.lab.study.execution.fill" if command == "study" else "mmnn_pin.lab.study.tuning.Scorer.score"
    monkeypatch.setattr(name, pressed)
    file = written(tmp_path) if command == "study" else ROOT / "examples" / "tuning.toml"
    assert main([command, str(file), "--out", str(tmp_path / "out")]) == 130
    assert capsys.readouterr().err.splitlines()[-1] + "\n" == LINE


@pytest.mark.parametrize(
    ("status", "signal", "pressed", "code"),
    [
        ("tripped", "stop", True, 130),  # a Ctrl-C that stops the robot
        ("tripped", "stop", False, 1),  # its service
        ("tripped", "e[0]", True, 130),  # after a trip of another cause
        ("interrupted", "", True, 130),
        ("completed", "", False, 0),
    ],
)
def test_a_node_that_ctrl_c_stops_ends_with_130(
    status: str, signal: str, pressed: bool, code: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    run = SimpleNamespace(outcome=Outcome(status, 1.0, signal, "so it ended"), path=tmp_path / "run.h5")
    monkeypatch.setattr(sys.modules[node.callback.__module__], "require_rclpy", lambda: None)
    of_rclpy = SimpleNamespace(control=lambda *_: (run, pressed))
    monkeypatch.setitem(sys.modules, "mmnn_pin.deploy.ros2.node", of_rclpy)
    monkeypatch.setattr(graph_side, "node", of_rclpy, raising=False)
    assert main(["ros2", str(ROOT / "examples" / "robot" / "robot.yaml")]) == code


@pytest.mark.parametrize("closed", ["1", "2", "12"])
def test_closed_streams_are_no_error(closed: str) -> None:
    code = "from mmnn_pin.cli import main; raise SystemExit(main())"
    redirects = " ".join(f"{number}>&-" for number in closed)
    for command, expected in (("list", 0), ("inspect nonesuch", 2)):
        line = f"{sys.executable} -c '{code}' {command} {redirects}"
        done = subprocess.run(["bash", "-c", line], capture_output=True, text=True)
        assert done.returncode == expected and "internal error" not in done.stdout + done.stderr

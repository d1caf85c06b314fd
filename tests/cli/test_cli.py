"""The command line: what it prints, where, with which exit code, and that bad input leaves nothing behind."""

from __future__ import annotations

import json
import os
import re
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import click
import h5py
import numpy as np
import pytest

from mmnn_pin import Recording, load
from mmnn_pin.cli import main, mmnn
from mmnn_pin.cli.output import announce, interruptible
from mmnn_pin.lab.experiments.config import bundled, load_experiment
from mmnn_pin.lab.experiments.controllers import CONTROLLERS
from mmnn_pin.lab.show import comparison as table
from mmnn_pin.lab.show.table import broken, number
from mmnn_pin.model.dynamics import Dynamics

SHORT = ("--set", "time.duration=0.02")
ARM = ("--robot", "two_axis_arm", "--controller", "pd", "--set", "feedback.arm=1")
ALL = ["two_layer", "one_layer", "pd", "pd_effective", "pd_effective_one_layer", "computed_torque"]
Call = Callable[..., tuple[int, str, str]]


@pytest.fixture
def call(capsys: pytest.CaptureFixture[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Call:
    """Run the command line inside an empty folder: exit code, standard output, standard error."""
    (tmp_path / "here").mkdir()
    monkeypatch.chdir(tmp_path / "here")

    def run(*arguments: str | Path) -> tuple[int, str, str]:
        code = main([str(argument) for argument in arguments])
        return code, *capsys.readouterr()

    return run


@pytest.fixture
def undrawn(monkeypatch: pytest.MonkeyPatch) -> None:
    """The plot of a run is only a file: drawing takes longer than all the rest."""

    def draw(recordings: object, names: object, folder: Path, force: bool = True) -> dict[str, Path]:
        (folder / "errors.png").write_text("plot")
        return {"errors": folder / "errors.png"}

    monkeypatch.setattr("mmnn_pin.lab.show.gallery.write_pictures", draw)


@pytest.fixture(scope="module")
def short_run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder of a short run of chapter 4."""
    folder = tmp_path_factory.mktemp("runs") / "short"
    chosen = ("--controller", "pd", "--controller", "two_layer")
    assert main(["run", "chapter4", *SHORT, *chosen, "--out", str(folder)]) == 0
    return folder


def files_here() -> list[Path]:
    return sorted(Path().rglob("*"))


def only_line(err: str) -> str:
    """The one line of a complaint."""
    assert err.endswith("\n") and err.count("\n") == 1, err
    assert "Traceback" not in err and "error: " in err
    return err.strip()


# -- help --------------------------------------------------------------------------------------------------------------


def test_version(call: Call) -> None:
    from mmnn_pin import __version__

    code, out, _ = call("--version")
    assert code == 0 and __version__ in out


def test_without_arguments_the_help_is_shown(call: Call) -> None:
    assert call() == call("--help")


@pytest.mark.parametrize("command", ["run", "readings", "model", "plot", "inspect", "check", "list"])
def test_help_of_every_command_has_examples(call: Call, command: str) -> None:
    code, out, err = call(command, "--help")
    assert code == 0 and err == ""
    assert "Examples:" in out and f"  mmnn {command}" in out
    assert "--json" in out and "--debug" in out


@pytest.mark.parametrize("command", mmnn.commands.values(), ids=mmnn.commands)
def test_help_says_a_default_once_and_a_summary_whole(command: click.Command) -> None:
    records = [record for one in command.params if (record := one.get_help_record(click.Context(command)))]
    assert [name for name, text in records if text.count("[default: ") > 1] == []
    assert not command.get_short_help_str(100).endswith("...")


def test_help_imports_nothing_slow() -> None:
    code = "import sys, mmnn_pin.cli as c; c.main(['--help']); print(*sys.modules, file=sys.stderr)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    loaded = set(done.stderr.split())
    assert not loaded & {"numpy", "numba", "pinocchio", "matplotlib", "rich", "h5py", "scipy", "lxml"}


# -- run ---------------------------------------------------------------------------------------------------------------


def test_inspect_waits_for_no_compiler_and_says_the_same(call: Call) -> None:
    """In a process of its own numba is off, which must change nothing; in this one it is as it was."""
    code = "import sys; from mmnn_pin.cli import main; main(); import numba; assert numba.config.DISABLE_JIT"
    done = subprocess.run(
        [sys.executable, "-c", code, "inspect", "platform_arm", "--json"], capture_output=True, text=True, check=True
    )
    assert json.loads(done.stdout) == json.loads(call("inspect", "platform_arm", "--json")[1])


def test_run_writes_recordings_and_plot_and_prints_a_table(call: Call) -> None:
    code, out, _ = call("run", "chapter4", *SHORT, "--details")
    assert code == 0
    folder = Path("runs/chapter4")
    pictures = {f"{name}.png" for name in load_experiment("chapter4").plots}
    assert {f.name for f in folder.iterdir()} == {f"{c}.h5" for c in ALL} | pictures and len(pictures) == 6
    assert (folder / "errors.png").read_bytes().startswith(b"\x89PNG")
    for controller in ALL:
        assert f"wrote {folder / controller}.h5" in out
        recording = Recording.open(folder / f"{controller}.h5")
        assert recording.complete and len(recording) == 10 and recording.meta["experiment"] == "chapter4"
    head, _, rest = out.partition("wrote")
    said, table = head.splitlines()[:3], head.splitlines()[3:]
    assert [line.partition(":")[0] for line in said] == ["base", "arm", ""] and max(map(len, said)) <= 120
    assert max(map(len, table)) <= 100
    for words in (
        "pose x [mm]",
        "pose phi [mrad]",
        "velocity v [mm/s]",
        "velocity w [mrad/s]",
        "RMS 0-0.02 s",
        "effort",
    ):
        assert words in head
    assert head.count("done") == 6 and "effective gain" in head and "learned share" in head
    assert "No run lasts until the window in which it would be judged." in head
    assert rest.count("errors.png") == 1


@pytest.mark.usefixtures("undrawn")
def test_run_json_is_one_object_and_agrees_with_the_recordings(call: Call) -> None:
    code, out, _ = call("run", "chapter4", *SHORT, "--json")
    assert code == 0
    result = json.loads(out)
    assert set(result) >= {"experiment", "robot", "runs", "comparison"}
    assert (result["experiment"], result["robot"]) == ("chapter4", "platform_arm")
    assert list(result["runs"]) == ALL
    for run in result["runs"].values():
        recording = Recording.open(run["file"])
        assert run["outcome"] == recording.outcome.status == "completed"
        peak = np.abs(recording["pose_error"][:, 0]).max()
        assert run["metrics"]["pose_error.x.peak"] == pytest.approx(peak, rel=1e-12)
        assert run["metrics"]["pose_error.x.rms_1_5"] is None  # the window was not reached


@pytest.mark.usefixtures("undrawn")
def test_options_change_the_run(call: Call) -> None:
    done = call("run", "chapter4", *SHORT, "--controller", "pd", "--seed", "7", "--set", "feedback.base=123", "--json")
    runs = json.loads(done[1])["runs"]
    recording = Recording.open(runs["pd"]["file"])
    assert list(runs) == ["pd"] and recording.meta["seed"] == 7
    assert np.all(recording["effective_gain"][:, :2] == 123)
    assert json.loads(recording.config_text)["feedback"]["base"] == 123


@pytest.mark.usefixtures("undrawn")
def test_robot_option_runs_another_robot(call: Call) -> None:
    code, out, _ = call("run", "chapter4", *SHORT, *ARM, "--json")
    assert code == 0 and json.loads(out)["robot"] == "two_axis_arm"
    assert "z" not in Recording.open("runs/chapter4/pd.h5")


@pytest.mark.usefixtures("undrawn")
def test_table_of_a_fixed_arm_has_no_base_rows(call: Call) -> None:
    for details, row in ((["--details"], "joint arm_1_joint [mrad]"), ([], " arm_1_joint [mrad]")):
        code, out, _ = call("run", "chapter4", *SHORT, *ARM, *details)
        assert code == 0 and row in out and "pose" not in out and "base [mm]" not in out


@pytest.mark.usefixtures("undrawn")
def test_a_run_is_told_in_forty_lines_with_verdict_table_and_files(call: Call) -> None:
    code, out, _ = call("run", "chapter4", *SHORT)
    lines = out.splitlines()
    assert code == 0 and len(lines) <= 40 and lines[-1].endswith("into runs/chapter4")
    [row] = [line for line in lines if line.startswith(" arm_1_joint")]
    fair = [name for name in ALL if name != "computed_torque"]
    least = min(np.sqrt(np.mean(Recording.open(f"runs/chapter4/{name}.h5")["e"][:, 0] ** 2)) for name in fair)
    assert float(re.search(r"([0-9.e-]+) \*", row)[1]) == pytest.approx(1e3 * least, rel=0.01)  # type: ignore[index]


@pytest.mark.usefixtures("undrawn")
def test_own_toml_and_own_folder(call: Call) -> None:
    Path("mine.toml").write_text(bundled()["chapter4"].read_text())
    code, out, _ = call("run", "mine.toml", *SHORT, "--controller", "pd", "--out", "there", "--json")
    assert code == 0 and json.loads(out)["experiment"] == "mine"
    assert Path("there/pd.h5").exists() and Path("there/errors.png").exists()


@pytest.mark.usefixtures("undrawn")
def test_diverged_run_is_exit_code_1_and_says_where(call: Call) -> None:
    code, out, err = call("run", "chapter4", "--controller", "pd", *SHORT, "--set", "bounds.joint_speed=0.02")
    assert code == 1 and err == ""
    assert "diverged" in out and "note: pd: nu of " in out
    recording = Recording.open("runs/chapter4/pd.h5")
    assert recording.outcome.status == "diverged" and recording.outcome.signal.startswith("nu")
    assert 0 < recording.outcome.time < 0.02


@pytest.mark.usefixtures("undrawn")
def test_a_second_run_gets_a_numbered_folder_and_leaves_the_first_as_it_was(call: Call) -> None:
    command, first, second = ("run", "chapter4", "--controller", "pd", *SHORT), "runs/chapter4", "runs/chapter4-2"
    assert call(*command)[0] == 0
    before = {file: file.read_bytes() for file in files_here() if file.is_file()}
    code, out, _ = call(*command)
    assert code == 0 and f"wrote pd.h5, errors.png into {second}\n" in out
    assert sorted(map(str, Path("runs").iterdir())) == [first, second]
    code, out, err = call(*command, "--out", second)
    told = f"{second} has runs already: these go to {second}-2 (--force replaces them)"
    assert code == 0 and f"into {second}-2\n" in out and told in err
    assert {file: file.read_bytes() for file in before} == before
    assert call("run", "chapter4", "--controller", "pd", "--set", "time.duration=0.03", "--force")[0] == 0
    assert len(Recording.open(f"{first}/pd.h5")) == 15 and len(list(Path("runs").iterdir())) == 3


@pytest.mark.usefixtures("undrawn")
def test_a_refused_run_does_not_say_where_its_runs_go(call: Call) -> None:
    command = ("run", "chapter4", "--controller", "pd", *SHORT)
    assert call(*command)[0] == 0
    code, out, err = call(*command, "--set", "feedback.arm=1e9")
    assert code == 2 and "unstable" in err and "these go to" not in err + out
    assert [str(folder) for folder in Path("runs").iterdir()] == ["runs/chapter4"]
    assert "these go to runs/chapter4-2" in call(*command)[2]


@pytest.mark.usefixtures("undrawn")
def test_default_controllers_that_cannot_run_are_left_out_and_named_ones_are_refused(call: Call) -> None:
    joints = "wheel_left_joint", "wheel_right_joint", "arm_1_joint", "arm_2_joint"
    servos = ("--set", "interfaces={" + ",".join(f'{joint}="velocity"' for joint in joints) + "}")
    code, out, err = call("run", "track", *SHORT, *servos)
    assert code == 0 and "note: learned, pid, feedforward left out: they go by the torque" in out
    assert "pid.h5" not in out and "feedforward.h5" not in out
    assert f"note: driven {', '.join(joints)} by velocity" in out
    named = [("--controller", "pid"), ("--set", "controllers=['pd', 'pid']")]
    Path("own.toml").write_text('experiment = "track"\ncontrollers = ["pid", "pd"]\n')
    for name, more in [*(("track", more) for more in named), ("own.toml", ())]:
        code, out, err = call("run", name, *SHORT, *servos, *more)
        assert code == 2 and "pid on a velocity interface" in err and err.count("\n") == 1
    Path("own.toml").write_text('experiment = "track"\n')
    assert call("run", "own.toml", *SHORT, *servos)[0] == 0


@pytest.mark.usefixtures("undrawn")
def test_a_named_folder_is_used_unless_it_has_such_files(call: Call) -> None:
    Path("out").mkdir()
    Path("out/errors.png").write_text("mine")
    assert call("run", "chapter4", *SHORT, "--controller", "pd", "--out", "out")[0] == 0
    assert Path("out/errors.png").read_text() == "mine" and len(list(Path("out").iterdir())) == 1
    assert Path("out-2/pd.h5").is_file()
    _, out, err = call("run", "chapter4", *SHORT, "--controller", "pid", "--set", "plots=[]", "--out", "out-2")
    assert "into out-2\n" in out and "has runs" not in err  # beside those that are there
    assert call("run", "chapter4", *SHORT, "--controller", "pid", "--out", "out-2", "--force")[0] == 0
    assert not Path("out-2-2").exists() and not Path("out-3").exists()


def test_ctrl_c_keeps_what_is_recorded(tmp_path: Path) -> None:
    program = [sys.executable, "-c", "import sys; from mmnn_pin.cli import main; sys.exit(main())"]
    arguments = ["run", "chapter4", "--controller", "pd", "--controller", "computed_torque", "--json"]
    with subprocess.Popen(
        [*program, *arguments, "--set", "time.duration=1000"], cwd=tmp_path, stdout=subprocess.PIPE, text=True
    ) as run:
        file, end = tmp_path / "runs/chapter4/pd.h5", time.monotonic() + 100
        while time.monotonic() < end and not has_rows(file):
            time.sleep(0.2)
        run.send_signal(signal.SIGINT)
        out, _ = run.communicate(timeout=60)
    assert run.returncode == 130
    assert {name: run["outcome"] for name, run in json.loads(out)["runs"].items()} == {"pd": "interrupted"}
    recording = Recording.open(file)
    assert recording.complete and recording.outcome.status == "interrupted" and len(recording) > 0


@pytest.mark.usefixtures("undrawn")
def test_ctrl_c_that_python_swallows_is_not_lost(call: Call, monkeypatch: pytest.MonkeyPatch) -> None:
    class Deaf:
        def __del__(self) -> None:
            os.kill(os.getpid(), signal.SIGINT)
            time.sleep(0.1)  # the KeyboardInterrupt is raised and ignored in here

    from mmnn_pin.lab.experiments import runner

    order = runner.in_order

    def in_order(wanted: list[str]) -> list[str]:
        Deaf()
        return order(wanted)

    monkeypatch.setattr(runner, "in_order", in_order)
    monkeypatch.setattr(sys, "unraisablehook", lambda _: None)
    code, out, _ = call("run", "chapter4", "--controller", "pd", *SHORT)
    assert code == 130 and "interrupted" in out
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler


def test_a_run_in_another_thread_works(call: Call) -> None:
    from threading import Thread

    codes: list[int] = []
    thread = Thread(target=lambda: codes.append(main(["run", "chapter4", "--controller", "pd", *SHORT, "--json"])))
    thread.start()
    thread.join()
    assert codes == [0]


def has_rows(file: Path) -> bool:
    try:
        with h5py.File(file, "r", locking=False) as content:
            return len(content["signals/time"]) > 0
    except (OSError, KeyError):
        return False


@pytest.mark.usefixtures("undrawn")
def test_first_run_says_that_it_compiles(call: Call, monkeypatch: pytest.MonkeyPatch) -> None:
    import mmnn_pin.compiled

    monkeypatch.setattr(mmnn_pin.compiled, "is_warm", lambda: False)
    monkeypatch.setattr(mmnn_pin.compiled, "when_compiling", lambda tell: tell())  # as if something were
    announce.cache_clear()
    _, out, err = call("run", "chapter4", "--controller", "pd", *SHORT, "--json")
    assert "first run of this version: compiling takes" in err and json.loads(out)


@pytest.mark.parametrize("text", ["{}", "{}=1", "foo={}", "controllers=['{}']", "robot='{}'", "reference.file='{}'"])
def test_a_file_put_in_the_place_of_a_value_does_not_fill_the_screen(call: Call, text: str) -> None:
    code, _, err = call("run", "track", "--set", text.format("x" * 100_000))
    assert code == 2 and "error: " in err and len(err) < 4_000


def test_warm_compiles_ahead_and_writes_nothing_else(call: Call) -> None:
    code, out, _ = call("warm", "chapter4", "--controller", "pd", "--json")
    told = json.loads(out)
    assert (code, told["experiment"], told["controllers"]) == (0, "chapter4", ["pd"]) and told["seconds"] > 0.0
    assert not any(Path.cwd().iterdir())
    assert call("warm", "no_such_experiment")[0] == 2


@pytest.mark.usefixtures("undrawn")
def test_progress_is_shown_on_a_terminal_only(call: Call, monkeypatch: pytest.MonkeyPatch) -> None:
    assert call("run", "chapter4", "--controller", "pd", *SHORT)[2] == ""
    monkeypatch.setenv("TERM", "xterm")
    monkeypatch.setenv("FORCE_COLOR", "1")
    monkeypatch.setattr(sys.stderr, "isatty", lambda: True)
    code, out, err = call("run", "chapter4", "--controller", "pd", *SHORT, "--force", "--json")
    assert code == 0 and "pd" in err and json.loads(out)


@pytest.mark.usefixtures("undrawn")
def test_rank_one_weights_are_told(call: Call) -> None:
    zero = ("--set", "two_layer.initial=zero")
    code, out, _ = call("run", "chapter4", "--controller", "two_layer", *zero, *SHORT)
    assert code == 0 and "rank one" in out.partition("note: ")[2]


def test_a_ctrl_c_that_a_destructor_lost_at_the_very_end_is_told() -> None:
    text = """
import sys
sys.argv = ["mmnn"]
from mmnn_pin.program import heard
class Lost:
    def __del__(self):
        raise KeyboardInterrupt
with heard():
    Lost()
"""
    done = subprocess.run([sys.executable, "-c", text], capture_output=True, text=True)
    assert (done.returncode, done.stderr) == (130, "error: stopped by Ctrl-C\n")


# -- the table ---------------------------------------------------------------------------------------------------------


NONE_LOST: Any = SimpleNamespace(lost={})


def test_best_of_a_row_is_marked_but_never_the_oracle() -> None:
    cells = table.marked(NONE_LOST, {"pd": 2.0, "two_layer": 1.0, "one_layer": float("nan"), "computed_torque": 0.1})
    assert [f"{cell.text} {cell.mark}".strip() for cell in cells] == ["2.00", "1.00 *", "-", "0.100"]
    last = table.marked(NONE_LOST, {"pd": 2.0, "two_layer": 1.0, "computed_torque": 1.0})[2]
    assert (last.text, last.mark) == ("1.00", "")


def test_a_single_controller_is_not_best_of_anything() -> None:
    assert table.marked(NONE_LOST, {"pd": 2.0, "computed_torque": 3.0})[0].mark == ""


@pytest.mark.parametrize(
    ("value", "text"),
    [(0.0, "0"), (31.4159, "31.4"), (-0.0123456, "-0.0123"), (1234.5, "1234"), (1e-9, "1.0e-09"), (np.inf, "-")],
)
def test_three_digits(value: float, text: str) -> None:
    assert number(value) == text


@pytest.mark.parametrize("name", ALL)
def test_headings_are_short_and_keep_the_name(name: str) -> None:
    lines = broken(name, 9).split("\n")
    assert "_".join(lines) == name and max(map(len, lines)) <= 9


# -- bad input: exit code 2, one line, nothing written -----------------------------------------------------------------

BAD = {
    "unknown experiment": (["run", "chapter6"], ["unknown experiment 'chapter6'", "chapter4"]),
    "unknown robot": (["run", "chapter4", "--robot", "platform"], ["unknown robot", "platform_arm", "two_axis_arm"]),
    "unknown robot of model": (["model", "robbie"], ["unknown robot", "platform_arm"]),
    "unknown controller": (["run", "chapter4", "--controller", "lqr"], ["unknown controller 'lqr'", *ALL]),
    "unknown key": (["run", "chapter4", "--set", "feedback.bass=3"], ["feedback", "unknown key 'bass'", "base, arm"]),
    "unknown section": (["run", "chapter4", "--set", "feetback.base=3"], ["unknown key 'feetback'", "feedback"]),
    "unknown path": (["run", "chapter4", "--set", "reference.base.type=loop"], ["unknown type 'loop'", "line, circle"]),
    "unknown argument": (["run", "chapter4", "--set", "reference.base.sped=1"], ["unknown key 'sped'", "speed"]),
    "unknown input": (["run", "chapter4", "--set", "inputs.signals=['psi']"], ["unknown network input", "pose_ref"]),
    "unknown key that steers": (["run", "chapter4", "--set", "ti\x1bme.x=1"], ["--set ti me.x", "unknown key 'ti me'"]),
    "unknown limit": (
        ["embed", "chapter4", "--controller", "pd", "--out", "c", "--limits", "spede=1"],
        ["--limits", "unknown limit 'spede'", "did you mean 'speed'"],
    ),
    "text for a limit": (
        ["embed", "chapter4", "--controller", "pd", "--out", "c", "--limits", "speed=fast"],
        ["--limits speed", "'fast' is a text: give a number"],
    ),
    "no number of frames": (["replay", "x.h5", "--html", "x.html", "--fps", "nan"], ["--fps", "nan is no number"]),
    "no seconds to wait": (["ros2", "x.yaml", "--wait", "nan"], ["--wait", "nan is no number"]),
    "no load": (["judge", "x.h5", "--payload", "nan"], ["--payload", "nan is no number"]),
    "unknown command": (["fly"], ["unknown command 'fly'", "readings, model, plot"]),
    "unknown option": (["run", "chapter4", "--robt", "x"], ["unknown option '--robt'", "--robot"]),
    "an argument by name": (["view", "--robot", "x"], ["unknown option '--robot'", "mmnn view ROBOT"]),
    "unknown plot": (["plot", "x.h5", "--what", "wieghts"], ["wieghts", "errors", "psi"]),
    "missing argument": (["run"], ["EXPERIMENT", "--help"]),
    "missing toml": (["run", "mine.toml"], ["mine.toml", "no such file"]),
    "missing urdf": (["run", "chapter4", "--robot", "mine.urdf"], ["mine.urdf", "no such file"]),
    "missing state": (["model", "platform_arm", "--at", "s.json"], ["s.json", "cannot be read"]),
    "missing recording": (["plot", "x.h5"], ["x.h5", "no such recording"]),
    "folder as urdf": (["model", "/"], ["/", "folder"]),
    "number for a text": (["run", "chapter4", "--set", "robot=3"], ["robot", "3 is a whole number: give a text"]),
    "text for a number": (["run", "chapter4", "--set", "feedback.base=strong"], ["feedback.base", "str"]),
    "text for an integer": (["run", "chapter4", "--seed", "one"], ["--seed", "one"]),
    "float for an integer": (
        ["run", "chapter4", "--set", "two_layer.hidden=2.5"],
        ["two_layer.hidden", "2.5 is a number: give a whole number"],
    ),
    "wrong choice": (["run", "chapter4", "--set", "two_layer.initial=ones"], ["two_layer.initial", "ones"]),
    "too few numbers": (["run", "chapter4", "--set", "two_layer.F=[1.0]"], ["two_layer.F", "has one entry: give 2"]),
    "too many gains": (["run", "chapter4", "--set", "feedback.base=[1, 2, 3]"], ["feedback.base", "3", "2"]),
    "too many offsets": (["run", "chapter4", "--set", "start.joint_offset=[1, 2, 3]"], ["start.joint_offset", "3"]),
    "key into a number": (["run", "chapter4", "--set", "seed.value=3"], ["seed.value", "not a table"]),
    "place outside a list": (["run", "chapter4", "--set", "reference.arm.5.value=3"], ["reference.arm.5", "list of 2"]),
    "set without value": (["run", "chapter4", "--set", "seed"], ["'seed' sets nothing", "key.path=value"]),
    "negative gain": (["run", "chapter4", "--set", "feedback.arm=-1"], ["feedback.arm", "negative"]),
    "negative learning rate": (["run", "chapter4", "--set", "two_layer.F=[1, -1]"], ["two_layer.F", "negative"]),
    "range too wide": (["run", "chapter4", "--set", "two_layer.v_range=1.7e308"], ["two_layer.v_range", "smaller"]),
    "too many units": (
        ["run", "chapter4", "--set", "two_layer.hidden=2000000000"],
        ["two_layer.hidden", "memory and time grow with it", "use at most 10000"],
    ),
    "infinite gain": (["run", "chapter4", "--set", "kinematic.kx=inf"], ["kinematic.kx", "finite"]),
    "negative seed": (["run", "chapter4", "--seed", "-1"], ["seed", "-1"]),
    "unstable gain": (
        ["run", "chapter4", "--set", "feedback.base=1e6"],
        ["unstable", "spectral radius", "limit alone"],
    ),
    "control period": (["run", "chapter4", "--set", "time.control_period=0.003"], ["control_period", "divide"]),
    "plant step": (["run", "chapter4", "--set", "time.plant_step=0.0015"], ["plant_step", "divide"]),
    "sensor period": (["run", "chapter4", "--set", "time.sensor_period=0.0015"], ["divide", "0.0015"]),
    "no duration": (["run", "chapter4", "--set", "time.duration=0"], ["time.duration", "> 0"]),
    "no controllers": (["run", "chapter4", "--set", "controllers=[]"], ["no controllers", "two_layer"]),
    "same controller twice": (["run", "chapter4", "--set", "controllers=['pd', 'pd']"], ["controllers", "twice"]),
    "empty window": (["run", "chapter4", "--set", "windows=[[1.0, 1.0]]"], ["windows"]),
    "other suffix": (["plot", "x.h5", "--out", "x.bmp"], ["x.h5", "no such recording"]),
}


@pytest.mark.parametrize(("arguments", "words"), BAD.values(), ids=BAD)
def test_bad_input_is_one_line_and_leaves_nothing(call: Call, arguments: list[str], words: list[str]) -> None:
    code, out, err = call(*arguments)
    line = only_line(err)
    assert code == 2 and out == ""
    assert [word for word in words if word not in line] == [], line
    assert files_here() == []


@pytest.mark.parametrize("name", ["arguments", "file"])
def test_bad_input_with_json_is_one_object_too(call: Call, name: str) -> None:
    Path("bad.json").write_text('{"joints": {"elbow": 1.0}}')
    arguments = {"arguments": ["run", "chapter6"], "file": ["model", "platform_arm", "--at", "bad.json"]}[name]
    code, out, err = call(*arguments, "--json")
    error = json.loads(out)["error"]
    assert code == 2 and error["what"] in only_line(err) and error["what"].startswith("unknown")
    assert error["file"] == {"arguments": None, "file": "bad.json"}[name]


def numbers(value: object, key: str = "") -> list[str]:
    """Key paths of all floats in an experiment."""
    if isinstance(value, dict):
        return [path for name, inner in value.items() for path in numbers(inner, f"{key}.{name}".lstrip("."))]
    if isinstance(value, list):
        return [path for i, inner in enumerate(value) for path in numbers(inner, f"{key}.{i}")]
    return [key] if isinstance(value, float) else []


NUMBERS = numbers(json.loads(load_experiment("chapter4").to_json()))


@pytest.mark.parametrize("bad", ["nan", "inf"])
def test_a_number_that_is_not_finite_is_refused_wherever_it_stands(call: Call, bad: str) -> None:
    assert len(NUMBERS) > 40
    for key in (*NUMBERS, "inputs.constant_yaw_rate", "time.sensor_period"):
        code, _, err = call("run", "chapter4", "--controller", "two_layer", *SHORT, "--set", override(key, bad))
        assert code == 2, f"{key}: {err}"
        only_line(err)
    assert files_here() == []


def override(key: str, value: str) -> str:
    """Override of one number; of a whole list where the number is in one, since defaults are not in the TOML."""
    path, _, last = key.rpartition(".")
    if not last.isdecimal():
        return f"{key}={value}"
    whole = json.loads(load_experiment("chapter4").to_json())
    for part in path.split("."):
        whole = whole[int(part)] if isinstance(whole, list) else whole[part]
    path, whole, at = (path, whole, int(last))
    if path.rpartition(".")[2].isdecimal():  # windows: a list in a list
        return f"windows=[[0.0, {value}]]"
    return f"{path}=[{', '.join(value if i == at else str(x) for i, x in enumerate(whole))}]"


def test_unreadable_files_are_told(call: Call, tmp_path: Path) -> None:
    text = tmp_path / "text.toml"
    for content, words in ((b"a = [", "not valid TOML"), (b"\xff\xfe\x00", "UTF-8"), (b"x = 1", "unknown key 'x'")):
        text.write_bytes(content)
        code, _, err = call("run", text)
        assert code == 2 and words in only_line(err) and "text.toml" in err
    for content, words in ((b"<robot>", "XML"), (b"not a robot", "XML"), (b"<sdf/>", "SDF"), (b"", "empty")):
        (tmp_path / "robot.urdf").write_bytes(content)
        code, _, err = call("model", tmp_path / "robot.urdf")
        assert code == 2 and words in only_line(err) and "robot.urdf" in err
    (tmp_path / "run.h5").write_bytes(b"not HDF5")
    code, _, err = call("plot", tmp_path / "run.h5")
    assert code == 2 and "not an HDF5 file" in only_line(err)
    assert files_here() == []


def test_toml_syntax_errors_name_the_line(call: Call, tmp_path: Path) -> None:
    (tmp_path / "x.toml").write_text("robot = 'platform_arm'\nseed = = 3\n")
    assert "x.toml:2: error: not valid TOML" in only_line(call("run", tmp_path / "x.toml")[2])
    robot = only_line(call("run", Path(__file__).parents[2] / "urdf/platform_arm.urdf")[2])
    assert "it is XML, as a robot's URDF is: name the robot by --robot FILE" in robot


def test_output_below_a_file_cannot_be_written(call: Call) -> None:
    Path("file").write_text("mine")
    code, _, err = call("run", "chapter4", *SHORT, "--controller", "pd", "--out", "file/runs")
    assert code == 2 and "file" in only_line(err)
    assert Path("file").read_text() == "mine" and files_here() == [Path("file")]


@pytest.mark.skipif(os.geteuid() == 0, reason="root may write anywhere")
def test_output_in_a_folder_without_permission(call: Call) -> None:
    Path("locked").mkdir(mode=0o500)
    code, _, err = call("run", "chapter4", *SHORT, "--controller", "pd", "--out", "locked/runs")
    assert code == 2 and "locked" in only_line(err)


# -- errors that should not happen -------------------------------------------------------------------------------------


def test_unexpected_errors_are_one_line_unless_debug(call: Call, monkeypatch: pytest.MonkeyPatch) -> None:
    def broken(*_: object, **__: object) -> None:
        raise ZeroDivisionError("oh")

    monkeypatch.setattr("mmnn_pin.model.loading.load", broken)
    code, _, err = call("model", "platform_arm")
    assert code == 1 and "ZeroDivisionError: oh" in only_line(err)
    code, _, err = call("model", "platform_arm", "--debug")
    assert code == 1 and "Traceback" in err and "in broken" in err


def test_other_errors_of_the_package_are_failures(call: Call, monkeypatch: pytest.MonkeyPatch) -> None:
    from mmnn_pin.errors import MmnnError

    def failing(*_: object, **__: object) -> None:
        raise MmnnError("the simulation failed")

    monkeypatch.setattr("mmnn_pin.model.loading.load", failing)
    code, _, err = call("model", "platform_arm")
    assert code == 1 and only_line(err) == "error: the simulation failed"


def test_ctrl_c_outside_of_a_run(call: Call, monkeypatch: pytest.MonkeyPatch) -> None:
    def stopped(*_: object, **__: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr("mmnn_pin.model.loading.load", stopped)
    code, _, err = call("model", "platform_arm")
    assert code == 130 and "Ctrl-C" in err and "Traceback" not in err


def test_a_reader_that_leaves_is_no_error() -> None:
    program = "from mmnn_pin.cli import main; import sys; sys.exit(main(['list']))"
    with subprocess.Popen([sys.executable, "-c", program], stdout=subprocess.PIPE, stderr=subprocess.PIPE) as run:
        assert run.stdout is not None and run.stderr is not None
        run.stdout.close()
        err = run.stderr.read()
    assert run.returncode == 0 and err == b""


# -- model -------------------------------------------------------------------------------------------------------------

STATE = {
    "pose": [1.0, -2.0, 0.7],
    "base_velocity": [0.4, -0.6],
    "joints": {"arm_2_joint": 0.8, "arm_1_joint": -0.3, "wheel_left_joint": 2.0},
    "joint_velocities": {"arm_2_joint": 1.1},
}


def test_model_json_is_the_reduced_model(call: Call) -> None:
    Path("state.json").write_text(json.dumps(STATE))
    code, out, err = call("model", "platform_arm", "--at", "state.json", "--json")
    got = json.loads(out)
    assert code == 0 and err == ""
    robot = load("platform_arm")
    position, nu = robot.neutral_position(), np.array([0.4, -0.6, 0.0, 1.1])
    names = list(robot.position_names)
    position[:3] = STATE["pose"]
    for name, value in STATE["joints"].items():
        position[names.index(name)] = value
    dynamics = Dynamics(robot)
    assert got["velocity_names"] == ["v", "w", "arm_1_joint", "arm_2_joint"] and got["base"] == "differential_drive"
    np.testing.assert_allclose(got["M"], dynamics.mass_matrix(position), rtol=1e-12)
    np.testing.assert_allclose(got["C"], dynamics.coriolis_matrix(position, nu), rtol=1e-12, atol=1e-15)
    np.testing.assert_allclose(got["gravity"], dynamics.gravity(position), atol=1e-12)
    np.testing.assert_allclose(got["friction"], dynamics.friction(nu), atol=1e-12)
    A, T, E = (np.array(got[name]) for name in "ATE")
    assert len(got["full_velocity_names"]) == len(T) and np.abs(A @ T).max() < 1e-12
    assert np.linalg.matrix_rank(A) == len(T) - len(got["velocity_names"])
    wheels = [got["actuator_names"].index(f"wheel_{side}_joint") for side in ("left", "right")]
    assert np.allclose(E[0, wheels], 1 / 0.075) and np.allclose(E[1, wheels], [-0.171 / 0.075, 0.171 / 0.075])


def test_model_of_a_fixed_arm_and_without_a_state(call: Call) -> None:
    code, out, _ = call("model", "two_axis_arm", "--json")
    got = json.loads(out)
    assert code == 0 and got["base"] == "fixed" and got["A"] == [] and got["T"] == np.eye(2).tolist()
    assert np.all(np.array(got["C"]) == 0)


def test_model_text_names_rows_and_columns(call: Call) -> None:
    Path("state.json").write_text(json.dumps(STATE))
    code, out, _ = call("model", "platform_arm", "--at", "state.json")
    M = load("platform_arm"), json.loads(call("model", "platform_arm", "--at", "state.json", "--json")[1])["M"]
    row = next(line for line in out.splitlines() if line.split()[:1] == ["arm_1_joint"])
    assert code == 0 and row.split()[1:] == [f"{value:.5g}" for value in M[1][2]]
    assert "constraint 1" in out and "wheel_left_joint" in out
    assert "constraint" not in call("model", "two_axis_arm")[1].split(" T  ")[1]


def test_a_state_names_steering_and_hitch_angles(call: Call) -> None:
    """The linkage follows, and the maps are those of that place."""
    state = {"joints": {"front_left_steering_joint": 0.5, "hitch_joint": -0.7}, "base_velocity": [0.4, 0.1]}
    Path("state.json").write_text(json.dumps(state))
    turned = json.loads(call("model", "truck_trailer_arm", "--at", "state.json", "--json")[1])
    straight = json.loads(call("model", "truck_trailer_arm", "--json")[1])
    names, T = turned["full_velocity_names"], np.array(turned["T"])
    assert np.abs(np.array(turned["A"]) @ T).max() < 1e-12
    ratio = T[
        names.index("front_right_steering_joint"), 1
    ]  # cot of the right angle is cot of the left one, and 2 k / L
    cot = 1 / np.tan(0.5) + 2 * 0.17 / 0.6
    assert ratio == pytest.approx((1 / np.sin(0.5) ** 2) / (1 + cot**2), rel=1e-9)
    assert not np.allclose(T, straight["T"]) and np.any(turned["C"])
    Path("state.json").write_text('{"joints": {"front_left_steering_joint": 40}}')
    assert "beyond its limits" in call("model", "truck_trailer_arm", "--at", "state.json")[2]


BAD_STATES = {
    '{"pose": [1, 2]}': ["pose", "this has another length: give 3"],
    '{"pose": [1, 2, NaN]}': ["not valid JSON"],
    '{"pose": [1, 2, 1e999]}': ["pose"],
    '{"base_velocity": [1, 2, 3]}': ["base_velocity", "v, w"],
    '{"joints": {"elbow": 1}}': ["joints", "unknown joint 'elbow'", "arm_1_joint", "wheel_left_joint"],
    '{"joint_velocities": {"wheel_left_joint": 1}}': ["joint_velocities", "wheel_left_joint", "arm_1_joint"],
    '{"joints": {"arm_1_joint": "up"}}': ["joints", "a text: give a number"],
    '{"a\\nb": 1}': ["unknown key 'a b'", "there is: pose"],
    '{"Pose": [1, 2, 3]}': ["unknown key 'Pose'", "did you mean 'pose'"],
    "[1, 2, 3]": ["a list: give a table"],
    '{"pose": [1, 2, 3]': ["not valid JSON"],
}


@pytest.mark.parametrize(("state", "words"), BAD_STATES.items(), ids=BAD_STATES)
def test_bad_states_are_refused(call: Call, state: str, words: list[str]) -> None:
    Path("state.json").write_text(state)
    code, out, err = call("model", "platform_arm", "--at", "state.json")
    assert code == 2 and out == ""
    assert [word for word in ("state.json", *words) if word not in only_line(err)] == []


def test_a_pose_for_a_fixed_arm_is_refused(call: Call) -> None:
    Path("state.json").write_text('{"pose": [1, 2, 3]}')
    code, _, err = call("model", "two_axis_arm", "--at", "state.json")
    assert code == 2 and "fixed" in only_line(err)


# -- plot --------------------------------------------------------------------------------------------------------------


def test_the_suffix_is_the_format(call: Call, short_run: Path) -> None:
    code, out, err = call("plot", short_run / "pd.h5", "--what", "path", "--out", "there/x.svg")
    assert code == 0 and err == "" and "wrote there/x.svg" in out
    assert Path("there/x.svg").read_bytes().startswith(b"<?xml")


def test_several_plots_go_into_a_folder(call: Call, short_run: Path) -> None:
    whats = [word for what in ("torque", "path") for word in ("--what", what)]
    code, out, _ = call("plot", short_run, *whats, "--what", "path", "--out", "there", "--json")
    got = json.loads(out)
    assert code == 0 and [Path(run).stem for run in got["runs"]] == ["two_layer", "pd"]
    assert got["files"] == {what: f"there/{what}.png" for what in ("torque", "path")}
    assert sorted(str(file) for file in Path("there").iterdir()) == sorted(got["files"].values())


def test_a_picture_is_not_overwritten_unasked(call: Call, short_run: Path) -> None:
    Path("errors.png").write_text("mine")
    code, _, err = call("plot", short_run)
    assert code == 2 and "errors.png" in only_line(err) and Path("errors.png").read_text() == "mine"
    assert call("plot", short_run, "--force")[0] == 0 and Path("errors.png").read_bytes().startswith(b"\x89PNG")


@pytest.mark.usefixtures("undrawn")
def test_bad_plots_are_refused(call: Call, short_run: Path, tmp_path: Path) -> None:
    Path("empty").mkdir()
    arm = tmp_path / "arm"
    call("run", "chapter4", *SHORT, *ARM, "--out", arm)
    bad = {
        (str(short_run), "--out", "x.bmp"): [".bmp", ".svg"],
        (str(short_run), "--out", "x.png", "--what", "psi", "--what", "path"): ["2 plots", "folder"],
        ("empty",): ["no recordings"],
        (str(short_run), str(arm)): ["another robot", "arm_1_joint"],
        (str(arm), "--what", "path"): ["path"],
    }
    for arguments, words in bad.items():
        code, _, err = call("plot", *arguments)
        assert code == 2 and [word for word in words if word not in only_line(err)] == []
    assert files_here() == [Path("empty")]


def test_equal_controllers_are_told_apart_by_file(call: Call, short_run: Path, tmp_path: Path) -> None:
    from mmnn_pin.cli.results import by_name

    runs = [Recording.open(short_run / "pd.h5")] * 2
    runs[1] = Recording.open(short_run / "../short/pd.h5")
    assert list(by_name(runs)) == [str(run.path) for run in runs]


# -- list --------------------------------------------------------------------------------------------------------------


def test_list_names_all_there_is(call: Call) -> None:
    _, text, _ = call("list")
    code, out, _ = call("list", "--json")
    got = json.loads(out)
    assert code == 0 and set(got["controllers"]) == set(CONTROLLERS) > {*ALL}
    assert set(got["experiments"]) == set(bundled()) and {"platform_arm", "two_axis_arm"} <= set(got["robots"])
    assert set(got["references"]["base"]) == {"line", "circle", "eight", "waypoints", "parking"}
    for names in (*got.values(), *got["references"].values()):
        assert [name for name in names if name not in text and name not in ("base", "arm")] == []


def test_too_little_memory_is_one_line(call: Call, monkeypatch: pytest.MonkeyPatch) -> None:
    def fails(*_: object, **__: object) -> None:
        raise MemoryError("Unable to allocate 3 TiB")

    monkeypatch.setattr("mmnn_pin.lab.experiments.config.load_experiment", fails)
    code, _, err = call("run", "chapter4")
    assert code == 2 and "not enough memory: Unable to allocate 3 TiB: use a shorter duration" in only_line(err)


def test_ctrl_c_that_a_compiler_swallows_is_not_a_fault_of_ours() -> None:
    """Numba's callback prints a KeyboardInterrupt and fails later, in its own way."""
    with pytest.raises(KeyboardInterrupt), interruptible(lambda: None):
        with suppress(KeyboardInterrupt):
            os.kill(os.getpid(), signal.SIGINT)
        raise RuntimeError("no compiled object yet")
    with pytest.raises(RuntimeError), interruptible(lambda: None):
        raise RuntimeError("a fault indeed")


@pytest.mark.parametrize(
    ("experiment", "keys"),
    [
        ("certified", "reference.arm, feedback.arm, friction.arm"),
        ("eight", "reference.arm, feedback.arm, sensor.velocity_noise"),
        ("chapter4", "reference.arm"),
    ],
)
def test_an_experiment_that_is_made_for_another_robot_says_so(experiment, keys, tmp_path, capsys):
    """Keys of so many joints, and the experiment to take; that one takes it."""
    file = tmp_path / "three.urdf"
    third = '<link name="hand"><inertial><mass value="0.2"/><inertia ixx="1e-3" ixy="0" ixz="0" iyy="1e-3" iyz="0" '
    third += 'izz="1e-3"/></inertial></link><joint name="wrist" type="revolute"><parent link="arm_tip"/><child '
    third += 'link="hand"/><axis xyz="0 0 1"/><limit lower="-1" upper="1" effort="9" velocity="5"/></joint></robot>'
    file.write_text(load("platform_arm").path.read_text().replace("</robot>", third))
    assert main(["run", experiment, "--robot", str(file), "--controller", "pd", "--out", str(tmp_path / "out")]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    about = (
        f"--robot: error: {experiment} is made for platform_arm and its 2 arm joints: {keys}: three has 3 arm joints"
    )
    advised = f"mmnn run track --robot {file}"
    assert line.startswith(about) and advised in line and not (tmp_path / "out").exists()
    if experiment == "chapter4":  # the advice is the same for all
        words = [
            "--controller",
            "pd",
            "--set",
            "time.duration=0.02",
            "--set",
            "plots=[]",
            "--out",
            str(tmp_path / "on"),
        ]
        assert main([*advised.split()[1:], *words]) == 0


def test_a_list_of_the_users_own_is_told_as_it_is(tmp_path, capsys):
    words = ["--set", "friction.arm=[1,2]", "--controller", "pd", "--out", str(tmp_path / "out")]
    assert main(["run", "track", "--robot", "ur5", *words]) == 2
    assert "friction.arm: error: 2 numbers for 6 velocities" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("change", "begins"),
    [
        ("reference.base.lenght=3", "--set reference.base.lenght: error: unknown key 'lenght': did you mean 'length'?"),
        (
            "reference.base.type=circel",
            "--set reference.base.type: error: unknown type 'circel': did you mean 'circle'",
        ),
        ("reference.arm.amplitude=x", "--set reference.arm.amplitude: error: 'x' is a text"),
        ("reference.base.length=-3", "--set reference.base.length: error: length = -3.0 is not positive"),
        ("reference.arm=[]", "--set reference.arm: error: 0 profiles for 2 arm joints"),
        ("feedback.arm=1e9", "--set feedback: error: the sampled PD loop is unstable"),
    ],
)
def test_an_error_met_while_the_run_is_made_names_the_option_it_came_from(change: str, begins: str, call: Call) -> None:
    code, _, err = call("run", "track", "--controller", "pd", "--set", change)
    assert code == 2 and err.startswith(begins) and err.count("\n") == 1 and not files_here(), err
    code, _, err = call("embed", "track", "--controller", "pd", "--out", "c", "--set", change)
    assert code == 2 and err.startswith(begins) and not files_here(), err


def test_an_error_met_while_the_run_is_made_names_the_line_of_the_file_it_came_from(call: Call) -> None:
    Path("mine.toml").write_text('experiment = "track"\n\n[reference.base]\ntype = "circel"\n')
    assert call("run", "mine.toml")[2].startswith("mine.toml:4:reference.base.type: error: unknown type 'circel'")
    Path("next.toml").write_text('experiment = "mine.toml"\n[time]\nduration = 2.0\n')
    assert call("run", "next.toml")[2].startswith("mine.toml:4:reference.base.type: error: unknown type 'circel'")
    key = ("--set", "reference.base={type='circle', radius=-1, speed=0.3}")
    assert call("run", "next.toml", *key)[2].startswith(
        "--set reference.base.radius: error: radius = -1.0 is not positive"
    )
    Path("mine.toml").write_text('experiment = "track"\ncontrollers = ["pd"]\n[feedback]\nbase = 1.0\narm = 1e9\n')
    assert call("run", "mine.toml")[2].startswith("mine.toml:3:feedback: error: the sampled PD loop is unstable")

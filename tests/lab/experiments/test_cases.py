"""Experiments in cases: changes of keys, verdicts on runs, and the fault matrix that comes with the package."""

from __future__ import annotations

import json
from dataclasses import replace

import builders
import msgspec
import numpy as np
import pytest

from mmnn_pin.cli import main
from mmnn_pin.errors import ConfigError, InputError, UnknownName
from mmnn_pin.lab.experiments.cases import judge, run_cases, with_case
from mmnn_pin.lab.experiments.config import load_experiment, merged
from mmnn_pin.lab.experiments.experiment import Case, Tolerance
from mmnn_pin.lab.show import comparison as shown
from mmnn_pin.recording.recording import Outcome

NAMES = {"velocity_names": ("v", "w", "a", "b"), "actuator_names": ("l", "r", "a", "b"), "control_period": 0.01}
LOOSE = Tolerance(settle=0.5, pose=0.05, joint=0.05, runaway=0.3)


def recording(outcome=None, *, away=0.0, turned=0.0, joint=0.0, speed=0.0, drive=0.0, broken=False):
    """Two seconds in which the last second is off by the given errors, and moves at the given speed."""
    time = 0.01 * np.arange(200)[:, None]
    late = time >= 1.0
    signals = {
        "true_pose_error": late * (0.6 * away, 0.8 * away, turned),
        "true_e": late * (0.0, -joint),
        "nu": late * (0.0, speed, 0.0, 0.0),
        "position": (time >= 1.5) * (drive, 0, 0, 0, 0, 0, 0),
        "psi": np.where(np.arange(200)[:, None] == 120, np.nan, 0.0) if broken else 0.0,
    }
    return builders.recording(rows=200, period=0.01, signals=signals, outcome=outcome, **NAMES)


TRIPPED = Outcome("tripped", 1.2, "e[0]", "tripped at t = 1.2 s: joint error of a 0.21, 0.01 over its limit of 0.2")


@pytest.mark.parametrize(
    ("outcome", "errors", "kind", "says"),
    [
        (None, {"away": 0.049, "joint": 0.049}, "tracked", "within"),
        (None, {"away": 0.051}, "failed", "not stopped: pose 0.051 over 0.05"),
        (None, {"joint": 0.06}, "failed", "not stopped: joint 0.06"),
        (None, {"turned": 0.2}, "failed", "not stopped: heading 0.2"),
        (None, {"broken": True}, "failed", "psi not finite"),
        (TRIPPED, {"away": 0.2}, "stopped", "joint error of a"),
        (TRIPPED, {"away": 0.4}, "failed", "0.4 m away when it tripped"),
        (TRIPPED, {"speed": 0.03}, "failed", "the base moves at 0.03"),
        (TRIPPED, {"drive": 0.5}, "failed", "it drove 0.5 m after the trip"),
        (TRIPPED, {"broken": True}, "failed", "psi not finite"),
        (Outcome("diverged", 1.0, "nu[0]", "nu[0] left its bounds"), {}, "failed", "left its bounds"),
        (Outcome("interrupted", 1.0, "", "stopped by Ctrl-C"), {}, "interrupted", "Ctrl-C"),
    ],
)
def test_a_run_tracked_or_was_stopped_safely_or_failed(outcome, errors, kind, says):
    verdict = judge(recording(outcome, **errors), LOOSE)
    assert verdict.kind == kind and says in verdict.text


def test_errors_count_after_settling_only():
    assert judge(recording(away=1.0), Tolerance(settle=1.9999)).kind == "tracked"  # no sample is that late
    assert judge(recording(away=1.0), Tolerance(settle=1.95)).kind == "failed"


def test_tables_merge_and_lists_are_replaced():
    table = {"a": {"b": 1, "c": [1, 2]}, "d": 3}
    assert merged(table, {"a": {"c": [5]}, "e": {"f": 1}}) == {"a": {"b": 1, "c": [5]}, "d": 3, "e": {"f": 1}}
    assert table == {"a": {"b": 1, "c": [1, 2]}, "d": 3}


def test_a_table_of_another_type_replaces_the_old_one():
    table = {"base": {"type": "eight", "length": 3.0, "period": 6.0}}
    assert merged(table, {"base": {"type": "circle", "radius": 1.0}}) == {"base": {"type": "circle", "radius": 1.0}}
    for change in ({"period": 7.0}, {"type": "eight", "period": 7.0}):
        assert merged(table, {"base": change})["base"] == {"type": "eight", "length": 3.0, "period": 7.0}


FAULTS = load_experiment("faults")
LEAN = """
title = "lean"
experiment = "chapter4"
seed = 5
feedback.arm = 20.0

[cases.own]
title = "as it is"

[cases.eight]
title = "from another one"
experiment = "eight"
set.kinematic.K = 5.0

[cases.beside]
title = "from a file beside it"
experiment = "other.toml"
"""


def written(folder, text, other="experiment = 'track'\nwindows = [[0.0, 1.0]]\n"):
    (folder / "other.toml").write_text(other)
    (folder / "lean.toml").write_text(text)
    return folder / "lean.toml"


def test_an_experiment_and_its_cases_may_start_from_others(tmp_path):
    """The file's own keys hold everywhere, overrides above them, and a case has the last word."""
    path = written(tmp_path, LEAN)
    lean, chapter4 = load_experiment(path), load_experiment("chapter4")
    assert lean.reference == chapter4.reference and lean.two_layer == chapter4.two_layer and lean.seed == 5
    assert (lean.title, lean.variant, lean.feedback.arm, lean.feedback.base) == ("lean", "", 20.0, 500.0)
    eight, beside = with_case(lean, "eight"), with_case(lean, "beside")
    assert eight.reference == load_experiment("eight").reference and with_case(lean, "own").kinematic.K == 7.0
    assert (eight.seed, eight.feedback.arm, eight.kinematic.K, eight.kinematic.kx) == (5, 20.0, 5.0, 10.0)
    assert beside.windows == ((0.0, 1.0),) and beside.reference.share == 0.75 and beside.feedback.arm == 20.0
    changed = load_experiment(path, ["feedback.arm=3.0", "kinematic.K=1.0", "cases.own.set.seed=9"])
    for name, K in (("own", 1.0), ("eight", 5.0), ("beside", 1.0)):
        one = with_case(changed, name)
        assert (one.feedback.arm, one.kinematic.K, one.seed) == (3.0, K, 9 if name == "own" else 5)
        assert not one.cases


@pytest.mark.parametrize(
    ("text", "other", "says"),
    [
        ("experiment = 'lean.toml'", "", "starts from itself"),
        ("experiment = 'other.toml'", "experiment = 'lean.toml'", "starts from itself"),
        ("experiment = 'chapter9'", "", "unknown experiment 'chapter9'"),
        ("experiment = 'chapter4'\n[cases.a]\ntitle='a'\nexperiment='none.toml'", "", "no such file"),
        ("experiment = 'chapter4'\n[cases.a]\ntitle='a'\nexperiment='other.toml'", "experiment = [", "not valid TOML"),
    ],
)
def test_a_start_that_cannot_be_is_named(tmp_path, text, other, says):
    with pytest.raises(InputError, match=says):
        load_experiment(written(tmp_path, text, other))


def changed(**cases):
    return msgspec.structs.replace(FAULTS, cases={name: Case("a case", keys) for name, keys in cases.items()})


@pytest.mark.parametrize(
    ("keys", "error", "where"),
    [
        ({"sensr": {}}, ConfigError, "cases.mine.set"),
        ({"time": {"duration": "long"}}, ConfigError, "cases.mine.set.time.duration"),
        ({"sensor": {"loss": 1.5}}, ConfigError, "cases.mine.set.sensor.loss"),
        ({"actuator": {"gap": 0.1}}, ConfigError, "cases.mine.set.actuator.rotor_inertia"),
        ({"plant": "lunar"}, UnknownName, "cases.mine.set.plant"),
    ],
)
def test_a_case_that_changes_what_is_not_there_is_named(keys, error, where):
    with pytest.raises(error) as caught:
        with_case(changed(mine=keys), "mine")
    assert caught.value.key == where


def test_a_case_may_be_on_hardware_of_its_own():
    track = load_experiment("track", ['robot="two_axis_arm"'])
    cases = {"slow": Case("slow", {"hardware": "unknown"}), "wrong": Case("wrong", {"hardware": "none"})}
    found = with_case(msgspec.structs.replace(track, cases=cases), "slow")
    alone = load_experiment("track", ['robot="two_axis_arm"', 'hardware="unknown"'])
    assert found == msgspec.structs.replace(alone, title=found.title) and found.interfaces
    with pytest.raises(UnknownName, match="none") as caught:
        with_case(msgspec.structs.replace(track, cases=cases), "wrong")
    assert caught.value.key == "cases.wrong.set.hardware"
    with pytest.raises(ConfigError, match="the experiment has hardware"):
        with_case(msgspec.structs.replace(alone, cases=cases), "slow")


def test_a_case_that_cannot_run_is_refused_before_anything_is_written(tmp_path):
    joint = {"disturbances": [{"type": "dead_motor", "joint": "tail"}]}
    with pytest.raises(InputError, match="tail") as caught:
        run_cases(changed(fine={}, mine=joint), "x", out=tmp_path / "out")
    assert "cases.mine" in str(caught.value.key) and not (tmp_path / "out").exists()


def test_a_robot_that_runs_on_while_its_sensors_see_nothing_fails():
    """Without limits nothing stops it, and what the sensors say looks well."""
    frozen = {"disturbances": [{"type": "frozen_encoder", "joint": "arm_1_joint", "start": 0.5}], "safety": None}
    short = changed(none={}, frozen=frozen)
    time = msgspec.structs.replace(short.time, duration=1.5)
    matrix = run_cases(msgspec.structs.replace(short, controllers=("pd",), time=time), "x")
    assert matrix.verdicts["none"]["pd"].kind == "tracked"
    assert matrix.verdicts["frozen"]["pd"].kind == "failed" and "joint" in matrix.verdicts["frozen"]["pd"].text
    assert not matrix.completed and matrix.count("failed") == 1
    text = shown.render_cases(matrix)
    assert "FAILED: not stopped: joint" in text and "2 runs: 1 tracked, 0 stopped, 1 failed" in text


STOPPED = ("sensor_killed", "nan_forever", "frozen_arm", "blocked_wheel", "command_lost")


def test_a_part_of_the_fault_matrix_tracks_or_is_stopped_safely(tmp_path, capsys):
    cases = [word for case in ("none", "blocked_wheel", "command_lost") for word in ("--case", case)]
    assert main(["run", "faults", *cases, "--controller", "pd", "--json", "--out", str(tmp_path / "out")]) == 0
    cells = json.loads(capsys.readouterr().out)["comparison"]["verdicts"]
    assert {case: row["pd"]["kind"] for case, row in cells.items()} == {
        "none": "tracked", "blocked_wheel": "stopped", "command_lost": "stopped",
    }  # fmt: skip


@pytest.mark.long
def test_every_cell_of_the_fault_matrix_tracks_or_is_stopped_safely(tmp_path, capsys):
    """The bundled matrix as the command runs it: at least 20 faults, three controllers, no cell without a verdict."""
    out = tmp_path / "out"
    assert main(["run", "faults", "--json", "--out", str(out)]) == 0
    found = json.loads(capsys.readouterr().out)
    cells = found["comparison"]["verdicts"]
    assert len(cells) - 1 >= 20 and all(set(row) == {"pd", "one_layer", "two_layer"} for row in cells.values())
    kinds = {cell["kind"] for row in cells.values() for cell in row.values()}
    assert kinds == {"tracked", "stopped"}
    assert {cell["kind"] for cell in cells["none"].values()} == {"tracked"}
    for case in STOPPED:
        assert {cell["kind"] for cell in cells[case].values()} == {"stopped"}, case
    assert len(list(out.rglob("*.h5"))) == 3 * len(cells)
    assert main(["run", "faults", "--out", str(out)]) == 2 and "--force" in capsys.readouterr().err


def test_a_fault_that_fails_makes_the_command_fail(tmp_path, capsys):
    arguments = ["--controller", "pd", "--set", "time.duration=1.5", "--set", "tolerance.pose=1e-6"]
    keep = ["--set", 'cases={none={title="no fault"}}']
    assert main(["run", "faults", *arguments, *keep, "--out", str(tmp_path / "out")]) == 1
    assert "FAILED: not stopped: pose" in capsys.readouterr().out


def test_recordings_say_which_case_they_are(tmp_path):
    time = msgspec.structs.replace(FAULTS.time, duration=0.5)
    one = replace_controllers(changed(quiet={"tolerance": {"settle": 0.2}}), time)
    matrix = run_cases(one, "faults", out=tmp_path)
    assert (tmp_path / "quiet" / "pd.h5").is_file()
    assert matrix.results["quiet"].recordings["pd"].meta["experiment"] == "faults/quiet"


def replace_controllers(experiment, time):
    return msgspec.structs.replace(experiment, controllers=("pd",), time=time)


def test_verdicts_are_data():
    verdict = judge(recording(), LOOSE)
    assert replace(verdict, kind="failed").kind == "failed"
    assert msgspec.to_builtins(verdict)["kind"] == "tracked"

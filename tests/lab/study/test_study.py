"""Studies as they run: the same numbers as alone, everywhere; nothing lost by kills, full disks or changed settings."""

from __future__ import annotations

import json
import signal
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import msgspec
import numpy as np
import pytest
from numba import config
from places import ROOT
from study_files import SHORT, numbers, planned, run_here, stored, told, written

from mmnn_pin import Recording, load
from mmnn_pin.cli import main
from mmnn_pin.errors import StudyError
from mmnn_pin.lab.experiments.config import load_experiment
from mmnn_pin.lab.experiments.runner import run_experiment
from mmnn_pin.lab.study import worker
from mmnn_pin.lab.study.execution import fill, missing_trials, probe
from mmnn_pin.lab.study.plan import StudyPlan
from mmnn_pin.lab.study.pools import here, processes
from mmnn_pin.lab.study.results import load_results
from mmnn_pin.lab.study.store import NAME, OLD_NAME, TrialResult, reading, writing
from mmnn_pin.lab.study.worker import loop_of
from mmnn_pin.loop.batch import simulate

compiled_only = pytest.mark.skipif(config.DISABLE_JIT, reason="slow in plain Python")
BASE = ["time.duration=0.04", "windows=[[0.0,0.02],[0.02,0.04]]"]  # what the short study changes


@pytest.fixture(scope="module")
def done(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, StudyPlan, list[TrialResult]]:
    """A study that has run: its folder, plan and rows."""
    folder = tmp_path_factory.mktemp("study")
    plan = planned(folder)
    return folder, plan, run_here(plan, folder)


# -- numbers ----------------------------------------------------------------------------------------------------------


def test_all_rows_are_there_once(done) -> None:
    _, plan, rows = done
    assert [row.id for row in rows] == list(range(len(plan)))
    assert {row.status for row in rows} == {"completed"}
    assert [row.fingerprint for row in rows] == list(plan.fingerprints)


def test_a_row_is_the_run_that_its_settings_make_by_hand(done) -> None:
    _, _, rows = done
    base = load_experiment("chapter4", BASE)
    for row in rows[::5]:
        p = row.parameters
        factor = p["friction"]
        friction = [30 * factor, 5 * factor, 0.5 * factor, 0.5 * factor]
        believed = load("platform_arm").with_friction([30.0, 5.0, 0.5, 0.5])
        robot = load("platform_arm").with_masses({"root": p["masses.root"]}).with_friction(friction)
        loop = base.loop(robot, base.controller(row.controller))
        timing = msgspec.structs.replace(base.time, control_period=p["time.control_period"])
        loop = replace(loop, seed=row.seed, timing=timing, nominal=believed, check_gains=False)
        assert told(simulate(loop, None, base.windows, False, bool).metrics) == told(row.metrics)


def test_without_factors_it_is_the_experiment_itself_also_at_an_effective_gain(tmp_path: Path) -> None:
    text = SHORT[: SHORT.index("[sampling]")].replace('"computed_torque"]', '"pd_effective"]')
    rows = run_here(planned(tmp_path, text), tmp_path)
    overrides = [
        "time.duration=0.04",
        "windows=[[0.0,0.02],[0.02,0.04]]",
        'controllers=["pd","two_layer","pd_effective"]',
    ]
    expected = run_experiment(load_experiment("chapter4", overrides), "chapter4").metrics
    assert {row.controller: told(row.metrics) for row in rows} == {name: told(m) for name, m in expected.items()}


def test_the_model_is_the_nominal_one_or_the_true_one(done, tmp_path: Path) -> None:
    _, plan, rows = done
    true = run_here(planned(tmp_path, 'model = "true"\n' + SHORT), tmp_path)
    for one, other in zip(rows, true, strict=True):
        assert (told(one.metrics) == told(other.metrics)) == (one.controller != "computed_torque")
    assert loop_of(plan.trial(2)).nominal.masses == {"root": 1.0, **dict.fromkeys(plan.table["masses"], 1.0)}


@compiled_only
def test_processes_give_the_same_rows_as_this_one(done, tmp_path: Path) -> None:
    _, plan, rows = done
    assert numbers(run_here(plan, tmp_path, processes(2))) == numbers(rows)


def test_a_row_is_replayed_alone_with_all_signals_and_the_same_numbers(done, capsys) -> None:
    folder, _, rows = done
    for number in (1, 2):
        assert main(["study", str(folder / "short.toml"), "--row", str(number), "--out", str(folder), "--json"]) == 0
        found = json.loads(capsys.readouterr().out)
        assert found["same"] is True and found["parameters"] == rows[number].parameters
        recording = Recording.open(found["file"])
        assert recording["torque"].shape[0] == round(0.04 / rows[number].parameters["time.control_period"])
    assert main(["study", str(folder / "short.toml"), "--row", "1", "--out", str(folder)]) == 2
    assert "the file exists" in capsys.readouterr().err


def test_a_replay_that_gives_other_numbers_says_so(done, tmp_path: Path, capsys) -> None:
    folder, _, _ = done
    (tmp_path / NAME).write_bytes((folder / NAME).read_bytes())
    with writing(tmp_path / NAME) as store:
        result = store.results[3]
        store.add(msgspec.structs.replace(result, metrics=result.metrics | {"effort": 1.0}))
    assert main(["study", str(folder / "short.toml"), "--row", "3", "--out", str(tmp_path)]) == 1
    assert "OTHER numbers than the stored ones" in capsys.readouterr().out


# -- what goes wrong in runs ------------------------------------------------------------------------------------------


def test_a_run_that_diverges_is_a_row(tmp_path: Path) -> None:
    text = SHORT.replace("[factors]\n", '[factors]\n"feedback.arm" = { grid = [30.0, 1e6] }\n').replace(
        "points = 4", "points = 1"
    )
    rows = run_here(planned(tmp_path, text), tmp_path)
    assert {row.status for row in rows if row.parameters["feedback.arm"] == 1e6} == {"diverged"}
    assert {row.status for row in rows if row.parameters["feedback.arm"] == 30.0} == {"completed"}
    worse = next(row for row in rows if row.status == "diverged")
    assert worse.time < 0.04 and worse.signal.startswith("nu[")
    assert any(np.isnan(value) for value in worse.metrics.values()), "a window that it did not reach has no number"


def test_a_run_that_a_supervisor_stops_is_a_row_and_no_success(tmp_path: Path) -> None:
    text = SHORT.replace("[set]\n", "[set]\nsafety.position_error = 0.005\n")  # it starts 10 mm behind
    rows = run_here(planned(tmp_path, text, "sampling.points=1"), tmp_path)
    assert {row.status for row in rows} == {"tripped"}
    assert not load_results(tmp_path).succeeded("pd").any()


def test_settings_that_no_run_can_be_made_of_are_a_refused_row(tmp_path: Path) -> None:
    text = SHORT.replace("[factors]\n", '[factors]\n"start.joint_offset" = { grid = [0.1, [0.1, 0.2, 0.3]] }\n')
    rows = run_here(planned(tmp_path, text, "sampling.points=1"), tmp_path)
    for row in rows:
        bad = row.parameters["start.joint_offset"] != 0.1
        assert row.status == ("refused" if bad else "completed")
        assert ("3 numbers for 2 joints" in row.message) == bad
    assert main(["study", str(tmp_path / "short.toml"), "--out", str(tmp_path), "--set", "sampling.points=1"]) == 0


def test_a_fault_is_kept_told_and_run_again(tmp_path: Path, monkeypatch, capsys) -> None:
    usual = worker.simulate

    def faulty(loop, *rest):
        if loop.controller.name == "pd":
            raise RuntimeError("cosmic ray")
        return usual(loop, *rest)

    file = written(tmp_path, SHORT)
    monkeypatch.setattr(worker, "simulate", faulty)
    arguments = ["study", str(file), "--out", str(tmp_path), "--set", "sampling.points=1", "--workers", "1"]
    assert main(arguments) == 1
    assert "failed and is run again next time: RuntimeError: cosmic ray" in capsys.readouterr().out
    assert [row.status for row in stored(tmp_path)].count("failed") == 2
    monkeypatch.setattr(worker, "simulate", usual)
    assert main(arguments) == 0
    assert {row.status for row in stored(tmp_path)} == {"completed"}


# -- kills, Ctrl-C, two at once ---------------------------------------------------------------------------------------

MANY = SHORT.replace("points = 4", "points = 16").replace("0.04", "0.6")


def command(file: Path, *more: str) -> list[str]:
    program = "import sys; from mmnn_pin.cli import main; sys.exit(main(sys.argv[1:]))"
    return [sys.executable, "-c", program, "study", str(file), "--out", str(file.parent), *more]


def started(file: Path, least: int) -> subprocess.Popen[str]:
    """A study in a process of its own, that has stored some rows."""
    process = subprocess.Popen(command(file), stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, cwd=ROOT)
    deadline = time.monotonic() + 120
    while time.monotonic() < deadline and process.poll() is None:
        if (file.parent / NAME).exists() and count(file.parent) >= least:
            return process
        time.sleep(0.02)
    raise AssertionError(process.communicate()[1])


def count(folder: Path) -> int:
    try:
        return len(stored(folder))
    except StudyError:
        return 0


@compiled_only
def test_a_killed_study_has_lost_nothing_and_goes_on(tmp_path: Path) -> None:
    file = written(tmp_path, MANY)
    process = started(file, 5)
    with (
        pytest.raises(StudyError, match=rf"in use: process {process.pid} on .* writes it"),
        writing(tmp_path / NAME),
    ):
        pass
    process.send_signal(signal.SIGKILL)
    process.wait()
    process.communicate()
    before = {row.id: row for row in stored(tmp_path)}
    plan = planned(tmp_path, MANY)
    assert 5 <= len(before) < len(plan)
    after = run_here(plan, tmp_path)
    assert [row.id for row in after] == list(range(len(plan)))
    assert all(after[i] == row for i, row in before.items()), "rows that were done are not run again"
    sample = plan.trial(next(iter(set(range(len(plan))) - set(before))))
    assert told(worker.run(sample).metrics) == told(after[sample.id].metrics)


@compiled_only
def test_ctrl_c_keeps_what_is_done(tmp_path: Path) -> None:
    process = started(written(tmp_path, MANY), 3)
    process.send_signal(signal.SIGINT)
    out, err = process.communicate(timeout=60)
    assert process.returncode == 130, err
    assert "the same command goes on with what is missing" in err and "Traceback" not in err
    rows = stored(tmp_path)
    assert 3 <= len(rows) < 96 and {row.status for row in rows} == {"completed"}
    assert f"{len(rows)} runs of 96" in out


# -- the file of results ---------------------------------------------------------------------------------------------


def test_changed_settings_are_refused_and_with_force_the_same_rows_stay(done, tmp_path: Path, capsys) -> None:
    folder, _, rows = done
    (tmp_path / NAME).write_bytes((folder / NAME).read_bytes())
    file = written(tmp_path, SHORT)
    more = ["study", str(file), "--out", str(tmp_path), "--workers", "1", "--set", "sampling.points=6"]
    assert main(more) == 2
    said = capsys.readouterr().err
    assert "changed: sampling.points; 24 of 24 stored rows are also in the new study: --force keeps these" in said
    assert numbers(stored(tmp_path)) == numbers(rows)
    assert main([*more, "--force"]) == 0
    grown = stored(tmp_path)
    assert len(grown) == 36 and grown[:24] == rows
    fewer = [*more[:-2], "--set", 'controllers=["two_layer"]', "--force"]
    assert main(fewer) == 0
    kept = {row.fingerprint: row for row in rows if row.controller == "two_layer"}
    left = stored(tmp_path)
    assert [row.id for row in left] == list(range(8))
    assert all(msgspec.structs.replace(kept[row.fingerprint], id=row.id) == row for row in left)
    capsys.readouterr()
    assert main([*fewer, "--json"]) == 0, "done: nothing is run"
    assert json.loads(capsys.readouterr().out)["done"] == 8


def test_rows_of_another_version_of_the_package_are_refused(done, tmp_path: Path) -> None:
    folder, plan, _ = done
    (tmp_path / NAME).write_bytes((folder / NAME).read_bytes())
    with writing(tmp_path / NAME) as store:
        store.add(store.facts | {"mmnn_pin": "0.0.1"})
    with writing(tmp_path / NAME) as store:
        with pytest.raises(StudyError, match=r"mmnn_pin 0\.0\.1 wrote its 24 rows"):
            missing_trials(store, plan, probe(plan), False)
        assert len(missing_trials(store, plan, probe(plan), True)) == 24
    assert not stored(tmp_path)


def test_results_of_another_format_or_program_are_refused(done, tmp_path: Path, capsys) -> None:
    folder, _, _ = done
    command, file = ["study", str(written(tmp_path, SHORT)), "--out", str(tmp_path)], tmp_path / NAME
    text = (folder / NAME).read_text().replace('"format_version": 2', '"format_version": 99')
    for content, words in (
        (text, "results of another version: its format version is 99, this mmnn_pin reads 2: use the mmnn_pin that"),
        ("no results at all\n", "not a study's results: Expecting value"),
        ("\n".join(text.splitlines()[1:]) + "\n", "not a study's results: it does not begin with facts"),
        ("[" * 100_000 + "\n", "not a study's results"),
    ):
        file.write_text(content)
        assert main(command) == main(["report", str(tmp_path), "--html", str(tmp_path / "x.html")]) == 2
        said = capsys.readouterr().err
        assert said.count(f"{file}: error: {words}") == said.count("\n") == 2, said
    file.unlink()
    (tmp_path / OLD_NAME).write_bytes(b"SQLite format 3")
    for words in (command, ["report", str(tmp_path), "--html", str(tmp_path / "x.html")]):
        assert main(words) == 2
        said = capsys.readouterr().err
        assert f"{tmp_path / OLD_NAME}: error: results of another version: a database of mmnn_pin before" in said
    assert main([*command[:-1], str(tmp_path / "other"), "--set", "sampling.points=1", "--workers", "1"]) == 0


def test_numbers_keep_their_bits_in_the_file(tmp_path: Path, done) -> None:
    _, plan, _ = done
    values = {"a": 0.1 + 0.2, "b": 5e-324, "c": np.inf, "d": -np.inf, "e": np.nan, 'f"': 1e300, "g": -0.0}
    with writing(tmp_path / NAME) as store:
        missing_trials(store, plan, probe(plan), False)
        store.add(plan.trial(7).result("completed", metrics=values))
    (row,) = stored(tmp_path)
    assert row.id == 7 and told(row.metrics) == told(values) and np.signbit(row.metrics["g"])
    _, line = (tmp_path / NAME).read_text().splitlines()
    assert json.loads(line)["metrics"]["a"] == values["a"]


def test_a_line_that_a_kill_cut_off_is_dropped_and_its_run_made_again(done, tmp_path: Path) -> None:
    folder, plan, rows = done
    whole = (folder / NAME).read_bytes()
    for cut in (1, 30, len(whole.splitlines()[-1])):
        (tmp_path / NAME).write_bytes(whole[:-cut])
        assert stored(tmp_path) == rows[:-1]
        assert numbers(run_here(plan, tmp_path)) == numbers(rows)
        assert (tmp_path / NAME).read_bytes().count(b"\n") == whole.count(b"\n")


FULL = """
import sys
from pathlib import Path
from mmnn_pin.lab.study.store import NAME, TrialResult, writing
from mmnn_pin.errors import StudyError
path = Path(sys.argv[1]) / NAME
known = dict.fromkeys(("versions", "settings", "experiment", "units"), {})
known |= dict.fromkeys(("controllers", "metrics", "robots"), ())
known |= {"mmnn_pin": "0", "plan": "", "rows": 0, "name": "", "file": ""}
try:
    with writing(path) as store:
        store.add(known)
        for i in range(10000):
            about = {"id": i, "point": i, "controller": "pd", "seed": 1, "parameters": {}, "status": "completed"}
            store.add(TrialResult(**about, metrics={f"m{k}": 1.0 for k in range(40)}))
            print(i)
except StudyError as error:
    print(error, file=sys.stderr)
"""


def test_a_full_disk_is_told_and_loses_no_stored_row(tmp_path: Path) -> None:
    (small := tmp_path / "small").mkdir()
    (kept := tmp_path / "kept").mkdir()
    steps = (
        f"mount -t tmpfs -o size=256k tmpfs {small}",
        f"{sys.executable} -c '{FULL}' {small}",
        f"cp {small}/* {kept}",
    )
    unshared = ["unshare", "-rm", "sh", "-c", " && ".join(steps)]
    made = subprocess.run(unshared, capture_output=True, text=True, cwd=ROOT)
    if made.returncode:
        pytest.skip(f"no file system of one's own here: {made.stderr}")
    assert "cannot write the results: No space left on device: free some space" in made.stderr
    finished = made.stdout.split()
    assert len(finished) > 5 and [str(row.id) for row in stored(kept)] == finished


def test_a_folder_that_cannot_be_made_is_told(tmp_path: Path, capsys) -> None:
    (tmp_path / "file").write_text("")
    file = written(tmp_path, SHORT)
    assert main(["study", str(file), "--out", str(tmp_path / "file" / "inner")]) == 2
    assert "the folder cannot be written to: Not a directory" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (("--workers", "0"), "0 workers: use at least one"),
        (("--cluster", "tcp://127.0.0.1:1", "--workers", "2"), "--cluster with --workers"),
        (("--row", "24"), "there is no row 24: use one from 0 to 23"),
        (("--set", "sampling"), "'sampling' sets nothing"),
    ],
)
def test_wrong_options_are_told(options: tuple[str, ...], words: str, tmp_path: Path, capsys) -> None:
    file = written(tmp_path, SHORT)
    assert main(["study", str(file), "--out", str(tmp_path / "out"), *options]) == 2
    assert words in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


def test_a_study_that_is_read_while_it_runs_does_not_disturb_it(done, tmp_path: Path) -> None:
    _, plan, rows = done
    seen: list[int] = []
    with here() as pool, writing(tmp_path / NAME) as store:
        missing = missing_trials(store, plan, probe(plan), False)
        fill(store, plan, missing[:6], pool, lambda finished: seen.append(count(tmp_path)))
    assert all(kept > done for done, kept in enumerate(seen)) and seen == sorted(seen) and seen[-1] == 6
    assert numbers(reading(tmp_path / NAME).results) == numbers(rows)[:6]

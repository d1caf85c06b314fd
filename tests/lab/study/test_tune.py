"""Tuning: better gains are found and judged on fresh draws, bad ones are refused, searches go on where they stopped."""

from __future__ import annotations

import json
import sqlite3
import sys
from contextlib import closing
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numba import config
from places import ROOT
from study_files import SHORT, planned, run_here, written

from mmnn_pin.cli import main
from mmnn_pin.errors import ConfigError
from mmnn_pin.lab.study import tuning
from mmnn_pin.lab.study.pools import here
from mmnn_pin.lab.study.results import load_results
from mmnn_pin.lab.study.settings import load_study
from mmnn_pin.lab.study.tuning import LOST, NAME, REFUSED, Score, Scorer, violations

optuna = pytest.importorskip("optuna")
pytestmark = pytest.mark.skipif(config.DISABLE_JIT, reason="slow in plain Python")

EXAMPLE = ROOT / "examples" / "tuning.toml"
TUNE = (
    SHORT
    + """
[tune]
controller = "pd"
objective = "e.*.peak"
quantile = 0.75
trials = 6
check = 4

[tune.gains]
"feedback.arm" = { log_uniform = [10.0, 4000.0] }
"kinematic.K" = { uniform = [1.0, 20.0], relative = true }
"""
)


def tuned(file: Path, *more: str, capsys) -> dict:
    assert main(["tune", str(file), "--out", str(file.parent), "--workers", "1", "--json", *more]) == 0
    return json.loads(capsys.readouterr().out)


def values(folder: Path) -> list[tuple[dict[str, float], float]]:
    found = optuna.load_study(study_name="tune", storage=f"sqlite:///{folder / NAME}").trials
    return [(trial.params, trial.value) for trial in found if trial.value is not None]


def test_a_score_is_the_quantile_over_the_rows_of_the_study(tmp_path: Path) -> None:
    rows = run_here(planned(tmp_path, SHORT), tmp_path)
    expected = np.sort(load_results(tmp_path).metric("pd", "e.*.peak"))
    study = load_study(written(tmp_path, TUNE))
    assert study.settings.tune is not None
    with here() as pool:
        scorer = Scorer(study, study.settings.tune, pool)
        score, lost = scorer.score({}), scorer.score({"bounds.joint_speed": 0.01})
    assert lost.lost == 1.0 and lost.value == 2 * LOST, "the error of a run that diverged is not its error so far"
    assert len(rows) == 24 and np.sort(score.metric).tolist() == expected.tolist()
    assert score.value == expected[int(np.ceil(0.75 * 8)) - 1]


def test_lost_runs_count_as_worst_and_refused_gains_more() -> None:
    fine = Score(np.array([1.0, 2.0, 3.0, np.inf]), 0.75)
    lost = [Score(np.array([1.0] * n + [np.inf] * (8 - n)), 0.75).value for n in (5, 4, 0)]
    refused = Score(np.zeros(0), 0.75, 0.5, "unstable").value
    assert fine.value == 3.0 and fine.lost == 0.25
    assert 3.0 < LOST < lost[0] < lost[1] < lost[2] < REFUSED < refused


def test_better_gains_are_found_and_the_own_ones_come_first(tmp_path: Path, capsys) -> None:
    found = tuned(written(tmp_path, TUNE), capsys=capsys)
    trials = values(tmp_path)
    assert len(trials) == found["trials"] == 6
    assert trials[0][0] == {"feedback.arm": 30.0, "kinematic.K": 1.0} and trials[0][1] == found["own"]
    assert found["best"] == min(value for _, value in trials) < found["own"]
    best = min(trials, key=lambda trial: trial[1])[0]
    assert found["gains"] == {"feedback.arm": best["feedback.arm"], "kinematic.K": 7.0 * best["kinematic.K"]}
    fresh = found["fresh"]
    assert fresh["best"]["quantile"]["value"] < fresh["own"]["quantile"]["value"]
    assert found["refused"] == sum(value >= REFUSED for _, value in trials) > 0


def test_gains_that_break_a_constraint_on_fresh_draws_are_passed_over(tmp_path: Path, capsys, monkeypatch) -> None:
    """The best of the search is refused afterwards: the next one is judged, and the result says so."""
    file = written(tmp_path, TUNE)
    first = tuned(file, "--set", "tune.check=0", capsys=capsys)
    ranked = sorted(values(tmp_path), key=lambda trial: trial[1])

    def not_the_best(loop) -> None:
        if loop.controller.feedback.arm == pytest.approx(first["gains"]["feedback.arm"]):
            raise ConfigError("not these")

    monkeypatch.setattr(tuning, "CONSTRAINTS", (*tuning.CONSTRAINTS, (not_the_best, 4)))
    study = load_study(file)
    with here() as pool:
        found = tuning.result(study, tmp_path, pool)
    assert found.passed_over == 1 and found.value == ranked[1][1] > first["best"]
    assert found.best["feedback.arm"] == ranked[1][0]["feedback.arm"] and not found.fresh[1].refused
    assert "1 better on the study's draws, refused by a constraint on these" in found.describe()


def test_a_search_that_was_stopped_goes_on_to_the_same_trials(tmp_path: Path, capsys) -> None:
    (whole, parts) = (written(tmp_path / name, TUNE) for name in ("whole", "parts"))
    tuned(whole, "--set", "tune.check=0", capsys=capsys)
    tuned(parts, "--set", "tune.trials=2", "--set", "tune.check=0", capsys=capsys)
    optuna.load_study(study_name="tune", storage=f"sqlite:///{parts.parent / NAME}").ask()  # as a kill leaves it
    assert tuned(parts, "--set", "tune.check=0", capsys=capsys)["trials"] == 6
    assert values(parts.parent) == values(whole.parent)


def test_gains_that_are_unstable_when_sampled_are_refused_without_a_run(tmp_path: Path) -> None:
    study = load_study(written(tmp_path, TUNE))
    assert study.settings.tune is not None
    with here() as pool:
        scorer = Scorer(study, study.settings.tune, replace(pool, executor=None))  # type: ignore[arg-type]
        score = scorer.score({"feedback.arm": 1e5})
        assert list(violations(scorer.plan({"feedback.arm": 10.0}))) == []
    assert score.value == REFUSED * 2.0 and "the sampled PD loop is unstable" in score.complaint


def test_rates_beyond_the_condition_of_the_certificate_are_refused() -> None:
    """Chapter 4's own rates are allowed on the example's draws, four times as much is not."""
    study = load_study(EXAMPLE)
    assert study.settings.tune is not None
    with here() as pool:
        scorer = Scorer(study, study.settings.tune, pool)
        assert list(violations(scorer.plan({}))) == []
        complaints = list(violations(scorer.plan({"two_layer.F": [4.0, 0.8], "two_layer.G": [4.0, 0.8]})))
    assert complaints and all("times its largest rate" in line for line in complaints)


def test_trials_of_other_settings_are_refused_without_force(tmp_path: Path, capsys) -> None:
    file = written(tmp_path, TUNE)
    tuned(file, "--set", "tune.trials=1", "--set", "tune.check=0", capsys=capsys)
    assert main(["tune", str(file), "--out", str(tmp_path), "--set", "tune.quantile=0.5"]) == 2
    assert "the trials are of another study or version" in capsys.readouterr().err
    more = ("--set", "tune.quantile=0.5", "--set", "tune.trials=2", "--set", "tune.check=0", "--force")
    assert tuned(file, *more, capsys=capsys)["trials"] == 2


BAD = [
    ('"pd"\nobj', '"pdd"\nobj', "tune.controller: error: unknown controller 'pdd'"),
    ('e.*.peak"\nq', 'e.*.pek"\nq', "tune.objective: error: unknown metric 'e.*.pek'"),
    ("quantile = 0.75", "quantile = 0", "tune.quantile: error: 0.0: use a number above 0"),
    ('"feedback.arm" = {', '"feedback.am" = {', "tune.gains.feedback.am: error: unknown setting 'feedback.am'"),
    ("[10.0, 4000.0]", "[10.0, -1.0]", "tune.gains.feedback.arm.log_uniform: error"),
    ("log_uniform = [10.0, 4000.0]", "normal = [10.0, 1.0]", "tune.gains.feedback.arm: error: a gain has no normal"),
    ("trials = 6", "trials = 0", "tune.trials: error: 0: use a number from 1 to 10000000"),
    ("check = 4", "check = 1099511627776", "tune.check: error: 1099511627776: use a number from 0 to 10000000"),
    ("kinematic.K", "sensor.velocity", "tune.gains.sensor.velocity: error: 'true' cannot be multiplied"),
]


@pytest.mark.parametrize(("old", "new", "words"), BAD)
def test_what_is_wrong_with_the_file_is_told_with_its_line(
    old, new, words, tmp_path: Path, capsys, monkeypatch
) -> None:
    text = TUNE.replace(old, new)
    assert text != TUNE
    monkeypatch.chdir(tmp_path)
    written(tmp_path, text)
    assert main(["tune", "short.toml"]) == 2
    said = capsys.readouterr().err
    assert words in said and said.startswith("short.toml:") and said.count("\n") == 1
    assert [file.name for file in tmp_path.iterdir()] == ["short.toml"]


def test_a_study_without_tune_and_a_machine_without_optuna_are_told(tmp_path: Path, capsys, monkeypatch) -> None:
    assert main(["tune", str(written(tmp_path))]) == 2
    assert "nothing to tune: add [tune] and [tune.gains]" in capsys.readouterr().err
    monkeypatch.setitem(sys.modules, "optuna", None)
    assert main(["tune", str(written(tmp_path, TUNE))]) == 2
    assert "pip install 'mmnn_pin[tune]'" in capsys.readouterr().err


BROKEN = {  # what SQLAlchemy raises of Python's own, and nothing of ours
    "UPDATE trials SET state = '3'": "'3' is not among",
    "UPDATE study_user_attributes SET value_json = ''": "Expecting value",
    "UPDATE trial_params SET distribution_json = '[['": "Expecting value",
}


@pytest.mark.parametrize("change", BROKEN)
def test_what_no_search_wrote_into_a_database_ends_it_in_one_line(change: str, tmp_path: Path, capsys) -> None:
    file, more = written(tmp_path, TUNE), ("--set", "tune.trials=1", "--set", "tune.check=0")
    tuned(file, *more, capsys=capsys)
    with closing(sqlite3.connect(tmp_path / NAME)) as db, db:
        db.execute(change)
    assert main(["tune", str(file), "--out", str(tmp_path), "--workers", "1", *more]) == 2
    said = capsys.readouterr().err
    assert f"the database cannot be used: {BROKEN[change]}" in said and "internal error" not in said


ENDLESS = "WITH RECURSIVE r(n) AS (SELECT 1 UNION ALL SELECT n + 1 FROM r)"
PROGRAMS = {
    "a view": f"ALTER TABLE trials RENAME TO t; CREATE VIEW trials AS {ENDLESS} SELECT t.* FROM t, r WHERE n < 0",
    "a trigger": f"CREATE TRIGGER t BEFORE UPDATE ON trials BEGIN {ENDLESS} SELECT n FROM r; END",
    "a computed column": "CREATE TABLE t (n INTEGER, x BLOB GENERATED ALWAYS AS (zeroblob(n)))",
    "an expression": "CREATE INDEX t ON trials (hex(zeroblob(number)))",
    "a part": "CREATE INDEX t ON trials (number) WHERE length(zeroblob(number)) > 0",
    "a check": "CREATE TABLE t (n INTEGER CHECK (length(zeroblob(n)) > 0))",
    "a default": "CREATE TABLE t (n INTEGER DEFAULT (length(zeroblob(1000000000))))",
}


@pytest.mark.parametrize("program", PROGRAMS)
def test_a_database_that_would_run_a_program_is_refused(program: str, tmp_path: Path, capsys) -> None:
    file, more = written(tmp_path, TUNE), ("--set", "tune.trials=1", "--set", "tune.check=0")
    tuned(file, *more, capsys=capsys)
    with closing(sqlite3.connect(tmp_path / NAME)) as db, db:
        db.executescript(PROGRAMS[program])
    assert main(["tune", str(file), "--out", str(tmp_path), "--workers", "1", *more]) == 2
    said = capsys.readouterr().err
    assert "the database has 't" in said and "computes what it holds: it is run as it is read" in said


def test_a_database_that_keeps_nothing_ends_the_search_in_one_line(tmp_path: Path, capsys) -> None:
    """Its study has another number than its trials are filed under: a damaged row."""
    file, more = written(tmp_path, TUNE), ("--set", "tune.trials=1", "--set", "tune.check=0")
    tuned(file, *more, capsys=capsys)
    with closing(sqlite3.connect(tmp_path / NAME)) as db, db:
        db.execute("UPDATE studies SET study_id = 3")
    assert main(["tune", str(file), "--out", str(tmp_path), "--workers", "1", *more]) == 2
    said = capsys.readouterr().err
    assert "the database is damaged" in said and "internal error" not in said
    assert tuned(file, *more, "--out", str(tmp_path / "another"), capsys=capsys)["trials"] == 1

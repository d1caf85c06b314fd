"""The study behind docs/explanation/contest.md: its document, what the contest takes from the search, the search."""

from __future__ import annotations

import csv
import json
import math
from dataclasses import replace
from types import SimpleNamespace

import msgspec
import numpy as np
import pytest

from mmnn_pin.disturbance import payload
from mmnn_pin.lab.experiments.cases import with_case
from mmnn_pin.lab.experiments.config import load_experiment
from research.contest.settings import load_contest
from research.contest.task import demand, held_out_torque, tasks_of
from research.studies.contest import document, search
from research.studies.contest.__main__ import main
from research.studies.contest.search import OUTSIDE, TRIES, TUNINGS, spaces, taken, tuned, tuning_file
from research.studies.document import DOCS, kept

SHORT = (
    *("time.duration=1.6", "time.control_period=0.0025", "time.plant_step=0.00125", "windows=[[0, 0.5], [0.8, 1.6]]"),
    *(f"held_out.{name}.duration=0.8" for name in ("similar", "tight", "circle")),
)


LOADED = (
    *(*SHORT[1:], "time.duration=3.2", "contest.window=0.4"),
    *(f"cases.{case}.set.disturbances.0.start=0.8" for case in ("light", "heavy")),
)


@pytest.fixture(scope="module")
def bench():
    return search.Bench.made("eight", *SHORT)


@pytest.fixture(scope="module")
def loaded():
    return search.Bench.made("payload", *LOADED)


def test_the_document_is_made_from_the_summary_that_is_kept():
    assert (DOCS / "explanation/contest.md").read_text(encoding="utf-8") == document.render(kept(document.SUMMARY))


def test_the_csv_file_has_the_numbers_of_the_summary_that_is_kept():
    """Every task and controller once; medians as the summary has them, to four digits."""
    tasks = kept(document.SUMMARY)["tasks"]
    with (DOCS / "explanation/contest.csv").open(encoding="utf-8", newline="") as file:
        rows = list(csv.DictReader(file))
    assert [(row["task"], row["controller"]) for row in rows] == [
        (task, name) for task in tasks for name in tasks[task]["rows"]
    ]
    for row in rows:
        for column, key in (("base [mm]", "base"), ("frozen_fvu", "frozen_fvu"), ("held_arm [mrad]", "held_arm")):
            cell = tasks[row["task"]]["rows"][row["controller"]][key]
            assert row[column] == "" if cell is None else float(row[column]) == pytest.approx(float(cell[1]), rel=1e-3)


def test_controllers_are_listed_by_the_least_delay_that_loses_them():
    some = [1.0, 1.0]
    errors = {"a": [some, None, None], "b": [some, some, some], "c": [some, None, some], "d": [some, some, None]}
    found = document.lost_from({"delays": [0.0, 0.001, 0.002], "errors": errors})
    assert found == {"1 ms": ["a", "c"], "2 ms": ["d"], "none": ["b"]} and list(found) == ["1 ms", "2 ms", "none"]


def test_the_best_plain_controller_is_that_of_those_that_ran():
    far = {"pd": {"a": 9.0, "b": 5.0}, "pd_gravity": {"a": 8.0, "b": 6.0}, "pid": {"a": "inf"}, "adaptive": {"a": 1.0}}
    assert document.best_plain(far, "a") == 8.0 and document.best_plain(far, "b") == 5.0


def test_a_controller_is_first_where_no_other_one_is_nearer_to_the_best():
    far = {"a": {"x": 1.1, "y": 2.0, "z": "inf"}, "b": {"x": 1.2, "y": 1.5, "z": "inf"}, "c": {"y": 1.0}}
    assert document.first_on(far, "a") == (["x", "z"], ["y"]) and document.first_on(far, "c") == (["y"], [])


def test_who_is_worse_than_pd_is_named_with_the_task():
    def about(a, b):
        return {"rows": {"pd": row(1.0, 2.0), "x": row(a, b), "y": row(0.5, 0.5)}}

    def row(base, arm):
        return {"base": [0.0, base, 9.0], "arm": [0.0, arm, 9.0], "held_base": None, "held_arm": None}

    tasks = {"one": about(1.04, 2.0), "two": about(0.5, 2.2), "three": about(2.0, "inf")}
    assert document.worse_than_pd(tasks, ["x", "y", "z"]) == {"x": ["two", "three"]}


def test_searches_whose_best_try_did_not_hold_are_named():
    searches = {"a": {"x": {"score": 0.2, "best": 0.1}, "y": {"score": 0.1, "best": 0.1}}, "b": {"x": {"score": 0.2}}}
    assert document.passed_over(searches) == {"x": ["a"]}


@pytest.mark.parametrize("tuning", TUNINGS)
def test_the_contest_has_what_the_search_found(tuning):
    """In the case of the search's name; the document says the same."""
    told = kept(document.SUMMARY)["tuned"][tuning]
    for learner, found in tuned()[tuning].items():
        assert taken(tuning, learner) == found["settings"] == told[learner]["settings"]
        assert set(found["settings"]) == {
            path for name, f in spaces(tuning)[learner].items() for path in f.keys or [name]
        }
        assert found["score"] == found["scores"][found["taken"]] and found["own"] == found["scores"][0]


def test_all_learners_have_as_many_tries():
    for tuning in TUNINGS:
        assert {found["tries"] for found in tuned()[tuning].values()} == {TRIES[tuning]}
        assert {len(found["scores"]) for found in tuned()[tuning].values()} == {TRIES[tuning]}
        own = {"pid"} if tuning == "payload" else set()  # they keep what they have
        assert set(tuned()[tuning]) == set(spaces(tuning))
        assert set(spaces(tuning)) == set(spaces("eight")) - own or tuning == "velocity"


@pytest.mark.parametrize("learner", spaces("payload"))
def test_the_second_search_starts_from_what_the_first_found(learner):
    """A setting of the second is the first's or the experiment's own; but for how long a stack keeps its entries."""
    start = json.loads(load_contest(tuning_file("payload")).to_json())
    for path, value in tuned()["eight"][learner]["settings"].items():
        assert search.value_at(start, path) == value


@pytest.mark.parametrize("tuning", ("eight", "payload"))
def test_nothing_is_tuned_on_what_is_reported(tuning):
    """Other seeds, other paths, other sines, other loads, in training and held out; the same robot, gains and noise."""
    reported, tried = load_contest(), load_contest(tuning_file(tuning))
    assert not seeds(reported) & seeds(tried)
    theirs = [reported.held_out[name] for name in reported.held_out]
    theirs += [case.set["reference"] for case in reported.cases.values() if "arm" in case.set.get("reference", {})]
    theirs.append(reported.reference)
    for a in map(msgspec.to_builtins, motions(tried)):
        for b in map(msgspec.to_builtins, theirs):
            assert a["base"] != b.get("base") and list(a["arm"]) != list(b["arm"])
    for name in ("feedback", "kinematic", "sensor", "friction", "robust"):
        assert getattr(tried, name) == getattr(reported, name)
    load = payload(with_case(reported, "payload").disturbances)[1]
    for case in tried.cases:
        other = payload(with_case(tried, case).disturbances)[1]
        assert (other is None) == (tuning == "eight")
        assert other is None or (other.mass != load.mass and other.at != load.at and other.start != load.start)


def test_the_searches_outside_of_the_model_class_drive_otherwise_and_for_the_same_controllers():
    """Each of the contest's last ten tasks has one; what learns there is searched, without exception."""
    reported, tried = load_contest(), load_contest(tuning_file("friction"))
    assert not seeds(reported) & seeds(tried) and set(OUTSIDE) == set(list(reported.cases)[-10:])
    for case in tried.cases:
        own, other = with_case(tried, case), with_case(reported, case)
        assert own.reference.arm != other.reference.arm and own.reference.base != other.reference.base
        assert set(other.controllers) & set(spaces("eight")) == set(spaces(case))
        load, theirs = payload(own.disturbances)[1], payload(other.disturbances)[1]
        assert (load is None) == (theirs is None) and (load is None or load.mass != theirs.mass)
        for name in ("friction", "sensor", "actuator", "latency", "plant", "radii", "robot"):
            assert getattr(own, name) == getattr(other, name)


def test_a_search_that_was_stopped_goes_on_and_ends_as_one_that_was_not(tmp_path):
    """Each set of settings is run once; a journal of other settings is not believed."""
    run = []

    class Counting:
        tasks = (SimpleNamespace(experiment=load_experiment("eight")),)

        def score(self, learner, settings):
            run.append(settings)
            return 1.0 + math.log10(settings["adaptive.rate"])

    space, journal, quiet = spaces("lag")["adaptive"], tmp_path / "a.json", lambda text: None
    whole = search.search(Counting(), "adaptive", space, 6, quiet)
    assert len(run) == 6
    search.search(Counting(), "adaptive", space, 4, quiet, journal)
    assert search.search(Counting(), "adaptive", space, 6, quiet, journal) == whole and len(run) == 12
    changed = json.loads(journal.read_text())
    changed[2][0]["adaptive.rate"] = 1.0
    journal.write_text(json.dumps(changed))
    assert search.search(Counting(), "adaptive", space, 6, quiet, journal) == whole and len(run) > 12
    before = len(run)
    scores = [score for _, score in whole]
    assert search.search(Counting(), "adaptive", space, 6, quiet, scores=scores) == whole and len(run) == before
    assert search.search(Counting(), "adaptive", space, 6, quiet, scores=scores[:4]) == whole and len(run) == before + 2


def test_the_two_searches_have_nothing_in_common():
    first, second = (load_contest(tuning_file(tuning)) for tuning in ("eight", "payload"))
    assert not seeds(first) & seeds(second)
    bases = [[msgspec.to_builtins(motion)["base"] for motion in motions(tried)] for tried in (first, second)]
    assert all(base not in bases[0] for base in bases[1]) and len(bases[1]) == 5


def test_the_robot_can_drive_what_it_is_tuned_on_with_its_load():
    """Wheels and torques within their limits, in training and held out: no learner is asked for what motors cannot."""
    for task in tasks_of(load_contest(tuning_file("payload")), ("pd",)):
        asked = demand(replace(task, robot=task.at_the_end))
        assert max(asked.speed) < 1.0 and 0.4 < max(asked.torque) < 0.9
        assert max(held_out_torque(task).values()) < 0.9


def seeds(experiment):
    return {experiment.seed + i for i in range(experiment.contest.seeds)}


def motions(experiment):
    """All that is driven: held out, and in the cases."""
    return [*experiment.held_out.values(), *(case.set["reference"] for case in experiment.cases.values())]


def test_the_score_of_pd_is_one_and_less_is_better(bench):
    assert bench.score("pd", {}) == pytest.approx(1.0)
    assert bench.score("computed_torque", {}) < 0.1
    assert bench.score("adaptive", {"adaptive.rate": -1.0}) == search.LOST
    assert bench.score("two_layer", {"two_layer.F": [1e6, 1e6]}) == pytest.approx(search.LOST)


def test_ratios_are_root_mean_squares_over_the_axes(bench):
    """By hand for one row: errors twice as large on one of two axes."""
    assert search.relative({"x": 2.0, "a": 1.0}, {"x": 1.0, "a": 1.0}) == pytest.approx(math.sqrt(2.5))
    pd = bench.pd["swing"][0]
    assert search.ratios(pd, pd, 0.5) == [1.0, 1.0, 1.0]
    assert search.ratios(msgspec.structs.replace(pd, torque=1.1), pd, 0.5) == [search.LOST] * 3


def test_with_a_load_the_first_seconds_count_too(loaded, monkeypatch):
    """Their error is that of the recording's samples from the pick-up on."""
    task = loaded.tasks[0]
    assert task.since == 0.8 and loaded.score("pd", {}) == pytest.approx(1.0)
    pd = loaded.pd[task.name][0]
    recording = task.training(task.controller("pd"), task.seeds[0]).run()
    after = (recording.time >= 0.8 - 1e-9) & (recording.time < 0.8 + search.SOON - 1e-9)
    assert after.sum() == 800
    found = search.soon(pd, task.contest.window)
    assert list(found) == list(pd.rms)
    assert found["x"] == pytest.approx(np.sqrt((recording["true_pose_error"][after, 0] ** 2).mean()))
    late = msgspec.structs.replace(pd, curve=[[4 * value for value in mean] for mean in pd.curve])
    assert search.ratios(late, pd, task.contest.window) == pytest.approx([1.0, 1.0, 1.0, 2.0])
    assert search.ratios(msgspec.structs.replace(pd, outcome="diverged"), pd, 0.4) == [search.LOST] * 4


@pytest.mark.long
def test_a_search_is_the_same_again_and_starts_from_its_own(bench):
    space = spaces("eight")["adaptive"]
    first, second = (search.search(bench, "adaptive", space, 3, lambda text: None) for _ in range(2))
    assert first == second and len(first) == 3
    assert first[0][1] == pytest.approx(bench.score("adaptive", {}))
    assert all(bench.score("adaptive", settings) == score for settings, score in first)


@pytest.mark.long
def test_the_command_makes_a_document(tmp_path):
    main(["--quick", "--out", str(tmp_path)])
    text = (tmp_path / "contest.md").read_text(encoding="utf-8")
    assert "### The eight" in text and "| rich | the eight after rich" in text and "{{" not in text
    assert (tmp_path / "figures" / "contest-fvu.png").exists()

"""The study behind docs/contest.md: its document, what the contest takes from the search, and the search itself."""

from __future__ import annotations

import math

import msgspec
import pytest

from mmnn_pin.experiments.config import load_experiment
from studies.contest import document, search
from studies.contest.__main__ import main
from studies.document import DOCS, kept

SHORT = (
    *("time.duration=1.6", "time.control_period=0.0025", "time.plant_step=0.00125", "windows=[[0, 0.5], [0.8, 1.6]]"),
    *(f"held_out.{name}.duration=0.8" for name in ("similar", "tight", "circle")),
)


@pytest.fixture(scope="module")
def bench():
    return search.Bench.made(*SHORT)


def test_the_document_is_made_from_the_summary_that_is_kept():
    assert (DOCS / "contest.md").read_text(encoding="utf-8") == document.render(kept(document.SUMMARY))


def test_the_contest_has_what_the_search_found():
    """On the eight; the document says the same."""
    for learner, found in search.tuned().items():
        assert search.taken(learner) == found["settings"]
        assert kept(document.SUMMARY)["tuned"][learner]["settings"] == found["settings"]
        assert found["score"] == min(found["scores"]) and found["own"] == found["scores"][0]


def test_all_learners_have_as_many_tries():
    assert {found["tries"] for found in search.tuned().values()} == {search.TRIES}
    assert {len(found["scores"]) for found in search.tuned().values()} == {search.TRIES}
    assert set(search.tuned()) == set(search.spaces())


def test_nothing_is_tuned_on_what_is_reported():
    """Other seeds, other paths and other sines, in training and held out; the same robot, gains and noise."""
    reported, tuning = load_experiment("contest"), load_experiment(search.TUNING)
    seeds = {reported.seed + i for i in range(reported.contest.seeds)}
    assert not seeds & {tuning.seed + i for i in range(tuning.contest.seeds)}
    mine = [tuning.held_out[name] for name in tuning.held_out]
    theirs = [reported.held_out[name] for name in reported.held_out]
    mine += [case.set["reference"] for case in tuning.cases.values()]
    theirs += [case.set["reference"] for case in reported.cases.values() if "arm" in case.set.get("reference", {})]
    theirs.append(msgspec.to_builtins(reported.reference))
    for a in map(msgspec.to_builtins, mine):
        for b in map(msgspec.to_builtins, theirs):
            assert a["base"] != b.get("base") and list(a["arm"]) != list(b["arm"])
    for name in ("feedback", "kinematic", "sensor", "friction", "robust"):
        assert getattr(tuning, name) == getattr(reported, name)


def test_the_score_of_pd_is_one_and_less_is_better(bench):
    assert bench.score("pd", {}) == pytest.approx(1.0)
    assert bench.score("computed_torque", {}) < 0.1
    assert bench.score("adaptive", {"adaptive.rate": -1.0}) == search.LOST
    assert bench.score("two_layer", {"two_layer.F": [1e6, 1e6]}) == pytest.approx(search.LOST)


def test_ratios_are_root_mean_squares_over_the_axes(bench):
    """By hand for one row: errors twice as large on one of two axes."""
    assert search.relative({"x": 2.0, "a": 1.0}, {"x": 1.0, "a": 1.0}) == pytest.approx(math.sqrt(2.5))
    pd = bench.pd["swing"][0]
    assert search.ratios(pd, pd) == [1.0, 1.0, 1.0]
    assert search.ratios(msgspec.structs.replace(pd, torque=1.1), pd) == [search.LOST] * 3


def test_a_search_is_the_same_again_and_starts_from_its_own(bench):
    space = search.spaces()["adaptive"]
    first, second = (search.search(bench, "adaptive", space, 3, lambda text: None) for _ in range(2))
    assert first == second and len(first["scores"]) == 3
    assert first["own"] == first["scores"][0] == pytest.approx(bench.score("adaptive", {}))
    assert bench.score("adaptive", first["settings"]) == first["score"]


def test_the_command_makes_a_document(tmp_path):
    main(["--quick", "--out", str(tmp_path)])
    text = (tmp_path / "contest.md").read_text(encoding="utf-8")
    assert "### eight: an eight" in text and "### rich" in text and "{{" not in text
    assert (tmp_path / "figures" / "contest-fvu.png").exists()

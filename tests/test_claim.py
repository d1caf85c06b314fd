"""The test of the thesis's claim: equal terms, honest counting, and a document that says what the runs gave."""

import json
import re
from dataclasses import replace
from pathlib import Path

import numba
import numpy as np
import pytest
from scipy.stats import binomtest

pytest.importorskip("optuna")
pytest.importorskip("cmaes")
ROOT = Path(__file__).parents[1]
SIMULATES = pytest.mark.skipif(numba.config.DISABLE_JIT, reason="runs of five seconds, uncompiled")
CONTROLLERS = ("pd", "two_layer", "one_layer", "gain_of_two_layer", "gain_of_one_layer")


@pytest.fixture(autouse=True)
def checkout(monkeypatch):
    monkeypatch.syspath_prepend(str(ROOT))


@pytest.fixture
def saved():
    return json.loads((ROOT / "studies" / "chapter4" / "summary.json").read_text(encoding="utf-8"))


def made_up(two, one, draws, **others):
    """Rows of one condition and reference with these errors, base and arm alike."""
    values = {"two_layer": two, "one_layer": one} | {
        f"gain_of_{n}": np.full(len(two), 2.0) for n in ("two_layer", "one_layer")
    }
    values |= {"pd": np.full(len(two), 4.0)} | others
    rows = []
    for k in range(len(two)):
        row = {"draw": int(draws[k]), "reference": "line", "condition": "thesis"}
        for name in CONTROLLERS:
            error = float(values[name][k])
            row |= {f"{name}.{part}.{window}": error for part in ("base", "arm") for window in ("whole", "tracking")}
            row[f"{name}.diverged"] = bool(np.isinf(error))
        rows.append(row)
    return rows


def test_draws_repeat_stay_in_range_and_differ_between_training_and_test():
    from studies.chapter4.claim import TEST, TRAINING
    from studies.chapter4.draws import MASSES, PERIODS, RANGES, draw

    test, training = ([draw(stream, i) for i in range(60)] for stream in (TEST, TRAINING))
    assert draw(TEST, 17).facts == test[17].facts
    assert not {d.seed for d in test} & {d.seed for d in training}
    for d in test:
        for name, (low, high, *_) in RANGES.items():
            assert np.all((low <= np.array(d.numbers[name])) & (np.array(d.numbers[name]) <= high))
    assert {d.period for d in test} == set(PERIODS) and {d.initial for d in test} == {"random", "zero"}
    K = np.array([d.numbers["K"] for d in test])
    assert K.min() < 5 < 10 < K.max() and len(test[0].numbers[MASSES]) == 3


def test_every_pair_of_motions_comes_equally_often():
    from collections import Counter

    from studies.chapter4.draws import REFERENCES, motions

    pairs = Counter(frozenset(motions(i)) for i in range(120))
    assert len(pairs) == 6 and set(pairs.values()) == {20}
    assert Counter(name for i in range(120) for name in motions(i)) == dict.fromkeys(REFERENCES, 60)


def test_both_networks_of_a_draw_meet_the_same_robot_gains_and_start():
    from studies.chapter4.claim import TEST, with_rates
    from studies.chapter4.draws import REFERENCES, draw, loop

    d, tuned = draw(TEST, 3), {"beta1": 1.0, "beta2": 2.0, "mu": 0.1, "width": 5.0, "centre_range": 2.0}
    for values in (None, tuned):
        loops = []
        for name in ("two_layer", "one_layer"):
            experiment = with_rates(d.experiment(), name, values if name == "one_layer" else None)
            loops.append(loop(experiment, d.robot, "eight", experiment.controller(name)))
        a, b = loops
        assert a.robot is b.robot and a.trajectory is b.trajectory is REFERENCES["eight"][1]
        for name in ("kinematic", "timing", "start", "seed"):
            assert getattr(a, name) == getattr(b, name)
        assert a.controller.feedback == b.controller.feedback and a.controller.robust == b.controller.robust
        assert a.controller.network.hidden == b.controller.network.hidden == 22
    assert (b.controller.network.beta, b.controller.network.width) == ((1.0, 2.0), 5.0)


def test_tuning_starts_at_the_printed_rates_with_as_many_numbers_for_each():
    from studies.chapter4.claim import TUNED
    from studies.chapter4.unstated import at, chapter4

    assert len(TUNED["two_layer"]) == len(TUNED["one_layer"])
    experiment, middle = chapter4(0.002), {k: at(v, np.full(5, 0.5)) for k, v in TUNED.items()}
    two, one = experiment.two_layer, experiment.one_layer
    F1, F2, G1, G2, kappa = (middle["two_layer"][k] for k in ("F1", "F2", "G1", "G2", "kappa"))
    np.testing.assert_allclose([F1, F2, G1, G2, kappa], [*two.F, *two.G, two.kappa])
    np.testing.assert_allclose([middle["one_layer"][k] for k in ("beta1", "beta2", "mu")], [*one.beta, one.mu])


def test_errors_are_rms_distances_and_a_lost_run_has_none():
    from studies.chapter4.claim import errors
    from studies.chapter4.rollouts import Rollout

    pose = np.zeros((1000, 3))
    pose[:500], pose[500:] = (3.0, 4.0, 9.0), (0.6, 0.8, 9.0)
    run = Rollout(True, {"pose_error": pose, "e": np.full((1000, 2), 1.0)})
    found = errors(run, 0.002)
    assert found["base.tracking"] == pytest.approx(1.0) and found["base.whole"] == pytest.approx(np.sqrt(13.0))
    assert found["arm.whole"] == pytest.approx(np.sqrt(2))
    assert set(errors(replace(run, completed=False), 0.002).values()) == {float("inf")}


def test_a_run_that_is_lost_loses_and_one_that_both_lose_is_nobodys():
    from studies.chapter4.verdict import verdict

    two, one = np.array([1.0, 1.0, np.inf, np.inf]), np.array([2.0, np.inf, 1.0, np.inf])
    found = verdict(made_up(two, one, np.arange(4)))["thesis"]["line"]
    part = found["base.tracking"]
    assert (part["two_layer_wins"]["share"], part["one_layer_wins"]["share"], part["both_lost"]) == (0.5, 0.25, 1)
    assert found["lost"] == {"pd": 0, "two_layer": 2, "one_layer": 2} and found["pairs"] == 4


def test_ratio_is_gain_times_learning():
    from studies.chapter4.verdict import verdict

    n = 25
    rows = made_up(np.full(n, 1.0), np.full(n, 3.0), np.arange(n), gain_of_two_layer=np.full(n, 1.5))
    part = verdict(rows)["thesis"]["line"]["both.tracking"]
    ratio, gain, learning = (part[key]["median"] for key in ("ratio", "gain", "learning"))
    assert ratio == pytest.approx(1 / 3) and gain == pytest.approx(0.75) and ratio == pytest.approx(gain * learning)
    assert part["two_layer_idle"]["share"] == 0 and part["one_layer_harms"]["share"] == 1


def test_intervals_are_wilsons_and_cover_when_pairs_of_a_draw_go_together():
    from studies.chapter4.verdict import middle, share, wilson

    exact = binomtest(15, 50).proportion_ci(method="wilson")
    assert wilson(0.3, 50) == pytest.approx((exact.low, exact.high), rel=1e-6)
    rng, draws, hits = np.random.default_rng(0), np.repeat(np.arange(50), 4), np.zeros(3)
    for _ in range(300):
        values = (rng.normal(size=50)[:, None] + 0.5 * rng.normal(size=(50, 4))).ravel()
        intervals = share(values > 0, draws), middle(np.exp(values), draws), share(values > 0, np.arange(200))
        for i, (entry, truth) in enumerate(zip(intervals, (0.5, 1.0, 0.5), strict=True)):
            hits[i] += entry["interval"][0] <= truth <= entry["interval"][1]
    assert np.all(hits[:2] / 300 > 0.9)
    assert hits[2] / 300 < 0.85, "pairs taken as independent would claim too much"


@SIMULATES
def test_a_network_that_does_not_learn_is_pd_at_its_gain():
    from msgspec.structs import replace as with_settings

    from studies.chapter4.claim import KEPT, TEST, at_gain
    from studies.chapter4.draws import draw, loop
    from studies.chapter4.rollouts import roll_out

    d = draw(TEST, 5)
    for learns, same in ((False, True), (True, False)):
        experiment = d.experiment()
        switches = with_settings(experiment.learning, learning=learns)
        experiment = with_settings(experiment, learning=switches)
        runs = roll_out([loop(experiment, d.robot, "line", experiment.controller("two_layer"))], KEPT)
        alone = at_gain([(5, d, "line")], runs)
        difference = np.abs(runs[0].signals["e"] - alone[0].signals["e"]).max()
        assert difference < 1e-12 if same else difference > 1e-5


@SIMULATES
def test_the_first_rows_of_the_claim_come_out_again(saved):
    """The saved medians need all draws; the rows of a draw need only itself."""
    from studies.chapter4.claim import TEST, compare
    from studies.chapter4.draws import draw, motions

    rates = {"tuned": {name: entry["values"] for name, entry in saved["claim"]["tuned"].items()}}
    rows = compare(rates, 1, 2)
    assert [row["reference"] for row in rows] == list(motions(1))
    assert all(row["seed"] == draw(TEST, 1).seed and row["condition"] == "tuned" for row in rows)
    assert compare(rates, 0, 2)[2:] == rows


def test_the_document_is_what_the_saved_summary_gives(saved):
    from studies.chapter4.document import DOCS, render

    text = (DOCS / "chapter4.md").read_text(encoding="utf-8")
    assert text == render(saved)
    shown = re.findall(r"\(figures/([^)]+)\)", text)
    assert len(shown) >= 5 and all((DOCS / "figures" / name).is_file() for name in shown)


def test_numbers_are_written_with_three_digits_and_shares_in_percent():
    from studies.chapter4.document import percent, three

    assert [three(x) for x in (0.12345, 1533.29, 20.0, None)] == ["0.123", "1530", "20.0", "-"]
    assert [percent(x) for x in (0.5, 0.996, 0.004, 1.0, None)] == ["50 %", "99.6 %", "0.4 %", "100 %", "-"]


@SIMULATES
def test_a_little_of_the_study_runs_and_gives_the_document_all_it_tells(saved, monkeypatch, tmp_path):
    """The variants and readings have tests of their own; all else runs here, with next to no trials."""
    from studies.chapter4 import __main__ as command
    from studies.chapter4.document import render

    monkeypatch.setattr(command, "run_variants", lambda folder, say: saved["variants"])
    monkeypatch.setattr(command, "read_otherwise", lambda say: saved["readings"])
    summary = json.loads(json.dumps(command.study(command.QUICK, tmp_path)))
    assert summary.keys() == saved.keys()
    assert "| both tuned | fast arm |" in render(summary)
    rows = (tmp_path / "draws.csv").read_text(encoding="utf-8").splitlines()
    assert len(rows) == 1 + command.QUICK.draws * 2 * 2 and "nan" not in "".join(rows)
    assert {file.name for file in (tmp_path / "figures").iterdir()} == {"intervals.png", "flatness.png", "claim.png"}
    assert len((tmp_path / "trials.csv").read_text(encoding="utf-8").splitlines()) > 3 * 10

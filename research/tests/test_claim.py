"""The test of the thesis's claim: equal terms, honest counting, and a document that says what the runs gave."""

import json
import re
from dataclasses import replace

import numba
import numpy as np
import pytest
from places import ROOT
from scipy.stats import binomtest

pytest.importorskip("optuna")
pytest.importorskip("cmaes")
SIMULATES = pytest.mark.skipif(numba.config.DISABLE_JIT, reason="runs of five seconds, uncompiled")


@pytest.fixture(autouse=True)
def checkout(monkeypatch):
    monkeypatch.syspath_prepend(str(ROOT))


@pytest.fixture
def saved():
    return json.loads((ROOT / "research" / "studies" / "chapter4" / "summary.json").read_text(encoding="utf-8"))


def made_up(two, one, **others):
    """Rows of one condition and motion with these errors, (tunings, draws), base and arm alike."""
    two, one = np.atleast_2d(two), np.atleast_2d(one)
    values = {"two_layer": two, "one_layer": one, "pd": np.full(two.shape, 4.0)}
    values |= {f"gain_of_{n}": np.full(two.shape, 2.0) for n in ("two_layer", "one_layer")}
    values |= {f"integral_of_{n}": np.full(two.shape, np.nan) for n in ("two_layer", "one_layer")}
    values |= {name: np.atleast_2d(value) for name, value in others.items()}
    rows = []
    for k, i in np.ndindex(two.shape):
        row = {"draw": i, "reference": "line", "condition": "thesis", "tuning": k}
        for name, errors in values.items():
            error = None if np.isnan(errors[k, i]) else float(errors[k, i])
            row |= {f"{name}.{part}.{window}": error for part in ("base", "arm") for window in ("whole", "tracking")}
            row[f"{name}.diverged"] = None if error is None else bool(np.isinf(error))
        rows.append(row)
    return rows


def test_draws_repeat_stay_in_range_and_differ_between_test_and_every_tuning():
    from research.studies.chapter4.claim import TEST
    from research.studies.chapter4.draws import MASSES, PERIODS, RANGES, draw
    from research.studies.chapter4.tuning import training

    test = [draw(TEST, i) for i in range(60)]
    assert draw(TEST, 17).facts == test[17].facts
    seeds = [d.seed for d in test] + [d.seed for tuning in range(3) for d, _ in training(20, tuning)]
    assert len(set(seeds)) == 120
    for d in test:
        for name, (low, high, *_) in RANGES.items():
            assert np.all((low <= np.array(d.numbers[name])) & (np.array(d.numbers[name]) <= high))
    assert {d.period for d in test} == set(PERIODS) and {d.initial for d in test} == {"random", "zero"}
    K = np.array([d.numbers["K"] for d in test])
    assert K.min() < 5 < 10 < K.max() and len(test[0].numbers[MASSES]) == 3


def test_what_the_thesis_prints_is_not_drawn():
    from research.studies.chapter4.claim import TEST
    from research.studies.chapter4.draws import draw
    from research.studies.chapter4.unstated import chapter4

    thesis = chapter4(0.002)
    for d in (draw(TEST, i).experiment() for i in range(20)):
        assert d.one_layer.centre_range == thesis.one_layer.centre_range == 10
        assert (d.kinematic.kx, d.kinematic.ky, d.kinematic.kth, d.feedback) == (10, 64, 16, thesis.feedback)
        assert (d.two_layer.F, d.two_layer.G, d.two_layer.kappa) == ((1, 0.2), (1, 0.2), 1)
        assert (d.one_layer.beta, d.one_layer.mu) == ((0.5, 0.5), 0.35)


def test_every_motion_comes_equally_often():
    from collections import Counter

    from research.studies.chapter4.draws import REFERENCES, motion

    assert Counter(motion(i) for i in range(120)) == dict.fromkeys(REFERENCES, 30)


def test_both_networks_of_a_draw_meet_the_same_robot_gains_and_start():
    from research.studies.chapter4.choices import TUNED, choice, with_choice
    from research.studies.chapter4.claim import TEST
    from research.studies.chapter4.draws import REFERENCES, draw, loop

    d = draw(TEST, 3)
    for places in (None, 0.3):
        loops = []
        for name in ("two_layer", "one_layer"):
            chosen = None if places is None else choice(name, np.full(len(TUNED[name]), places))
            experiment = with_choice(d.experiment(), name, chosen)
            loops.append(loop(experiment, d.robot, "eight", experiment.controller(name)))
        a, b = loops
        assert a.robot is b.robot and a.trajectory is b.trajectory is REFERENCES["eight"][1]
        for name in ("kinematic", "timing", "start", "seed"):
            assert getattr(a, name) == getattr(b, name)
        assert a.controller.feedback == b.controller.feedback and a.controller.robust == b.controller.robust
        assert a.controller.network.hidden == b.controller.network.hidden == 22
    assert chosen["centres"] == b.controller.network.centres == "diagonal"
    assert b.controller.network.beta == (chosen["beta1"], chosen["beta2"]) != (0.5, 0.5)
    for name in ("mu", "width", "centre_range"):
        assert getattr(b.controller.network, name) == chosen[name]


def test_tuning_starts_at_the_thesis_s_numbers_and_may_choose_every_one_of_the_network():
    from dataclasses import fields

    from mmnn_pin.torque.one_layer import OneLayer
    from mmnn_pin.torque.two_layer import TwoLayer
    from research.studies.chapter4.choices import TUNED, choice, with_choice
    from research.studies.chapter4.unstated import chapter4

    experiment = chapter4(0.002)
    for name, kind in (("two_layer", TwoLayer), ("one_layer", OneLayer)):
        middle = choice(name, np.full(len(TUNED[name]), 0.5))
        network, thesis = getattr(with_choice(experiment, name, middle), name), getattr(experiment, name)
        for key in ("F", "G", "kappa", "v_range", "beta", "mu", "centre_range"):
            if hasattr(thesis, key):
                np.testing.assert_allclose(getattr(network, key), getattr(thesis, key))
        names = kind.__struct_fields__ if hasattr(kind, "__struct_fields__") else [f.name for f in fields(kind)]
        changed = getattr(with_choice(experiment, name, choice(name, np.full(len(TUNED[name]), 0.2))), name)
        same = [key for key in names if getattr(changed, key) == getattr(thesis, key)]
        assert same in (["hidden"], ["hidden", "centres"])  # 0.2 is on the diagonal, as it is


@pytest.mark.parametrize("centres", ["diagonal", "random"])
def test_level_is_the_mean_square_of_the_gaussians_at_zero(centres):
    from mmnn_pin.torque.one_layer import OneLayer
    from research.studies.chapter4.choices import level

    chosen = {"width": 12.0, "centre_range": 4.0, "centres": centres}
    units, draws = (22, 1) if centres == "diagonal" else (10000, 4)
    found = []
    for seed in range(draws):
        W, V = np.zeros((units, 2)), np.zeros((22, units))
        OneLayer(hidden=units, **chosen).initialise(W, V, np.random.default_rng(seed))
        found.append(V)
    phi = np.exp(-np.sum(np.hstack(found) ** 2, axis=0) / (2 * 12.0**2))
    assert level(chosen) == pytest.approx(np.mean(phi**2), rel=0.01)
    assert level({**chosen, "width": 1e6}) == pytest.approx(1.0)


@SIMULATES
def test_a_network_without_inputs_is_one_leaky_integral_of_the_error():
    """The integral that is left of a network, against the sum over its own recorded errors."""
    from msgspec.structs import replace as with_settings

    from research.studies.chapter4.choices import INPUTS, integral_only, with_choice
    from research.studies.chapter4.unstated import chapter4

    one = {"beta1": 2.0, "beta2": 0.9, "mu": 0.2, "width": 20.0, "centre_range": 3.0, "centres": "diagonal"}
    two = {"F1": 0.7, "F2": 0.4, "G1": 3.0, "G2": 1.0, "kappa": 0.1, "v_range": 1.0, "initial": "random"}
    for name, chosen, gain, leakage in (("one_layer", one, 2.0, 0.4), ("two_layer", two, 0.7 / 4, 0.07)):
        left = integral_only(name, chosen)
        if name == "one_layer":  # the same gain and leakage as its Gaussians have at zero
            m = np.mean(np.exp(-INPUTS * np.linspace(-3.0, 3.0, 22) ** 2 / 20.0**2))
            assert left["beta1"] == pytest.approx(2.0 * m) and left["beta1"] * left["mu"] == pytest.approx(0.4)
            gain = 2.0 * m
        experiment = with_choice(chapter4(0.002), name, left)
        experiment = with_settings(experiment, time=with_settings(experiment.time, duration=0.5))
        run = experiment.loop(experiment.load_robot(), experiment.controller(name)).run()
        total, expected = np.zeros(2), []
        for z in run["z"]:
            expected.append(total.copy())
            total = total + 22 * gain * z - leakage * np.linalg.norm(z) * total
        np.testing.assert_allclose(run["psi_hat"][:, :2], expected, rtol=1e-6, atol=1e-9)


def test_errors_are_rms_distances_and_a_lost_run_has_none():
    from research.studies.chapter4.draws import errors
    from research.studies.rollouts import Rollout

    pose = np.zeros((1000, 3))
    pose[:500], pose[500:] = (3.0, 4.0, 9.0), (0.6, 0.8, 9.0)
    run = Rollout(True, {"pose_error": pose, "e": np.full((1000, 2), 1.0)})
    found = errors(run, 0.002)
    assert found["base.tracking"] == pytest.approx(1.0) and found["base.whole"] == pytest.approx(np.sqrt(13.0))
    assert found["arm.whole"] == pytest.approx(np.sqrt(2))
    assert set(errors(replace(run, completed=False), 0.002).values()) == {float("inf")}


def test_a_run_that_is_lost_loses_and_one_that_both_lose_is_nobodys():
    from research.studies.chapter4.verdict import verdict

    two, one = np.array([1.0, 1.0, np.inf, np.inf, 3.0]), np.array([2.0, np.inf, 1.0, np.inf, 2.0])
    found = verdict(made_up(two, one))["thesis"]["line"]
    wins = found["base.tracking"]["two_layer_wins"]
    assert (wins["share"], wins["of"]) == (0.5, 4)
    assert found["lost"] == {"pd": 0, "two_layer": 2, "one_layer": 2} and found["draws"] == 5


def test_ratio_is_gain_times_learning_and_what_was_not_run_is_left_out():
    from research.studies.chapter4.verdict import verdict

    n = 25
    gain = np.where(np.arange(n) < 10, 1.5, np.nan)
    rows = made_up(np.full(n, 1.0), np.full(n, 3.0), gain_of_two_layer=gain)
    part = verdict(rows)["thesis"]["line"]["both.tracking"]
    ratio, gain, learning = (part[key]["median"] for key in ("ratio", "gain", "learning"))
    assert ratio == pytest.approx(1 / 3) and gain == pytest.approx(0.75) and ratio == pytest.approx(gain * learning)
    assert part["two_layer_idle"] | {"interval": None} == {"share": 0, "of": 10, "interval": None}
    assert part["one_layer_harms"]["share"] == 1 and part["two_layer_to_integral"]["median"] is None


def test_every_tuning_meets_every_other():
    from research.studies.chapter4.verdict import verdict

    two, one = np.array([[1.0, 1.0], [3.0, 3.0]]), np.array([[2.0, 2.0], [0.5, 4.0]])
    part = verdict(made_up(two, one))["thesis"]["all"]["arm.tracking"]
    assert part["pairs"] == [[1.0, 0.5], [0.0, 0.5]]
    assert part["two_layer_wins"]["share"] == 0.5 and part["two_layer_wins"]["of"] == 8


def test_splits_are_by_what_was_drawn():
    from research.studies.chapter4.verdict import verdict

    rows = made_up(np.array([1.0, 1.0, 3.0]), np.full(3, 2.0))
    for row, initial in zip(rows, ("zero", "random", "random"), strict=True):
        row["initial"] = initial
    found = verdict(rows)["thesis"]
    shares = {name: found[f"initial {name}"]["base.tracking"]["two_layer_wins"]["share"] for name in ("zero", "random")}
    assert shares == {"zero": 1.0, "random": 0.5}


def test_interval_of_draws_alone_is_wilsons():
    from research.studies.crossed import share, wilson

    exact = binomtest(15, 50).proportion_ci(method="wilson")
    assert wilson(0.3, 50) == pytest.approx((exact.low, exact.high), rel=1e-6)
    yes = np.arange(2000) < 600
    exact = binomtest(600, 2000).proportion_ci(method="wilson")
    assert share(yes, np.full(2000, True))["interval"] == pytest.approx((exact.low, exact.high), rel=2e-3)


@pytest.mark.parametrize("luck", [(0.0, 0.0, 1.0), (0.7, 0.7, 1.0), (1.0, 0.3, 0.5), (1.0, 1.0, 0.2)])
def test_intervals_cover_the_luck_of_both_tunings_and_of_the_draws(luck):
    """Log ratios of a random effect of each; what is covered is the mean over all tunings and draws there are."""
    from research.studies.crossed import middle, share

    rng, hits, blind = np.random.default_rng(0), np.zeros(2), 0
    for _ in range(300):
        a, b, d = (size * rng.normal(size=n) for size, n in zip(luck, (3, 3, 60), strict=True))
        values = a[:, None, None] + b[:, None] + d + 0.3 * rng.normal(size=(3, 3, 60))
        known = np.full(values.shape, True)
        for i, (entry, truth) in enumerate(((share(values > 0, known), 0.5), (middle(np.exp(values)), 1.0))):
            hits[i] += entry["interval"][0] <= truth <= entry["interval"][1]
        one = share(values[0, 0] > 0, known[0, 0])["interval"]  # one tuning each, as if it were all there is
        blind += one[0] <= 0.5 <= one[1]
    assert np.all(hits / 300 > 0.92)
    if luck[0]:
        assert blind / 300 < 0.7, "draws alone would claim too much"


@SIMULATES
def test_a_network_that_does_not_learn_is_pd_at_its_gain():
    from msgspec.structs import replace as with_settings

    from research.studies.chapter4.claim import TEST, at_gain
    from research.studies.chapter4.draws import KEPT, draw, loop
    from research.studies.rollouts import roll_out

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
    from research.studies.chapter4.claim import TEST, compare, conditions
    from research.studies.chapter4.draws import draw, motion

    wanted = conditions(saved["claim"]["tuned"]["learners"])
    rows = compare(wanted, 1, 2)
    tunings = len(wanted["tuned"])
    assert [(row["condition"], row["tuning"]) for row in rows] == [
        ("thesis", 0),
        *(("tuned", k) for k in range(tunings)),
    ]
    assert all(row["seed"] == draw(TEST, 1).seed and row["reference"] == motion(1) for row in rows)
    assert [row for row in compare(wanted, 0, 2) if row["draw"] == 1] == rows


def test_the_document_is_what_the_saved_summary_gives(saved):
    from research.studies.chapter4.document import render
    from research.studies.document import DOCS

    text = (DOCS / "thesis/chapter4.md").read_text(encoding="utf-8")
    assert text == render(saved)
    shown = re.findall(r"\(\.\./figures/([^)]+)\)", text)
    assert len(shown) >= 5 and all((DOCS / "figures" / name).is_file() for name in shown)


def test_numbers_are_written_with_three_digits_and_shares_in_percent():
    from research.studies.chapter4.document import percent, three

    assert [three(x) for x in (0.12345, 1533.29, 20.0, None)] == ["0.123", "1530", "20.0", "-"]
    assert [percent(x) for x in (0.5, 0.996, 0.004, 1.0, None)] == ["50 %", "99.6 %", "0.4 %", "100 %", "-"]


def test_sentences_follow_the_numbers():
    from research.studies.chapter4.document import changed, own, parts, wins

    assert [wins({"interval": i}) for i in ([0.51, 0.6], [0.2, 0.49], [0.4, 0.6], None)] == [
        "two-layer better",
        "one-layer better",
        "undecided",
        "undecided",
    ]
    intervals = ([0.95, 1.05], [0.5, 0.95], [1.02, 1.3], [0.8, 1.3], [0.8, None], [1.5, None])
    assert [own({"interval": i}).split()[0] for i in intervals] == ["does", "is", "is", "cannot", "cannot", "is"]
    assert "better" in own({"interval": [0.5, 0.95]}) and "worse" in own({"interval": [1.5, None]})
    harm = {"pd": 2.0, "gain": 0.2, "learning": -0.5, "learning_share": None}
    assert parts(harm) == "10.0 − 25.0 (worse than PD)"
    assert parts(harm | {"learning": 0.6, "learning_share": 0.75}) == "10.0 + 30.0 (learning 75 %)"
    errors = {"rms": {"pose_error.x": 1.0, "e.arm_1_joint": 1.0}}
    same, other = {"two_layer": errors, "one_layer": errors}, {"rms": {"pose_error.x": 1.0, "e.arm_1_joint": 0.8}}
    assert changed([same | {"reading": "a"}, same | {"reading": "b"}, same | {"one_layer": other, "reading": "c"}]) == [
        "c"
    ]


@pytest.mark.long
@SIMULATES
def test_a_little_of_the_study_runs_and_gives_the_document_all_it_tells(saved, monkeypatch, tmp_path):
    """The variants and readings have tests of their own; all else runs here, with next to no trials."""
    from research.studies.chapter4 import __main__ as command
    from research.studies.chapter4.document import render

    monkeypatch.setattr(command, "run_variants", lambda folder, say: saved["variants"])
    monkeypatch.setattr(command, "read_otherwise", lambda say: saved["readings"])
    summary = json.loads(json.dumps(command.study(command.QUICK, tmp_path)))
    assert summary.keys() == saved.keys()
    assert "| both tuned | 2 | fast arm |" in render(summary)
    rows = (tmp_path / "draws.csv").read_text(encoding="utf-8").splitlines()
    assert len(rows) == 1 + command.QUICK.draws * (1 + command.QUICK.tuning.tunings) and "nan" not in "".join(rows)
    assert {file.name for file in (tmp_path / "figures").iterdir()} == {"intervals.png", "flatness.png", "claim.png"}
    assert len((tmp_path / "trials.csv").read_text(encoding="utf-8").splitlines()) > 3 * 10

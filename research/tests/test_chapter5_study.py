"""The study of chapter 5: rigs that are what they say, honest counting, and a document that says what the runs gave."""

import json
import re

import numba
import numpy as np
import pytest
from places import ROOT

pytest.importorskip("optuna")
pytest.importorskip("cmaes")
SIMULATES = pytest.mark.skipif(numba.config.DISABLE_JIT, reason="runs of eight seconds, uncompiled")


@pytest.fixture(autouse=True)
def checkout(monkeypatch):
    monkeypatch.syspath_prepend(str(ROOT))


@pytest.fixture
def saved():
    return json.loads((ROOT / "research" / "studies" / "chapter5" / "summary.json").read_text(encoding="utf-8"))


def test_rigs_repeat_stay_in_range_and_differ():
    from research.studies.chapter5.rigs import DRAWN, PERIODS, UNITS, draw

    rigs = [draw(i).values for i in range(80)]
    assert draw(17).values == rigs[17] and len({rig["seed"] for rig in rigs}) == 80
    for number in DRAWN:
        values = [rig[number.name] for rig in rigs]
        kept = [value for value in values if value or number.name != "gap"]
        assert all(number.lower <= value <= number.upper for value in kept) and len(set(kept)) > 40
    assert {rig["period"] for rig in rigs} == set(PERIODS) and {rig["unit"] for rig in rigs} == set(UNITS)
    assert 8 < sum(rig["gap"] == 0 for rig in rigs) < 35


def test_every_number_of_a_rig_arrives_where_it_belongs():
    from research.studies.chapter5.rigs import chapter5, robot_of, with_rig

    values = {"coulomb_1": 2.0, "coulomb_2": 3.0, "breakaway": 1.25, "stribeck": 0.07, "viscous": 0.9, "gap": 0.004,
              "resolution": 2e-4, "side": "motor", "inertia": 0.4, "period": 0.0025, "mu": 0.004, "Kz": 3e-5,
              "v_range": 0.1, "unit": "radians", "centres": "random", "offset": 0.01, "seed": 9}  # fmt: skip
    e = with_rig(chapter5(), values)
    f, a = e.friction, e.actuator
    assert (f.coulomb, f.breakaway, f.stribeck, f.arm) == ((2.0, 3.0), 1.25, 0.07, 0.9)
    assert (a.gap, a.rotor_inertia, e.armature, e.sensor.resolution, e.sensor.side) == (0.004, 0.2, 0.2, 2e-4, "motor")
    assert (e.time.control_period, e.one_layer.mu, e.one_layer.centres, e.robust.arm) == (0.0025, 0.004, "random", 3e-5)
    assert (e.two_layer.v_range, e.inputs.error_scale, e.start.joint_offset, e.seed) == (0.1, 1.0, 0.01, 9)
    assert with_rig(chapter5(), values | {"gap": 0.0}).armature == 0.4, "without a gap nobody else has the rotor"
    assert with_rig(chapter5(), {}) == chapter5()
    fast, slow = robot_of(e), e.load_robot()
    for name in ("coulomb", "damping", "viscous"):
        assert np.array_equal(getattr(fast, name), getattr(slow, name))
    assert np.array_equal(fast.model.armature, slow.model.armature) and fast.stribeck == slow.stribeck


def test_rates_per_second_are_the_printed_ones_at_200_hz():
    from research.studies.chapter5.rigs import chapter5, per_second, with_rig

    assert per_second(chapter5()) == chapter5()
    faster = per_second(with_rig(chapter5(), {"period": 0.001}))
    assert faster.two_layer.F[1] == pytest.approx(1.8 / 5) and faster.two_layer.G[1] == pytest.approx(1 / 5)
    assert faster.one_layer.beta[1] == pytest.approx(1 / 5) and faster.two_layer.kappa == 0.007


def test_errors_are_the_thesis_s_and_the_rms_of_the_truth_and_a_lost_run_has_none():
    from research.studies.chapter5.compare import beyond, errors
    from research.studies.rollouts import Rollout

    e, true = np.zeros((800, 2)), np.zeros((800, 2))
    e[7], true[100], true[400:] = np.radians([-2.0, 8.0]), 9.0, np.radians([3.0, 4.0])
    run = Rollout(True, {"e": e, "true_e": true, "q": np.radians([[31.0, 32.0], [-31.0, -30.5]])})
    found = errors(run, 0.005)
    assert found["largest"] == pytest.approx(4.0) and found["rms"] == pytest.approx(np.sqrt(12.5))
    assert set(errors(Rollout(False, run.signals), 0.005).values()) == {float("inf")}
    assert beyond(run) and not beyond(Rollout(True, {"q": np.radians([[31.0, 32.0], [-31.0, -29.0]])}))


def test_counting_by_hand():
    from research.studies.chapter5.compare import LEARNERS, NAMES
    from research.studies.chapter5.verdict import of_class

    table = {"pd": [2.0] * 4, "one_layer": [1.0] * 4, "two_layer_zero": [0.5, 0.95, 1.05, np.inf],
             "two_layer_random": [0.4, 2.0, 2.0, np.inf], "integral": [1.0] * 4}  # fmt: skip
    rows = [
        {f"{name}.{measure}": table[name][k] for name in NAMES for measure in ("largest", "rms")}
        | {f"gain_of_{name}.{measure}": 2.0 for name in LEARNERS for measure in ("largest", "rms")}
        | {f"{name}.lost": bool(np.isinf(table[name][k])) for name in NAMES}
        | {f"{name}.beyond": False for name in NAMES}
        for k in range(4)
    ]
    found = of_class(rows)
    entry = found["rms"]
    assert found["lost"]["two_layer_zero"] == 1 and entry["two_layer_wins"]["share"] == 0.5
    assert entry["best"] == {"pd": 0, "one_layer": 0.5, "two_layer_zero": 0.25, "two_layer_random": 0.25}
    assert entry["near"]["share"] == 0.5 and entry["beyond_thesis"]["share"] == 0.25
    assert entry["ratio"]["median"] == 0.95 and entry["learning"]["one_layer"]["median"] == 0.5


@SIMULATES
def test_the_integral_is_the_network_with_every_unit_on():
    """Ten units that give 1, in NumPy: `Psi_hat = 10 W`, `W += F (r - kappa |r| W)`."""
    from research.studies.chapter5.compare import controller
    from research.studies.chapter5.rigs import DEGREES, chapter5

    e = chapter5()
    run = e.loop(e.load_robot(), controller(e, "integral")).run()
    W, two = np.zeros(2), e.two_layer
    for k in range(200):
        np.testing.assert_allclose(run["psi_hat"][k], 10 * W / DEGREES, rtol=1e-9, atol=1e-12)
        r = DEGREES * run["r"][k]
        W = W + two.F[1] * (r - two.kappa * np.linalg.norm(r) * W)
    assert np.abs(run["psi_hat"][:200]).max() > 1


@SIMULATES
def test_a_learner_that_does_not_learn_is_pd_at_its_gain():
    from msgspec.structs import replace as with_settings

    from research.studies.chapter5.compare import compare
    from research.studies.chapter5.rigs import chapter5, robot_of

    e = chapter5()
    still = with_settings(e, learning=with_settings(e.learning, learning=False))
    row = compare([(still, robot_of(still))])[0]
    assert row["one_layer.rms"] == pytest.approx(row["gain_of_one_layer.rms"], rel=1e-9)
    assert row["two_layer_zero.rms"] == pytest.approx(row["pd.rms"], rel=0.01)


def test_the_file_s_calibrated_numbers_are_those_of_the_study(saved):
    from research.studies.chapter5.calibration import SEARCHED, taken

    assert taken() == saved["experiment"]["file"]
    assert all(number.lower <= taken()[number.name] <= number.upper for number in SEARCHED)
    assert saved["experiment"]["deviation"] < 0.02


@SIMULATES
def test_the_search_repeats_itself():
    from research.studies.chapter5.calibration import CASES, Budget, fit

    first, again = (fit(CASES[0], Budget(1, 10), seed=3) for _ in range(2))
    assert first == again and 0 < first[0] < 10


@SIMULATES
def test_a_saved_rig_gives_its_saved_errors_again(saved):
    from research.studies.chapter5.calibration import shown

    case = saved["calibration"]["one_layer"]
    again = shown(case["values"], case["unit"])
    for name, tolerance in (("pd", 0.02), ("one_layer", 0.03)):  # the two-layer network's depend on rounding
        np.testing.assert_allclose(again[name], case["largest"][name], rtol=tolerance)


def test_the_document_is_what_the_saved_summary_gives(saved):
    from research.studies.chapter5.document import render
    from research.studies.document import DOCS

    text = (DOCS / "thesis/chapter5.md").read_text(encoding="utf-8")
    assert text == render(saved) and saved["ranking"]["rigs"] >= 100
    shown = re.findall(r"\(\.\./figures/([^)]+)\)", text)
    assert len(shown) >= 2 and all((DOCS / "figures" / name).is_file() for name in shown)


@pytest.mark.long
@SIMULATES
def test_a_little_of_the_study_runs_and_gives_the_document_all_it_tells(saved, monkeypatch, tmp_path):
    from dataclasses import replace

    from research.studies.chapter5 import __main__ as command
    from research.studies.chapter5 import compare
    from research.studies.chapter5.document import render

    for name in ("gap", "resolution", "rate"):
        monkeypatch.delitem(compare.MOVED, name)
    summary = json.loads(json.dumps(command.study(replace(command.QUICK, rigs=2), tmp_path)))
    assert summary.keys() == saved.keys()
    assert "| sample rate: 200 Hz |" in render(summary)
    rows = (tmp_path / "rigs.csv").read_text(encoding="utf-8").splitlines()
    assert len(rows) == 1 + 2 * 2 and "nan" not in "".join(rows)
    names = {file.name for file in (tmp_path / "figures").iterdir()}
    assert names == {"chapter5-sweep.png", *(f"chapter5-figure-5.{i}.png" for i in (3, 4, 5))}

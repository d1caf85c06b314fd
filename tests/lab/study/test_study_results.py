"""What a study's rows say: intervals that cover, shares that are known, regions that are found, pages and tables."""

from __future__ import annotations

import csv
import json
import math
import re
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import stats
from study_files import SHORT, planned, run_here

from mmnn_pin.cli import main
from mmnn_pin.errors import StudyError
from mmnn_pin.lab.show import study_figures as plots
from mmnn_pin.lab.show.figure import FIGURES, axes_grid
from mmnn_pin.lab.show.study import page, render
from mmnn_pin.lab.study.factors import Factor
from mmnn_pin.lab.study.intervals import differ, quantile, rate
from mmnn_pin.lab.study.results import Results, load_results, unit_of, value_of
from mmnn_pin.lab.study.settings import Sampling, StudySettings, Success
from mmnn_pin.lab.study.store import NAME, TrialResult, writing
from mmnn_pin.lab.study.verdict import (
    bins_of,
    region_of,
    sentences,
    share_of,
    verdict,
)

# -- intervals --------------------------------------------------------------------------------------------------------


def test_intervals_cover_the_truth_as_often_as_they_say() -> None:
    rng = np.random.default_rng(0)
    draws, true = rng.exponential(size=(1500, 60)), stats.expon.ppf(0.8)
    inside = [(q := quantile(row, 0.8)).low <= true <= q.high for row in draws]
    assert 0.94 < np.mean(inside) < 0.99
    counts = rng.binomial(60, 0.3, 1500)
    assert 0.93 < np.mean([(r := rate(np.arange(60) < k)).low <= 0.3 <= r.high for k in counts]) < 0.97


@pytest.mark.parametrize(("groups", "seeds", "spread"), [(12, 8, 3.0), (40, 5, 1.0), (40, 5, 0.0), (64, 2, 2.0)])
def test_seeds_of_one_draw_do_not_narrow_an_interval(groups: int, seeds: int, spread: float) -> None:
    """Draws decide more (`spread`) or less of a run: the truth of all draws is covered as often as is said.

    The intervals of runs as if each were a draw of its own cover it far less often where draws decide much.
    """
    rng = np.random.default_rng(7)
    draws = np.repeat(np.arange(groups), seeds)
    errors = spread * rng.standard_normal((1000, groups, 1)) + rng.standard_normal((1000, groups, seeds))
    errors, true = errors.reshape(1000, -1), math.hypot(spread, 1.0) * stats.norm.ppf(0.7)
    good = errors < true  # of which 0.7 are, over all draws
    covered, naive = [], []
    for row, successes in zip(errors, good, strict=True):
        q, r = quantile(row, 0.7, draws), rate(successes, draws)
        covered.append([q.low <= true <= q.high, r.low <= 0.7 <= r.high])
        q, r = quantile(row, 0.7), rate(successes)
        naive.append([q.low <= true <= q.high, r.low <= 0.7 <= r.high])
    assert np.mean(covered, axis=0).min() > 0.93
    if spread:
        assert np.mean(naive, axis=0).max() < 0.91
    else:  # and where they decide nothing, little is lost
        wide, narrow = (np.mean([(r := rate(s, of)).high - r.low for s in good]) for of in (draws, None))
        assert wide < 1.15 * narrow


def test_an_interval_of_draws_is_that_of_a_bootstrap_of_draws() -> None:
    """A second answer: the middle 95 % of the rate over draws that are drawn again, with all their seeds."""
    rng = np.random.default_rng(8)
    p = rng.beta(2.0, 1.0, (200, 1))
    good = rng.random((200, 6)) < p
    again = good[rng.integers(0, 200, (4000, 200))].mean(axis=(1, 2))
    found = rate(good.ravel(), np.repeat(np.arange(200), 6))
    assert [found.low, found.high] == pytest.approx(np.quantile(again, [0.025, 0.975]), abs=0.006)
    assert found.high - found.low > 1.5 * (rate(good.ravel()).high - rate(good.ravel()).low)


def test_seeds_that_repeat_a_draw_say_nothing_new() -> None:
    rng = np.random.default_rng(9)
    one, other = rng.random(30) < 0.6, rng.random(30) < 0.4
    draws, values = np.repeat(np.arange(30), 4), rng.random(30)
    again, single = rate(np.repeat(one, 4), draws), rate(one)
    assert (again.low, again.high) == pytest.approx((single.low, single.high))
    assert quantile(np.repeat(values, 4), 0.5, draws) == quantile(values, 0.5)
    assert differ(np.repeat(one, 4), np.repeat(other, 4), draws) == differ(one, other)
    ranks = share_of(np.repeat(values, 4).tolist(), np.repeat(rng.random(30), 4), True, draws)
    assert ranks.p > 0.01


def test_a_factor_without_influence_has_none_by_many_seeds_either() -> None:
    rng, draws = np.random.default_rng(10), np.repeat(np.arange(40), 6)
    found = []
    for _ in range(300):
        values, own = rng.random(40)[draws].tolist(), rng.random(40)[draws] + 0.2 * rng.random(240)
        found.append([share_of(values, own, True, groups).p < 0.05 for groups in (draws, None)])
    honest, naive = np.mean(found, axis=0)
    assert honest < 0.09 and naive > 0.5


@given(st.integers(0, 50), st.integers(1, 50))
def test_a_rate_solves_wilsons_equation(successes: int, more: int) -> None:
    n = successes + more
    found, z = rate(np.arange(n) < successes), stats.norm.ppf(0.975)
    for bound in (found.low, found.high):
        assert (found.value - bound) ** 2 == pytest.approx(z**2 * bound * (1 - bound) / n, abs=1e-9)


@given(st.lists(st.floats(-1e3, 1e3), min_size=1, max_size=60), st.integers(0, 20))
def test_runs_that_did_not_complete_are_the_worst(values: list[float], lost: int) -> None:
    with_lost = np.array(values + [math.inf] * lost)
    found = quantile(with_lost, 0.5)
    assert found.low <= found.value <= found.high
    assert (found.value == math.inf) == (lost > len(values))
    assert quantile(with_lost, 1.0).value == (math.inf if lost else max(values))


def test_a_difference_is_judged_on_runs_of_the_same_draw() -> None:
    one = np.array([True] * 8 + [False] * 2 + [True] * 90)
    other = np.array([False] * 8 + [True] * 2 + [True] * 90)
    assert differ(one, other) == pytest.approx(2 * sum(math.comb(10, k) for k in range(3)) / 2**10)
    assert differ(one, one) == 1.0


# -- what decides -----------------------------------------------------------------------------------------------------


def test_shares_are_those_of_a_function_whose_shares_are_known() -> None:
    """`y = x1 + x2 / 2` of uniform numbers: ranks keep the order, shares are 4/5 and 1/5; x3 has none."""
    rng = np.random.default_rng(1)
    x = rng.random((4000, 3))
    y = x[:, 0] + x[:, 1] / 2
    found = [share_of(column.tolist(), y, True) for column in x.T]
    assert [share.share for share in found] == pytest.approx([0.8, 0.2, 0.0], abs=0.04)
    assert found[0].direction > 0.8 and found[0].p < 1e-10 < found[2].p
    assert share_of(x[:, 0].tolist(), -y, True).direction < -0.8


def test_a_factor_without_influence_has_no_share_on_average() -> None:
    rng = np.random.default_rng(2)
    shares = [share_of(rng.random(64).tolist(), rng.random(64), True) for _ in range(300)]
    assert np.mean([share.p < 0.05 for share in shares]) < 0.08
    assert np.mean([share.share for share in shares]) < 0.05


def test_shares_of_levels_and_of_runs_that_were_lost() -> None:
    values = ["a", "b", "c"] * 40
    result = np.array([{"a": 1.0, "b": 2.0, "c": math.inf}[value] for value in values])
    assert share_of(values, result, False).share == pytest.approx(1.0)
    assert share_of(values, np.ones(120), False).share == 0.0
    assert bins_of([3.0, 1.0, 2.0, 1.0], True).tolist() == [2, 0, 1, 0]
    assert set(np.bincount(bins_of(list(np.random.default_rng(0).random(800)), True)).tolist()) == {100}


# -- regions ----------------------------------------------------------------------------------------------------------


def test_a_region_is_found_where_it_is_and_nothing_more() -> None:
    rng = np.random.default_rng(3)
    values: dict[str, Any] = {"x": rng.random(2000).tolist(), "y": rng.random(2000).tolist()}
    values["kind"] = rng.choice(["good", "bad"], 2000).tolist()
    good = (np.array(values["x"]) < 0.6) & (np.array(values["kind"]) == "good")
    factors = {name: Factor(uniform=(0, 1)) for name in "xy"} | {"kind": Factor(choice=("good", "bad"))}
    half = rng.random(2000) < 0.5
    found = region_of(values, factors, good, half, 0.95)
    assert found is not None
    cuts = {cut.factor: cut for cut in found.cuts}
    assert set(cuts) == {"x", "kind"} and cuts["kind"].levels == ("good",)
    assert cuts["x"].low is None and cuts["x"].high == pytest.approx(0.6, abs=0.06)
    assert found.success.value > 0.9 and found.share == pytest.approx(0.3, abs=0.05)


def test_no_region_is_found_in_noise_and_all_where_all_succeed() -> None:
    rng = np.random.default_rng(4)
    values, factors = {"x": rng.random(400).tolist()}, {"x": Factor(uniform=(0, 1))}
    half = rng.random(400) < 0.5
    assert region_of(values, factors, rng.random(400) < 0.5, half, 0.95) is None
    everything = region_of(values, factors, np.ones(400, bool), half, 0.95)
    assert everything is not None and everything.cuts == () and everything.share == 1.0


def test_a_region_is_judged_by_runs_that_did_not_find_it() -> None:
    """In noise a box of 75 % can be found where 65 % succeed; on the other runs it is no better than that."""
    found, true = [], []
    for seed in range(40):
        rng = np.random.default_rng(seed)
        values = {"x": rng.random(300).tolist(), "y": rng.random(300).tolist()}
        factors = {name: Factor(uniform=(0, 1)) for name in values}
        good, half = rng.random(300) < 0.65, rng.random(300) < 0.5
        if (box := region_of(values, factors, good, half, 0.75)) is not None:
            inside = np.all([cut.holds(values[cut.factor]) for cut in box.cuts], axis=0)
            assert good[inside & half].mean() >= 0.75
            found.append(box.success.value)
            true.append(good[inside & ~half].mean())
    assert len(found) > 3 and found == true and np.mean(found) < 0.72


# -- the answer -------------------------------------------------------------------------------------------------------


def made(good: dict[str, np.ndarray], error: dict[str, np.ndarray], factors: dict[str, Any]) -> Results:
    """Results of rows that are made up: successes are errors up to 1."""
    rows = []
    for name, successes in good.items():
        for i, success in enumerate(successes):
            metrics = {"e.joint.peak": float(error[name][i]) if success else 2.0}
            values = {factor: column[i] for factor, column in factors.items()}
            row = {"id": len(rows), "point": i, "controller": name, "seed": 1, "parameters": values}
            rows.append(TrialResult(**row, status="completed", time=1.0, metrics=metrics))
    settings = StudySettings(
        experiment="chapter4",
        factors={name: Factor(uniform=(0.0, 1.0)) for name in factors},
        sampling=Sampling(points=1),
        success=Success(at_most={"e.*.peak": 1.0}),
    )
    meta = {"controllers": list(good), "settings": {}, "versions": {}, "file": "made.toml"}
    units = {"e.joint.peak": "rad"}
    return Results(Path("x"), "made", settings, len(rows), rows, [], ("e.*.peak",), units, meta)


def test_the_answer_is_the_controller_with_most_successes() -> None:
    rng = np.random.default_rng(5)
    good = {"pd": rng.random(300) < 0.5, "two_layer": rng.random(300) < 0.9}
    error = {name: rng.random(300) for name in good}
    found = verdict(made(good, error, {"x": rng.random(300)}))
    assert found.controller == "two_layer" and found.alike == () and found.deciding == ""
    told = sentences(made(good, error, {"x": rng.random(300)}), found)
    share = 100 * good["two_layer"].mean()
    assert told[0].startswith(f"Take two_layer: it succeeds in {share:.1f} % [") and told[0].endswith("of 300 runs.")


def test_equal_successes_are_decided_by_the_smaller_error_and_it_is_said() -> None:
    rng = np.random.default_rng(6)
    same = rng.random(300) < 0.99
    error = {"pd": rng.uniform(0.5, 1, 300), "two_layer": rng.uniform(0, 0.5, 300)}
    results = made({"pd": same, "two_layer": same}, error, {"x": rng.random(300)})
    found = verdict(results)
    assert found.controller == "two_layer" and found.alike == ("pd",) and found.deciding == "e.*.peak"
    told = sentences(results, found)
    why = "its successes and those of pd are not told apart by so many runs"
    assert told[0] == f"Take two_layer: {why}, and it has the smallest median of e.*.peak among them."
    assert told[-1].startswith("Within everything that was varied ") and told[-1].endswith("check it succeed.")


def test_a_region_that_the_runs_kept_apart_do_not_confirm_is_said_to_be_none() -> None:
    results = made({"pd": np.ones(40, bool)}, {"pd": np.ones(40)}, {"x": np.linspace(0, 1, 40)})
    found = verdict(results)
    assert found.region is not None and not found.region.cuts
    poor = replace(found, region=replace(found.region, success=rate(np.arange(20) < 1)))
    assert sentences(results, poor)[-1].endswith("succeed, fewer than the 95 % that were asked.")


@given(st.integers(0, 10**6), st.integers(8, 60), st.floats(0.05, 0.95))
@settings(max_examples=60, deadline=None)
def test_what_is_said_of_ranges_holds_in_the_map_beside_it(seed: int, count: int, share: float) -> None:
    """Read from the sentence and from the picture's numbers; neither shares code with the other."""
    rng = np.random.default_rng(seed)
    columns = {"x": rng.choice([1.0, 2.0, 3.0], count), "y": rng.choice([10.0, 20.0], count)}
    good = (rng.random(count) < share) | ((columns["x"] == 2.0) & (rng.random(count) < 0.9))
    results = made({"pd": good}, {"pd": np.ones(count)}, columns)
    found = verdict(results)
    if found.region is not None or found.controller is None:
        return
    told = sentences(results, found)[-1]
    cuts = {name: float(value) for name, value in re.findall(r"\b([xy]) ([0-9.]+)", told)}
    inside = np.logical_and.reduce([np.ones(count, bool), *(columns[name] == value for name, value in cuts.items())])
    assert f"{100 * good[inside].mean():.1f} % [" in told and f"of {inside.sum()} runs" in told and cuts
    cells = [int(text.get_text()) for text in plots.success_maps(results).axes[0].texts]
    singles = [good[columns[name] == value].mean() for name in columns for value in set(columns[name])]
    if told.startswith("Within"):
        assert good[inside].mean() >= 0.95 and (len(cuts) == 1 or max(singles) < 0.95)
    else:
        assert max(cells) < 95 and max(singles) < 0.95
    assert max(cells) < 95 or told.startswith("Within")


@given(st.lists(st.floats(0.0, 0.99) | st.floats(1.0, 200.0), min_size=1, max_size=30))
@settings(max_examples=60, deadline=None)
def test_successes_that_are_lost_are_counted(peaks: list[float]) -> None:
    """Where no bound was asked for, every run that completes is a success."""
    results = made({"pd": np.ones(len(peaks), bool)}, {"pd": np.array(peaks)}, {"x": np.linspace(0, 1, len(peaks))})
    lost = [peak for peak in peaks if peak >= 1]
    for bounds in ({}, {"e.*.peak": 0.995}):  # that is the advice, followed
        results = replace(results, settings=msgspec.structs.replace(results.settings, success=Success(at_most=bounds)))
        told = " ".join(sentences(results, verdict(results)))
        said = re.search(r"lost in (\d+) of these all the same \(e.joint.peak is up to ([0-9.e+]+) rad\)", told)
        assert bool(said) == (bool(lost) and not bounds)
        if said:
            assert int(said[1]) == len(lost) and float(said[2]) == pytest.approx(max(lost), rel=0.01)


def test_where_nothing_succeeds_nothing_is_recommended() -> None:
    none = np.zeros(50, bool)
    results = made({"pd": none}, {"pd": np.ones(50)}, {"x": np.linspace(0, 1, 50)})
    assert verdict(results).controller is None
    assert sentences(results, verdict(results)) == ["None of pd succeeds in any run."]


def test_patterns_take_the_largest_and_what_is_no_number_is_worst() -> None:
    metrics = {"e.a.peak": 1.0, "e.b.peak": 3.0, "z.v.peak": 9.0, "e.a.rms_0_1": math.nan}
    assert value_of(metrics, "e.*.peak") == 3.0
    assert value_of(metrics, "e.*.rms_0_1") == math.inf
    assert math.isnan(value_of(metrics, "gone"))
    named = ("pose_error.phi.rms_0_0.5", "e.slide.peak", "e.a.peak", "z.vx.peak")
    assert [unit_of(name, {"slide"}) for name in named] == ["rad", "m", "rad", "m/s"]


# -- pages, tables, files ---------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def done(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder of a study that has run, some of its runs diverged."""
    folder = tmp_path_factory.mktemp("study")
    text = SHORT.replace("[factors]\n", '[factors]\n"feedback.arm" = { grid = [30.0, 1e6] }\n')
    run_here(planned(folder, text), folder)
    return folder


def test_the_table_tells_outcomes_rates_and_quantiles(done: Path, capsys) -> None:
    assert main(["study", str(done / "short.toml"), "--out", str(done)]) == 0
    said = capsys.readouterr().out
    assert re.search(r"diverged +8 +8 +8", said) and re.search(r"runs +completed +8 +8 +8", said)
    assert ("median" in said and max(map(len, said.splitlines())) <= 110) or str(done) in said
    results = load_results(done)
    ordered = np.sort(results.metric("pd", "e.*.peak"))
    assert np.isinf(ordered[8:]).all() and np.isfinite(ordered[:8]).all()


def test_a_bound_that_too_few_runs_give_is_a_dash_and_the_caption_says_so() -> None:
    """Of three runs that completed, no interval of the 95 % quantile is bounded above."""
    results = made({"pd": np.ones(3, bool)}, {"pd": np.array([0.1, 0.2, 0.3])}, {"x": np.linspace(0, 1, 3)})
    text = " ".join(render(results).split())
    assert ", -]" in text and "inf" not in text and "A dash: not enough runs completed, or too few to bound it." in text


def test_json_holds_the_same_numbers(done: Path, capsys) -> None:
    assert main(["study", str(done / "short.toml"), "--out", str(done), "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert found["rows"] == found["done"] == 48 and found["stopped"] is False
    pd = found["controllers"]["pd"]
    assert pd["outcomes"] == {"completed": 8, "diverged": 8}
    assert pd["metrics"]["e.*.peak"]["q95"]["value"] is None and pd["metrics"]["e.*.peak"]["unit"] == "rad"
    ordered = sorted(load_results(done).metric("pd", "e.*.peak"))
    assert pd["metrics"]["e.*.peak"]["median"]["value"] == ordered[7]
    assert found["verdict"]["take"] in found["controllers"]


def test_a_half_done_study_says_so(done: Path, tmp_path: Path) -> None:
    (tmp_path / NAME).write_bytes((done / NAME).read_bytes())
    with writing(tmp_path / NAME) as store:
        store.rewrite(store.facts, store.results[:20])
    assert "20 runs of 48" in (said := render(load_results(tmp_path)))
    assert "28 runs are missing; the same command makes them" in said
    with writing(tmp_path / NAME) as store:
        store.rewrite(store.facts, [])
    with pytest.raises(StudyError, match="holds no rows yet"):
        load_results(tmp_path)


def test_the_page_is_whole_and_tells_the_answer(done: Path, tmp_path: Path, capsys) -> None:
    assert main(["report", str(done), "--html", str(tmp_path / "page.html")]) == 0
    text = (tmp_path / "page.html").read_text()
    results = load_results(done)
    assert sentences(results, verdict(results))[0].replace("'", "&#39;") in text
    head, *_ = text.partition("<svg")
    assert text.count("<svg") == 5 and "src=" not in text and "http" not in head
    assert re.search(r"row \d+: nu of \w+ left its bounds", text)
    assert main(["report", str(done), "--html", str(tmp_path / "page.html")]) == 2
    assert main(["report", str(done), str(done), "--html", str(tmp_path / "two.html")]) == 2
    assert "a study among other runs" in capsys.readouterr().err


def test_a_page_shows_names_as_text(done: Path) -> None:
    results = load_results(done)
    titled = msgspec.structs.replace(results.settings, title="<script>alert(1)</script>")
    assert "<script" not in page(replace(results, settings=titled)).html


def test_pictures_show_what_was_counted(done: Path) -> None:
    results = load_results(done)
    axes = plots.against_factors(results).axes[list(results.factors).index("feedback.arm")]
    heights = {tuple(np.round(line.get_ydata(), 6)) for line in axes.get_lines() if len(line.get_ydata()) == 2}
    expected = set()
    for name in results.controllers:
        values, good = results.values(name, "feedback.arm"), results.succeeded(name)
        expected.add(tuple(np.round([good[np.array(values) == level].mean() for level in (30.0, 1e6)], 6).tolist()))
    assert expected <= heights
    curves = [line for line in plots.distributions(results).axes[0].get_lines() if len(line.get_ydata()) > 2]
    assert max(float(np.max(line.get_ydata())) for line in curves) == pytest.approx(0.5), "half of the runs diverged"
    assert len(plots.success_maps(results).axes) == 4 and len(plots.sensitivity(results).axes) == 3


@pytest.mark.parametrize("span", [6.0, 90.0, 110.0, 3e4])
def test_numbers_of_a_panels_axis_do_not_touch(span: float) -> None:
    picture, (axes, *_) = axes_grid(3, 3, 3.5, 2.7, 0.7)
    axes.plot([0.013, 0.013 * span], [0.0, 1.0])
    plots.log_axis(axes)
    picture.canvas.draw()
    shown = [label for label in axes.xaxis.get_ticklabels(which="both") if label.get_text()]
    boxes = [label.get_window_extent() for label in shown]
    inside = sorted((box.x0, box.x1) for box in boxes if axes.bbox.x0 <= (box.x0 + box.x1) / 2 <= axes.bbox.x1)
    assert len(inside) >= 2 and all(left[1] < right[0] for left, right in pairwise(inside))


def test_plot_draws_the_figures_of_a_study_and_no_others(done: Path, tmp_path: Path, capsys) -> None:
    assert main(["plot", str(done), "--out", str(tmp_path / "all")]) == 0
    assert {file.stem for file in (tmp_path / "all").iterdir()} == set(FIGURES["study"])
    assert main(["plot", str(done), "--what", "study-errors", "--out", str(tmp_path / "one.svg")]) == 0
    assert "Errors against each factor" in (tmp_path / "one.svg").read_text()
    capsys.readouterr()
    assert main(["plot", str(done), "--what", "psi"]) == 2
    assert "'psi' is no figure of a study: there is: study-distributions" in capsys.readouterr().err
    assert main(["plot", str(tmp_path), "--what", "study-maps"]) == 2
    assert "'study-maps' is a figure of a study: name a study's folder" in capsys.readouterr().err


def test_rows_are_exported_with_their_bits(done: Path, tmp_path: Path) -> None:
    pq = pytest.importorskip("pyarrow.parquet")
    assert main(["export", str(done), "--to", "csv", "--out", str(tmp_path / "rows.csv")]) == 0
    assert main(["export", str(done / NAME), "--to", "parquet", "--out", str(tmp_path)]) == 0
    rows = load_results(done).rows
    with (tmp_path / "rows.csv").open() as file:
        table = list(csv.DictReader(file))
    frame = pq.read_table(tmp_path / "short.parquet")
    assert len(table) == frame.num_rows == 48
    for row, line, record in zip(rows, table, frame.to_pylist(), strict=True):
        assert (
            line["controller"] == record["controller"] == row.controller and int(line["id"]) == record["id"] == row.id
        )
        assert float(line["factor masses.root"]) == record["factor masses.root"] == row.parameters["masses.root"]
        for name, value in row.metrics.items():
            for read in (float(line[name]), record[name]):
                assert read == value or (math.isnan(read) and math.isnan(value))
    assert frame.schema.field("effort").metadata[b"unit"] == "N²m²s".encode()
    assert json.loads(frame.schema.metadata[b"mmnn_pin"])["name"] == "short"


def test_rows_go_to_tables_only_and_files_are_not_replaced(done: Path, tmp_path: Path, capsys) -> None:
    assert main(["export", str(done), "--to", "mcap", "--out", str(tmp_path)]) == 2
    assert "unknown format for the rows of a study 'mcap'" in capsys.readouterr().err
    (tmp_path / "short.csv").write_text("mine")
    assert main(["export", str(done), "--to", "csv", "--out", str(tmp_path)]) == 2
    assert (tmp_path / "short.csv").read_text() == "mine"


def test_plot_of_a_study_leaves_out_figures_that_it_has_nothing_for(tmp_path: Path, capsys) -> None:
    text = SHORT[: SHORT.index("[factors]")] + '[factors]\n"masses.root" = { uniform = [0.5, 1.5] }\n'
    run_here(planned(tmp_path, text), tmp_path)
    assert main(["plot", str(tmp_path), "--out", str(tmp_path / "all")]) == 0
    drawn = {file.stem for file in (tmp_path / "all").iterdir()}
    assert "study-errors" in drawn and "study-maps" not in drawn
    assert main(["plot", str(tmp_path), "--what", "study-maps"]) == 2
    assert "nothing to plot for study-maps" in capsys.readouterr().err

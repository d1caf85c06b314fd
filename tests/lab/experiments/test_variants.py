"""Chapter 4 in its variants: every value marked, what is printed equal in all, and each unfairness told."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

import numba
import pytest
from marks import leaves, marked

from mmnn_pin import Recording, load_experiment, run_experiment
from mmnn_pin.cli import main
from mmnn_pin.errors import ConfigError, UnknownName
from mmnn_pin.lab.experiments.config import bundled, read_toml, variants
from mmnn_pin.lab.experiments.result import Result, unfair
from mmnn_pin.lab.show import comparison

FILES = variants(bundled()["chapter4"])
LEARNERS = ("two_layer", "one_layer")
compiled_only = pytest.mark.skipif(bool(numba.config.DISABLE_JIT), reason="slow in plain Python")
each_variant = pytest.mark.parametrize("variant", FILES)


# -- the files ---------------------------------------------------------------------------------------------------------


def test_there_are_three_and_fair_is_the_default() -> None:
    assert sorted(FILES) == ["fair", "figures", "printed"] and next(iter(FILES)) == "fair"
    assert load_experiment("chapter4") == load_experiment("chapter4", variant="fair")
    assert {name: load_experiment("chapter4", variant=name).variant for name in FILES} == {n: n for n in FILES}
    assert not any("." in name for name in bundled())


@each_variant
def test_every_value_carries_exactly_one_mark(variant: str) -> None:
    assert sorted(marked(FILES[variant])) == sorted(leaves(read_toml(FILES[variant])))


def test_the_mark_of_a_line_is_missed_when_it_is_not_there(tmp_path: Path) -> None:
    text = FILES["fair"].read_text()
    for old, new in (("# printed: k1", ""), ("# printed: k1", "# printed, assumed"), ("# printed: k1", "# ours")):
        (tmp_path / "x.toml").write_text(text.replace(old, new))
        with pytest.raises(AssertionError, match="base = 500"):
            marked(tmp_path / "x.toml")


def test_what_is_printed_is_equal_in_all_variants() -> None:
    every = {name: marked(file) for name, file in FILES.items()}
    printed: dict[str, Any] = {}
    for values in every.values():
        for key, (value, mark) in values.items():
            if mark == "printed":
                assert printed.setdefault(key, value) == value, key
    departures = {
        key for values in every.values() for key, (value, _) in values.items() if printed.get(key, value) != value
    }
    # The order of Appendix B: a variant that departs from the print does not call it printed.
    assert departures == {"learning.update"}
    assert {"kinematic.kx", "feedback.base", "two_layer.F", "one_layer.mu", "inputs.signals", "learning.rates"} <= set(
        printed
    )


def test_only_the_fitted_variant_is_calibrated() -> None:
    fitted = {name for name, file in FILES.items() if any(mark == "calibrated" for _, mark in marked(file).values())}
    assert "figures" in fitted and "printed" not in fitted


@pytest.mark.parametrize("variant", ["fair", "printed"])
def test_learners_of_a_fair_variant_share_everything_but_the_network(variant: str) -> None:
    e = load_experiment("chapter4", variant=variant)
    assert e.two_layer.hidden == e.one_layer.hidden == 22
    one, two = (e.controller(name) for name in LEARNERS)
    assert (one.feedback, one.robust, one.inputs) == (two.feedback, two.robust, two.inputs)
    assert unfair(e, {name: {} for name in LEARNERS}) == ""


# -- choosing one ------------------------------------------------------------------------------------------------------


def test_an_unknown_variant_is_told_with_the_near_one(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(UnknownName, match=r"unknown variant 'figure': did you mean 'figures'\? there is: fair, "):
        load_experiment("chapter4", variant="figure")
    assert main(["run", "chapter4", "--variant", "prnted"]) == 2
    assert "did you mean 'printed'?" in capsys.readouterr().err
    with pytest.raises(ConfigError, match=r"^--variant: error: track has no variants"):
        load_experiment("track", variant="fair")


def test_variants_of_a_file_lie_beside_it(tmp_path: Path) -> None:
    text = bundled()["chapter4"].read_text()
    (tmp_path / "mine.toml").write_text(text.replace('variant = "fair"', 'variant = "plain"'))
    (tmp_path / "mine.slow.toml").write_text(text.replace("speed = 0.3", "speed = 0.1"))
    (tmp_path / "minestrone.toml").write_text(text)
    assert list(variants(tmp_path / "mine.toml")) == ["plain", "slow"]
    slow = load_experiment(tmp_path / "mine.toml", ["seed=4"], "slow")
    assert slow.reference.base is not None and (slow.reference.base["speed"], slow.seed) == (0.1, 4)


def test_the_variant_is_recorded_and_listed(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    options = ["--variant", "printed", "--controller", "pd", "--set", "time.duration=0.02", "--set", "plots=[]"]
    assert main(["run", "chapter4", *options, "--out", str(tmp_path / "out"), "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["variant"] == "printed"
    assert json.loads(Recording.open(tmp_path / "out" / "pd.h5").config_text)["variant"] == "printed"
    assert main(["list"]) == 0
    assert "(--variant fair, figures, printed)" in " ".join(capsys.readouterr().out.split())  # folded to the terminal
    assert main(["list", "--json"]) == 0
    told = json.loads(capsys.readouterr().out)["variants"]
    assert told["chapter4"] == list(FILES) and told["track"] == []


def test_variants_have_folders_of_their_own(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    quick = ["--controller", "pd", "--set", "time.duration=0.02", "--set", "plots=[]"]
    assert main(["run", "chapter4", "--variant", "fair", *quick]) == main(["run", "chapter4", *quick]) == 0
    assert sorted(file.parent.name for file in tmp_path.rglob("pd.h5")) == ["chapter4", "chapter4-fair"]


# -- robust terms of single learners -----------------------------------------------------------------------------------


def test_a_learner_can_have_a_robust_term_of_its_own() -> None:
    e = load_experiment("chapter4", ["robust_of.one_layer={base=3.0, arm=0.5, ZB=[1, 2]}"])
    assert e.controller("one_layer").robust.base == 3.0 and e.controller("two_layer").robust == e.robust  # type: ignore


@pytest.mark.parametrize(
    ("setting", "told"),
    [
        ("robust_of.pd={base=1.0}", "robust_of.pd: error: unknown key 'pd': there is: two_layer, one_layer"),
        (
            "robust_of.one_layer={bas=1.0}",
            "robust_of.one_layer.bas: error: unknown key 'bas': did you mean 'base'? there is: base, arm, ZB",
        ),
        ("robust_of.two_layer={base=-1.0}", "robust.base: error: -1.0"),
    ],
)
def test_bad_robust_terms_are_told(setting: str, told: str) -> None:
    with pytest.raises((ConfigError, UnknownName)) as error:
        load_experiment("chapter4", [setting])
    assert told in str(error.value)


def test_a_run_refuses_pictures_that_there_are_not(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    code = main(["run", "chapter4", "--set", "plots=['figure-4.1']", "--out", str(tmp_path / "runs")])
    assert code == 2 and not (tmp_path / "runs").exists()
    assert "plots: error: unknown plot 'figure-4.1': did you mean 'figure-4.4'?" in capsys.readouterr().err


# -- what the tables say -----------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def figures() -> Result:
    duration = ["time.duration=0.02"] if numba.config.DISABLE_JIT else []
    return run_experiment(load_experiment("chapter4", duration, "figures"), "chapter4")


def test_the_first_line_says_that_figures_is_not_fair_and_with_which_gains(figures: Result) -> None:
    text = comparison.render(figures)
    assert text.startswith("Not a fair comparison: ") and "robust term of its own" in text.splitlines()[0]
    head = " ".join(text.partition("\nChapter 4")[0].split())
    gains = [figures.recordings[name]["effective_gain"] for name in LEARNERS]
    base, arm = ([each[:, part].mean() for each in gains] for part in (slice(0, 2), slice(2, None)))
    told = [float(number) for number in re.findall(r"(?:base|arm|against) ([\d.]+)", head)]
    assert told == pytest.approx([*base, *arm], rel=1e-3)
    assert figures.to_dict()["comparison"]["unfair"].lower() == head.lower()


def test_networks_of_different_size_are_not_fair_either() -> None:
    e = load_experiment("chapter4", ["one_layer.hidden=44"])
    numbers = {name: {"effective_gain.base": 1.0, "effective_gain.arm": 2.0} for name in LEARNERS}
    assert "the networks differ in size" in unfair(e, numbers)
    assert unfair(e, {"two_layer": numbers["two_layer"]}) == unfair(e, {}) == ""  # nobody to compare with


@compiled_only
def test_figures_meets_at_least_eleven_intervals(figures: Result) -> None:
    rows = figures.to_dict()["comparison"]["figure_ranges"]
    assert len(rows) == 12 and sum(row["inside"] for row in rows) >= 11


@compiled_only
@each_variant
def test_tables_show_pd_at_both_gains_shares_and_intervals(variant: str) -> None:
    e = load_experiment("chapter4", ["time.duration=1.5"], variant)
    text = comparison.render(run_experiment(e, "chapter4"))
    assert max(map(len, text.splitlines())) <= 100
    for words in ("pd\neffective", "= gain", "+ learning", "intervals of the figures met", "4.4 bottom  arm error e2"):
        assert all(part in text for part in words.split("\n")), words
    assert text.startswith("Not a fair") == (variant == "figures")

"""What a user reads for settings that cannot be: one plain line with the key, sizes and numbers within bounds."""

from __future__ import annotations

from pathlib import Path

import msgspec
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mmnn_pin.cli import main
from mmnn_pin.errors import InputError
from mmnn_pin.lab.experiments.config import load_experiment
from mmnn_pin.settings import LARGEST
from mmnn_pin.settings.arguments import wrong_type

CIRCLE = "base={type='circle',radius=1.0,speed=1.0}"
BAD = {
    "nominal.masses=[0.7, 0.8]": "nominal.masses: error: [0.7, 0.8] is a list: give a number or a table",
    "nominal.masses='x'": "nominal.masses: error: 'x' is a text: give a number or a table",
    "nominal.masses={root='x'}": "nominal.masses.root: error: 'x' is a text: give a number",
    "nominal.masses={root=nan}": "nominal.masses: error: {'root': nan}: use finite factors > 0",
    "nominal.masses={}": "nominal.masses: error: {}: use finite factors > 0",
    "nominal.friction=3": "nominal.friction: error: 3 is a whole number: give true or false",
    "two_layer.F=[1.0]": "two_layer.F: error: [1.0] has one entry: give 2",
    "kalman=3": "kalman: error: 3 is a whole number: give a table",
    "kalman.features.hidden=1000000": "kalman.features.hidden: error: 1000000: memory and time grow with it",
    "kalman.bilinear.hidden=2001": "kalman.bilinear.hidden: error: 2001: memory and time grow with it: use",
    "kalman.residual.largest=2001": "kalman.residual.largest: error: 2001",
    "kalman.regressor.prior=1e300": "kalman.regressor.prior: error: 1e+300: use a number up to 1e+12",
    "kalman.regressor.noise=nan": "kalman.regressor.noise: error: nan is negative or not finite",
    "concurrent.entries=5001": "concurrent.entries: error: 5001: memory and time grow with it: use at most 5000",
    "one_layer.hidden=10001": "one_layer.hidden: error: 10001: memory and time grow with it: use at most 10000",
    "two_layer.hidden=10001": "two_layer.hidden: error: 10001: memory and time grow with it",
    "held_out.mine=3": "held_out.mine: error: 3 is a whole number: give a table",
    f"held_out.mine={{duration=inf, {CIRCLE}}}": "held_out.mine.duration: error: inf s: use a finite number",
    f"held_out.mine={{duration=-1, {CIRCLE}}}": "held_out.mine.duration: error: -1.0 s",
    "cases.mine={}": "cases.mine: error: the key 'title' is missing",
    "cases.mine=3": "cases.mine: error: 3 is a whole number: give a table",
    "cases.mine={title='x', set=3}": "cases.mine.set: error: 3 is a whole number: give a table",
    "cases.mine={title='x', experiment='eigth'}": "cases.mine.experiment: error: unknown experiment 'eigth'",
    "laws.x=3": "laws.x: error: 3 is a whole number: give a table",
}


@pytest.mark.parametrize("text", BAD)
def test_a_bad_setting_is_told_with_its_key(text: str) -> None:
    with pytest.raises(InputError) as caught:
        load_experiment("eight", [text])
    assert "eight.toml" not in str(caught.value) or "experiment" in text  # the file does not say it
    assert BAD[text] in str(caught.value)
    assert "`" not in str(caught.value) and "\n" not in str(caught.value)


def test_a_run_that_is_over_before_its_errors_count_is_no_verdict(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["run", "faults", "--case", "none", "--set", "time.duration=0.5"]) == 2
    assert "cases.none: tolerance.settle: error: 1 s: errors count from then on" in capsys.readouterr().err


def test_the_command_line_says_it_in_one_line(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["run", "track", "--set", "nominal.masses=[1]"]) == 2
    err = capsys.readouterr().err
    assert err.endswith("nominal.masses: error: [1] is a list: give a number or a table\n") and err.count("\n") == 1


def test_all_bundled_sizes_are_within_their_bounds() -> None:
    for name in ("eight", "chapter4", "chapter5", "track"):
        assert load_experiment(
            name, ["kalman.features.hidden=2000", "concurrent.entries=5000", "two_layer.hidden=10000"]
        )
    assert load_experiment("eight", [f"kalman.features.prior={LARGEST!r}"]).kalman.features.prior == LARGEST


KINDS = {int: "a whole number", float: "a number", str: "a text", bool: "true or false", list: "a list"}
VALUES = {
    int: st.integers(-9, 9),
    float: st.floats(0.1, 0.9),
    str: st.text("ab", min_size=1),
    list: st.lists(st.none()),
}


@given(st.sampled_from([int, float, str, bool, list]), st.one_of(st.booleans(), *VALUES.values()))
def test_every_message_of_a_conversion_is_put_in_plain_words(kind: type, value: object) -> None:
    try:
        msgspec.convert(value, kind)
    except msgspec.ValidationError as error:
        what, fix = wrong_type(error, value)
        assert fix == f"give {KINDS[kind]}" and what.endswith(f" is {KINDS[type(value)]}")


def test_messages_of_another_kind_stay_as_they_are() -> None:
    assert wrong_type("something else - at `$.x`") == ("something else", "")
    assert wrong_type("Expected `int | null`, got `str`") == ("this is a text", "give a whole number")


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("sensor.nois=1", "--set sensor.nois: error: unknown key 'nois': did you mean 'noise'?"),
        ("nois=1", "--set nois: error: unknown key 'nois'"),
        ("sensor.foo.bar=1", "--set sensor.foo.bar: error: unknown key 'foo'"),
        ("sensor={noise=1, foo=2}", "--set sensor.foo: error: unknown key 'foo'"),
        ("sensor.noise='a'", "--set sensor.noise: error: 'a' is a text: give a number"),
    ],
)
def test_an_error_of_an_override_says_that_it_came_from_there(text: str, told: str, tmp_path: Path) -> None:
    """And one that stands in a file names that, whatever else is set."""
    with pytest.raises(InputError) as caught:
        load_experiment("track", ["time.duration=1", text])
    assert str(caught.value).startswith(told)
    file = tmp_path / "mine.toml"
    file.write_text('experiment = "track"\n[sensor]\nnois = 1\n')
    with pytest.raises(InputError, match=r"mine\.toml:3:sensor: error: unknown key 'nois'"):
        load_experiment(file, ["time.duration=1", "actuator.lag=0.01"])

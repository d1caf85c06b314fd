"""`mmnn check`: its JSON, its table, its exit codes, the progress bar only on a terminal."""

from __future__ import annotations

import json
import sys
from pathlib import Path

import pytest

from mmnn_pin.cli import main
from mmnn_pin.model.checks import properties
from mmnn_pin.signals import Array


def run(capsys: pytest.CaptureFixture[str], *arguments: str) -> tuple[int, str, str]:
    code = main(["check", *arguments])
    return code, *capsys.readouterr()


def test_json_is_as_agreed(capsys):
    code, out, err = run(capsys, "platform_arm", "--samples", "4", "--seed", "7", "--json")
    found = json.loads(out)
    assert (code, err) == (0, "")
    assert (found["samples"], found["seed"]) == (4, 7)
    assert all(
        isinstance(p["worst"], float) and isinstance(p["tolerance"], float) and p["pass"] is True
        for p in found["properties"].values()
    )
    assert {
        "coriolis_linear",
        "skew_symmetry",
        "skew_symmetry_blocks",
        "skew_symmetry_cross",
        "skew_symmetry_base",
    } <= set(found["properties"])
    assert 0 < found["bounds"]["M_min"] < found["bounds"]["M_max"] and found["bounds"]["C_b"] > 0
    assert "uniform" in found["bounds"]["sampling"]
    tested = found["nonholonomic"]
    assert (tested["distribution"], tested["closure"]) == (2, 3) and tested["verdict"].startswith("nonholonomic")
    assert (tested["with_wheel_angles"]["closure"], tested["with_wheel_angles"]["coordinates"]) == (4, 5)


def test_a_fixed_arm(capsys):
    code, out, _ = run(capsys, "two_axis_arm", "--samples", "2", "--json")
    tested = json.loads(out)["nonholonomic"]
    assert code == 0 and (tested["distribution"], tested["closure"]) == (0, 0) and "fixed" in tested["verdict"]


def test_swapped_limits_of_a_locked_joint_are_no_internal_error(tmp_path, capsys):
    text = (Path(__file__).parents[2] / "urdf/platform_arm.urdf").read_text(encoding="utf-8")
    start = text.index('<joint name="arm_2_joint"')
    swapped = text[start:].replace('lower="-3.14159" upper="3.14159"', 'lower="1.0" upper="-1.0"', 1)
    (tmp_path / "swapped.urdf").write_text(text[:start] + swapped, encoding="utf-8")
    assert main(["check", str(tmp_path / "swapped.urdf"), "--lock", "arm_2_joint", "--samples", "20"]) == 0
    assert "internal error" not in capsys.readouterr().err


def test_table_says_seed_and_verdict(capsys):
    code, out, err = run(capsys, "platform_arm", "--samples", "3", "--seed", "11")
    assert (code, err) == (0, "")
    assert "3 random states, seed 11" in out and "all properties hold" in out and "nonholonomic" in out
    assert "rank 2 -> 3 -> 4 of 5" in out


def test_same_seed_same_numbers(capsys):
    first, second, other = (run(capsys, "platform_arm", "--samples", "3", "--seed", s, "--json")[1] for s in "112")
    assert first == second != other


def test_a_broken_property_exits_with_1(capsys, monkeypatch):
    class Broken(properties.FullTerms):
        def coriolis(self, q: Array, v: Array) -> Array:
            return 0 * super().coriolis(q, v)

    monkeypatch.setattr(properties, "FullTerms", Broken)
    code, out, _ = run(capsys, "platform_arm", "--samples", "2", "--json")
    assert code == 1 and json.loads(out)["properties"]["skew_symmetry"]["pass"] is False
    code, out, _ = run(capsys, "platform_arm", "--samples", "2")
    assert code == 1 and "FAIL" in out and "FAILED: skew_symmetry" in out


@pytest.mark.parametrize(
    "arguments", [("no_such_robot",), ("platform_arm", "--samples", "0"), ("platform_arm", "--seed", "-1")]
)
def test_bad_input_exits_with_2(capsys, arguments):
    code, out, err = run(capsys, *arguments)
    assert code == 2 and out == "" and err.count("\n") == 1


def test_progress_only_on_a_terminal(capsys, monkeypatch):
    monkeypatch.setattr(sys.stderr, "isatty", lambda: True, raising=False)
    code, out, err = run(capsys, "platform_arm", "--samples", "2", "--json")
    assert code == 0 and json.loads(out) and "checking" in err

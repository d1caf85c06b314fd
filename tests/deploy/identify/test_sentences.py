"""What identification says in counts, ranges and "none", held against the data that it was said of."""

from __future__ import annotations

import re
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from mmnn_pin import load
from mmnn_pin.deploy.identify.identification import beyond_limits
from mmnn_pin.deploy.identify.log import Log
from mmnn_pin.deploy.identify.quality import despiked, numbers_only
from mmnn_pin.lab.show.identified import CHECKED, check_text, excitation_text, headline, joints_table

ROBOT = load("platform_arm")
SHARE = st.floats(1e-4, 3.0)
NAME = "arm_1_joint"


def said(pattern: str, text: str) -> tuple[str, ...]:
    """The parts of a sentence."""
    found = re.search(pattern, " ".join(text.split()))
    assert found, f"{pattern!r} is not in {text!r}"
    return found.groups()


def log_of(effort: np.ndarray, position: np.ndarray | None = None) -> Log:
    """A log of one joint at 100 Hz."""
    return Log(
        "random.csv", 0.01 * np.arange(len(effort)), {} if position is None else {NAME: position}, effort={NAME: effort}
    )


@given(st.lists(st.tuples(st.booleans(), SHARE, SHARE), min_size=1, max_size=6), SHARE, SHARE, SHARE, SHARE)
def test_the_headline_counts_the_efforts_that_are_identified_and_orders_the_errors(
    joints: list[tuple[bool, float, float]], ours: float, plain: float, urdf: float, friction: float
) -> None:
    report = {
        "robot": "drawn", "joints": {f"j{i}": {"identified": known} for i, (known, *_) in enumerate(joints)},
        "held_out": ours, "urdf_held_out": urdf, "friction_held_out": friction, "without_toml_held_out": plain,
        "least_squares_held_out": ours, "plausible": True, "better": max(ours, plain) < min(urdf, friction),
    }  # fmt: skip
    count, of, error, word, before, alone = said(
        r"(\d+) of (\d+) efforts identified; held-out error (\S+) %, (.*better than.*) the URDF \((\S+) %\) and "
        r"friction alone \((\S+) %\)",
        headline(report),
    )
    assert (int(count), int(of)) == (sum(known for known, *_ in joints), len(joints))
    told = [float(number) for number in (error, before, alone)]
    assert told == pytest.approx([100 * ours, 100 * urdf, 100 * friction], rel=0.006)
    written = [float(number) for number in re.findall(r"hold of it (\S+) %", word)]
    assert written == pytest.approx([100 * plain] * len(written), rel=0.006)
    assert ("NOT" not in word) == (max(ours, plain) < min(urdf, friction))
    if "NOT" in word and not written:  # then the numbers beside it say why
        assert ours >= min(urdf, friction)


@given(st.lists(st.tuples(st.booleans(), SHARE, SHARE, SHARE, SHARE, SHARE), min_size=1, max_size=5))
def test_the_best_error_of_a_joint_is_the_smallest_that_is_shown(joints: list[tuple[Any, ...]]) -> None:
    keys = ("held_out", "without_toml_held_out", "least_squares_held_out", "friction_held_out", "urdf_held_out")
    table = joints_table(
        {"joints": {f"j{i}": {"identified": known} | dict(zip(keys, errors, strict=True))
                    for i, (known, *errors) in enumerate(joints)}, "cutoff": 5.0}
        | dict.fromkeys(keys, 0.5)
    )  # fmt: skip
    for row in table.rows[:-1]:
        shown = [(float(cell.text.split()[0]), cell.kind) for cell in row.cells[1:] if cell.text != "-"]
        marked = [value for value, kind in shown if kind == "best"]
        assert marked and max(marked) == min(value for value, _ in shown)


GRADE = st.sampled_from(("refused", "warned", "mended"))


@given(st.lists(GRADE, max_size=2 * CHECKED))
def test_the_doctor_counts_what_it_found(grades: list[str]) -> None:
    blank = {"why": "", "changes": "", "fix": ""}
    findings = [{"grade": grade, "what": f"finding {i}"} | blank for i, grade in enumerate(sorted(grades))]
    text = check_text({"robot": "drawn", "findings": findings, "logs": []})
    refused, head = grades.count("refused"), text.splitlines()[0]
    if refused:
        assert said(r"(\d+) of (\d+) findings?", head) == (str(refused), str(len(grades)))
    else:
        assert "nothing contradicts the physics" in head and ("finding" in head) == bool(grades)
        assert not grades or said(r"(\d+) finding", head) == (str(len(grades)),)
    shown = len(re.findall(r"finding \d+", text))
    more = re.findall(r"and (\d+) more", text)
    assert shown + sum(map(int, more)) == len(grades) and bool(more) == (len(grades) > shown)
    assert not re.search(r"\b1 findings", text)


@given(
    st.lists(st.tuples(SHARE, SHARE), min_size=1, max_size=14),
    st.lists(st.tuples(st.floats(-5, 0), st.floats(0, 5)), min_size=2, max_size=2) | st.just([]),
    st.none() | st.floats(0.05, 3.0),
)
def test_a_motion_found_says_how_many_parameters_it_predicts_and_where_it_drives(
    parameters: list[tuple[float, float]], floor: list[tuple[float, float]], nearest: float | None
) -> None:
    base = [{"combination": f"p{i}", "sd": sd, "size": size} for i, (sd, size) in enumerate(parameters)]
    base.sort(key=lambda one: one["size"] / one["sd"])
    found = {"robot": "drawn", "duration": 20.0, "condition": 12.0, "base_parameters": base, "floor": floor}
    text = " ".join(excitation_text(found | {"nearest_obstacle": nearest}).split())
    total, well = said(r"of (\d+) base parameters (\d+) are predicted within 10 %", text)
    assert (int(total), int(well)) == (len(base), sum(100 * sd / size < 10 for sd, size in parameters))
    for axis, (low, high) in zip("xy", floor, strict=False):
        first, last = said(rf"{axis} from (\S+) to (\S+) m", text)
        assert (float(first), float(last)) == pytest.approx((low, high), abs=0.0051)
    assert ("drives within" in text) == bool(floor) and ("no nearer than" in text) == (nearest is not None)


@given(arrays(float, st.integers(20, 60), elements=st.floats(-300, 300)), st.floats(5.0, 200.0))
@settings(deadline=None)
def test_efforts_beyond_their_motor_are_counted(efforts: np.ndarray, limit: float) -> None:
    robot: Any = SimpleNamespace(actuator_names=(NAME,), effort_limits=np.array([limit]))
    told = list(beyond_limits([log_of(efforts)], robot, ()))
    sizes = np.abs(efforts)
    if not told:
        assert not (sizes > 1.01 * limit).any()  # a little above is rounding
        return
    count, of, most = said(r"limit of \S+ in (\d+) of (\d+) samples, at most (\S+):", told[0])
    assert (sizes > 1.01 * limit).sum() <= int(count) <= (sizes > limit).sum() and int(of) == len(efforts)
    assert float(most) == pytest.approx(sizes.max(), rel=1e-3)


@given(st.integers(30, 120), st.data())
@settings(deadline=None)
def test_values_that_are_no_numbers_are_counted_and_their_rows_go(rows: int, data: st.DataObject) -> None:
    place = st.integers(0, rows - 1)
    holes = data.draw(st.lists(place, max_size=3, unique=True))
    values = np.sin(0.1 * np.arange(rows))
    values[holes] = np.nan
    made = numbers_only(log_of(np.cos(0.1 * np.arange(rows)), values), ROBOT)
    told = [finding.what for finding in made.findings]
    assert bool(told) == bool(holes)
    if holes:
        assert said(r"has (\d+) values?", told[0]) == (str(len(holes)),)
        if NAME in made.position:
            assert len(made.time) == rows - len(holes)


@given(st.lists(st.integers(1, 18), min_size=0, max_size=4, unique=True), st.floats(3.0, 50.0))
@settings(deadline=None)
def test_spikes_are_counted_where_they_are(places: list[int], size: float) -> None:
    time = np.arange(2000)
    calm = np.sin(0.01 * time) + 1e-4 * np.random.default_rng(0).standard_normal(2000)
    values = calm.copy()
    values[[100 * place for place in places]] += size
    made = despiked(log_of(values), ROBOT)
    told = [note for note in made.notes if "spike" in note]
    assert bool(told) == bool(places)
    if places:
        count, first = said(r"(\d+) spikes? replaced, the first at t = (\S+) s", told[0])
        assert int(count) == len(places) and float(first) == pytest.approx(0.01 * 100 * min(places))
        assert np.abs(made.effort[NAME] - calm).max() < 0.1

"""What a recording says of itself in Python: errors, a table for pandas, a file."""

from __future__ import annotations

from html import escape

import builders
import numpy as np
import pytest

from mmnn_pin import Recording, load
from mmnn_pin.errors import RecordingError
from mmnn_pin.recording.tracking import Errors


@pytest.fixture(scope="module")
def run():
    return builders.recording(rows=50, period=0.1, noise=0.3, seed=2, signals=None)


def test_errors_are_those_of_the_signals(run):
    kept = run.time >= 1.0
    found = run.errors(1.0)
    for i, name in enumerate(run.labels("pose_error")):
        values = run["true_pose_error" if "true_pose_error" in run else "pose_error"][kept, i]
        np.testing.assert_allclose(found[name].rms, np.linalg.norm(values) / np.sqrt(kept.sum()))
        assert found[name].peak == max(abs(values)) and found[name].last == abs(values[-1])
    assert [found[name].unit for name in ("x", "y", "phi")] == ["m", "m", "rad"]
    assert set(found) == {*run.labels("pose_error"), *run.labels("e")}
    np.testing.assert_allclose(run.errors(0.0, 2.0)["x"].peak, abs(run["true_pose_error"][run.time < 2.0, 0]).max())


def test_a_sliding_joint_has_metres():
    from mmnn_pin import PD, Loop, Timing, Trajectory

    robot = load("tiago")
    errors = Loop(robot, Trajectory.of(robot), PD(), timing=Timing(duration=0.01)).run().errors()
    assert errors["torso_lift_joint"].unit == "m" and errors["arm_1_joint"].unit == "rad"


def test_errors_of_no_time_are_refused(run):
    with pytest.raises(RecordingError, match="no samples from 99 s on"):
        run.errors(99.0)
    with pytest.raises(RecordingError, match=r"no samples from 1 s to 0\.5 s"):
        run.errors(1.0, 0.5)


def test_errors_print_as_a_table_and_escape_names(run):
    lines = repr(run.errors()).splitlines()
    assert lines[0].startswith("from 0 s to") and lines[1].split() == ["error", "RMS", "peak", "last"]
    assert len(lines) == 2 + len(run.errors())
    hostile = Errors.of(np.arange(3.0), {"<script>": (np.ones(3), "m")})
    assert "<script>" not in hostile._repr_html_() and escape("<script>") in hostile._repr_html_()
    assert hostile.to_dict() == {"<script>": {"rms": 1.0, "peak": 1.0, "last": 1.0, "unit": "m"}}


def test_a_saved_recording_is_the_same(run, tmp_path):
    file = run.save(tmp_path / "deep" / "run.h5")
    again = Recording.open(file)
    assert again.complete and again.outcome == run.outcome and again.meta.keys() == run.meta.keys()
    for name in run:
        np.testing.assert_array_equal(again[name], run[name])
        assert again.labels(name) == run.labels(name) and again.unit(name) == run.unit(name)
    for group in ("weights", "final"):
        for name, array in getattr(run, group).items():
            np.testing.assert_array_equal(getattr(again, group)[name], array)
    with pytest.raises(RecordingError, match="the file exists"):
        run.save(file)
    assert again.save(tmp_path / "copy.h5").exists() and run.save(file, force=True) == file


def test_a_table_for_pandas_has_the_columns_of_an_export(run):
    pandas = pytest.importorskip("pandas", reason="pip install pandas: it is what to_dataframe gives")
    frame = run.to_dataframe()
    assert frame.index.name == "time" and len(frame) == len(run) and isinstance(frame, pandas.DataFrame)
    np.testing.assert_array_equal(frame["z.v"], run["z"][:, 0])
    assert list(frame.columns) == [name for name in run.columns() if name != "time"]


def test_without_pandas_there_is_one_line(run, monkeypatch):
    import sys

    monkeypatch.setitem(sys.modules, "pandas", None)
    with pytest.raises(RecordingError, match=r"pandas is not installed.*pip install pandas"):
        run.to_dataframe()

"""A run comes back as it was written, whatever ended it."""

import errno
import itertools
import os
import subprocess
import sys
import time
from pathlib import Path

import h5py
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mmnn_pin.errors import RecordingError, UnknownName
from mmnn_pin.recording import run_file
from mmnn_pin.recording.recorder import Recorder, buffer_rows
from mmnn_pin.recording.recording import Outcome, Recording
from mmnn_pin.signals import SIGNALS, Layout

LAYOUT = Layout(base=2, arm=2, full=7, motors=4)
META = {
    "robot": "platform_arm",
    "controller": "two_layer",
    "seed": 7,
    "velocity_names": ("v", "w", "joint1", "joint2"),
    "actuator_names": ("wheel_left", "wheel_right", "joint1", "joint2"),
    "position_names": ("x", "y", "phi", "wheel_left", "wheel_right", "joint1", "joint2"),
    "config": "seed = 7  # µ",
    "urdf": "<robot name='päd'/>",
    "gains": {"k1": 500.0, "note": None},
    "text": "json: not really",
    "step": np.float64(1e-3),
}
BUFFER_ROWS = buffer_rows(LAYOUT)
DONE = Outcome("completed", 5.0, "", "all well")


def rows_of(count: int, layout: Layout = LAYOUT, seed: int = 0) -> np.ndarray:
    rows = np.random.default_rng(seed).normal(size=(count, layout.width))
    rows[:, 0] = 1e-3 * np.arange(count)
    return rows


def record(rows: np.ndarray, path: Path | None = None, layout: Layout = LAYOUT, meta: dict = META) -> Recording:
    with Recorder(layout, meta, path) as recorder:
        for row in rows:
            recorder.append(row, step_time=2e-6)
        return recorder.finish(DONE)


@pytest.mark.parametrize("where", ["memory", "file"])
def test_what_goes_in_comes_out(where, tmp_path):
    rows = rows_of(BUFFER_ROWS + 300)
    rows[-1, 5] = np.nan
    weights = [np.random.default_rng(k).normal(size=(22, 3)) for k in range(3)]
    recorder = Recorder(LAYOUT, META, tmp_path / "new" / "run.h5" if where == "file" else None)
    recorder.append_block(rows[:1000], step_times=np.arange(1000.0))
    for k, array in enumerate(weights):
        recorder.weights(0.1 * k, {"W1": array, "b": np.arange(2)})
    for row in rows[1000:]:
        recorder.append(row)
    outcome = Outcome("diverged", 1.3, "nu[1]", "nu[1] is not finite")
    rec = recorder.finish(outcome, {"nu": np.arange(4.0), "level": 3.0})

    # Of the contact plant, of a rig, of a torque that leads, of touch, of paths, of bases that steer.
    others = ("wheel", "floor", "rig", "lead", "touch", "scene", "task", "hand", "shape")
    names = tuple(name for name, kind, *_ in SIGNALS if kind.split()[0] not in others)
    for name in names:
        expected = rows[:, LAYOUT.where(name)]
        np.testing.assert_array_equal(rec[name], expected[:, 0] if expected.shape[1] == 1 else expected)
    assert rec.names == names == tuple(rec)
    assert len(rec) == len(rec.time) == len(rows)
    assert "z" in rec and "nonsense" not in rec
    assert rec.outcome == outcome and rec.complete
    np.testing.assert_array_equal(rec.weights["W1"], weights)
    np.testing.assert_allclose(rec.weights["time"], [0.0, 0.1, 0.2])
    np.testing.assert_array_equal(rec.final["nu"], np.arange(4.0))
    assert rec.final["level"] == 3.0
    np.testing.assert_array_equal(rec.step_times, np.r_[np.arange(1000.0), np.zeros(len(rows) - 1000)])
    assert (rec.config_text, rec.urdf) == (META["config"], META["urdf"])
    assert {key: rec.meta[key] for key in META.keys() - {"config", "urdf"}} == {
        key: value for key, value in META.items() if key not in ("config", "urdf")
    }
    assert rec.meta["versions"].keys() - {"commit"} == {"python", "mmnn_pin", "pin", "numpy", "numba", "h5py"}
    assert len(rec.meta["urdf_sha256"]) == 64
    assert f"two_layer on platform_arm: diverged at t = 1.3 s, {len(rows):,} rows" in rec.summary()
    assert rec.path == (tmp_path / "new" / "run.h5" if where == "file" else None)
    if rec.path is not None:  # a recorder tells of its file what it wrote; another process reads it
        read = Recording.open(rec.path)
        assert (read.meta, read.outcome, read.names) == (rec.meta, rec.outcome, rec.names)
        assert (read.config_text, read.urdf, len(read)) == (rec.config_text, rec.urdf, len(rec))
        assert all(read[name].tobytes() == rec[name].tobytes() for name in rec)
        assert all((read.unit(name), read.labels(name)) == (rec.unit(name), rec.labels(name)) for name in rec)


@given(pieces=st.lists(st.integers(0, 2500), max_size=4))
@settings(max_examples=15, deadline=None)
def test_blocks_and_single_rows_record_the_same(pieces):
    rows = rows_of(sum(pieces), Layout(0, 1, 1, 1))
    blocks = Recorder(Layout(0, 1, 1, 1), {})
    start = 0
    for count in pieces:
        blocks.append_block(rows[start : start + count])
        start += count
    rec, single = blocks.finish(DONE), record(rows, None, Layout(0, 1, 1, 1), {})
    np.testing.assert_array_equal(rec["q"], rows[:, Layout(0, 1, 1, 1).where("q")][:, 0])
    np.testing.assert_array_equal(rec["q"], single["q"])


@pytest.mark.parametrize("where", ["memory", "file"])
@pytest.mark.parametrize("count", [7, 9000])  # a small part of a block in memory, and more than one
def test_chosen_signals_are_recorded_and_no_others(where, count, tmp_path):
    rows = rows_of(count)
    recorder = Recorder(LAYOUT, META, tmp_path / "run.h5" if where == "file" else None, signals=("z", "q", "energy"))
    recorder.append_block(rows)
    rec = recorder.finish(DONE)
    assert rec.names == ("time", "q", "z", "energy") and len(rec) == count
    for name in rec:
        np.testing.assert_array_equal(rec[name].reshape(count, -1), rows[:, LAYOUT.where(name)])
    with pytest.raises(UnknownName, match="'nu'"):
        rec["nu"]


def test_a_signal_to_record_must_exist():
    with pytest.raises(UnknownName, match=r"signals: .*'zz'.*did you mean 'z'"):
        Recorder(LAYOUT, META, signals=("zz",))


def test_rows_are_copied():
    recorder, row = Recorder(LAYOUT, META), LAYOUT.new_row()
    weights = np.zeros(3)
    recorder.append(row)
    recorder.weights(0.0, {"W": weights})
    row[:], weights[:] = 9.0, 9.0
    rec = recorder.finish(DONE)
    assert rec.time[0] == 0.0 and not rec.weights["W"].any()


@pytest.mark.parametrize("where", ["memory", "file"])
def test_columns_have_units_and_labels(where, tmp_path):
    rec = record(rows_of(3), tmp_path / "run.h5" if where == "file" else None)
    assert rec.labels("pose_error") == ("x", "y", "phi")
    assert rec.labels("z") == ("v", "w") and rec.unit("z") == "m/s, rad/s"
    assert rec.labels("e") == ("joint1", "joint2")
    assert rec.labels("psi") == META["velocity_names"] and rec.unit("psi") == "N, N m; N m or N"
    assert rec.labels("position") == META["position_names"]
    assert rec.labels("motor_torque") == META["actuator_names"] and rec.unit("motor_torque")
    assert rec.labels("energy") == ("energy",) and rec.unit("energy") == "J"
    for name in rec:
        assert len(rec.labels(name)) == (1 if rec[name].ndim == 1 else rec[name].shape[1]), name


def test_any_hdf5_reader_finds_signals_and_units(tmp_path):
    record(rows_of(3), tmp_path / "run.h5")
    with h5py.File(tmp_path / "run.h5") as file:
        assert file["signals/z"].shape == (3, 2) and file["signals/time"].shape == (3,)
        assert list(file["signals/z"].attrs["labels"]) == ["v", "w"] and file["signals/z"].attrs["unit"]
        assert file.attrs["complete"] and file.attrs["outcome"] == "completed" and file.attrs["seed"] == 7
        assert file["urdf"].asstr()[()] == META["urdf"]


def test_a_fixed_arm_has_no_base_signals(tmp_path):
    layout = Layout(base=0, arm=2, full=2, motors=2)
    rec = record(rows_of(4, layout), tmp_path / "arm.h5", layout, {})
    assert not {"pose", "z", "alpha"} & set(rec.names)
    assert rec["e"].shape == (4, 2) and rec.labels("e") == ("velocity[0]", "velocity[1]")


def test_equal_rows_make_equal_datasets(tmp_path):
    rows = rows_of(3000)
    record(rows, tmp_path / "a.h5")
    with Recorder(LAYOUT, META, tmp_path / "b.h5") as recorder:
        for block in np.array_split(rows, 7):  # written in other portions
            recorder.append_block(block)
        recorder.finish(DONE)
    with h5py.File(tmp_path / "a.h5") as a, h5py.File(tmp_path / "b.h5") as b:
        assert list(a["signals"]) == list(b["signals"])
        for name in a["signals"]:
            assert a["signals"][name][()].tobytes() == b["signals"][name][()].tobytes(), name


KILLED = """
import sys, time
import numpy as np
from mmnn_pin.recording.recorder import Recorder
from mmnn_pin.signals import Layout
layout = Layout(2, 2, 7, 4)
recorder, row, k = Recorder(layout, {}, sys.argv[1]), layout.new_row(), 0
while True:
    row[:] = time.time()
    row[1] = k
    recorder.append(row)
    if k % 100 == 0:
        recorder.weights(k, {"W": np.full((5, 3), k)})
    k += 1
    time.sleep(1e-4)
"""


def test_a_killed_run_is_readable_up_to_half_a_second_before(tmp_path):
    path = tmp_path / "run.h5"
    writer = subprocess.Popen([sys.executable, "-c", KILLED, str(path)])
    while not path.exists():
        assert writer.poll() is None
        time.sleep(0.01)
    time.sleep(1.0)
    writer.kill()
    killed = time.time()
    writer.wait()
    rec = Recording.open(path)
    assert not rec.complete and rec.outcome.status == "interrupted"
    assert rec.outcome.message == f"run incomplete: {len(rec):,} rows, ends at t = {rec.time[-1]:g} s"
    assert 0.0 < killed - rec.time[-1] < 0.5 and len(rec) > 100
    np.testing.assert_array_equal(rec["position"][:, 0], np.arange(len(rec)))
    assert all(len(rec[name]) == len(rec) for name in rec)
    np.testing.assert_array_equal(rec.weights["W"][:, 4, 2], rec.weights["time"])


def test_a_kill_between_two_datasets_cuts_to_the_shortest(tmp_path):
    with pytest.raises(ZeroDivisionError), Recorder(LAYOUT, META, tmp_path / "run.h5") as recorder:
        recorder.append_block(rows_of(50))
        recorder.weights(0.0, {"W": np.zeros(2)})
        raise ZeroDivisionError
    with h5py.File(tmp_path / "run.h5", "r+") as file:
        file["signals/psi"].resize(30, axis=0)
        file["weights/W"].resize(0, axis=0)
    rec = Recording.open(tmp_path / "run.h5")
    assert len(rec) == 30 and all(len(rec[name]) == 30 for name in rec) and len(rec.step_times) == 30
    assert len(rec.weights["time"]) == len(rec.weights["W"]) == 0


def test_an_exception_leaves_an_incomplete_recording_with_all_rows(tmp_path):
    with pytest.raises(ZeroDivisionError), Recorder(LAYOUT, META, tmp_path / "run.h5") as recorder:
        recorder.append_block(rows_of(50))
        raise ZeroDivisionError
    rec = Recording.open(tmp_path / "run.h5")
    assert len(rec) == 50 and not rec.complete and rec.outcome.time == pytest.approx(0.049)
    assert list(tmp_path.iterdir()) == [tmp_path / "run.h5"]


@pytest.mark.parametrize("count", [0, 1, 700, 1024, 9000])  # the last is more than a chunk, and than a buffer
@pytest.mark.parametrize("expected", [0, 1, 700, 8192, 20_000])
def test_runs_of_any_length_come_back_whatever_was_expected(count, expected, tmp_path):
    rows = rows_of(count)
    with Recorder(LAYOUT, META, tmp_path / "run.h5", expected=expected) as recorder:
        recorder.append_block(rows)
        recorder.finish(DONE)
    rec = Recording.open(tmp_path / "run.h5")
    assert rec.complete and len(rec) == count
    assert all(rec[name].tobytes() == np.ascontiguousarray(rows[:, LAYOUT.where(name)]).tobytes() for name in rec)


def test_a_short_run_is_written_at_once(tmp_path, monkeypatch):
    opened = []
    monkeypatch.setattr(
        h5py, "File", lambda *given, _file=h5py.File, **named: opened.append(given) or _file(*given, **named)
    )
    with Recorder(LAYOUT, META, tmp_path / "run.h5", expected=5000) as recorder:
        before = len(opened)
        recorder.append_block(rows_of(2500))
        recorder.append_block(rows_of(2400))
        assert len(opened) == before
        assert len(Recording.open(tmp_path / "run.h5")) == 0  # there, and readable
        opened.clear()
        recorder.finish(DONE)
        assert len(opened) == 1
    assert len(Recording.open(tmp_path / "run.h5")) == 4900 and len(list(tmp_path.iterdir())) == 1


def test_a_short_run_that_does_not_fit_on_the_disk_is_told(tmp_path, monkeypatch):
    record(rows_of(5), tmp_path / "run.h5")

    def full(*_: object) -> int:
        raise OSError(errno.ENOSPC, "no room")

    with Recorder(LAYOUT, META, tmp_path / "run.h5", force=True) as recorder:
        recorder.append_block(rows_of(50))
        monkeypatch.setattr("os.posix_fallocate", full)
        with pytest.raises(RecordingError, match=r"No space left.*the recording that was to be replaced is back"):
            recorder.finish(DONE)
    assert len(Recording.open(tmp_path / "run.h5")) == 5 and len(list(tmp_path.iterdir())) == 1


def test_a_run_killed_before_its_first_row_is_readable(tmp_path):
    Recorder(LAYOUT, META, tmp_path / "run.h5").__exit__(None, None, None)
    rec = Recording.open(tmp_path / "run.h5")
    assert len(rec) == 0 and rec and rec.outcome.message == "run incomplete: no rows"


FULL = """
import resource, sys
import numpy as np
from mmnn_pin.errors import RecordingError
from mmnn_pin.recording.recorder import Recorder
from mmnn_pin.signals import Layout
layout = Layout(2, 2, 7, 4)
resource.setrlimit(resource.RLIMIT_FSIZE, (6_000_000, 6_000_000))
try:
    with Recorder(layout, {}, sys.argv[1]) as recorder:
        for k in range(0, 100_000, 100):
            recorder.append_block(np.repeat(np.arange(k, k + 100.0)[:, None], layout.width, axis=1))
except RecordingError as error:
    sys.exit(str(error))
"""


@pytest.mark.skipif(sys.platform != "linux", reason="space is reserved on Linux only")
def test_a_full_disk_is_told_and_leaves_what_was_written(tmp_path):
    path = tmp_path / "run.h5"
    run = subprocess.run([sys.executable, "-c", FULL, str(path)], capture_output=True, text=True)
    rec = Recording.open(path)
    assert run.returncode == 1 and run.stderr.startswith(f"{path}: error: cannot write the recording: File too large:")
    assert f"{len(rec):,} rows can be read" in run.stderr and len(rec) > 2000 and not rec.complete
    for name in rec:
        np.testing.assert_array_equal(rec[name].reshape(len(rec), -1)[:, -1], np.arange(len(rec)))


def test_an_existing_file_is_kept_unless_forced(tmp_path):
    path = tmp_path / "run.h5"
    path.write_text("precious")
    with pytest.raises(RecordingError, match=r"the file exists.*--force"):
        Recorder(LAYOUT, META, path)
    assert path.read_text() == "precious"
    with pytest.raises(ValueError, match="velocity_names"):
        Recorder(LAYOUT, META | {"velocity_names": ("v",)}, path, force=True)
    assert path.read_text() == "precious"
    Recorder(LAYOUT, META, path, force=True).finish(DONE)
    assert Recording.open(path).complete and list(tmp_path.iterdir()) == [path]


def test_two_recorders_never_share_a_file(tmp_path):
    path = tmp_path / "run.h5"
    first = Recorder(LAYOUT, META, path)
    first.append_block(rows_of(10))
    with pytest.raises(RecordingError, match=r"the file exists"):
        Recorder(LAYOUT, META, path)
    with pytest.raises(RecordingError, match="another run is writing it"):
        Recorder(LAYOUT, META, path, force=True)
    assert len(first.finish(DONE)) == 10


def test_a_place_that_cannot_be_written_is_refused(tmp_path):
    (tmp_path / "file").write_text("")
    for path in (tmp_path / "file" / "run.h5", tmp_path, Path("/proc/mmnn/run.h5")):
        with pytest.raises(RecordingError, match=r"cannot create the recording: [^[]*$"):
            Recorder(LAYOUT, META, path)
    if os.geteuid():
        (tmp_path / "closed").mkdir(mode=0o500)
        with pytest.raises(RecordingError, match="Permission denied"):
            Recorder(LAYOUT, META, tmp_path / "closed" / "run.h5")


def test_what_is_not_a_recording_is_refused(tmp_path):
    with pytest.raises(RecordingError, match="no such recording"):
        Recording.open(tmp_path / "missing.h5")
    (tmp_path / "text.h5").write_text("no")
    with pytest.raises(RecordingError, match="not an HDF5 file"):
        Recording.open(tmp_path / "text.h5")
    with h5py.File(tmp_path / "other.h5", "w") as file:
        file["data"] = [1.0]
    with pytest.raises(RecordingError, match="mmnn_pin did not write it"):
        Recording.open(tmp_path / "other.h5")
    record(rows_of(2), tmp_path / "new.h5")
    with h5py.File(tmp_path / "new.h5", "r+") as file:
        file.attrs["format_version"] = 99
    with pytest.raises(RecordingError, match=r"format version is 99.*upgrade"):
        Recording.open(tmp_path / "new.h5")
    data = (record(rows_of(2), tmp_path / "cut.h5").path or tmp_path).read_bytes()
    (tmp_path / "cut.h5").write_bytes(data[: len(data) // 2])
    with pytest.raises(RecordingError, match="cannot read the recording"):
        Recording.open(tmp_path / "cut.h5")


def test_wrong_use_is_told(tmp_path):
    recorder = Recorder(LAYOUT, META)
    for wrong in (np.zeros(1), np.zeros(LAYOUT.width + 1)):
        with pytest.raises(ValueError, match="row"):
            recorder.append(wrong)
        with pytest.raises(ValueError, match="rows"):
            recorder.append_block(wrong[None])
    recorder.weights(0.0, {"W": np.zeros(3)})
    with pytest.raises(ValueError, match="shapes"):
        recorder.weights(1.0, {"W": np.zeros(4)})
    rec = recorder.finish(DONE)
    with pytest.raises(RecordingError, match="this run is finished"):
        recorder.finish(DONE)
    with pytest.raises(UnknownName, match="psi_hatt") as raised:
        rec["psi_hatt"]
    assert "did you mean 'psi_hat'" in str(raised.value)
    with pytest.raises(UnknownName):
        rec.unit("nonsense")


@pytest.mark.skipif(sys.platform != "linux", reason="space is reserved on Linux only")
@pytest.mark.parametrize("moment", ["rows", "weights", "finish"])
def test_wherever_the_disk_fills_the_rows_before_are_kept(moment, tmp_path, monkeypatch):
    def full(*_: object) -> None:
        raise OSError(errno.ENOSPC, "no room")

    with Recorder(LAYOUT, META, tmp_path / "run.h5") as recorder:
        recorder.append_block(rows_of(BUFFER_ROWS))
        monkeypatch.setattr("os.posix_fallocate", full)
        told = rf"No space left on device.*the first {BUFFER_ROWS:,} rows can be read"
        with pytest.raises(RecordingError, match=told):
            if moment == "rows":
                recorder.append_block(rows_of(BUFFER_ROWS))
            elif moment == "weights":
                recorder.weights(0.0, {"W": np.zeros(3)})
                recorder.append_block(rows_of(BUFFER_ROWS))  # they go to the file together
            else:
                recorder.finish(DONE, {"nu": np.zeros(4)})
    rec = Recording.open(tmp_path / "run.h5")
    assert len(rec) == BUFFER_ROWS and not rec.complete


def test_a_file_is_replaced_only_by_one_with_a_header(tmp_path, monkeypatch):
    def fail(*_: object) -> None:
        raise OSError(errno.EIO, "broken")

    record(rows_of(5), tmp_path / "run.h5")
    monkeypatch.setattr("os.replace", fail)
    with pytest.raises(RecordingError, match="cannot create the recording: Input/output error"):
        Recorder(LAYOUT, META, tmp_path / "run.h5", force=True)
    assert len(Recording.open(tmp_path / "run.h5")) == 5 and len(list(tmp_path.iterdir())) == 1


def test_files_of_the_current_folder_do_not_meet_what_is_made_in_memory(tmp_path, monkeypatch):
    """HDF5 looks for a file of the name that it is given, also where it writes none."""
    monkeypatch.chdir(tmp_path)
    for number in range(20):
        os.mkfifo(f"recording {number}")
    monkeypatch.setattr(run_file, "NUMBERS", itertools.count())
    run_file._empty.cache_clear()
    assert len(record(rows_of(3), tmp_path / "run.h5")) == 3

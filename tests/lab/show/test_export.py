"""Exports are read back with the other programs' own readers and hold what the recording holds."""

from __future__ import annotations

import csv
import json
import sys
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from replays import recorded
from robots import mobile_arm

from mmnn_pin import load, load_experiment
from mmnn_pin.cli import main
from mmnn_pin.errors import RecordingError, UnknownName
from mmnn_pin.lab.show.bag import field_names
from mmnn_pin.lab.show.curves import column_units
from mmnn_pin.lab.show.export import FORMATS, export
from mmnn_pin.recording.recording import Outcome, Recording, as_columns

ROWS = 60


def run(seed: int = 0, robot: str = "platform_arm") -> Recording:
    """A run of random numbers, but for the time and for where the robot was."""

    def noise(table: np.ndarray, where) -> None:
        moved = [where(name) for name in ("time", "position", "pose", "pose_ref", "q", "q_ref")]
        kept = [table[:, part].copy() for part in moved]
        table[:] = np.random.default_rng(seed).normal(size=table.shape)
        for part, values in zip(moved, kept, strict=True):
            table[:, part] = values

    return recorded(load(robot), duration=ROWS * 0.002, change=noise)


def values(recording: Recording, column: str) -> np.ndarray:
    """A column by the name that the tables give it."""
    signal, _, label = column.partition(".")
    if signal.startswith("weight_norm["):
        return recording["weight_norm"][:, int(signal[-2])]
    return as_columns(recording[signal])[:, recording.labels(signal).index(label or signal)]


def test_csv_gives_the_same_bits_with_units(tmp_path: Path) -> None:
    rec = run()
    rec["z"][:3, 0] = np.nan, np.inf, 5e-324
    with export(rec, tmp_path / "run.csv").open(newline="") as file:
        head, *rows = list(csv.reader(file))
    table = np.array(rows, dtype=float)
    assert table.shape == (ROWS, sum(len(rec.labels(name)) for name in rec))
    for name, column in zip(head, table.T, strict=True):
        np.testing.assert_array_equal(column, values(rec, name.partition(" [")[0] if " [" in name else name))
    for unit in ("time [s]", "pose_error.phi [rad]", "position.arm_1_joint [rad]", "torque.v [N]", "weight_norm[1]"):
        assert unit in head


def test_npz_holds_everything(tmp_path: Path) -> None:
    rec = run()
    with np.load(export(rec, tmp_path / "run.npz")) as read:
        for name in rec:
            np.testing.assert_array_equal(read[name], rec[name])
        told = json.loads(str(read["about"]))
    assert told["urdf"] == rec.urdf and told["meta"]["robot"] == "platform_arm"
    assert told["outcome"]["status"] == "completed" and told["signals"]["z"] == {
        "labels": ["v", "w"],
        "units": ["m/s", "rad/s"],
    }


def test_parquet_holds_units(tmp_path: Path) -> None:
    parquet = pytest.importorskip("pyarrow.parquet")
    rec = run()
    read = parquet.read_table(export(rec, tmp_path / "run.parquet"))
    for name in read.column_names:
        np.testing.assert_array_equal(read[name].to_numpy(), values(rec, name))
    assert read.schema.field("torque.w").metadata == {b"unit": b"N m"}
    assert json.loads(read.schema.metadata[b"mmnn_pin"])["meta"]["controller"] == "two_layer"


def messages(file: Path) -> dict[str, list]:
    """Topic to decoded messages, each with its time, by the reader of the mcap packages."""
    reader = pytest.importorskip("mcap.reader")
    decoder = pytest.importorskip("mcap_ros2.decoder")
    found: dict[str, list] = {}
    with file.open("rb") as stream:
        for _, channel, message, decoded in reader.make_reader(
            stream, decoder_factories=[decoder.DecoderFactory()]
        ).iter_decoded_messages():
            found.setdefault(channel.topic, []).append((message.log_time, decoded))
    return found


def test_mcap_holds_joint_states_and_odometry(tmp_path: Path) -> None:
    rec = run()
    found = messages(export(rec, tmp_path / "run.mcap"))
    for row, (at, state) in enumerate(found["/joint_states"]):
        assert at == round(1e9 * rec.time[row]) == state.header.stamp.sec * 10**9 + state.header.stamp.nanosec
        np.testing.assert_array_equal(state.position, rec["position"][row, 3:])
        rates, torques = (
            dict(zip(state.name, state.velocity, strict=True)),
            dict(zip(state.name, state.effort, strict=True)),
        )
        for label, rate in zip(rec.labels("nu")[2:], rec["nu"][row, 2:], strict=True):
            assert rates[label] == rate
        for label, torque in zip(rec.labels("motor_torque"), rec["motor_torque"][row], strict=True):
            assert torques[label] == torque
    for topic, pose, velocity in (("/odom", "pose", "velocity"), ("/odom_reference", "pose_ref", "velocity_ref")):
        for row, (_, odometry) in enumerate(found[topic]):
            place, twist = odometry.pose.pose, odometry.twist.twist
            turn = 2 * np.arctan2(place.orientation.z, place.orientation.w)
            np.testing.assert_allclose([place.position.x, place.position.y, turn], rec[pose][row], atol=1e-12)
            assert [twist.linear.x, twist.angular.z] == rec[velocity][row].tolist()
    for signal in rec.names[1:]:
        fields = field_names(rec.labels(signal))
        table = [[getattr(message, name) for name in fields] for _, message in found[f"/signals/{signal}"]]
        np.testing.assert_array_equal(table, as_columns(rec[signal]))
    assert found["/robot_description"][0][1].data == rec.urdf


def test_mcap_of_a_run_on_a_robot_has_the_time_of_day(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    rec = run()
    monkeypatch.setattr(Recording, "final", {"began": np.array([1.79e9])})
    for topic, rows in messages(export(rec, tmp_path / "run.mcap")).items():
        times = rec.time if len(rows) > 1 else rec.time[:1]
        assert [at for at, _ in rows] == [1_790_000_000 * 10**9 + round(1e9 * t) for t in times], topic


@pytest.mark.parametrize("name", ["platform_arm", "two_axis_arm", "spatial"])
def test_mcap_frames_are_where_pinocchio_has_the_links(tmp_path: Path, name: str) -> None:
    robot = mobile_arm(3) if name == "spatial" else load(name)
    rec = recorded(robot, duration=0.1)
    found = messages(export(rec, tmp_path / "run.mcap"))
    data, row = robot.model.createData(), 40
    pin.framesForwardKinematics(robot.model, data, robot.configuration(rec["position"][row]))
    tree = {
        t.child_frame_id: t for topic, k in (("/tf_static", 0), ("/tf", row)) for t in found[topic][k][1].transforms
    }
    lift = robot.base.floor if robot.dimensions.pose else 0.0  # the world of the frames is the floor

    def placed(frame: str) -> pin.SE3:
        if frame not in tree:
            return pin.SE3.Identity()
        t = tree[frame].transform
        turn = pin.Quaternion(t.rotation.w, t.rotation.x, t.rotation.y, t.rotation.z)
        at = np.array([t.translation.x, t.translation.y, t.translation.z])
        return placed(tree[frame].header.frame_id) * pin.SE3(turn.matrix(), at)

    links = [frame for frame in robot.model.frames if frame.type == pin.FrameType.BODY and frame.name in tree]
    assert len(links) > 2
    for frame in links:
        expected = data.oMf[robot.model.getFrameId(frame.name)]
        there = placed(frame.name)
        np.testing.assert_allclose(there.rotation, expected.rotation, atol=1e-9)
        np.testing.assert_allclose(there.translation + np.array([0, 0, lift]), expected.translation, atol=1e-9)


def test_fields_are_names_of_ros_and_none_is_lost() -> None:
    labels = ["Arm-1 joint", "arm_1_joint", "7th", "<script>", "", "ß"]
    assert field_names(labels) == ["arm_1_joint", "arm_1_joint_2", "joint_7th", "script", "joint", "joint_2"]


def test_joints_and_pushed_bases_have_their_units() -> None:
    rec = run()
    assert column_units(rec, "position") == ["m", "m", "rad", "rad", "rad", "rad", "rad"]
    assert column_units(rec, "motor_torque") == ["N m"] * 4
    loop = load_experiment("track", ["time.duration=0.01", "touch={}"]).loop(load("platform_arm"), "pd_gravity")
    assert column_units(loop.run(), "external_wrench") == ["N"] * 3 + ["N m"] * 3


def test_a_part_has_some_signals_and_every_nth_sample(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The run has 500 samples per second: at most 100 rows per second are every fifth, at most 90 every sixth."""
    rec = run()
    for rate, every in ((100.0, 5), (90.0, 6), (1e6, 1)):
        with export(rec, tmp_path / f"{every}.csv", signals=["q", "pose"], rate=rate).open(newline="") as file:
            head, *rows = list(csv.reader(file))
        assert [name.partition(".")[0].partition(" ")[0] for name in head] == ["time", *["pose"] * 3, *["q"] * 2]
        wanted = np.column_stack([as_columns(rec[name])[::every] for name in ("time", "pose", "q")])
        np.testing.assert_array_equal(np.array(rows, float), wanted)
        with np.load(export(rec, tmp_path / f"{every}.npz", signals=["q", "pose"], rate=rate)) as arrays:
            np.testing.assert_array_equal(arrays["q"], rec["q"][::every])
            assert "torque" not in arrays and arrays["step_time"].size == len(rows)
    short = ["--set", "time.duration=0.1", "--set", "plots=[]", "--controller", "pd", "--out", str(tmp_path / "a")]
    assert main(["run", "chapter4", *short]) == 0
    saved = str(tmp_path / "a/pd.h5")
    for options, told in (
        (["--signals", "q,torqe"], "--signals: error: unknown signal 'torqe': did you mean 'torque'?"),
        (["--rate", "0"], "--rate: error: 0 Hz: give a rate above 0"),
    ):
        assert main(["export", saved, "--to", "csv", "--out", str(tmp_path / "b.csv"), *options]) == 2
        assert told in capsys.readouterr().err and not (tmp_path / "b.csv").exists()
    assert main(["export", saved, "--to", "mcap", "--out", str(tmp_path / "b.mcap"), "--rate", "5"]) == 2
    assert "a part of a recording as MCAP" in capsys.readouterr().err


def test_a_large_file_is_told_with_how_to_have_less(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    short = ["--set", "time.duration=0.1", "--set", "plots=[]", "--controller", "pd", "--out", str(tmp_path / "a")]
    assert main(["run", "chapter4", *short]) == 0
    saved = str(tmp_path / "a/pd.h5")
    monkeypatch.setattr("mmnn_pin.cli.results.LARGE", 1000)
    assert main(["export", saved, "--to", "csv"]) == 0
    out = capsys.readouterr().out
    assert "MB; --rate 100 and --signals q,torque make smaller tables" in out
    assert main(["export", saved, "--to", "csv", "--force", "--rate", "100", "--signals", "q,torque"]) == 0


@pytest.mark.parametrize("to", FORMATS)
def test_a_diverged_run_can_be_exported(tmp_path: Path, to: str) -> None:
    def lose(table: np.ndarray, where) -> None:
        table[-1, 1:] = np.nan
        table[-2, 1:] = np.inf

    rec = recorded(load("platform_arm"), duration=0.02, change=lose, outcome=Outcome("diverged", 0.02, "nu[0]", "lost"))
    with np.errstate(invalid="ignore"):
        assert export(rec, tmp_path / f"run.{to}").stat().st_size > 1000


def test_a_file_is_not_replaced_unasked(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    rec, file = run(), tmp_path / "run.npz"
    file.write_text("mine")
    with pytest.raises(RecordingError, match="exists"):
        export(rec, file)
    monkeypatch.setattr("mmnn_pin.lab.show.export.about", lambda recording: 1 / 0)
    with pytest.raises(ZeroDivisionError):
        export(rec, file, force=True)
    assert file.read_text() == "mine" and list(tmp_path.iterdir()) == [file]


def test_what_is_not_installed_is_told(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for package in ("pyarrow", "mcap_ros2.writer"):
        monkeypatch.setitem(sys.modules, package, None)
    monkeypatch.delitem(sys.modules, "mmnn_pin.lab.show.bag", raising=False)
    for to, package in (("parquet", "pyarrow"), ("mcap", "mcap_ros2")):
        with pytest.raises(RecordingError) as error:
            export(run(), tmp_path / f"run.{to}")
        assert package in str(error.value) and "pip install 'mmnn_pin[export]'" in str(error.value)
    assert list(tmp_path.iterdir()) == []
    with pytest.raises(UnknownName):
        export(run(), tmp_path / "run.xls")


def test_the_command(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for name in ("a", "b"):
        (tmp_path / name).mkdir()
    settings = ["--set", "time.duration=0.1", "--set", "plots=[]", "--controller", "pd", "--controller", "two_layer"]
    assert main(["run", "chapter4", *settings, "--out", str(tmp_path / "a")]) == 0
    capsys.readouterr()
    out = tmp_path / "tables"
    assert main(["export", str(tmp_path / "a"), "--to", "npz", "--out", str(out), "--json"]) == 0
    files = json.loads(capsys.readouterr().out)["files"]
    assert sorted(map(Path, files.values())) == [out / "pd.npz", out / "two_layer.npz"]
    with np.load(out / "two_layer.npz") as read:
        np.testing.assert_array_equal(read["z"], Recording.open(tmp_path / "a/two_layer.h5")["z"])
        assert {"weights/V1", "final/controller_state"} <= set(read)
    assert main(["export", str(tmp_path / "a"), "--to", "npz", "--out", str(out)]) == 2
    assert "--force" in capsys.readouterr().err
    assert main(["export", str(tmp_path / "a"), "--to", "csv", "--out", str(tmp_path / "one.csv")]) == 2
    assert main(["export", str(tmp_path / "a/pd.h5"), "--to", "csv", "--out", str(tmp_path / "one.csv")]) == 0

"""Bags: what rosbags writes is read back, from sqlite3 and MCAP; bags without a motion are refused in one line."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from motions import simulated

from mmnn_pin import load
from mmnn_pin.cli import main
from mmnn_pin.deploy.identify.bag import decoder
from mmnn_pin.deploy.identify.log import Log
from mmnn_pin.deploy.identify.reading import read_logs
from mmnn_pin.errors import RecordingError
from mmnn_pin.model.robot import Robot

rosbags = pytest.importorskip("rosbags", reason="pip install 'mmnn_pin[identify]'")


@pytest.fixture(scope="module")
def arm() -> Robot:
    return load("two_axis_arm")


@pytest.fixture(scope="module")
def log(arm: Robot) -> Log:
    return simulated(arm, 5.0)


def write(path: Path, storage: str, messages: list[tuple[str, str, int, Any]]) -> Path:
    """A bag of (topic, type, nanoseconds, message)."""
    from rosbags.rosbag2 import StoragePlugin, Writer
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS2_HUMBLE)
    with Writer(path, version=9, storage_plugin=StoragePlugin[storage]) as writer:
        topics: dict[str, Any] = {}
        for topic, kind, time, message in messages:
            if topic not in topics:
                topics[topic] = writer.add_connection(topic, kind, typestore=store)
            writer.write(topics[topic], time, store.serialize_cdr(message, kind))
    return path


def states(log: Log, joints: list[str], start: int = 1_700_000_000, every: int = 1, shift: float = 0.0) -> list[Any]:
    from rosbags.typesys import Stores, get_typestore

    types = get_typestore(Stores.ROS2_HUMBLE).types
    made = []
    for i in range(0, len(log.time), every):
        ns = round((log.time[i] + shift) * 1e9)
        stamp = types["builtin_interfaces/msg/Time"](start + ns // 10**9, ns % 10**9)
        parts = [np.array([table[j][i] for j in joints]) for table in (log.position, log.velocity, log.effort)]
        message = types["sensor_msgs/msg/JointState"](types["std_msgs/msg/Header"](stamp, ""), joints, *parts)
        made.append(("/joint_states", "sensor_msgs/msg/JointState", start * 10**9 + ns, message))
    return made


@pytest.mark.parametrize("storage", ["SQLITE3", "MCAP"])
def test_joint_states_are_read_back(storage: str, log: Log, arm: Robot, tmp_path: Path) -> None:
    folder = write(tmp_path / "bag", storage, states(log, list(arm.joint_names)))
    (file,) = [f for f in folder.iterdir() if f.suffix in (".db3", ".mcap")]
    for path in (folder, file):
        (found,) = read_logs([path], arm)
        assert set(found.signals) == set(log.signals)
        for name, values in log.signals.items():
            np.testing.assert_array_equal(found.signals[name], values)
        np.testing.assert_allclose(found.time, log.time, atol=1e-9)


def test_joints_in_messages_of_their_own_are_interpolated(log: Log, arm: Robot, tmp_path: Path) -> None:
    one, two = arm.joint_names
    messages = states(log, [one]) + states(log, [two], every=2, shift=0.003)
    found = read_logs([write(tmp_path / "bag", "SQLITE3", messages)], arm)[0]
    assert any(f"{two}: in messages of their own" in note for note in found.notes)
    shown = np.interp(found.time, log.time[::2] + 0.003, log.position[two][::2])
    np.testing.assert_allclose(found.position[two], shown, atol=1e-9)
    np.testing.assert_array_equal(found.effort[one], log.effort[one])


def test_other_names_are_mapped(log: Log, arm: Robot, tmp_path: Path) -> None:
    one, two = arm.joint_names
    messages = states(log, [one, two])
    for *_, message in messages:
        message.name[:] = ["a", "b"]
    path = write(tmp_path / "bag", "MCAP", messages)
    with pytest.raises(RecordingError, match=r"no joint of the robot in /joint_states.*joint.OURS=THEIRS"):
        read_logs([path], arm)
    (found,) = read_logs([path], arm, {f"joint.{one}": "a", f"joint.{two}": "b"})
    np.testing.assert_array_equal(found.position[two], log.position[two])


def test_bags_without_a_motion_are_refused(
    log: Log, arm: Robot, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    from rosbags.typesys import Stores, get_typestore

    said = get_typestore(Stores.ROS2_HUMBLE).types["std_msgs/msg/String"]("hello")
    path = write(tmp_path / "talk", "SQLITE3", [("/chatter", "std_msgs/msg/String", 5, said)])
    with pytest.raises(RecordingError, match=r"without joint states: it has /chatter \(std_msgs/msg/String\)"):
        read_logs([path], arm)
    assert main(["identify", str(path), "--robot", "two_axis_arm", "--out", str(tmp_path / "out")]) == 2
    said = capsys.readouterr()
    assert said.out == "" and said.err.count("\n") == 1 and "without joint states" in said.err
    assert not (tmp_path / "out").exists()
    (tmp_path / "broken.mcap").write_bytes(b"\x89MCAP0\r\nno more")
    (tmp_path / "broken.db3").write_bytes(b"nothing")
    (tmp_path / "empty").mkdir()
    chunk = bytes(16) + (2**40).to_bytes(8, "little") + bytes(40)
    (tmp_path / "long.mcap").write_bytes(b"\x89MCAP0\r\n\x01" + (2**40).to_bytes(8, "little") + bytes(40))
    (tmp_path / "dense.mcap").write_bytes(b"\x89MCAP0\r\n\x06" + len(chunk).to_bytes(8, "little") + chunk + bytes(40))
    for name, why in {
        "long.mcap": "record at byte 8 has 1,099,511,627,776",
        "dense.mcap": "unpacks to 1,099,512 MB",
    }.items():
        with pytest.raises(RecordingError, match=why):
            read_logs([tmp_path / name], arm)
    for name in ("broken.mcap", "broken.db3", "empty"):
        with pytest.raises(RecordingError, match="the bag cannot be read") as error:
            read_logs([tmp_path / name], arm)
        assert "\n" not in str(error.value)


BOMB = 50_000_000  # bytes of nothing
TOO_LARGE = r"unpacks to (far )?more than"


@pytest.mark.parametrize("form", ["zstd", "lz4"])
def test_a_chunk_that_lies_about_what_it_unpacks_to_is_refused(form: str, arm: Robot, tmp_path: Path) -> None:
    packed = decoder(form).compress(bytes(BOMB))
    head = bytes(16) + (1000).to_bytes(8, "little") + bytes(4) + len(form).to_bytes(4, "little") + form.encode()
    chunk = head + len(packed).to_bytes(8, "little") + packed
    (tmp_path / "a.mcap").write_bytes(b"\x89MCAP0\r\n\x06" + len(chunk).to_bytes(8, "little") + chunk + bytes(40))
    with pytest.raises(RecordingError, match=f"the chunk at byte 8 {TOO_LARGE} 1,000 bytes"):
        read_logs([tmp_path / "a.mcap"], arm)


def test_a_bag_of_a_compressed_gigabyte_is_refused(log: Log, arm: Robot, tmp_path: Path) -> None:
    (tmp_path / "bag").mkdir()
    (tmp_path / "bag" / "a.db3.zstd").write_bytes(decoder("zstd").compress(bytes(BOMB)))
    with pytest.raises(RecordingError, match=rf"a\.db3\.zstd: error: .* it {TOO_LARGE}"):
        read_logs([tmp_path / "bag"], arm)


def test_a_dataset_of_a_billion_equal_numbers_is_refused(arm: Robot, tmp_path: Path) -> None:
    pyarrow = pytest.importorskip("pyarrow", reason="pip install 'mmnn_pin[export]'")
    parquet = pytest.importorskip("pyarrow.parquet")
    part = pyarrow.table({"timestamp": np.zeros(10**7, np.float32)})
    for name in ("data", "meta"):
        (tmp_path / name).mkdir()
    (tmp_path / "meta" / "info.json").write_text('{"features": {}}')
    with parquet.ParquetWriter(tmp_path / "data" / "a.parquet", part.schema) as writer:
        for _ in range(7):
            writer.write_table(part)
    assert (tmp_path / "data" / "a.parquet").stat().st_size < 10**7
    with pytest.raises(RecordingError, match=f"{TOO_LARGE} 500 MB"):
        read_logs([tmp_path], arm)

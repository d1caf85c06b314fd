"""Bags: what rosbags writes is read back, from sqlite3 and MCAP; bags without a motion are refused in one line."""

from __future__ import annotations

import json
import re
import resource
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from motions import simulated

from mmnn_pin import load
from mmnn_pin.cli import main
from mmnn_pin.deploy.identify.bag import JOINTS, READ
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
    (tmp_path / "long.mcap").write_bytes(b"\x89MCAP0\r\n\x01" + (2**40).to_bytes(8, "little") + bytes(40))
    for name in ("broken.mcap", "long.mcap", "broken.db3", "empty"):
        with pytest.raises(RecordingError, match="the bag cannot be read") as error:
            read_logs([tmp_path / name], arm)
        assert "\n" not in str(error.value)


TOO_LARGE = r"unpacks to (far )?more than"
NOTHING = bytes(50_000_000)


def refused(path: Path, arm: Robot) -> None:
    """A bag is, for what it unpacks to."""
    with pytest.raises(RecordingError, match=rf"{re.escape(str(path))}: error: .* it {TOO_LARGE}"):
        read_logs([path], arm)


@pytest.mark.parametrize("form", ["bz2", "lz4"])
def test_a_chunk_of_ros_1_that_unpacks_to_far_more_is_refused(form: str, log: Log, arm: Robot, tmp_path: Path) -> None:
    from rosbags.rosbag1 import Writer
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS1_NOETIC)
    writer = Writer(tmp_path / "a.bag")
    writer.set_compression(Writer.CompressionFormat[form.upper()])
    with writer:
        topic = writer.add_connection("/joint_states", JOINTS, typestore=store)
        writer.write(topic, 5, NOTHING)
    refused(tmp_path / "a.bag", arm)


@pytest.mark.parametrize("storage", ["SQLITE3", "MCAP"])
@pytest.mark.parametrize("mode", ["MESSAGE", "FILE", "STORAGE"])
def test_what_is_compressed_in_a_bag_is_read_within_limits(
    storage: str, mode: str, log: Log, arm: Robot, tmp_path: Path
) -> None:
    from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer
    from rosbags.typesys import Stores, get_typestore

    if (storage, mode) == ("SQLITE3", "STORAGE"):
        pytest.skip("there is none")
    store = get_typestore(Stores.ROS2_HUMBLE)
    for name, extra in (("sound", b""), ("bomb", NOTHING)):
        writer = Writer(tmp_path / name, version=8, storage_plugin=StoragePlugin[storage])
        writer.set_compression(CompressionMode[mode], CompressionFormat.ZSTD)
        with writer:
            topic = writer.add_connection("/joint_states", JOINTS, typestore=store)
            for _, kind, time, message in states(log, list(arm.joint_names)):
                writer.write(topic, time, store.serialize_cdr(message, kind))
            if extra:
                writer.write(topic, time + 1, extra)
    (packed,) = (file for file in (tmp_path / "bomb").iterdir() if file.suffix != ".yaml")
    other = packed.rename(packed.with_suffix(".data"))  # its name tells nobody
    said = tmp_path / "bomb" / "metadata.yaml"
    said.write_text(said.read_text().replace(packed.name, other.name))
    refused(tmp_path / "bomb", arm)
    if mode == "STORAGE":
        data = bytearray(other.read_bytes())
        chunk = 17 + int.from_bytes(data[9:17], "little")
        assert data[chunk] == 6
        data[chunk] = 9  # an attachment, of which the index says that it is a chunk
        other.write_bytes(data)
        refused(tmp_path / "bomb", arm)
    (found,) = read_logs([tmp_path / "sound"], arm)
    np.testing.assert_array_equal(found.signals[f"position.{arm.joint_names[0]}"], log.position[arm.joint_names[0]])


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


def test_texts_of_a_dataset_are_not_unpacked(arm: Robot, tmp_path: Path) -> None:
    """Half a megabyte of them may be 200 GB."""
    pyarrow = pytest.importorskip("pyarrow", reason="pip install 'mmnn_pin[export]'")
    parquet, rows = pytest.importorskip("pyarrow.parquet"), 200_000
    texts = pyarrow.DictionaryArray.from_arrays(np.zeros(rows, np.int32), ["x" * 1_000_000])
    state = pyarrow.FixedSizeListArray.from_arrays(np.zeros(2 * rows, np.float32), 2)
    columns = {"timestamp": 0.01 * np.arange(rows), "episode_index": np.zeros(rows, np.int64)}
    for name in ("data", "meta"):
        (tmp_path / name).mkdir()
    names = [f"{joint}.pos" for joint in arm.joint_names]
    about = {"observation.state": {"dtype": "float32", "names": names}}
    (tmp_path / "meta" / "info.json").write_text(json.dumps({"features": about}))
    table = pyarrow.table(columns | {"task": texts, "observation.state": state})
    parquet.write_table(table, tmp_path / "data" / "a.parquet", store_schema=False)  # which says that they are equal
    before = pyarrow.total_allocated_bytes()
    with pytest.raises(RecordingError, match="it has no efforts at all"):
        read_logs([tmp_path], arm)
    assert pyarrow.default_memory_pool().max_memory() - before < 100_000_000


# -- types -------------------------------------------------------------------------------------------------------------

LARGE = (
    "module x { module msg { module Y_Constants { const uint32 A = 1 << 9999999999; }; struct Y { uint32 a; }; }; };"
)


def test_definitions_of_a_bag_are_not_read(arm: Robot, tmp_path: Path) -> None:
    """They are expressions: this one is a number of a gigabyte."""
    writer = pytest.importorskip("mcap.writer", reason="pip install 'mmnn_pin[export]'")
    with (tmp_path / "a.mcap").open("wb") as file:
        (bag := writer.Writer(file)).start("ros2")
        topic = bag.register_channel("/y", "cdr", bag.register_schema("x/msg/Y", "ros2idl", LARGE.encode()))
        bag.add_message(topic, 0, bytes(8), 0)
        bag.finish()
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    with pytest.raises(RecordingError, match=re.escape("a bag without joint states: it has /y (x/msg/Y)")):
        read_logs([tmp_path / "a.mcap"], arm)
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before < 500_000  # kB


def test_messages_are_those_of_every_ros_2(arm: Robot) -> None:
    from rosbags.typesys import Stores, get_typestore

    stores = [get_typestore(store) for store in Stores if store.name.startswith("ROS2")]
    assert len(stores) > 5 and all(len({store.hash_rihs01(name) for store in stores}) == 1 for name in READ)


def test_a_bag_with_other_messages_than_those_of_ros_is_refused(arm: Robot, log: Log, tmp_path: Path) -> None:
    from rosbags.rosbag1 import Writer
    from rosbags.typesys import Stores, get_types_from_msg, get_typestore

    store = get_typestore(Stores.EMPTY)
    store.register(get_types_from_msg("float64[] position\n", JOINTS))
    with Writer(tmp_path / "a.bag") as writer:
        topic = writer.add_connection("/joint_states", JOINTS, typestore=store)
        writer.write(topic, 5, store.serialize_ros1(store.types[JOINTS](np.zeros(2)), JOINTS))
    with pytest.raises(RecordingError, match=f"its {JOINTS} is another than that of ROS"):
        read_logs([tmp_path / "a.bag"], arm)

"""Recordings as LeRobot datasets (v3.0): one run is one episode of states and actions, without images.

    observation.state       measured joints `JOINT.pos`, base velocity `x.vel`, `theta.vel` (and `y.vel`)
    observation.velocity    rates of the joints `JOINT.vel`
    observation.effort      torques of the motors `MOTOR.effort`
    action                  the reference of the same names as the state

Numbers are in rad, m, rad/s, m/s, N m and N, as the features say; LeRobot's drivers of hobby arms take degrees.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np

from ...errors import ConfigError, RecordingError
from ...files import whole_folder
from ...recording.recording import Recording, as_columns
from ...signals import Array

VERSION = "v3.0"
PLACE = "chunk-000/file-000.parquet"
BASE = {"v": "x", "vx": "x", "vy": "y", "w": "theta"}  # velocities of a base, as LeRobot's drivers call them
INDICES = ("frame_index", "episode_index", "index", "task_index")
WHOLE = 1e-3  # of a rate, by which it may be beside a whole number [Hz]
INDEXED = {  # as pandas has a table of which `task` is the index
    "index_columns": ["task"],
    "column_indexes": [],
    "columns": [
        {"name": name, "field_name": name, "pandas_type": kind, "numpy_type": numpy, "metadata": None}
        for name, kind, numpy in (("task_index", "int64", "int64"), ("task", "unicode", "object"))
    ],
    "creator": {"library": "pyarrow"},
    "pandas_version": "2.0.0",
}
UNITS = "rad, m, rad/s, m/s, N m, N"


def write_lerobot(recording: Recording, path: Path, every: int = 1, force: bool = False) -> Path:
    """A dataset of one episode of every n-th sample in a folder, whole or not at all.

    Raises:
        ConfigError: The rows per second are no whole number.
        RecordingError: The folder cannot be written, or has files of that name.
    """
    import pyarrow
    import pyarrow.parquet

    features, rate = features_of(recording, every), rate_of(recording, every)
    count, task = len(next(iter(features.values()))[1]), str(recording.meta.get("experiment", "")) or "run"
    columns: dict[str, Any] = {
        name: pyarrow.array(list(np.asarray(values, np.float32))) for name, (_, values) in features.items()
    }
    frames = np.arange(count)
    columns["timestamp"] = pyarrow.array(np.asarray(frames / rate, np.float32))
    columns |= {name: pyarrow.array(frames if name in ("frame_index", "index") else 0 * frames) for name in INDICES}
    stats = {name: statistics(values) for name, (_, values) in features.items()}
    episode = {"episode_index": 0, "tasks": [task], "length": count}
    episode |= {"dataset_from_index": 0, "dataset_to_index": count}
    episode |= {f"{kind}/{which}_index": 0 for kind in ("data", "meta/episodes") for which in ("chunk", "file")}
    episode |= {f"stats/{name}/{key}": value for name, found in stats.items() for key, value in found.items()}
    with whole_folder(path, "dataset", force) as folder:
        tables = {
            f"data/{PLACE}": columns,
            f"meta/episodes/{PLACE}": {name: pyarrow.array([value]) for name, value in episode.items()},
            "meta/tasks.parquet": {"task_index": pyarrow.array([0]), "task": pyarrow.array([task])},
        }
        for name, table in tables.items():
            (folder / name).parent.mkdir(parents=True, exist_ok=True)
            made = pyarrow.table(table)
            if "task" in table:
                made = made.replace_schema_metadata({"pandas": json.dumps(INDEXED)})
            pyarrow.parquet.write_table(made, folder / name)
        for name, about in (("info", info(recording, features, rate, count)), ("stats", stats)):
            (folder / "meta" / f"{name}.json").write_text(json.dumps(about, indent=4) + "\n", encoding="utf-8")
    return path


def features_of(recording: Recording, every: int) -> dict[str, tuple[list[str], Array]]:
    """Names and values (rows, columns) of every feature.

    Raises:
        RecordingError: Nothing was measured.
    """
    if not {"q", "velocity"} & {*recording}:
        raise RecordingError("nothing to export", why="it has no joints and no base velocity", file=recording.path)
    joints, base = recording.labels("q") if "q" in recording else (), []
    if "velocity" in recording:
        base = [f"{BASE.get(name, name)}.vel" for name in recording.labels("velocity")]

    def table(*signals: str) -> Array:
        return np.hstack([as_columns(recording[name])[::every] for name in signals if name in recording])

    state = [*(f"{joint}.pos" for joint in joints), *base]
    found = {"observation.state": (state, table("q", "velocity"))}
    if joints:
        found["observation.velocity"] = ([f"{joint}.vel" for joint in joints], table("qdot"))
    torque = "applied" if "applied" in recording else "motor_torque"
    found["observation.effort"] = ([f"{name}.effort" for name in recording.labels(torque)], table(torque))
    action = table("q_ref", "velocity_ref")
    if action.shape[1] == len(state):
        found["action"] = (state, action)
    return found


def rate_of(recording: Recording, every: int) -> int:
    """Rows per second, a whole number as datasets have it.

    Raises:
        ConfigError: It is none.
    """
    rate = 1.0 / (every * float(np.median(np.diff(recording.time)))) if len(recording) > every else 1.0
    if abs(rate - round(rate)) > WHOLE:
        fix = "choose another with --rate, such as --rate 50"
        raise ConfigError(f"{rate:g} rows per second", why="a dataset has a whole number", fix=fix, key="--rate")
    return round(rate)


def statistics(values: Array) -> dict[str, list[float]]:
    """Smallest, largest, mean and deviation of every column, and how many rows there are."""
    found = {
        "min": values.min(axis=0),
        "max": values.max(axis=0),
        "mean": values.mean(axis=0),
        "std": values.std(axis=0),
    }
    return {name: each.tolist() for name, each in found.items()} | {"count": [len(values)]}


def info(recording: Recording, features: dict[str, tuple[list[str], Array]], rate: int, count: int) -> dict[str, Any]:
    """The contents of `meta/info.json`."""
    described: dict[str, Any] = {
        name: {"dtype": "float32", "shape": [len(names)], "names": names, "units": UNITS}
        for name, (names, _) in features.items()
    }
    described["timestamp"] = {"dtype": "float32", "shape": [1], "names": None}
    described |= {name: {"dtype": "int64", "shape": [1], "names": None} for name in INDICES}
    return {
        "codebase_version": VERSION,
        "robot_type": recording.meta.get("robot"),
        "total_episodes": 1,
        "total_frames": count,
        "total_tasks": 1,
        "chunks_size": 1000,
        "data_files_size_in_mb": 100,
        "video_files_size_in_mb": 200,
        "fps": rate,
        "splits": {"train": "0:1"},
        "data_path": "data/chunk-{chunk_index:03d}/file-{file_index:03d}.parquet",
        "video_path": None,
        "features": described,
    }

"""Takes the rows of one run as they come and ends as a `Recording`, in memory or in a file.

Rows gather in a buffer and go to the file when it is full or 0.25 s old, so a kill loses less than half a second.
"""

from __future__ import annotations

import hashlib
import platform
import time
from collections.abc import Mapping
from dataclasses import asdict
from datetime import UTC, datetime
from importlib import metadata
from pathlib import Path
from types import TracebackType
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .recording import Outcome, Recording
from .run_file import Arrays, Columns, RunFile, decode, encode
from .signals import SIGNALS, Array, Layout

BUFFER_ROWS = 1024
WRITE_PERIOD = 0.25  # [s] of wall clock


class Recorder:
    """Writes one run.

    Use it in a `with` block: an exception closes the file, whose recording then reads as incomplete.

    Args:
        layout: Where the signals stand in a row.
        meta: About the run: `robot`, `controller`, `seed`; the texts `config` and `urdf`; `velocity_names` (p),
            `position_names` (nv) and `actuator_names` for the columns' labels; anything else that JSON can hold.
        path: File to write; None keeps everything in memory.
        force: Replace an existing file.

    Raises:
        RecordingError: The file exists (without `force`), another run writes it, or it cannot be created.
    """

    def __init__(
        self, layout: Layout, meta: Mapping[str, Any], path: str | Path | None = None, force: bool = False
    ) -> None:
        facts = _facts(meta)
        texts: dict[str, str] = {name: facts.pop(name) for name in ("config", "urdf") if name in facts}
        columns = _columns(layout, facts)
        self._store: RunFile | _Memory = (
            _Memory(layout, columns, facts, texts)
            if path is None
            else RunFile(Path(path), force, layout, columns, facts, texts)
        )
        self._rows, self._step_times = np.empty((BUFFER_ROWS, layout.width)), np.empty(BUFFER_ROWS)
        self._filled, self._written = 0, time.perf_counter()
        self._weight_shapes: dict[str, tuple[int, ...]] = {}

    def append(self, row: Array, step_time: float = 0.0) -> None:
        """Add one row, shape (width,), which is copied; `step_time` is the wall-clock time it took [s].

        Raises:
            RecordingError: The file cannot be written; the rows already in it can be read.
        """
        if row.shape != self._rows.shape[1:]:
            raise ValueError(f"a row has shape {self._rows.shape[1:]}, not {row.shape}")
        self._rows[self._filled] = row
        self._step_times[self._filled] = step_time
        self._filled += 1
        self._write_when_due()

    def append_block(self, rows: Array, step_times: ArrayLike = 0.0) -> None:
        """Add rows, shape (k, width), which are copied; `step_times` (k,) or one for all [s].

        Raises:
            RecordingError: The file cannot be written; the rows already in it can be read.
        """
        if rows.ndim != 2 or rows.shape[1] != self._rows.shape[1]:
            raise ValueError(f"rows have shape (k, {self._rows.shape[1]}), not {rows.shape}")
        times = np.broadcast_to(np.asarray(step_times, float), len(rows))
        done = 0
        while done < len(rows):
            count = min(len(rows) - done, BUFFER_ROWS - self._filled)
            end = self._filled + count
            self._rows[self._filled : end] = rows[done : done + count]
            self._step_times[self._filled : end] = times[done : done + count]
            self._filled, done = end, done + count
            self._write_when_due()

    def weights(self, time: float, arrays: Mapping[str, ArrayLike]) -> None:
        """Keep a snapshot of the networks' weights at a time [s]: the same names and shapes every time.

        Raises:
            RecordingError: The file cannot be written; the rows already in it can be read.
        """
        snapshot: Arrays = {"time": np.array(time, float)} | {name: np.array(a) for name, a in arrays.items()}
        shapes = {name: array.shape for name, array in snapshot.items()}
        if self._weight_shapes not in ({}, shapes):
            raise ValueError(f"the weights had the shapes {self._weight_shapes}, now {shapes}")
        self._weight_shapes = shapes
        self._store.weights(snapshot)

    def finish(self, outcome: Outcome, final_state: Mapping[str, ArrayLike] | None = None) -> Recording:
        """Write what is left, the outcome and the final state, and close the file.

        Raises:
            RecordingError: The file cannot be written; the rows already in it can be read.
        """
        self._write()
        final: Arrays = {name: np.array(array) for name, array in (final_state or {}).items()}
        if isinstance(self._store, _Memory):
            return self._store.finish(outcome, final)
        self._store.finish(asdict(outcome), final)
        return Recording.open(self._store.path)

    def __enter__(self) -> Recorder:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        if self._store.is_open:
            try:
                self._write()
            finally:
                self._store.close()

    def _write_when_due(self) -> None:
        if self._filled == BUFFER_ROWS or time.perf_counter() - self._written > WRITE_PERIOD:
            self._write()

    def _write(self) -> None:
        if not self._store.is_open:
            raise ValueError("this run is finished")
        if self._filled:
            self._store.write(self._rows[: self._filled], self._step_times[: self._filled])
        self._filled, self._written = 0, time.perf_counter()


class _Memory:
    """Keeps a run as a list of blocks."""

    def __init__(
        self, layout: Layout, columns: dict[str, Columns], meta: dict[str, Any], texts: dict[str, str]
    ) -> None:
        self.layout, self.columns, self.meta, self.texts = layout, columns, meta, texts
        self.blocks, self.step_times = [np.empty((0, layout.width))], [np.empty(0)]
        self.snapshots: dict[str, list[NDArray[Any]]] = {}
        self.is_open = True

    def write(self, rows: Array, step_times: Array) -> None:
        self.blocks.append(rows.copy())
        self.step_times.append(step_times.copy())

    def weights(self, snapshot: Arrays) -> None:
        for name, array in snapshot.items():
            self.snapshots.setdefault(name, []).append(array)

    def finish(self, outcome: Outcome, final: Arrays) -> Recording:
        self.close()
        rows = np.concatenate(self.blocks)
        parts: dict[str, Arrays] = {f"signals/{name}": {name: self._signal(rows, name)} for name in self.columns}
        parts["timing/step_time"] = {"step_time": np.concatenate(self.step_times)}
        parts |= {"weights": {name: np.stack(arrays) for name, arrays in self.snapshots.items()}, "final": final}
        return Recording(
            columns=self.columns,
            rows=len(rows),
            read=parts.__getitem__,
            meta=self.meta,
            texts=self.texts,
            outcome=outcome,
        )

    def close(self) -> None:
        self.is_open = False

    def _signal(self, rows: Array, name: str) -> Array:
        columns = rows[:, self.layout.where(name)]
        return np.ascontiguousarray(columns[:, 0] if columns.shape[1] == 1 else columns)


def versions() -> dict[str, str]:
    """Versions of Python, of this package and of what its numbers come from."""
    found = {"python": platform.python_version()}
    for name in ("mmnn_pin", "pin", "numpy", "numba", "h5py"):
        try:
            found[name] = metadata.version(name)
        except metadata.PackageNotFoundError:
            found[name] = "unknown"
    return found


def _facts(meta: Mapping[str, Any]) -> dict[str, Any]:
    """What is known of the run, when it was made and by which versions; as it will read back."""
    facts = {"created": datetime.now(UTC).isoformat(timespec="seconds"), "versions": versions(), **meta}
    if "urdf" in facts:
        facts.setdefault("urdf_sha256", hashlib.sha256(facts["urdf"].encode()).hexdigest())
    return {name: decode(encode(value)) for name, value in facts.items()}


def _columns(layout: Layout, facts: Mapping[str, Any]) -> dict[str, Columns]:
    """Unit and labels of every signal that this robot has."""
    velocities = _names(facts, "velocity_names", layout.dof)
    labels = {
        "pose": ("x", "y", "phi"),
        "all": velocities,
        "base": velocities[: layout.base],
        "arm": velocities[layout.base :],
        "full": _names(facts, "position_names", layout.full),
        "motor": _names(facts, "actuator_names", layout.motors),
        "wheel": _names(facts, "actuator_names", layout.motors)[: layout.wheels],
    }
    columns = {}
    for name, kind, *_ in SIGNALS:
        if size := layout.where(name).stop - layout.where(name).start:
            own = (name,) if size == 1 else tuple(f"{name}[{i}]" for i in range(size))
            columns[name] = Columns(layout.unit(name), labels.get(kind, own))
    return columns


def _names(facts: Mapping[str, Any], key: str, count: int) -> tuple[str, ...]:
    names = tuple(facts.get(key, (f"{key.removesuffix('_names')}[{i}]" for i in range(count))))
    if len(names) != count:
        raise ValueError(f"{key} must name {count} columns, not {len(names)}: {names}")
    return names

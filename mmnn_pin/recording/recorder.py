"""Takes the rows of one run as they come and ends as a `Recording`, in memory or in a file.

Rows gather in a buffer and go to the file when it is full or old enough that a kill loses less than half a second: a
run that ends before is written at once.
"""

from __future__ import annotations

import hashlib
import math
import time
from collections.abc import Callable, Collection, Mapping
from dataclasses import asdict
from datetime import UTC, datetime
from pathlib import Path
from types import TracebackType
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..errors import ConfigError, RecordingError, UnknownName
from ..settings.arguments import shortly
from ..signals import SIGNALS, Array, Layout
from .recording import Outcome, Recording, from_file
from .run_file import Arrays, RunFile, SignalColumns, decode, encode
from .schema import facts_problem, labels_of
from .versions import versions

BUFFER_BYTES = 1 << 22  # from this size on numpy asks for large pages, which are faster to get
FIRST_WRITE, WRITE_PERIOD = 0.45, 0.25  # since the start, and between two others [s] of wall clock


class Recorder:
    """Writes one run.

    Use it in a `with` block: an exception closes the file, whose recording then reads as incomplete.

    Args:
        layout: Where the signals stand in a row.
        meta: About the run: `robot`, `controller`, `seed`; the texts `config` and `urdf`; `velocity_names` (p),
            `position_names` (nv) and `actuator_names` for the columns' labels; anything else that JSON can hold.
        path: File to write; None keeps everything in memory.
        force: Replace an existing file.
        signals: Names of the signals to keep beside `time`; None for all.
        expected: How many rows will come, 0 where that is not known; others may.

    Raises:
        RecordingError: The file exists (without `force`), another run writes it, or it cannot be created.
        UnknownName: A signal that does not exist.
        ConfigError: A fact of a wrong type.
    """

    def __init__(
        self,
        layout: Layout,
        meta: Mapping[str, Any],
        path: str | Path | None = None,
        force: bool = False,
        signals: Collection[str] | None = None,
        expected: int = 0,
    ) -> None:
        facts = _facts(meta)
        texts: dict[str, str] = {name: facts.pop(name) for name in ("config", "urdf") if name in facts}
        columns = _columns(layout, facts)
        if signals is not None:
            columns = {name: about for name, about in columns.items() if name in ("time", *known(signals))}
        self._about: dict[str, Any] = {"columns": columns, "meta": facts, "texts": texts}
        self._store: RunFile | _Memory = (
            _Memory(layout, columns)
            if path is None
            else RunFile(Path(path), force, layout, columns, facts, texts, expected)
        )
        self._width, self._size = layout.width, buffer_rows(layout)
        self._due = math.inf if path is None else time.perf_counter() + FIRST_WRITE
        self._filled, self.rows = 0, 0
        self._rows, self._step_times = self._buffers()
        self._weight_shapes: dict[str, tuple[int, ...]] = {}
        self._snapshots: list[Arrays] = []

    def append(self, row: Array, step_time: float = 0.0) -> None:
        """Add one row, shape (width,), which is copied; `step_time` is the wall-clock time it took [s].

        Raises:
            RecordingError: The file cannot be written; the rows already in it can be read.
        """
        if row.shape != (self._width,):
            raise ValueError(f"a row has shape {(self._width,)}, not {row.shape}")
        self._rows[self._filled] = row
        self._step_times[self._filled] = step_time
        self._filled, self.rows = self._filled + 1, self.rows + 1
        self._write_when_due()

    def append_block(self, rows: Array, step_times: ArrayLike = 0.0) -> None:
        """Add rows, shape (k, width), which are copied; `step_times` (k,) or one for all [s].

        Raises:
            RecordingError: The file cannot be written; the rows already in it can be read.
        """
        if rows.ndim != 2 or rows.shape[1] != self._width:
            raise ValueError(f"rows have shape (k, {self._width}), not {rows.shape}")
        times = np.broadcast_to(np.asarray(step_times, float), len(rows))
        done = 0
        while done < len(rows):
            count = min(len(rows) - done, self._size - self._filled)
            end = self._filled + count
            self._rows[self._filled : end] = rows[done : done + count]
            self._step_times[self._filled : end] = times[done : done + count]
            self._filled, self.rows, done = end, self.rows + count, done + count
            self._write_when_due()

    def weights(self, time: float, arrays: Mapping[str, ArrayLike]) -> None:
        """Keep a snapshot of the networks' weights at a time [s]: the same names and shapes every time.

        Snapshots go to the file when the next rows do, one by one they would cost more than the run.

        Raises:
            RecordingError: The file cannot be written; the rows already in it can be read.
        """
        snapshot: Arrays = {"time": np.array(time, float)} | {name: np.array(a) for name, a in arrays.items()}
        shapes = {name: array.shape for name, array in snapshot.items()}
        if self._weight_shapes not in ({}, shapes):
            raise ValueError(f"the weights had the shapes {self._weight_shapes}, now {shapes}")
        self._weight_shapes = shapes
        self._snapshots.append(snapshot)
        self._write_when_due()

    def finish(self, outcome: Outcome, final_state: Mapping[str, ArrayLike] | None = None) -> Recording:
        """Write what is left, the outcome and the final state, and close the file.

        Raises:
            RecordingError: The file cannot be written; the rows already in it can be read.
        """
        self._hand_over()
        final: Arrays = {name: np.array(array) for name, array in (final_state or {}).items()}
        if isinstance(self._store, _Memory):
            return Recording(**self._about, rows=self.rows, read=self._store.finish(final), outcome=outcome)
        self._store.finish(asdict(outcome), final)
        path = self._store.path
        return Recording(**self._about, rows=self.rows, read=from_file(path, self.rows), outcome=outcome, path=path)

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
        if self._filled == self._size or time.perf_counter() > self._due:
            self._write()

    def _write(self) -> None:
        self._hand_over()
        if isinstance(self._store, RunFile):
            self._store.flush()
            self._due = time.perf_counter() + WRITE_PERIOD

    def _hand_over(self) -> None:
        if not self._store.is_open:
            raise RecordingError("this run is finished", why="its file is closed")
        if self._snapshots:
            self._store.weights({name: np.stack([s[name] for s in self._snapshots]) for name in self._weight_shapes})
            self._snapshots = []
        if self._filled:
            self._store.write(self._rows[: self._filled], self._step_times[: self._filled])
            if isinstance(self._store, _Memory):  # it keeps these
                self._rows, self._step_times = self._buffers()
        self._filled = 0

    def _buffers(self) -> tuple[Array, Array]:
        return np.empty((self._size, self._width)), np.empty(self._size)


class _Memory:
    """Keeps a run as a list of blocks; signals are taken out of them when they are asked for."""

    def __init__(self, layout: Layout, columns: Mapping[str, SignalColumns]) -> None:
        self.columns = columns
        self.kept = np.concatenate([np.arange(layout.width)[layout.where(name)] for name in columns])
        self.ends = np.cumsum([len(about.labels) for about in columns.values()])
        self.blocks, self.step_times = [np.empty((0, self.kept.size))], [np.empty(0)]
        self.snapshots: dict[str, list[NDArray[Any]]] = {}  # several at a time
        self.is_open = True

    def write(self, rows: Array, step_times: Array) -> None:
        whole = self.kept.size == rows.shape[1] and 2 * rows.nbytes > BUFFER_BYTES  # else a small part of its buffer
        self.blocks.append(rows if whole else rows[:, self.kept])
        self.step_times.append(step_times)

    def weights(self, snapshots: Arrays) -> None:
        for name, array in snapshots.items():
            self.snapshots.setdefault(name, []).append(array)

    def finish(self, final: Arrays) -> Callable[[str], Arrays]:
        self.close()
        parts: dict[str, Arrays] = {"timing/step_time": {"step_time": np.concatenate(self.step_times)}, "final": final}
        parts["weights"] = {name: np.concatenate(arrays) for name, arrays in self.snapshots.items()}
        return lambda where: parts[where] if where in parts else self._signal(where.removeprefix("signals/"))

    def close(self) -> None:
        self.is_open = False

    def _signal(self, name: str) -> Arrays:
        end, size = self.ends[list(self.columns).index(name)], len(self.columns[name].labels)
        columns = np.concatenate([rows[:, end - size : end] for rows in self.blocks])
        return {name: columns[:, 0] if size == 1 else columns}


def buffer_rows(layout: Layout) -> int:
    """How many rows a recorder gathers at most before it hands them over."""
    return max(1024, -(-BUFFER_BYTES // (8 * layout.width)))


def _facts(meta: Mapping[str, Any]) -> dict[str, Any]:
    """Facts of the run, with when it was made and by which versions; as they will read back."""
    facts = {"created": datetime.now(UTC).isoformat(timespec="seconds"), "versions": dict(versions()), **meta}
    if "urdf" in facts:
        facts.setdefault("urdf_sha256", hashlib.sha256(facts["urdf"].encode()).hexdigest())
    facts = {name: as_it_reads(name, value) for name, value in facts.items()}
    if problem := facts_problem(facts):
        key, what, fix = problem
        raise ConfigError(what, fix=fix, key=f"meta.{key}")
    return facts


def as_it_reads(name: str, value: Any) -> Any:
    """A fact as the file of a recording gives it back.

    Raises:
        ConfigError: No file can hold it.
    """
    try:
        return decode(encode(value))
    except (TypeError, ValueError, RecursionError) as error:
        what, fix = f"{shortly(value)} cannot be recorded", "give texts, numbers, lists and tables of them"
        raise ConfigError(what, fix=fix, key=f"meta.{name}") from error


def _columns(layout: Layout, facts: Mapping[str, Any]) -> dict[str, SignalColumns]:
    """Unit and labels of every signal that this robot has."""
    counts = {"velocity_names": layout.dof, "position_names": layout.full, "actuator_names": layout.motors}
    named = {**facts, **{key: _names(facts, key, count) for key, count in counts.items()}}
    sizes = {name: layout.where(name).stop - layout.where(name).start for name, *_ in SIGNALS}
    return {name: SignalColumns(layout.unit(name), labels_of(name, n, named)) for name, n in sizes.items() if n}


def known(signals: Collection[str]) -> Collection[str]:
    """Names of signals that exist, on some robot.

    Raises:
        UnknownName: One does not.
    """
    names = [name for name, *_ in SIGNALS]
    for name in signals:
        if name not in names:
            raise UnknownName("signal", name, names, key="signals")
    return signals


def _names(facts: Mapping[str, Any], key: str, count: int) -> tuple[str, ...]:
    names = tuple(facts.get(key, (f"{key.removesuffix('_names')}[{i}]" for i in range(count))))
    if len(names) != count:
        raise ValueError(f"{key} must name {count} columns, not {len(names)}: {names}")
    return names

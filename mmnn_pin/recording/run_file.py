"""The HDF5 file of one run: written as it happens, readable whatever ends the run.

    /                   attributes: format, complete, outcome, robot, controller, seed, versions, created, ...
    /config, /urdf      texts
    /signals/<name>     (N, size), or (N,) for scalars; attributes `unit` and `labels` (one per column)
    /weights/<name>     (k, ...) snapshots of the networks' weights, taken at /weights/time (k,) [s]
    /final/<name>       the states at the end: position, nu, controller_state, hardware_state
    /timing/step_time   (N,) wall-clock seconds per step: the one dataset that two equal runs do not share

The file is in HDF5's default format; what was flushed a kill leaves readable. It lies on the disk from the start,
without rows; HDF5 opens it for the first of them, which for most runs are all. Before it grows its space is reserved,
so a full disk is found before HDF5 is half way through a write. What all runs of a robot share, the tables with their
units and labels, is made once.
"""

from __future__ import annotations

import errno
import fcntl
import json
import os
import re
import sys
from collections.abc import Iterator, Mapping
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass
from functools import cached_property, lru_cache
from itertools import count
from pathlib import Path
from typing import Any

import h5py
import numpy as np
from numpy.typing import NDArray

from ..errors import RecordingError
from ..files import ELSEWHERE, folders_for, opened, reason, settle, way_out
from ..signals import Array, Layout

FORMAT = "mmnn_pin recording"
FORMAT_VERSION = 1
CHUNK_ROWS, MOST_CHUNK_ROWS = 1024, 8192  # of tables whose length is not known; at most
SLACK_BYTES = 1 << 16  # what HDF5 keeps beside the numbers themselves
HEAP, SMALLEST_HEAP = b"GCOL\x01", 4096  # where a heap of texts begins; bytes
PIECE = 1 << 24  # bytes of a file that are searched at a time

ALL = h5py.h5s.ALL
NUMBERS = count()

Arrays = dict[str, NDArray[Any]]


@dataclass(frozen=True)
class SignalColumns:
    """The columns of one signal: their unit and one label each."""

    unit: str
    labels: tuple[str, ...]


@dataclass(frozen=True)
class Places:
    """Where signals stand in a row that holds them side by side; a `Layout` is one, too."""

    width: int  # of a row
    slices: Mapping[str, slice]  # signal to its place

    @classmethod
    def of(cls, sizes: Mapping[str, int]) -> Places:
        """Of signals with these sizes, in this order."""
        ends = np.cumsum(list(sizes.values()))
        starts = (ends - list(sizes.values())).tolist()
        return cls(int(ends[-1]), {n: slice(a, int(b)) for n, a, b in zip(sizes, starts, ends, strict=True)})

    def where(self, signal: str) -> slice:
        """Place of a signal."""
        return self.slices[signal]


class RunFile:
    """A file that is being written.

    Args:
        path: Where it goes; missing folders are made.
        force: Replace an existing file.
        layout: Where the signals stand in a row.
        columns: Unit and labels of the signals to write.
        meta: Facts for the root's attributes.
        texts: Texts for the root's datasets.
        expected: How many rows will come, 0 where that is not known; others may.

    Raises:
        RecordingError: The file exists (without `force`), another run writes it, or it cannot be created.
    """

    def __init__(
        self,
        path: Path,
        force: bool,
        layout: Layout | Places,
        columns: Mapping[str, SignalColumns],
        meta: Mapping[str, Any],
        texts: Mapping[str, str],
        expected: int = 0,
    ) -> None:
        self.path, self.rows, self.is_open = path, 0, True
        self._before = path.with_name(f".{path.name}.before") if force else None
        self._chunk_rows, self._row_bytes = _chunk_rows(expected), 8 * (layout.width + 1)
        self._row = _row_of({name: layout.where(name) for name in columns}, layout.width)
        self._flushed, self._weights = 0, dict[str, h5py.h5d.DatasetID]()
        with _in_memory(_empty(tuple(columns.items()), self._chunk_rows)) as file:
            _write_facts(file, meta, texts)
            self._lock = _create(path, self._before, _image(file))

    @cached_property
    def _file(self) -> h5py.File:
        """The file, open."""
        return h5py.File(self.path, "r+", locking=False)  # it is locked already

    @cached_property
    def _tables(self) -> dict[str, h5py.h5d.DatasetID]:
        """Tables of the signals."""
        signals = h5py.h5g.open(self._file.id, b"signals")
        return {name: h5py.h5d.open(signals, name.encode()) for name in self._row.names or ()}

    @cached_property
    def _step_times(self) -> h5py.h5d.DatasetID:
        """Table of the step times."""
        return h5py.h5d.open(self._file.id, b"timing/step_time")

    def write(self, rows: Array, step_times: Array) -> None:
        """Add rows (k, width) and the wall-clock times (k,) they took [s].

        Raises:
            RecordingError: The disk is full or gone; the file is closed and holds the rows of the last flush.
        """
        if not len(rows):
            return
        chunks = -(-(self.rows + len(rows)) // self._chunk_rows) - -(-self.rows // self._chunk_rows)
        signals = np.ascontiguousarray(rows).view(self._row)[:, 0]  # numpy copies a signal's numbers of a row at once
        with self._closing_on_failure():
            self._reserve(chunks * self._chunk_rows * self._row_bytes)
            for name, table in self._tables.items():
                _extend(table, signals[name].copy().view(float).reshape(len(rows), -1), self.rows, self._chunk_rows)
            _extend(self._step_times, step_times, self.rows, self._chunk_rows)
        self.rows += len(rows)

    def flush(self) -> None:
        """Put on the disk what was written.

        Raises:
            RecordingError: As for `write`.
        """
        with self._closing_on_failure():
            self._file.flush()
        self._flushed = self.rows

    def weights(self, snapshots: Mapping[str, NDArray[Any]]) -> None:
        """Add snapshots of the weights, (k, ...) each.

        Raises:
            RecordingError: As for `write`.
        """
        with self._closing_on_failure():
            self._reserve(sum(max(array.nbytes, 8192) for array in snapshots.values()))
            group = self._file.require_group("weights").id
            for name, array in snapshots.items():
                rows = max(1, 8192 // max(array[0].nbytes, 1))
                if name not in self._weights:
                    self._weights[name] = _table(group, name, array.shape[1:], rows, array.dtype)
                _extend(self._weights[name], array, self._weights[name].shape[0], rows)

    def finish(self, outcome: Mapping[str, Any], final: Mapping[str, NDArray[Any]]) -> None:
        """Write how the run ended, mark the file complete and close it.

        Raises:
            RecordingError: As for `write`.
        """
        with self._closing_on_failure():
            self._reserve(sum(array.nbytes for array in final.values()))
            group = self._file.require_group("final").id if final else None
            for name, array in final.items():
                _dataset(group, name, array)
            root = h5py.h5g.open(self._file.id, b"/")
            _attribute(root, "outcome", outcome["status"])
            for field in ("time", "signal", "message"):
                _attribute(root, f"outcome_{field}", encode(outcome[field]))
            self._file.flush()
            h5py.h5a.open(root, b"complete").write(np.array(True))
            self.close()
        if self._before is not None:
            self._before.unlink(missing_ok=True)

    def close(self) -> None:
        """Close the file as it is; unless `finish` came before, it reads as incomplete."""
        self.is_open = False
        try:
            if "_file" in vars(self):
                self._file.close()
        finally:
            os.close(self._lock)

    def _reserve(self, size: int) -> None:
        """Take room on the disk for what HDF5 is about to add; the file must still be where it was made."""
        if not os.path.samestat(os.stat(self.path), os.fstat(self._lock)):
            raise FileNotFoundError(errno.ENOENT, "another file has its name")
        if size and sys.platform == "linux":
            os.posix_fallocate(self._lock, os.fstat(self._lock).st_size, size + SLACK_BYTES)

    @contextmanager
    def _closing_on_failure(self) -> Iterator[None]:
        """Close the file where it cannot be written."""
        try:
            yield
        except (OSError, RuntimeError) as error:
            with suppress(OSError, RuntimeError):
                self.close()
            fix = f"make room on the disk; the first {self.rows:,} rows can be read"
            if self._before is not None and self._before.exists():
                with suppress(OSError):
                    os.replace(self._before, self.path)
                    fix = "make room on the disk; the recording that was to be replaced is back"
            elif isinstance(error, FileNotFoundError):
                fix = "leave its folder where it is until the run is over"
            raise RecordingError("cannot write the recording", why=reason(error), fix=fix, file=self.path) from error


def encode(value: Any) -> Any:
    """Value as an HDF5 attribute: texts, numbers and lists of texts as they are, the rest as JSON."""
    value = value.item() if isinstance(value, np.generic) else value
    if isinstance(value, bool | int | float) or (isinstance(value, str) and not value.startswith("json:")):
        return value
    if isinstance(value, list | tuple) and value and all(isinstance(item, str) for item in value):
        return np.array(value, dtype=h5py.string_dtype())
    return f"json:{json.dumps(value, default=lambda array: np.asarray(array).tolist())}"


def decode(value: Any) -> Any:
    """Inverse of `encode`; lists of texts come back as tuples."""
    if isinstance(value, np.ndarray):
        return tuple(map(str, value))
    if isinstance(value, np.generic):
        return value.item()
    return json.loads(value[5:]) if isinstance(value, str) and value.startswith("json:") else value


def endless_heap(path: Path) -> bool:
    """Whether HDF5 would go round for ever in a heap of texts, or heaps say that they take more than the file has.

    A heap has a head of 16 bytes, its size in the last 8, and objects one after the other, each with its number in the
    first 2 of 16 bytes and its size in the last 8; of number 0, the free room, the size counts the 16 bytes (HDF5 File
    Format Specification, III.E). HDF5 does not leave an object that takes no room.

    A file is looked at again when it has changed.

    Raises:
        OSError: The file cannot be read.
    """
    now = path.stat()
    return endless_in(path, now.st_ino, now.st_mtime_ns, now.st_size)


@lru_cache(maxsize=256)
def endless_in(path: Path, inode: int, changed: int, size: int) -> bool:
    """See `endless_heap`; of a file as it was when it last changed."""
    start, left = 0, size + PIECE  # what bounds the work: heaps do not overlap
    with opened(path) as file:
        while piece := os.pread(file.fileno(), PIECE, start):
            for found in re.finditer(HEAP, piece):
                place = start + found.start()
                size = int.from_bytes(os.pread(file.fileno(), 16, place)[8:], "little")
                heap = os.pread(file.fileno(), min(size, PIECE), place)
                left -= max(len(heap), SMALLEST_HEAP)
                if left < 0 or stands_still(heap):
                    return True
            start += PIECE - len(HEAP) + 1
    return False


def stands_still(heap: bytes) -> bool:
    """Whether an object of a heap takes no room, in the arithmetic of 64 bits that HDF5 does."""
    place = 16
    while place + 16 <= len(heap):
        number = int.from_bytes(heap[place : place + 2], "little")
        size = int.from_bytes(heap[place + 8 : place + 16], "little")
        taken = (16 + (size + 7) // 8 * 8 if number else size) % 2**64
        if taken == 0:
            return True
        place += taken
    return False


def _create(path: Path, before: Path | None, image: bytes) -> int:
    """Make the file, whole or not at all; its open and locked descriptor.

    What is replaced stays under the name `before` until its successor is complete, but does not take the place of a
    complete recording there, which a killed run left; None replaces nothing.
    """
    try:
        with ExitStack() as undo:
            _require_free(path, before is not None)
            part = path.with_name(f".{path.name}.{os.getpid()}.part")
            undo.enter_context(folders_for(path))
            undo.callback(part.unlink, missing_ok=True)
            lock = _write_locked(part, image)
            undo.callback(os.close, lock)
            if before is not None and path.exists() and (not before.exists() or _is_complete(path)):
                with suppress(OSError):  # a file system without links
                    before.unlink(missing_ok=True)
                    os.link(path, before)
                    undo.callback(before.unlink, missing_ok=True)
            settle(part, path, "recording", before is not None, sync=False)
            part.unlink(missing_ok=True)
            undo.pop_all()
    except (OSError, RuntimeError) as error:
        raise RecordingError(
            "cannot create the recording", why=reason(error), fix=way_out(error) or ELSEWHERE, file=path
        ) from error
    return lock


def _write_locked(path: Path, data: bytes) -> int:
    """Write a file, not by HDF5, which does not survive a full disk; its descriptor, locked while it is open."""
    path.unlink(missing_ok=True)
    descriptor = os.open(path, os.O_RDWR | os.O_CREAT | os.O_EXCL, 0o666)
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        with open(descriptor, "wb", closefd=False) as file:
            file.write(data)
    except BaseException:
        os.close(descriptor)
        raise
    return descriptor


def _chunk_rows(expected: int) -> int:
    """Rows of a chunk: a table of the expected length is one chunk, or some equal ones."""
    return -(-expected // -(-expected // MOST_CHUNK_ROWS)) if expected > 0 else CHUNK_ROWS


@lru_cache(maxsize=16)
def _empty(columns: tuple[tuple[str, SignalColumns], ...], chunk_rows: int) -> bytes:
    """Image of a file with the empty tables of some signals, and nothing else."""
    with _in_memory() as file:
        file.attrs["format"], file.attrs["format_version"], file.attrs["complete"] = FORMAT, FORMAT_VERSION, False
        signals, timing = (file.create_group(name).id for name in ("signals", "timing"))
        for name, about in columns:
            size = len(about.labels)
            table = _table(signals, name, (size,) if size > 1 else (), chunk_rows)
            _attribute(table, "unit", about.unit)
            _attribute(table, "labels", encode(about.labels))
        _attribute(_table(timing, "step_time", (), chunk_rows), "unit", "s")
        return _image(file)


def _in_memory(image: bytes = b"") -> h5py.File:
    """A file in memory that begins as an image."""
    access = h5py.h5p.create(h5py.h5p.FILE_ACCESS)
    access.set_fapl_core(SLACK_BYTES, False)
    # HDF5 takes two open files of one name for the same, and one on the disk for this one: none can have that name
    name = f"{os.devnull}/recording {next(NUMBERS)}".encode()
    if not image:
        return h5py.File(h5py.h5f.create(name, h5py.h5f.ACC_TRUNC, fapl=access))
    access.set_file_image(image)
    return h5py.File(h5py.h5f.open(name, h5py.h5f.ACC_RDWR, fapl=access))


def _image(file: h5py.File) -> bytes:
    """The bytes of a file in memory."""
    file.flush()
    return bytes(file.id.get_file_image())


def _is_complete(path: Path) -> bool:
    """Whether there is a recording whose run closed it."""
    try:
        if endless_heap(path):
            return False
        with h5py.File(path, "r", locking=False) as file:
            return file.attrs["format"] == FORMAT and bool(file.attrs["complete"])
    except Exception:  # whatever HDF5 raises of another file
        return False


def _require_free(path: Path, force: bool) -> None:
    if not path.exists():
        return
    if path.is_dir():
        raise RecordingError("cannot create the recording", why="there is a folder of that name", file=path)
    if not force:
        fix = "choose another name, or replace it with --force (force=True)"
        raise RecordingError("the file exists", why="a recording is not overwritten unasked", fix=fix, file=path)
    try:
        with opened(path) as old:
            fcntl.flock(old, fcntl.LOCK_SH | fcntl.LOCK_NB)
    except BlockingIOError as error:
        why = "another run is writing it"
        raise RecordingError("the file is in use", why=why, fix="choose another name", file=path) from error
    except OSError as error:
        raise RecordingError("it cannot be replaced", why=reason(error), fix=ELSEWHERE, file=path) from error


def _write_facts(file: h5py.File, meta: Mapping[str, Any], texts: Mapping[str, str]) -> None:
    root = h5py.h5g.open(file.id, b"/")
    for name, value in meta.items():
        _attribute(root, name, encode(value))
    for name, text in texts.items():
        _dataset(root, name, np.asarray(text, dtype=h5py.string_dtype()))


def _dataset(group: h5py.h5g.GroupID, name: str, array: NDArray[Any]) -> None:
    """A dataset that does not grow."""
    kind = h5py.h5t.py_create(array.dtype, logical=True)
    h5py.h5d.create(group, name.encode(), kind, _space(array.shape)).write(ALL, ALL, array)


def _attribute(place: h5py.h5g.GroupID | h5py.h5d.DatasetID, name: str, value: Any) -> None:
    """An attribute as h5py writes it, in half the time."""
    array = np.asarray(value, dtype=h5py.string_dtype() if isinstance(value, str) else None)
    kind = h5py.h5t.py_create(array.dtype, logical=True)
    h5py.h5a.create(place, name.encode(), kind, _space(array.shape)).write(array)


def _space(shape: tuple[int, ...]) -> h5py.h5s.SpaceID:
    return h5py.h5s.create_simple(shape) if shape else h5py.h5s.create(h5py.h5s.SCALAR)


def _table(
    group: h5py.h5g.GroupID, name: str, shape: tuple[int, ...], rows: int, dtype: Any = np.float64
) -> h5py.h5d.DatasetID:
    """Dataset without rows yet, each of a shape, that grows by chunks of so many rows."""
    chunks = h5py.h5p.create(h5py.h5p.DATASET_CREATE)
    chunks.set_chunk((rows, *shape))
    space = h5py.h5s.create_simple((0, *shape), (h5py.h5s.UNLIMITED, *shape))
    return h5py.h5d.create(group, name.encode(), h5py.h5t.py_create(np.dtype(dtype), logical=True), space, dcpl=chunks)


def _row_of(places: Mapping[str, slice], width: int) -> np.dtype[np.void]:
    """A row of so many numbers as one record, each signal's part of it in one piece."""
    formats = [f"V{8 * (place.stop - place.start)}" for place in places.values()]
    offsets = [8 * place.start for place in places.values()]
    return np.dtype({"names": [*places], "formats": formats, "offsets": offsets, "itemsize": 8 * width})


def _extend(table: h5py.h5d.DatasetID, rows: NDArray[Any], start: int, chunk_rows: int) -> None:
    """Append rows to a table; one whole chunk goes past HDF5's cache of chunks."""
    shape = (start + len(rows), *table.shape[1:])
    rows = np.ascontiguousarray(rows.reshape(len(rows), *shape[1:]))
    table.set_extent(shape)
    if not start and len(rows) == chunk_rows:
        table.write_direct_chunk((0,) * rows.ndim, rows)
        return
    target = h5py.h5s.create_simple(shape)
    target.select_hyperslab((start, *(0,) * (rows.ndim - 1)), rows.shape)
    table.write(h5py.h5s.create_simple(rows.shape), target, rows)

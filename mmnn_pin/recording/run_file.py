"""The HDF5 file of one run: written as it happens, readable whatever ends the run.

    /                   attributes: format, complete, outcome, robot, controller, seed, versions, created, ...
    /config, /urdf      texts
    /signals/<name>     (N, size), or (N,) for scalars; attributes `unit` and `labels` (one per column)
    /weights/<name>     (k, ...) snapshots of the networks' weights, taken at /weights/time (k,) [s]
    /final/<name>       the states at the end: position, nu, controller_state, hardware_state
    /timing/step_time   (N,) wall-clock seconds per step: the one dataset that two equal runs do not share

The file is in HDF5's default format and flushed with every write: that is what a kill leaves readable. Before the
file grows its space is reserved, so a full disk is found before HDF5 is half way through a write.
"""

from __future__ import annotations

import errno
import fcntl
import json
import os
import sys
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import h5py
import numpy as np
from numpy.typing import NDArray

from ..errors import RecordingError
from ..files import folders_for, reason, settle, way_out
from ..signals import Array, Layout

FORMAT = "mmnn_pin recording"
FORMAT_VERSION = 1
CHUNK_ROWS = 1024
SLACK_BYTES = 1 << 16  # what HDF5 keeps beside the numbers themselves

Arrays = dict[str, NDArray[Any]]


@dataclass(frozen=True)
class Columns:
    """The columns of one signal: their unit and one label each."""

    unit: str
    labels: tuple[str, ...]


@dataclass(frozen=True)
class Places:
    """Where signals stand in a row that holds them side by side; a `Layout` is one, too.

    Attributes:
        width: Of a row.
        slices: Signal to its place.
    """

    width: int
    slices: Mapping[str, slice]

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

    Raises:
        RecordingError: The file exists (without `force`), another run writes it, or it cannot be created.
    """

    def __init__(
        self,
        path: Path,
        force: bool,
        layout: Layout | Places,
        columns: Mapping[str, Columns],
        meta: Mapping[str, Any],
        texts: Mapping[str, str],
    ) -> None:
        self.path, self.rows, self.is_open = path, 0, True
        self._before = path.with_name(f".{path.name}.before") if force else None
        self._file = _create(path, self._before, lambda file: _write_header(file, columns, meta, texts))
        self._tables = [(self._file[f"signals/{name}"], layout.where(name)) for name in columns]
        self._weights: dict[str, h5py.Dataset] = {}
        self._row_bytes = 8 * (layout.width + 1)

    def write(self, rows: Array, step_times: Array) -> None:
        """Add rows (k, width) and the wall-clock times (k,) they took [s], and flush.

        Raises:
            RecordingError: The disk is full or gone; the file is closed and holds the rows before these.
        """
        chunks = -(-(self.rows + len(rows)) // CHUNK_ROWS) - -(-self.rows // CHUNK_ROWS)
        with self._closing_on_failure():
            self._reserve(chunks * CHUNK_ROWS * self._row_bytes)
            for table, where in self._tables:
                _extend(table, rows, where, self.rows)
            _extend(self._file["timing/step_time"], step_times[:, None], slice(0, 1), self.rows)
            self._file.flush()
        self.rows += len(rows)

    def weights(self, snapshots: Mapping[str, NDArray[Any]]) -> None:
        """Add snapshots of the weights, (k, ...) each.

        Raises:
            RecordingError: As for `write`.
        """
        with self._closing_on_failure():
            self._reserve(sum(max(array.nbytes, 8192) for array in snapshots.values()))
            for name, array in snapshots.items():
                if name not in self._weights:
                    rows = max(1, 8192 // max(array[0].nbytes, 1))
                    self._weights[name] = _table(self._file, f"weights/{name}", array.shape[1:], rows, array.dtype)
                table = self._weights[name]
                table.resize(len(table) + len(array), axis=0)
                table[-len(array) :] = array

    def finish(self, outcome: Mapping[str, Any], final: Mapping[str, NDArray[Any]]) -> None:
        """Write how the run ended, mark the file complete and close it.

        Raises:
            RecordingError: As for `write`.
        """
        with self._closing_on_failure():
            self._reserve(sum(array.nbytes for array in final.values()))
            for name, array in final.items():
                self._file[f"final/{name}"] = array
            self._file.attrs["outcome"] = outcome["status"]
            for field in ("time", "signal", "message"):
                self._file.attrs[f"outcome_{field}"] = outcome[field]
            self._file.flush()
            self._file.attrs["complete"] = True
            self.close()
        if self._before is not None:
            self._before.unlink(missing_ok=True)

    def close(self) -> None:
        """Close the file as it is; unless `finish` came before, it reads as incomplete."""
        self.is_open = False
        self._file.close()

    def _reserve(self, size: int) -> None:
        """Take room on the disk for what HDF5 is about to add; the file must still be where it was made."""
        handle = self._file.id.get_vfd_handle()
        if not os.path.samestat(os.stat(self.path), os.fstat(handle)):
            raise FileNotFoundError(errno.ENOENT, "another file has its name")
        if size and sys.platform == "linux":
            os.posix_fallocate(handle, self._file.id.get_filesize(), size + SLACK_BYTES)

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


def _create(path: Path, before: Path | None, fill: Callable[[h5py.File], None]) -> h5py.File:
    """Make the file, whole or not at all.

    A complete recording that is replaced stays under the name `before` until its successor is complete; None replaces
    nothing.
    """
    try:
        with ExitStack() as undo:
            _require_free(path, before is not None)
            part = path.with_name(f".{path.name}.{os.getpid()}.part")
            undo.enter_context(folders_for(path))
            undo.callback(part.unlink, missing_ok=True)
            part.write_bytes(_header(fill))  # not by HDF5, which does not survive a full disk
            file = h5py.File(part, "r+", locking=True)
            undo.callback(file.close)
            if before is not None and _is_complete(path):
                with suppress(OSError):  # a file system without links
                    before.unlink(missing_ok=True)
                    os.link(path, before)
                    undo.callback(before.unlink, missing_ok=True)
            settle(part, path, "recording", before is not None)
            part.unlink(missing_ok=True)
            undo.pop_all()
    except (OSError, RuntimeError) as error:
        raise RecordingError("cannot create the recording", why=reason(error), fix=way_out(error), file=path) from error
    return file


def _header(fill: Callable[[h5py.File], None]) -> bytes:
    """The file before its first row."""
    with h5py.File("header", "w", driver="core", backing_store=False) as file:
        fill(file)
        file.flush()
        return bytes(file.id.get_file_image())


def _is_complete(path: Path) -> bool:
    """Whether there is a recording whose run closed it."""
    try:
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
    with open(path, "rb") as old:
        try:
            fcntl.flock(old, fcntl.LOCK_SH | fcntl.LOCK_NB)
        except BlockingIOError as error:
            why = "another run is writing it"
            raise RecordingError("the file is in use", why=why, fix="choose another name", file=path) from error


def _write_header(
    file: h5py.File, columns: Mapping[str, Columns], meta: Mapping[str, Any], texts: Mapping[str, str]
) -> None:
    file.attrs["format"], file.attrs["format_version"], file.attrs["complete"] = FORMAT, FORMAT_VERSION, False
    for name, value in meta.items():
        file.attrs[name] = encode(value)
    for name, text in texts.items():
        file.create_dataset(name, data=text, dtype=h5py.string_dtype())
    for name, about in columns.items():
        size = len(about.labels)
        table = _table(file, f"signals/{name}", (size,) if size > 1 else (), CHUNK_ROWS)
        table.attrs["unit"], table.attrs["labels"] = about.unit, list(about.labels)
    _table(file, "timing/step_time", (), CHUNK_ROWS).attrs["unit"] = "s"


def _table(group: h5py.Group, name: str, shape: tuple[int, ...], rows: int, dtype: Any = "f8") -> h5py.Dataset:
    """Dataset without rows yet, each of a shape, that grows by chunks of so many rows."""
    return group.create_dataset(name, (0, *shape), dtype, maxshape=(None, *shape), chunks=(rows, *shape))


def _extend(table: h5py.Dataset, rows: Array, where: slice, start: int) -> None:
    """Append some columns of rows to a table; HDF5 itself gathers them, h5py's slices are several times slower."""
    shape = (start + len(rows), *table.shape[1:])
    table.id.set_extent(shape)
    target = h5py.h5s.create_simple(shape)
    target.select_hyperslab((start, 0)[: len(shape)], (len(rows), *shape[1:]))
    source = h5py.h5s.create_simple(rows.shape)
    source.select_hyperslab((0, where.start), (len(rows), where.stop - where.start))
    table.id.write(source, target, rows)

"""The file of a recording, read as if a stranger had made it: it is held against the schema when it is opened.

Nothing is read before its kind, its type and its size are known. What no recording of this package has refuses the
whole file with one line: links, data kept in other files, filters that are not known, more numbers than such a file can
hold, facts of a wrong type. What a disk can do to one dataset is told (`Contents.damage`); the others can be read.
"""

from __future__ import annotations

import json
import math
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import h5py

from ..errors import RecordingError
from ..files import DENSEST, ROOM, reason
from ..settings.arguments import shortly
from .run_file import FORMAT, FORMAT_VERSION, Arrays, SignalColumns, decode, endless_heap
from .schema import Damaged, facts_problem, require_plain, signal_problem, time_problem

FILTERS = {h5py.h5z.FILTER_DEFLATE, h5py.h5z.FILTER_SHUFFLE, h5py.h5z.FILTER_FLETCHER32, h5py.h5z.FILTER_LZF}
MOST_MEMBERS, MOST_NAMES = 1000, 10_000
END = ("outcome", "outcome_time", "outcome_signal", "outcome_message")
OURS = "name a file that `mmnn run` wrote"
AGAIN = "take it from a copy, or run it again"


@dataclass(frozen=True)
class Contents:
    """The contents of a file beside its numbers."""

    columns: dict[str, SignalColumns]  # units and labels of the signals that can be read
    rows: int  # how many rows all of them have
    meta: dict[str, Any]  # facts of the run
    texts: dict[str, str]  # `config` and `urdf`, where they can be read
    end: dict[str, Any]  # how the run ended, empty where it did not close the file
    damage: dict[str, str]  # what cannot be read, as `signals/z`, and why


def contents(path: Path) -> Contents:
    """Everything but the numbers of a recording, held against the schema.

    Raises:
        RecordingError: No such file, no recording, one by a newer mmnn_pin, or one that breaks the schema as a whole.
    """
    with open_run(path) as file, hdf5_errors(path):
        return Examined(file, path).contents()


@contextmanager
def open_run(path: Path) -> Iterator[h5py.File]:
    """A recording that is open for reading, also while its run is still going on elsewhere.

    Raises:
        RecordingError: No such file, not HDF5, not a recording, or written by a newer mmnn_pin.
    """
    try:
        if not path.is_file():
            raise RecordingError("no such recording", fix=OURS, file=path)
        endless = endless_heap(path)
    except OSError as error:
        raise RecordingError("cannot read the recording", why=reason(error), fix=AGAIN, file=path) from error
    if endless:
        raise RecordingError("cannot read the recording", why="its texts are damaged", fix=AGAIN, file=path)
    try:
        file = h5py.File(path, "r", locking=False)
    except Exception as error:  # whatever a damaged file makes HDF5 raise
        why, fix = (reason(error), AGAIN) if is_hdf5(path) else ("it is not an HDF5 file", OURS)
        raise RecordingError("cannot read the recording", why=why, fix=fix, file=path) from error
    with file:
        with hdf5_errors(path):
            require_ours(file, path)
        yield file


def is_hdf5(path: Path) -> bool:
    """Whether a file begins as HDF5 does."""
    try:
        return bool(h5py.is_hdf5(path))
    except OSError:
        return False


@contextmanager
def hdf5_errors(path: Path, where: str = "the recording") -> Iterator[None]:
    """Raise as a `RecordingError` whatever a damaged file makes HDF5 raise within."""
    try:
        yield
    except RecordingError:
        raise
    except Exception as error:
        raise RecordingError(f"cannot read {where}", why=reason(error), fix=AGAIN, file=path) from error


def require_ours(file: h5py.File, path: Path) -> None:
    """Refuse what is no recording, or one of a newer version (`RecordingError`)."""
    found = {}
    for name in ("format", "format_version", "complete"):
        try:
            found[name] = attribute(file, name) if name in file.attrs else None
        except Damaged as error:
            raise RecordingError(f"its attribute '{name}' cannot be read", why=str(error), file=path) from None
    if found["format"] != FORMAT or not isinstance(found["complete"], bool):
        raise RecordingError("not a recording", why="an HDF5 file, but mmnn_pin did not write it", file=path)
    version = found["format_version"]
    if not isinstance(version, int) or version < 1:
        raise RecordingError(f"its format version is {shortly(version)}", fix=AGAIN, file=path)
    if version > FORMAT_VERSION:
        why = f"its format version is {version}, this mmnn_pin reads up to {FORMAT_VERSION}"
        raise RecordingError("cannot read the recording", why=why, fix="upgrade mmnn_pin", file=path)


def read_arrays(path: Path, where: str, rows: int | None = None) -> Arrays:
    """Arrays of a group, or one dataset, by name; empty if there is none.

    Args:
        path: The recording.
        where: Group or dataset, e.g. `signals/z`.
        rows: Length to read. A kill can leave the datasets of a group at unequal lengths: None reads whole
            arrays and `-1` as many rows as all of them have.

    Raises:
        RecordingError: What is there cannot be read.
    """
    with open_run(path) as file, hdf5_errors(path, where):
        examined = Examined(file, path)
        if "/" in where:
            found = examined.some(where.partition("/")[0], [where.partition("/")[2]])
        else:
            found = examined.tables(where)
        for name, problem in examined.damage.items():
            raise RecordingError(f"{name} is damaged", why=problem, fix=AGAIN, file=path)
        rows = min(map(len, found.values()), default=0) if rows == -1 else rows
        return {name: native(table[()] if rows is None else table[:rows]) for name, table in found.items()}


def native(values: Any) -> Any:
    """Numbers of a file in this machine's order of bytes: compiled code takes no other."""
    return values.astype(values.dtype.newbyteorder("="), copy=False)


def attribute(holder: Any, name: str) -> Any:
    """An attribute of a file or of a dataset, as it was before `encode`.

    Raises:
        Damaged: It is of a kind, a size or an encoding that none of a recording has.
    """
    place = holder.attrs.get_id(name)
    shape, kind, text = place.shape, place.dtype, h5py.check_string_dtype(place.dtype)
    if shape is None or (shape and (text is None or len(shape) > 1 or shape[0] > MOST_NAMES)):
        raise Damaged(f"it has the shape {shape}")
    if (text is None and kind.kind not in "biuf") or kind.itemsize > ROOM:
        raise Damaged(f"it is of the type {kind}")
    try:
        value = decode(holder.attrs[name])
    except (ValueError, RecursionError) as error:  # JSON, or a text that is not UTF-8
        raise Damaged(" ".join(str(error).split())) from None
    require_plain(value)
    return value


@dataclass
class Examined:
    """A file that is held against the schema."""

    file: h5py.File  # the open file
    path: Path  # its name
    damage: dict[str, str] = field(default_factory=dict)  # what was found so far
    declared: int = 0  # bytes of the numbers that it says it holds

    def contents(self) -> Contents:
        """All but the numbers."""
        require_links(self.file, self.path)
        meta = self.facts()
        end = {name.removeprefix("outcome_"): meta.pop(name) for name in END if name in meta}
        complete = bool(self.file.attrs["complete"])
        tables, timing = self.tables("signals"), self.tables("timing")
        if "time" not in tables and "signals/time" not in self.damage:
            raise RecordingError(
                "it has no signals/time", why=self.damage.get("signals", ""), fix=AGAIN, file=self.path
            )
        columns = {name: about for name, table in tables.items() if (about := self.columns_of(name, table, meta))}
        rows = self.rows({f"signals/{n}": tables[n] for n in columns} | {f"timing/{n}": t for n, t in timing.items()})
        if "time" in columns:
            try:
                self.damage |= {"signals/time": problem} if (problem := time_problem(tables["time"][:rows])) else {}
            except OSError as error:
                self.damage["signals/time"] = reason(error)
        columns = {name: about for name, about in columns.items() if f"signals/{name}" not in self.damage}
        for group in ("weights", "final"):
            self.tables(group)
        texts = {name: text for name in ("config", "urdf") if (text := self.text(name)) is not None}
        return Contents(columns, rows, meta, texts, end if complete else {}, self.damage)

    def facts(self) -> dict[str, Any]:
        """The attributes: all of them, since a run without one of its facts would be another run.

        Raises:
            RecordingError: One that cannot be read or is of the wrong type.
        """
        found, names = {}, list(self.file.attrs)
        if len(names) > MOST_MEMBERS:
            raise RecordingError(f"it has {len(names)} attributes", fix=AGAIN, file=self.path)
        for name in names:
            try:
                if not isinstance(name, str):  # h5py gives the bytes of what is not UTF-8
                    raise Damaged("its name is not a text in UTF-8")
                found[name] = attribute(self.file, name)
            except Damaged as error:
                what = f"its attribute {shortly(name)} cannot be read"
                raise RecordingError(what, why=str(error), fix=AGAIN, file=self.path) from None
        kept = {name: value for name, value in found.items() if name not in ("format", "format_version", "complete")}
        if problem := facts_problem(kept):
            name, what, fix = problem
            raise RecordingError(f"its attribute '{name}': {what}", why=fix.replace("give", "expected"), file=self.path)
        if found["complete"]:
            self.require_end(kept)
        return kept

    def require_end(self, meta: Mapping[str, Any]) -> None:
        """Refuse an outcome that none of our runs has (`RecordingError`)."""
        wanted = {
            "outcome": meta.get("outcome") in ("completed", "diverged", "tripped", "interrupted"),
            "outcome_time": isinstance(time := meta.get("outcome_time"), float | int) and math.isfinite(time),
            "outcome_signal": isinstance(meta.get("outcome_signal", ""), str),
            "outcome_message": isinstance(meta.get("outcome_message", ""), str),
        }
        for name, good in wanted.items():
            if not good:
                what = f"its attribute '{name}': {shortly(meta.get(name))}"
                raise RecordingError(what, why="no run ends so", fix=AGAIN, file=self.path)

    def tables(self, group: str) -> dict[str, h5py.Dataset]:
        """The datasets of a group that hold numbers, by name; the others are damage."""
        if group not in self.file:
            return {}
        holder = self.file[group]
        if not isinstance(holder, h5py.Group):
            self.damage[group] = "it is no group of arrays"
            return {}
        require_links(holder, self.path)
        found = self.some(group, list(holder))
        lengths = {len(table) for table in found.values()} if group == "weights" else set()
        if len(lengths) > 1 and self.file.attrs["complete"]:
            self.damage[group] = "its arrays have different lengths"
        elif group == "weights" and "time" in found and self.file.attrs["complete"]:
            try:
                problem = time_problem(found["time"][:].ravel())
            except OSError as error:
                problem = reason(error)
            self.damage |= {group: f"its time: {problem}"} if problem else {}
        return found

    def some(self, group: str, names: Iterable[str]) -> dict[str, h5py.Dataset]:
        """Datasets of a group that hold numbers, by name; the others are damage."""
        found = {}
        for name in names:
            if not isinstance(name, str):  # h5py gives the bytes of what is not UTF-8
                self.damage[f"{group}/{name!r}"] = "its name is not a text in UTF-8"
                continue
            try:
                found[name] = self.table(f"{group}/{name}")
            except Damaged as error:
                self.damage[f"{group}/{name}"] = str(error)
        return found

    def table(self, where: str) -> h5py.Dataset:
        """A dataset of numbers.

        Raises:
            Damaged: It is none, or cannot be read.
            RecordingError: It is none that a recording has; see the top of this module.
        """
        try:
            table = self.file[where]
            if not isinstance(table, h5py.Dataset):
                raise Damaged("it is no array")
            self.require_own(table, where)
            numbers = table.dtype.kind == "f" and table.dtype.itemsize == 8
        except (Damaged, RecordingError):
            raise
        except Exception as error:  # whatever a damaged file makes HDF5 raise
            raise Damaged(reason(error)) from None
        group, _, name = where.partition("/")
        if not numbers and not (group in ("weights", "final") and table.dtype.kind in "iub"):
            raise Damaged(f"its numbers are of the type {table.dtype}")
        flat = table.ndim == 1 or (table.ndim == 2 and table.shape[1] > 1)
        if (group in ("signals", "timing") and not flat) or (group == "weights" and not table.ndim):
            raise Damaged(f"it has the shape {table.shape}")
        if group == "timing" and name != "step_time":
            raise Damaged("no recording has it")
        return table

    def require_own(self, data: h5py.Dataset, where: str) -> None:
        """Refuse a dataset whose numbers are elsewhere, packed in an unknown way, or more than the file can hold.

        Raises:
            RecordingError: With its name.
        """
        plan = data.id.get_create_plist()
        filters = {plan.get_filter(k)[0] for k in range(plan.get_nfilters())}
        problem = ""
        if plan.get_layout() == h5py.h5d.VIRTUAL or plan.get_external_count():
            problem = "its numbers are in another file"
        elif filters - FILTERS:
            problem = f"filter {min(filters - FILTERS)} is unknown"
        if problem:
            raise RecordingError(f"{where} is not read", why=problem, fix="copy its numbers into it", file=self.path)
        cells = max(math.prod(data.shape or ()), math.prod(data.chunks or ()))
        self.declared += cells * data.dtype.itemsize
        held = self.file.id.get_filesize()
        if self.declared > DENSEST * held + ROOM:
            why = f"with it the file says it holds {self.declared / 1e6:,.0f} MB, and has {held / 1e6:,.1f} MB"
            raise RecordingError(f"{where} is not read", why=why, fix=AGAIN, file=self.path)

    def columns_of(self, name: str, table: h5py.Dataset, meta: Mapping[str, Any]) -> SignalColumns | None:
        """Unit and labels of a signal; None where they are not as they must be."""
        try:
            unit, labels = attribute(table, "unit"), attribute(table, "labels")
            if not isinstance(unit, str) or not (isinstance(labels, tuple) and labels):
                raise Damaged("its unit or its labels are no texts")
            about = SignalColumns(unit, labels)
            if problem := signal_problem(name, table.shape[1] if table.ndim == 2 else 1, about, meta):
                raise Damaged(problem)
            return about
        except Damaged as error:
            self.damage[f"signals/{name}"] = str(error)
        except Exception as error:  # whatever a damaged file makes HDF5 raise
            self.damage[f"signals/{name}"] = reason(error)
        return None

    def rows(self, tables: Mapping[str, h5py.Dataset]) -> int:
        """Rows that all tables have; in a file that its run closed they have equally many, others are damage."""
        lengths = {name: len(table) for name, table in tables.items()}
        if not lengths:
            return 0
        if not self.file.attrs["complete"]:  # a kill can come between two tables
            return min(lengths.values())
        rows = Counter(lengths.values()).most_common(1)[0][0]
        wrong = {name: length for name, length in lengths.items() if length != rows}
        self.damage |= {name: f"it has {length:,} rows, the others {rows:,}" for name, length in wrong.items()}
        return rows

    def text(self, name: str) -> str | None:
        """One of the texts; None where there is none, or none that can be read."""
        if name not in self.file:
            return None
        try:
            data = self.file[name]
            if not isinstance(data, h5py.Dataset) or data.shape != () or not h5py.check_string_dtype(data.dtype):
                raise Damaged("it is no text")
            self.require_own(data, name)
            text = str(data.asstr()[()])
            require_plain(text)
            if name == "config":
                with suppress(ValueError):  # a text of a user's own
                    require_plain(json.loads(text))
            return text
        except RecordingError:
            raise
        except Exception as error:  # whatever a damaged file makes HDF5 raise
            self.damage[name] = reason(error)
        return None


def require_links(group: h5py.Group, path: Path) -> None:
    """Refuse members of a group that are only links: their target may be any file (`RecordingError`)."""
    if len(group) > MOST_MEMBERS:
        what = f"{group.name} has {len(group):,} members, a recording at most {MOST_MEMBERS:,}"
        raise RecordingError(what, fix=AGAIN, file=path)
    for name in group:
        raw = name if isinstance(name, bytes) else name.encode(errors="surrogateescape")
        if group.id.links.get_info(raw).type != h5py.h5l.TYPE_HARD:
            where = f"{group.name}/{shortly(name) if isinstance(name, bytes) else name}".lstrip("/")
            what, why = f"{where} is not read", "it is a link, which may lead out of the file"
            raise RecordingError(what, why=why, fix="copy what it leads to into the file", file=path)

"""A study's rows in one SQLite file, each there as soon as its run has finished.

Write-ahead logging: a process that is killed loses no row that was stored, and readers never wait. One process writes,
held off from others by a lock on a file beside the database.
"""

from __future__ import annotations

import contextlib
import json
import math
import os
import sqlite3
import sys
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, fields
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, Literal

import msgspec

from ...errors import StudyError
from ...files import locked
from ...settings.arguments import wrong_type
from .worker import JobResult

FORMAT, FORMAT_VERSION = "mmnn_pin study", 1
NAME = "study.sqlite"
AGAIN = "take the database from a copy, or choose another folder with --out"
ROOM = "free some space; what is stored is kept, and the same command goes on from there"
LONGEST_VALUE = 50_000_000  # bytes of a text in a database: a study's file is far shorter
SCHEMA = f"""
CREATE TABLE meta (key TEXT PRIMARY KEY, value TEXT NOT NULL) WITHOUT ROWID;
CREATE TABLE rows (
    id INTEGER PRIMARY KEY, fingerprint TEXT NOT NULL, point INTEGER NOT NULL, controller TEXT NOT NULL,
    seed INTEGER NOT NULL, parameters TEXT NOT NULL, status TEXT NOT NULL, time REAL NOT NULL, signal TEXT NOT NULL,
    message TEXT NOT NULL, metrics TEXT NOT NULL, seconds REAL NOT NULL, host TEXT NOT NULL, finished TEXT NOT NULL
);
INSERT INTO meta VALUES ('format', '"{FORMAT}"'), ('format_version', '{FORMAT_VERSION}');
"""


@dataclass(frozen=True, kw_only=True)
class Stored(JobResult):
    """A row of the database: the result of a run, and of which run; see `worker.Row`."""

    fingerprint: str
    point: int
    controller: str
    seed: int
    parameters: dict[str, Any]
    finished: str

    @property
    def completed(self) -> bool:
        """Whether the run reached its end."""
        return self.status == "completed"


class Facts(msgspec.Struct, frozen=True):
    """Types of the facts about a study; those that its first session has not written yet are left out."""

    mmnn_pin: str = ""
    versions: dict[str, str] = {}
    plan: str = ""
    rows: int = 0
    name: str = ""
    file: str = ""
    settings: dict[str, Any] = {}
    experiment: dict[str, Any] = {}
    controllers: tuple[str, ...] = ()
    metrics: tuple[str, ...] = ()
    units: dict[str, str] = {}
    robots: tuple[str, ...] = ()


class StoredTypes(msgspec.Struct, frozen=True):
    """Types of a row's columns, JSON already read."""

    id: int
    status: Literal["completed", "diverged", "tripped", "interrupted", "refused", "failed"]
    time: float
    signal: str
    message: str
    metrics: dict[str, float | None]
    seconds: float
    host: str
    fingerprint: str
    point: int
    controller: str
    seed: int
    parameters: dict[str, Any]
    finished: str


COLUMNS = ", ".join(field.name for field in fields(Stored))


class Store:
    """An open database; made by `writing` or `reading`.

    Args:
        path: The file.
        connection: To it.
    """

    def __init__(self, path: Path, connection: sqlite3.Connection) -> None:
        self.path, self._db = path, connection

    def require_tables(self) -> None:
        """Refuse whatever is no plain table: views and triggers are programs, and may be those of a stranger.

        Raises:
            StudyError: With its name.
        """
        with sqlite_errors(self.path, "read"):
            self._db.execute("PRAGMA trusted_schema = OFF")
            found = self._db.execute("SELECT type, name, sql FROM sqlite_master WHERE sql IS NOT NULL").fetchall()
        for kind, name, made in found:
            if kind != "table" or name not in ("meta", "rows") or "GENERATED" in str(made).upper():
                raise self.broken(f"the {kind} '{name}'", "a study's database has the tables meta and rows alone")

    def meta(self) -> dict[str, Any]:
        """Facts about the study: format, versions, settings, experiment."""
        with sqlite_errors(self.path, "read"):
            found = self._db.execute("SELECT key, value FROM meta").fetchall()
        facts = {str(key): self.json(value, f"the fact '{key}'") for key, value in found}
        try:
            msgspec.convert(facts, Facts)
        except msgspec.ValidationError as error:
            what, fix = wrong_type(error)
            where = str(error).partition(" - at ")[2].strip("`$.")
            raise self.broken(f"the fact '{where}'", f"{what}; {fix}" if fix else what) from None
        return facts

    def json(self, text: Any, where: str) -> Any:
        """A value out of its text.

        Raises:
            StudyError: It is none.
        """
        try:
            return json.loads(text)
        except (TypeError, ValueError, RecursionError) as error:
            raise self.broken(where, str(error)) from None

    def broken(self, where: str, why: str) -> StudyError:
        """The error of a database that holds something else than we write."""
        return StudyError(f"{where} cannot be read", why=why, fix=AGAIN, file=self.path)

    def set_meta(self, facts: Mapping[str, Any]) -> None:
        """Write facts, all or none."""
        texts = [(key, json.dumps(value)) for key, value in facts.items()]
        with sqlite_errors(self.path, "write"), self._db:
            self._db.executemany("INSERT OR REPLACE INTO meta VALUES (?, ?)", texts)

    def fingerprints(self) -> dict[str, tuple[int, str]]:
        """Fingerprint of every row to its number and status."""
        with sqlite_errors(self.path, "read"):
            found = self._db.execute("SELECT fingerprint, id, status FROM rows").fetchall()
        for fingerprint, _, status in found:
            if not isinstance(fingerprint, str) or not isinstance(status, str):
                raise self.broken(f"the row {fingerprint!r}", "its fingerprint or its status is no text")
        return {fingerprint: (number, status) for fingerprint, number, status in found}

    def rows(self) -> list[Stored]:
        """All rows in order."""
        with sqlite_errors(self.path, "read"):
            found = self._db.execute(f"SELECT {COLUMNS} FROM rows ORDER BY id").fetchall()
        return [self.stored(row) for row in found]

    def row(self, number: int) -> Stored | None:
        """One row; None if it is not there."""
        with sqlite_errors(self.path, "read"):
            found = self._db.execute(f"SELECT {COLUMNS} FROM rows WHERE id = ?", (number,)).fetchone()
        return None if found is None else self.stored(found)

    def stored(self, row: tuple[Any, ...]) -> Stored:
        """A row of SQL as ours.

        Raises:
            StudyError: It holds something else than we write.
        """
        values = dict(zip(COLUMNS.split(", "), row, strict=True))
        where = f"row {values['id']}"
        values |= {key: self.json(values[key], f"{key} of {where}") for key in ("metrics", "parameters")}
        try:
            msgspec.convert(values, StoredTypes)
        except msgspec.ValidationError as error:
            raise self.broken(where, str(error)) from None
        metrics = {
            sys.intern(name): math.nan if value is None else float(value) for name, value in values["metrics"].items()
        }
        return Stored(**values | {"metrics": metrics})

    def add(self, fingerprint: str, point: int, controller: str, seed: int, parameters: Any, done: JobResult) -> None:
        """Store a finished run; see `add_all`."""
        self.add_all([(fingerprint, point, controller, seed, parameters, done)])

    def add_all(self, runs: Iterable[tuple[str, int, str, int, Any, JobResult]]) -> None:
        """Store finished runs; they are on disk, as far as a killed process matters, when this returns.

        Args:
            runs: Of each fingerprint, point, controller, seed, parameters and result.

        Raises:
            StudyError: They cannot be written, for example on a full disk.
        """
        require_there(self.path)
        now = datetime.now(UTC).isoformat(timespec="seconds")
        rows = [
            vars(done)
            | {"metrics": encoded(done.metrics), "parameters": json.dumps(parameters), "fingerprint": fingerprint}
            | {"point": point, "controller": controller, "seed": seed, "finished": now}
            for fingerprint, point, controller, seed, parameters, done in runs
        ]
        marks = COLUMNS.replace(", ", ", :")
        with sqlite_errors(self.path, "write"), self._db:
            self._db.executemany(f"INSERT OR REPLACE INTO rows ({COLUMNS}) VALUES (:{marks})", rows)

    def renumber(self, numbers: Mapping[str, int]) -> None:
        """Give rows the numbers that they have in another plan, and drop those that are not in it.

        Args:
            numbers: Fingerprint to number.
        """
        kept = [(row, numbers[row.fingerprint]) for row in self.rows() if row.fingerprint in numbers]
        with sqlite_errors(self.path, "write"), self._db:
            self._db.execute("UPDATE rows SET id = -1 - id")
            for row, number in kept:
                self._db.execute("UPDATE rows SET id = ? WHERE id = ?", (number, -1 - row.id))
            self._db.execute("DELETE FROM rows WHERE id < 0")

    def close(self) -> None:
        """Close it, its log merged into it."""
        with contextlib.suppress(sqlite3.Error):
            self._db.close()


@contextmanager
def writing(path: Path) -> Iterator[Store]:
    """The database for its one writer, made if it is not there.

    Raises:
        StudyError: Another process writes it, it is no study's, of another version, or it cannot be made.
    """
    with locked(path, "database", StudyError):
        is_new = not path.exists() or not path.stat().st_size
        store = Store(path, connect(path, "rwc"))
        try:
            with sqlite_errors(path, "write"):
                if is_new:  # its tables, all or none
                    store._db.execute("PRAGMA journal_mode = WAL")
                    store._db.executescript(f"BEGIN;{SCHEMA}COMMIT;")
            require_ours(store)
            yield store
        finally:
            store.close()


@contextmanager
def reading(path: Path) -> Iterator[Store]:
    """The database for reading, also while another process writes it.

    Raises:
        StudyError: It does not exist, is no study's, or of another version.
    """
    if not path.is_file():
        raise StudyError("no such database", fix="name one that `mmnn study` wrote", file=path)
    store = Store(path, connect(path, "ro" if os.access(path.parent, os.W_OK) else "ro&immutable=1"))
    try:
        require_ours(store)
        yield store
    finally:
        store.close()


def connect(path: Path, mode: str) -> sqlite3.Connection:
    """A connection to a file."""
    with sqlite_errors(path, "open"):
        opened = sqlite3.connect(f"{path.absolute().as_uri()}?mode={mode}", uri=True, timeout=30.0)
        opened.setlimit(sqlite3.SQLITE_LIMIT_LENGTH, LONGEST_VALUE)
        return opened


def require_ours(store: Store) -> None:
    """Refuse a file that is no study's, or one of another version.

    Raises:
        StudyError: With both versions.
    """
    try:
        store.require_tables()
        meta = store.meta()
    except StudyError as error:
        if "no such table" in error.why or "not a database" in error.why:
            fix = "name another folder with --out"
            raise StudyError("not a study's database", why=error.why, fix=fix, file=store.path) from None
        raise
    if meta.get("format") != FORMAT:
        raise StudyError("not a study's database", why="another program wrote it", file=store.path)
    if (version := meta.get("format_version")) != FORMAT_VERSION:
        why = f"its format version is {version}, this mmnn_pin reads {FORMAT_VERSION}"
        fix = "use the mmnn_pin that wrote it, or another folder with --out"
        raise StudyError("a database of another version", why=why, fix=fix, file=store.path)


@contextmanager
def sqlite_errors(path: Path, verb: str) -> Iterator[None]:
    """Errors of SQLite as ours."""
    try:
        yield
    except (sqlite3.Error, UnicodeDecodeError) as error:  # the second is of a damaged text
        why = str(error)
        fix = ROOM if "full" in why or "disk I/O" in why else ""
        raise StudyError(f"cannot {verb} the database", why=why, fix=fix, file=path) from None


def storage_error(error: Exception, file: Path) -> StudyError | None:
    """What Optuna raises where its database cannot be written any more, as ours; None for any other error."""
    inner = getattr(error, "__cause__", None) or error
    kind = f"{type(inner).__module__}.{type(inner).__name__}"
    if not kind.startswith(("sqlalchemy.", "sqlite3.", "optuna.exceptions.StorageInternalError")):
        return None
    why = str(getattr(inner, "orig", None) or inner).splitlines()[0]
    fix = ROOM if "full" in why or "disk I/O" in why else ""
    return StudyError("cannot write the database", why=why, fix=fix, file=file)


def require_there(path: Path) -> None:
    """Refuse to go on where a database was taken away: rows would go into a file without a name, and be lost.

    Raises:
        StudyError: It is gone.
    """
    if not path.is_file():
        fix = "leave its folder where it is until the study is over; the same command makes its rows again"
        raise StudyError("cannot write the database", why="it is gone", fix=fix, file=path)


def require_kept(path: Path, kept: bool) -> None:
    """Refuse to go on with a database that does not keep what is written: a search would go on for ever.

    Raises:
        StudyError: It does not.
    """
    if not kept:
        why, fix = "it does not keep the trials that are written", "choose another folder with --out"
        raise StudyError("the database is damaged", why=why, fix=fix, file=path)


def encoded(metrics: Mapping[str, float]) -> str:
    """Metrics as JSON that every reader of JSON takes: null for nan, 1e999 for inf; finite numbers keep their bits."""
    texts = {k: "null" if math.isnan(v) else repr(float(v)).replace("inf", "1e999") for k, v in metrics.items()}
    return "{" + ", ".join(f"{json.dumps(name)}: {text}" for name, text in texts.items()) + "}"

"""A study's results in one file, a line of JSON for each run, there as soon as the run has finished.

The first line holds the facts of the study: version, settings, experiment. Lines are only added, and of two about one
run, or of two lines of facts, the later counts. So a kill loses no finished run: what is left of a line that was not
written whole is dropped. One process writes, held off from others by a lock; readers never wait.
"""

from __future__ import annotations

import json
import os
import sys
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

import msgspec

from ...errors import StudyError
from ...files import FULL, locked, opened, ours, parsed_json, reason, whole_file
from ...settings.arguments import wrong_type

FORMAT, VERSION = "mmnn_pin study", 2
NAME, OLD_NAME = "results.jsonl", "study.sqlite"
AGAIN = "take the results from a copy, or choose another folder with --out"
ROOM = "free some space; what is stored is kept, and the same command goes on from there"
LONGEST_LINE = 50_000_000  # bytes: those of a study are far shorter


class TrialResult(msgspec.Struct, frozen=True, kw_only=True):
    """The result of one run of a study, and of which one.

    Attributes:
        id: Number of the run, from 0.
        fingerprint: Hash of all that decides its numbers, but for the software.
        point: Number of its point of the factors.
        controller: Its controller.
        seed: Its seed.
        parameters: Factor to value.
        status: Of its outcome, or "refused" (these settings cannot be run) or "failed" (a fault; it is run again).
        time: When it ended [s].
        signal: Signal that went first.
        message: One line for people.
        metrics: See `Reducer.result`.
        seconds: Wall-clock time that it took [s].
        host: Machine that ran it.
        finished: Date and time at its end there.
    """

    id: int
    fingerprint: str = ""
    point: int
    controller: str
    seed: int
    parameters: dict[str, Any]
    status: Literal["completed", "diverged", "tripped", "interrupted", "refused", "failed"]
    time: float = 0.0
    signal: str = ""
    message: str = ""
    metrics: dict[str, float] = {}
    seconds: float = 0.0
    host: str = ""
    finished: str = ""

    @property
    def completed(self) -> bool:
        """Whether the run reached its end."""
        return self.status == "completed"


class Facts(msgspec.Struct, frozen=True):
    """Types of the facts of a study."""

    mmnn_pin: str
    versions: dict[str, str]
    plan: str
    rows: int
    name: str
    file: str
    settings: dict[str, Any]
    experiment: dict[str, Any]
    controllers: tuple[str, ...]
    metrics: tuple[str, ...]
    units: dict[str, str]
    robots: tuple[str, ...]


@dataclass
class Store:
    """A study's results as they are on disk."""

    path: Path  # the file
    facts: dict[str, Any] = field(default_factory=dict)  # of the study; empty where none were written
    # of its runs, in order of their numbers; those that are added later are only in the file
    results: list[TrialResult] = field(default_factory=list)

    def add(self, *lines: TrialResult | Mapping[str, Any]) -> None:
        """Write results or facts; they are on disk, as far as a killed process matters, when this returns.

        Raises:
            StudyError: They cannot be written, for example on a full disk.
        """
        text = b"".join(encoded(line) for line in lines)
        try:
            with ours(self.path) as file:
                end = file.seek(0, 2)
                try:
                    if file.write(text) != len(text):
                        raise OSError(FULL[0], "")
                except OSError:
                    file.truncate(end)
                    raise
        except OSError as error:
            raise cannot_write(self.path, error) from None

    def rewrite(self, facts: Mapping[str, Any], results: list[TrialResult]) -> None:
        """Replace the whole file, all or nothing."""
        with whole_file(self.path, "results") as part:
            part.write_bytes(encoded(facts) + b"".join(map(encoded, results)))
        self.facts, self.results = dict(facts), results


def cannot_write(path: Path, error: OSError) -> StudyError:
    """The error of a file that cannot be written any more."""
    fix = ROOM if error.errno in FULL else ""
    if not path.exists():
        fix = "leave its folder where it is until the study is over; the same command makes its rows again"
    return StudyError("cannot write the results", why=reason(error), fix=fix, file=path)


def encoded(line: TrialResult | Mapping[str, Any]) -> bytes:
    """A line; numbers keep their bits, and NaN and Infinity stand for themselves, as in Python's `json`."""
    head = {} if isinstance(line, TrialResult) else {"format": FORMAT, "format_version": VERSION}
    return json.dumps(head | msgspec.to_builtins(line)).encode() + b"\n"


@contextmanager
def writing(path: Path) -> Iterator[Store]:
    """The results for their one writer, a file made if there is none.

    Raises:
        StudyError: Another process writes it, it is no study's, of another version, or it cannot be made.
    """
    with locked(path, "results file", StudyError):
        try:
            with ours(path, os.O_CREAT) as file:
                store, whole = contents(path)
                file.truncate(whole)
        except OSError as error:
            raise cannot_write(path, error) from None
        yield store


def reading(path: Path) -> Store:
    """The results, also while another process writes them.

    Raises:
        StudyError: There are none, the file is no study's, or of another version.
    """
    if not path.is_file() and not path.with_name(OLD_NAME).is_file():
        raise StudyError("no such results", fix="name a folder that `mmnn study` wrote", file=path)
    return contents(path)[0]


def contents(path: Path) -> tuple[Store, int]:
    """The results, and how many bytes are whole lines."""
    old = path.with_name(OLD_NAME)
    if path == old or (old.is_file() and not (path.is_file() and path.stat().st_size)):
        why, fix = "a database of mmnn_pin before 0.4", "use the version that wrote it, or another folder with --out"
        raise StudyError("results of another version", why=why, fix=fix, file=old)
    facts, results, whole = dict[str, Any](), dict[int, TrialResult](), 0
    for number, line in enumerate(lines_of(path), 1):
        found = decoded(line, number, path)
        whole += len(line)
        if isinstance(found, TrialResult) and facts:
            results[found.id] = found
        elif isinstance(found, dict):
            facts = found
        else:
            raise StudyError("not a study's results", why="it does not begin with facts", file=path)
    return Store(path, facts, [results[i] for i in sorted(results)]), whole


def lines_of(path: Path) -> Iterator[bytes]:
    """Whole lines of a file.

    Raises:
        StudyError: It cannot be read, or a line is too long.
    """
    try:
        with opened(path) as file:
            while (line := file.readline(LONGEST_LINE)).endswith(b"\n"):
                yield line
    except OSError as error:
        raise StudyError("cannot read the results", why=reason(error), file=path) from None
    if len(line) == LONGEST_LINE:
        raise StudyError("cannot read the results", why="a line is too long", fix=AGAIN, file=path)


def decoded(line: bytes, number: int, path: Path) -> TrialResult | dict[str, Any]:
    """A result or the facts from their line.

    Raises:
        StudyError: It holds something else than we write.
    """
    try:
        table = parsed_json(line)
        if isinstance(table, dict) and table.get("format") == FORMAT:
            require_version(table, path)
            msgspec.convert(table, Facts)
            return table
        found = msgspec.convert(table, TrialResult)
    except msgspec.ValidationError as error:
        (what, fix), where = wrong_type(error), str(error).partition(" - at ")[2].strip("`$.")
        why = ", ".join(filter(None, (f"{where}: {what}" if where else what, fix)))
    except ValueError as error:
        why = str(error)
    else:
        names = {sys.intern(name): value for name, value in found.metrics.items()}
        return msgspec.structs.replace(found, metrics=names)
    what = "not a study's results" if number == 1 else f"line {number} cannot be read"
    raise StudyError(what, why=why, fix=AGAIN, file=path) from None


def require_version(facts: Mapping[str, Any], path: Path) -> None:
    """Refuse a file of another version (`StudyError`)."""
    if (version := facts.get("format_version")) != VERSION:
        why = f"its format version is {version}, this mmnn_pin reads {VERSION}"
        fix = "use the mmnn_pin that wrote it, or another folder with --out"
        raise StudyError("results of another version", why=why, fix=fix, file=path)

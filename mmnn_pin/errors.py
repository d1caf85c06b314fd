"""Errors of this package, each said in one line: `where: error: what: why: fix`.

Every error of this package derives from `MmnnError`. An `InputError` is the user's to mend (the command line
exits with 2); its children carry the evidence as attributes and say what would have been right.
"""

from __future__ import annotations

import copy
import difflib
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Self

LONGEST = 1000  # letters of a name or value in a message
FEW = 8  # names in a message


def printable(text: str, keep: str = "") -> str:
    """Text without what would steer a terminal or end a line of a file: control and direction characters of names.

    Args:
        text: It.
        keep: Characters of these kinds that stay.
    """
    return text if text.isprintable() else "".join(c if c.isprintable() or c in keep else " " for c in text)


def short(text: str, most: int = LONGEST) -> str:
    """The text as a message repeats it, in so many letters: a file in the place of a name would fill the screen."""
    return text if len(text) <= most else f"{text[: most - 3]}..."


def few(names: Sequence[str], most: int = FEW) -> str:
    """Names as a message tells them: so many at most, and how many more there are."""
    return ", ".join(names[:most]) + (f" and {len(names) - most} more" if len(names) > most else "")


class MmnnError(Exception):
    """Root of all errors raised by mmnn_pin."""


@dataclass(frozen=True)
class Values:
    """Values of settings that would mend an error; as text they are as Python writes them."""

    table: str  # key of the settings, such as `feedback`
    texts: Mapping[str, str]  # name to value, as Python writes it

    def __str__(self) -> str:
        values = ", ".join(f"{name}={text}" for name, text in self.texts.items())
        return f"{self.table}={self.table.capitalize()}({values})"


class InputError(MmnnError):
    """Bad input: a file, a name, a value.

    Args:
        what: What is wrong, e.g. `"mass '1,5' is not a number"`.
        why: Why it is refused, or what it would lead to.
        fix: What to do instead.
        file: File the input came from.
        line: Line in that file, counted from 1.
        key: Key path inside a config, e.g. `time.control_period`.
        code: What kind of problem it is, for programs: `LENGTH`; empty for one that no program asks for.
        values: What would mend it; `fix` has them as text.

    >>> try:
    ...     load("platform_arm").gravity([0.0, 0.0])
    ... except InputError as error:
    ...     print(error)
    q: error: 2 numbers where platform_arm has 5: give x, y, phi, arm_1_joint, arm_2_joint
    """

    def __init__(
        self,
        what: str,
        *,
        why: str = "",
        fix: str = "",
        file: str | Path | None = None,
        line: int | None = None,
        key: str | None = None,
        code: str = "",
        values: Values | None = None,
    ) -> None:
        self.what, self.why, self.fix = what, why, fix
        self.file, self.line, self.key = file, line, key
        self.code, self.values = code, values
        self.option = ""  # of the command line that gave the key its value
        super().__init__(what)

    def __reduce__(self) -> tuple[Any, ...]:
        return restored, (type(self), self.args, self.__dict__)  # an error comes back from a process as it was

    def but(self, **changes: Any) -> Self:
        """A copy of the error with other attributes: as it is told from further outside."""
        found = copy.copy(self)
        found.__dict__.update(changes)
        return found

    def __str__(self) -> str:
        given = self.option and self.key and self.line is None  # else a file has the key, on that line
        key = f"{self.option} {self.key}" if given else self.key
        where = [short(str(part)) for part in (self.file, self.line, key) if part is not None]
        text = ": ".join(part for part in (short(self.what), self.why, self.fix) if part)
        return printable(f"{':'.join(where)}: error: {text}" if where else f"error: {text}")


@contextmanager
def keyed(outside: Callable[[str], str]) -> Iterator[None]:
    """Errors within name their key as it is from outside; empty stands for none on either side."""
    try:
        yield
    except InputError as error:
        raise error.but(key=outside(error.key or "") or None) from error


def restored(kind: type[InputError], args: tuple[Any, ...], content: dict[str, Any]) -> InputError:
    """An error from its parts."""
    error = kind.__new__(kind, *args)
    error.__dict__.update(content)
    return error


class RobotError(InputError):
    """A robot description that cannot be used."""


class ConfigError(InputError):
    """A setting that is missing, unknown, of the wrong type or out of range."""


class TrajectoryError(InputError):
    """A reference trajectory that is malformed or that the base cannot follow."""


class RecordingError(InputError):
    """A recording that cannot be written or read."""


class StudyError(InputError):
    """A study whose database or workers cannot be used."""


class UnknownKey(ConfigError):
    """A key that settings do not have.

    Args:
        name: Of the key, the last part of its path.
    """

    def __init__(self, name: str, **told: Any) -> None:
        self.name = name
        super().__init__(f"unknown key '{name}'", **told)


LENGTH = "length"  # the code of a list that is as long as another robot needs it
SHOWN = 60  # names in a message: a robot may have hundreds of links


class UnknownName(InputError, KeyError):  # a KeyError, so that `get` of a mapping takes it
    """A name that nothing answers to.

    Args:
        kind: What was looked for, e.g. `"robot"`.
        name: The name given.
        available: The names that exist.
    """

    def __init__(
        self, kind: str, name: str, available: Iterable[str], *, file: str | Path | None = None, key: str | None = None
    ) -> None:
        self.kind, self.name, self.available = kind, name, tuple(available)
        near = difflib.get_close_matches(name, self.available, n=1)
        guess = f"did you mean '{near[0]}'? " if near else ""
        fix = f"{guess}there is: {few(self.available, SHOWN)}"
        super().__init__(f"unknown {kind} '{name}'", fix=fix, file=file, key=key)


class UnknownArgument(UnknownName, TypeError):  # as Python has it for functions without a check
    """An argument that a class or a function does not have."""

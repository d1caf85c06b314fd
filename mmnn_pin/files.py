"""Files of others are read within limits, our own are written whole or not at all.

A file, or a folder of files, is made under another name beside its place and moved there when it is complete: a full
disk, a folder that is gone or a kill leaves what was there before, and nothing half written. Where a file must not be
replaced it is not, also if another process has written it meanwhile. TOML is bounded before it is parsed: the time that
the parser takes grows with the square of a key's length, and its stack with every bracket.
"""

from __future__ import annotations

import errno
import fcntl
import grp
import json
import os
import pwd
import re
import shutil
import socket
import stat
import tempfile
import tomllib
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from io import FileIO
from pathlib import Path
from typing import Any, BinaryIO

from .errors import ConfigError, InputError, RecordingError

FULL = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)
ELSEWHERE, NO_FILE = "choose another place", "it is no plain file"
POINTER = b"version https://git-lfs"  # where Git LFS has the file itself elsewhere
CLOSED = (errno.EACCES, errno.EPERM, errno.EROFS)
LONGEST, DEEPEST = 1_000_000, 32  # bytes of a TOML file; levels of its tables and lists
LARGEST = 500_000_000  # bytes of tables of numbers: logs, trajectories
MOST = 100_000_000_000  # bytes of any file
DENSEST, ROOM = 64, 1 << 24  # what a file unpacks to: so many times its size, and so many bytes more
XML = "it is XML, as a robot's URDF is", 'name the robot by --robot FILE, or by robot = "FILE" in the TOML'
TOML = "mend it: lines are key = value, texts stand in quotes, every bracket is closed"
PART = r"(?:\"[^\"\n]*+\"|'[^'\n]*+'|[\w-]++)"  # of a key
DEEP_KEY = re.compile(rf"(?:^|[\[{{,])[ \t]*+{PART}(?:[ \t]*+\.[ \t]*+{PART}){{{DEEPEST},}}", re.MULTILINE)
DEEP = f"it is nested more than {DEEPEST} levels deep"


def reason(error: Exception) -> str:
    """Cause of a failed file operation, without HDF5's own stack of phrases where the system has a name for it."""
    number = getattr(error, "errno", None)
    return os.strerror(number) if number else str(error)


def way_out(error: Exception) -> str:
    """Advice for an error of the disk, the place or the name; empty for others."""
    number = getattr(error, "errno", None)
    if number in FULL:
        return "make room on the disk, and give the same command again"
    if number in (errno.ENAMETOOLONG, errno.ELOOP):
        return "use a shorter name"
    return ELSEWHERE if number in CLOSED else ""


# -- what is read ------------------------------------------------------------------------------------------------------


def opened(path: str | Path, most: int = MOST) -> BinaryIO:
    """A plain file, open for reading: no pipe, which may keep one waiting, nor a device, which may never end.

    Args:
        path: The file.
        most: Bytes that it may have.

    Raises:
        OSError: It cannot be opened, is something else, a pointer of Git LFS, or has more.
        ValueError: A name that no file can have.
    """
    try:
        file = open(path, "rb", opener=lambda name, flags: os.open(name, flags | os.O_NONBLOCK))  # noqa: SIM115
    except IsADirectoryError:
        raise IsADirectoryError(NO_FILE) from None
    state = os.fstat(file.fileno())
    wrong = too_large(most) if state.st_size > most else None
    wrong = wrong if stat.S_ISREG(state.st_mode) else OSError(NO_FILE)
    if wrong is None and file.read(len(POINTER)) == POINTER:
        wrong = OSError("it is a pointer to a file in Git LFS: git lfs pull brings the file itself")
    if wrong is not None:
        file.close()
        raise wrong
    file.seek(0)
    return file


def too_large(most: int) -> OSError:
    """The error of a file of more than some bytes."""
    unit, name = next((one for one in ((1e9, "GB"), (1e6, "MB")) if most > one[0]), (1e3, "kB"))
    return OSError(f"it has more than {most / unit:,g} {name}")


def read_bytes(path: str | Path, most: int = LONGEST) -> bytes:
    """Content of a plain file of at most so many bytes.

    Raises:
        OSError: As `opened`, or there are more.
        ValueError: As `opened`.
    """
    with opened(path, most) as file:
        data = file.read(most + 1)
    if len(data) > most:  # it grows
        raise too_large(most)
    return data


def read_text(path: Path, most: int = LONGEST) -> str:
    """A text in UTF-8.

    Raises:
        ConfigError: It cannot be read, is no plain file, too large, or not in UTF-8.
    """
    try:
        return read_bytes(path, most).decode()
    except UnicodeDecodeError as error:
        raise ConfigError("not a text in UTF-8", why=str(error), fix="save it in UTF-8", file=path) from error
    except (OSError, ValueError) as error:  # a name that no file can have
        raise ConfigError("cannot be read", why=reason(error), file=path) from error


def read_toml(path: Path) -> dict[str, Any]:
    """Content of a TOML file.

    Raises:
        ConfigError: It cannot be read, is too large or too deep, not UTF-8 or not TOML; with the line.
    """
    text = read_text(path)
    try:
        return parsed_toml(text)
    except ValueError as error:
        line = re.search(r"at line (\d+)", str(error))
        number = int(line[1]) if line else None
        why, fix = XML if text.lstrip().startswith("<") else (str(error), TOML)
        raise ConfigError("not valid TOML", why=why, fix=fix, file=path, line=number) from error


def parsed_toml(text: str) -> dict[str, Any]:
    """A text of TOML as a table.

    Raises:
        ValueError: It is none, or too deep.
    """
    if key := DEEP_KEY.search(text):
        raise ValueError(f"{DEEP} (at line {text.count(chr(10), 0, key.start()) + 1})")
    try:
        table = tomllib.loads(text)
    except RecursionError:
        raise ValueError(DEEP) from None
    if is_deep(table):
        raise ValueError(DEEP)
    return table


def parsed_json(text: str | bytes) -> Any:
    """A text of JSON as its value.

    Raises:
        ValueError: It is none, or too deep.
    """
    try:
        return json.loads(text)
    except RecursionError:
        raise ValueError("it is nested too deeply") from None


def quoted(text: str) -> str:
    """A text in quotes for TOML, and for YAML: on one line, whatever it holds."""
    plain = (c if c.isprintable() and c not in '"\\' else f"\\U{ord(c):08x}" for c in text)
    return f'"{"".join(plain)}"'


def is_deep(value: Any) -> bool:
    """Whether tables and lists are nested in one another more than `DEEPEST` times."""
    level = [value]
    for _ in range(DEEPEST + 1):
        inner = [item for item in level if isinstance(item, dict | list)]
        level = [part for item in inner for part in (item.values() if isinstance(item, dict) else item)]
        if not level:
            return False
    return True


# -- what is written ---------------------------------------------------------------------------------------------------


def require_free(path: Path, force: bool, what: str = "file") -> None:
    """Refuse to replace a file unasked; `what` names it in the error (`RecordingError`)."""
    if path.is_dir():
        raise RecordingError(f"cannot write the {what}", why="there is a folder of that name", file=path)
    if path.exists() and not force:
        raise taken(path, what)


def taken(path: Path, what: str) -> RecordingError:
    """The error of a file that is there."""
    return RecordingError(f"the {what} exists", fix="choose another, or replace it with --force", file=path)


@contextmanager
def whole_file(path: Path, what: str, force: bool = True) -> Iterator[Path]:
    """A temporary name to write to; it becomes `path` at the end of the block, or vanishes with an error.

    Args:
        path: The file; missing folders are made.
        what: What it is, for the message of an error.
        force: Whether it may replace another one.

    Raises:
        RecordingError: A place that cannot be written, or a file that is there.
    """
    require_free(path, force, what)
    part = path.with_name(f".{path.name}.{os.getpid()}.part")
    with errors_of(path, what), folders_for(path):
        part.unlink(missing_ok=True)  # a link of somebody else's would be written through
        try:
            yield part
            settle(part, path, what, force)
        finally:
            with suppress(OSError):
                part.unlink()


def settle(part: Path, path: Path, what: str, force: bool, sync: bool = True) -> None:
    """Give a complete file its name, once it is on the disk; without `sync` before, for one that will grow.

    Raises:
        RecordingError: Another process has written it meanwhile, and `force` is off.
        OSError: It cannot be.
    """
    if sync:
        with part.open("rb") as file:
            os.fsync(file.fileno())  # a disk over a network says only now that it is full
    if not force:
        try:
            os.link(part, path)  # as a rename, but never over a file
            return
        except FileExistsError:
            raise taken(path, what) from None
        except OSError:  # a file system without links
            require_free(path, force, what)
    os.replace(part, path)


@contextmanager
def whole_folder(folder: Path, what: str, force: bool = True) -> Iterator[Path]:
    """A temporary folder to write files into; at the end they are in `folder`, all of them or none.

    Args:
        folder: Where they go; other files that are there stay.
        what: What it is, for the message of an error.
        force: Whether files there may be replaced.

    Raises:
        RecordingError: A place that cannot be written, or a file that is there.
    """
    with errors_of(folder, what), folders_for(folder):
        made = Path(tempfile.mkdtemp(prefix=f".{folder.name}.", dir=folder.parent))
        try:
            yield made
            settle_folder(made, folder, what, force)
        finally:
            shutil.rmtree(made, ignore_errors=True)


def settle_folder(made: Path, folder: Path, what: str, force: bool) -> None:
    """Give complete files their names; errors as of `settle`."""
    if not folder.exists():
        made.chmod(0o777 & ~umask())
        made.rename(folder)
        return
    files = sorted(file.relative_to(made) for file in made.rglob("*") if file.is_file())
    for file in files:
        require_free(folder / file, force, what)
    for file in files:
        (folder / file).parent.mkdir(parents=True, exist_ok=True)
        settle(made / file, folder / file, what, force)


def make_private(folder: Path) -> str:
    """Make a folder that only we, and root, can write to, for what is run as it is found there.

    Args:
        folder: The folder, without symbolic links.

    Returns:
        Why others can write to it, or replace a folder above it; empty where they cannot.

    Raises:
        OSError: It cannot be made.
    """
    if why := way_in(folder):
        return why
    for place in (*reversed(folder.parents), folder):
        with suppress(FileExistsError):
            place.mkdir(0o700)
            place.chmod(0o700)  # whatever the umask
    return way_in(folder)


def way_in(folder: Path) -> str:
    """The way by which others can put files into a folder, also one to be made; empty where there is none.

    It looks at all folders above, up to the user's own one. One whose entries only their owners can replace is no way
    in, but may stand in a folder that is.
    """
    home = Path.home().resolve()
    for place in (folder, *folder.parents):
        try:
            state = place.stat()
        except FileNotFoundError:
            continue
        if state.st_uid not in (os.getuid(), 0):
            return f"user {state.st_uid} owns {place}"
        by_group = state.st_mode & stat.S_IWGRP and not is_own_group(state.st_gid)
        sticky = state.st_mode & stat.S_ISVTX and place != folder
        if (by_group or state.st_mode & stat.S_IWOTH) and not sticky:
            return f"others can write to {place} (mode {stat.S_IMODE(state.st_mode):o})"
        if place == home:
            break
    return ""


def is_own_group(number: int) -> bool:
    """Whether a group is the user's alone, as many systems make one for each."""
    with suppress(KeyError):
        group, user = grp.getgrgid(number), pwd.getpwuid(os.getuid())
        return group.gr_name == user.pw_name and {*group.gr_mem} <= {user.pw_name}
    return False


def umask() -> int:
    """The permissions that new files of this process do not get."""
    found = os.umask(0o077)
    os.umask(found)
    return found


@contextmanager
def errors_of(path: Path, what: str) -> Iterator[None]:
    """Errors of the system while a file is written, as ours."""
    try:
        yield
    except OSError as error:
        raise RecordingError(
            f"cannot write the {what}", why=reason(error), fix=way_out(error) or ELSEWHERE, file=path
        ) from error


@contextmanager
def folders_for(path: Path) -> Iterator[None]:
    """The folders above a file, made for the block; those that are still empty after an error are taken away again."""
    new = [folder for folder in path.parents if not folder.exists()]
    path.parent.mkdir(parents=True, exist_ok=True)
    try:
        yield
    except BaseException:
        for folder in new:
            with suppress(OSError):
                folder.rmdir()
        raise


def ours(path: Path, flags: int = 0) -> FileIO:
    """A plain file that we write to where it is: no link, which may lead to a file that is none of this.

    Args:
        path: The file.
        flags: `O_CREAT` makes it where there is none.

    Raises:
        OSError: It cannot be opened, or is something else.
    """
    if path.is_symlink():
        raise OSError("it is a link")
    number = os.open(path, os.O_RDWR | os.O_NOFOLLOW | os.O_NONBLOCK | flags, 0o666)
    if stat.S_ISREG(os.fstat(number).st_mode):
        return FileIO(number, "r+b")
    os.close(number)
    raise OSError(NO_FILE)


@contextmanager
def locked(path: Path, what: str, kind: type[InputError] = RecordingError) -> Iterator[None]:
    """Keep other processes from writing a file; the lock ends with this process, however that ends.

    Args:
        path: The file; its lock is a file beside it.
        what: What it is, for the message of an error.
        kind: Of that error.

    Raises:
        InputError: Another process has it, with its number and machine; or the folder cannot be written to.
    """
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        file = ours(path.with_name(f"{path.name}.lock"), os.O_CREAT)
    except OSError as error:
        fix = way_out(error) or "choose another folder"
        raise kind("the folder cannot be written to", why=reason(error), fix=fix, file=path) from None
    with file:
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            file.seek(0)
            why = f"process {file.read().decode(errors='replace').strip() or 'unknown'} writes it"
            fix = "wait for it, or choose another folder"
            raise kind(f"the {what} is in use", why=why, fix=fix, file=path) from None
        with suppress(OSError):  # a full disk must not keep anyone from reading on
            file.truncate(0)
            file.write(f"{os.getpid()} on {socket.gethostname()}\n".encode())
        yield

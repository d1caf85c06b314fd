"""Files that appear whole or not at all."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from ...errors import RecordingError


@contextmanager
def whole(path: Path, what: str) -> Iterator[Path]:
    """A temporary name to write to; it becomes `path` at the end of the block, or vanishes with an error.

    Args:
        path: The file; missing folders are made.
        what: What it is, for the message of an error.

    Raises:
        RecordingError: A place that cannot be written.
    """
    part = path.with_name(f".{path.name}.{os.getpid()}.part")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        yield part
        os.replace(part, path)
    except OSError as error:
        raise RecordingError(f"cannot write the {what}", why=error.strerror or str(error), file=path) from error
    finally:
        with suppress(OSError):
            part.unlink()


def require_free(path: Path, force: bool) -> None:
    """Refuse to replace a file unasked.

    Raises:
        RecordingError: It exists, and `force` is off.
    """
    if path.exists() and not force:
        raise RecordingError("the file exists", fix="choose another, or replace it with --force", file=path)

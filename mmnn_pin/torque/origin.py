"""Where a controller in plain Python comes from: its file, and the line of it that an error is about."""

from __future__ import annotations

import hashlib
import inspect
import sys
import traceback
from pathlib import Path
from typing import Any

from ..errors import InputError
from .controller import TorqueController

DIGEST = "__mmnn_sha256__"  # of a module: what its file was when it was read


def origin_of(kind: type[TorqueController]) -> dict[str, Any]:
    """Class, file and hash of the file of a controller; file and hash are empty where there is none.

    The hash is that of the file as it was read, where `experiments.own` read it.
    """
    file = file_of(kind)
    digest = getattr(sys.modules.get(kind.__module__), DIGEST, "")
    if not digest and file is not None and file.is_file():
        digest = sha256(file.read_bytes())
    return {"class": kind.__qualname__, "file": "" if file is None else str(file), "sha256": digest}


def sha256(content: bytes) -> str:
    """Hash of a file's content."""
    return hashlib.sha256(content).hexdigest()


def file_of(kind: type[TorqueController]) -> Path | None:
    """The file in which a class is written; None for one that was typed in."""
    try:
        return Path(inspect.getfile(kind)).absolute()
    except (TypeError, OSError):
        return None


def blamed(error: BaseException, controller: TorqueController) -> InputError:
    """An error of a controller in plain Python, told in one line with the place in its file."""
    return told(error, f"controller '{controller.name}' failed", file_of(type(controller)))


def told(error: BaseException, what: str, file: Path | None) -> InputError:
    """An error in one line, with the innermost line of a file that it passed through."""
    lines = [(Path(f.filename).absolute(), f.lineno) for f in traceback.extract_tb(error.__traceback__)]
    if isinstance(error, SyntaxError) and error.filename:
        lines.append((Path(error.filename).absolute(), error.lineno))
    line = next((number for where, number in reversed(lines) if where == file), None)
    text = error.msg if isinstance(error, SyntaxError) else str(error)
    return InputError(what, why=" ".join(f"{type(error).__name__}: {text}".split()), file=file, line=line)

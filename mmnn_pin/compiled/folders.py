"""Where compiled code is kept: a folder for each module, by a hash of the sources that it depends on.

numba looks only at the file of the function itself, so an edited callee would run stale. Code is run as it is found, so
the folder must be one that only this user can write to.
"""

from __future__ import annotations

import hashlib
import os
import re
import sys
import time
from contextlib import suppress
from functools import cache
from multiprocessing import parent_process
from pathlib import Path
from shutil import rmtree
from tempfile import gettempdir

import numba

from ..files import make_private

PACKAGE = Path(__file__).parents[1]
MARKS = re.compile(rb"^ *@(internal|compiled|linked|inlined|by_address)", re.M)
IMPORT = re.compile(r"^from (\.*)([\w.]*) import (\([^)]*\)|[^(\n]*)", re.M)
# Without compiled functions; these depend on them.
CONSTANTS = tuple(f"mmnn_pin.{name}" for name in ("signals", "parts", "compiled", "compiled.linking"))
KEPT = 30 * 86400.0  # how long code of other versions is kept after its last use [s]
PLAIN = os.environ.get("MMNN_PLAIN_NUMBA", "0") == "1"


@cache
def file_of(module: str) -> Path | None:
    """The file of a module; None where it has none."""
    root, *names = module.split(".")
    if root != PACKAGE.name:
        file = getattr(sys.modules.get(module), "__file__", None)
        return Path(file) if file and Path(file).is_file() else None
    place = PACKAGE.joinpath(*names)
    files = (place / "__init__.py", place.with_suffix(".py"))
    return next((file for file in files if file.is_file()), None)


@cache
def text_of(module: str) -> bytes:
    """The source of a module; nothing where it has none."""
    file = file_of(module)
    return b"" if file is None else file.read_bytes()


@cache
def imports_of(module: str) -> dict[str, str]:
    """The names that a module imports at its head from this package, and the modules that they come from."""
    file, found = file_of(module), dict[str, str]()
    parts = module.split(".") if file is not None and file.name == "__init__.py" else module.split(".")[:-1]
    for dots, source, names in IMPORT.findall(text_of(module).decode()):
        base = ".".join([*parts[: len(parts) - len(dots) + 1], *([source] if source else [])]) if dots else source
        if base.split(".")[0] == PACKAGE.name:
            for name in re.findall(r"(\w+)(?: +as +\w+)?", re.sub(r"#.*", "", names)):
                found[name] = origin(base, name)
    return found


def origin(module: str, name: str) -> str:
    """The module that a name comes from which another module hands on."""
    if file_of(f"{module}.{name}") is not None:
        return f"{module}.{name}"
    file = file_of(module)
    if file is not None and file.name == "__init__.py":
        return imports_of(module).get(name, module)
    return module


@cache
def has_compiled(module: str) -> bool:
    """Whether compiled functions depend on the text of a module; a package is imported for what it hands on."""
    file = file_of(module)
    hands_on = file is not None and file.name == "__init__.py"
    return hands_on or module in CONSTANTS or MARKS.search(text_of(module)) is not None


@cache
def source_key(module: str) -> str:
    """A name for the sources that the compiled functions of a module depend on: its own, and what it imports."""
    found, left = {module, *CONSTANTS}, [module]
    while left:
        new = {one for one in imports_of(left.pop()).values() if has_compiled(one)} - found
        found |= new
        left += new
    if PLAIN:  # callers have the code of learners in them: all sources
        files = (file.relative_to(PACKAGE.parent).with_suffix("").parts for file in PACKAGE.rglob("*.py"))
        found |= {one for one in map(".".join, files) if has_compiled(one)}
    digest = hashlib.sha256(numba.__version__.encode())  # of two versions neither reads what the other keeps
    for one in sorted(found):
        digest.update(one.encode() + b"\0" + text_of(one))
    return digest.hexdigest()[:16]


def cache_root() -> Path:
    """Folder that holds the compiled code of all versions of the sources."""
    if given := os.environ.get("NUMBA_CACHE_DIR"):
        return Path(given)
    if sys.platform == "darwin":
        return Path.home() / "Library" / "Caches" / "mmnn_pin"
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "mmnn_pin"


@cache
def cache_folder(module: str = "mmnn_pin.loop.compiled") -> Path | None:
    """Folder for the code of a module compiled from exactly these sources, None where nothing can be written."""
    try:
        root, name = checked_root(), source_key(module)
        if root is None or make_private(root / name):
            return None
        os.utime(root / name)  # used now
    except OSError:
        return None
    return root / name if os.access(root / name, os.W_OK) else None


@cache
def checked_root() -> Path | None:
    """The folder for the code of all modules that only this user can write to, see `private_root`; None for none."""
    root = private_root(cache_root().resolve(), source_key("mmnn_pin.compiled"))
    if root is not None:
        with suppress(OSError):
            forget(root)
    return root


def private_root(root: Path, name: str) -> Path | None:
    """The folder for compiled code, or another where strangers can write to that one: code is run as it is found.

    Args:
        root: The folder, without symbolic links.
        name: Of the folder in it; it is made.
    """
    if not (why := make_private(root / name)):
        return root
    other: Path | None = Path(gettempdir(), f"mmnn_pin-{os.getuid()}").resolve()
    if other is not None and make_private(other / name):
        other = None
    if parent_process() is None:  # else it has said so
        instead = "it is not kept" if other is None else f"it is kept in {other}"
        fix = "set NUMBA_CACHE_DIR to a folder of your own"
        print(f"warning: compiled code is not taken from {root}: {why}: {instead}: {fix}", file=sys.stderr)
    return other


def forget(root: Path) -> None:
    """Remove the code of other versions that nothing has used for `KEPT`: a version takes up to 150 MB."""
    for folder in root.iterdir():
        with suppress(OSError):  # another process removes it, too
            unused = time.time() - folder.stat().st_mtime > KEPT
            if unused and re.fullmatch("[0-9a-f]{16}", folder.name) and any(folder.rglob("*.nbi")):
                rmtree(folder, ignore_errors=True)

"""Settings that libraries read from the folder where one stands: for the program `mmnn` nothing there counts.

numba reads `.numba_config.yaml` when it is imported and before it compiles, matplotlib `matplotlibrc`: of a folder of
recordings that somebody else made, either is his. Who imports this package from Python has his own ways.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from importlib.machinery import ModuleSpec, PathFinder
from types import ModuleType

from .leaving import PROGRAM

READING = ("numba.core.config", "matplotlib")  # modules that read settings as they are imported


@contextmanager
def elsewhere() -> Iterator[None]:
    """Stand in the root folder meanwhile."""
    here = os.open(".", getattr(os, "O_PATH", os.O_RDONLY))  # which may be closed to readers
    try:
        os.chdir("/")
        yield
    finally:
        os.fchdir(here)
        os.close(here)


class Elsewhere:
    """Finds those modules, and has them imported elsewhere."""

    @staticmethod
    def find_spec(name: str, path: Sequence[str] | None = None, target: ModuleType | None = None) -> ModuleSpec | None:
        """Where a module is; None for those that others find."""
        found = PathFinder.find_spec(name, path, target) if name in READING else None
        if found is None or found.loader is None:
            return None
        execute = found.loader.exec_module

        def execute_elsewhere(module: ModuleType) -> None:
            with elsewhere():
                execute(module)
            if name == READING[0]:
                vars(module)["_config_fname"] = os.devnull  # which it would look for again and again

        vars(found.loader)["exec_module"] = execute_elsewhere
        return found


if PROGRAM == "mmnn":
    sys.meta_path.insert(0, Elsewhere)

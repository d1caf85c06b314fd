"""How long a user waits: whole processes of the command line, warm and with an empty cache of compiled code."""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

MMNN = Path(sys.executable).with_name("mmnn")
COMMAND = [str(MMNN)] if MMNN.exists() else [sys.executable, "-c", "from mmnn_pin.cli import main; main()"]


def help_text() -> dict[str, float]:
    """`mmnn --help`."""
    return process("--help")


def chapter4(*, cold: bool = False) -> dict[str, float]:
    """`mmnn run chapter4`: all its controllers, recorded and compared; cold starts with nothing compiled."""
    with tempfile.TemporaryDirectory() as folder:
        cache = {"NUMBA_CACHE_DIR": f"{folder}/cache"} if cold else {}
        return process("run", "chapter4", "--out", f"{folder}/runs", "--json", **cache)


def first_result() -> dict[str, float]:
    """`mmnn run chapter4` for one controller, with nothing compiled."""
    with tempfile.TemporaryDirectory() as folder:
        arguments = ("run", "chapter4", "--controller", "two_layer", "--out", f"{folder}/runs", "--json")
        return process(*arguments, NUMBA_CACHE_DIR=f"{folder}/cache")


def process(*arguments: str, **environment: str) -> dict[str, float]:
    """Seconds of wall clock and of processor time of a command, which keeps Python's byte code as pip and users do.

    Raises:
        CalledProcessError: It failed.
    """
    surroundings = os.environ | {"NUMBA_DISABLE_JIT": "0"} | environment
    surroundings.pop("PYTHONDONTWRITEBYTECODE", None)
    wall, before = time.perf_counter(), os.times()
    subprocess.run([*COMMAND, *arguments], check=True, capture_output=True, env=surroundings)
    after = os.times()
    cpu = after.children_user + after.children_system - before.children_user - before.children_system
    return {"wall": time.perf_counter() - wall, "cpu": cpu}

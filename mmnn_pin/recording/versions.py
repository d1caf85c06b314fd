"""Which versions made something: of Python, of this package and its commit, and of what its numbers come from."""

from __future__ import annotations

import json
import os
import platform
import subprocess
from functools import cache
from importlib import metadata
from pathlib import Path

import mmnn_pin

CHANGED = "+changes"  # after a commit to which the files have been changed


@cache
def versions() -> dict[str, str]:
    """Versions by name; `commit` where it is known."""
    found = {"python": platform.python_version()}
    for name in ("mmnn_pin", "pin", "numpy", "numba", "h5py"):
        try:
            found[name] = metadata.version(name)
        except metadata.PackageNotFoundError:
            found[name] = "unknown"
    made = commit(Path(mmnn_pin.__file__).parent)
    return found | ({"commit": made} if made else {})


def commit(package: Path) -> str:
    """The commit that a package is of; empty where nothing tells.

    A clone tells it by git, with `+changes` where a tracked file is another; an installation from a repository by what
    its installer noted (PEP 610). One from a wheel or from an archive has none.

    Args:
        package: The package's folder.
    """
    if (package.parent / ".git").exists():
        return described(package.parent)
    try:
        noted = json.loads(metadata.distribution(package.name).read_text("direct_url.json") or "{}")
    except (metadata.PackageNotFoundError, ValueError):
        return ""
    return str(noted.get("vcs_info", {}).get("commit_id", ""))


def described(clone: Path) -> str:
    """The commit of a clone, empty where git does not tell it."""
    command = ["git", "-C", str(clone), "describe", "--always", "--abbrev=40", f"--dirty={CHANGED}", "--exclude=*"]
    try:
        quiet = os.environ | {"GIT_OPTIONAL_LOCKS": "0"}  # it writes nothing
        told = subprocess.run(command, capture_output=True, text=True, timeout=5, check=False, env=quiet)
    except (OSError, subprocess.TimeoutExpired):
        return ""
    return told.stdout.strip() if told.returncode == 0 else ""

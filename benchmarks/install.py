"""What an installation takes on disk, and which dependency brings how much of it.

    python benchmarks/install.py                  of what is installed beside this Python: dependencies, then extras
    python benchmarks/install.py --json           the same as one JSON object

For every dependency two numbers: the files of its own package, and what would go if it were no dependency, that is its
files and those of all packages that nothing else needs. Compiled Python (`__pycache__`) counts where it is there: `pip`
writes it, other installers may not. An extra counts what it adds to the dependencies; packages that are not installed
are named instead of counted.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Collection, Iterable
from functools import cache
from importlib.metadata import Distribution, PackageNotFoundError, distribution
from importlib.util import cache_from_source
from typing import Any

from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

PROJECT = "mmnn_pin"
MB = 1e6


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--json", action="store_true")
    result = measured()
    print(json.dumps(result) if parser.parse_args().json else table(result))


def measured(project: str = PROJECT) -> dict[str, Any]:
    """Megabytes of a project's dependencies, each alone and with what it alone brings, and of its extras."""
    wanted = direct(project)
    core = closure(wanted)
    extras = {extra: closure([*wanted, *direct(project, extra)]) - core for extra in extras_of(project)}
    return {
        "total_mb": megabytes(core),
        "dependencies": {
            name: {"own_mb": megabytes([name]), "only_it_brings_mb": megabytes(core - closure(without(name, wanted)))}
            for name in sorted({plain(one) for one in wanted})
        },
        "extras_mb": {extra: megabytes(added) for extra, added in sorted(extras.items())},
        "not_installed": sorted(name for name in core.union(*extras.values()) if installed(name) is None),
    }


@cache
def installed(name: str) -> Distribution | None:
    """A package that is installed beside this Python."""
    try:
        return distribution(name)
    except PackageNotFoundError:
        return None


def extras_of(project: str) -> Collection[str]:
    """Names of a project's extras."""
    found = installed(project)
    return [] if found is None else found.metadata.get_all("Provides-Extra") or []


@cache
def direct(name: str, extra: str = "") -> frozenset[str]:
    """Packages that one asks for by itself, or for one of its extras: `name`, or `name[extra]`."""
    found = installed(name)
    needed: set[str] = set()
    for text in (found.requires or []) if found else []:
        requirement = Requirement(text)
        if requirement.marker and not requirement.marker.evaluate({"extra": extra}):
            continue
        if extra and (not requirement.marker or requirement.marker.evaluate({"extra": ""})):
            continue  # asked for without the extra, too
        other = canonicalize_name(requirement.name)
        if other == canonicalize_name(name):  # an extra made of others
            needed |= {one for part in requirement.extras for one in direct(name, part)}
        else:
            needed |= {other, *(f"{other}[{part}]" for part in requirement.extras)}
    return frozenset(needed)


def plain(name: str) -> str:
    """The name of a package without its extras."""
    return name.partition("[")[0]


def without(name: str, names: Iterable[str]) -> set[str]:
    """All names but those of one package."""
    return {one for one in names if plain(one) != name}


def closure(names: Iterable[str]) -> set[str]:
    """All packages that come with some, without extras in their names."""
    found: set[str] = set()
    left = list(names)
    while left:
        one = left.pop()
        if one not in found:
            found.add(one)
            package, _, extra = one.rstrip("]").partition("[")
            left += [package, *direct(package, extra)]
    return {plain(name) for name in found}


def megabytes(names: Iterable[str]) -> float:
    """Size of the files of packages, with their compiled Python where it is there."""
    return round(sum(size(name) for name in names) / MB, 1)


@cache
def size(name: str) -> int:
    """Bytes of the files of one package; 0 where it is not installed."""
    found = installed(name)
    paths = {file.locate() for file in (found.files or [])} if found else set()
    paths |= {type(path)(cache_from_source(str(path))) for path in paths if path.suffix == ".py"}
    return sum(path.stat().st_size for path in paths if path.is_file())


def table(result: dict[str, Any]) -> str:
    """The result for people, what costs most first."""
    lines = [
        f"dependencies together: {result['total_mb']:.0f} MB",
        "",
        "dependency [MB]       own  with what only it brings",
    ]
    for name, sizes in sorted(result["dependencies"].items(), key=lambda entry: -entry[1]["only_it_brings_mb"]):
        lines.append(f"{name:18} {sizes['own_mb']:6.1f}  {sizes['only_it_brings_mb']:6.1f}")
    lines += ["", "extra              adds [MB]"]
    lines += [f"{name:18} {mb:6.1f}" for name, mb in sorted(result["extras_mb"].items(), key=lambda entry: -entry[1])]
    if result["not_installed"]:
        lines += ["", "not installed, so not counted: " + ", ".join(result["not_installed"])]
    return "\n".join(lines)


if __name__ == "__main__":
    main()

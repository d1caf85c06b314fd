"""How long a first run takes: commands on an empty cache, in turn with another version of the package.

    python benchmarks/first.py --rounds 3                       this version, four commands
    python benchmarks/first.py --rounds 3 --before FOLDER       in turn with a checkout of another version

Wall clock and processor time of the command and of what it waits for.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from statistics import median

HERE = Path(__file__).parents[1]
COMMANDS = {
    "two_layer": ["chapter4", "--controller", "two_layer"],
    "all six": ["chapter4"],
    "hardware": ["track", "--controller", "two_layer"],
    "adaptive": ["track", "--controller", "adaptive"],
    "kalman_regressor": ["track", "--controller", "kalman_regressor"],
}
CALL = "import sys; from mmnn_pin.cli import main; sys.exit(main())"


def first_run(package: Path, arguments: list[str]) -> tuple[float, float]:
    """Seconds by the clock and of the processor that a command takes with an empty cache."""
    with tempfile.TemporaryDirectory() as folder:
        environment = os.environ | {"PYTHONPATH": str(package), "NUMBA_CACHE_DIR": f"{folder}/cache"}
        environment.pop("PYTHONDONTWRITEBYTECODE", None)
        command = [sys.executable, "-c", CALL, "run", *arguments, "--out", f"{folder}/runs"]
        began = time.perf_counter()
        quiet = subprocess.DEVNULL  # in an empty folder: Python imports from where it stands first
        process = subprocess.Popen(command, cwd=folder, env=environment, stdout=quiet, stderr=quiet)
        _, status, used = os.wait4(process.pid, 0)
        clock = time.perf_counter() - began
        if status:
            sys.exit(f"{' '.join(command)} ended with {status}")
        return clock, used.ru_utime + used.ru_stime


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--before", type=Path, help="a checkout of the version to compare with")
    parser.add_argument("--only", nargs="*", choices=COMMANDS, default=list(COMMANDS))
    options = parser.parse_args()
    versions = {"now": HERE} | ({"before": options.before.resolve()} if options.before else {})
    for name in options.only:
        found: dict[str, list[tuple[float, float]]] = {version: [] for version in versions}
        for _ in range(options.rounds):
            for version, package in versions.items():
                found[version].append(first_run(package, COMMANDS[name]))
        for version, times in found.items():
            clock, processor = ([pair[i] for pair in times] for i in range(2))
            print(
                f"{name:18}{version:8}{median(clock):7.1f} s ({min(clock):.1f} to {max(clock):.1f}),"
                f" processor {median(processor):.1f} s, load {os.getloadavg()[0]:.1f}",
                flush=True,
            )


if __name__ == "__main__":
    main()

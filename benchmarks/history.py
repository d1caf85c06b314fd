"""The ratios of all measurements that were kept, by commit: `python benchmarks/history.py FILE --out PLOT.svg`.

`benchmarks/run.py --history FILE` adds a line to the file: commit, date, machine and ratios, which a noisy machine
spoils less than it spoils times. A ratio's plot begins with the first commit that has it.
"""

from __future__ import annotations

import argparse
import json
import subprocess
from collections.abc import Mapping, Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

HERE = Path(__file__).parent
LESS_IS_BETTER = {
    "file/memory": "recorded to a file, times in memory",
    "compiled/floor": "compiled step, times the C++ floor",
    "loop/compiled": "ordinary step, times the compiled one",
    "whole/compiled": "whole Loop.run, times its steps",
}
MORE_IS_BETTER = {
    "rollouts/floor": "rollouts per second, times the C++ floor",
    "masses/same": "rollouts with other masses, times those without",
    "threads/thread": "rollouts on all threads, times those on one",
}


def main() -> None:
    """Parse the command line, plot."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("file", type=Path, help="what `run.py --history` wrote")
    parser.add_argument("--out", type=Path, default=Path("history.svg"), help="picture to write (history.svg)")
    options = parser.parse_args()
    plot([json.loads(line) for line in options.file.read_text().splitlines()], options.out)


def ratios(result: Mapping[str, Any]) -> dict[str, float]:
    """The ratios of a result of `run.py`, those that it has."""
    us, file, whole = (result[f"us_per_step{key}"] for key in ("", "_file", "_whole_run"))
    rates, floor = result["rollouts_per_s"], result["floor"]
    pairs = {
        "file/memory": (file["compiled"], us["compiled"]),
        "compiled/floor": (us["compiled"], floor.get("us_per_step", {}).get("cpp")),
        "loop/compiled": (us["loop"], us["compiled"]),
        "whole/compiled": (whole["compiled"], us["compiled"]),
        "rollouts/floor": (rates.get("same_all_threads"), floor.get("rollouts_per_s", {}).get("cpp_all_threads")),
        "masses/same": (rates.get("masses_all_threads"), rates.get("same_all_threads")),
        "threads/thread": (rates.get("same_all_threads"), rates.get("same_1_thread")),
    }
    return {name: over / under for name, (over, under) in pairs.items() if over and under}


def append(file: Path, result: Mapping[str, Any]) -> None:
    """Add a result to a history."""
    described = subprocess.run(
        ["git", "describe", "--always", "--dirty"], cwd=HERE, capture_output=True, text=True, check=False
    )
    line = {
        "commit": described.stdout.strip() or "unknown",
        "date": datetime.now(UTC).isoformat(timespec="seconds"),
        "processor": result["machine"]["processor"],
        "load": result["machine"]["load_before_after"],
        "ratios": ratios(result),
    }
    with file.open("a", encoding="utf-8") as out:
        out.write(json.dumps(line) + "\n")


def plot(history: Sequence[Mapping[str, Any]], file: Path) -> None:
    """Draw every ratio over the commits."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(10, 7), layout="constrained")
    for axes, names, better in zip(
        figure.subplots(2, 1), (LESS_IS_BETTER, MORE_IS_BETTER), ("less", "more"), strict=True
    ):
        for name, words in names.items():
            points = [(i, one["ratios"][name]) for i, one in enumerate(history) if name in one["ratios"]]
            if points:
                axes.plot(*zip(*points, strict=True), "o-", label=words)
        axes.set_xticks(range(len(history)), [one["commit"] for one in history], rotation=60)
        axes.set(ylabel=f"ratio, {better} is better")
        axes.grid(alpha=0.3)
        axes.legend(fontsize="small")
    figure.savefig(file)


if __name__ == "__main__":
    main()

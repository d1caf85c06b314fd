"""The three variants of `mmnn run chapter4`, and every reading of the thesis turned alone."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

from mmnn_pin import load_experiment, run_experiment
from mmnn_pin.lab.experiments.files import find, variants
from mmnn_pin.lab.experiments.readings import readings, told
from mmnn_pin.lab.experiments.runner import Result
from mmnn_pin.lab.show.gallery import write_pictures

PICTURES = ("figure-4.2", "figure-4.3", "figure-4.4", "psi", "gains")


def run_variants(folder: Path, say: Callable[[str], None]) -> dict[str, Any]:
    """Run every variant, write its pictures as `VARIANT-NAME.png`, and give the numbers for JSON."""
    found = {}
    for variant in variants(find("chapter4")):
        result = run_experiment(load_experiment("chapter4", variant=variant), "chapter4")
        for name, file in write_pictures(result.recordings, PICTURES, folder).items():
            file.replace(folder / f"{variant}-{name}.png")
        found[variant] = numbers_of(result)
        say(f"variant {variant}: {found[variant]['met']} of {len(found[variant]['intervals'])}")
    return found


def numbers_of(result: Result) -> dict[str, Any]:
    """What the document takes from a variant."""
    told = result.to_dict()
    ranges = told["comparison"]["figure_ranges"]
    kept = ("effective_gain.", "learned_share.", "pose_error.x", "e.arm_1_joint", "z.v")
    metrics = {
        name: {key: value for key, value in run["metrics"].items() if key.startswith(kept)}
        for name, run in told["runs"].items()
    }
    return {
        "intervals": ranges,
        "met": sum(row["inside"] for row in ranges),
        "metrics": metrics,
        "improvement": told["comparison"]["improvement"],
        "unfair": told["comparison"]["unfair"],
        "messages": [run["message"] for run in told["runs"].values() if run["message"]],
    }


def read_otherwise(say: Callable[[str], None]) -> list[dict[str, Any]]:
    """Every switch that the thesis leaves open, turned alone from the default variant."""
    rows = told(readings(load_experiment("chapter4"), "chapter4"))
    say(f"{len(rows)} readings")
    return rows

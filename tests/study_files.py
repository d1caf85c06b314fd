"""What tests of studies share: a short study as a file, and its rows as plain tuples."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

from mmnn_pin.lab.study.execution import fill, missing_trials, probe
from mmnn_pin.lab.study.plan import StudyPlan, plan_of
from mmnn_pin.lab.study.pools import Pool, here
from mmnn_pin.lab.study.settings import load_study
from mmnn_pin.lab.study.store import NAME, TrialResult, reading, writing

SHORT = """
title = "Short"
experiment = "chapter4"
controllers = ["pd", "two_layer", "computed_torque"]
metrics = ["pose_error.[xy].peak", "e.*.peak"]

[set]
time.duration = 0.04
windows = [[0.0, 0.02], [0.02, 0.04]]

[sampling]
method = "sobol"
points = 4
seed = 3

[factors]
"masses.root" = { uniform = [0.5, 1.5] }
"seed" = { integer = [0, 1000] }
"time.control_period" = { grid = [0.001, 0.002] }

[factors.friction]
keys = ["friction.base", "friction.arm"]
log_uniform = [0.2, 5.0]
relative = true

[success]
at_most = { "pose_error.[xy].peak" = 0.03 }
"""


def written(folder: Path, text: str = SHORT, name: str = "short.toml") -> Path:
    """A study's file."""
    folder.mkdir(parents=True, exist_ok=True)
    (folder / name).write_text(text)
    return folder / name


def planned(folder: Path, text: str = SHORT, *overrides: str) -> StudyPlan:
    """Plan of a study's text."""
    return plan_of(load_study(written(folder, text), overrides))


def run_here(plan: StudyPlan, folder: Path, pool: Any = None, force: bool = False) -> list[TrialResult]:
    """Make a study's missing rows and give back all."""
    with writing(folder / NAME) as store, pool or here() as made:
        assert isinstance(made, Pool)
        fill(store, plan, missing_trials(store, plan, probe(plan), force), made)
    return stored(folder)


def stored(folder: Path) -> list[TrialResult]:
    """Results of a study."""
    return reading(folder / NAME).results


def numbers(rows: list[TrialResult]) -> list[tuple[Any, ...]]:
    """What must not depend on where and when a row was made; nan as a text, so that it equals itself."""
    return [
        (
            r.id,
            r.fingerprint,
            r.controller,
            r.seed,
            r.parameters,
            r.status,
            r.time,
            r.signal,
            r.message,
            told(r.metrics),
        )
        for r in rows
    ]


def told(metrics: dict[str, float]) -> dict[str, float | str]:
    """Metrics with nan as a text."""
    return {name: "nan" if math.isnan(value) else value for name, value in metrics.items()}

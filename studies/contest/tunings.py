"""The two searches by name: where, in which spaces, how many tries, and what was found and is kept.

`eight` searches the settings of every learner that its space names, on a robot that does not change, `payload` after it
those that forget and follow on one that picks something up.
"""

from __future__ import annotations

import json
import tomllib
from pathlib import Path
from typing import Any

import msgspec

from mmnn_pin.lab.experiments.cases import with_case
from mmnn_pin.lab.experiments.config import load_experiment
from mmnn_pin.lab.study.factors import Factor
from mmnn_pin.lab.study.keys import at

HERE = Path(__file__).parent
SPACES, TUNED = HERE / "spaces.toml", HERE / "tuned.json"
TRIES = {"eight": 40, "payload": 30}  # sets of settings per learner
TUNINGS = tuple(TRIES)  # each also the case of the contest that takes what was found


def tuning_file(tuning: str) -> Path:
    """The experiment that a search runs."""
    return HERE / "tuning" / f"{tuning}.toml"


def spaces(tuning: str) -> dict[str, dict[str, Factor]]:
    """What is searched for each learner."""
    content = tomllib.loads(SPACES.read_text(encoding="utf-8"))
    return msgspec.convert(content[tuning], dict[str, dict[str, Factor]])


def tuned() -> dict[str, dict[str, Any]]:
    """What was found and is kept: tuning and learner to their search."""
    kept = json.loads(TUNED.read_text(encoding="utf-8")) if TUNED.exists() else {}
    return {tuning: kept.get(tuning, {}) for tuning in TUNINGS}


def keep(tuning: str, learner: str, found: dict[str, Any]) -> None:
    """Keep a search beside what is there."""
    content = tuned()
    content[tuning][learner] = found
    TUNED.write_text(json.dumps(content, indent=1) + "\n", encoding="utf-8")


def taken(tuning: str, learner: str) -> dict[str, Any]:
    """What the contest's case says of what was searched for a learner: key path to value."""
    table = json.loads(with_case(load_experiment("contest"), tuning).to_json())
    return {path: at(table, path) for path in tuned()[tuning][learner]["settings"]}

"""The experiment that a study varies: that of its file with the study's changes, as a table with all defaults."""

from __future__ import annotations

from typing import Any

import msgspec

from ...errors import ConfigError, InputError
from ...model.robot import bodies_of
from ..experiments.config import config_error
from ..experiments.experiment import Experiment
from .bundle import load_once
from .factors import Factor
from .keys import changed, deep, flat, require_path
from .reading import StudyFile

# Keys that change no number of a run; a study does not vary them. Its rows are judged by its own `success`.
COSMETIC = (
    *("title", "variant", "controllers", "plots", "torque_limits", "weights_interval"),
    *("cases", "tolerance", "contest"),
)


def changed_base(study: StudyFile) -> tuple[dict[str, Any], Experiment]:
    """The study's experiment with the changes in `set`, as a table with all defaults and as an experiment."""
    table = deep(msgspec.to_builtins(study.base)) | {"cases": {}}
    expand_masses(table, [*(path for path, _ in flat(study.settings.set)), *paths_of(study.settings.factors)], study)
    known = {key: value for key, value in table.items() if key not in COSMETIC}
    for path, value in flat(study.settings.set):
        with study.placing():
            require_path(known, path, f"set.{path}")
            changed(table, path, value)
    try:
        return table, msgspec.convert(table, Experiment)
    except (msgspec.ValidationError, InputError) as error:
        what, why, fix, key = told(error, table)
        raise study.placed(ConfigError(what, why=why, fix=fix, key=f"set.{key}")) from None


def told(error: InputError | msgspec.ValidationError, table: dict[str, Any]) -> tuple[str, str, str, str]:
    """What, why, fix and key of an error about an experiment."""
    found = error if isinstance(error, InputError) else config_error(error, None, table)
    return found.what, found.why, found.fix, found.key or ""


def expand_masses(table: dict[str, Any], paths: list[str], study: StudyFile) -> None:
    """One factor for all bodies as one per body, where single bodies are to be changed."""
    if isinstance(table["masses"], dict) or not any(path.startswith("masses.") for path in paths):
        return
    try:
        robot = load_once(study.base.robot, study.base.overrides)
    except InputError as error:
        error.file = error.file or study.path
        raise
    table["masses"] = dict.fromkeys(bodies_of(robot.model), float(table["masses"]))


def paths_of(factors: dict[str, Factor]) -> list[str]:
    """Key paths that factors change."""
    return [path for name, factor in factors.items() for path in factor.keys or (name,)]

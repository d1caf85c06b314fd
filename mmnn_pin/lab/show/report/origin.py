"""Where the runs come from: the command that makes them again, what differs from the bundled experiment, versions."""

from __future__ import annotations

import json
import shlex
from collections.abc import Iterator, Mapping
from typing import Any

import msgspec

from ....errors import InputError
from ....recording.recording import Recording
from ...experiments.config import bundled, load_experiment
from ...experiments.experiment import Experiment
from ...experiments.runner import Result

OWN = ("variant", "overrides", "title")  # keys that no `--set` changes


def command_of(result: Result) -> str:
    """The command that makes these runs again; empty where none does, such as for an experiment of a file."""
    if result.name not in bundled() or not all(recording.config_text for recording in result.recordings.values()):
        return ""
    experiment = result.experiment
    try:
        settings = changes(load_experiment(result.name, (), experiment.variant or None), experiment)
        again = load_experiment(result.name, settings, experiment.variant or None)
        default = load_experiment(result.name).variant
    except InputError:
        return ""
    if msgspec.structs.replace(again, overrides=experiment.overrides) != experiment:
        return ""
    variant = ["--variant", experiment.variant] if experiment.variant not in ("", default) else []
    return shlex.join(["mmnn", "run", result.name, *variant, *(p for text in settings for p in ("--set", text))])


def changes(one: Experiment, other: Experiment) -> list[str]:
    """What `--set` makes of one experiment another, as `key.path=value`."""
    before, after = (flat(msgspec.to_builtins(experiment)) for experiment in (one, other))
    return [
        f"{key}={json.dumps(value)}" for key, value in after.items() if before.get(key) != value and value is not None
    ]


def flat(table: Mapping[str, Any], path: str = "") -> dict[str, Any]:
    """Values of a table of tables by key path."""
    found: dict[str, Any] = {}
    for key, value in table.items():
        if isinstance(value, dict) and value:
            found |= flat(value, f"{path}{key}.")
        elif path or key not in OWN:
            found[path + key] = value
    return {key: value for key, value in found.items() if not key.startswith("overrides.")}


def facts_of(recordings: Mapping[str, Recording]) -> Iterator[tuple[str, str]]:
    """Facts with their names, once where all runs share them, else per run."""
    metas = {name: recording.meta for name, recording in recordings.items()}
    made = sorted(str(meta["created"]) for meta in metas.values() if "created" in meta)
    if made:
        yield "made", made[0] if made[0] == made[-1] else f"{made[0]} to {made[-1]}"
    keys = {"seed": "seed", "control_period": "control period [s]", "loop": "loop", "plant": "plant"}
    keys |= {"urdf_sha256": "sha256 of the URDF"}
    for key, words in keys.items():
        yield words, shared({name: str(meta.get(key, "-")) for name, meta in metas.items()})
    yield "samples", shared({name: f"{len(recording):,}" for name, recording in recordings.items()})
    yield (
        "files",
        ", ".join(recording.path.name if recording.path else "in memory" for recording in recordings.values()),
    )
    versions = {name: meta.get("versions", {}) for name, meta in metas.items()}
    yield "versions", shared({name: ", ".join(f"{k} {v}" for k, v in told.items()) for name, told in versions.items()})


def shared(facts: Mapping[str, str]) -> str:
    """One fact for all runs, or one per run."""
    return (
        next(iter(facts.values())) if len(set(facts.values())) == 1 else "; ".join(f"{k} {v}" for k, v in facts.items())
    )

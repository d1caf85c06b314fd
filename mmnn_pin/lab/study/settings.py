"""A study's TOML: its keys as settings, and the reader that reports whatever is wrong with file, line and key."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, TypeVar

import msgspec

from ...errors import ConfigError, InputError, UnknownName, keyed
from ...files import read_toml
from ...settings import Settings
from ...settings.arguments import unknown_key, wrong_type
from ..experiments.config import bundled, load_experiment, override, words_of
from ..experiments.controllers import CONTROLLERS
from ..experiments.experiment import Experiment
from ..experiments.origins import placed
from .factors import Factor

MOST = 10_000_000  # runs of one study


class Sampling(Settings, frozen=True):
    """How factors with a distribution are drawn.

    Args:
        method: "sobol", "lhs" (Latin hypercube) or "random".
        points: Number of draws; each is run with every value of the grid, seed and controller.
        seed: Seed of the draws.
    """

    method: Literal["sobol", "lhs", "random"] = "sobol"
    points: int = 0
    seed: int = 0

    def __post_init__(self) -> None:
        if not 0 <= self.seed < 2**63:
            raise ConfigError(f"{self.seed}", fix="use an integer from 0 to 2^63 - 1", key="seed")
        if not 0 <= self.points <= MOST:
            raise ConfigError(f"{self.points} points", fix=f"use a number from 1 to {MOST}", key="points")


class Success(Settings, frozen=True):
    """When a run is a success: it completed, and every metric named is at most its bound.

    Args:
        at_most: Metric to bound; `*` in a name stands for anything, and the largest counts.
        wanted: Share of successes that is asked of a region of the factors, for the verdict.
    """

    at_most: dict[str, float] = msgspec.field(default_factory=dict)
    wanted: float = 0.95

    def __post_init__(self) -> None:
        for name, bound in self.at_most.items():
            if not math.isfinite(bound):
                raise ConfigError(f"{bound}", fix="use a finite number", key=f"at_most.{name}")
        if not 0 < self.wanted < 1:
            raise ConfigError(f"{self.wanted}", fix="use a share between 0 and 1", key="wanted")


class Tune(Settings, frozen=True):
    """Settings of a search for gains by `mmnn tune`.

    Args:
        controller: The controller whose gains are tuned.
        gains: Key path of the experiment to its bounds, as a factor: `uniform`, `log_uniform`, `integer` or `choice`.
        objective: Metric to minimise, as in `metrics`.
        quantile: The quantile of the objective over the study's points; a run that did not complete counts as worst.
        trials: Sets of gains to try, the experiment's own first.
        check: Fresh points on which the best gains are compared with the experiment's own afterwards.
        sampler: "tpe", "cmaes" or "random" of Optuna.
        seed: Seed of the sampler.
    """

    controller: str
    gains: dict[str, Factor]
    objective: str
    quantile: float = 0.9
    trials: int = 100
    check: int = 64
    sampler: Literal["tpe", "cmaes", "random"] = "tpe"
    seed: int = 0

    def __post_init__(self) -> None:
        if not self.gains:
            raise ConfigError("no gains to tune", fix="add [tune.gains] with bounds", key="gains")
        for name, gain in self.gains.items():
            if gain.kind not in ("uniform", "log_uniform", "integer", "choice"):
                fix = "use uniform, log_uniform, integer or choice"
                raise ConfigError(f"a gain has no {gain.kind}", fix=fix, key=f"gains.{name}")
        if not 0 < self.quantile <= 1:
            raise ConfigError(f"{self.quantile}", fix="use a number above 0, up to 1", key="quantile")
        for key, least, most in (("trials", 1, MOST), ("check", 0, MOST), ("seed", 0, 2**63 - 1)):
            if not least <= getattr(self, key) <= most:
                raise ConfigError(f"{getattr(self, key)}", fix=f"use a number from {least} to {most}", key=key)


class StudySettings(Settings, frozen=True):
    """Everything that defines a study; see docs/how-to/studies.md and examples/robustness.toml.

    Args:
        experiment: A bundled experiment, or the path of one from the study's folder.
        title: One line for tables and pages.
        variant: Variant of the experiment.
        controllers: Which controllers: names, or `FILE.py:Class` for a class of a user; the experiment's by default.
        seeds: Seeds, or how many, counted from the experiment's own.
        model: What model-based controllers and gains scaled by inertia are made from: the "nominal" robot, with the
            masses and friction of the experiment, or the "true" one of each run.
        metrics: Metrics to show and to report; `*` and `[xy]` are as in a shell, and the largest that fits counts.
            None for the peaks of the errors and the effort. All metrics are stored.
        set: Changes to the experiment, key path to value.
        factors: The factors that are varied, by name; the name is the key path, unless the factor names `keys`.
        sampling: How factors with a distribution are drawn.
        success: When a run is a success.
        tune: What to tune.

    Raises:
        UnknownName: A controller that does not exist.
        ConfigError: No seeds or one twice, no controllers; points without drawn factors, or the other way round.
    """

    experiment: str
    title: str = ""
    variant: str | None = None
    controllers: tuple[str, ...] | None = None
    seeds: int | tuple[int, ...] = 1
    model: Literal["nominal", "true"] = "nominal"
    metrics: tuple[str, ...] | None = None
    set: dict[str, Any] = msgspec.field(default_factory=dict)
    factors: dict[str, Factor] = msgspec.field(default_factory=dict)
    sampling: Sampling = Sampling()
    success: Success = Success()
    tune: Tune | None = None

    def __post_init__(self) -> None:
        if self.controllers == ():
            fix = f"choose from: {', '.join(CONTROLLERS)}"
            raise ConfigError("no controllers, so no runs", fix=fix, key="controllers")
        if len(set(self.controllers or ())) < len(self.controllers or ()):
            raise ConfigError("a controller appears twice", fix="name each once", key="controllers")
        count = self.seeds if isinstance(self.seeds, int) else len(self.seeds)
        if count < 1:
            raise ConfigError("no seeds, so no runs", fix="give at least one", key="seeds")
        if isinstance(self.seeds, tuple) and len(set(self.seeds)) < count:
            raise ConfigError("a seed appears twice", fix="name each once", key="seeds")
        if self.seeds != 1 and any("seed" in factor.paths(name) for name, factor in self.factors.items()):
            raise ConfigError("the seed is a factor, too", fix="leave one of them out", key="seeds")
        drawn = [name for name, factor in self.factors.items() if factor.drawn]
        if drawn and not self.sampling.points:
            what = "no points, so no runs"
            raise ConfigError(what, why=f"{drawn[0]} is drawn", fix="say how many draws", key="sampling.points")
        if self.sampling.points and not drawn:
            what = f"{self.sampling.points} points of nothing"
            fix = "leave them out, or give a factor a distribution"
            raise ConfigError(what, why="no factor is drawn", fix=fix, key="sampling.points")


PARTS: dict[str, type[Settings]] = {"sampling": Sampling, "success": Success, "tune": Tune}
S = TypeVar("S", bound=Settings)


@dataclass(frozen=True)
class StudyFile:
    """A study as its file has it."""

    settings: StudySettings  # what it says
    base: Experiment  # the experiment that it varies, without the study's changes
    path: Path  # the file

    @property
    def name(self) -> str:
        """Its name: that of the file."""
        return self.path.stem

    def placed(self, error: InputError) -> InputError:
        """An error about a key of this study, with file and line."""
        return placed(error, self.path)


def load_study(path: str | Path, overrides: Iterable[str] = ()) -> StudyFile:
    """Study of a TOML file.

    Args:
        path: The file.
        overrides: `key.path=value` texts that change keys of the file.

    Raises:
        InputError: The file cannot be read or is not TOML; a key is unknown, a value of the wrong type or out of
            range; the experiment does not load. With the line, where it is about the file.
    """
    path = Path(path)
    if not path.is_file():
        raise ConfigError("no such file", fix="name the TOML file of a study", file=path)
    table = read_toml(path)
    with placing(path):
        for text in overrides:
            override(table, text)
        settings = settings_of(table)
        return StudyFile(settings, base_of(settings, path), path)


def settings_of(table: dict[str, Any]) -> StudySettings:
    """Settings of a table read from TOML.

    Raises:
        InputError: With the key path, without the file.
    """
    tune = table.get("tune", {})
    groups = {
        "factors": table.get("factors", {}),
        "tune.gains": tune.get("gains", {}) if isinstance(tune, dict) else {},
    }
    parts: list[tuple[str, Any, type[Settings]]] = []
    for prefix, group in groups.items():
        parts += [(f"{prefix}.{n}", factor, Factor) for n, factor in (group.items() if isinstance(group, dict) else ())]
    parts += [(name, table.get(name), kind) for name, kind in PARTS.items()]  # after the factors in them
    for prefix, content, kind in parts:
        if isinstance(content, dict):
            with keyed(lambda key, prefix=prefix: joined(prefix, key)):  # type: ignore[misc]
                part(content, kind)
    return part(table, StudySettings)


def part(table: dict[str, Any], kind: type[S]) -> S:
    """A part of the settings; errors name the key path within it."""
    try:
        return msgspec.convert(table, kind)
    except msgspec.ValidationError as error:
        message, _, where = str(error).partition(" - at ")
        inner = re.sub(r"^\$\.?", "", where.strip("`"))
        if not inner and (unknown := unknown_key(error)) is not None:
            if kind is StudySettings and unknown in Experiment.__struct_fields__:
                why, fix = "it is one of the experiment's", f"write it below [set], or as set.{unknown}"
                raise ConfigError(f"unknown key '{unknown}'", why=why, fix=fix, key=unknown) from None
            raise UnknownName("key", unknown, kind.__struct_fields__) from None
        known = words_of({field.name: field.type for field in msgspec.structs.fields(kind)}.get(inner))
        what, fix = wrong_type(message, table.get(inner))
        fix = f"there is: {', '.join(known)}" if known else fix
        raise ConfigError(what, fix=fix, key=inner) from None


def joined(*parts: str) -> str:
    """Key path of parts, some of them empty."""
    return ".".join(part for part in parts if part)


@contextmanager
def placing(path: Path) -> Iterator[None]:
    """Errors within are about keys of a study's file."""
    try:
        yield
    except InputError as error:
        raise placed(error, path) from None


def base_of(settings: StudySettings, path: Path) -> Experiment:
    """The experiment that a study varies, with the study's controllers: bundled, or a file in the study's folder.

    Raises:
        InputError: It does not load, or does not know a controller.
    """
    name: str | Path = settings.experiment
    if settings.experiment not in bundled():
        beside = path.parent / settings.experiment
        if not beside.is_file():
            fix = f"name a file from the study's folder, or one of: {', '.join(bundled())}"
            raise ConfigError(f"no experiment '{settings.experiment}'", fix=fix, key="experiment")
        name = beside
    experiment = load_experiment(name, (), settings.variant)
    if settings.controllers is not None:
        experiment = msgspec.structs.replace(experiment, controllers=settings.controllers)
    if settings.tune is not None and settings.tune.controller not in (there := {**CONTROLLERS, **experiment.laws}):
        raise UnknownName("controller", settings.tune.controller, there, key="tune.controller")
    return experiment

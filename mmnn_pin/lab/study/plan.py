"""The runs of a study: points of the factors, times seeds, times controllers; every run has a number and a fingerprint.

The experiment that they vary is that of the study's file with the study's changes, as a table with all defaults. A run
is made from its number alone, so that any machine and any later session makes the same one.
"""

from __future__ import annotations

import hashlib
import itertools
import json
import math
from collections.abc import Iterable
from contextlib import suppress
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import msgspec
import numpy as np

from ...errors import ConfigError, InputError
from ...model.structure import bodies_of
from ..experiments.config import config_error, on_other_hardware
from ..experiments.experiment import Experiment
from ..experiments.laws import LAW, digest_of, name_of
from .factors import Factor, unit_cube
from .keys import changed, deep, flat, require_path
from .settings import MOST, StudyFile, StudySettings, placing
from .worker import Bundle, Trial, code_digest, load_once

# Keys that change no number of a run; a study does not vary them. Its rows are judged by its own `success`.
COSMETIC = (
    *("title", "variant", "controllers", "plots", "torque_limits", "weights_interval"),
    *("cases", "tolerance"),
)
ROBOT = ("robot", "overrides")  # decide which robot is loaded
KINDS = {field.name: field.type for field in msgspec.structs.fields(Experiment)}
BODIES = "masses."  # begins the paths of single bodies
TRUTH = ("masses", "friction")  # of the true robot only, where the model is nominal


@dataclass(frozen=True, eq=False)
class StudyPlan:
    """All runs of a study."""

    study: StudyFile  # the study
    base: Experiment  # its experiment with the study's changes, without its factors
    table: dict[str, Any] = field(repr=False)  # the same as a table, with all defaults
    points: tuple[dict[str, Any], ...] = field(repr=False)  # factor to value, of every point
    controllers: tuple[str, ...]  # of every point
    seeds: tuple[int | None, ...]  # of every point; None where the seed is a factor
    bundles: dict[Any, Bundle] = field(default_factory=dict, init=False, repr=False)  # files of the robots met so far

    def __len__(self) -> int:
        return len(self.points) * len(self.seeds) * len(self.controllers)

    @cached_property
    def fingerprints(self) -> tuple[str, ...]:
        """Fingerprint of every run, in order."""
        found: list[str] = []
        for point, seed in itertools.product(self.points, self.seeds):
            experiment, settings = self.experiment(point, seed)
            found += [self.fingerprint(experiment, settings, controller) for controller in self.controllers]
        return tuple(found)

    @cached_property
    def digest(self) -> str:
        """Hash of all fingerprints."""
        return hashlib.sha256(" ".join(self.fingerprints).encode()).hexdigest()

    def trial(self, i: int) -> Trial:
        """Run i.

        Raises:
            ConfigError: There is none of that number.
        """
        if not 0 <= i < len(self):
            fix = f"use one from 0 to {len(self) - 1}"
            raise ConfigError(f"there is no row {i}", fix=fix, file=self.study.path, key="--row")
        shape = len(self.points), len(self.seeds), len(self.controllers)
        point, which_seed, which_controller = map(int, np.unravel_index(i, shape))
        controller, parameters = self.controllers[which_controller], self.points[point]
        common, settings = self.experiment(parameters, self.seeds[which_seed])
        experiment = msgspec.structs.replace(common, controllers=(controller,))
        return Trial(
            id=i,
            point=point,
            controller=controller,
            seed=experiment.seed,
            parameters=parameters,
            experiment=experiment,
            nominal=self.nominal(experiment),
            fingerprint=self.fingerprint(common, settings, controller),
            code=code_digest(),
        )

    def experiment(self, parameters: dict[str, Any], seed: int | None) -> tuple[Experiment, dict[str, Any]]:
        """The experiment at values of the factors, and the settings that the factors gave it.

        Raises:
            InputError: The values make no experiment; with the factors' values.
        """
        table, settings = self.table_at(parameters, seed)
        tops = {path.partition(".")[0] for path in settings}
        with suppress(msgspec.ValidationError, InputError):  # the whole table tells where it is wrong
            return msgspec.structs.replace(
                self.base, **{key: msgspec.convert(table[key], KINDS[key]) for key in tops}
            ), settings
        try:
            return msgspec.convert(table, Experiment), settings
        except (msgspec.ValidationError, InputError) as error:
            raise self.no_experiment(parameters, table, error) from None

    def table_at(self, parameters: dict[str, Any], seed: int | None) -> tuple[dict[str, Any], dict[str, Any]]:
        """The table at values of the factors, its parts that no factor changes shared, and what the factors changed.

        Raises:
            InputError: A value cannot be put in; with the factors' values.
        """
        settings: dict[str, Any] = {} if seed is None else {"seed": seed}
        tops = {path.partition(".")[0] for path in paths_of(self.study.settings.factors)}
        table = self.table | {key: deep(self.table[key]) for key in tops if key in self.table}
        try:
            for name, value in parameters.items():
                factor = self.study.settings.factors[name]
                for path in factor.paths(name):
                    settings[path] = changed(table, path, value, factor.relative)
            if seed is not None:
                table["seed"] = seed
            return table, settings
        except InputError as error:
            raise self.no_experiment(parameters, table, error) from None

    def no_experiment(
        self, parameters: dict[str, Any], table: dict[str, Any], error: InputError | msgspec.ValidationError
    ) -> InputError:
        """Why values of the factors make no experiment, at the key of the factor that is nearest to it."""
        what, why, fix, key = parts_of(error, table)
        factors = self.study.settings.factors
        blamed = [n for n in parameters for path in factors[n].paths(n) if touches(path, key)]
        values = ", ".join(f"{name} = {short(value)}" for name, value in parameters.items())
        found = ConfigError(
            f"{key}: {what}" if key else what,
            why="; ".join(part for part in (why, f"at {values}") if part),
            fix=fix,
            key=f"factors.{(blamed or list(parameters) or [''])[0]}",
        )
        return self.study.placed(found)

    def blamed(self, error: InputError) -> InputError:
        """An error of a run, at the key of the factor or change of the study that it is about, if it is about one."""
        if error.file is None and error.key:
            names = [n for n, f in self.study.settings.factors.items() for p in f.paths(n) if touches(p, error.key)]
            changes = [path for path, _ in flat(self.study.settings.set) if touches(path, error.key)]
            keys = [*(f"factors.{n}" for n in names), *(f"set.{path}" for path in changes)]
            return self.study.placed(error.but(key=keys[0])) if keys else error
        return error

    def nominal(self, experiment: Experiment) -> Experiment | None:
        """The experiment whose robot a controller is made for; None for the true one."""
        if self.study.settings.model == "true":
            return None
        believed = msgspec.structs.replace(experiment, **{key: getattr(self.base, key) for key in TRUTH})
        return None if believed == experiment else believed

    def fingerprint(self, experiment: Experiment, settings: dict[str, Any], controller: str) -> str:
        """Hash of what decides a run's numbers."""
        robot = self.bundle(experiment).digest
        parts: list[Any] = [self._base_digest, self.study.settings.model, robot, controller, sorted(settings.items())]
        parts += [digest_of(self.base.laws[controller][LAW])] if controller in self.base.laws else []
        return hashlib.sha256(json.dumps(parts).encode()).hexdigest()[:32]

    def bundle(self, experiment: Experiment) -> Bundle:
        """Files of an experiment's robot."""
        key = (experiment.robot, experiment.overrides)
        if key not in self.bundles:
            self.bundles[key] = Bundle.of(*key)
        return self.bundles[key]

    @cached_property
    def _base_digest(self) -> str:
        kept = {key: value for key, value in self.table.items() if key not in (*COSMETIC, *ROBOT, "seed")}
        return hashlib.sha256(json.dumps(kept, sort_keys=True).encode()).hexdigest()


def plan_of(study: StudyFile, *, sampling_seed: int | None = None, points: int | None = None) -> StudyPlan:
    """The runs of a study, every point judged.

    Args:
        study: The study.
        sampling_seed: Seed of the draws in place of the study's.
        points: Number of draws in place of the study's.

    Raises:
        InputError: A change or a factor names no setting, or a point makes no experiment; with the line.
    """
    settings = study.settings
    table, base = changed_base(study)
    known = {key: value for key, value in table.items() if key not in COSMETIC}
    for name, factor in settings.factors.items():
        for i, path in enumerate(factor.paths(name)):
            key = f"factors.{name}.keys.{i}" if factor.keys else f"factors.{name}"
            with placing(study.path):
                require_path(known, path, key)
            if touches(path, "hardware"):
                why, fix = "all else follows from it", "give every hardware a study, or a case of an experiment"
                raise study.placed(ConfigError("hardware is no factor", why=why, fix=fix, key=key))
    method, seed = settings.sampling.method, settings.sampling.seed if sampling_seed is None else sampling_seed
    count = settings.sampling.points if points is None or not settings.sampling.points else points
    controllers = tuple(map(name_of, settings.controllers)) if settings.controllers else base.controllers
    if (runs := count_of(settings, count, len(controllers))) > MOST:
        what, fix = f"{runs} runs", f"at most {MOST} are taken"
        raise study.placed(ConfigError(what, fix=fix, key="sampling.points"))
    made = points_of(settings.factors, method, count, seed)
    plan = StudyPlan(study, base, table, made, controllers, seeds_of(settings.seeds, base.seed, settings.factors))
    for point in plan.points:
        plan.experiment(point, plan.seeds[0])
    return plan


def count_of(settings: StudySettings, draws: int, controllers: int) -> int:
    """Number of runs of a study with so many draws and controllers, none of which is made."""
    factors = settings.factors.values()
    draws = max(draws, 1) if any(factor.drawn for factor in factors) else 1
    seeds = settings.seeds if isinstance(settings.seeds, int) else len(settings.seeds)
    return draws * math.prod(len(factor.grid) for factor in factors if factor.grid) * seeds * controllers


def points_of(factors: dict[str, Factor], method: str, count: int, seed: int) -> tuple[dict[str, Any], ...]:
    """Values of all factors at all points: every draw with every cell of the grid."""
    drawn = [name for name, factor in factors.items() if factor.drawn]
    grid = [name for name in factors if name not in drawn]
    cells = list(itertools.product(*(factors[name].grid or () for name in grid)))
    draws = unit_cube(method, max(count, 1), len(drawn), seed) if drawn else np.zeros((1, 0))
    points = []
    for draw in draws:
        values = {name: factors[name].value(float(u)) for name, u in zip(drawn, draw, strict=True)}
        both = (values | dict(zip(grid, cell, strict=True)) for cell in cells)
        points += [{name: every[name] for name in factors} for every in both]
    return tuple(points)


def seeds_of(seeds: int | tuple[int, ...], first: int, factors: dict[str, Factor]) -> tuple[int | None, ...]:
    """Seeds of every point."""
    if "seed" in paths_of(factors):
        return (None,)
    return tuple(range(first, first + seeds)) if isinstance(seeds, int) else seeds


def changed_base(study: StudyFile) -> tuple[dict[str, Any], Experiment]:
    """The study's experiment with the changes in `set`, as a table with all defaults and as an experiment."""
    table = deep(msgspec.to_builtins(study.base)) | {"cases": {}}
    given = list(flat(study.settings.set))
    of_bodies = [(path, value) for path, value in given if path.startswith(BODIES)]  # of the robot that the rest says
    set_values(table, [one for one in given if one not in of_bodies], study)
    if of_bodies or any(path.startswith(BODIES) for path in paths_of(study.settings.factors)):
        expand_masses(table, study)
    set_values(table, of_bodies, study)
    if table["hardware"] != msgspec.to_builtins(study.base.hardware):
        try:
            made = on_other_hardware(study.base, table, nested(given))
        except (msgspec.ValidationError, InputError) as error:
            raise not_set(error, table, study) from None
        return deep(msgspec.to_builtins(made)), made
    return table, experiment_of(table, study)


def set_values(table: dict[str, Any], given: Iterable[tuple[str, Any]], study: StudyFile) -> None:
    """Write values into an experiment's table.

    Raises:
        UnknownName: A path that names nothing.
    """
    known = {key: value for key, value in table.items() if key not in COSMETIC}
    for path, value in given:
        with placing(study.path):
            require_path(known, path, f"set.{path}")
            changed(table, path, value)


def experiment_of(table: dict[str, Any], study: StudyFile) -> Experiment:
    """A study's experiment from its table.

    Raises:
        ConfigError: A value that cannot be, with its place in `set`.
    """
    try:
        return msgspec.convert(table, Experiment)
    except (msgspec.ValidationError, InputError) as error:
        raise not_set(error, table, study) from None


def not_set(error: InputError | msgspec.ValidationError, table: dict[str, Any], study: StudyFile) -> InputError:
    """An error of a table, at its place in `set`."""
    what, why, fix, key = parts_of(error, table)
    return study.placed(ConfigError(what, why=why, fix=fix, key=f"set.{key}"))


def nested(given: Iterable[tuple[str, Any]]) -> dict[str, Any]:
    """Key paths and their values as tables in tables."""
    found: dict[str, Any] = {}
    for path, value in given:
        here, (*above, last) = found, path.split(".")
        for name in above:
            here = here.setdefault(name, {})
        here[last] = value
    return found


def parts_of(error: InputError | msgspec.ValidationError, table: dict[str, Any]) -> tuple[str, str, str, str]:
    """What, why, fix and key of an error about an experiment."""
    ours = error if isinstance(error, InputError) else config_error(error, table)
    return ours.what, ours.why, ours.fix, ours.key or ""


def expand_masses(table: dict[str, Any], study: StudyFile) -> None:
    """One factor for all bodies as one per body of the robot that a table names; nothing where that is done.

    Raises:
        InputError: The robot cannot be loaded.
    """
    if isinstance(table["masses"], dict):
        return
    made = experiment_of(table, study)
    try:
        robot = load_once(made.robot, made.overrides)
    except InputError as error:
        raise error.but(file=error.file or study.path) from None
    table["masses"] = dict.fromkeys(bodies_of(robot.model), float(table["masses"]))


def paths_of(factors: dict[str, Factor]) -> list[str]:
    """Key paths that factors change."""
    return [path for name, factor in factors.items() for path in factor.paths(name)]


def short(value: Any) -> str:
    """A value in few digits."""
    return f"{value:.4g}" if isinstance(value, float) else str(value)


def touches(path: str, key: str) -> bool:
    """Whether one of two key paths starts with the other."""
    return f"{path}.".startswith(f"{key}.") or f"{key}.".startswith(f"{path}.")

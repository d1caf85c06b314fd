"""Looks for gains with Optuna; every trial is stored, so that the search goes on where it was stopped."""

from __future__ import annotations

import hashlib
import json
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType
from typing import Any

import msgspec

from ... import __version__
from ...errors import ConfigError, StudyError
from ..experiments.config import value_at
from .execution import Pool
from .factors import Factor
from .keys import require_path
from .objective import Score, Scorer, settings_of
from .plan import changed_base
from .settings import StudyFile, Tune
from .store import locked

NAME = "tune.sqlite"
FRESH = 7919  # added to the seed of the draws for those that judge the result


@dataclass(frozen=True)
class Tuned:
    """What a search found.

    Attributes:
        tune: What was looked for.
        trials: Sets of gains that were tried.
        refused: Of them, those that broke a constraint.
        own: Value of the experiment's own gains; None where they have none within the bounds.
        best: The best gains, key path to value.
        value: Their value on the study's draws.
        fresh: Scores of the own and of the best gains on fresh draws; None where none were asked for.
    """

    tune: Tune
    trials: int
    refused: int
    own: float | None
    best: dict[str, Any]
    value: float
    fresh: tuple[Score, Score] | None


def tuned_part(study: StudyFile) -> Tune:
    """What a study says about tuning, its keys judged.

    Raises:
        InputError: It says nothing, or names a gain that does not exist; with the line.
    """
    tune = study.settings.tune
    if tune is None:
        fix = "add [tune] and [tune.gains], see docs/studies.md"
        raise study.placed(ConfigError("nothing to tune", fix=fix, key="tune"))
    table, _ = changed_base(study)
    with study.placing():
        for name, gain in tune.gains.items():
            for path in gain.keys or (name,):
                require_path(table, path, f"tune.gains.{name}")
            try:
                settings_of({name: gain.value(0.5)}, tune.gains, table)
            except ConfigError as error:
                error.key = f"tune.gains.{name}"
                raise
    return tune


def search(
    study: StudyFile,
    folder: Path,
    pool: Pool,
    *,
    force: bool = False,
    progress: Callable[[int, float], None] = lambda done, best: None,
) -> None:
    """Try sets of gains until there are as many as the study asks for.

    Args:
        study: The study.
        folder: For the database of the trials.
        pool: Makes the runs.
        force: Start anew where the trials in the database are of other settings.
        progress: Called after each trial with the number of trials and the best value.

    Raises:
        StudyError: Optuna is not installed, another process searches, or the trials are of other settings.
        MmnnError: The pool is lost.
    """
    optuna, tune = imported(), tuned_part(study)
    scorer = Scorer(study, tune, pool)
    with locked(folder / NAME), opened(optuna, study, folder / NAME, force) as trials:
        table, _ = changed_base(study)
        for trial in trials.get_trials(states=(optuna.trial.TrialState.RUNNING,)):  # of a process that was killed
            trials.tell(trial.number, state=optuna.trial.TrialState.FAIL)
        while (done := len(finished(optuna, trials))) < tune.trials:
            own = own_gains(tune.gains, table)
            if not done and own is not None:
                trials.enqueue_trial(own)
            trials.sampler = sampler(optuna, tune, done)
            trial = trials.ask()
            drawn = {name: suggested(trial, name, gain) for name, gain in tune.gains.items()}
            try:
                score = scorer.score(settings_of(drawn, tune.gains, table))
            except BaseException:
                trials.tell(trial, state=optuna.trial.TrialState.FAIL)
                raise
            trial.set_user_attr("lost", score.lost)
            trial.set_user_attr("refused", score.complaint)
            trial.set_user_attr("own", not done and own is not None)
            trials.tell(trial, score.value)
            progress(done + 1, trials.best_value)


def result(study: StudyFile, folder: Path, pool: Pool | None) -> Tuned:
    """What the trials so far have found, judged on fresh draws.

    Args:
        study: The study.
        folder: Of the database.
        pool: Makes the runs on fresh draws; None for no such judgement.

    Raises:
        StudyError: There are no trials.
    """
    optuna, tune = imported(), tuned_part(study)
    with opened(optuna, study, folder / NAME, False) as trials:
        done = finished(optuna, trials)
        if not done:
            raise StudyError("no trial has finished", file=folder / NAME)
        best = min(done, key=lambda trial: trial.value)
    table, _ = changed_base(study)
    gains = settings_of(best.params, tune.gains, table)
    own = next((trial.value for trial in done if trial.user_attrs.get("own")), None)
    fresh = None
    if pool is not None and tune.check and study.settings.sampling.points:
        scorer = Scorer(study, tune, pool, tune.check, study.settings.sampling.seed + FRESH)
        fresh = scorer.score({}), scorer.score(gains)
    refused = sum(bool(trial.user_attrs.get("refused")) for trial in done)
    return Tuned(tune, len(done), refused, own, gains, best.value, fresh)


def finished(optuna: ModuleType, trials: Any) -> list[Any]:
    """Trials that have a value."""
    found: list[Any] = trials.get_trials(deepcopy=False, states=(optuna.trial.TrialState.COMPLETE,))
    return found


def sampler(optuna: ModuleType, tune: Tune, done: int) -> Any:
    """A sampler whose next draw depends on the trials so far and on nothing else, so that a search can be resumed."""
    seed = (tune.seed + done) % 2**32
    if tune.sampler == "tpe":
        return optuna.samplers.TPESampler(seed=seed, multivariate=True)
    if tune.sampler == "cmaes":
        return optuna.samplers.CmaEsSampler(seed=seed)
    return optuna.samplers.RandomSampler(seed=seed)


def suggested(trial: Any, name: str, gain: Factor) -> Any:
    """Value of a gain in a trial."""
    if gain.choice is not None:
        return trial.suggest_categorical(name, gain.choice)
    if gain.integer is not None:
        return trial.suggest_int(name, *gain.integer)
    lower, upper = gain.uniform or gain.log_uniform or (0.0, 1.0)
    return trial.suggest_float(name, lower, upper, log=gain.on_log_scale)


def own_gains(gains: dict[str, Factor], table: dict[str, Any]) -> dict[str, Any] | None:
    """The experiment's own gains as a trial; None where one is outside its bounds or no single number."""
    found = {}
    for name, gain in gains.items():
        old = 1.0 if gain.relative else value_at(table, (gain.keys or (name,))[0])
        if gain.choice is not None:
            inside = old in gain.choice
        else:
            lower, upper = gain.uniform or gain.log_uniform or gain.integer or (0.0, 0.0)
            inside = isinstance(old, (int, float)) and lower <= old <= upper
        if not inside:
            return None
        found[name] = old
    return found


@contextmanager
def opened(optuna: ModuleType, study: StudyFile, file: Path, force: bool) -> Iterator[Any]:
    """The trials in a database, made if they are not there.

    Raises:
        StudyError: They are of other settings, and `force` is off; or the file is not Optuna's.
    """
    optuna.logging.set_verbosity(optuna.logging.ERROR)
    asked = {"mmnn_pin": __version__, "tune": fingerprint(study)}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        try:
            storage = optuna.storages.RDBStorage(f"sqlite:///{file.absolute()}")
            trials = optuna.create_study(study_name="tune", storage=storage, direction="minimize", load_if_exists=True)
            if trials.user_attrs and trials.user_attrs != asked:
                if not force:
                    fix = "--force drops these trials and starts anew; or choose another folder with --out"
                    raise StudyError("the trials are of another study or version", fix=fix, file=file)
                optuna.delete_study(study_name="tune", storage=storage)
                trials = optuna.create_study(study_name="tune", storage=storage, direction="minimize")
            for key, value in asked.items():
                trials.set_user_attr(key, value)
        except StudyError:
            raise
        except Exception as error:  # SQLAlchemy's, which comes with Optuna
            why = " ".join(str(error).split())[:200]
            raise StudyError("cannot open the trials", why=why, file=file) from None
        try:
            yield trials
        finally:
            storage.remove_session()
            storage.engine.dispose()


def fingerprint(study: StudyFile) -> str:
    """What decides the values of trials, as a text: the study without the number of trials and what is only shown."""
    settings = msgspec.to_builtins(study.settings)
    kept = {k: v for k, v in settings.items() if k not in ("title", "metrics", "success", "controllers")}
    kept["tune"] = {k: v for k, v in kept["tune"].items() if k not in ("trials", "check")}
    text = json.dumps([kept, msgspec.to_builtins(study.base)], sort_keys=True)
    return hashlib.sha256(text.encode()).hexdigest()


def imported() -> ModuleType:
    """The module `optuna`.

    Raises:
        StudyError: It is not installed.
    """
    try:
        import cmaes  # noqa: F401
        import optuna
    except ModuleNotFoundError as error:
        fix = "pip install 'mmnn_pin[tune]'"
        raise StudyError("cannot tune without Optuna", why=f"no {error.name}", fix=fix) from None
    return optuna

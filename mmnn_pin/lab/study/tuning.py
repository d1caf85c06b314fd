"""Looks for gains with Optuna; every trial is stored, so that the search goes on where it was stopped.

What tuning makes small is a quantile of a metric over all of a study's draws, for one set of gains. Gains must satisfy
constraints before runs are made with them. A constraint takes the loop of a run and raises `ConfigError` where its
gains break it.
"""

from __future__ import annotations

import hashlib
import json
import math
import re
import shlex
import sqlite3
import traceback
import warnings
from collections.abc import Callable, Iterator, Mapping
from contextlib import closing, contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from types import ModuleType
from typing import Any

import msgspec
import numpy as np

from ... import __version__
from ...actuator import Actuator
from ...errors import ConfigError, MmnnError, StudyError, keyed
from ...files import locked
from ...loop.loop import Loop
from ...sensing import Sensor
from ...settings.arguments import shortly
from ...signals import Array, IntArray
from ...torque.neural import Neural
from ..experiments.config import value_at
from ..psi.rate import rate_of
from ..psi.subject import Subject
from .execution import execute
from .factors import Factor, draws_of
from .intervals import Interval, quantile
from .keys import require_path, times
from .plan import StudyPlan, changed_base, plan_of
from .pools import Pool, optional
from .results import worth
from .settings import StudyFile, Tune, placing
from .store import AGAIN, ROOM
from .worker import loop_of

NAME = "tune.sqlite"
COMPUTES = re.compile(r"\b(?:VIRTUAL|AS|CHECK|WHERE|DEFAULT)\b", re.IGNORECASE)  # a table of Optuna's has no other
OWN_CHECK = "CHECK (version_info_id=1)"  # than this
DATABASE = {"sqlalchemy", "sqlite3", "optuna"}  # packages whose errors are those of a database
FRESH = 7919  # added to the seed of the draws for those that judge the result
LOST = 1e12  # value of gains with which too many runs did not complete, times 1 + the share of those
REFUSED = 1e15  # value of gains that break a constraint, times 1 + the share of runs that do
LOOK = 1.0  # of a run, to see where the weights go before the learning rates are judged [s]


@dataclass(frozen=True)
class Score:
    """The score of a set of gains."""

    metric: Array  # (n,) the metric of every run, inf where it did not complete
    quantile: float  # which counts
    refused: float = 0.0  # share of runs on which the gains break a constraint; nothing was run then
    complaint: str = ""  # one of these complaints
    draws: IntArray | None = None  # (n,) number of the draw of every run; None where each has its own

    @property
    def interval(self) -> Interval:
        """The quantile with its confidence interval."""
        return quantile(self.metric, self.quantile, self.draws)

    @property
    def lost(self) -> float:
        """Share of runs that did not complete."""
        return float(np.mean(~np.isfinite(self.metric))) if len(self.metric) else 0.0

    @property
    def value(self) -> float:
        """The quantile as a number that an optimiser can take: finite, and worse the more runs are lost."""
        if self.refused:
            return REFUSED * (1.0 + self.refused)
        found = self.interval.value
        return found if math.isfinite(found) else LOST * (1.0 + self.lost)


@dataclass
class Scorer:
    """Tries gains on a study's draws."""

    study: StudyFile  # the study
    tune: Tune  # what to look for
    pool: Pool  # makes the runs
    points: int | None = None  # number of draws; None for the study's
    sampling_seed: int | None = None  # of the draws; None for the study's

    def score(self, gains: Mapping[str, Any]) -> Score:
        """Run all draws with a set of gains.

        Raises:
            MmnnError: The pool is lost, or a run failed for a fault.
        """
        plan = self.plan(gains)
        if complaints := list(violations(plan)):
            return Score(np.zeros(0), self.tune.quantile, len(complaints) / len(judged(plan)), complaints[0])
        metric, runs = np.full(len(plan), math.inf), [(dict[str, Any](), 0)] * len(plan)
        for result in execute(self.pool, plan, range(len(plan))):
            if result.status == "failed":
                raise MmnnError(f"a run failed: {result.message}")
            metric[result.id] = worth(result.status, result.metrics, self.tune.objective)
            runs[result.id] = result.parameters, result.seed
        return Score(metric, self.tune.quantile, draws=draws_of(self.study.settings.factors, runs))

    def plan(self, gains: Mapping[str, Any]) -> StudyPlan:
        """The runs of one set of gains."""
        settings = msgspec.structs.replace(
            self.study.settings,
            controllers=(self.tune.controller,),
            tune=None,
            set=self.study.settings.set | dict(gains),
        )
        study = replace(self.study, settings=settings)
        return plan_of(study, sampling_seed=self.sampling_seed, points=self.points)


def settings_of(drawn: Mapping[str, Any], gains: Mapping[str, Factor], table: Mapping[str, Any]) -> dict[str, Any]:
    """Key path to value of a set of gains.

    Args:
        drawn: Name of a gain to its number.
        gains: Name of a gain to what it changes.
        table: The experiment, for gains that multiply what it has.
    """
    paths = [(path, name) for name in drawn for path in gains[name].paths(name)]
    return {p: times(value_at(table, p), drawn[n]) if gains[n].relative else drawn[n] for p, n in paths}


def stable_when_sampled(loop: Loop) -> None:
    """The PD loop alone is stable at the control period, on the true robot; see `loop/before_run.py`."""
    replace(loop, check_gains=True).require_stable_gains()


def learns_slowly_enough(loop: Loop) -> None:
    """The loop with its network, linearised, does not grow at the first second's weights; see `lab/proof/rate.py`.

    Sensors, motors and the world are left out: this is about rates, sample time and gains.
    """
    controller = loop.controller
    if not isinstance(controller, Neural) or not controller.learning:
        return
    h, timing = loop.timing.control_period, loop.timing
    short = msgspec.structs.replace(timing, duration=h * max(2, round(min(LOOK, timing.duration) / h)))
    ideal = replace(loop, timing=short, plant="ideal", sensor=Sensor(), actuator=Actuator(), safety=None)
    recording = replace(ideal, disturbances=(), check_gains=False).run()
    if recording.outcome.status != "completed":
        return  # its runs will show it
    rate = rate_of(Subject.of(recording))
    if not rate.stable:
        ratio = 1.0 / rate.limit.min()
        what = f"learning at {ratio:.3g} times its largest rate" if ratio > 1 else "the leakage turns the weights over"
        raise ConfigError(what, why=f"spectral radius {rate.radius.max():.4g}", fix="lower F, G or beta")


# Constraints, and on how many runs of a study, evenly spread, each is judged.
CONSTRAINTS: tuple[tuple[Callable[[Loop], None], int], ...] = ((stable_when_sampled, 64), (learns_slowly_enough, 4))


def violations(plan: StudyPlan) -> Iterator[str]:
    """Complaints about the gains of a study, one per run that breaks a constraint."""
    refused: set[int] = set()
    for constraint, most in CONSTRAINTS:
        for number in judged(plan, most):
            try:
                if number not in refused:
                    constraint(loop_of(plan.trial(number)))
            except ConfigError as error:
                refused.add(number)
                yield f"row {number}: {error.what}"


def judged(plan: StudyPlan, most: int = CONSTRAINTS[0][1]) -> list[int]:
    """Runs on which gains are judged."""
    return sorted({int(i) for i in np.linspace(0, len(plan) - 1, min(most, len(plan)))})


@dataclass(frozen=True)
class Tuned:
    """The result of a search for gains."""

    tune: Tune  # what was looked for
    trials: int  # sets of gains that were tried
    refused: int  # of them, those that broke a constraint
    own: float | None  # value of the experiment's own gains; None where they have none within the bounds
    best: dict[str, Any]  # the best gains that keep the constraints on the fresh draws, too, key path to value
    value: float  # their value on the study's draws
    # scores of the own and of the best gains on fresh draws; None where none were asked for
    fresh: tuple[Score, Score] | None
    passed_over: int = 0  # better sets of gains that break a constraint on the fresh draws

    def describe(self) -> str:
        """The result for people."""
        t = self.tune
        lines = [
            f"{t.controller}: {self.trials} trials, {self.refused} of them refused by a constraint",
            f"quantile {t.quantile:g} of {t.objective} over the study's draws: {value_words(self.value)}"
            f" (the experiment's own gains: {value_words(self.own)})",
        ]
        if self.fresh is not None:
            lines.append(f"on {len(self.fresh[1].metric) or t.check} runs with fresh draws:")
            for name, score in zip(("own", "best"), self.fresh, strict=True):
                span = "" if score.refused else f" [{score.interval.low:.4g}, {score.interval.high:.4g}]"
                lost = f"{100 * score.lost:.1f} % of runs not completed"
                lines.append(f"  {name} gains: {value_words(score.value)}{span}, {lost}")
            if self.passed_over:
                lines.append(f"  {self.passed_over} better on the study's draws, refused by a constraint on these")
        settings = (shlex.quote(f"{path}={json.dumps(value)}") for path, value in self.best.items())
        return "\n".join([*lines, "best gains:", *(f"  --set {setting}" for setting in settings)])

    def to_dict(self) -> dict[str, Any]:
        """The result for JSON."""
        scores = zip(("own", "best"), self.fresh or (), strict=self.fresh is not None)
        of = {n: {"quantile": s.interval.to_dict(), "lost": s.lost, "refused": s.refused} for n, s in scores}
        about = {"controller": self.tune.controller, "objective": self.tune.objective, "quantile": self.tune.quantile}
        counts = {"trials": self.trials, "refused": self.refused, "passed_over": self.passed_over}
        return about | counts | {"own": self.own, "best": self.value, "gains": self.best, "fresh": of or None}


def value_words(value: float | None) -> str:
    """A value in words: also that too many runs were lost, or that the gains are refused."""
    if value is None:
        return "outside the bounds"
    if value >= REFUSED:
        return "refused by a constraint"
    return f"{100 * (value / LOST - 1):.0f} % of runs not completed" if value >= LOST else f"{value:.4g}"


def tuned_part(study: StudyFile) -> tuple[Tune, dict[str, Any]]:
    """The table `tune` of a study, its keys judged, and the study's experiment as a table.

    Raises:
        InputError: It says nothing, or names a gain that does not exist; with the line.
    """
    tune = study.settings.tune
    if tune is None:
        fix = "add [tune] and [tune.gains], see `mmnn docs how-to/studies`"
        raise study.placed(ConfigError("nothing to tune", fix=fix, key="tune"))
    table, _ = changed_base(study)
    with placing(study.path):
        for name, gain in tune.gains.items():
            for path in gain.paths(name):
                require_path(table, path, f"tune.gains.{name}")
            with keyed(lambda key, name=name: f"tune.gains.{name}"):  # type: ignore[misc]
                settings_of({name: gain.value(0.5)}, tune.gains, table)
    return tune, table


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
    optuna, (tune, table) = imported(), tuned_part(study)
    scorer, own = Scorer(study, tune, pool), own_gains(tune.gains, table)
    with locked(folder / NAME, "database", StudyError), opened(optuna, study, folder / NAME, force) as trials:
        for trial in trials.get_trials(states=(optuna.trial.TrialState.RUNNING,)):  # of a process that was killed
            trials.tell(trial.number, state=optuna.trial.TrialState.FAIL)
        while (done := len(finished(optuna, trials))) < tune.trials:
            if not done and own is not None:
                trials.enqueue_trial(own)
            trials.sampler = sampler(optuna, tune, done)
            trial = trials.ask()
            drawn = {name: suggested(trial, name, gain) for name, gain in tune.gains.items()}
            score = scorer.score(settings_of(drawn, tune.gains, table))
            trial.set_user_attr("lost", score.lost)
            trial.set_user_attr("refused", score.complaint)
            trial.set_user_attr("own", not done and own is not None)
            require_there(folder / NAME)
            trials.tell(trial, score.value)
            values = [one.value for one in finished(optuna, trials)]
            if len(values) == done:  # a search would go on for ever
                why, fix = "it does not keep the trials that are written", "choose another folder with --out"
                raise StudyError("the database is damaged", why=why, fix=fix, file=folder / NAME)
            progress(done + 1, min(values))


def require_there(path: Path) -> None:
    """Refuse to go on where a database was taken away: trials would go into a file without a name, and be lost.

    Raises:
        StudyError: It is gone.
    """
    if not path.is_file():
        fix = "leave its folder where it is until the search is over; the same command goes on with what is there"
        raise StudyError("cannot write the database", why="it is gone", fix=fix, file=path)


def result(study: StudyFile, folder: Path, pool: Pool | None) -> Tuned:
    """The result of the trials so far, judged on fresh draws.

    Args:
        study: The study.
        folder: Of the database.
        pool: Makes the runs on fresh draws; None for no such judgement.

    Raises:
        StudyError: There are no trials.
    """
    optuna, (tune, table) = imported(), tuned_part(study)
    with opened(optuna, study, folder / NAME, False) as trials:
        done = finished(optuna, trials)
        if not done:
            raise StudyError("no trial has finished", file=folder / NAME)
    ranked = sorted(done, key=lambda trial: trial.value)
    sets = [(t.value, settings_of(t.params, tune.gains, table)) for t in ranked if t is ranked[0] or t.value < LOST]
    own = next((trial.value for trial in done if trial.user_attrs.get("own")), None)
    fresh, place = None, 0
    if pool is not None and tune.check and study.settings.sampling.points:
        scorer = Scorer(study, tune, pool, tune.check, study.settings.sampling.seed + FRESH)
        place = next((i for i, (_, gains) in enumerate(sets) if not any(violations(scorer.plan(gains)))), 0)
        fresh = scorer.score({}), scorer.score(sets[place][1])
    refused = sum(bool(trial.user_attrs.get("refused")) for trial in done)
    return Tuned(tune, len(done), refused, own, sets[place][1], sets[place][0], fresh, place)


def finished(optuna: ModuleType, trials: Any) -> list[Any]:
    """Trials that have a value."""
    return list(trials.get_trials(deepcopy=False, states=(optuna.trial.TrialState.COMPLETE,)))


def sampler(optuna: ModuleType, tune: Tune, done: int) -> Any:
    """A sampler whose next draw depends on the trials so far and on nothing else, so that a search can be resumed."""
    seed = (tune.seed + done) % 2**32
    kind = {"tpe": "TPESampler", "cmaes": "CmaEsSampler", "random": "RandomSampler"}[tune.sampler]
    return getattr(optuna.samplers, kind)(seed=seed, **({"multivariate": True} if tune.sampler == "tpe" else {}))


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
    trial = {name: 1.0 if gain.relative else value_at(table, gain.paths(name)[0]) for name, gain in gains.items()}
    for name, gain in gains.items():
        lower, upper = gain.uniform or gain.log_uniform or gain.integer or (0.0, 0.0)
        within = isinstance(trial[name], (int, float)) and lower <= trial[name] <= upper
        if not (within if gain.choice is None else trial[name] in gain.choice):
            return None
    return trial


@contextmanager
def opened(optuna: ModuleType, study: StudyFile, file: Path, force: bool) -> Iterator[Any]:
    """The trials in a database, made if they are not there.

    Raises:
        StudyError: They are of other settings, and `force` is off; or the file is not Optuna's, or cannot be written.
    """
    optuna.logging.set_verbosity(optuna.logging.ERROR)
    asked = {"mmnn_pin": __version__, "tune": fingerprint(study)}
    storage = trials = None
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            require_tables(file)
            storage = optuna.storages.RDBStorage(f"sqlite:///{file.absolute()}")
            trials = optuna.create_study(study_name="tune", storage=storage, direction="minimize", load_if_exists=True)
            if trials.user_attrs not in ({}, asked):
                if not force:
                    fix = "--force drops these trials and starts anew; or choose another folder with --out"
                    raise StudyError("the trials are of another study or version", fix=fix, file=file)
                optuna.delete_study(study_name="tune", storage=storage)
                trials = optuna.create_study(study_name="tune", storage=storage, direction="minimize")
            for key, value in asked.items():
                trials.set_user_attr(key, value)
            require_sound(optuna, trials, study, file)
        yield trials
    except MmnnError:
        raise
    except Exception as error:  # SQLAlchemy's, which comes with Optuna; whatever a damaged database leads to
        inner = error.__cause__ or error
        if trials is not None and not DATABASE & {type(inner).__module__.partition(".")[0], *passed(inner)}:
            raise
        why = str(getattr(inner, "orig", None) or error).partition("\n")[0][:200]
        fix = ROOM if "full" in why or "disk I/O" in why else ""
        raise StudyError("the database cannot be used", why=why, fix=fix, file=file) from error
    finally:
        if storage is not None:
            storage.remove_session()
            storage.engine.dispose()


def require_tables(file: Path) -> None:
    """Refuse a database that has more than tables and indexes of what is stored: others are programs, without end.

    Views, triggers and computed columns are; so are expressions in indexes, in checks and in default values.

    Raises:
        StudyError: With its name.
        sqlite3.Error: It is none.
    """
    if not file.is_file():
        return
    with closing(sqlite3.connect(f"{file.absolute().as_uri()}?mode=rw", uri=True)) as base:
        made = base.execute("SELECT type, name, sql FROM sqlite_master").fetchall()
    for kind, name, sql in made:
        text = str(sql or "").replace(OWN_CHECK, "")
        if kind not in ("table", "index") or COMPUTES.search(text) or (kind == "index" and text.count("(") > 1):
            what = f"the database has {shortly(name)}, which computes what it holds"
            raise StudyError(what, why="it is run as it is read", fix=AGAIN, file=file)


def passed(error: BaseException) -> set[str]:
    """The packages that an error came through: a database's are also Python's own, such as a LookupError or JSON's."""
    names = (str(frame.f_globals.get("__name__", "")) for frame, _ in traceback.walk_tb(error.__traceback__))
    return {name.partition(".")[0] for name in names}


def require_sound(optuna: ModuleType, trials: Any, study: StudyFile, file: Path) -> None:
    """Refuse trials that are none of the search's: a `StudyError` with the number of the first."""
    gains = study.settings.tune.gains if study.settings.tune is not None else {}
    for trial in finished(optuna, trials):
        named = isinstance(trial.value, float) and not math.isnan(trial.value) and set(trial.params) == set(gains)
        if not named or not all(isinstance(trial.params[n], int | float) or gains[n].choice for n in gains):
            why = "its value is no number, or its gains are not those of the search"
            raise StudyError(f"trial {trial.number} cannot be read", why=why, fix=AGAIN, file=file)


def fingerprint(study: StudyFile) -> str:
    """Hash of what decides the values of trials: the study without the number of trials and what is only shown."""
    settings = msgspec.to_builtins(study.settings)
    kept = {k: v for k, v in settings.items() if k not in ("title", "metrics", "success", "controllers")}
    kept["tune"] = {k: v for k, v in kept["tune"].items() if k not in ("trials", "check")}
    text = json.dumps([kept, msgspec.to_builtins(study.base)], sort_keys=True)
    return hashlib.sha256(text.encode()).hexdigest()


def imported() -> ModuleType:
    """The module `optuna`; errors as in `optional`."""
    return optional("cannot tune without Optuna", "tune", "optuna", "cmaes")

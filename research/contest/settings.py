"""What a contest asks: how many seeds, what counts as learned, what each learner knows, which targets it has."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

import msgspec

from mmnn_pin.errors import ConfigError, UnknownName
from mmnn_pin.lab.experiments.config import load_as
from mmnn_pin.lab.experiments.controllers import CONTROLLERS
from mmnn_pin.lab.experiments.experiment import Experiment
from mmnn_pin.lab.experiments.origins import of_override
from mmnn_pin.settings import Settings, require_gains

FILE = Path(__file__).parent / "contest.toml"  # the contest `contest`
ONLY = "task"  # name of the task of a contest without cases
# What a learner has to beat here.
PLAIN = ("pd", "pd_gravity", "pid")
# What a learner knows before it starts.
KNOWS = ("kinematics", "form", "nothing", "nominal")


class Targets(Settings, frozen=True):
    """Targets of the learners, judged by medians over the seeds.

    Args:
        task: Task of an ordinary training motion; most targets are judged there.
        rich: Task of a rich one, for learners that know nothing.
        poor: Task of a poor one.
        frozen_fvu: By what a learner knows before it starts: the largest frozen FVU, of the worst component, that the
            best such learner may have.
        better: Least ratio of the thesis's error to that of the best learner, on every axis.
        near: Largest ratio of the error of the best learner that knows the kinematics to the oracle's.
        oracle: Largest held-out errors of the oracle, whose model is right, of base and arm [m, rad].
        bounded: Largest ratio of any learner's error to PD's after a poor motion, on every axis, held out with learning
            on and off.
        kick: Largest ratio of any learner's torque at the start to the oracle's.
        first: Largest ratio of one learner's error to the least in any task, of all that do not know the truth.
    """

    task: str = ""
    rich: str = ""
    poor: str = ""
    frozen_fvu: dict[str, float] = msgspec.field(default_factory=dict)
    better: float = 3.0
    near: float = 1.5
    oracle: tuple[float, float] = (3e-5, 1e-4)
    bounded: float = 1.0
    kick: float = 3.0
    first: float = 1.2

    def __post_init__(self) -> None:
        require_gains(self, "contest.targets", "better", "near", "oracle", "bounded", "kick", "first")
        for name, value in self.frozen_fvu.items():
            if name not in KNOWS or not 0 < value < float("inf"):
                raise ConfigError(
                    f"a target for '{name}'" if name not in KNOWS else f"{value}",
                    fix=f"give finite numbers > 0 for: {', '.join(KNOWS)}",
                    key=f"contest.targets.frozen_fvu.{name}",
                )


class Contest(Settings, frozen=True):
    """A contest: every controller on every task with every seed; what it learned is judged on held-out trajectories.

    Args:
        seeds: How many, counted from the experiment's own.
        beside: Controllers that always run, because the others are compared with them: those without learning, the
            thesis's law, the oracle. A case that names its own controllers runs those.
        knows: Names of the learners by what they know before they start ("kinematics", "form", "nothing", "nominal").
        window: Length of the windows of the learning curves [s].
        learned: Error over the least of PD, PD with gravity and PID, in every later window, that counts as learned.
        start: Length of the start in which a kick is looked for [s].
        targets: What is asked.

    Raises:
        ConfigError: No seeds, a window or share out of range, a learner that is listed twice.
    """

    seeds: int = 5
    beside: tuple[str, ...] = (*PLAIN, "two_layer", "computed_torque")
    knows: dict[str, tuple[str, ...]] = msgspec.field(default_factory=dict)
    window: float = 1.0
    learned: float = 0.2
    start: float = 0.1
    targets: Targets = Targets()

    def __post_init__(self) -> None:
        if not 1 <= self.seeds <= 1000:
            raise ConfigError(f"{self.seeds} seeds", fix="use 1 to 1000", key="contest.seeds")
        for name in ("window", "learned", "start"):
            if not 0 < getattr(self, name) < float("inf"):
                raise ConfigError(f"{getattr(self, name)}", fix="use a finite number > 0", key=f"contest.{name}")
        already: dict[str, str] = {}
        for name, controllers in self.knows.items():
            if name not in KNOWS:
                raise ConfigError(
                    f"unknown key '{name}'", fix=f"there is: {', '.join(KNOWS)}", key=f"contest.knows.{name}"
                )
            for one in controllers:
                if already.setdefault(one, name) != name:
                    raise ConfigError(
                        f"'{one}' is in {already[one]}, too", fix="name it once", key=f"contest.knows.{name}"
                    )

    def knowledge_of(self, controller: str) -> str:
        """What a learner knows before it starts; empty for one that is not in the list."""
        return next((what for what, names in self.knows.items() if controller in names), "")


class ContestExperiment(Experiment, frozen=True):
    """An experiment whose cases are the tasks of a contest: their runs are compared and not judged one by one.

    Args:
        contest: What the contest asks.
    """

    contest: Contest = Contest()

    @property
    def ordinary(self) -> Experiment:
        """The experiment without what makes it a contest."""
        return Experiment(**{name: getattr(self, name) for name in Experiment.__struct_fields__})


def load_contest(
    name_or_path: str | Path = "contest", overrides: Iterable[str] = (), variant: str | None = None
) -> ContestExperiment:
    """A contest from a TOML file, or the one that comes with this package; as `load_experiment`."""
    path, texts = FILE if name_or_path == "contest" else Path(name_or_path), tuple(overrides)
    asked = load_as(ContestExperiment, path, texts, variant)
    try:
        require_names(asked)
    except UnknownName as error:
        raise of_override(error.but(file=path), texts) from None
    return asked


def require_names(experiment: ContestExperiment) -> None:
    """Refuse controllers and tasks that a contest names and that do not exist.

    Raises:
        UnknownName: With the key path.
    """
    contest, tasks = experiment.contest, tuple(experiment.cases) or (ONLY,)
    there = {**CONTROLLERS, **experiment.laws}
    named = {f"contest.knows.{what}": names for what, names in contest.knows.items()}
    for key, names in (named | {"contest.beside": contest.beside}).items():
        for name in names:
            if name not in there:
                raise UnknownName("controller", name, there, key=key)
    for key in ("task", "rich", "poor"):
        name = getattr(contest.targets, key)
        if name and name not in tasks:
            raise UnknownName("task", name, tasks, key=f"contest.targets.{key}")

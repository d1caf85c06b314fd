"""The result of an experiment: its runs by controller, their numbers beside each other, tables and figures of them.

How much of a learner's advantage over PD is gain, and how much is learning? A learner's robust term adds feedback, so
part of what it wins it would win without its network. PD at the learner's own effective gain, sample by sample, has
the one and not the other:

    pd -> learner  =  (pd -> pd at the learner's effective gain)  +  (pd at that gain -> learner)
      improvement  =                  gain                        +            learning
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any

from ...errors import UnknownName
from ...recording.recording import Recording, as_columns
from ...settings import finite
from ...settings.arguments import faced
from ...shown import ShownPage, ShownPicture, ShownTable, shown
from .beside_plain import worse_than_plain
from .controllers import LEARNERS, effective
from .experiment import Experiment
from .hand import HandErrors
from .outliers import outliers, worst_loss
from .thesis import beside_the_thesis, figure_ranges

WORSE = "worse than plain control"  # outcome of a learner's run that was completed, and should not have been


@faced
@dataclass(frozen=True, repr=False)
class Result(Mapping[str, Recording]):
    """The result of an experiment: its recordings by controller, tables and figures of them.

    In a notebook it shows its table and its errors; `print` shows the table.
    """

    experiment: Experiment  # the experiment
    name: str  # its name
    recordings: dict[str, Recording]  # controller to recording, in the order asked for
    metrics: dict[str, dict[str, float]]  # controller to numbers (see `metrics`)
    notes: tuple[str, ...]  # what the user should know
    # controller to what it did at every frame that the reference took along a path
    hand: dict[str, list[HandErrors]] = field(default_factory=dict)
    # controller to numbers of what its hand touched (`pushing_numbers`); empty where it touched nothing
    pushes: dict[str, dict[str, float | None]] = field(default_factory=dict)
    plain: Recording | None = None  # a run of plain control that learners are measured by, where none was asked for

    def __getitem__(self, controller: str) -> Recording:
        if controller not in self.recordings:
            raise UnknownName("run", str(controller), self.recordings)
        return self.recordings[controller]

    def __iter__(self) -> Iterator[str]:
        return iter(self.recordings)

    def __len__(self) -> int:
        return len(self.recordings)

    def __repr__(self) -> str:
        ends = (f"{name} {recording.outcome.status}" for name, recording in self.items())
        return f"<Result: {', '.join(ends)}>"

    def __str__(self) -> str:
        return str(self.table())

    def _repr_html_(self) -> str:
        return self.table()._repr_html_() + self.plot()._repr_html_()

    def table(self) -> ShownTable:
        """The runs beside each other: errors, torques, what was learned; it prints as text."""
        made: ShownTable = shown(self, "table")
        return made

    def plot(self, what: str = "errors") -> ShownPicture:
        """A figure of the runs, of those that `mmnn plot --help` names; `.save("errors.svg")` writes it.

        Raises:
            UnknownName: There is no such figure.
            RecordingError: The runs have nothing for it.
        """
        made: ShownPicture = shown(self, "plot", what)
        return made

    def replay(self, *, title: str = "", fps: float = 60.0, package_dirs: Sequence[str | Path] = ()) -> ShownPage:
        """A page that plays the runs in one scene; `.save("replay.html")` writes it.

        Args:
            title: Heading of the page; by default the robot and the experiment.
            fps: Frames per second that are kept; the page interpolates between them.
            package_dirs: Folders to look for meshes in before those that the recordings know.

        Raises:
            InputError: There is nothing to show.
        """
        made: ShownPage = shown(self, "replay", title=title, fps=fps, package_dirs=package_dirs)
        return made

    def report(self, *, with_replay: bool = True, package_dirs: Sequence[str | Path] = ()) -> ShownPage:
        """A page that says how good the runs were; `.save("report.html")` writes it.

        Args:
            with_replay: Whether the replay is in it.
            package_dirs: Folders to look for the replay's meshes in.

        Raises:
            RecordingError: There is nothing to report.
        """
        made: ShownPage = shown(self, "report", with_replay=with_replay, package_dirs=package_dirs)
        return made

    @property
    def completed(self) -> bool:
        """Whether every run reached its end."""
        return all(recording.outcome.status == "completed" for recording in self.recordings.values())

    def to_dict(self) -> dict[str, Any]:
        """The result as the command line's JSON object."""
        runs = {
            name: {
                "file": str(recording.path) if recording.path else None,
                "outcome": WORSE if name in self.worse else recording.outcome.status,
                "message": recording.outcome.message,
                "metrics": {key: finite(value) for key, value in self.metrics[name].items()},
            }
            for name, recording in self.recordings.items()
        }
        comparison = {
            "relative_to_pd": self.relative_to("pd"),
            "torque_limits": self.torque_limits(),
            "improvement": {
                learner: {row: {key: finite(value) for key, value in i.to_dict().items()} for row, i in rows.items()}
                for learner, rows in self.improvements().items()
            },
            "figure_ranges": self.figure_ranges(),
            **self.largest_errors(),
            **({"hand": {name: told(errors) for name, errors in self.hand.items()}} if any(self.hand.values()) else {}),
            **({"pushes": self.pushes} if any(self.pushes.values()) else {}),
            "unfair": unfair(self.experiment, self.metrics),
            "notes": [*self.worse.values(), *self.notes, *self.outliers()],
        }
        about = {"experiment": self.name, "variant": self.experiment.variant, "robot": self.experiment.robot}
        return about | {"runs": runs, "comparison": comparison}

    @cached_property
    def worse(self) -> dict[str, str]:
        """Learner to why it is worse than plain control, for those that are."""
        return worse_than_plain(self.recordings, self.plain)

    @cached_property
    def lost(self) -> dict[str, str]:
        """Run to the metric by which it is lost most (`worst_loss`), for those that are."""
        found = {name: worst_loss(recording, self.metrics[name]) for name, recording in self.recordings.items()}
        return {name: key for name, key in found.items() if key}

    def outliers(self) -> list[str]:
        """Runs that throw a joint about, or shake a motor, as no other run does: a sentence each."""
        return outliers(self.recordings, self.metrics)

    def improvements(self) -> dict[str, dict[str, Improvement]]:
        """Shares of gain and of learning in each learner's improvement over PD, see `improvements`."""
        return improvements(self.metrics, self.experiment.windows)

    def figure_ranges(self) -> list[dict[str, Any]]:
        """The runs beside the intervals of the thesis's figures that this experiment is compared with."""
        figures = tuple(name.removeprefix("figure-") for name in self.experiment.plots if name.startswith("figure-"))
        return [row for row in figure_ranges(self.recordings) if row["figure"].startswith(figures)]

    def largest_errors(self) -> dict[str, Any]:
        """The runs beside the largest errors that chapter 5 prints; empty for an experiment without its figure 5.5."""
        return beside_the_thesis(self.recordings) if "figure-5.5" in self.experiment.plots else {}

    def torque_limits(self) -> list[dict[str, Any]]:
        """Per actuator its effort limit (None without one) and every controller's peak torque [N m or N].

        The torque is the one that the motors gave, where they are simulated.
        """
        if not self.recordings:
            return []
        first = next(iter(self.recordings.values()))
        actuators, limits = (first.meta.get(key, ()) for key in ("actuator_names", "effort_limits"))
        given = {name: "applied" if "applied" in r else "motor_torque" for name, r in self.recordings.items()}
        peaks = {name: as_columns(r[given[name]]) for name, r in self.recordings.items() if len(r)}
        return [
            {
                "actuator": actuator,
                "limit": finite(limit),
                "peak": {name: finite(abs(torque[:, i]).max()) for name, torque in peaks.items()},
            }
            for i, (actuator, limit) in enumerate(zip(actuators, limits, strict=False))
        ]

    def relative_to(self, other: str) -> dict[str, dict[str, float | None]]:
        """Every error metric of every controller divided by that of another one; empty without it."""
        if other not in self.metrics:
            return {}
        base = self.metrics[other]
        return {
            name: {
                key: finite(value / base[key]) if base.get(key) else None
                for key, value in numbers.items()
                if key.endswith("peak") or ".rms_" in key
            }
            for name, numbers in self.metrics.items()
            if name != other
        }


@dataclass(frozen=True)
class Improvement:
    """A learner's RMS error beside that of PD and of PD at its effective gain, in the error's unit."""

    pd: float  # RMS error of PD
    pd_effective: float  # RMS error of PD at the learner's effective gain
    learner: float  # RMS error of the learner

    @property
    def total(self) -> float:
        """`pd - learner`; negative where the learner is worse."""
        return self.pd - self.learner

    @property
    def gain(self) -> float:
        """The part of PD's error that the higher gain alone takes away; negative where it adds to it."""
        return self.pd - self.pd_effective

    @property
    def learning(self) -> float:
        """The part that the network takes away beyond that; negative where it adds to it."""
        return self.pd_effective - self.learner

    @property
    def learning_share(self) -> float | None:
        """`learning / total`; above 1 or below 0 where the two work against each other.

        None where there is no improvement to share, or no numbers.
        """
        return self.learning / self.total if self.total > 0 else None

    def to_dict(self) -> dict[str, float | None]:
        """Numbers for JSON; shares are None where the learner is not better than PD."""
        learning = self.learning_share
        return {
            "pd": self.pd,
            "pd_effective": self.pd_effective,
            "learner": self.learner,
            "improvement": self.total,
            "gain": self.gain,
            "learning": self.learning,
            "gain_share": None if learning is None else 1.0 - learning,
            "learning_share": learning,
        }


def improvements(
    metrics: Mapping[str, Mapping[str, float]], windows: tuple[tuple[float, float], ...]
) -> dict[str, dict[str, Improvement]]:
    """Learner to error (`pose_error.x`) to its improvement over PD, in the RMS of the last window.

    Learners without PD and PD at their effective gain beside them are left out.

    Args:
        metrics: Controller to numbers, see `metrics`.
        windows: Windows of the RMS errors [s].
    """
    if not windows or "pd" not in metrics:
        return {}
    ending = ".rms_{:g}_{:g}".format(*windows[-1])
    rows = [key.removesuffix(ending) for key in metrics["pd"] if key.endswith(ending)]
    return {
        learner: {
            row: Improvement(*(float(metrics[name][row + ending]) for name in ("pd", pd, learner))) for row in rows
        }
        for pd, learner in effective(metrics).items()
        if pd in metrics and learner in metrics
    }


def unfair(experiment: Experiment, metrics: Mapping[str, Mapping[str, float]]) -> str:
    """The reason why learners are not compared on equal terms, with their mean effective gains; empty if they are.

    Args:
        experiment: The experiment; its learners' robust terms and hidden units are compared.
        metrics: Controller to numbers, see `metrics`.
    """
    names = [name for name in LEARNERS if name in metrics]
    reasons = []
    if len({experiment.robust_term(name) for name in names}) > 1 and experiment.learning.robust_term:
        reasons.append("each learner has a robust term of its own")
    if len({getattr(experiment, "one_layer" if name == "one_layer" else "two_layer").hidden for name in names}) > 1:
        reasons.append("the networks differ in size")
    if not reasons:
        return ""
    gains = ", ".join(
        f"{part} {' against '.join(f'{metrics[name][key]:.4g}' for name in names)}"
        for part in ("base", "arm")
        if (key := f"effective_gain.{part}") in metrics[names[0]]
    )
    return f"not a fair comparison: {' and '.join(reasons)}; mean effective gain {gains} ({' against '.join(names)})"


def told(hands: list[HandErrors]) -> dict[str, Any]:
    """Numbers of the first frame, and under `frames` those of every one where there are several."""
    if not hands:
        return {}
    more = {"frames": {errors.frame: errors.numbers() for errors in hands}} if len(hands) > 1 else {}
    return {**hands[0].numbers(), **more}

"""What the thesis leaves open or contradicts itself in, each as one switch, and what turning it does."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import msgspec

from ...recording.metrics import ERRORS
from ...torque.neural import THESIS_INPUT
from .controllers import LEARNERS
from .experiment import Experiment
from .runner import Result, run_experiment

APPENDIX_B_SHORT = ("alpha", "alphadot", "e", "r", "q_ref", "qdot_ref", "qddot_ref")


@dataclass(frozen=True)
class Switch:
    """A key of an experiment and the two values between which the thesis leaves a choice.

    Attributes:
        key: Key path, `section.name`.
        first: One value, and how the table calls it.
        second: The other.
    """

    key: str
    first: tuple[Any, str]
    second: tuple[Any, str]

    def turned(self, experiment: Experiment) -> tuple[str, Experiment]:
        """The experiment with this switch in its other place, and what that is called."""
        section, _, name = self.key.partition(".")
        settings = getattr(experiment, section)
        value, words = self.second if getattr(settings, name) == self.first[0] else self.first
        return words, msgspec.structs.replace(
            experiment, **{section: msgspec.structs.replace(settings, **{name: value})}
        )


WITHOUT_POSITION = tuple(name for name in THESIS_INPUT if name != "pose_ref")
SWITCHES = (
    Switch("learning.rates", ("per_sample", "rates per sample"), ("per_second", "rates per second")),
    Switch("two_layer.initial", ("random", "weights from random"), ("zero", "weights from zero")),
    Switch("learning.update", ("after_output", "update after output"), ("before_output", "update before output")),
    Switch("inputs.constant_yaw_rate", (None, "wd in the input"), (5.0, "wd = 5 in the input")),
    Switch("inputs.pose_error", ("body", "body-frame pose error"), ("world", "world-frame pose error")),
    Switch("inputs.signals", (THESIS_INPUT, "input (3.24)"), (WITHOUT_POSITION, "no absolute position")),
    Switch("inputs.signals", (THESIS_INPUT, "input (3.24)"), (APPENDIX_B_SHORT, "Appendix B's short input")),
)


def readings(
    experiment: Experiment, name: str, progress: Callable[[str, float], None] | None = None
) -> dict[str, Result]:
    """All learners with the experiment as it is, then with each switch turned alone, in memory.

    Args:
        experiment: Where to start from.
        name: Its name.
        progress: Called before each reading with `readings` and the fraction done.

    Raises:
        KeyboardInterrupt: Ctrl-C during a run.
    """
    learners = tuple(name for name in experiment.controllers if name in LEARNERS)
    base = msgspec.structs.replace(experiment, controllers=learners or ("two_layer", "one_layer"))
    cases = {"as it is": base} | dict(switch.turned(base) for switch in SWITCHES)
    found = {}
    for i, (words, case) in enumerate(cases.items()):
        if progress is not None:
            progress("readings", i / len(cases))
        found[words] = result = run_experiment(case, name)
        if any(recording.outcome.status == "interrupted" for recording in result.recordings.values()):
            raise KeyboardInterrupt
    return found


def summaries(results: dict[str, Result]) -> list[dict[str, Any]]:
    """Per reading, for JSON: RMS errors of the last window, learned shares, the figures' intervals."""
    return [{"reading": words, **effects(result)} for words, result in results.items()]


def effects(result: Result) -> dict[str, Any]:
    """Per learner its outcome, RMS errors of the last window and learned shares; the intervals met and compared."""
    window = ".rms_{:g}_{:g}".format(*result.experiment.windows[-1])
    every, ranges = result.to_dict()["runs"], result.figure_ranges()
    numbers = {
        learner: {
            "outcome": every[learner]["outcome"],
            "rms": {
                key.removesuffix(window): value
                for key, value in every[learner]["metrics"].items()
                if key.startswith(ERRORS) and key.endswith(window)
            },
            "learned_share": {
                key.partition(".")[2]: value
                for key, value in every[learner]["metrics"].items()
                if key.startswith("learned_share")
            },
        }
        for learner in every
    }
    return {**numbers, "figure_ranges": ranges, "met": sum(row["inside"] for row in ranges), "of": len(ranges)}

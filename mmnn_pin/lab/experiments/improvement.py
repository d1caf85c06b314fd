"""How much of a learner's advantage over PD is gain, and how much is learning.

A learner's robust term adds feedback, so part of what it wins it would win without its network. PD at the learner's
own effective gain, sample by sample, has the one and not the other:

    pd -> learner  =  (pd -> pd at the learner's effective gain)  +  (pd at that gain -> learner)
      improvement  =                  gain                        +            learning
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from .controllers import effective


@dataclass(frozen=True)
class Improvement:
    """A learner's RMS error beside that of PD and of PD at its effective gain, in the error's unit.

    Attributes:
        pd: RMS error of PD.
        pd_effective: RMS error of PD at the learner's effective gain.
        learner: RMS error of the learner.
    """

    pd: float
    pd_effective: float
    learner: float

    @property
    def total(self) -> float:
        """`pd - learner`; negative where the learner is worse."""
        return self.pd - self.learner

    @property
    def gain(self) -> float:
        """What the higher gain alone takes away from PD's error; negative where it adds to it."""
        return self.pd - self.pd_effective

    @property
    def learning(self) -> float:
        """What the network takes away from there; negative where it adds to it."""
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

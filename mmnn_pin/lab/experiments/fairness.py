"""Whether the learners of an experiment are compared on equal terms; if not, how unequal they are."""

from __future__ import annotations

from collections.abc import Mapping

from .controllers import LEARNERS
from .experiment import Experiment


def unfair(experiment: Experiment, metrics: Mapping[str, Mapping[str, float]]) -> str:
    """Why the learners are not compared on equal terms, with their mean effective gains; empty if they are.

    Args:
        experiment: The experiment; its learners' robust terms and hidden units are compared.
        metrics: Controller to numbers, see `metrics`.
    """
    names = [name for name in LEARNERS if name in metrics]
    reasons = []
    if len({experiment.robust_term(name) for name in names}) > 1 and experiment.learning.robust_term:
        reasons.append("each learner has a robust term of its own")
    if len({experiment.network(name).hidden for name in names}) > 1:
        reasons.append("the networks differ in size")
    if not reasons:
        return ""
    gains = ", ".join(
        f"{part} {' against '.join(f'{metrics[name][key]:.4g}' for name in names)}"
        for part in ("base", "arm")
        if (key := f"effective_gain.{part}") in metrics[names[0]]
    )
    return f"not a fair comparison: {' and '.join(reasons)}; mean effective gain {gains} ({' against '.join(names)})"

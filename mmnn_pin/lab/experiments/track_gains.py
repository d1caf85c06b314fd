"""The gains that `mmnn run track` gives a robot, velocity by velocity, and how to set them elsewhere."""

from __future__ import annotations

from typing import Any

from ...model.robot import Robot
from .config import load_experiment

TRACK = "track"
DIGITS = 4


def track_gains(robot: Robot) -> dict[str, Any]:
    """Gains on `[z; r]` that suit a robot along the reference of `track`, and what they come from.

    Args:
        robot: The robot.

    Returns:
        For JSON: `gains`, `inertia` and `bandwidth` of every velocity by name [N s/m, N m s; kg, kg m^2; 1/s], the
        share of the usual bandwidths that its loop bears, and `set`: the keys of an experiment with these gains.

    Raises:
        TrajectoryError: A base that cannot follow the reference.
        ConfigError: An arm that cannot.
    """
    experiment = load_experiment(TRACK)
    found = experiment.fit(robot)
    assert found is not None  # the experiment gives no gains
    feedback = experiment.feedback.scaled(robot.dimensions, found.inertia, found.share)
    gains, names, nb = feedback.vector(robot.dimensions), robot.velocity_names, robot.dimensions.base
    short = [float(f"{gain:.{DIGITS}g}") for gain in gains]
    parts = {"feedback.base": short[:nb], "feedback.arm": short[nb:]}
    return {
        "gains": dict(zip(names, gains.tolist(), strict=True)),
        "inertia": dict(zip(names, found.inertia.tolist(), strict=True)),
        "bandwidth": dict(zip(names, (gains / found.inertia).tolist(), strict=True)),
        "share": found.share,
        "set": {key: part for key, part in parts.items() if part},
    }

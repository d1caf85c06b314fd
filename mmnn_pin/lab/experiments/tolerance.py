"""Cases of an experiment as data, and what is asked of their runs."""

from __future__ import annotations

from typing import Any

import msgspec

from ...settings import Settings, require_gains


class Case(Settings, frozen=True):
    """One case of an experiment.

    Args:
        title: A few words for the table.
        set: Keys that it changes, tables in tables.
        experiment: A bundled experiment or a file from which it starts, in place of the one that it is a case of; what
            that one says itself holds in this case, too.
    """

    title: str
    set: dict[str, Any] = msgspec.field(default_factory=dict)
    experiment: str = ""


class Tolerance(Settings, frozen=True):
    """What a case asks of its runs.

    Args:
        settle: Time after which the errors count [s].
        pose: Largest distance of the base from its reference [m].
        heading: Largest heading error [rad].
        joint: Largest error of an arm joint [rad or m].
        runaway: Largest distance from the reference at the moment of a trip, and driven after it [m].
        speed: Speed of the base that counts as rest [m/s, rad/s].
        joint_speed: Speed of an arm joint that counts as rest [rad/s or m/s].
    """

    settle: float = 1.0
    pose: float = 0.05
    heading: float = 0.1
    joint: float = 0.05
    runaway: float = 0.5
    speed: float = 0.02
    joint_speed: float = 0.1

    def __post_init__(self) -> None:
        require_gains(self, "tolerance")

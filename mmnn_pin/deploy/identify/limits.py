"""Limits of a motion that identifies, and the reasons for which candidates are refused."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from ...errors import ConfigError

SHARE = 0.8  # of a limit that is used
NEAR = 0.9  # of the distance at which links were found, for the spheres that are advised


@dataclass(frozen=True)
class ExcitationLimits:
    """Limits of a motion that identifies.

    Args:
        duration: [s].
        space: Half the side of the square that the base stays in [m].
        share: Of the limits of position, speed and torque that is used.
        clearance: Radius of the spheres along the links [m]; 0 for no look at collisions.
        seconds: Time to look for it [s].
        seed: Of the search.

    Raises:
        ConfigError: A number that cannot be.
    """

    duration: float = 40.0
    space: float = 1.0
    share: float = SHARE
    clearance: float = 0.06
    seconds: float = 20.0
    seed: int = 0

    def __post_init__(self) -> None:
        for name, least in (("duration", 5.0), ("space", 0.0), ("share", 0.0), ("clearance", 0.0), ("seconds", 0.0)):
            value = getattr(self, name)
            if not (np.isfinite(value) and value >= least) or (name == "share" and not 0 < value <= 1):
                fix = "give a share up to 1" if name == "share" else f"give a finite number from {least:g}"
                raise ConfigError(f"{value}", fix=fix, key=f"--{name}")


@dataclass(frozen=True)
class RefusedCandidate:
    """Why a candidate is no motion.

    Attributes:
        what: `"links"` touch, a motor cannot `"hold"` its joint up or `"move"` it, parameters stay `"unseen"`.
        size: Least distance of links, or largest torque, over what is allowed; 0 of parameters.
        names: The velocity whose torque is the largest; the parameters.
    """

    what: Literal["links", "hold", "move", "unseen"]
    size: float
    names: tuple[str, ...] = ()


def none_found(
    refused: Sequence[RefusedCandidate], limits: ExcitationLimits, slowest: float, stuck: Sequence[str], base: bool
) -> ConfigError:
    """The error that says what most candidates were refused for, and what to change.

    Args:
        refused: All candidates, at least one.
        limits: What a motion may do.
        slowest: Times as slowly that they were tried.
        stuck: Joints without a range.
        base: Whether the robot has a base that drives.
    """
    counts = Counter(one.what for one in refused)
    worst, count = counts.most_common(1)[0]
    those = [one for one in refused if one.what == worst]
    names = [name for name, _ in Counter(name for one in those for name in one.names).most_common(4)]
    least, most = min(one.size for one in those), max(one.size for one in those)
    torque = f"at least {least:.3g} times {limits.share:g} of the limit, most often at {', '.join(names[:2])}"
    if worst == "links":
        radius = NEAR * most * limits.clearance
        why, key = f"links that are no neighbours come closer than {2 * limits.clearance:g} m", "--clearance"
        fix = f"give a smaller one: {radius:.2g} leaves room" if most > 0.1 else "give 0: no look at links"
    elif worst == "hold":
        why, key = f"the arm's weight alone asks motors for {torque}", "--share"
        fix = f"give a larger --share, or mend the URDF's masses or effort limits of {names[0]}"
    elif worst == "move":
        why, key = f"even {slowest:.2g} times as slow they ask motors for {torque}", "--share"
        fix = "give a larger --share or a longer --duration, or mend the URDF's friction or effort limits"
    elif stuck:
        why, key = f"{', '.join(stuck)} cannot move", "--lock"
        fix = " ".join(f"--lock {name}" for name in stuck)
    elif base and limits.space == 0:
        why, key, fix = "the base has no room", "--space", "give more than 0, or --base fixed"
    else:
        why, key = f"they do not tell {', '.join(names)} from others", "--duration"
        fix = "give a longer --duration or a larger --share"
    more = "".join(f", {number} {SHORT[kind]}" for kind, number in counts.most_common()[1:])
    why = f"{count} of {len(refused)} candidates are refused: {why}{more}"
    return ConfigError("no motion found", why=why, fix=fix, key=key)


SHORT = {
    "links": "for links that touch",
    "hold": "for the arm's weight",
    "move": "for torque",
    "unseen": "for parameters that they do not tell apart",
}

"""Doubts about an identification: motion not recorded, efforts that no motor gives, joints that fit badly.

They are told and no reason to refuse: a limit may be wrong as well as an effort.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping, Sequence

import numpy as np

from ...model.robot import Robot
from ...signals import Array
from .equations import coordinates
from .log import Log
from .quality import Bools

ABOVE = 1.001  # times a limit: more is not rounding
POOR = 0.05  # error below which no joint fits badly
FAR, APART = 2.0, 4.0  # error over that of least squares, and over the median of the other joints, that is told


def beyond_limits(logs: Sequence[Log], robot: Robot, unknown: Collection[str]) -> Iterator[str]:
    """Efforts above the URDF's limit of their motor, a line for each, with how many samples.

    Args:
        logs: Motions, efforts in N m and N.
        robot: Whose limits count.
        unknown: Motors whose torque constant is not known yet.
    """
    limits = dict(zip(robot.actuator_names, robot.effort_limits, strict=True))
    for name, limit in limits.items():
        given = [log.effort[name] for log in logs if name in log.effort and name not in unknown]
        sizes = np.abs(np.concatenate(given)) if given else np.zeros(0)
        if count := int(np.count_nonzero(sizes > ABOVE * limit)):
            yield (
                f"effort.{name} is above the URDF's limit of {limit:g} in {count} of {sizes.size} samples, at most "
                f"{sizes.max():.4g}: another unit, a torque constant (--torque-constant {name}=K), or a wrong limit"
            )


def misfits(names: Sequence[str], errors: Mapping[str, Array], follows: Bools) -> Iterator[str]:
    """Joints that were fitted, and whose held-out error is far above least squares' or that of the other joints.

    Args:
        names: Of the r efforts.
        errors: Held-out errors (r,) of `identified`, `least_squares` and `urdf`; nan for one that stands.
        follows: (r,) whether an effort was fitted, of bool.
    """
    ours, theirs = errors["identified"], errors["least_squares"]
    for i in map(int, np.flatnonzero(follows & (ours > POOR))):
        others = ours[follows & np.isfinite(ours) & (np.arange(len(names)) != i)]
        usual = float(np.median(others)) if others.size else np.inf
        here = f"{names[i]} fits badly: held-out error {100 * ours[i]:.3g} %"
        if ours[i] > FAR * theirs[i]:
            yield (
                f"{here}, {100 * theirs[i]:.3g} % by least squares without regard to masses: no body that can be "
                "explains its effort; check its sign, unit, gear and torque constant"
            )
        elif ours[i] > APART * usual:
            fix = "check its unit and torque constant, or its friction (--stribeck)"
            if errors["urdf"][i] < ours[i]:
                fix = f"by the URDF {100 * errors['urdf'][i]:.3g} %, so the motion tells too little of it (mmnn excite)"
            yield f"{here}, the other joints' median {100 * usual:.3g} %: {fix}"


def missing_notes(logs: Sequence[Log], robot: Robot) -> list[str]:
    """Notes on joints that the logs do not have and that are taken as still, and on locked ones that move."""
    found = []
    for log in logs:
        _, missing = coordinates(log, robot)
        if missing:
            found.append(f"{log.name}: not in the log, taken as still: {', '.join(missing)}")
        frozen = [name for name in log.position if name not in robot.joint_names and name in robot.arm.locked]
        moved = [name for name in frozen if np.ptp(log.position[name]) > 0.02]
        if moved:
            found.append(f"{log.name}: locked in the model, but they move: {', '.join(moved)}: --free JOINT frees one")
    return found

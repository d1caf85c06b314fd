"""Lines for the user on gains, and answers of learners, that a loop does not bear and that were reduced."""

from __future__ import annotations

from typing import Any

import numpy as np

from ..model.robot import Robot
from ..torque.controller import Bears, Feedback
from .suited import MARGIN, LoopToSuit, bears_of, fit

LESS = 0.7  # of what an ideal loop would have: less is told


def reductions(robot: Robot, controller: Any, given: LoopToSuit) -> list[str]:
    """Lines on a controller that was reduced because of all that is in its loop; none where that is ideal.

    Args:
        robot: Its robot.
        controller: As `suited` made it.
        given: The loop around it.
    """
    ideal = given._replace(delay=MARGIN, margin=MARGIN, lag=0.0, late=0.0, sight=None)
    why = in_the_loop(given)
    feedback, name = getattr(controller, "feedback", None), getattr(controller, "name", "it")
    if not why or not isinstance(feedback, Feedback):
        return []
    told = []
    found, best = fit(robot, Feedback(), given), fit(robot, Feedback(), ideal)
    if feedback == Feedback().scaled(robot.dimensions, found.inertia, found.share) and found.share < LESS * best.share:
        told.append(f"gains are {percent(found.share / best.share)} of those without {why}: the loop bears no more")
    bears = getattr(getattr(controller, "networks", None) or controller, "bears", None)
    if isinstance(bears, Bears) and bears.rate < LESS * (free := bears_of(robot, feedback, ideal).rate):
        told.append(
            f"{name} answers errors at up to {bears.rate:.3g} 1/s over its feedback, without {why} at {free:.3g}: the "
            "loop bears no more" + ("" if bears.rate else ", and it learns nothing from them")
        )
    return told


def in_the_loop(given: LoopToSuit) -> str:
    """Parts of a loop beside its control period, in words."""
    lag, late = float(np.max(given.lag)), given.delay - given.margin
    parts = [f"{1e3 * lag:.3g} ms of lag"] * (lag > 0.0) + [f"{1e3 * late:.3g} ms of latency"] * (late > 1e-9)
    parts += ["velocities made of encoders"] * (given.sight is not None or given.late > 0.0)
    parts += [f"a margin of {1e3 * given.margin:.3g} ms"] * (given.margin > MARGIN)
    return " and ".join(filter(None, (", ".join(parts[:-1]), parts[-1] if parts else "")))


def percent(share: float) -> str:
    """A share in percent."""
    return f"{100 * share:.0f} %"

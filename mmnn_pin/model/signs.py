"""Signs and readings: what is seen of a robot, what each sign speaks for, and which of two readings it bears out.

A *sign* is one independent thing, with its weight for a reading: the logarithm of how many times likelier it is where
that reading is true. A *reading* is one way to understand a robot, or a joint of it; its score is the sum of its signs.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

MARGIN = 2.0  # least difference of two scores that tells: seven to one; below it the loader asks


@dataclass(frozen=True)
class Sign:
    """One thing that is seen."""

    text: str  # what it is, in words, with its line in the file where it has one
    weight: float  # what it adds to the score of its reading [nats]; negative where it speaks against it
    line: int = 0  # its line in the file, 0 without one
    joint: str = ""  # the joint that it is about, empty for the robot


def score(signs: Sequence[Sign]) -> float:
    """The sum of the weights of signs [nats]."""
    return sum(sign.weight for sign in signs)


def told_apart(best: Sequence[Sign], other: Sequence[Sign], most: int = 3) -> list[str]:
    """Signs that speak for one reading rather than for another, in words, the strongest first, at most so many."""
    weights = {sign.text: sign.weight for sign in best}
    for sign in other:
        weights[sign.text] = weights.get(sign.text, 0.0) - sign.weight
    telling = sorted((text for text in weights if weights[text] > 0), key=lambda text: -weights[text])
    return telling[:most]

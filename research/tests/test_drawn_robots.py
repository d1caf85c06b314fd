"""Robots at random, identified: their mass is within its band where a rotor turns with a link that hides it."""

from __future__ import annotations

import pytest

from research.studies.drawn_robots import one


@pytest.mark.parametrize("seed", [20236, 20376, 20388, 20548])
def test_a_rotor_does_not_weigh(seed: int) -> None:
    """One joint shows the sum of the link's inertia and the rotor's: links were found 0.3 to 7 times as heavy."""
    _, shares = one(seed)
    assert shares["mass of the whole"].all() and shares["written"].mean() > 0.8

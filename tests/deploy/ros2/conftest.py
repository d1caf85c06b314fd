"""What every test in a graph of real ROS 2 has."""

from __future__ import annotations

from collections.abc import Iterator

import pytest
from graph import claimed


@pytest.fixture
def domain() -> Iterator[int]:
    """A domain that no other test of this machine uses meanwhile."""
    with claimed() as number:
        yield number

"""A sample of the damaged logs: no number outside its band without a warning."""

from __future__ import annotations

import pytest

from research.studies.damaged_logs import ended


@pytest.mark.parametrize("seed", [1003, 1047, 1066, 1245])
def test_a_damaged_log_is_right_or_doubted(seed: int) -> None:
    """1066 and 1245 were outside while what is written followed rows that turn back; 1047 holds its positions."""
    end, kinds, told = ended(seed, 1 + seed % 2)
    assert end in ("refused", "warned", "right"), f"{kinds}: {told}"

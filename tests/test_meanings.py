"""What is said of fields: in docstrings and beside them, where commands, schemas, ROS 2 and exported C take it from."""

from __future__ import annotations

from typing import NamedTuple

from mmnn_pin.model.base.steered import SteeredBase
from mmnn_pin.settings.meanings import meanings
from mmnn_pin.torque.concurrent import ConcurrentSettings, History


class Said(NamedTuple):
    """A class.

    Attributes:
        one, two: Both,
            on two lines [m].
    """

    one: int
    two: int = 2
    three: float = 3.0  # beside it [s]
    # above it, too long for
    # one line [N m]
    four: str = "  # no comment"
    five: int = 5


def test_fields_are_told_by_docstring_and_comments() -> None:
    assert meanings(Said) == {
        "one": "Both, on two lines [m].",
        "two": "Both, on two lines [m].",
        "three": "beside it [s]",
        "four": "above it, too long for one line [N m]",
    }


def test_every_field_is_told_of_settings_numbers_and_kinds_of_base() -> None:
    assert [*meanings(ConcurrentSettings)] == [*ConcurrentSettings.__struct_fields__]
    assert [*meanings(History)] == [*History._fields]
    assert {"wheels", "pivots", "length"} <= meanings(SteeredBase).keys()  # of `Base` and its own

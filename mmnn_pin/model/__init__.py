"""The robot: its file audited, its base and arm understood, its Pinocchio model with the motions left to it.

The names are loaded when first used, so that a controller that asks a base for its law does not load the rest.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from .base.base import Base, Wheel
    from .base.report import Undecided
    from .loading import load
    from .robot import Robot
    from .robots import bundled

__all__ = ["Base", "Robot", "Undecided", "Wheel", "bundled", "load"]
_HOME = {"Base": "base.base", "Wheel": "base.base", "Undecided": "base.report", "Robot": "robot", "bundled": "robots"}


def __getattr__(name: str) -> Any:
    if name not in __all__:
        raise AttributeError(f"module 'mmnn_pin.model' has no attribute '{name}'")
    return getattr(import_module(f"mmnn_pin.model.{_HOME.get(name, 'loading')}"), name)

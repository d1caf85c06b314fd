"""The robot: its file audited, its base and arm understood, its Pinocchio model with the motions left to it."""

from .base.base import Base, Wheel
from .base.report import Undecided
from .loading import load
from .robot import Robot
from .robots import bundled

__all__ = ["Base", "Robot", "Undecided", "Wheel", "bundled", "load"]

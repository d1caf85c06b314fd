"""What the robot is: the file audited, its mobile base found, and its Pinocchio model with the motions left to it."""

from mmnn_pin.model.loading import load
from mmnn_pin.model.robot import Robot
from mmnn_pin.model.robots import bundled

from .base.base import Base, Undecided, Wheel

__all__ = ["Base", "Robot", "Undecided", "Wheel", "bundled", "load"]

"""A robot in meshcat: Pinocchio's visualizer on a server of this machine, with sliders and a legend beside it."""

from .view import RobotView, played

"""The plan of a loop: all that an engine needs of it, looked up and checked."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from ..elementary.matrices import pseudo_inverse
from ..kinematic import Steering
from ..model.robot import Robot
from ..plant.contact.feet import Contact
from ..settings import Timing
from ..signals import Array, Layout
from ..torque.controller import CompiledController, Context, TorqueController
from .lead import Lead
from .servo_model import LinearServos
from .sight import VelocityFilter


@dataclass(frozen=True, eq=False)
class Plan:
    """The plan of a loop: all that an engine needs of it, looked up and checked."""

    robot: Robot  # the robot, as all but its plant take it
    true: Robot  # the true robot, which may roll on wheels of other radii
    layout: Layout  # where the signals stand in a row
    timing: Timing  # periods
    controller: TorqueController | CompiledController  # the controller
    context: Context  # what it is told before the run
    believed: Robot  # the robot that it believes in, where it uses a model
    gains: Array  # (3,) of the kinematic layer
    K: Array  # (n,) gain of the filtered arm error [1/s]
    bounds: Array  # (p,) on |nu|, beyond which a state counts as lost
    setpoints: Array  # the setpoint of every control sample, (samples, ...)
    loaded: Robot | None = None  # the robot once it has picked up its payload; None without one
    contact: Contact | None = None  # the floor of the contact plant; None for the ideal plant
    block: int = 1  # samples that an engine hands over at a time
    latency: float = 0.0  # known delay between measurement and torque, for the check of the gains [s]
    lag: float | tuple[float, ...] = 0.0  # time constant of the motors, one number or one per motor, for the same [s]
    sight: VelocityFilter | None = None  # how velocities are made of encoders, for the same; None where they are exact
    # what the servos of velocity interfaces amount to, for the same; None without any
    servo: LinearServos | None = None
    lead: Lead | None = None  # how Psi_hat looks ahead to where the torque acts; None where it does not
    age: float = 0.0  # by how much measurements are brought up to now [s]
    touched: str = ""  # the frame that touches something; empty where none does
    steering: Steering | None = None  # of a base that steers; None for others
    freezes: bool = False  # whether contact keeps a learner from learning
    # of the trailer that follows the reference, as of `Kinematic.hitch_of`; (0,) where the base does
    hitch: Array = field(default_factory=lambda: np.zeros(0))

    @property
    def E_inv(self) -> Array:
        """(motors, p) motor torques from the torque on nu; of a base that steers those of the last sample."""
        return pseudo_inverse(self.robot.E) if self.steering is None else self.steering.E_inv

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
    """The plan of a loop: all that an engine needs of it, looked up and checked.

    Attributes:
        robot: The robot, as all but its plant take it.
        true: The true robot, which may roll on wheels of other radii.
        layout: Where the signals stand in a row.
        timing: Periods.
        controller: The controller.
        context: What it is told before the run.
        believed: The robot that it believes in, where it uses a model.
        gains: (3,) of the kinematic layer.
        K: (n,) gain of the filtered arm error [1/s].
        bounds: (p,) on |nu|, beyond which a state counts as lost.
        setpoints: The setpoint of every control sample, (samples, ...).
        loaded: The robot once it has picked up its payload; None without one.
        contact: The floor of the contact plant; None for the ideal plant.
        block: Samples that an engine hands over at a time.
        latency: Known delay between measurement and torque, for the check of the gains [s].
        lag: Time constant of the motors, one number or one per motor, for the same [s].
        sight: How velocities are made of encoders, for the same; None where they are exact.
        servo: What the servos of velocity interfaces amount to, for the same; None without any.
        lead: How Psi_hat looks ahead to where the torque acts; None where it does not.
        age: By how much measurements are brought up to now [s].
        steering: Of a base that steers; None for others.
        touched: The frame that touches something; empty where none does.
        freezes: Whether contact keeps a learner from learning.
        hitch: Of the trailer that follows the reference, as of `Kinematic.hitch_of`; (0,) where the base does.
    """

    robot: Robot
    true: Robot
    layout: Layout
    timing: Timing
    controller: TorqueController | CompiledController
    context: Context
    believed: Robot
    gains: Array
    K: Array
    bounds: Array
    setpoints: Array
    loaded: Robot | None = None
    contact: Contact | None = None
    block: int = 1
    latency: float = 0.0
    lag: float | tuple[float, ...] = 0.0
    sight: VelocityFilter | None = None
    servo: LinearServos | None = None
    lead: Lead | None = None
    age: float = 0.0
    touched: str = ""
    steering: Steering | None = None
    freezes: bool = False
    hitch: Array = field(default_factory=lambda: np.zeros(0))

    @property
    def E_inv(self) -> Array:
        """(motors, p) motor torques from the torque on nu; of a base that steers those of the last sample."""
        return pseudo_inverse(self.robot.E) if self.steering is None else self.steering.E_inv

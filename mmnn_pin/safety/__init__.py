"""A supervisor between controller and motors: limits, timeouts, and a stop that holds the arm and brakes the base.

At every measurement it refuses what is not finite and keeps what it had. At every control sample it refuses a command
that is not finite, bounds the weights, clips the motor torques, and trips when a limit is passed. After a trip the
controller is no longer asked: the base is braked and the arm is held where it was by the experiment's own feedback,
with an integral against gravity. Without fresh measurements the base gets no torque, that of the arm ramps to zero, and
the windings of the motors are shorted where they brake (`actuator.brake`); so it is where feedback does not bring the
robot to rest in time. Where the drive motors have such a brake the base is braked by it at once, for which nothing has
to be measured.

A program of your own makes a `Safety.supervisor` once, calls `accept` at every measurement, `supervise` at every
control sample, and asks `may_learn` whether the controller is still to be asked.
"""

from .door import accept, release
from .settings import Safety, new_state, no_supervisor, remarks, steering_motors, trip_of
from .supervisor import (
    RAMPING,
    RUNNING,
    STEPPED_IN,
    STOPPING,
    TRIPPED,
    Supervisor,
    SupervisorState,
    has_ended,
    may_learn,
    press,
    supervise,
)

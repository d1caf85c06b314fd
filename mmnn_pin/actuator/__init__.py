"""The motors and gears between a commanded torque and the joints: limits, current loop, supply, backlash.

`Actuator` in `settings` makes the list of effects, `effects` has one class for each.
"""

from .effects import STATES, Backlash, Drive, Motors, MotorState, motor_state, new_drive
from .settings import NEVER, Actuator, motor_places

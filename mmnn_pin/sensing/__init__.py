"""From the state to the Measurement: encoders, differenced velocities, odometry, noise, delay.

`Sensor` in `settings` makes the list of effects, `effects` has one class for each.
"""

from .effects import FrozenEncoders, Sensors, exact, observe
from .settings import Sensor

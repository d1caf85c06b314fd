"""From the state to the Measurement: encoders, differenced velocities, odometry, noise, delay."""

from .encoders import measure
from .exact import exact
from .settings import Sensing, Sensor

__all__ = ["Sensing", "Sensor", "exact", "measure"]

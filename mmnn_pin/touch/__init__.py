"""Touch: what the motors say of the world that pushes back, without a sensor of forces.

`Touch` are the settings, `feel` and `remember` the two halves of a control sample, before and after the torque.
"""

from .new_observer import Sending, new_feeler, new_state, touch_shapes
from .observer import Feeler, feel, give_way, go_back, is_asked, is_frozen, remember
from .settings import Touch

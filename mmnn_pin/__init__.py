"""Controllers that learn the dynamics of nonholonomic mobile manipulators, checked against Pinocchio.

    reference -> kinematic -> torque -> safety -> actuator -> plant -> sensor -> (back)        closed by `loop`

Six things are enough to begin with: a robot (`load`), a `Trajectory`, controllers (`PD`, `Neural`, or their names), a
`Loop` around them, the `Recording` that it leaves, and an experiment (`compare`, or a file: `load_experiment`).

    >>> robot = load("platform_arm")
    >>> path = Trajectory.from_waypoints(robot, base=[(0, 0), (1, 0), (1, 1)])
    >>> runs = compare(robot, path, ["pd", "two_layer"], duration=0.4)
    >>> print(runs["pd"].summary())
    pd on platform_arm: completed at t = 0.4 s, 200 rows

The names here are those that most people need; they are loaded when first used. All others are in their modules:

- `mmnn_pin.model`: what the robot is; `model.dynamics`, `model.regressor`, `model.checks`.
- `mmnn_pin.reference`: where it should be: more paths and profiles, `reference.hand`, wishes of a joystick.
- `mmnn_pin.kinematic`, `mmnn_pin.torque`: pose error to velocity command to torque; a module for every controller.
- `mmnn_pin.safety`, `actuator`, `disturbance`, `sensing`, `plant`: the robot as it is, simulated.
- `mmnn_pin.loop`: one row of signals per control sample; `loop.batch` for thousands of runs.
- `mmnn_pin.recording`, `deploy`, `lab`: one run; out of the simulation; what judges and shows.
"""

from __future__ import annotations

from . import program  # noqa: F401 - first: from then on Ctrl-C is heard

# isort: split
import lazy_loader

from .shown import ABOVE

__version__ = "0.3.0"
__getattr__, loaded, __all__ = lazy_loader.attach_stub(__name__, __file__)  # the names of __init__.pyi


def __dir__() -> list[str]:
    return [*loaded(), "__version__"]


def above() -> None:
    """Import what shows and writes results, here and in what is installed above the package."""
    from importlib.metadata import entry_points

    from .deploy.identify import corrected  # noqa: F401
    from .lab.show import gallery  # noqa: F401

    for point in entry_points(group="mmnn_pin.show"):
        point.load()


ABOVE.append(above)

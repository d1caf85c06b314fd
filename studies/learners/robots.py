"""Every learner with its defaults on every robot of `mmnn list`, along the eight of `track`: error over PD's.

For base (position) and arm (all joints together) the RMS error after 2 s over that of PD, and the largest peak torque
over its motor's limit. Arguments are robots and controllers, none for all, and `key=value`s; docs/learners.md has the
table. A run that is lost says when.

    python studies/learners/robots.py so100 so101 kalman_bilinear
"""

from __future__ import annotations

import sys

import numpy as np

from mmnn_pin import load_experiment
from mmnn_pin.batch import Run, simulate_many
from mmnn_pin.errors import InputError
from mmnn_pin.experiments.controllers import CONTROLLERS, EFFECTIVE
from mmnn_pin.metrics import as_columns
from mmnn_pin.model.robots import bundled, extra
from mmnn_pin.signals import Array

LATE = (2.0, 10.0)  # [s]
NAMES = tuple(name for name in CONTROLLERS if name not in EFFECTIVE and name not in ("pd", "two_layer_random"))


def error(run: Run, signal: str, wanted: tuple[str, ...] = ()) -> float:
    """RMS error after 2 s, root of the sum over components; nan where a robot has none."""
    ends = tuple(f".{name}.rms_{LATE[0]:g}_{LATE[1]:g}" for name in wanted) or (f".rms_{LATE[0]:g}_{LATE[1]:g}",)
    found = [value for key, value in run.metrics.items() if key.startswith(signal + ".") and key.endswith(ends)]
    return float(np.sqrt(np.sum(np.square(found)))) if found else np.nan


def errors(run: Run) -> Array:
    """Errors of the base's position [m] and of the arm [rad], (2,)."""
    return np.array([error(run, "pose_error", ("x", "y")), error(run, "e")])


def peak(run: Run, limits: Array) -> float:
    """Largest peak torque over its motor's limit."""
    assert run.recording is not None
    return float(np.max(abs(as_columns(run.recording["motor_torque"])) / limits))


def tell(robot_name: str, controllers: tuple[str, ...], settings: list[str]) -> None:
    """Run PD and controllers on a robot and print what they reached."""
    experiment = load_experiment("track", [f"robot={robot_name}", *settings])
    try:
        robot = experiment.load_robot()
        loops = [experiment.loop(robot, experiment.controller(name, robot=robot)) for name in ("pd", *controllers)]
    except InputError as refused:
        print(f"{robot_name}: not run: {refused.what}", flush=True)
        return
    runs = simulate_many(loops, windows=(LATE,), keep=("motor_torque",))
    of_pd = errors(runs[0])
    print(f"{robot_name}: pd: base {1e3 * of_pd[0]:.3g} mm, arm {1e3 * of_pd[1]:.3g} mrad", flush=True)
    for name, run in zip(("pd", *controllers), runs, strict=True):
        base, arm = errors(run) / of_pd
        outcome = run.outcome.status if run.outcome.status == "completed" else f"lost at {run.outcome.time:.2f} s"
        most = peak(run, robot.effort_limits)
        print(f"  {name:22s} base {base:8.3g}  arm {arm:8.3g}  torque {most:8.3g}  {outcome}", flush=True)


def main(arguments: list[str]) -> None:
    """Tell of all robots and controllers that are named."""
    settings = [text for text in arguments if "=" in text]
    controllers = tuple(text for text in arguments if text in CONTROLLERS) or NAMES
    robots = [text for text in arguments if text not in settings and text not in CONTROLLERS] or list(
        bundled() | extra()
    )
    for name in robots:
        tell(name, controllers, settings)


if __name__ == "__main__":
    main(sys.argv[1:])

"""Every learner with its defaults on every robot of `mmnn list`, on an eight (robots.toml), beside plain controllers.

For base (position) and arm (all joints together) the RMS error after 2 s over the smallest of `pd`, `pd_gravity` and
`pid`, and the largest peak torque over its motor's limit. Arguments are robots and controllers, none for all, and
`key=value`s; `--table` prints it once more as the table of docs/explanation/learners.md, with "!" where a motor was
asked for more than it can give.

    python research/studies/learners/robots.py so100 so101 kalman_bilinear
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np

from mmnn_pin import load_experiment
from mmnn_pin.errors import InputError
from mmnn_pin.lab.experiments.controllers import CONTROLLERS, EFFECTIVE
from mmnn_pin.loop.batch import BatchRun, simulate_many
from mmnn_pin.model.robots import bundled, extra
from mmnn_pin.recording.recording import as_columns
from mmnn_pin.signals import Array

LATE = (2.0, 10.0)  # [s]
PLAIN = ("pd", "pd_gravity", "pid")  # what an engineer tries first: the best of them is what counts, for base and arm
NAMES = tuple(name for name in CONTROLLERS if name not in (*EFFECTIVE, *PLAIN, "two_layer_random"))


def error(run: BatchRun, signal: str, wanted: tuple[str, ...] = ()) -> float:
    """RMS error after 2 s, root of the sum over components; nan where a robot has none."""
    ends = tuple(f".{name}.rms_{LATE[0]:g}_{LATE[1]:g}" for name in wanted) or (f".rms_{LATE[0]:g}_{LATE[1]:g}",)
    found = [value for key, value in run.metrics.items() if key.startswith(signal + ".") and key.endswith(ends)]
    return float(np.sqrt(np.sum(np.square(found)))) if found else np.nan


def errors(run: BatchRun) -> Array:
    """Errors of the base's position [m] and of the arm [rad], (2,)."""
    return np.array([error(run, "pose_error", ("x", "y")), error(run, "e")])


def peak(run: BatchRun, limits: Array) -> float:
    """Largest peak torque over its motor's limit."""
    assert run.recording is not None
    return float(np.max(abs(as_columns(run.recording["motor_torque"])) / limits))


def tell(robot_name: str, controllers: tuple[str, ...], settings: list[str]) -> list[str]:
    """Run the plain controllers and others on a robot and print what they reached; the cells of a table's row."""
    experiment = load_experiment(Path(__file__).with_suffix(".toml"), [f"robot={robot_name}", *settings])
    try:
        robot = experiment.load_robot()
        loops = [experiment.loop(robot, experiment.controller(name, robot=robot)) for name in (*PLAIN, *controllers)]
    except InputError as refused:
        print(f"{robot_name}: not run: {refused.what}", flush=True)
        return []
    runs = simulate_many(loops, windows=(LATE,), keep=("motor_torque",))
    best = np.min([errors(run) for run in runs[: len(PLAIN)] if run.outcome.status == "completed"], axis=0)
    cells = [f"`{robot_name}`", " ".join(f"{1e3 * value:.3g}" for value in best if np.isfinite(value))]
    for name, run in zip((*PLAIN, *controllers), runs, strict=True):
        ratios, most = errors(run) / best, peak(run, robot.effort_limits)
        done = run.outcome.status == "completed"
        parts = "  ".join(f"{part} {value:8.3g}" for part, value in zip(("base", "arm"), ratios, strict=True))
        outcome = "completed" if done else f"lost at {run.outcome.time:.2f} s"
        print(f"{robot_name} {name:20s} {parts}  torque {most:8.3g}  {outcome}", flush=True)
        cells += [
            " ".join(f"{value:.2g}" for value in ratios if np.isfinite(value)) + "!" * (most > 1) if done else "lost"
        ]
    return cells


def main(arguments: list[str]) -> None:
    """Tell of all robots and controllers that are named."""
    settings = [text for text in arguments if "=" in text]
    controllers = tuple(text for text in arguments if text in CONTROLLERS) or NAMES
    named = [text for text in arguments if text not in (*settings, *CONTROLLERS, "--table")]
    rows = [tell(name, controllers, settings) for name in named or (bundled() | extra())]
    if "--table" in arguments:
        names = ["robot", "best of three [mm, mrad]", *PLAIN, *controllers]
        for cells in (names, ["---"] * len(names), *filter(None, rows)):
            print(f"| {' | '.join(cells)} |")


if __name__ == "__main__":
    main(sys.argv[1:])

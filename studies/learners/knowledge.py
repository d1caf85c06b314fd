"""What learners know after a motion: tracking errors, FVU online, and frozen on faster motions never trained on.

The thesis robot with friction and noise, started from nothing. Arguments are controllers and `key=value`s for the
training run; `after=circle` goes on after the training with half a minute of a circle on which the arm hardly moves,
`only=circle` trains on that alone. docs/learners.md has the table.

    python studies/learners/knowledge.py adaptive adaptive_composite concurrent
"""

from __future__ import annotations

import sys
from dataclasses import replace
from typing import Any

import numpy as np

from mmnn_pin import Loop, Memory, Recording, load_experiment
from mmnn_pin.control import Torque
from mmnn_pin.proof.fvu import fvu
from mmnn_pin.signals import Array, Layout

EIGHT = "{{type='eight', length={}, width={}, period={}, ramp=1.0}}"
CIRCLE = "{{type='circle', radius={}, speed={}, ramp=1.0}}"
Motion = tuple[str, tuple[float, float], float, float]
MOTIONS: dict[str, Motion] = {  # base, periods of the arm's joints [s], their amplitude [rad], duration [s]
    "training": (EIGHT.format(1.5, 0.75, 12.0), (4.0, 3.0), 0.785, 48.0),
    "poor": (CIRCLE.format(1.0, 0.4), (40.0, 40.0), 0.1, 30.0),
    "eight3": (EIGHT.format(1.5, 0.75, 9.23), (3.08, 2.31), 0.785, 18.5),
    "eight2": (EIGHT.format(0.9, 0.45, 9.23), (3.08, 2.31), 0.785, 18.5),
    "circle": (CIRCLE.format(0.7, 0.5), (1.8, 1.3), 0.785, 12.0),
}
HELD_OUT = ("eight3", "eight2", "circle")
NOISE = ["sensor.noise=1e-4", "sensor.pose_noise=[1e-4,1e-4,1e-4]", "sensor.velocity_noise=2e-3"]
COMMON = [
    "friction.coulomb=0.5", "time.plant_step=0.002", "time.integrator=implicit_friction",
    "robust.base=0.0", "robust.arm=0.0",
]  # fmt: skip


def loop(name: str, motion: str, said: list[str]) -> Loop:
    """The closed loop of a controller on a motion."""
    base, periods, amplitude, duration = MOTIONS[motion]
    arm = [f"{{type='sine', amplitude={amplitude}, period={period}, phase=1.5708}}" for period in periods]
    moves = [f"reference.base={base}", f"reference.arm=[{','.join(arm)}]", f"time.duration={duration}"]
    experiment = load_experiment("chapter4", [*COMMON, *moves, *said])
    robot = experiment.load_robot()
    return experiment.loop(robot, experiment.controller(name, robot=robot))


def rows_of(run: Recording, layout: Layout) -> Array:
    """All signals of a run, (N, width)."""
    rows = np.zeros((len(run), layout.width))
    for name in run:
        rows[:, layout.where(name)] = np.reshape(run[name], (len(run), -1))
    return rows


def frozen_fvu(learned: Loop, memory: Memory, rows: Array) -> float:
    """FVU of a learner that no longer learns, mean of the components."""
    layout, controller = learned.robot.layout, learned.controller
    still: Any = replace(controller, learning=False) if hasattr(controller, "learning") else controller
    row, told = layout.new_row(), np.zeros((len(rows), layout.dof))
    torque = Torque(still, learned.wiring(), row, learned.robot, memory.snapshot())
    for k in range(len(rows)):
        row[:] = rows[k]
        row[layout.where("psi_hat")] = 0.0
        torque.step(k * learned.timing.control_period)
        told[k] = row[layout.where("psi_hat")]
    return float(fvu(rows[250:, layout.where("psi")], told[250:]).mean())


def errors(run: Recording) -> Array:
    """RMS errors after 2 s: x, y [mm], phi, joints [mrad]."""
    both = np.hstack((run["true_pose_error"], run["true_e"]))[run.time > min(2.0, run.time[-1] / 2)]
    return 1e3 * np.sqrt(np.mean(both**2, axis=0))


def memory_after(learned: Loop, run: Recording) -> Memory:
    """A controller's memory at the end of a run."""
    memory: Memory = learned.controller.init(learned.wiring())
    memory.values[:] = run.final["memory"]
    return memory


def tell(name: str, said: list[str], truth: dict[str, Array], motions: tuple[str, ...]) -> None:
    """Train a controller on motions, one after the other, and print what it reached."""
    memory = None
    for motion in motions:
        learned = loop(name, motion, NOISE + said)
        run = learned.run(memory=memory)
        memory, late = memory_after(learned, run), run.time > 0.5
        online = fvu(run["psi"][late], run["psi_hat"][late]).mean()
        frozen = "  ".join(f"{motion} {frozen_fvu(learned, memory, rows):.5f}" for motion, rows in truth.items())
        numbers = " ".join(f"{value:.3g}" for value in errors(run))
        print(f"{name}, {motion}: errors {numbers}   FVU online {online:.5f}, frozen {frozen}", flush=True)
        if run.outcome.message:
            print(f"    {run.outcome.message}")


def main(arguments: list[str]) -> None:
    """Tell of all controllers that are named."""
    said = [text for text in arguments if "=" in text]
    motions = ("training",)
    if "after=circle" in said:
        said.remove("after=circle")
        motions = ("training", "poor")
    if "only=circle" in said:
        said.remove("only=circle")
        motions = ("poor",)
    told = {motion: loop("computed_torque", motion, []) for motion in HELD_OUT}
    truth = {motion: rows_of(one.run(), one.robot.layout) for motion, one in told.items()}
    for name in [text for text in arguments if "=" not in text]:
        tell(name, said, truth, motions)


if __name__ == "__main__":
    main(sys.argv[1:])

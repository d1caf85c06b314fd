"""What learners know after a motion: tracking errors, FVU online, and frozen on faster motions never trained on.

The thesis robot with friction and noise, started from nothing. Arguments are controllers and `key=value`s for the
training run; `after=poor` goes on after the training with half a minute of a circle on which the arm hardly moves,
`only=poor` trains on that alone, `only=rich` on the same eight with the arm shaken. `--time` tells what a sample takes
instead. docs/explanation/learners.md has the tables.

    python research/studies/learners/knowledge.py adaptive adaptive_composite concurrent
"""

from __future__ import annotations

import sys
from dataclasses import fields, replace
from time import process_time
from typing import Any

import numpy as np

from mmnn_pin import Loop, Recording, load_experiment
from mmnn_pin.lab.psi.learner import Learner, LearnerStepper
from mmnn_pin.lab.psi.psi import fvu
from mmnn_pin.signals import Array, Layout
from mmnn_pin.torque.controller import ControllerState


def sine(*parts: tuple[float, float]) -> str:
    """A joint's motion as a table: sines with these amplitudes [rad] and periods [s], all at their top at the start."""
    amplitudes, periods = zip(*parts, strict=True)
    return f"{{type='sines', amplitude={list(amplitudes)}, period={list(periods)}, phase={[1.5708] * len(parts)}}}"


EIGHT = "{{type='eight', length={}, width={}, period={}, ramp=1.0}}"
CIRCLE = "{{type='circle', radius={}, speed={}, ramp=1.0}}"
Motion = tuple[str, tuple[str, str], float]
MOTIONS: dict[str, Motion] = {  # base, the arm's joints, duration [s]
    "training": (EIGHT.format(1.5, 0.75, 12.0), (sine((0.785, 4.0)), sine((0.785, 3.0))), 48.0),
    "rich": (
        EIGHT.format(1.5, 0.75, 12.0),
        (sine((0.785, 4.0), (0.1, 1.3)), sine((0.785, 3.0), (0.1, 0.8))),
        48.0,
    ),
    "poor": (CIRCLE.format(1.0, 0.4), (sine((0.1, 40.0)), sine((0.1, 40.0))), 30.0),
    "eight3": (EIGHT.format(1.5, 0.75, 9.23), (sine((0.785, 3.08)), sine((0.785, 2.31))), 18.5),
    "eight2": (EIGHT.format(0.9, 0.45, 9.23), (sine((0.785, 3.08)), sine((0.785, 2.31))), 18.5),
    "circle": (CIRCLE.format(0.7, 0.5), (sine((0.785, 1.8)), sine((0.785, 1.3))), 12.0),
}
HELD_OUT = ("eight3", "eight2", "circle")
NOISE = ["sensor.noise=1e-4", "sensor.pose_noise=[1e-4,1e-4,1e-4]", "sensor.velocity_noise=2e-3"]
COMMON = [
    "friction.coulomb=0.5", "time.plant_step=0.002", "time.integrator=implicit_friction",
    "robust.base=0.0", "robust.arm=0.0",
]  # fmt: skip


def loop(name: str, motion: str, settings: list[str]) -> Loop:
    """The closed loop of a controller on a motion."""
    base, arm, duration = MOTIONS[motion]
    moves = [f"reference.base={base}", f"reference.arm=[{','.join(arm)}]", f"time.duration={duration}"]
    experiment = load_experiment("chapter4", [*COMMON, *moves, *settings])
    robot = experiment.load_robot()
    return experiment.loop(robot, experiment.controller(name, robot=robot))


def rows_of(run: Recording, layout: Layout) -> Array:
    """All signals of a run, (N, width)."""
    rows = np.zeros((len(run), layout.width))
    for name in run:
        rows[:, layout.where(name)] = np.reshape(run[name], (len(run), -1))
    return rows


def psi_hat_along(loop: Loop, layout: Layout, state: ControllerState, rows: Array) -> Array:
    """Psi_hat of the controller of a loop, step by step along rows (N, width); (N, p) [N, N m].

    It is what the weights say, before the motors' limits take of it.

    Args:
        loop: Of the controller, which learns from the rows unless it is frozen.
        layout: Of the rows; they may lack what the loop's hardware adds.
        state: What it remembers, changed in place.
        rows: The rows; they are not changed.
    """
    context = replace(loop.context(), layout=layout)
    stepper = LearnerStepper(Learner(loop.controller, context, state, state, 0.0, loop.believed), state)
    found = np.zeros((len(rows), layout.dof))
    for n, row in enumerate(rows):
        stepper.step(row)
        found[n] = stepper.known
    return found


def frozen_fvu(learned: Loop, state: ControllerState, rows: Array) -> float:
    """FVU of a learner that no longer learns, mean of the components."""
    layout = Layout.of(learned.robot.dimensions)
    learner: Any = learned.controller
    still = replace(learner, learning=False) if any(f.name == "learning" for f in fields(learner)) else learner
    told = psi_hat_along(replace(learned, controller=still), layout, state.snapshot(), rows)
    return float(fvu(rows[250:, layout.where("psi")], told[250:]).mean())


def errors(run: Recording) -> Array:
    """RMS errors after 2 s: x, y [mm], phi, joints [mrad]."""
    both = np.hstack((run["true_pose_error"], run["true_e"]))[run.time > min(2.0, run.time[-1] / 2)]
    return 1e3 * np.sqrt(np.mean(both**2, axis=0))


def memory_after(learned: Loop, run: Recording) -> ControllerState:
    """A controller's memory at the end of a run."""
    state: ControllerState = learned.controller.init(learned.context())
    state.values[:] = run.final["controller_state"]
    return state


def tell(name: str, settings: list[str], truth: dict[str, Array], motions: tuple[str, ...]) -> None:
    """Train a controller on motions, one after the other, and print what it reached."""
    state = None
    for motion in motions:
        learned = loop(name, motion, NOISE + settings)
        run = learned.run(state=state)
        state, late = memory_after(learned, run), run.time > 0.5
        online = fvu(run["psi"][late], run["psi_hat"][late]).mean()
        frozen = "  ".join(f"{motion} {frozen_fvu(learned, state, rows):.5f}" for motion, rows in truth.items())
        numbers = " ".join(f"{value:.3g}" for value in errors(run))
        print(f"{name}, {motion}: errors {numbers}   FVU online {online:.5f}, frozen {frozen}", flush=True)
        if run.outcome.message:
            print(f"    {run.outcome.message}")


def tell_time(name: str, settings: list[str]) -> None:
    """Print the processor time of a control sample of the whole compiled loop, best of five blocks of 1,000."""
    engine = loop(name, "training", NOISE + settings).engine_at()
    best = np.inf
    for k in range(6):
        began = process_time()
        for first in range(1000 * k, 1000 * (k + 1), 50):
            engine.advance(first, first + 50)
        best = min(best, process_time() - began if k else np.inf)  # the first one compiles
    print(f"{name}: {1e3 * best:.1f} us a sample")


def main(arguments: list[str]) -> None:
    """Tell of all controllers that are named."""
    names = [text for text in arguments if "=" not in text and text != "--time"]
    settings = [text for text in arguments if "=" in text]
    if "--time" in arguments:
        for name in names:
            tell_time(name, settings)
        return
    motions: tuple[str, ...] = ("training",)
    for word, meant in (("after=poor", ("training", "poor")), ("only=poor", ("poor",)), ("only=rich", ("rich",))):
        if word in settings:
            settings.remove(word)
            motions = meant
    told = {motion: loop("computed_torque", motion, []) for motion in HELD_OUT}
    truth = {motion: rows_of(one.run(), one.layout) for motion, one in told.items()}
    for name in names:
        tell(name, settings, truth, motions)


if __name__ == "__main__":
    main(sys.argv[1:])

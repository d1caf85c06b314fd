"""`mmnn run track` on every robot: the errors of its joints on the last lap of the arm, and what the motors gave.

    python -m research.studies.track_any [ROBOT...] [--joints] [--set KEY=VALUE]

ROBOT is a name or a path, none for all of `mmnn list`. A run has `LAPS` periods of the arm's swing, however slow the
reference is on that robot. It prints the tables of docs/how-to/tracking.md.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import click
import numpy as np
from numpy.typing import NDArray

from mmnn_pin import load_experiment
from mmnn_pin.errors import InputError
from mmnn_pin.lab.experiments.experiment import Experiment
from mmnn_pin.loop.batch import BatchRun, simulate_many
from mmnn_pin.loop.sampled import delay_margin
from mmnn_pin.model.robot import Robot
from mmnn_pin.model.robots import bundled, extra
from mmnn_pin.recording.recording import as_columns
from mmnn_pin.signals import Array

LAPS, PERIOD = 3, 6.0  # of the arm's swing [s]
NAMES = ("pd", "pd_gravity", "pid", "feedforward", "two_layer", "adaptive", "computed_torque")


@dataclass(frozen=True)
class RobotRow:
    """One robot."""

    name: str  # of the robot
    joints: tuple[str, ...]  # names of its arm's joints
    slowness: float  # of the reference
    margin: float  # delay margin of PD [s]
    # controller to the RMS errors of the joints on the last lap, (n,) [rad or m]; inf where the run was lost
    errors: dict[str, Array]
    base: dict[str, float]  # controller to the RMS error of the base's position likewise [m]
    given: dict[str, float]  # controller to the largest torque over its limit that a motor gave
    asked: dict[str, float]  # likewise, that it was asked for


def experiment_of(name: str, settings: tuple[str, ...] = ()) -> tuple[Experiment, Robot]:
    """The experiment for a robot, with laps as long as its reference is slow."""
    robot = load_experiment("track", [f"robot={name}", *settings]).load_robot()
    laps = [f"robot={name}", f"time.duration={LAPS * PERIOD}", *settings]
    slowness = load_experiment("track", laps).trajectory_of(robot).slowness
    end = float(np.ceil(LAPS * PERIOD * slowness))
    last = f"windows=[[{end - PERIOD * slowness!r},{end!r}]]"
    return load_experiment("track", [*laps, f"time.duration={end!r}", last]), robot


def row_of(name: str, settings: tuple[str, ...] = (), controllers: tuple[str, ...] = NAMES) -> RobotRow:
    """Run controllers on one robot."""
    experiment, robot = experiment_of(name, settings)
    loops = [experiment.loop(robot, experiment.controller(c, robot=robot)) for c in controllers]
    runs = simulate_many(loops, windows=experiment.windows, keep=("motor_torque", "applied"))
    found = dict(zip(controllers, runs, strict=True))
    ending = ".rms_{:g}_{:g}".format(*experiment.windows[-1])
    joints, lost = robot.joint_names, np.inf

    def rms(run: BatchRun, signal: str) -> float:
        return run.metrics.get(signal + ending, lost) if run.outcome.status == "completed" else lost

    def peak(run: BatchRun, signal: str) -> float:
        assert run.recording is not None
        torque = np.abs(as_columns(run.recording[signal])).max(axis=0)
        return float(np.divide(torque, robot.effort_limits, out=np.zeros(len(torque)), where=torque > 0).max())

    return RobotRow(
        Path(name).stem,
        tuple(joints),
        loops[0].trajectory.slowness,
        delay_margin(loops[0].plan()),
        {c: np.array([rms(run, f"e.{joint}") for joint in joints]) for c, run in found.items()},
        {c: float(np.hypot(rms(r, "pose_error.x"), rms(r, "pose_error.y"))) for c, r in found.items()},
        {c: peak(run, "applied") for c, run in found.items()},
        {c: peak(run, "motor_torque") for c, run in found.items()},
    )


def cell(value: float) -> str:
    """An error in mrad or mm."""
    return f"{1e3 * value:.3g}" if np.isfinite(value) else "lost"


def no_worse(row: RobotRow) -> NDArray[np.bool_]:
    """(n,) joints on which `adaptive` errs no more than `pd_gravity`."""
    found: NDArray[np.bool_] = row.errors["adaptive"] <= row.errors["pd_gravity"]
    return found


def summary(rows: list[RobotRow], controllers: tuple[str, ...] = NAMES) -> list[str]:
    """The table of `cells` in Markdown."""
    titles, *others = cells(rows, controllers)
    return [table_line(line) for line in (titles, ["---"] * len(titles), *others)]


def cells(rows: list[RobotRow], controllers: tuple[str, ...] = NAMES) -> list[list[str]]:
    """Titles, then per robot: the largest error of its joints under every controller, torques, slowness, margin."""
    lines = [["robot", "slower", "margin [ms]", *controllers, "torque given, asked", "adaptive no worse"]]
    for row in rows:
        worst = [cell(row.errors[name].max(initial=0.0)) for name in controllers]
        bases = [cell(row.base[name]) for name in controllers]
        errors = [f"{arm}; {base}" if base != "lost" else arm for arm, base in zip(worst, bases, strict=True)]
        torque = f"{max(row.given.values()):.2f}, {max(row.asked.values()):.2f}"
        count = f"{no_worse(row).sum()} of {len(row.joints)}"
        lines.append([row.name, f"{row.slowness:.2g}", f"{1e3 * row.margin:.1f}", *errors, torque, count])
    return lines


def per_joint(rows: list[RobotRow], wanted: bool | None = None) -> list[str]:
    """A line per joint; `wanted` of those on which `adaptive` is, or is not, worse than `pd_gravity` alone."""
    lines = [table_line(["robot", "joint", *NAMES]), table_line(["---"] * (2 + len(NAMES)))]
    for row in rows:
        worse = ~no_worse(row)
        for i, joint in enumerate(row.joints):
            if wanted is None or worse[i] == wanted:
                lines.append(table_line([row.name, joint, *(cell(row.errors[name][i]) for name in NAMES)]))
    return lines


def table_line(cells: list[str]) -> str:
    """A line of a table in Markdown."""
    return f"| {' | '.join(cells)} |"


@click.command(context_settings={"ignore_unknown_options": True})
@click.argument("robots", nargs=-1)
@click.option("--set", "settings", multiple=True, help="key=value of the experiment")
@click.option("--joints", is_flag=True, help="errors of every joint, too")
def main(robots: tuple[str, ...], settings: tuple[str, ...], joints: bool) -> None:
    """Track with every robot that can be loaded."""
    rows = []
    for name in robots or (*bundled(), *extra()):
        try:
            rows.append(row_of(name, settings))
        except InputError as refused:
            click.echo(f"{name}: not run: {refused.what}", err=True)
            continue
        click.echo("\n".join([*summary(rows[-1:])[2:], *(per_joint(rows[-1:])[2:] if joints else [])]), err=True)
    click.echo("\n".join(summary(rows)))
    worse = sum(int((~no_worse(row)).sum()) for row in rows)
    count = sum(len(row.joints) for row in rows)
    click.echo(f"\nadaptive is no worse than pd_gravity on {count - worse} of {count} joints; the others:\n")
    click.echo("\n".join(per_joint(rows, None if joints else True)))


if __name__ == "__main__":
    main()

"""Many runs on all cores, of which only some signals are kept: what a study judges, without a recording per run."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from threading import Event

import numpy as np

from mmnn_pin import Loop, Robot
from mmnn_pin.signals import Array, Layout

LOADED = Event()  # set once this process has the compiled code


@dataclass(frozen=True)
class Rollout:
    """What is left of a run."""

    completed: bool  # whether it reached its end; otherwise it diverged
    signals: dict[str, Array]  # name to (samples, size), in SI units


class Keep:
    """A sink for `Loop.stream` that copies a few columns.

    Args:
        layout: Where the signals stand in a row.
        names: Signals to keep.
    """

    def __init__(self, layout: Layout, names: Sequence[str]) -> None:
        self.places = {name: layout.where(name) for name in names}
        self.blocks: dict[str, list[Array]] = {
            name: [np.zeros((0, at.stop - at.start))] for name, at in self.places.items()
        }

    def append_block(self, rows: Array, step_times: Array) -> None:
        """Take rows (k, width)."""
        for name, at in self.places.items():
            self.blocks[name].append(rows[:, at].copy())

    def weights(self, time: float, arrays: Mapping[str, Array]) -> None:
        """Weights are not kept."""


def roll_out(loops: Sequence[Loop], names: Sequence[str]) -> list[Rollout]:
    """Run all loops; a run that diverges is a result.

    The same runs as `simulate_many` makes, bit for bit, whatever the number of cores.

    Args:
        loops: What to run.
        names: Signals to keep.
    """

    def one(loop: Loop) -> Rollout:
        loop = replace(loop, weights_interval=loop.timing.duration)  # nobody reads the weights on the way
        engine, keep = loop.engine_at(), Keep(loop.layout, names)
        outcome = loop.stream(engine, keep)
        return Rollout(outcome.status == "completed", {n: np.vstack(parts) for n, parts in keep.blocks.items()})

    alone = [] if LOADED.is_set() else loops[:1]  # it compiles, or loads the compiled code: no threads compete for it
    first = [one(loop) for loop in alone]
    LOADED.set()
    with ThreadPoolExecutor(os.cpu_count() or 1) as pool:
        return first + list(pool.map(one, loops[len(alone) :]))


def with_mount(robot: Robot, x: float) -> Robot:
    """The same robot with its first arm joint at another place along the platform's x axis [m]."""
    model = robot.model.copy()
    joint = model.getJointId(robot.joint_names[0])
    place = model.jointPlacements[joint].copy()
    place.translation = np.array([x, *place.translation[1:]])
    model.jointPlacements[joint] = place
    return replace(robot, model=model)


def with_centre_of_mass(robot: Robot, x: float) -> Robot:
    """The same robot with the centre of mass of its platform moved to x [m]; the inertia about that centre stays."""
    model = robot.model.copy()
    body = model.inertias[1].copy()
    body.lever = np.array([x, *body.lever[1:]])
    model.inertias[1] = body
    return replace(robot, model=model)

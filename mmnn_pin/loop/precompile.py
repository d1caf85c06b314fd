"""Compiles the blocks in two processes before a first run.

numba holds a lock while it compiles, so threads do not help; two processes meet in the cache on disk. Each block is
called once on a small robot: what is compiled depends on the types of its arguments only. Imperfect sensors and all
else that stands behind a hardware model is left out: it is compiled by the first run that has it.
"""

from __future__ import annotations

import gc
import os
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from multiprocessing import get_context
from typing import Any

import numpy as np
from numba.core.event import Listener, register

from ..children import Spawning, end_with
from ..compiled import cache_folder, is_warm
from ..elementary import arrays
from ..model.loading import load
from ..model.reduction import as_measured, quadratic
from ..model.tree.body import body_of, evaluate, new_work
from ..model.tree.dynamics import potential_energy
from ..model.tree.twin import psi_of
from ..plant.integrators import Joints, Terms, derivative, euler, rk4_stage
from ..recording.metrics import accumulate
from ..sensing import exact
from ..signals import INDEX, Layout
from ..torque import law
from ..torque.controller import Context, Feedback
from ..torque.neural import Neural
from .lead import catch_up, reference_then
from .sample import after_torque, before_torque


def precompile(tell: Callable[[str], None] = lambda name: None) -> None:
    """Compile the blocks on two cores, unless that was done, or cannot be kept.

    What it leaves out, also where the second process fails, is compiled when it is first called.

    Args:
        tell: Called every second with what is compiled while the second process goes on alone.
    """
    if is_warm() or cache_folder() is None or (os.cpu_count() or 1) < 2:
        return
    context: Any = get_context("fork") if sys.platform == "linux" else Spawning()  # a fork has imported everything
    other = context.Process(target=quietly, args=(call_plant_blocks, os.getpid()), daemon=True)
    other.start()
    try:
        with no_collection():
            call_control_blocks()
        while other.is_alive():
            other.join(1.0)
            tell("the dynamics")
    finally:
        other.kill()


def quietly(work: Callable[[], None], parent: int) -> None:
    """Work in a process that prints nothing, nor says that Ctrl-C ended it, and ends with its parent."""
    end_with(parent)
    nowhere = os.open(os.devnull, os.O_RDWR)
    for stream in range(3):
        os.dup2(nowhere, stream)
    with no_collection():
        work()


class Told(Listener):
    """Hears from numba what is compiled, and tells its name.

    Args:
        tell: Called with the name of a function before it is compiled.
    """

    def __init__(self, tell: Callable[[str], None]) -> None:
        self.tell = tell

    def on_start(self, event: Any) -> None:
        """A function is going to be compiled."""
        self.tell(event.data["dispatcher"].py_func.__name__)

    def on_end(self, event: Any) -> None:
        """It is compiled."""


def when_compiling(tell: Callable[[str], None]) -> None:
    """From now on, tell the name of every function that this process compiles."""
    register("numba:compile", Told(tell))


@contextmanager
def no_collection() -> Iterator[None]:
    """Without Python's search for rings of objects, which takes a sixth of the time that numba's Python takes."""
    gc.disable()
    try:
        yield
    finally:
        gc.enable()
        gc.freeze()  # what numba keeps is not searched again


def call_control_blocks() -> None:
    """Call exact measurement, the reference of a late one, velocity command, torque and the integrators."""
    layout = Layout(base=2, arm=1, full=4, motors=3)
    row, at, p, nv = layout.new_row(), layout.offsets, layout.dof, layout.full
    controller, context = Neural(feedback=Feedback(1.0, 1.0)), Context(layout, 0.001, 1)
    numbers, state = controller.law(context).numbers, controller.init(context)
    setpoint = np.zeros(at[INDEX["pose"]] - at[INDEX["pose_ref"]])
    y, arm, nu = np.zeros(nv + p + 1), np.array([3]), np.zeros(p)
    exact(row, at, y[:nv], nu, arm)
    reference_then(setpoint[None], 0, 0.0, setpoint)
    catch_up(row, at, setpoint, setpoint, 0.0)
    before_torque(row, at, 0.0, setpoint, np.ones(3), np.ones(1))
    law.step(row, at, numbers, state.values, None, None)
    T, M, L, v = np.zeros((nv, p)), np.eye(p), np.zeros((p, p)), np.zeros(nv)
    ydot, grip = y.copy(), np.zeros((nv, p + 2))
    joints = Joints(T, v.copy(), np.zeros((nv, 3)), nu, 2, False)
    terms = Terms(v, M, nu, nu, np.zeros(nv), ydot, L, nu.copy(), grip)
    derivative(y, nu, joints, terms)
    euler(0, 0.001, joints, terms, nu, y)
    rk4_stage(0, 0.001, y, ydot, y.copy(), y.copy())


def call_plant_blocks() -> None:
    """Call the dynamics, the guard and what sums up the rows."""
    robot = load("platform_arm")
    layout, body = Layout.of(robot.dimensions), body_of(robot)
    work, nv, p = new_work(body), layout.full, layout.dof
    row, y, nu = layout.new_row(), np.concatenate((robot.neutral_position(), np.zeros(p + 1))), np.zeros(p)
    pose, velocity, q, qdot = (row[layout.where(name)] for name in ("pose", "velocity", "q", "qdot"))
    as_measured(body.offset, body.columns, pose, velocity, q, qdot, y[:nv], y[nv : nv + p])
    evaluate(body, work, y[:nv], y[nv : nv + p])
    psi_of(body, work, y[:nv], nu, nu, np.zeros(p))
    potential_energy(body.tree, y[:nv], work.scratch)
    arrays.cos_sin(np.zeros(1))  # of references
    quadratic(work.M, nu)
    after_torque(row, layout.offsets, y, body.arm, np.eye(p), np.eye(p), 0.0, 0.0, np.ones(p))
    sums, windows = np.zeros(1), np.zeros((1, 2))
    accumulate(row[None], np.array([0]), windows, sums, sums.copy(), sums.copy(), np.zeros(1), np.zeros((1, 1)))

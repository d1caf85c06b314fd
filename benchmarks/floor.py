"""A worker for the floor, the same closed loop in C++ with Pinocchio and in numba alone: `floor.py FOLDER SECONDS`.

The folder holds the built reference: the modules `mmcore`, `loop_nb` and `loop_np`, `models/thesis5.urdf`, and the
environment `env` whose interpreter runs this. A request is `cpp`, `numba`, or `batch KIND RUNS THREADS` of one of them.
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import numpy as np
from worker import Prepare, Timed, serve

FOLDER, STEPS, PERIOD = Path(sys.argv[1]), round(1000 * float(sys.argv[2])), 1e-3
SIGNALS = 21  # columns that the floor records


def parts() -> tuple[Any, Any, Any, Any]:
    """The floor's modules, its robot flattened for numba, and the same for C++."""
    sys.path.insert(0, str(FOLDER))
    import loop_nb
    import loop_np
    import mmcore
    import pinocchio as pin

    file = str(FOLDER / "models" / "thesis5.urdf")
    return loop_nb, loop_np, loop_nb.flatten(pin.buildModelFromUrdf(file)), mmcore.Sim(file)


def one(kind: str) -> Prepare:
    """One run, all of its signals kept."""
    loop_nb, loop_np, tree, cpp = parts()

    def prepare() -> Timed:
        start, rows = loop_np.init(0), np.zeros((STEPS, SIGNALS))

        def run() -> dict[str, Any]:
            if kind == "cpp":
                cpp.rollout(*start, STEPS, PERIOD, 1, rows, 1)
            else:
                loop_nb.rollout(*tree, *start, STEPS, PERIOD, 1, rows, True)
            return {"steps": STEPS}

        return run

    return prepare


def batch(kind: str, runs: int, threads: int) -> Prepare:
    """Many runs, none of their signals kept."""
    loop_nb, loop_np, tree, cpp = parts()
    starts = [np.ascontiguousarray(np.stack(part)) for part in zip(*map(loop_np.init, range(runs)), strict=True)]

    def prepare() -> Timed:
        given, scratch = [part.copy() for part in starts], np.zeros((2, STEPS, SIGNALS))

        def run() -> dict[str, Any]:
            if kind == "cpp":
                cpp.batch(runs, *given, STEPS, PERIOD, 1, np.zeros(0), 1, threads)
            else:
                loop_nb.batch(*tree, *given, STEPS, PERIOD, 1, scratch, False)
            return {"rollouts": runs, "steps": runs * STEPS}

        return run

    return prepare


def route(name: str) -> Prepare:
    """A route by name."""
    kind, *rest = name.split()
    return batch(rest[0], int(rest[1]), int(rest[2])) if kind == "batch" else one(kind)


if __name__ == "__main__":
    serve(route)

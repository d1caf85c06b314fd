"""A worker for our own routes: `routes.py SECONDS FOLDER [TIAGO.urdf]`.

A request is `loop`, `compiled`, `whole_loop`, `whole_compiled`, `tiago_compiled`, `chain N` (arm joints),
`batch KIND RUNS THREADS` (KIND `same` or `masses`), `parts ENGINE` (microseconds of each part of a step), or
`work FILE` (what the peers need).
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from time import process_time
from typing import Any

import numpy as np
from worker import Prepare, serve
from workload import arm_loop, chain, find_tiago, peer_work, thesis_loop

from mmnn_pin import Loop, load, simulate_many
from mmnn_pin.recorder import Recorder

Timed = Callable[[], dict[str, Any]]
SECONDS, FOLDER = float(sys.argv[1]), Path(sys.argv[2])
GIVEN = Path(sys.argv[3]) if len(sys.argv) > 3 else None


def steps(loop: Loop) -> Prepare:
    """The steps of a loop recorded in memory; reference, flattened tree and the check of the gains beforehand."""

    def prepare() -> Timed:
        engine = loop.engine_at()

        def run() -> dict[str, Any]:
            with Recorder(loop.robot.layout, loop.facts()) as recorder:
                outcome = loop.stream(engine, recorder)
                recorder.finish(outcome, loop.final(engine))
            assert outcome.status == "completed", outcome.message
            return {"steps": loop.timing.samples, "robot": loop.robot.name, "joints": loop.robot.layout.arm}

        return run

    return prepare


def whole(loop: Loop) -> Prepare:
    """`Loop.run`, with all that it does before the first step."""

    def run() -> dict[str, Any]:
        loop.run()
        return {"steps": loop.timing.samples}

    return lambda: run


def batch(kind: str, runs: int, threads: int) -> Prepare:
    """`simulate_many` on the thesis robot, the same or with other masses in every run (made anew every time)."""
    loop = thesis_loop(SECONDS)

    def run() -> dict[str, Any]:
        factors = np.random.default_rng(0).uniform(0.8, 1.2, runs)
        robots = [loop.robot] * runs if kind == "same" else [loop.robot.with_masses(float(f)) for f in factors]
        loops = [replace(loop, robot=robot, seed=seed) for seed, robot in enumerate(robots)]
        done = simulate_many(loops, workers=threads)
        assert all(one.outcome.status == "completed" for one in done)
        return {"rollouts": runs, "steps": runs * loop.timing.samples}

    return lambda: run


def parts(kind: str) -> Prepare:
    """The parts of one step, each repeated; the first call compiles."""
    from parts import PARTS, REPEAT

    calls = PARTS[kind]()
    for call in calls.values():
        call(1)

    def run() -> dict[str, Any]:
        spent = {}
        for name, call in calls.items():
            began = process_time()
            call(REPEAT)
            spent[name] = 1e6 * (process_time() - began) / REPEAT
        return {"steps": REPEAT, "parts": spent}

    return lambda: run


def peer_file(file: str) -> Prepare:
    """Writes what the peers need."""

    def run() -> dict[str, Any]:
        work: dict[str, Any] = dict(peer_work(SECONDS))
        np.savez(file, **work)
        return {"file": file}

    return lambda: run


def route(name: str) -> Prepare:
    """A route by name.

    Raises:
        ValueError: There is none of that name.
    """
    kind, *rest = name.split()
    if kind in ("loop", "whole_loop"):
        loop = thesis_loop(SECONDS, engine="ordinary")
        return whole(loop) if kind == "whole_loop" else steps(loop)
    if kind in ("compiled", "whole_compiled"):
        loop = thesis_loop(SECONDS, engine="compiled")
        return whole(loop) if kind == "whole_compiled" else steps(loop)
    if kind == "tiago_compiled":
        file = find_tiago(GIVEN)
        robot = load(file) if file else chain(7, FOLDER)
        return steps(replace(arm_loop(robot, SECONDS), engine="compiled"))
    if kind == "chain":
        return steps(replace(arm_loop(chain(int(rest[0]), FOLDER), min(SECONDS, 1.0)), engine="compiled"))
    if kind == "batch":
        return batch(rest[0], int(rest[1]), int(rest[2]))
    if kind == "parts":
        return parts(rest[0])
    if kind == "work":
        return peer_file(rest[0])
    raise ValueError(name)


if __name__ == "__main__":
    serve(route)

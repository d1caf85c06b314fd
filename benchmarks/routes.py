"""A worker for our own routes: `routes.py SECONDS FOLDER [TIAGO.urdf]`.

A request is `loop`, `compiled`, `tiago_compiled`, or one of these after `alone_`, `file_` or `whole_`; `chain N` (arm
joints), `batch KIND RUNS THREADS` (KIND `same` or `masses`), `parts ENGINE` (microseconds of each part of a step), or
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
from worker import Prepare, Timed, serve
from workload import arm_loop, chain, find_tiago, peer_work, thesis_loop

from mmnn_pin import Loop, load
from mmnn_pin.loop.batch import simulate_many
from mmnn_pin.recording.recorder import Recorder

SECONDS, FOLDER = float(sys.argv[1]), Path(sys.argv[2])
GIVEN = Path(sys.argv[3]) if len(sys.argv) > 3 else None


class Nothing:
    """A sink that takes nothing."""

    def append_block(self, rows: Any, step_times: Any) -> None:
        """Rows."""

    def weights(self, time: float, arrays: Any) -> None:
        """Weights."""


def steps(loop: Loop, sink: str = "memory") -> Prepare:
    """The steps of a loop; reference, flattened tree and the check of the gains beforehand.

    Args:
        loop: The loop.
        sink: "memory" or "file" for a recording, "alone" for none.
    """
    file = FOLDER / f"{loop.robot.name}_{loop.engine}.h5" if sink == "file" else None

    def prepare() -> Timed:
        engine = loop.engine_at()

        def run() -> dict[str, Any]:
            if sink == "alone":
                outcome = loop.stream(engine, Nothing())
            else:
                samples = loop.timing.samples
                with Recorder(loop.layout, loop.facts(), file, force=True, expected=samples) as recorder:
                    outcome = loop.stream(engine, recorder)
                    recorder.finish(outcome, loop.final(engine))
            assert outcome.status == "completed", outcome.message
            return {"steps": loop.timing.samples, "robot": loop.robot.name, "joints": loop.layout.arm}

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


def tiago() -> Loop:
    """TIAGo without hand, or where it is not installed a mobile base with a 7-joint arm."""
    file = find_tiago(GIVEN)
    return replace(arm_loop(load(file) if file else chain(7, FOLDER), SECONDS), engine="compiled")


LOOPS: dict[str, Callable[[], Loop]] = {
    "loop": lambda: thesis_loop(SECONDS, engine="ordinary"),
    "compiled": lambda: thesis_loop(SECONDS, engine="compiled"),
    "tiago_compiled": tiago,
}


def route(name: str) -> Prepare:
    """A route by name.

    Raises:
        ValueError: There is none of that name.
    """
    kind, *rest = name.split()
    first, _, others = kind.partition("_")
    sink, engine = (first, others) if first in ("alone", "file", "whole") else ("", kind)
    if engine in LOOPS:
        loop = LOOPS[engine]()
        return whole(loop) if sink == "whole" else steps(loop, sink or "memory")
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

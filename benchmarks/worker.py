"""Processes that run routes on request, so that routes can be measured in turn without sharing a process.

A worker reads one request a line, runs the route with its set-up outside the clock, and answers with one JSON object:
`wall` and `cpu` seconds, and what the route said of itself.
"""

from __future__ import annotations

import json
import os
import resource
import subprocess
import sys
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from tempfile import TemporaryFile
from typing import Any, Self

HERE = Path(__file__).parent
Timed = Callable[[], dict[str, Any]]
Prepare = Callable[[], Timed]


class Worker:
    """The caller's end of a worker.

    Args:
        script: File of this folder that calls `serve`.
        arguments: Its arguments.
        python: Interpreter.
        environment: Added to this process's.
    """

    def __init__(
        self, script: str, *arguments: str, python: str = sys.executable, environment: Mapping[str, str] | None = None
    ) -> None:
        self.errors = TemporaryFile()  # noqa: SIM115 (closed on leaving)
        self.process = subprocess.Popen(
            [python, str(HERE / script), *arguments],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=self.errors,
            text=True,
            env=os.environ | {"NUMBA_DISABLE_JIT": "0"} | dict(environment or {}),
        )

    def ask(self, request: str) -> dict[str, Any]:
        """Have a route run once; `{"skipped": reason}` where it cannot.

        Raises:
            RuntimeError: The worker has ended, with what it wrote last.
        """
        assert self.process.stdin and self.process.stdout
        try:
            self.process.stdin.write(request + "\n")
            self.process.stdin.flush()
            answer = self.process.stdout.readline()
        except BrokenPipeError:
            answer = ""
        if not answer:
            self.errors.seek(0)
            raise RuntimeError(f"'{request}' ended its process: {self.errors.read().decode()[-2000:]}")
        return dict(json.loads(answer))

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.process.communicate()
        self.errors.close()


def serve(routes: Callable[[str], Prepare]) -> None:
    """Run routes by name until the input ends. What libraries print goes nowhere."""
    out = os.fdopen(os.dup(1), "w")
    silent = os.open(os.devnull, os.O_WRONLY)
    os.dup2(silent, 1)
    built: dict[str, Prepare] = {}
    for line in sys.stdin:
        name = line.strip()
        try:
            if name not in built:
                built[name] = routes(name)
            answer = timed(built[name]())
        except ImportError as error:
            answer = {"skipped": str(error)}
        print(json.dumps(answer), file=out, flush=True)


def processor_time() -> float:
    """Of this process, and of those that it has started and waited for [s]."""
    others = resource.getrusage(resource.RUSAGE_CHILDREN)
    return time.process_time() + others.ru_utime + others.ru_stime


def timed(run: Callable[[], dict[str, Any]]) -> dict[str, Any]:
    """Run once: seconds of wall clock and of processor time, and the most memory of a process so far [MB].

    Processes that the run has started and waited for count, too.
    """
    wall, cpu = time.perf_counter(), processor_time()
    said = run()
    wall, cpu = time.perf_counter() - wall, processor_time() - cpu
    whose = (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)
    largest = max(resource.getrusage(who).ru_maxrss for who in whose) / (1e6 if sys.platform == "darwin" else 1e3)
    return {"wall": wall, "cpu": cpu, "peak_mb": largest, **said}

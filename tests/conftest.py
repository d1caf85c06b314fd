"""What all tests share."""

from __future__ import annotations

import fcntl
import hashlib
import os
import signal
import sys
import tempfile
from copy import copy
from functools import cache, wraps
from pathlib import Path
from typing import Any

import pytest
from hypothesis import settings

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # the tests run side by side; read when numpy is imported

# A shell that starts the tests in the background lets them ignore Ctrl-C; tests of Ctrl-C need it.
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)


settings.register_profile("untimed", deadline=None)  # the first example may compile, and machines are busy
settings.load_profile("untimed")

EXAMPLES = 15  # of a property are tried at most, in plain Python 4; `--full` tries as many as its test says
MOST_SAMPLES = 4000  # of a run in the ordinary engine, 0.1 ms each
LOCKS = Path(tempfile.gettempdir()) / "mmnn_pin-compiling"


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption("--full", action="store_true", help="properties with all examples, every run in its own engine")


def pytest_itemcollected(item: pytest.Item) -> None:
    """Try fewer examples of a property than its test says."""
    from numba import config

    test = getattr(getattr(item, "obj", None), "__func__", getattr(item, "obj", None))
    if getattr(test, "is_hypothesis_test", False) and not item.config.getoption("--full"):
        own, most = test._hypothesis_internal_use_settings, 4 if config.DISABLE_JIT else EXAMPLES
        test._hypothesis_internal_use_settings = settings(own, max_examples=min(own.max_examples, most))


def pytest_sessionstart(session: pytest.Session) -> None:
    let_coverage_rest()
    if not session.config.getoption("--full"):
        compile_few_loops()


def compile_few_loops() -> None:
    """Let `Loop.run` take the ordinary engine for short runs of rare loops, unless a test asks for the compiled one.

    Both engines have the same bits (`test_compiled_loop.py`, `test_hardware.py`, `assert_engines_agree`). A loop takes
    20 s to compile for every combination of a controller, hardware and a lead; the ordinary engine needs parts of it.
    Contests and studies are left alone: they compare bits of a run with those of their batches, which are compiled.
    """
    from mmnn_pin.loop.loop import Loop
    from mmnn_pin.torque.model_based import PD, ComputedTorque
    from mmnn_pin.torque.neural import Neural

    own = Loop.run

    @wraps(own)
    def run(self: Loop, *arguments: Any, **named: Any) -> Any:
        ideal = self.sensor.exact and not (self.layout.hardware or self.lead)
        frequent = ideal and isinstance(self.controller, (PD, ComputedTorque, Neural))
        left_alone = sys._getframe(1).f_globals["__name__"].startswith(("mmnn_pin.lab.contest", "mmnn_pin.lab.study"))
        if self.engine == "auto" and not (frequent or left_alone) and self.timing.samples <= MOST_SAMPLES:
            self = copy(self)
            object.__setattr__(self, "engine", "ordinary")
        return own(self, *arguments, **named)

    Loop.run = run  # type: ignore[method-assign]


def let_coverage_rest() -> None:
    """Compile without the tracer of coverage, and nothing twice in two processes at a time.

    Coverage would trace all of numba, and sees nothing of what is compiled. What another process is compiling, this one
    waits for and finds in the cache.
    """
    from numba.core.compiler_lock import global_compiler_lock
    from numba.core.registry import CPUDispatcher

    def compile_untraced(self: Any, sig: Any) -> Any:
        tracer = sys.gettrace()
        sys.settrace(None)
        try:
            name = f"{self.py_func.__module__}.{self.py_func.__qualname__}{sig}"
            with global_compiler_lock, open(LOCKS / hashlib.sha256(name.encode()).hexdigest()[:16], "w") as lock:
                fcntl.flock(lock, fcntl.LOCK_EX)
                return compile_it(self, sig)
        finally:
            if tracer is not None:
                sys.settrace(tracer)
                take_up()

    LOCKS.mkdir(exist_ok=True)
    compile_it, CPUDispatcher.compile = CPUDispatcher.compile, compile_untraced


def take_up() -> None:
    """Do nothing: at the first call after `settrace` the tracer installs itself anew."""


@cache
def compile_once() -> None:
    from mmnn_pin.cli.output import compile_if_cold

    compile_if_cold(hardware=True)


@pytest.fixture(autouse=True)
def compiled_before_it_is_read(request: pytest.FixtureRequest) -> None:
    """A first run says on standard error that it compiles: ahead of a test that reads what a run says."""
    if {"capsys", "capfd"} & set(request.fixturenames):
        compile_once()

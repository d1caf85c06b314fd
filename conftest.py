"""What all tests share."""

from __future__ import annotations

import fcntl
import hashlib
import os
import signal
import sys
import tempfile
from functools import cache
from pathlib import Path
from typing import Any

import pytest
from hypothesis import settings

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # the tests run side by side; read when numpy is imported
os.environ.pop("COLUMNS", None)  # the terminal's width is a test's own; the workers of pytest-xdist are given one

# A shell that starts the tests in the background lets them ignore Ctrl-C; tests of Ctrl-C need it.
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)


settings.register_profile("untimed", deadline=None)  # the first example may compile, and machines are busy
settings.load_profile("untimed")

EXAMPLES = 8  # of a property are tried at most, in plain Python 4; `--full` tries as many as its test says
LOCKS = Path(tempfile.gettempdir()) / "mmnn_pin-compiling"


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption("--full", action="store_true", help="properties with all their examples")


def pytest_itemcollected(item: pytest.Item) -> None:
    """Try fewer examples of a property than its test says, and the same ones each time; `--full` draws its own."""
    from numba import config

    test = getattr(getattr(item, "obj", None), "__func__", getattr(item, "obj", None))
    if getattr(test, "is_hypothesis_test", False) and not item.config.getoption("--full"):
        own, most = test._hypothesis_internal_use_settings, 4 if config.DISABLE_JIT else EXAMPLES
        few = settings(own, max_examples=min(own.max_examples, most), derandomize=True)
        test._hypothesis_internal_use_settings = few


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Leave out of a run as plain Python what is marked as `compiled`."""
    from numba import config as numba

    if numba.DISABLE_JIT and not config.getoption("--full"):
        left_out = [item for item in items if item.get_closest_marker("compiled")]
        config.hook.pytest_deselected(items=left_out)
        items[:] = [item for item in items if not item.get_closest_marker("compiled")]


def pytest_sessionstart(session: pytest.Session) -> None:
    let_coverage_rest()


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
    from mmnn_pin.compiled import when_compiling

    compile_if_cold(hardware=True)
    when_compiling(lambda: None)  # what else takes long on a busy machine is not told between the lines of a test


@pytest.fixture(autouse=True)
def compiled_before_it_is_read(request: pytest.FixtureRequest) -> None:
    """A first run says on standard error that it compiles: ahead of a test that reads what a run says."""
    if {"capsys", "capfd"} & set(request.fixturenames):
        compile_once()

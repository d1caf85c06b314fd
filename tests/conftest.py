"""What all tests share."""

from __future__ import annotations

import os
import signal
import sys
from functools import cache
from typing import Any

import pytest

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # the tests run side by side; read when numpy is imported

# A shell that starts the tests in the background lets them ignore Ctrl-C; tests of Ctrl-C need it.
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)


def pytest_sessionstart() -> None:
    """Let coverage rest while numba compiles: it would trace all of numba, and sees nothing of what is compiled."""
    from numba.core.registry import CPUDispatcher

    def compile_untraced(self: Any, sig: Any) -> Any:
        tracer = sys.gettrace()
        if tracer is None:
            return compile_it(self, sig)
        sys.settrace(None)
        try:
            return compile_it(self, sig)
        finally:
            sys.settrace(tracer)
            take_up()

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

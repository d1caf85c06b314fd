"""What all tests share."""

from __future__ import annotations

import os
import signal
from functools import cache

import pytest

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # the tests run side by side; read when numpy is imported

# A shell that starts the tests in the background lets them ignore Ctrl-C; tests of Ctrl-C need it.
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)


@cache
def compile_once() -> None:
    from mmnn_pin.cli.output import compile_if_cold

    compile_if_cold(hardware=True)


@pytest.fixture(autouse=True)
def compiled_before_it_is_read(request: pytest.FixtureRequest) -> None:
    """A first run says on standard error that it compiles: ahead of a test that reads what a run says."""
    if {"capsys", "capfd"} & set(request.fixturenames):
        compile_once()

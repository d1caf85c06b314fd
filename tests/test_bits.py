"""Runs have the same bits when glibc, numpy and OpenBLAS may not use what this processor can do."""

from __future__ import annotations

import platform
import subprocess
import sys

import pytest
from places import ROOT

SCRIPT = ROOT / "benchmarks" / "bits.py"
# What a libm or a BLAS did before; the runs themselves, all robots and learners are `.ci/full`'s.
CASES = ("references", "robots", "starts", "differential two_layer")


@pytest.mark.skipif(platform.machine() not in ("x86_64", "AMD64"), reason="the settings name features of x86")
def test_bits_do_not_depend_on_the_libraries_kernels() -> None:
    only = [part for name in CASES for part in ("--only", name)]
    command = [sys.executable, str(SCRIPT), *only, "--settings", "libraries", "--duration", "0.1"]
    done = subprocess.run(command, capture_output=True, text=True, timeout=600)
    assert done.returncode == 0, done.stdout + done.stderr
    assert done.stdout.count("differential two_layer") == 4 and "no bit changed" in done.stdout

"""Machine code is made for what Python calls, once, and kept; what compiled code calls waits for it."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import time

import pytest
from numba import config

from mmnn_pin import deferred
from mmnn_pin.compiled import prepare

pytestmark = pytest.mark.skipif(bool(config.DISABLE_JIT), reason="nothing is compiled")

# An inner and an outer function; what each process says: results, which have machine code, compiled or from the disk.
MODULE = """
import numpy as np
from mmnn_pin.compiled import compiled

@compiled
def inner(x, out):
    for i in range(x.size):
        out[i] = 2.0 * x[i] + 1.0

@compiled
def outer(x, out):
    inner(x, out)
    inner(out, out)
"""
CALLS = """
import json, sys
import numpy as np
import two
x, told = np.array([1.0, -2.0]), {}
def entry(function): return next(iter(function.overloads.values())).entry_point
for name in sys.argv[1:]:
    out = np.zeros(2)
    getattr(two, name)(x, out)
    told[name] = out.tolist()
told["machine_code"] = [f.__name__ for f in (two.inner, two.outer) if f.overloads and entry(f).machine_code]
told["compiled"] = [f.__name__ for f in (two.inner, two.outer) if f.stats.cache_misses]
print(json.dumps(told))
"""
INNER, OUTER = [3.0, -3.0], [7.0, -5.0]  # 2 x + 1, and that of that


@pytest.fixture
def call(tmp_path):
    """Calls the functions of these names in a process of its own; the processes share a cache."""
    (tmp_path / "two.py").write_text(MODULE)
    paths = os.pathsep.join([str(tmp_path), *filter(None, sys.path)])
    around = os.environ | {"NUMBA_CACHE_DIR": str(tmp_path / "cache"), "PYTHONPATH": paths}

    def called(*names: str) -> dict:
        command = [sys.executable, "-c", CALLS, *names]
        return json.loads(subprocess.run(command, env=around, capture_output=True, text=True, check=True).stdout)

    return called


def test_what_compiled_code_calls_waits_until_python_calls_it_and_both_are_kept(call):
    assert call("outer") == {"outer": OUTER, "machine_code": ["outer"], "compiled": ["inner", "outer"]}
    assert call("outer") == {"outer": OUTER, "machine_code": ["outer"], "compiled": []}  # inner was not even loaded
    assert call("inner") == {"inner": INNER, "machine_code": ["inner"], "compiled": []}  # from what LLVM reads
    both = {"inner": INNER, "outer": OUTER, "machine_code": ["inner", "outer"]}
    assert call("inner", "outer") == both | {"compiled": []}


def test_one_process_may_call_them_in_any_order(call):
    both = {"outer": OUTER, "inner": INNER, "machine_code": ["inner", "outer"]}
    assert call("outer", "inner") == both | {"compiled": ["inner", "outer"]}


def test_what_is_prepared_is_not_run_and_has_no_machine_code():
    namespace: dict = {"__name__": "prepared"}
    exec("def double(x):\n    return 2.0 * x", namespace)
    namespace["__name__"] = __name__
    double = deferred.Dispatcher(namespace["double"], targetoptions={"nopython": True})
    prepare(double, 1.5)
    (kept,) = double.overloads.values()
    assert kept.entry_point.machine_code is None
    assert double(1.5) == 3.0
    assert kept.entry_point.machine_code is not None


def test_who_waits_long_is_told_once_and_who_does_not_is_not(monkeypatch):
    told: list[str] = []
    monkeypatch.setattr(deferred, "waiting", [told.append])
    monkeypatch.setattr(deferred, "PATIENCE", 0.05)
    with deferred.patient("slow"):
        time.sleep(0.5)
    with deferred.patient("fast"):
        pass
    time.sleep(0.2)
    assert told == ["slow"]

"""The names that a newcomer sees: few, documented by examples that run, and known to editors."""

from __future__ import annotations

import doctest
import inspect
import sys

import numpy as np
import pytest

import mmnn_pin

MOST = 30
NEEDS = {"identify": "cvxpy"}


def namespace() -> dict[str, object]:
    """What `from mmnn_pin import *` gives, and numpy."""
    return {name: getattr(mmnn_pin, name) for name in mmnn_pin.__all__} | {"np": np}


def run_examples(thing: object, name: str) -> doctest.TestResults:
    """The examples in the docstring of a thing itself, not in those of its methods."""
    finder, runner = doctest.DocTestFinder(recurse=False), doctest.DocTestRunner(optionflags=doctest.ELLIPSIS)
    tests = finder.find(thing, name, globs=namespace())
    for test in tests:
        runner.run(test, out=sys.stderr.write)
    return runner.summarize(verbose=False)


@pytest.mark.parametrize("name", [*mmnn_pin.__all__, "mmnn_pin"])
def test_every_name_has_an_example_that_runs(name, tmp_path, monkeypatch):
    if name in NEEDS:
        pytest.importorskip(NEEDS[name], reason=f"pip install {NEEDS[name]}: the example of {name} needs it")
    monkeypatch.chdir(tmp_path)
    result = run_examples(mmnn_pin if name == "mmnn_pin" else getattr(mmnn_pin, name), name)
    assert result.attempted > 0
    assert result.failed == 0


def test_the_face_is_small():
    assert len(mmnn_pin.__all__) <= MOST
    assert {*mmnn_pin.__all__, "__version__"} == set(dir(mmnn_pin))


def test_every_name_is_described() -> None:
    assert all(inspect.getdoc(getattr(mmnn_pin, name)) for name in mmnn_pin.__all__)


def test_a_name_that_is_not_there_is_an_attribute_error():
    with pytest.raises(AttributeError, match="no_such_thing"):
        _ = mmnn_pin.no_such_thing

"""Files broken at random: refused or loaded, nothing else. `python tests/fuzz_urdf.py` runs 3,000 of them."""

from __future__ import annotations

import importlib.util

import pytest
from fuzz_urdf import XACRO, fuzz, mutant, sources, verdict


def test_broken_files_never_crash_and_never_give_a_model_that_is_not_finite():
    counts, wrong = fuzz(100, seed=10_000, batch=100)
    assert wrong == []
    assert sum(counts.values()) == 100
    assert counts["refused"] > 20 and counts["finite"] > 5  # the mutator breaks some and not all


def test_broken_xacro_files_are_refused_or_loaded_too():
    pytest.importorskip("xacrodoc", reason="pip install 'mmnn_pin[xacro]'")
    counts, wrong = fuzz(16, seed=10_000, batch=16, xacro=True)
    assert wrong == [] and sum(counts.values()) == 16
    assert counts["refused"] > 3 and counts["finite"] > 0


def test_the_sources_load(tmp_path):
    if importlib.util.find_spec("xacrodoc"):
        assert verdict(XACRO.encode(), tmp_path / "a.urdf.xacro") == "finite"
    assert [verdict(source, tmp_path / "a.urdf") for source in sources()] == ["finite"] * 3


def test_a_seed_is_a_file():
    assert mutant(3) == mutant(3)
    assert len({mutant(seed) for seed in range(50)}) > 40

"""Files broken at random: refused or loaded, nothing else. `python tests/fuzz_urdf.py` runs 3,000 of them."""

from __future__ import annotations

from fuzz_urdf import fuzz, mutant, sources, verdict


def test_broken_files_never_crash_and_never_give_a_model_that_is_not_finite():
    counts, wrong = fuzz(100, seed=10_000, batch=100)
    assert wrong == []
    assert sum(counts.values()) == 100
    assert counts["refused"] > 20 and counts["finite"] > 5  # the mutator breaks some and not all


def test_the_sources_load(tmp_path):
    assert [verdict(source, tmp_path / "a.urdf") for source in sources()] == ["finite"] * 3


def test_a_seed_is_a_file():
    assert mutant(3) == mutant(3)
    assert len({mutant(seed) for seed in range(50)}) > 40

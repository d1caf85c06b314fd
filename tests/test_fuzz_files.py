"""Files of every kind, broken at random: an answer or one clear line. `python tests/fuzz_files.py` tries 10,000."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
from fuzz_files import KINDS, fuzz
from places import ROOT

SOURCES = "import sys; from pathlib import Path; from sound_files import sound_files; "
SOURCES += "sound_files(Path(sys.argv[1]), ('adaptive',), tuned=False)"
QUICK = [kind for kind in KINDS if not kind.startswith("tuning")]


@pytest.fixture(scope="module")
def sources(tmp_path_factory) -> Iterator[Path]:
    """Sound files, made without compiling."""
    folder = tmp_path_factory.mktemp("sound") / "files"
    environment = os.environ | {"NUMBA_DISABLE_JIT": "1", "PYTHONPATH": f"{ROOT}:{ROOT / 'tests'}"}
    subprocess.run([sys.executable, "-c", SOURCES, str(folder)], env=environment, check=True)
    return folder


def test_no_broken_file_makes_a_command_fail_otherwise_than_in_one_line(sources):
    counts, wrong = fuzz(sources, 12 * len(QUICK), batch=1000, kinds=QUICK, cheap=True)
    assert wrong == []
    told = {verdict: sum(found[verdict] for found in counts.values()) for verdict in ("done", "refused")}
    assert told["done"] > 20 and told["refused"] > 20  # it tries files that can be read, and files that cannot


@pytest.mark.long
def test_a_thousand_more(sources):
    assert fuzz(sources, 1000, seed=1_000_000, kinds=QUICK)[1] == []

"""The study of what learners know: its command prints numbers, and frozen means frozen."""

from __future__ import annotations

import re
import runpy

import pytest
from numba import config
from places import ROOT

pytestmark = pytest.mark.lab

STUDY = ROOT / "studies" / "learners" / "knowledge.py"


@pytest.mark.skipif(config.DISABLE_JIT, reason="needs a long run")
def test_the_study_of_knowledge_runs(capsys):
    study = runpy.run_path(str(STUDY))
    for name, (base, arm, duration) in list(study["MOTIONS"].items()):
        study["MOTIONS"][name] = (base, arm, min(duration, 6.0))
    study["main"](["computed_torque", "concurrent", "pd", "after=poor", "concurrent.rate=3"])
    lines = [line for line in capsys.readouterr().out.splitlines() if "frozen" in line]
    assert [line.split(":")[0] for line in lines] == [
        f"{name}, {motion}" for name in ("computed_torque", "concurrent", "pd") for motion in ("training", "poor")
    ]
    frozen = {line.split(":")[0]: float(re.search(r"eight3 ([0-9.]+)", line)[1]) for line in lines}
    assert frozen["computed_torque, training"] < 1e-9 < frozen["concurrent, training"] < 0.05
    assert frozen["pd, training"] > 0.9
    study["main"](["--time", "pd"])
    assert float(re.fullmatch(r"pd: ([0-9.]+) us a sample\n", capsys.readouterr().out)[1]) > 0

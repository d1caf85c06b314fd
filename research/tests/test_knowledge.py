"""The study of what learners know: its command prints numbers, and frozen means frozen."""

from __future__ import annotations

import re
import runpy
from dataclasses import replace

import numpy as np
import pytest
from numba import config
from places import ROOT

from mmnn_pin import load_experiment
from mmnn_pin.lab.experiments.runner import run_experiment
from mmnn_pin.lab.psi.subject import Subject
from research.proof.load import carried

STUDY = ROOT / "research" / "studies" / "learners" / "knowledge.py"


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


KNOWN = {"regressor": 1e-3, "bilinear": 1e-2, "features": 0.1, "residual": 1e-2}


@pytest.mark.skipif(config.DISABLE_JIT, reason="needs a long run")
@pytest.mark.parametrize("kind", sorted(KNOWN))
def test_a_rich_motion_brings_the_knowledge_that_is_asked_for(kind, capsys):
    """48 s of an eight with the arm shaken: FVU frozen on three motions that it has not seen, by what it was told."""
    runpy.run_path(str(STUDY))["main"]([f"kalman_{kind}", "only=rich"])
    line = capsys.readouterr().out.splitlines()[0]
    known = [float(found) for found in re.findall(r"(?:eight3|eight2|circle) (\d[.]\d{5})", line)]
    assert len(known) == 3 and max(known) <= KNOWN[kind]


# -- a load that was picked up --


@pytest.mark.compiled
@pytest.mark.parametrize("name", ["concurrent", "adaptive_composite"])
def test_what_a_learner_knows_of_a_load_is_told_with_what_the_run_determined(name: str) -> None:
    """The truth within three deviations where it is determined, and coordinates that no torque tells are named."""
    friction = ("friction.base=[30.0,5.0]", "friction.arm=0.5", "friction.coulomb=0.5")
    load = "disturbances=[{type='payload', mass=1.5, start=7.0, at=[0.25, 0.05, 0.05]}]"
    run = ("time.duration=12.0", "windows=[[0.0, 12.0]]", "plots=[]", f"controllers=['{name}']", load)
    experiment = load_experiment("track", [*friction, *run, "sensor.noise=1e-4", "sensor.velocity_noise=2e-3"])
    found = carried(Subject.of(run_experiment(experiment, "track").recordings[name]))
    assert found is not None
    np.testing.assert_allclose(found.centre, (0.25, 0.05, 0.05), atol=1e-12)  # the link stands where its joint does
    assert found.to_dict()["com"][2] is None
    if name == "adaptive_composite":  # it has estimates, and no intervals
        assert (
            found.found is None
            and found.to_dict()["mass"] is None
            and "not determined: no covariance, it does not know how sure it is" in str(found)
        )
        return
    assert found.found is not None and found.determined == (True, (True, True, False))  # z: along the joint's axis
    assert abs(found.found.mass - 1.5) < 3.0 * found.found.mass_sd
    assert (np.abs(found.found.centre - found.centre)[:2] < 3.0 * found.found.centre_sd[:2]).all()
    assert "not determined) mm" in str(found)
    vague = replace(found, found=replace(found.found, mass_sd=0.6 * found.found.mass))
    assert "mass not determined" in str(vague) and vague.to_dict()["mass"] is None
    short = replace(found, found=None, why="too short")
    assert "not determined: too short" in str(short) and short.to_dict()["mass"] is None

"""How this package is found: by `python -m` in a clone, by entry points where it is installed."""

from __future__ import annotations

import subprocess
import sys
import tomllib
from importlib.metadata import EntryPoint

import click
import pytest
from places import ROOT

from mmnn_pin.lab.show.figure import FIGURES

POINTS = tomllib.loads((ROOT / "research" / "pyproject.toml").read_text())["project"]["entry-points"]


def test_a_command_runs_in_a_clone() -> None:
    done = subprocess.run([sys.executable, "-m", "research.prove", "--help"], cwd=ROOT, capture_output=True, text=True)
    assert done.returncode == 0 and done.stdout.startswith("Usage: mmnn prove")


@pytest.mark.parametrize(("name", "place"), POINTS["mmnn_pin.commands"].items())
def test_entry_points_are_commands(name: str, place: str) -> None:
    command = EntryPoint(name, place, "mmnn_pin.commands").load()
    assert isinstance(command, click.Command) and command.name == name


def test_what_it_shows_is_registered() -> None:
    for name, place in POINTS["mmnn_pin.show"].items():
        EntryPoint(name, place, "mmnn_pin.show").load()
    assert "lyapunov" in FIGURES["judged"]

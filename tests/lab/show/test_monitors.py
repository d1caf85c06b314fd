"""Monitors draw what was recorded."""

from __future__ import annotations

import numpy as np
import pytest
from builders import THESIS
from numba import config
from test_holonomic import PATHS

from mmnn_pin import PD, Hold, Loop, Neural, Sine, Timing, Trajectory, load
from mmnn_pin.cli.results import whats
from mmnn_pin.errors import RecordingError
from mmnn_pin.lab.show.gallery import PICTURES
from mmnn_pin.lab.show.plots import step_times_figure
from mmnn_pin.torque.two_layer import TwoLayer


def test_figures_draw_what_was_recorded() -> None:
    robot = load("platform_arm")
    trajectory = Trajectory(PATHS["line"], (Sine(0.4, 2.0), Hold(0.2)))
    timing = Timing(0.02 if config.DISABLE_JIT else 0.1, 0.001, 0.001)
    runs = {}
    for controller in (Neural(TwoLayer(hidden=4), THESIS), PD(THESIS)):
        loop = Loop(robot, trajectory, controller, timing=timing, engine="ordinary")
        runs[controller.name] = loop.run()
    upper, lower = PICTURES["weights"].make(runs).axes
    for column, axes in enumerate((upper, lower)):
        (line,) = [line for line in axes.get_lines() if len(line.get_xdata()) > 2]
        np.testing.assert_array_equal(line.get_ydata(), runs["two_layer"]["weight_norm"][:, column])
    (axes,) = PICTURES["residuals"].make(runs).axes
    lines = [line for line in axes.get_lines() if len(line.get_xdata()) > 2]
    for line, rec in zip(lines, runs.values(), strict=True):
        np.testing.assert_allclose(line.get_ydata(), 1e3 * rec["energy_residual"])
    (axes,) = step_times_figure(runs).axes
    steps = [patch.get_xy()[:, 1] for patch in axes.patches]
    assert [counts.max() > 0 for counts in steps] == [True, True] and axes.get_xscale() == "log"
    if not config.DISABLE_JIT:
        compiled = Loop(robot, trajectory, PD(THESIS), timing=timing).run()
        with pytest.raises(RecordingError, match="compiled"):
            step_times_figure({"pd": compiled})
    with pytest.raises(RecordingError):
        PICTURES["weights"].make({"pd": runs["pd"]})


def test_the_command_offers_every_picture() -> None:
    assert {"weights", "residuals", "step-times", "errors", "fvu", "figure-4.2"} < set(whats()) == set(PICTURES)

"""How much of a two-layer network is left when its input is in degrees: the share of hidden outputs at either end."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from msgspec.structs import replace as with_settings
from scipy.special import expit

from mmnn_pin import Recording
from mmnn_pin.lab.experiments.experiment import Experiment
from mmnn_pin.signals import Array

from .rigs import chapter5, loop_of, robot_of

LEARNED = 0.2  # from when on outputs count [s]
END = 0.01  # an output this near to 0 or 1 is at that end


def saturation() -> dict[str, Any]:
    """Of both starts of the network on the rig of the experiment's file: shares of hidden outputs near 1 and near 0."""
    e = with_settings(chapter5(), weights_interval=0.02)
    names = ("two_layer_zero", "two_layer_random")
    runs = {name: loop_of(e, robot_of(e), e.controller(name)).run() for name in names}
    return {name: ends(hidden_outputs(e, run)) for name, run in runs.items()}


def ends(outputs: Array) -> Mapping[str, float]:
    """Share of hidden outputs that are near 1, and near 0."""
    return {"on": float(np.mean(outputs > 1 - END)), "off": float(np.mean(outputs < END))}


def hidden_outputs(experiment: Experiment, run: Recording) -> Array:
    """Outputs of the arm's hidden units wherever the weights were recorded after `LEARNED`, (k, hidden)."""
    times, V = run.weights["time"], run.weights["V2"]
    samples = np.rint(times / experiment.time.control_period).astype(int)
    counted = (times > LEARNED) & (samples < len(run))
    x = experiment.inputs.scale * np.hstack([run[name] for name in experiment.inputs.signals])[samples[counted]]
    return np.asarray(expit(np.einsum("ki,kih->kh", x, V[counted])))

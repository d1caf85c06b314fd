"""What a designer may choose of each network, around the thesis's numbers as the middle of every range."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from msgspec.structs import replace as with_settings
from scipy.special import erf

from mmnn_pin.lab.experiments.experiment import Experiment
from mmnn_pin.signals import Array
from research.studies.search import Number, at

Choice = Mapping[str, Any]  # name of a number or a switch to what was chosen

# Rates, leakage, and what shapes the network: the range of the initial weights here, width and centres there.
TUNED: dict[str, tuple[Number, ...]] = {
    "two_layer": (
        Number("F1", 0.01, 100, "", log=True),
        Number("F2", 0.002, 20, "", log=True),
        Number("G1", 0.01, 100, "", log=True),
        Number("G2", 0.002, 20, "", log=True),
        Number("kappa", 0.01, 100, "", log=True),
        Number("v_range", 0.05, 20, "", log=True),
        Number("initial", 0, 1, ""),
    ),
    "one_layer": (
        Number("beta1", 0.005, 50, "", log=True),
        Number("beta2", 0.005, 50, "", log=True),
        Number("mu", 0.0035, 35, "", log=True),
        Number("width", 0.2, 100, "", log=True),
        Number("centre_range", 0.1, 1000, "", log=True),
        Number("centres", 0, 1, ""),
    ),
}
SWITCHES = {"initial": ("zero", "random"), "centres": ("diagonal", "random")}  # below and above one half
INPUTS = UNITS = 22  # of each network
FLAT = 1e6  # a width at which all Gaussians are one, wherever their centres are


def choice(learner: str, place: Array) -> dict[str, Any]:
    """What a place of the unit cube means."""
    values: dict[str, Any] = at(TUNED[learner], place)
    return values | {name: words[values[name] >= 0.5] for name, words in SWITCHES.items() if name in values}


def with_choice(experiment: Experiment, learner: str, chosen: Choice | None) -> Experiment:
    """The experiment with one network as chosen; as it is for None."""
    if chosen is None:
        return experiment
    if learner == "two_layer":
        rates: dict[str, Any] = {"F": (chosen["F1"], chosen["F2"]), "G": (chosen["G1"], chosen["G2"])}
        rest = {name: chosen[name] for name in ("kappa", "v_range", "initial")}
        return with_settings(experiment, two_layer=with_settings(experiment.two_layer, **rates, **rest))
    rates = {"beta": (chosen["beta1"], chosen["beta2"])}
    rest = {name: chosen[name] for name in ("mu", "width", "centre_range", "centres")}
    return with_settings(experiment, one_layer=with_settings(experiment.one_layer, **rates, **rest))


def integral_only(learner: str, chosen: Choice) -> Choice:
    """The same network deaf to its input: every hidden unit gives the same number, whatever it is.

    What is left is 22 times one leaky integral of the error: sigmoids whose input weights start at zero and stay there;
    Gaussians too wide to tell inputs apart, with `beta` and `mu` such that gain and leakage are those of the chosen
    Gaussians at the input 0: with their mean square m there, `beta m` and `mu / m`.
    """
    if learner == "two_layer":
        return {**chosen, "G1": 0.0, "G2": 0.0, "initial": "zero"}
    m = max(level(chosen), 1e-12)
    rates = {name: chosen[name] * m for name in ("beta1", "beta2")}
    return {**chosen, **rates, "mu": chosen["mu"] / m, "width": FLAT, "centres": "diagonal"}


def level(chosen: Choice) -> float:
    """Mean square of the chosen Gaussians where all 22 inputs are 0; random centres by the mean over their draws."""
    R, width = chosen["centre_range"], chosen["width"]
    if chosen["centres"] == "diagonal":
        return float(np.mean(np.exp(-INPUTS * np.linspace(-R, R, UNITS) ** 2 / width**2)))
    return float((np.sqrt(np.pi) * width / (2 * R) * erf(R / width)) ** INPUTS)

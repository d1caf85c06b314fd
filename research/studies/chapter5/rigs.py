"""Rigs: chapter 5 with other friction, backlash, encoders, sample rate and unstated numbers of the controllers.

Also how much of a two-layer network is left when its input is in degrees: the share of hidden outputs at either end.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache, cached_property
from typing import Any

import numpy as np
from msgspec.structs import replace as with_settings
from scipy.special import expit

from mmnn_pin import Loop, Recording, Robot, load_experiment
from mmnn_pin.lab.experiments.experiment import Experiment
from mmnn_pin.signals import Array
from mmnn_pin.torque.controller import CompiledController, TorqueController
from research.studies.search import Number

Values = Mapping[str, Any]


DEGREES = 180.0 / np.pi


# How the network takes the error that teaches it: in degrees, as its input, or in radians.
UNITS = {"degrees": DEGREES, "radians": 1.0}


THESIS_PERIOD = 0.005  # 200 Hz, for which the rates are printed [s]


PERIODS = (0.008, 0.005, 0.0025, 0.001)  # sample times that are drawn, equally likely [s]


# What is drawn for the ranking, each uniformly or (log) uniformly in the logarithm, the same for all controllers.
DRAWN = (
    Number("coulomb", 1.0, 15.0, "N m", log=True),
    Number("breakaway", 1.0, 2.0, ""),
    Number("stribeck", 0.02, 0.5, "rad/s", log=True),
    Number("viscous", 0.1, 8.0, "N m s", log=True),
    Number("gap", 0.001, 0.02, "rad", log=True),
    Number("resolution", 1e-4, 5e-3, "rad", log=True),
    Number("inertia", 0.2, 0.6, "kg m^2", log=True),
    Number("mu", 0.002, 0.03, "", log=True),
    Number("Kz", 1e-5, 1e-3, "", log=True),
    Number("v_range", 0.003, 0.3, "", log=True),
)


TIGHT = 0.25  # share of the rigs without backlash


@cache
def chapter5() -> Experiment:
    """Chapter 5 as it stands in its file, with weights that nobody records."""
    return load_experiment("chapter5", ["weights_interval=8.0"])


@cache
def bare_robot() -> Robot:
    """Its robot before rotors and friction."""
    bare = with_settings(chapter5(), armature=0.0, friction=with_settings(chapter5().friction, arm=0.0, coulomb=0.0))
    return bare.load_robot()


def with_rig(experiment: Experiment, values: Values) -> Experiment:
    """An experiment with other numbers of the rig and of what the thesis leaves open; what is not given stays.

    Args:
        experiment: Where to start from.
        values: `coulomb` (or `coulomb_1`, `coulomb_2`), `breakaway`, `stribeck`, `viscous`, `gap`, `inertia` (of rotor
            and gear, half of it on either side of a gap), `resolution`, `side` of the encoders, `period`, `mu`, `Kz`,
            `v_range`, `unit`, `centres`, `offset` of the start, `seed`.
    """
    e, v = experiment, dict(values)
    if "coulomb_1" in v:
        v["coulomb"] = (v["coulomb_1"], v["coulomb_2"])
    gap = v.get("gap", e.actuator.gap)
    of_file = e.armature + (e.actuator.rotor_inertia if e.actuator.gap else 0.0)  # type: ignore[operator]
    inertia = v.get("inertia", of_file)
    names = {"viscous": "arm", "coulomb": "coulomb", "breakaway": "breakaway", "stribeck": "stribeck"}
    friction = with_settings(e.friction, **{key: v[name] for name, key in names.items() if name in v})
    time = with_settings(e.time, control_period=v.get("period", e.time.control_period))
    return with_settings(
        e,
        friction=friction,
        time=time,
        armature=inertia if gap == 0.0 else 0.5 * inertia,
        actuator=with_settings(e.actuator, gap=gap, rotor_inertia=0.5 * inertia),
        sensor=with_settings(
            e.sensor, resolution=v.get("resolution", e.sensor.resolution), side=v.get("side", e.sensor.side)
        ),
        one_layer=with_settings(
            e.one_layer, mu=v.get("mu", e.one_layer.mu), centres=v.get("centres", e.one_layer.centres)
        ),
        two_layer=with_settings(e.two_layer, v_range=v.get("v_range", e.two_layer.v_range)),
        robust=with_settings(e.robust, arm=v.get("Kz", e.robust.arm)),
        inputs=with_settings(e.inputs, error_scale=UNITS[v["unit"]] if "unit" in v else e.inputs.error_scale),
        start=with_settings(e.start, joint_offset=v.get("offset", e.start.joint_offset)),
        seed=v.get("seed", e.seed),
    )


def per_second(experiment: Experiment) -> Experiment:
    """The same with rates that learn as much in a second as the printed ones do at 200 Hz."""
    share = experiment.time.control_period / THESIS_PERIOD
    two, one = experiment.two_layer, experiment.one_layer
    scaled = {name: tuple(share * rate for rate in getattr(two, name)) for name in ("F", "G")}
    beta = tuple(share * rate for rate in one.beta)
    return with_settings(experiment, two_layer=with_settings(two, **scaled), one_layer=with_settings(one, beta=beta))


def robot_of(experiment: Experiment) -> Robot:
    """The rig of an experiment, without reading the URDF again."""
    f = experiment.friction
    robot = bare_robot().with_armature(experiment.armature)
    robot = robot.with_joint_friction(coulomb=f.coulomb, breakaway=f.breakaway, stribeck=f.stribeck)
    return robot.with_friction(f.arm)


def loop_of(experiment: Experiment, robot: Robot, controller: CompiledController | TorqueController) -> Loop:
    """The closed loop of one controller on a rig."""
    return experiment.loop(robot, controller)


@dataclass(frozen=True, eq=False)
class Rig:
    """One drawn rig: its place in a seeded sequence and its numbers."""

    number: int
    values: Values

    @cached_property
    def experiment(self) -> Experiment:
        """Chapter 5 on it."""
        return with_rig(chapter5(), self.values)

    @cached_property
    def robot(self) -> Robot:
        """Its arm."""
        return robot_of(self.experiment)


def draw(number: int) -> Rig:
    """Rig of a number; rigs are independent, whatever their number."""
    rng = np.random.default_rng([5, number])
    values: dict[str, Any] = {each.name: float(each.at(rng.random())) for each in DRAWN}
    if rng.random() < TIGHT:
        values["gap"] = 0.0
    values |= {
        "period": PERIODS[rng.integers(len(PERIODS))],
        "unit": ("degrees", "radians")[rng.integers(2)],
        "centres": ("diagonal", "random")[rng.integers(2)],
        "side": ("joint", "motor")[rng.integers(2)],
        "seed": int(rng.integers(2**31)),
    }
    return Rig(number, values)


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

"""Learners on the thesis robot with friction: loops by the name of a controller, and what their frozen weights say."""

from __future__ import annotations

from dataclasses import replace

import msgspec
import numpy as np
from numba import config

from mmnn_pin import load_experiment
from mmnn_pin.loop.batch import simulate_many

COMMON = ["friction.coulomb=0.5", "time.plant_step=0.002", "time.integrator=implicit_friction", "weights_interval=0.01"]
SHORT = 0.02 if config.DISABLE_JIT else 0.4


def made(name, *said, duration=SHORT):
    """The closed loop of a controller on chapter 4's line with friction, noisy."""
    noise = ["sensor.noise=1e-4", "sensor.velocity_noise=2e-3"]
    experiment = load_experiment("chapter4", [*COMMON, *noise, f"time.duration={duration}", *said])
    robot = experiment.load_robot()
    return experiment.loop(robot, experiment.controller(name, robot=robot))


def assert_engines_agree(loop):
    """The compiled and the ordinary engine, and a batch with the first bit for bit."""
    runs = [replace(loop, engine=engine).run() for engine in ("compiled", "ordinary")]
    for signal in ("psi_hat", "torque", "e", "weight_norm"):
        scale = np.abs(runs[0][signal]).max()
        np.testing.assert_allclose(runs[0][signal], runs[1][signal], rtol=1e-9, atol=1e-9 * scale)
    kept = simulate_many([replace(loop, engine="compiled")] * 2, keep=True, workers=2)
    for one in kept:
        np.testing.assert_array_equal(one.recording["torque"], runs[0]["torque"])
        np.testing.assert_array_equal(one.final["controller_state"], runs[0].final["controller_state"])
    return runs[0]


def assert_it_resumes(whole, half):
    """A run to the end against one that stops at `half` seconds and goes on from its memory."""
    first = replace(whole, timing=msgspec.structs.replace(whole.timing, duration=half))
    straight, begun = whole.run(), first.run()
    state = first.controller.init(first.context())
    state.values[:] = begun.final["controller_state"]
    resumed = whole.run(
        state=state,
        plant_state=(begun.final["position"], begun.final["nu"]),
        hardware_state=begun.final["hardware_state"] if begun.final["hardware_state"].size else None,
        first=round(half / whole.timing.control_period),
    )
    np.testing.assert_array_equal(resumed.final["controller_state"], straight.final["controller_state"])


def assert_frozen(loop):
    """Without learning the weights of a run stay as they are."""
    run = replace(loop, controller=replace(loop.controller, learning=False)).run()
    for name, values in run.weights.items():
        if name != "time":
            np.testing.assert_array_equal(values[0], values[-1])

"""One case of `behaviour.py` in plain Python; runs with the package as it was and as it is.

python behaviour_worker.py CASE FOLDER
"""

from __future__ import annotations

import inspect
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

from mmnn_pin import Recording, load_experiment
from mmnn_pin.loop.batch import simulate_many

SHORT = ["time.duration=1.0"]


def loop_of(name: str, controller: str, *overrides: str) -> Any:
    """The closed loop of one controller of an experiment."""
    experiment = load_experiment(name, [*SHORT, *overrides])
    robot = experiment.load_robot()
    gains = {} if "robot" not in inspect.signature(experiment.controller).parameters else {"robot": robot}
    return experiment.loop(robot, experiment.controller(controller, **gains))


def final(recording: Recording, *names: str) -> Any:
    """The first of some arrays that a recording holds at its end."""
    return next(recording.final[name] for name in names if name in recording.final)


def resumed(loop: Any, folder: Path) -> None:
    """A run to half of its time, and on from there."""
    whole = loop.timing
    half = replace_time(whole, whole.duration / 2)
    first = replace(loop, timing=half).run(folder / "first.h5")
    # in `Loop.run` the controller's state was called `memory`, and the plant's `state`
    old = "memory" in inspect.signature(loop.run).parameters
    plant = (final(first, "position"), final(first, "nu"))
    learned = loop.memory_from() if old else loop.state_from()
    learned.values[:] = final(first, "controller_state", "memory")
    hardware = final(first, "hardware_state", "rig_memory")
    names = ("memory", "state", "rig_memory") if old else ("state", "plant_state", "hardware_state")
    loop.run(folder / "second.h5", first=half.samples, **dict(zip(names, (learned, plant, hardware), strict=True)))


def replace_time(timing: Any, duration: float) -> Any:
    """The same periods, another duration."""
    import msgspec

    return msgspec.structs.replace(timing, duration=duration)


def batch(folder: Path) -> None:
    """Runs of a batch with other masses and seeds, their signals kept."""
    loop = loop_of("chapter4", "two_layer")
    loops = [replace(loop, robot=loop.robot.with_masses({"root": 0.5 + 0.2 * i}), seed=i) for i in range(6)]
    for i, run in enumerate(simulate_many(loops, keep=True)):
        (folder / f"{i}.txt").write_text("\n".join(f"{key} {value!r}" for key, value in sorted(run.metrics.items())))
        assert run.recording is not None
        run.recording.save(folder / f"{i}.h5") if hasattr(run.recording, "save") else save(
            run.recording, folder / f"{i}"
        )


def save(recording: Recording, file: Path) -> None:
    """The signals of a recording that lies in memory."""
    import numpy as np

    np.savez(file.with_suffix(".npz"), **{name: recording[name] for name in recording.names})


ORDINARY = ("pd", "two_layer", "one_layer", "computed_torque", "adaptive_composite", "concurrent", "kalman_regressor")
RESUMED = ("two_layer", "adaptive_composite", "concurrent", "kalman_features")
SENSED = ("sensor.velocity=filtered", "sensor.delay=1", "sensor.resolution=0.001", "sensor.wheel_resolution=0.001")


def main(case: str, folder: Path) -> None:
    """Make the recordings of a case."""
    folder.mkdir(parents=True, exist_ok=True)
    if case == "batch":
        return batch(folder)
    kind, _, name = case.partition(":")
    if kind == "ordinary":
        replace(loop_of("track", name), engine="ordinary").run(folder / "run.h5")
    elif kind == "ordinary_sensed":
        replace(loop_of("track", name, *SENSED), engine="ordinary").run(folder / "run.h5")
    elif kind == "sensed":
        loop_of("track", name, *SENSED).run(folder / "run.h5")
    elif kind == "resumed":
        resumed(loop_of("track", name, *SENSED), folder)
    else:
        raise SystemExit(f"no case '{case}'")


if __name__ == "__main__":
    main(sys.argv[1], Path(sys.argv[2]))

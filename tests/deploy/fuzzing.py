"""Runs in which anything goes wrong that can, for exported controllers, with the answers of Python."""

from __future__ import annotations

from dataclasses import dataclass, replace

import msgspec
import numpy as np

from mmnn_pin import load_experiment
from mmnn_pin.deploy.embed.board import FOLLOW_SAMPLE, FOLLOW_VELOCITY, GO_ON, STAND, Fresh
from mmnn_pin.deploy.embed.export import supervised
from mmnn_pin.deploy.embed.files import files_of, selftest, translated
from mmnn_pin.deploy.embed.golden import PAUSE, RESET, RESUME, STOP, GoldenEvent, answers, as_measured
from mmnn_pin.reference.limits import Limits


def loop_of(robot, controller, **changes):
    """The loop of `track` with a robot and a controller, with its supervisor."""
    experiment = msgspec.structs.replace(load_experiment("track"), robot=robot, **changes)
    loaded = experiment.load_robot()
    return supervised(experiment.loop(loaded, experiment.controller(controller, robot=loaded)))


def fuzzed(loop, period, steps, seed):
    """Samples of which anything may go wrong: numbers, times, setpoints; trips, stops and resets."""
    rng, d = np.random.default_rng(seed), loop.robot.dimensions
    table = loop.trajectory.table(np.arange(steps) * period, d)
    time, events = 0.0, []
    for asked in table:
        time += period * rng.choice([1.0, 0.0, -1.0, 3.0, 400.0], p=[0.95, 0.02, 0.01, 0.015, 0.005])
        now = float(rng.choice([time, np.nan, np.inf, -np.inf], p=[0.994, 0.002, 0.002, 0.002]))
        received = as_measured(asked, loop.robot)
        received += 0.01 * rng.standard_normal(received.size)
        sent = asked.copy()
        for numbers in (received, sent):
            if rng.random() < 0.03:
                strange = [np.nan, np.inf, -np.inf, 1e308, 1e9, -1e5, 5e-324, -0.0, 3e7]
                numbers[int(rng.integers(numbers.size))] = rng.choice(strange)
        wishes = [FOLLOW_SAMPLE, GO_ON, STAND, FOLLOW_VELOCITY]
        wish = int(rng.choice(wishes[: 4 if d.base else 3], p=[0.8, 0.1, 0.05, 0.05] if d.base else [0.8, 0.1, 0.1]))
        action = int(rng.choice([0, STOP, RESET, PAUSE, RESUME], p=[0.94, 0.005, 0.035, 0.005, 0.015]))
        measured = time + period * rng.choice([0.0, -1.0, 5.0, -900.0, np.nan], p=[0.9, 0.06, 0.02, 0.01, 0.01])
        is_lost = rng.random() < 0.05
        events.append(GoldenEvent(now, None if is_lost else received, float(measured), wish, sent, action))
    return events


@dataclass(frozen=True)
class Fuzzed:
    """What happened in a run: how many answers were different, how often it tripped, was refused and felt contact."""

    distinct: int
    trips: int
    refused: int
    touched: int


def write_fuzzed(loop, folder, steps, seed):
    """An export with a self-test of samples that were fuzzed, into a folder; what happened in them."""
    safety = msgspec.structs.replace(loop.safety, timeout=0.02, joint_error=0.3)
    stepper = Fresh.of(replace(loop, safety=safety), limits=Limits())
    export = translated(stepper, loop.controller.name)
    for name, text in files_of(export).items():
        (folder / name).parent.mkdir(exist_ok=True)
        (folder / name).write_text(text)
    events = fuzzed(loop, stepper.period, steps, seed)
    states, seen, felt = stepper.hardware.way.supervisor.state, [], []

    def watched():
        """The events, with trips and samples so far noted after each."""
        for event in events:
            yield event
            seen.append((states.tripped[0], stepper.k))
            felt.append(stepper.is_touched)

    found = answers(stepper, watched(), [m.live for m in export.remembered])
    (folder / "selftest.c").write_text(selftest(export, events, found))
    tripped, samples = np.diff(np.array(seen), axis=0).T
    return Fuzzed(
        len({answer.checksum for answer in found}), int((tripped > 0).sum()), int((samples == 0).sum()), sum(felt)
    )

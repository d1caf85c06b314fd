"""The learner of a recording, built again: its settings, its weights at the start and at the end, and its steps.

A controller of this package is a compiled step over rows, so stepping it again over the rows of its run gives the
weights of every sample; with learning switched off it gives what fixed weights say of any rows.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import msgspec
import numpy as np

from ..errors import RecordingError
from ..recording import Recording
from ..signals import Array, Layout
from ..torque import law
from ..torque.controller import Feedback, Memory, Wiring
from ..torque.neural import Inputs, Neural, OneLayer, Robust, TwoLayer, channels

NETWORKS: dict[str, Any] = {
    **dict.fromkeys(("two_layer", "two_layer_zero", "two_layer_random"), TwoLayer),
    "one_layer": OneLayer,
}
PARTS: dict[str, Any] = {
    "feedback": Feedback,
    "robust": Robust | None,
    "inputs": Inputs,
    "inertia": tuple[float, ...] | None,
}


@dataclass(frozen=True, eq=False)
class Learner:
    """A learner and its weights.

    Attributes:
        controller: Its settings.
        wiring: What it was told before the run.
        start: Its memory before the first row.
        end: Its memory at the end, or the last one that is known.
        end_time: When that is [s].
    """

    controller: Neural
    wiring: Wiring
    start: Memory
    end: Memory
    end_time: float

    @property
    def networks(self) -> list[tuple[int, slice]]:
        """Number of every network (1 the base's, 2 the arm's) and its velocities."""
        layout = self.wiring.layout
        parts = {1: slice(0, layout.base), 2: slice(layout.base, layout.dof)}
        return [(i, parts[i]) for i, _ in channels(layout)]

    def frozen(self) -> Neural:
        """The controller with its weights held fixed."""
        return replace(self.controller, learning=False)


@dataclass(frozen=True, eq=False)
class Said:
    """What a learner with fixed weights says along rows.

    Attributes:
        psi_hat: (N, p) its output [N, N m].
        inputs: (N, nx) what its networks see.
        activations: Network to (N, h) hidden outputs.
    """

    psi_hat: Array
    inputs: Array
    activations: dict[int, Array]


def said(learner: Learner, memory: Memory, rows: Array) -> Said:
    """What the weights of a memory, held fixed, say along rows (N, width)."""
    stepper = Stepper(learner.frozen(), learner.wiring, memory.snapshot())
    psi_hat, inputs = np.zeros((len(rows), learner.wiring.layout.dof)), np.zeros((len(rows), memory["x"].size))
    activations = {i: np.zeros((len(rows), memory[f"sigma{i}"].size)) for i, _ in learner.networks}
    seen, hidden = stepper.memory["x"], {i: stepper.memory[f"sigma{i}"] for i in activations}
    for k, row in enumerate(rows):
        psi_hat[k], inputs[k] = stepper.step(row), seen
        for i, sigma in hidden.items():
            activations[i][k] = sigma
    return Said(psi_hat, inputs, activations)


class Stepper:
    """A controller of this package stepped over rows of a recording; the rows are not changed.

    Args:
        controller: The controller.
        wiring: What it is told.
        memory: Its memory, changed in place.
    """

    def __init__(self, controller: Neural, wiring: Wiring, memory: Memory) -> None:
        self.law, self.memory = controller.law(wiring), memory
        self.at, self.row = wiring.layout.offsets, wiring.layout.new_row()
        self.psi_hat = self.row[wiring.layout.where("psi_hat")]

    def step(self, row: Array) -> Array:
        """Output at a row (width,), a view (p,) that the next step overwrites; a learner learns from it."""
        self.row[:] = row
        law.step(self.law.kind, self.row, self.at, self.law.sizes, self.law.settings, self.memory.values)
        return self.psi_hat


def recorded_learner(recording: Recording, layout: Layout) -> Learner | None:
    """The learner of a run; None where its controller is none of this package's learners.

    Raises:
        RecordingError: It is one, and the recording does not hold its settings or its weights.
    """
    network = NETWORKS.get(str(recording.meta.get("controller")))
    if network is None:
        return None
    settings = recording.meta.get("controller_settings")
    if not settings:
        what = f"the recording does not tell the settings of {recording.meta['controller']}"
        raise RecordingError(what, why="an older mmnn_pin wrote it", fix="run it again", file=recording.path)
    controller = controller_of(network, settings)
    seed = np.random.SeedSequence(int(recording.meta.get("seed", 0))).spawn(1)[0]
    period = float(recording.meta["control_period"])
    wiring = Wiring(layout, period, len(recording), np.random.default_rng(seed))
    start = controller.init(wiring)
    snapshots = recording.weights
    if "time" in snapshots and len(snapshots["time"]) and abs(snapshots["time"][0] - recording.time[0]) < period / 2:
        put(start, snapshots, 0)
    return Learner(controller, wiring, start, *last(recording, start))


def controller_of(network: type[Any], settings: dict[str, Any]) -> Neural:
    """A controller from the settings that `Neural.facts` gave."""
    rest = {k: v for k, v in settings.items() if k != "network"}
    rest = {k: msgspec.convert(v, PARTS[k]) if k in PARTS else v for k, v in rest.items()}
    return Neural(network=msgspec.convert(settings["network"], network), **rest)


def put(memory: Memory, snapshots: dict[str, Array], k: int) -> None:
    """Write the k-th snapshot of the weights into a memory."""
    for name, values in snapshots.items():
        if name != "time":
            memory[name] = values[k]


def last(recording: Recording, start: Memory) -> tuple[Memory, float]:
    """The last finite weights that a recording holds, and their time [s].

    Raises:
        RecordingError: There are none.
    """
    memory, final = start.snapshot(), recording.final.get("memory")
    if final is not None and final.shape == memory.values.shape and np.isfinite(final).all():
        memory.values[:] = final
        return memory, recording.outcome.time
    times = recording.weights.get("time", np.zeros(0))
    for k in reversed(range(len(times))):
        if all(np.isfinite(values[k]).all() for values in recording.weights.values()):
            put(memory, recording.weights, k)
            return memory, float(times[k])
    raise RecordingError(
        "the recording holds no weights", why="its run ended before", fix="run again", file=recording.path
    )

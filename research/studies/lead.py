"""What the lead of Psi_hat does to error, noise and delay margin: `python -m research.studies.lead`.

Every controller drives `eight` with and without it, with the sensors' noise and without. Noise is what the
sensors' noise adds to the torque: the standard deviation, over the gain K, of its change from sample to sample. The
margin of `extrapolated` is that of `Psi_k + (Psi_k - Psi_k-1) / 2`, which takes the feedback inside Psi ahead, too.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence

import msgspec
import numpy as np

from mmnn_pin import load_experiment
from mmnn_pin.lab.show.table import Cell, Column, Table, number, row_of, terminal_text
from mmnn_pin.loop.batch import simulate_many
from mmnn_pin.loop.loop import Loop
from mmnn_pin.loop.sampled import HeldLoop, gains_of, linearised, slowest
from mmnn_pin.recording.recording import Recording
from mmnn_pin.sensing import Sensor
from mmnn_pin.signals import Array

LATE = 5.0  # errors and noise count from here on [s]
CASES = {  # whether Psi_hat leads, whether sensors have noise
    "at the sample": (False, True),
    "led": (True, True),
    "at the sample, exact": (False, False),
    "led, exact": (True, False),
}
FREQUENCIES = 4000


def main(arguments: Sequence[str] | None = None) -> None:
    """Parse the command line, run, print."""
    parser = argparse.ArgumentParser(prog="python -m research.studies.lead", description=__doc__)
    parser.add_argument("controllers", nargs="*", default=["computed_torque", "kalman_regressor", "two_layer"])
    parser.add_argument("--experiment", default="eight", help="name or file")
    parser.add_argument("--duration", type=float, default=20.0, help="of a run [s]")
    options = parser.parse_args(arguments)
    experiment = load_experiment(options.experiment, [f"time.duration={options.duration}"])
    robot, rows = experiment.load_robot(), []
    for name in options.controllers:
        loops = []
        for lead, noisy in CASES.values():
            sensor = experiment.sensor if noisy else Sensor()
            one = msgspec.structs.replace(experiment, lead=lead, sensor=sensor)
            loops.append(one.loop(robot, one.controller(name, robot=robot)))
        runs = simulate_many(loops, keep=("true_pose_error", "true_e", "torque", "effective_gain"), workers=2)
        for case, run in zip(CASES, runs, strict=True):
            assert run.recording is not None
            rows.append(row_of(name, Cell(case), *(number(value) for value in numbers(run.recording))))
        own, extrapolated = margins(loops[0])
        rows.append(row_of(name, Cell("margin, led or not"), number(1e3 * own), "", ""))
        rows.append(row_of(name, Cell("margin, extrapolated"), number(1e3 * extrapolated), "", ""))
    errors = (Column("base\n", "mm or ms"), Column("arm\n", "mrad"), Column("noise\n", "mrad/s"))
    heads = (Column(text=True), Column(text=True), *errors)
    print(terminal_text([Table("lead", heads, tuple(rows))], False, 120))


def numbers(run: Recording) -> tuple[float, float, float]:
    """RMS errors of base [mm] and arm [mrad], and the noise in the torques of the arm over K [mrad/s]."""
    late, n = run.time > LATE, run["true_e"].shape[1]
    base = 1e3 * float(np.sqrt((run["true_pose_error"][late][:, :2] ** 2).sum(axis=1).mean()))
    arm = 1e3 * float(np.sqrt((run["true_e"][late] ** 2).mean()))
    change = np.diff(run["torque"][late] / run["effective_gain"][late], n=2, axis=0)[:, -n:]
    return base, arm, 1e3 * float(np.sqrt((change**2).mean() / 6.0))  # a second difference of white noise has 6 times


def margins(loop: Loop) -> tuple[float, float]:
    """Delay margin of a loop with the feedback inside Psi, and the same extrapolated by half a period [s]."""
    plan = loop.plan()
    gains, h = gains_of(plan), slowest(plan)
    places = [held for held in linearised(plan, 5) if held is not None]
    return min(held.margin(gains, h, True) for held in places), min(extrapolated(held, gains, h) for held in places)


def extrapolated(held: HeldLoop, gains: Array, h: float) -> float:
    """The margin where `M nudot_ref` is `1.5` times this sample's less half of the last one's, by a sweep [s]."""
    k, inner = len(held.state), held.inside
    outer = held.feedback(gains, False)
    both = np.block([[held.state, np.zeros((k, k))], [np.eye(k), np.zeros((k, k))]])
    inside = np.hstack((outer + 1.5 * inner, -0.5 * inner))
    closed = both + np.vstack((held.torque, np.zeros_like(held.torque))) @ inside
    if np.abs(np.linalg.eigvals(closed)).max() > 1.0:
        return 0.0
    found = np.inf
    w = np.geomspace(1.0, np.pi / h, FREQUENCIES)
    z = np.exp(1j * w * h)
    F = outer + inner * (1.5 - 0.5 / z)[:, None, None]
    H = F @ np.linalg.solve(z[:, None, None] * np.eye(k) - held.state, held.torque + 0j)
    values = np.linalg.eigvals(H)
    values = np.take_along_axis(values, np.argsort(np.abs(values), axis=1), axis=1)
    over = np.abs(values) > 1.0
    for i, j in np.argwhere(over[1:] != over[:-1]):
        found = min(found, float(np.angle(values[i, j]) % (2 * np.pi) / w[i]))
    return found


if __name__ == "__main__":
    main()

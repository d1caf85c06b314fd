"""A compliant hand in numbers: stiffness under every controller, energy against delay, the force of hand-guiding.

    python benchmarks/compliance.py stiffness       of 300 N/m asked, measured against a spring in the world
    python benchmarks/compliance.py energy          put in beyond what the world did on the hand, over random contacts
    python benchmarks/compliance.py guiding         force that leads the hand at 0.1 m/s

Each prints a line per case. Robots: platform_arm, or those that are named after it.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence

import msgspec
import numpy as np

from mmnn_pin.compliance import Impedance
from mmnn_pin.disturbance import Surface
from mmnn_pin.errors import InputError
from mmnn_pin.lab.experiments.config import load_experiment
from mmnn_pin.lab.experiments.controllers import CONTROLLERS
from mmnn_pin.lab.experiments.experiment import Experiment
from mmnn_pin.lab.experiments.pushing import surface_normal
from mmnn_pin.loop.latency import Latency
from mmnn_pin.model.chain import chain_of, hands_of, track
from mmnn_pin.recording.recording import Recording, recorded_position
from mmnn_pin.settings import Timing, plain
from mmnn_pin.signals import Array
from mmnn_pin.touch import Touch

ASKED = 300.0  # N/m
SKIPPED = ("pd_effective", "pd_effective_one_layer")  # they need the run of a learner


def still(robot: str, seconds: float, *surfaces: Surface, **more: object) -> Experiment:
    """The hand of `wipe` at rest before some surfaces, on the ideal plant, without its force."""
    path = f"reference.hand.path=[{{type='wait', seconds={seconds}}}]"
    made = load_experiment("wipe", [f"robot={robot!r}", path, f"time.duration={seconds}"])
    given = {"force": None, "disturbances": surfaces, "plant": "ideal", "impedance": Impedance(stiffness=ASKED)}
    timing = msgspec.structs.replace(made.time, duration=seconds)
    assert isinstance(timing, Timing)
    return msgspec.structs.replace(made, time=timing, **(given | more))


def run(experiment: Experiment, controller: str) -> tuple[Recording, Array, Array]:
    """A run, the places of its hand (N, 3) and the direction in which its first surface faces (3,)."""
    robot = experiment.load_robot()
    recording = experiment.loop(robot, controller).run()
    chain = chain_of(robot, hands_of(robot)[0])
    places = track(chain, recorded_position(recording, robot))[:, 9:]
    faces = np.zeros(3)
    if experiment.disturbances:
        faces = surface_normal(plain(experiment.disturbances[0]), recording, robot)
    return recording, places, faces


def stiffness(robot: str, controller: str, touch: Touch | None) -> float:
    """Force over displacement at rest [N/m]: a spring of 500 N/m that begins 8 cm behind the hand, after a second.

    With `touch` a contact that is felt keeps what learns from learning; without it, it goes on.
    """
    spring = Surface(gap=-0.08, stiffness=500.0, damping=50.0, friction=0.0, start=1.0)
    recording, places, faces = run(still(robot, 6.0, spring, touch=touch), controller)
    before, after = recording.time < 1.0, recording.time > 5.5
    moved = float((places[after].mean(axis=0) - places[before][-1]) @ faces)
    force = float(recording["hand_force"][after].mean(axis=0) @ faces)
    return force / moved


def given_energy(robot: str, delay: float, seed: int, asked: float = ASKED) -> tuple[float, float]:
    """The most that controller and setpoint put in beyond the start, `injected`, and what went to and fro [J].

    Surfaces of random stiffness, place and time touch the hand, of half a joule at most where they appear.
    """
    rng = np.random.default_rng(seed)
    surfaces = []
    for t in rng.uniform(0.5, 4.0, 6):
        k = 10 ** rng.uniform(2.5, 4.0)
        gap, end = -rng.uniform(-0.01, min(0.03, 1.0 / np.sqrt(k))), float(t + rng.uniform(0.2, 0.6))
        surfaces.append(Surface(gap=gap, stiffness=k, damping=0.0, friction=0.0, start=float(t), end=end))
    impedance = Impedance(stiffness=asked)
    experiment = still(robot, 5.0, *surfaces, latency=Latency(command=delay), impedance=impedance)
    recording, _, _ = run(experiment, "computed_torque")
    begun = recording.time > 0.45
    injected, work = np.ravel(recording["injected"])[begun], np.ravel(recording["hand_work"])[begun]
    return float(injected.max() - injected[0]), float(np.ptp(work))


def guiding(robot: str, stiff: float) -> float:
    """Mean force with which a hand without a spring is led at 0.1 m/s [N]."""
    spring = Surface(gap=-0.01, stiffness=2e3, damping=200.0, friction=0.0)
    experiment = still(robot, 3.0, spring, impedance=Impedance(stiffness=stiff, damping=30.0, station=0.0))
    recording, places, faces = run(experiment, "computed_torque")
    speed = np.gradient(places @ faces, recording.time)
    moving = speed > 0.02
    return float((recording["hand_force"] @ faces)[moving].mean() / speed[moving].mean() * 0.1)


def main(arguments: Sequence[str]) -> None:
    """Print what is asked for."""
    what, robots = arguments[0] if arguments else "stiffness", list(arguments[1:]) or ["platform_arm"]
    for robot in robots:
        if what == "stiffness":
            for controller in (name for name in CONTROLLERS if name not in SKIPPED):
                found = []
                for touch in (None, Touch()):
                    try:
                        k = stiffness(robot, controller, touch)
                        found.append(f"{k:10.1f} N/m {k / ASKED - 1:+8.1%}")
                    except InputError as error:
                        found.append(str(error))
                print(f"{robot:14} {controller:22} learns {found[0]}, frozen {found[1]}", flush=True)
        elif what == "energy":
            for delay in (0.0, 0.002, 0.004, 0.008):
                most, exchanged = max(given_energy(robot, delay, seed) for seed in range(5))
                told = f"at most {1e3 * most:.3f} mJ, of {exchanged:.2f} J to and fro"
                print(f"{robot:14} delay {1e3 * delay:3.0f} ms: {told}", flush=True)
        else:
            print(f"{robot:14} {guiding(robot, 0.0):.2f} N at 0.1 m/s", flush=True)


if __name__ == "__main__":
    main(sys.argv[1:])

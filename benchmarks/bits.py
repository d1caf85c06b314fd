"""Are the bits of a run the same whatever the processor can do, and wherever it is made?

    python benchmarks/bits.py                                 a hash per experiment
    python benchmarks/bits.py --settings                      and again under all settings; exit status 1 on a change
    python benchmarks/bits.py --settings libraries python     under some of them
    python benchmarks/bits.py --only two_layer --only study   experiments whose names contain a word

A hash is taken of everything that is recorded but the machine's seconds: all signals of every sample, and the states of
controller, hardware and plant at the end; of a study's rows the metrics. Settings, each in a process of its own:

    libraries    no AVX and no FMA in glibc (GLIBC_TUNABLES), numpy (NPY_DISABLE_CPU_FEATURES) and OpenBLAS (a core of
                 2008); numba compiles as ever
    plainest     the same, and numba compiles for a plain x86-64 with SSE2, without SVML
    unoptimised  numba's optimisation switched off
    python       no numba (NUMBA_DISABLE_JIT=1): the compiled text as plain Python, over the first samples

A study's rows are made here, in a process and on a local Dask cluster besides, and must be the same there; and so
must a run of both engines. On the contact plant MuJoCo moves the robot with its own arithmetic and the platform's libm:
its hash is told and not judged.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import os
import platform
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

GLIBC = ",".join(f"-{name}" for name in ("AVX2_Usable", "AVX2", "FMA_Usable", "FMA", "FMA4", "AVX512F", "AVX"))
NUMPY = "AVX2 FMA3 AVX512F AVX512CD AVX512_SKX AVX512_CLX AVX512_CNL AVX512_ICL AVX512_SPR F16C AVX X86_V3 X86_V4"
LIBRARIES = {"GLIBC_TUNABLES": f"glibc.cpu.hwcaps={GLIBC}", "OPENBLAS_CORETYPE": "Nehalem"}
PLAINEST = {"NUMBA_CPU_NAME": "x86-64", "NUMBA_CPU_FEATURES": "", "NUMBA_DISABLE_INTEL_SVML": "1"}
SETTINGS: dict[str, dict[str, str]] = {
    "libraries": LIBRARIES,
    "plainest": LIBRARIES | PLAINEST,
    "unoptimised": {"NUMBA_OPT": "0"},
    "python": {"NUMBA_DISABLE_JIT": "1"},
}
SHORT = 0.03  # [s] of a run in plain Python
SENSED = (
    "sensor.velocity=filtered", "sensor.delay=1", "sensor.resolution=0.001", "sensor.wheel_resolution=0.001",
    "sensor.velocity_noise=0.001", "actuator.lag=0.01", "safety.torque=1e3",
)  # fmt: skip
LEARNERS = (
    "two_layer", "one_layer", "adaptive", "adaptive_composite", "concurrent", "kalman_regressor",
    "kalman_bilinear", "kalman_features", "computed_torque", "extended_state",
)  # fmt: skip
ROBOTS = {"holonomic": "tiago_pro", "fixed": "ur5", "tiago": "tiago"}

Hash = Any


def hashed(digest: Hash, recording: Any) -> None:
    """Take in the signals of a recording and the states at its end."""
    for name in sorted(recording.names):
        if name != "step_time":
            digest.update(name.encode() + recording[name].tobytes())
    for name in sorted(recording.final):
        digest.update(name.encode() + recording.final[name].tobytes())


def loop_of(duration: float, controller: str, *overrides: str, robot: str = "", engine: str = "auto") -> Any:
    """The loop of the experiment `track`."""
    from mmnn_pin import load_experiment

    there = [f"robot={robot}"] if robot else []
    experiment = load_experiment("track", [f"time.duration={duration}", *there, *overrides])
    machine = experiment.load_robot()
    return replace(experiment.loop(machine, experiment.controller(controller, robot=machine)), engine=engine)


def run(*given: str, **named: str) -> Callable[[Hash, float], None]:
    """An experiment that is one run of a loop."""

    def case(digest: Hash, duration: float) -> None:
        hashed(digest, loop_of(duration, *given, **named).run())

    return case


def resumed(digest: Hash, duration: float) -> None:
    """A run to half of its time, and on from there."""
    import msgspec

    with tempfile.TemporaryDirectory() as folder:
        loop = loop_of(duration, "two_layer", *SENSED)
        half = msgspec.structs.replace(loop.timing, duration=duration / 2)
        first = replace(loop, timing=half).run(Path(folder) / "first.h5")
        state = loop.state_from()
        state.values[:] = first.final["controller_state"]
        plant = first.final["position"], first.final["nu"]
        hardware = first.final["hardware_state"]
        again = loop.run(first=half.samples, state=state, plant_state=plant, hardware_state=hardware)
        hashed(digest, again)


def batch(digest: Hash, duration: float) -> None:
    """Runs with other masses and seeds, on all cores."""
    from mmnn_pin.loop.batch import simulate_many

    loop = loop_of(duration, "two_layer")
    loops = [replace(loop, robot=loop.robot.with_masses({"root": 0.5 + 0.2 * i}), seed=i) for i in range(4)]
    for one in simulate_many(loops, keep=True):
        hashed(digest, one.recording)


STUDY = """
title = "Bits"
experiment = "track"
controllers = ["two_layer"]
metrics = ["pose_error.[xy].peak"]
[set]
time.duration = {duration}
windows = [[0.0, {duration}]]
[sampling]
method = "sobol"
points = 2
seed = 3
[factors]
"masses.root" = {{ log_normal = [1.0, 0.2] }}
"seed" = {{ integer = [0, 1000] }}
"""


@contextmanager
def dask() -> Iterator[Any]:
    """A pool of the workers of a cluster on this machine."""
    from distributed import LocalCluster

    from mmnn_pin.lab.study.pools import cluster

    with (
        LocalCluster(n_workers=1, threads_per_worker=1, dashboard_address=None) as there,
        cluster(there.scheduler_address) as pool,
    ):
        yield pool


def study(place: str) -> Callable[[Hash, float], None]:
    """The rows of a small study, made in this process, in another or on a cluster."""

    def case(digest: Hash, duration: float) -> None:
        from mmnn_pin.lab.study.execution import execute
        from mmnn_pin.lab.study.plan import plan_of
        from mmnn_pin.lab.study.pools import here, processes
        from mmnn_pin.lab.study.settings import load_study

        pools: dict[str, Callable[[], AbstractContextManager[Any]]]
        pools = {"this process": here, "processes": lambda: processes(1), "Dask": dask}
        with tempfile.TemporaryDirectory() as folder:
            file = Path(folder) / "bits.toml"
            file.write_text(STUDY.format(duration=duration))
            plan = plan_of(load_study(file, ()))
            with pools[place]() as pool:
                done = {result.id: result for result in execute(pool, plan, range(len(plan)))}
        for _, result in sorted(done.items()):
            assert result.status == "completed", (result.status, result.message)
            digest.update(json.dumps(result.metrics, sort_keys=True).encode())

    return case


def starts(digest: Hash, duration: float) -> None:
    """What every learner starts from, and what its compiled law is given."""
    from mmnn_pin.compiled import one_thread

    for name in LEARNERS:
        loop = loop_of(duration, name)
        state = one_thread(loop.controller.init)(loop.context())
        digest.update(name.encode() + state.values.tobytes())


def robots(digest: Hash, duration: float) -> None:
    """The arrays of the compiled twins, and the motors' maps."""
    from mmnn_pin import load
    from mmnn_pin.elementary.matrices import pseudo_inverse
    from mmnn_pin.model.tree.body import body_of

    for name in ("platform_arm", *ROBOTS.values(), "panda", "tiago_dual"):
        robot = load(name)
        tree = body_of(robot).tree
        for array in (tree.numbers, tree.rotors, robot.T, robot.E, pseudo_inverse(robot.E)):
            digest.update(array.tobytes())


def references(digest: Hash, duration: float) -> None:
    """Paths of the base and profiles of joints, as tables."""
    import numpy as np

    from mmnn_pin import Circle, Eight, Line, Sine
    from mmnn_pin.reference import MinimumJerk, Waypoints
    from mmnn_pin.reference.holonomic import HolonomicPath

    t, corners = np.linspace(0.0, 20.0, 5001), ((0.0, 0.0), (4.0, 0.3), (4.5, 4.0), (0.3, 3.0))
    turning = Sine(0.7, 9.0, 0.1, 0.3)
    paths: list[Any] = [
        Line(0.3, (0.1, 0.2, 0.7), 1.0), Circle(1.3, 0.4, (0.1, 0.2, 0.7), -1, 1.0), Waypoints(corners, 0.5, 0.4),
        Eight(3.0, 1.5, 20.0, (0.1, 0.2, 0.7), 2.0), HolonomicPath(Eight(3.0, 1.5, 20.0), turning),
    ]  # fmt: skip
    for path in paths:
        samples = path.sample(t)
        for array in (samples.pose, samples.velocity, samples.acceleration):
            digest.update(np.ascontiguousarray(array).tobytes())
    for profile in (turning, MinimumJerk(0.1, 0.9, 13.0, 1.0)):
        joint = profile.sample(t)
        digest.update(joint.q.tobytes() + joint.qdot.tobytes() + joint.qddot.tobytes())


CASES: dict[str, Callable[[Hash, float], None]] = {
    "references": references,
    "robots": robots,
    "starts": starts,
    "differential two_layer": run("two_layer"),
    "differential two_layer, ordinary": run("two_layer", engine="ordinary"),
    "differential computed_torque": run("computed_torque"),
    "differential computed_torque, ordinary": run("computed_torque", engine="ordinary"),
    "differential adaptive_composite": run("adaptive_composite"),
    "differential concurrent": run("concurrent"),
    "differential kalman_features": run("kalman_features"),
    "holonomic two_layer": run("two_layer", robot=ROBOTS["holonomic"]),
    "fixed two_layer": run("two_layer", robot=ROBOTS["fixed"]),
    "differential tiago two_layer": run("two_layer", robot=ROBOTS["tiago"]),
    "hardware two_layer": run("two_layer", *SENSED),
    "hardware two_layer, ordinary": run("two_layer", *SENSED, engine="ordinary"),
    "rk4 two_layer": run("two_layer", "time.integrator=rk4", "time.plant_step=0.0005"),
    "resumed two_layer": resumed,
    "batch two_layer": batch,
    "study two_layer in this process": study("this process"),
    "study two_layer in processes": study("processes"),
    "study two_layer on Dask": study("Dask"),
    "contact two_layer": run("two_layer", "plant=contact"),
}
STUDIES = [name for name in CASES if name.startswith("study")]  # these must have one hash
NOT_OURS = ("contact two_layer",)  # may change


def work(names: list[str], duration: float) -> None:
    """Print the hash of every experiment, or why it cannot be made."""
    for name in names:
        digest = hashlib.sha256()
        try:
            CASES[name](digest, duration)
            answer = digest.hexdigest()[:16]
        except ImportError as error:
            answer = f"skipped: {error}"
        print(json.dumps([name, answer]), flush=True)


def ask(names: list[str], duration: float, environment: dict[str, str]) -> Iterator[tuple[str, str]]:
    """The hashes as a process with an environment of its own makes them."""
    command = [sys.executable, __file__, "--work", json.dumps(names), "--duration", str(duration)]
    surroundings = os.environ | {"OPENBLAS_NUM_THREADS": "1"} | environment
    with subprocess.Popen(command, env=surroundings, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        for line in process.stdout:
            name, answer = json.loads(line)
            yield name, answer
    if process.returncode:
        raise SystemExit(f"a process failed under {environment or 'no setting'}")


def masked(environment: dict[str, str]) -> dict[str, str]:
    """A setting with those of numpy's features masked that this processor and this numpy know."""
    if environment.get("GLIBC_TUNABLES") is None:
        return environment
    from numpy._core._multiarray_umath import __cpu_dispatch__, __cpu_features__

    there = [name for name in NUMPY.split() if name in __cpu_dispatch__ and __cpu_features__.get(name)]
    return environment | {"NPY_DISABLE_CPU_FEATURES": " ".join(there)}


def compare(first: dict[str, str], setting: str, duration: float) -> list[str]:
    """Names of the experiments whose hash another setting changes."""
    names, changed = list(first), []
    if setting == "python":
        names, duration = [n for n in names if not n.startswith(("batch", "study"))], SHORT
        first = dict(ask(names, duration, {}))
    print(f"\n{setting}: {' '.join(f'{k}={v}' for k, v in masked(SETTINGS[setting]).items())}")
    for name, answer in ask(names, duration, masked(SETTINGS[setting])):
        differs = answer != first[name]
        if differs and name not in NOT_OURS:
            changed.append(name)
        note = "   changed: MuJoCo's" if name in NOT_OURS else "   CHANGED"
        print(f"{name:40} {answer}{note if differs else ''}", flush=True)
    return changed


def main() -> int:
    """Make the hashes, compare them, and say what changes."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--settings", nargs="*", choices=[*SETTINGS, []], help="settings to compare; all without names")
    parser.add_argument("--only", action="append", default=[], metavar="WORD", help="cases that contain it; repeatable")
    parser.add_argument("--duration", type=float, default=1.0, metavar="S", help="of the runs [s]")
    parser.add_argument("--work", help=argparse.SUPPRESS)
    given = parser.parse_args()
    if given.work:
        work(json.loads(given.work), given.duration)
        return 0
    names = [name for name in CASES if not given.only or any(word in name for word in given.only)]
    first = {}
    for name, answer in ask(names, given.duration, {}):
        first[name] = answer
        print(f"{name:40} {answer}", flush=True)
    engines = [(name, f"{name}, ordinary") for name in first if f"{name}, ordinary" in first]
    changed = [f"{one} is not {other}" for one, other in engines if first[one] != first[other]]
    if len({first[name] for name in STUDIES if name in first and "skipped" not in first[name]}) > 1:
        changed.append("study rows differ between this process, others and Dask")
    if given.settings is not None and platform.machine() not in ("x86_64", "AMD64"):
        given.settings = ["unoptimised", "python"]  # the others name features of x86
    for setting in given.settings or (SETTINGS if given.settings is not None else ()):
        changed += [f"{name} under {setting}" for name in compare(first, setting, given.duration)]
    print("\n" + ("\n".join(f"changed: {line}" for line in changed) or f"{len(first)} experiments, no bit changed"))
    return int(bool(changed))


if __name__ == "__main__":
    sys.exit(main())

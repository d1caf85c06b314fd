"""Measures our routes and the peers a user might pick, in turn, in one run: `python benchmarks/run.py`.

The thesis's robot for 5 s, plant and control at 1 kHz, two-layer law, Psi, semi-implicit Euler. See README.md.
"""

from __future__ import annotations

import argparse
import json
import math
import os
import platform
import tempfile
from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack
from importlib import metadata
from pathlib import Path
from statistics import linear_regression, median
from typing import Any

import history
import startup
from peers import PEERS
from report import table
from worker import Worker

Sample = dict[str, Any]
Ask = Callable[[], Sample]
RUNS = 200  # of a batch
SECTIONS = ("steps", "growth", "rollouts", "peers", "startup", "parts")
CONTRACT = ("loop", "compiled", "plain_python", "tiago_compiled")
SINKS = {
    "memory": ("loop", "compiled", "tiago_compiled"),
    "alone": ("loop", "compiled", "tiago_compiled"),
    "file": ("loop", "compiled"),
    "whole": ("loop", "compiled"),
}
PACKAGES = ("mmnn_pin", "pin", "numpy", "numba", "scipy", "llvmlite")


def main(arguments: Sequence[str] | None = None) -> None:
    """Parse the command line, measure, print."""
    options = parse(arguments)
    with tempfile.TemporaryDirectory() as folder:
        result = measure(options, Path(folder))
    if options.history:
        history.append(options.history, result)
    print(json.dumps(result) if options.json else table(result))


def parse(arguments: Sequence[str] | None) -> argparse.Namespace:
    """Options of the command line."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--json", action="store_true", help="one JSON object in place of the table")
    parser.add_argument("--quick", action="store_true", help="a few steps once: shows that all runs, not how fast")
    parser.add_argument("--only", nargs="+", choices=SECTIONS, metavar="SECTION", help=f"some of {', '.join(SECTIONS)}")
    parser.add_argument("--rounds", type=int, default=15, help="how often everything is measured in turn (15)")
    parser.add_argument("--tiago", type=Path, help="URDF of TIAGo; by default that of example-robot-data, if installed")
    parser.add_argument("--peer-python", default=None, help="interpreter of an environment with the peers")
    parser.add_argument(
        "--floor", type=Path, help="folder of the built C++ reference, which is measured in turn with us"
    )
    parser.add_argument("--history", type=Path, help="file to add the ratios to, which history.py plots")
    options = parser.parse_args(arguments)
    options.seconds = 0.02 if options.quick else 5.0
    options.rounds = 1 if options.quick else max(1, options.rounds)
    options.only = tuple(options.only or (("steps", "growth", "rollouts", "peers") if options.quick else SECTIONS))
    return options


def measure(options: argparse.Namespace, folder: Path) -> dict[str, Any]:
    """All that was asked for, as the JSON object."""
    load = [os.getloadavg()[0]]
    with ExitStack() as stack:
        ours = stack.enter_context(Worker("routes.py", *ours_arguments(options.seconds, folder, options.tiago)))
        plain_seconds = 0.02 if options.quick else 0.2
        plain = stack.enter_context(
            Worker("routes.py", *ours_arguments(plain_seconds, folder), environment={"NUMBA_DISABLE_JIT": "1"})
        )
        asks = step_routes(options, ours, plain) | growth_routes(options, ours) | batch_routes(options, ours)
        if "peers" in options.only:
            asks |= peer_routes(options, ours, stack, folder / "work.npz")
        if options.floor:
            asks |= floor_routes(options, stack)
        samples = in_turn(asks, options.rounds)
        parts = part_times(ours, options.rounds) if "parts" in options.only else {}
    load.append(os.getloadavg()[0])
    result = summary(samples) | {"parts_us": parts}
    result["thousand_rollouts"] = thousand(options, folder) if "rollouts" in options.only else {}
    result["start_up_s"] = start_up(options) if "startup" in options.only else {}
    result["versions"] = {"python": platform.python_version()} | {name: version(name) for name in PACKAGES}
    result["machine"] = machine(load)
    result["settings"] = {"seconds": options.seconds, "rounds": options.rounds, "only": list(options.only)}
    return result


def ours_arguments(seconds: float, folder: Path, tiago: Path | None = None) -> list[str]:
    """Arguments of a worker for our routes."""
    return [str(seconds), str(folder), *([str(tiago)] if tiago else [])]


def step_routes(options: argparse.Namespace, ours: Worker, plain: Worker) -> dict[str, Ask]:
    """One run of each engine."""
    if "steps" not in options.only:
        return {}
    names = [*SINKS["memory"], *(f"{sink}_{name}" for sink in ("alone", "file", "whole") for name in SINKS[sink])]
    return {name: asking(ours, name) for name in names} | {"plain_python": asking(plain, "loop")}


def growth_routes(options: argparse.Namespace, ours: Worker) -> dict[str, Ask]:
    """The compiled loop with more and more arm joints."""
    sizes = () if "growth" not in options.only else (6, 12) if options.quick else (6, 7, 10, 15, 22, 30, 42, 60)
    return {f"chain {n}": asking(ours, f"chain {n}") for n in sizes}


def batch_routes(options: argparse.Namespace, ours: Worker) -> dict[str, Ask]:
    """Many runs on one thread and on all."""
    if "rollouts" not in options.only:
        return {}
    runs, cores = (2 if options.quick else RUNS), os.cpu_count() or 1
    return {
        f"{kind} {name}": asking(ours, f"batch {kind} {runs} {threads}")
        for kind in ("same", "masses")
        for name, threads in (("1_thread", 1), ("all_threads", cores))
    }


def peer_routes(options: argparse.Namespace, ours: Worker, stack: ExitStack, work: Path) -> dict[str, Ask]:
    """One run of every peer, each in a process of its own."""
    ours.ask(f"work {work}")
    python = {"python": options.peer_python} if options.peer_python else {}
    workers = {name: stack.enter_context(Worker("peer_worker.py", str(work), **python)) for name in PEERS}
    return {f"peer {name}": asking(worker, name) for name, worker in workers.items()}


def floor_routes(options: argparse.Namespace, stack: ExitStack) -> dict[str, Ask]:
    """The floor: single runs beside our steps, batches beside our rollouts; see `floor.py`."""
    folder, cores = options.floor.resolve(), os.cpu_count() or 1
    python = str(folder / "env" / "bin" / "python")
    worker = stack.enter_context(Worker("floor.py", str(folder), str(options.seconds), python=python))
    runs, asks = (2 if options.quick else RUNS), dict[str, Ask]()
    if "steps" in options.only:
        asks |= {f"floor {kind}": asking(worker, kind) for kind in ("cpp", "numba")}
    if "rollouts" in options.only:
        asks["floor cpp 1_thread"] = asking(worker, f"batch cpp {runs} 1")
        asks |= {
            f"floor {kind} all_threads": asking(worker, f"batch {kind} {runs} {cores}") for kind in ("cpp", "numba")
        }
    return asks


def floor(samples: Mapping[str, list[Sample]]) -> dict[str, Any]:
    """Medians of the floor; empty where it was not measured."""
    found = {name.removeprefix("floor "): some for name, some in samples.items() if name.startswith("floor ")}
    steps = {name: per_step(some) for name, some in found.items() if " " not in name}
    rates = {name: median(s["rollouts"] / s["wall"] for s in some) for name, some in found.items() if " " in name}
    cpu = {name: per_step(some, "cpu") for name, some in found.items()}
    named = {"us_per_step": steps, "rollouts_per_s": rates, "cpu_us_per_step": cpu} if found else {}
    return {key: {name.replace(" ", "_"): value for name, value in some.items()} for key, some in named.items()}


def asking(worker: Worker, request: str) -> Ask:
    """A request for later."""
    return lambda: worker.ask(request)


def in_turn(asks: Mapping[str, Ask], rounds: int) -> dict[str, list[Sample]]:
    """Every route once to warm up, then all of them in turn, round after round; what cannot run is asked once."""
    first = {name: ask() for name, ask in asks.items()}
    samples: dict[str, list[Sample]] = {name: [sample] for name, sample in first.items() if "skipped" in sample}
    for _ in range(rounds):
        for name, ask in asks.items():
            if "skipped" not in first[name]:
                samples.setdefault(name, []).append(ask())
    return samples


def per_step(samples: Sequence[Sample], clock: str = "wall") -> float:
    """Median microseconds per step."""
    return median(1e6 * sample[clock] / sample["steps"] for sample in samples)


def summary(samples: Mapping[str, list[Sample]]) -> dict[str, Any]:
    """Medians, ratios and the exponent."""
    others = [f"{sink}_{name}" for sink, names in SINKS.items() for name in names]
    steps = {name: samples[name] for name in samples if name in (*CONTRACT, *others)}
    wall = {name: per_step(found) for name, found in steps.items()}
    chains = {int(name.split()[1]): per_step(found) for name, found in samples.items() if name.startswith("chain")}
    batches = {name: found for name, found in samples.items() if name.startswith(("same", "masses"))}
    tiago = samples["tiago_compiled"][0] if "tiago_compiled" in samples else {}
    return {
        "us_per_step": {name: wall.get(name) for name in CONTRACT},
        **{
            f"us_per_step_{key}": {name: wall.get(f"{sink}_{name}") for name in SINKS[sink]}
            for sink, key in (("alone", "alone"), ("file", "file"), ("whole", "whole_run"))
        },
        "best_us_per_step": {name: min(1e6 * s["wall"] / s["steps"] for s in found) for name, found in steps.items()},
        "cpu_us_per_step": {name: per_step(found, "cpu") for name, found in steps.items()},
        "ratios": ratios(wall),
        "robots": {"loop": "platform_arm", "tiago_compiled": {key: tiago.get(key) for key in ("robot", "joints")}},
        "growth": {"joints_to_us": chains, "exponent": exponent(chains)},
        "rollouts_per_s": {
            name.replace(" ", "_"): median(sample["rollouts"] / sample["wall"] for sample in found)
            for name, found in batches.items()
        },
        "best_rollouts_per_s": {
            name.replace(" ", "_"): max(sample["rollouts"] / sample["wall"] for sample in found)
            for name, found in batches.items()
        },
        "cpu_us_per_rollout_step": {name.replace(" ", "_"): per_step(found, "cpu") for name, found in batches.items()},
        "floor": floor(samples),
        "peers": {name: peer(name, samples[f"peer {name}"], wall) for name in PEERS if f"peer {name}" in samples},
    }


def ratios(wall: Mapping[str, float]) -> dict[str, float]:
    """How many times the other route's time."""
    pairs = (("plain_python", "loop"), ("plain_python", "compiled"), ("loop", "compiled"))
    return {f"{slow}/{fast}": wall[slow] / wall[fast] for slow, fast in pairs if slow in wall}


def exponent(chains: Mapping[int, float]) -> float | None:
    """Slope of log time over log joints."""
    if len(chains) < 2:
        return None
    return linear_regression([math.log(n) for n in chains], [math.log(us) for us in chains.values()]).slope


def peer(name: str, samples: Sequence[Sample], wall: Mapping[str, float]) -> dict[str, Any]:
    """One peer's numbers and what it does not do."""
    about = {"what": PEERS[name].what, "does_not": PEERS[name].lacks, "package": PEERS[name].package}
    if "skipped" in samples[0]:
        return about | {"skipped": samples[0]["skipped"]}
    us, last = per_step(samples), samples[-1]
    numbers = {"us_per_step": us, "cpu_us_per_step": per_step(samples, "cpu"), "version": last["version"]}
    if "compiled" in wall:
        numbers |= {"times_compiled": us / wall["compiled"], "times_loop": us / wall["loop"]}
    if "rollouts" in last:
        numbers["rollouts_per_s"] = median(sample["rollouts"] / sample["wall"] for sample in samples)
    return about | numbers | {"ended_away": last["ended_away"]}


def part_times(ours: Worker, rounds: int) -> dict[str, dict[str, float]]:
    """Microseconds of processor time of each part of a step, medians."""
    answers = [(ours.ask("parts compiled"), ours.ask("parts loop")) for _ in range(rounds)]
    return {
        engine: {name: median(answer[i]["parts"][name] for answer in answers) for name in answers[0][i]["parts"]}
        for i, engine in enumerate(("compiled", "loop"))
    }


def thousand(options: argparse.Namespace, folder: Path) -> dict[str, float]:
    """Seconds and peak memory of 1,000 runs with other masses each, in a process of their own."""
    runs = 2 if options.quick else 1000
    with Worker("routes.py", *ours_arguments(options.seconds, folder)) as worker:
        sample = worker.ask(f"batch masses {runs} {os.cpu_count() or 1}")
    return {"runs": runs, "seconds": sample["wall"], "cpu_seconds": sample["cpu"], "peak_mb": sample["peak_mb"]}


def start_up(options: argparse.Namespace) -> dict[str, dict[str, float]]:
    """Whole processes: medians of wall clock and processor time [s]; the cold ones once."""
    warm = {"help": startup.help_text, "run_chapter4": startup.chapter4}
    samples = in_turn(warm, min(options.rounds, 5))
    result = {
        name: {clock: median(s[clock] for s in found) for clock in ("wall", "cpu")} for name, found in samples.items()
    }
    if not options.quick:
        result |= {"cold_first_result": startup.first_result(), "cold_run_chapter4": startup.chapter4(cold=True)}
    return result


def version(package: str) -> str | None:
    """Version of an installed package."""
    try:
        return metadata.version(package)
    except metadata.PackageNotFoundError:
        return None


def machine(load: Sequence[float]) -> dict[str, Any]:
    """What it was measured on; a load average much above 1 before the run means that others were computing too."""
    info = Path("/proc/cpuinfo")
    lines = info.read_text().splitlines() if info.exists() else []
    model = next((line.split(":")[1].strip() for line in lines if line.startswith("model name")), platform.processor())
    return {"system": platform.platform(), "processor": model, "cores": os.cpu_count(), "load_before_after": list(load)}


if __name__ == "__main__":
    main()

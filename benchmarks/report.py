"""The benchmark's table for people."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

from history import ratios


def table(result: Mapping[str, Any]) -> str:
    """The result as text."""
    return "\n".join(
        [
            *header(result),
            *steps(result),
            *growth(result),
            *batch(result),
            *floor(result),
            *peers(result),
            *rest(result),
        ]
    )


def header(result: Mapping[str, Any]) -> Iterator[str]:
    """Machine and versions."""
    m, s = result["machine"], result["settings"]
    yield f"{m['processor']}, {m['cores']} cores, {m['system']}"
    yield "load average before and after: " + ", ".join(f"{load:.1f}" for load in m["load_before_after"])
    yield ", ".join(f"{name} {version}" for name, version in result["versions"].items())
    yield f"{s['seconds']:g} s of simulated time at 1 kHz, medians (and the best) of {s['rounds']} rounds in turn"
    if max(m["load_before_after"]) > 1.5 * m["cores"] or m["load_before_after"][0] > 0.5:
        yield "the machine was busy with other things: trust the processor times and the best, not the medians"


def steps(result: Mapping[str, Any]) -> Iterator[str]:
    """Microseconds per step."""
    cpu, best = result["cpu_us_per_step"], result["best_us_per_step"]
    if cpu:
        yield f"\n{'us per step':40}{'wall':>10}{'best':>10}{'cpu':>10}"
    for sink, key, note in SINKS:
        for name, us in result[f"us_per_step{key}"].items():
            if us is not None:
                route = f"{sink}{name}"
                robot = result["robots"]["tiago_compiled"]
                about = f"  {robot['robot']}, {robot['joints']} arm joints" if route == "tiago_compiled" else ""
                yield f"  {name + note:38}{us:10.2f}{best[route]:10.2f}{cpu[route]:10.2f}{about}"
    for name, ratio in result["ratios"].items():
        yield f"  {name:38}{ratio:10.1f}"


def growth(result: Mapping[str, Any]) -> Iterator[str]:
    """Compiled steps over arm joints."""
    if result["growth"]["joints_to_us"]:
        yield f"\ncompiled us per step with the number of arm joints, exponent {result['growth']['exponent']:.2f}"
        yield "  " + "  ".join(f"{n}: {us:.1f}" for n, us in result["growth"]["joints_to_us"].items())


def batch(result: Mapping[str, Any]) -> Iterator[str]:
    """Rollouts per second."""
    if result["rollouts_per_s"]:
        yield f"\n{'rollouts per second':40}{'wall':>10}{'best':>10}"
    for name, rate in result["rollouts_per_s"].items():
        yield f"  {name:38}{rate:10.1f}{result['best_rollouts_per_s'][name]:10.1f}"
    if many := result["thousand_rollouts"]:
        spent = f"{many['cpu_seconds']:.2f} s of processor time"
        yield f"  {many['runs']} rollouts: {many['seconds']:.2f} s ({spent}), {many['peak_mb']:.0f} MB"


def floor(result: Mapping[str, Any]) -> Iterator[str]:
    """The floor, and ours beside it."""
    if result["floor"]:
        yield f"\n{'the floor':40}{'wall':>10}{'':10}{'cpu':>10}"
        cpu = result["floor"]["cpu_us_per_step"]
        for name, us in result["floor"]["us_per_step"].items():
            yield f"  {name + ', us per step':38}{us:10.2f}{'':10}{cpu[name]:10.2f}"
        for name, rate in result["floor"]["rollouts_per_s"].items():
            yield f"  {name + ', rollouts per second':38}{rate:10.1f}{'':10}{cpu[name]:10.2f} us per step"
        for name, us in result["cpu_us_per_rollout_step"].items():
            yield f"  {'ours: ' + name:38}{result['rollouts_per_s'][name]:10.1f}{'':10}{us:10.2f} us per step"
    for name, ratio in ratios(result).items():
        yield f"  {name:38}{ratio:10.2f}"


def peers(result: Mapping[str, Any]) -> Iterator[str]:
    """Peers, each with what it does not do."""
    if result["peers"]:
        yield f"\n{'peers':36}{'us/step':>10}{'x compiled':>12}{'x loop':>8}"
    for name, peer in result["peers"].items():
        if "skipped" in peer:
            yield f"  {name:34}   skipped: {peer['skipped']}"
            continue
        ratio = "".join(f"{peer[key]:{width}.1f}" if key in peer else " " * width for key, width in RATIOS)
        away = "" if peer["ended_away"] is None else f"; ended {peer['ended_away']:.1g} from ours"
        yield f"  {name:34}{peer['us_per_step']:10.2f}{ratio}  {peer['version']}; not: {peer['does_not']}{away}"


def rest(result: Mapping[str, Any]) -> Iterator[str]:
    """Start-up and the parts of a step."""
    if result["start_up_s"]:
        yield f"\n{'whole processes [s]':36}{'wall':>10}{'cpu':>10}"
    for name, seconds in result["start_up_s"].items():
        yield f"  {name:34}{seconds['wall']:10.2f}{seconds['cpu']:10.2f}"
    for engine, parts in result["parts_us"].items():
        yield f"\nparts of one step, {engine} [us of processor time], in all {sum(parts.values()):.2f}"
        for name, us in parts.items():
            yield f"  {name:44}{us:8.2f}"


# Routes of a step: before the name of the route, after the key of the result, in words.
SINKS = (
    ("", "", ""),
    ("alone_", "_alone", ", not recorded"),
    ("file_", "_file", ", recorded to a file"),
    ("whole_", "_whole_run", ", whole Loop.run"),
)
RATIOS = (("times_compiled", 12), ("times_loop", 8))

"""The benchmark's table for people."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any


def table(result: Mapping[str, Any]) -> str:
    """The result as text."""
    return "\n".join([*header(result), *steps(result), *growth(result), *batch(result), *peers(result), *rest(result)])


def header(result: Mapping[str, Any]) -> Iterator[str]:
    """Machine and versions."""
    m, s = result["machine"], result["settings"]
    yield f"{m['processor']}, {m['cores']} cores, {m['system']}"
    yield "load average before and after: " + ", ".join(f"{load:.1f}" for load in m["load_before_after"])
    yield ", ".join(f"{name} {version}" for name, version in result["versions"].items())
    yield f"{s['seconds']:g} s of simulated time at 1 kHz, medians of {s['rounds']} rounds in turn"


def steps(result: Mapping[str, Any]) -> Iterator[str]:
    """Microseconds per step."""
    cpu = result["cpu_us_per_step"]
    measured = {name: us for name, us in result["us_per_step"].items() if us is not None}
    if measured:
        yield f"\n{'us per step':36}{'wall':>10}{'cpu':>10}"
    for name, us in measured.items():
        robot = result["robots"]["tiago_compiled"]
        note = f"  {robot['robot']}, {robot['joints']} arm joints" if name == "tiago_compiled" else ""
        yield f"  {name:34}{us:10.2f}{cpu[name]:10.2f}{note}"
    for name, us in result["us_per_step_whole_run"].items():
        if us is not None:
            yield f"  {name + ', whole Loop.run':34}{us:10.2f}{cpu[f'whole_{name}']:10.2f}"
    for name, ratio in result["ratios"].items():
        yield f"  {name:34}{ratio:10.1f}"


def growth(result: Mapping[str, Any]) -> Iterator[str]:
    """Compiled steps over arm joints."""
    if result["growth"]["joints_to_us"]:
        yield f"\ncompiled us per step with the number of arm joints, exponent {result['growth']['exponent']:.2f}"
        yield "  " + "  ".join(f"{n}: {us:.1f}" for n, us in result["growth"]["joints_to_us"].items())


def batch(result: Mapping[str, Any]) -> Iterator[str]:
    """Rollouts per second."""
    if result["rollouts_per_s"]:
        yield "\nrollouts per second"
    for name, rate in result["rollouts_per_s"].items():
        yield f"  {name:34}{rate:10.1f}"
    if many := result["thousand_rollouts"]:
        yield f"  {many['runs']} rollouts: {many['seconds']:.2f} s, {many['peak_mb']:.0f} MB at most"


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


RATIOS = (("times_compiled", 12), ("times_loop", 8))

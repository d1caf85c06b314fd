"""Are the numbers of two versions of the package the same, bit for bit?

    python benchmarks/behaviour.py --before ba86712                  all cases; the old code has its own environment
    python benchmarks/behaviour.py --before ba86712 --only track     the cases whose names contain a word
    python benchmarks/behaviour.py --before ba86712 --folder DIR     keep the old runs, and use those that are there

The old version is checked out beside this one, installed into an environment of its own, and both make the same runs on
this machine: every controller, both engines, the contact plant, imperfect hardware, chapters 4 and 5, a batch, resumed
runs, `prove` and the robots' matrices. Datasets are compared bit for bit, with a table of those that were
renamed; attributes, keys and texts are not compared, and what is measured in seconds of the machine's time is left out.
Exit status 0 when nothing differs, 1 when something does.

Versions up to 3ab987d took their sines from the platform, later ones from `mmnn_pin.elementary`: last places differ,
and a run carries that on. `--tolerance 1e-6` lets an array differ by that share of its largest entry, and tells the
share that every case needed.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import h5py
import numpy as np
from behaviour_worker import ORDINARY, RESUMED

HERE = Path(__file__).resolve().parent
CLI = """import sys
from contextlib import suppress
from mmnn_pin.cli import main, mmnn
given = sys.argv[1:]
with suppress(ImportError):  # before it stood beside the package
    from research.prove import prove
    mmnn.add_command(prove)
sys.exit(main(given))
"""
# Datasets that were renamed: old name to new name.
RENAMED = {"final/memory": "final/controller_state", "final/rig_memory": "final/hardware_state"}
# Keys of JSON that were renamed.
RENAMED_KEYS: dict[str, str] = {}
# Not numbers of the run: what the machine's clock says, and texts.
LEFT_OUT = (
    "step_time",
    "timing",
    "seconds",
    "rtf",
    "wall",
    "file",
    "path",
    "folder",
    "urdf",
    "version",
    "note",
    "message",
)

CONTROLLERS = (
    "two_layer", "two_layer_zero", "two_layer_random", "one_layer", "pd", "adaptive", "adaptive_composite",
    "concurrent", "two_layer_residual", "nominal", "kalman_regressor", "kalman_bilinear",
    "kalman_features", "kalman_residual", "computed_torque",
)  # fmt: skip
SHORT = ("--set", "time.duration=1.5")


def cases() -> dict[str, list[str]]:
    """Arguments of `mmnn` by the name of a case; `OUT` stands for the case's folder; those of the worker have none."""
    found: dict[str, list[str]] = {}
    for name in CONTROLLERS:
        found[f"track {name}"] = ["run", "track", "--controller", name, *SHORT, "--out", "OUT"]
    for variant in ("printed", "fair", "figures"):
        found[f"chapter4 {variant}"] = ["run", "chapter4", "--variant", variant, "--out", "OUT"]
    found["chapter5"] = ["run", "chapter5", "--out", "OUT"]
    for name in ("pd", "two_layer", "kalman_regressor"):
        found[f"contact {name}"] = ["run", "track", "--plant", "contact", "--controller", name, *SHORT, "--out", "OUT"]
    found["slip"] = ["run", "slip", "--set", "time.duration=2.0", "--out", "OUT"]
    found["faults"] = ["run", "faults", "--controller", "two_layer", "--out", "OUT"]
    for robot in ("tiago", "tiago_dual", "ur5"):
        for name in ("two_layer", "adaptive"):
            short = ("--set", "time.duration=0.5")
            found[f"track {robot} {name}"] = [
                "run",
                "track",
                "--robot",
                robot,
                "--controller",
                name,
                *short,
                "--out",
                "OUT",
            ]
    found["eight"] = ["run", "eight", "--controller", "two_layer", "--controller", "concurrent", *SHORT, "--out", "OUT"]
    found["certified"] = ["run", "certified", "--set", "time.duration=2.0", "--out", "OUT"]
    for name in ("two_layer", "adaptive_composite", "concurrent", "kalman_bilinear"):
        found[f"prove {name}"] = ["prove", f"PREVIOUS/track {name}/{name}.h5", "--json"]
    for robot in ("platform_arm", "tiago"):
        found[f"check {robot}"] = ["check", robot, "--json"]
        found[f"inspect {robot}"] = ["inspect", robot, "--json"]
    plain = [f"ordinary:{name}" for name in ORDINARY] + [f"ordinary_sensed:{name}" for name in ORDINARY[:2]]
    plain += [f"sensed:{name}" for name in ORDINARY] + [f"resumed:{name}" for name in RESUMED] + ["batch"]
    return found | {name: [] for name in plain}


def make(python: str, package: Path, root: Path, case: str, arguments: list[str]) -> None:
    """Make the files of a case under root with a Python and a checkout; keeps what is there and finished."""
    folder = root / case.replace(":", " ")
    done = folder / "exit_status"
    if done.exists():
        return
    folder.mkdir(parents=True, exist_ok=True)
    if arguments:
        filled = [part.replace("OUT", str(folder)).replace("PREVIOUS", str(root)) for part in arguments]
        command = [python, "-c", CLI, *filled, *(["--force"] if "--out" in filled else [])]
    else:
        command = [python, str(HERE / "behaviour_worker.py"), case, str(folder)]
    environment = os.environ | {"PYTHONPATH": str(package), "OPENBLAS_NUM_THREADS": "1"}
    ended = subprocess.run(command, env=environment, capture_output=True, text=True, cwd=root)
    (folder / "stdout").write_text(ended.stdout)
    (folder / "stderr").write_text(ended.stderr)
    if ended.returncode not in (0, 1) or "Traceback" in ended.stderr:
        raise SystemExit(f"{package}: {case} failed:\n{ended.stderr[-2000:]}")
    done.write_text(str(ended.returncode))


def datasets(file: Path) -> dict[str, np.ndarray[Any, Any]]:
    """All arrays of a recording or an npz, by name."""
    if file.suffix == ".npz":
        with np.load(file) as arrays:
            return {name: arrays[name] for name in arrays.files}
    found: dict[str, np.ndarray[Any, Any]] = {}
    with h5py.File(file) as opened:

        def visit(name: str, item: Any) -> None:
            if isinstance(item, h5py.Dataset) and item.dtype.kind in "fiu":
                found[name] = item[()]

        opened.visititems(visit)
    return found


def numbers(value: Any, path: str = "") -> Iterator[tuple[str, Any]]:
    """All numbers of a JSON document with their key paths."""
    if isinstance(value, dict):
        for key, each in value.items():
            if not any(word in key for word in LEFT_OUT):
                yield from numbers(each, f"{path}.{RENAMED_KEYS.get(key, key)}")
    elif isinstance(value, list):
        for i, each in enumerate(value):
            yield from numbers(each, f"{path}[{i}]")
    elif isinstance(value, int | float | bool) or value is None:
        yield path, value


def same_bits(one: np.ndarray[Any, Any], other: np.ndarray[Any, Any]) -> bool:
    """Equal shapes and equal bits."""
    return one.shape == other.shape and one.dtype == other.dtype and one.tobytes() == other.tobytes()


def apart(one: np.ndarray[Any, Any], other: np.ndarray[Any, Any]) -> float:
    """Largest difference as a share of the largest entry; inf for other shapes and other gaps."""
    if one.shape != other.shape or not np.array_equal(np.isfinite(one), np.isfinite(other)):
        return np.inf
    one, other = one[np.isfinite(one)], other[np.isfinite(other)]
    largest = np.abs(one).max(initial=0.0)
    if largest == 0.0:
        return np.inf if np.abs(other).any() else 0.0
    return float(np.abs(one - other).max(initial=0.0) / largest)


def differences(before: Path, after: Path, tolerance: float = 0.0) -> tuple[list[str], int, float]:
    """What differs between the files of a case, how many arrays and numbers were compared, and the largest share."""
    wrong, compared, most = [], 0, 0.0
    for file in sorted([*before.rglob("*.h5"), *before.rglob("*.npz")]):
        other = after / file.relative_to(before)
        if not other.exists():
            wrong.append(f"{file.name} is missing")
            continue
        old, new = datasets(file), datasets(other)
        for name, values in old.items():
            if any(word in name for word in LEFT_OUT):
                continue
            there = new.get(name, new.get(RENAMED.get(name, name)))
            compared += 1
            if there is None:
                wrong.append(f"{file.name}: {name} is missing")
            elif not same_bits(values, there):
                share = apart(values, there)
                most = max(most, share)
                if share <= tolerance:
                    continue
                worst = abs(values - there).max() if values.shape == there.shape and values.size else there.shape
                wrong.append(f"{file.name}: {name} differs by {worst}")
    for file in sorted(before.glob("*.txt")):
        compared += 1
        if tolerance == 0.0 and file.read_text() != (after / file.name).read_text():
            wrong.append(f"{file.name} differs")
    texts = [(folder / "stdout").read_text() for folder in (before, after)]
    if texts[0].startswith("{"):
        old_numbers, new_numbers = (dict(numbers(json.loads(text))) for text in texts)
        compared += len(old_numbers)
        for path, number in old_numbers.items():
            if path not in new_numbers:
                wrong.append(f"JSON: {path} is missing")
            elif repr(new_numbers[path]) != repr(number) and not close(new_numbers[path], number, tolerance):
                wrong.append(f"JSON: {path} is {new_numbers[path]!r}, not {number!r}")
    return wrong, compared, most


def close(one: Any, other: Any, tolerance: float) -> bool:
    """Whether two numbers of a document are as near as is asked for."""
    return None not in (one, other) and abs(one - other) <= tolerance * max(abs(one), abs(other))


def environment_of(commit: str, folder: Path) -> tuple[str, Path]:
    """The Python of an environment in which a commit is installed, and its checkout; made where they are missing."""
    checkout, environment = folder / "checkout", folder / "environment"
    if not checkout.exists():
        subprocess.run(["git", "worktree", "prune"], check=True, cwd=HERE)
        subprocess.run(["git", "worktree", "add", "-q", "--detach", str(checkout), commit], check=True, cwd=HERE)
    python = environment / "bin" / "python"
    if not python.exists():
        subprocess.run([sys.executable, "-m", "venv", str(environment)], check=True)
        install = [str(python), "-m", "pip", "install", "-q", "-e", f"{checkout}[robots,contact]"]
        subprocess.run(install, check=True)
    return str(python), checkout


def main() -> int:
    """Compare, and say what differs."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--before", required=True, metavar="COMMIT", help="the old version")
    parser.add_argument("--checkout", type=Path, metavar="DIR", help="a checkout of it that runs in this environment")
    parser.add_argument("--folder", type=Path, metavar="DIR", help="where the old version and its runs are kept")
    parser.add_argument("--tolerance", type=float, default=0.0, metavar="SHARE", help="of an array's largest entry; 0")
    parser.add_argument("--only", action="append", default=[], metavar="WORD", help="cases that contain it; repeatable")
    options = parser.parse_args()
    wanted = {name: a for name, a in cases().items() if not options.only or any(word in name for word in options.only)}
    needed = {f"track {name.partition(' ')[2]}" for name in wanted if name.startswith("prove")}
    wanted = {name: a for name, a in cases().items() if name in needed or name in wanted}
    kept = (options.folder or Path(tempfile.mkdtemp())).resolve()
    kept.mkdir(parents=True, exist_ok=True)
    failed = total = 0
    with tempfile.TemporaryDirectory() as scratch:
        if options.checkout and not (options.checkout / "mmnn_pin").is_dir():
            parser.error(f"{options.checkout} is no checkout: there is no mmnn_pin in it")
        python, checkout = (
            (sys.executable, options.checkout.resolve()) if options.checkout else environment_of(options.before, kept)
        )
        for name, arguments in wanted.items():
            old, new = kept / "runs" / options.before, Path(scratch)
            make(python, checkout, old, name, arguments)
            make(sys.executable, HERE.parent, new, name, arguments)
            folder = name.replace(":", " ")
            wrong, compared, most = differences(old / folder, new / folder, options.tolerance)
            failed, total = failed + bool(wrong), total + compared
            equal = f"{compared:5} equal" + (f" within {most:.1e}" if most else "")
            print(f"{name:32} {'DIFFERENT' if wrong else equal}", flush=True)
            for line in wrong[:5]:
                print(f"    {line}")
            if len(wrong) > 5:
                print(f"    and {len(wrong) - 5} more")
    print(f"{len(wanted)} cases, {failed} differ, {total} arrays and numbers compared")
    return int(failed > 0)


if __name__ == "__main__":
    sys.exit(main())

"""How long a URDF takes to be audited and understood, meshes and Pinocchio left out.

    python benchmarks/reading.py                      a file of 200 kB made for this: a drive, an arm, many fixed links
    python benchmarks/reading.py tiago_dual --json    any robot

Processor time of this process after all imports, in ms: the smallest of many repetitions, which other work on the
machine spoils least, and their median. The file is copied to a folder of its own, so that no mesh is found.
"""

from __future__ import annotations

import argparse
import json
import shutil
import statistics
import tempfile
import time
from pathlib import Path

from mmnn_pin.model.arm import choose_arm
from mmnn_pin.model.base.overrides import Overrides
from mmnn_pin.model.base.understanding import find_base
from mmnn_pin.model.robots import find
from mmnn_pin.model.urdf.reading import read
from mmnn_pin.model.urdf.shapes import AtRest

SIZE = 200_000  # bytes
INERTIA = '<inertia ixx="0.012" ixy="1e-5" ixz="-2e-5" iyy="0.013" iyz="3e-6" izz="0.011"/>'


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("robot", nargs="?", help="a name or a file; else one is made")
    parser.add_argument("--repetitions", type=int, default=60)
    parser.add_argument("--json", action="store_true")
    given = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "robot.urdf"
        if given.robot:
            shutil.copyfile(find(given.robot), file)
        else:
            file.write_text(made(SIZE))
        result = {"bytes": file.stat().st_size, **measured(file, given.repetitions)}
    print(json.dumps(result) if given.json else table(result))


def measured(file: Path, repetitions: int) -> dict[str, dict[str, float]]:
    """Smallest and median processor time of each part [ms], after one repetition to warm up."""
    times = [once(file) for _ in range(repetitions + 1)][1:]
    parts = {"audit": [a for a, _ in times], "understanding": [b for _, b in times], "both": [a + b for a, b in times]}
    return {name: {"min": 1e3 * min(s), "median": 1e3 * statistics.median(s)} for name, s in parts.items()}


def once(file: Path) -> tuple[float, float]:
    """Seconds for the audit, and for the base and the arm."""
    started, said = time.process_time(), Overrides()
    document = read(file)
    audited = time.process_time()
    rest = AtRest(document)
    choose_arm(rest, find_base(rest, said).base, said)
    return audited - started, time.process_time() - audited


def made(size: int) -> str:
    """A URDF of at least so many bytes: a differential drive, an arm of seven joints, and fixed links on it."""
    text = link("base", '<box size="0.4 0.3 0.1"/>', "0 0 0.2")
    for name, y in (("left", 0.2), ("right", -0.2)):
        text += link(f"{name}_wheel", '<cylinder radius="0.1" length="0.03"/>', rpy="1.5707963267948966 0 0")
        text += joint(name, "continuous", "base", f"{name}_wheel", f"0 {y} 0.1", "0 1 0")
    parent = "base"
    for i in range(7):
        text += link(f"arm_{i}", '<cylinder radius="0.04" length="0.2"/>', "0 0 0.1")
        text += joint(f"arm_{i}_joint", "revolute", parent, f"arm_{i}", "0 0 0.25", "0 0 1" if i % 2 else "0 1 0")
        parent = f"arm_{i}"
    count = 0
    while len(text) < size:
        text += link(f"part_{count}", '<box size="0.02 0.03 0.04"/>', "0.001 0.002 0.003", "0.1 0.2 0.3")
        text += joint(
            f"part_{count}_joint", "fixed", f"arm_{count % 7}", f"part_{count}", f"0.0{count % 9} 0 0.1", "1 0 0"
        )
        count += 1
    return f'<?xml version="1.0"?>\n<robot name="made">\n{text}</robot>\n'


def link(name: str, shape: str, xyz: str = "0 0 0", rpy: str = "0 0 0") -> str:
    """A link with inertial, visual and collision, one tag per line."""
    origin = f'<origin xyz="{xyz}" rpy="{rpy}"/>'
    body = f"      {origin}\n      <geometry>\n        {shape}\n      </geometry>\n"
    holders = "".join(f"    <{tag}>\n{body}    </{tag}>\n" for tag in ("visual", "collision"))
    inertial = f'    <inertial>\n      {origin}\n      <mass value="1.234567"/>\n      {INERTIA}\n    </inertial>\n'
    return f'  <link name="{name}">\n{inertial}{holders}  </link>\n'


def joint(name: str, kind: str, parent: str, child: str, xyz: str, axis: str) -> str:
    """A joint with everything a joint can have."""
    return (
        f'  <joint name="{name}" type="{kind}">\n    <parent link="{parent}"/>\n    <child link="{child}"/>\n'
        f'    <origin xyz="{xyz}" rpy="0 0 0"/>\n    <axis xyz="{axis}"/>\n'
        '    <limit lower="-2.5" upper="2.5" effort="40" velocity="2"/>\n'
        '    <dynamics damping="0.5" friction="0.1"/>\n  </joint>\n'
    )


def table(result: dict) -> str:
    """The result as text."""
    rows = [
        f"{name:14} {times['min']:6.1f} {times['median']:7.1f}" for name, times in result.items() if name != "bytes"
    ]
    return "\n".join([f"{result['bytes']:,} bytes, processor time [ms]", f"{'':14} {'min':>6} {'median':>7}", *rows])


if __name__ == "__main__":
    main()

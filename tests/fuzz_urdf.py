"""Break URDFs at random and load what comes out: a refusal or a finite model, never a crash.

python tests/fuzz_urdf.py [--files 3000] [--seed 0] [--batch 250] [--xacro] [--of FILE ...]

With `--xacro` a xacro file is broken, which takes half a second each; with `--of` these files are.

A batch of files is loaded in a process of its own, so that a crash of the interpreter is seen and its file known.
"""

from __future__ import annotations

import argparse
import collections
import random
import re
import subprocess
import sys
import tempfile
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np

ROOT = Path(__file__).parent.parent
WORDS = ["0", "-1", "1e400", "1e300", "1e-300", "nan", "inf", "1,5", "1.5kg", "${m}"]
WORDS += ["2 ", " 2", "2\t", "&#160;2"]
WORDS += ["0x10", "-0", "1e9", "1e-9", "90", "3.14159", "1_0"]
TYPES = ["revolute", "continuous", "prismatic", "fixed", "floating", "planar", "spherical"]
INERTIAL = '<inertial><mass value="1"/><inertia ixx="0.1" ixy="0" ixz="0" iyy="0.1" iyz="0" izz="0.1"/></inertial>'
PENDULUM = f"""<robot name="pendulum">
  <link name="stand"/>
  <link name="rod">{INERTIAL}<visual><geometry><cylinder radius="0.02" length="1"/></geometry></visual></link>
  <joint name="hinge" type="revolute">
    <parent link="stand"/><child link="rod"/><origin xyz="0 0 1" rpy="0 0 0"/><axis xyz="0 1 0"/>
    <limit lower="-2" upper="2" effort="5" velocity="1"/><dynamics damping="0.1" friction="0"/>
  </joint>
</robot>
"""
SLIDER = f"""<robot name="slider">
  <link name="base">{INERTIAL}</link>
  <link name="carriage">{INERTIAL}</link>
  <link name="finger">{INERTIAL}</link>
  <link name="plate"/>
  <joint name="rail" type="prismatic">
    <parent link="base"/><child link="carriage"/><axis xyz="1 0 0"/><limit lower="0" upper="1" effort="9" velocity="1"/>
  </joint>
  <joint name="grip" type="continuous">
    <parent link="carriage"/><child link="finger"/><origin xyz="0.1 0 0.2"/><axis xyz="0 0 1"/>
  </joint>
  <joint name="weld" type="fixed"><parent link="finger"/><child link="plate"/></joint>
</robot>
"""

XACRO = f"""<robot name="rail" xmlns:xacro="http://www.ros.org/wiki/xacro">
  <xacro:arg name="length" default="0.5"/><xacro:property name="mass" value="${{2 * 0.5}}"/>
  <xacro:macro name="body" params="name on:=stand x:=0 *shape">
    <link name="${{name}}">{INERTIAL}<visual><xacro:insert_block name="shape"/></visual></link>
    <joint name="${{name}}_joint" type="revolute"><parent link="${{on}}"/><child link="${{name}}"/>
      <origin xyz="${{x}} 0 $(arg length)"/><axis xyz="0 1 0"/>
      <limit lower="-2" upper="2" effort="5" velocity="1"/></joint>
  </xacro:macro>
  <link name="stand"/>
  <xacro:if value="${{mass > 0}}">
    <xacro:body name="rod"><geometry><sphere radius="0.1"/></geometry></xacro:body></xacro:if>
  <xacro:unless value="0">
    <xacro:body name="end" on="rod" x="$(arg length)"><geometry><sphere radius="0.1"/></geometry></xacro:body>
  </xacro:unless>
</robot>
"""

Mutation = Callable[[bytes, random.Random], bytes]


def sources(of: Sequence[str] = ()) -> list[bytes]:
    """The files that are broken."""
    return [Path(file).read_bytes() for file in of] or [
        (ROOT / "urdf" / "platform_arm.urdf").read_bytes(),
        PENDULUM.encode(),
        SLIDER.encode(),
    ]


def flip_byte(data: bytes, rng: random.Random) -> bytes:
    at = rng.randrange(len(data))
    return data[:at] + bytes([rng.randrange(256)]) + data[at + 1 :]


def cut_bytes(data: bytes, rng: random.Random) -> bytes:
    at = rng.randrange(len(data))
    return data[:at] + data[at + rng.choice((1, 2, 10, 200)) :]


def copy_bytes(data: bytes, rng: random.Random) -> bytes:
    at, to = rng.randrange(len(data)), rng.randrange(len(data))
    return data[:to] + data[at : at + rng.choice((1, 5, 50, 300))] + data[to:]


def truncate(data: bytes, rng: random.Random) -> bytes:
    return data[: rng.randrange(len(data))]


def replace_match(pattern: bytes, new: Callable[[re.Match[bytes], random.Random], bytes]) -> Mutation:
    """A mutation that puts something else in the place of one match of a pattern."""

    def mutate(data: bytes, rng: random.Random) -> bytes:
        body = data.find(b"<robot")
        found = list(re.finditer(pattern, data[body:], re.DOTALL))
        if not found:
            return data
        match = rng.choice(found)
        return data[: body + match.start()] + new(match, rng) + data[body + match.end() :]

    return mutate


def swap_elements(data: bytes, rng: random.Random) -> bytes:
    first, second = sorted(rng.sample(list(re.finditer(rb"<[a-z]+ [^<>]*/>", data)), 2), key=lambda m: m.start())
    between = data[first.end() : second.start()]
    return data[: first.start()] + second[0] + between + first[0] + data[second.end() :]


MUTATIONS: list[Mutation] = [
    flip_byte,
    cut_bytes,
    copy_bytes,
    truncate,
    swap_elements,
    *4 * [replace_match(rb"(?<=[\" ])-?\d+\.?\d*(?=[\" ])", lambda m, rng: rng.choice(WORDS).encode())],
    *2 * [replace_match(rb"(?<=[\" ])-?\d+\.?\d*(?=[\" ])", lambda m, rng: b"%g" % rng.gauss(0, 10))],
    replace_match(rb"<[a-z_]+ [^<>]*/>", lambda m, rng: b""),
    replace_match(rb"<[a-z_]+ [^<>]*/>", lambda m, rng: m[0] + m[0]),
    replace_match(rb"<inertial>.*?</inertial>", lambda m, rng: b""),
    replace_match(rb"<joint.*?</joint>", lambda m, rng: rng.choice((b"", m[0] + m[0]))),
    replace_match(rb"<link.*?</link>", lambda m, rng: rng.choice((b"", m[0] + m[0]))),
    replace_match(rb"(?<=type=\")\w+", lambda m, rng: rng.choice(TYPES).encode()),
    replace_match(rb"(?<=link=\")\w+", lambda m, rng: rng.choice((b"base_link", b"rod", b"stand", b"finger", b"x"))),
    replace_match(rb"(?<=<)\w+", lambda m, rng: m[0][1:] or b"x"),
    replace_match(rb"</joint>", lambda m, rng: b'<mimic joint="hinge"/></joint>'),
]


EXPRESSIONS = [
    "${1/0}",
    "${a}",
    "$(arg x)",
    "$(arg length)",
    "$(find no)/a",
    "${'x' * 10**9}",
    "${",
    "$(eval 1)",
    "${[]}",
]
EXPRESSIONS += [
    "${xacro.load_yaml('a')}",
    "$(env A)",
    "${mass}",
    "${open('a')}",
    "${__import__}",
    "$$",
    "${nan}",
    "true",
]
CALLS = ["<xacro:body/>", '<xacro:include filename="robot.urdf.xacro"/>', "<xacro:no/>", "<body/>", "<xacro:if/>"]
CALLS += [
    '<xacro:include filename="$(find no)/a"/>',
    '<xacro:arg name="length"/>',
    '<xacro:property name="a" value="${a}"/>',
]
OF_XACRO: list[Mutation] = [
    *4 * [replace_match(rb"(?<=\")[^\"<>]*(?=\")", lambda m, rng: rng.choice([*EXPRESSIONS, *WORDS]).encode())],
    *2
    * [replace_match(rb"<xacro:\w+", lambda m, rng: b"<xacro:" + rng.choice((b"if", b"body", b"macro", b"property")))],
    *2 * [replace_match(rb"<link", lambda m, rng: rng.choice(CALLS).encode() + m[0])],
    replace_match(rb"<xacro:(\w+).*?</xacro:\1>", lambda m, rng: rng.choice((b"", m[0] + m[0]))),
    replace_match(rb"(?<=params=\")[^\"]*", lambda m, rng: m[0][: rng.randrange(len(m[0]) + 1)]),
    replace_match(rb"</?xacro:macro[^>]*>", lambda m, rng: b""),
]


def mutant(seed: int, xacro: bool = False, of: Sequence[str] = ()) -> bytes:
    """One broken file: one to three mutations of one of the sources."""
    rng = random.Random(seed)
    data = XACRO.encode() if xacro else rng.choice(sources(of))
    mutations = [*MUTATIONS, *2 * OF_XACRO] if xacro else MUTATIONS
    for _ in range(rng.choice((1, 1, 1, 2, 3))):
        data = rng.choice(mutations)(data or b" " * 9, rng) if data.count(b"/>") > 1 else data
    return data


def verdict(data: bytes, file: Path) -> str:
    """`refused`, `finite`, or what went wrong: an exception that is no refusal, or a model that is not finite."""
    from mmnn_pin.errors import InputError
    from mmnn_pin.model import load
    from mmnn_pin.model.dynamics import Dynamics

    file.write_bytes(data)
    try:
        robot = load(file)
    except InputError as error:
        return "refused" if str(error).strip() else "a refusal without words"
    except Exception as error:
        return f"{type(error).__name__}: {error}"
    rng, dynamics = np.random.default_rng(1), Dynamics(robot)  # of what moves: a locked body may have no mass
    position, nu = robot.position(robot.random(1)), rng.uniform(-1, 1, robot.dimensions.dof)
    M, acceleration = dynamics.mass_matrix(position).copy(), dynamics.acceleration(position, nu, np.zeros(nu.size))
    tau = dynamics.psi(position, nu, nu, acceleration)  # what the acceleration needs: nothing
    finite = all(np.isfinite(x).all() for x in (acceleration, M, tau))
    return "finite" if finite and np.linalg.eigvalsh(M).min(initial=1.0) > 0 else "not finite, or M is singular"


def work_through(first: int, last: int, xacro: bool, of: Sequence[str]) -> None:
    """Load the mutants of some seeds, one line each on standard output."""
    with tempfile.TemporaryDirectory() as folder:
        for seed in range(first, last):
            print(seed, end=" ", flush=True)
            file = Path(folder) / f"robot.urdf{'.xacro' * xacro}"
            print(verdict(mutant(seed, xacro, of), file).replace("\n", " "), flush=True)


def fuzz(
    files: int, seed: int = 0, batch: int = 250, xacro: bool = False, of: Sequence[str] = ()
) -> tuple[collections.Counter[str], list[str]]:
    """Load many mutants in subprocesses.

    Returns:
        How often each verdict came, and every line that tells of a crash or a bad model.
    """
    counts: collections.Counter[str] = collections.Counter()
    wrong: list[str] = []
    for first in range(seed, seed + files, batch):
        last = min(first + batch, seed + files)
        while first < last:
            command = [sys.executable, __file__, "--work", str(first), str(last), *["--xacro"] * xacro, "--of", *of]
            done = subprocess.run(command, capture_output=True, text=True, cwd=ROOT, timeout=60 * (last - first) + 600)
            lines = [line.partition(" ") for line in done.stdout.splitlines()]
            for number, _, text in lines:
                kind = text if text in ("refused", "finite") else "wrong"
                crashed = f"crash, exit code {done.returncode}: {done.stderr[-300:]}"
                counts[kind] += 1
                wrong += [f"seed {number}: {text or crashed}"] if kind == "wrong" else []
            if not lines:
                raise RuntimeError(done.stderr)
            first = int(lines[-1][0]) + 1  # after a crash: go on behind it
    return counts, wrong


def main() -> int:
    """The command line."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--files", type=int, default=3000)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--batch", type=int, default=250)
    parser.add_argument("--work", type=int, nargs=2, help=argparse.SUPPRESS)
    parser.add_argument("--xacro", action="store_true", help="Break a xacro file.")
    parser.add_argument("--of", nargs="*", default=(), metavar="FILE", help="Break these files.")
    given = parser.parse_args()
    if given.work:
        work_through(*given.work, given.xacro, given.of)
        return 0
    counts, wrong = fuzz(given.files, given.seed, given.batch, given.xacro, given.of)
    print(dict(counts), *wrong, sep="\n")
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main())

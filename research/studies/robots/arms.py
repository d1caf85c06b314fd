"""The roles of arms' joints on public robots, held against how many joints their arms have.

    python -m research.studies.robots.arms FOLDER

Every robot with a truth about its arm (`arm` in the files of truths) whose base is understood is counted twice: by the
weights of `mmnn_pin.model.limbs`, and by weights that are fitted, from nothing, to the robots of all other
repositories (logistic regression with a Gaussian prior; a joint that moves speaks against every role, the topmost joint
of a branch that stands still for the one it has). The second is what the signs are worth on robots nobody has seen.
"""

from __future__ import annotations

import os
import tomllib
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import click
import numpy as np

from mmnn_pin.errors import InputError
from mmnn_pin.model.arm import limbs_of, slaves_of
from mmnn_pin.model.base.overrides import folders_of
from mmnn_pin.model.limbs import STILL, WEIGHTS, Limbs
from mmnn_pin.model.loading import load
from mmnn_pin.model.robot import Robot
from mmnn_pin.model.urdf.reading import parse
from mmnn_pin.model.urdf.shapes import AtRest
from mmnn_pin.signals import Array

from .__main__ import judge

TRUTHS = ("corpus.toml", "steered.toml", "wild.toml")
PRIOR = 3.0  # standard deviation of a weight [nats]
KEYS = tuple(WEIGHTS)


@dataclass(frozen=True)
class Known:
    """A robot whose arm is known.

    Attributes:
        name: Its name.
        repository: Where it is from.
        counts: How many joints its arms have; several where its file leaves that open.
        limbs: Its branches.
    """

    name: str
    repository: str
    counts: tuple[int, ...]
    limbs: Limbs

    def right(self, weights: Mapping[str, tuple[float, ...]] = WEIGHTS) -> bool:
        """Whether its arms have as many joints as they should, by some weights."""
        return len(replace(self.limbs, weights=weights).arm) in self.counts


def known(entry: dict[str, Any], folder: Path) -> Known | None:
    """A robot of a file of truths, None where its base is not understood."""
    os.environ.update(entry.get("env", {}))
    outcome = judge(entry, folder)
    if not outcome.file:
        return None
    try:
        robot = load(outcome.file, **outcome.said)
    except InputError:
        return None
    arm = entry["arm"]
    return Known(
        entry["name"],
        entry["repository"].partition("@")[0],
        (*arm,) if isinstance(arm, list) else (arm,),
        branches(robot),
    )


def branches(robot: Robot) -> Limbs:
    """The branches of a robot's joints that are not its base's."""
    document = parse(robot.urdf.encode(), robot.path)
    rest, slaves = AtRest(document, folders_of(robot.path, robot.overrides)), slaves_of(document)
    taken = {*robot.base.joints, *robot.base.locked, *slaves}
    joints = [joint.name for joint in document.joints.values() if joint.moves and joint.name not in taken]
    return limbs_of(rest, robot.base, joints, slaves, robot.overrides)[0]


def examples(robot: Known) -> Iterable[tuple[Array, float]]:
    """Rows of counted signs (STILL by KEYS) of a robot that is counted rightly: 1 where a branch stands still."""
    for name, limb in robot.limbs.limbs.items():
        role = limb.other if limb.role == "arm" else limb.role
        row = np.zeros((len(STILL), len(KEYS)))
        for key, _, _ in robot.limbs.seen(name) if role in STILL else ():
            row[STILL.index(role), KEYS.index(key)] += 1.0
        yield row.ravel(), float(limb.role != "arm")


def fitted(robots: Iterable[Known]) -> dict[str, tuple[float, ...]]:
    """Weights of signs that are likeliest on some robots: Newton's method on a logistic regression."""
    pairs = [pair for robot in robots if robot.right() for pair in examples(robot)]
    X, y = np.array([row for row, _ in pairs]), np.array([label for _, label in pairs])
    w = np.zeros(X.shape[1])
    for _ in range(30):
        p = 1 / (1 + np.exp(-np.clip(X @ w, -30, 30)))
        slope, curve = X.T @ (p - y) + w / PRIOR**2, (X.T * (p * (1 - p))) @ X + np.eye(len(w)) / PRIOR**2
        w -= np.linalg.solve(curve, slope)
    table = w.reshape(len(STILL), len(KEYS))
    return {key: tuple(map(float, table[:, i])) for i, key in enumerate(KEYS)}


@click.command()
@click.argument("folder", type=click.Path(exists=True, path_type=Path))
@click.option("--weights", is_flag=True, help="Print the weights that all robots give, beside those that are used.")
def main(folder: Path, weights: bool) -> None:
    """Count the joints of arms of public robots, each by weights that its repository had no part in."""
    here, robots = Path(__file__).parent, list[Known]()
    for file in (here / name for name in TRUTHS):
        entries = tomllib.loads(file.read_text())["robot"] if file.exists() else []
        robots += filter(None, (known(e, folder) for e in entries if "arm" in e and "repository" in e))
    repositories = {robot.repository for robot in robots}
    without = {name: fitted(r for r in robots if r.repository != name) for name in repositories}
    right = [robot.right() for robot in robots]
    left_out = [robot.right(without[robot.repository]) for robot in robots]
    for robot, by_table, by_others in zip(robots, right, left_out, strict=True):
        if not (by_table and by_others):
            more = "" if by_others else ", wrong by the others"
            click.echo(f"{robot.name}: {robot.counts} joints, {len(robot.limbs.arm)} by the table{more}")
    click.echo(f"{len(robots)} robots of {len(repositories)} repositories: {sum(right)} right by the table,")
    click.echo(f"{sum(left_out)} by weights that are fitted without their repository")
    if weights:
        for key, values in fitted(robots).items():
            pairs = ", ".join(f"{r} {w:+.1f} ({t:+.1f})" for r, w, t in zip(STILL, values, WEIGHTS[key], strict=True))
            click.echo(f"{key}: {pairs}")


if __name__ == "__main__":
    main()

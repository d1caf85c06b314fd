"""`load(name or path) -> Robot`: a URDF read and audited, its base and arm found, its model built and checked."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from .arm import choose_arm
from .assembly import assemble
from .base.overrides import Overrides, folders_of, said_of
from .base.remarks import arm_notes, printed_notes, settled, weld_notes
from .base.understanding import find_base
from .build import pinocchio_model, welded
from .robot import Robot
from .robots import find
from .sanity import require_finite, require_sane
from .urdf.parsing import Document, read
from .urdf.shapes import AtRest


def load(
    robot: str | Path,
    *,
    base: str | None = None,
    wheels: Sequence[str] | None = None,
    radius: float | None = None,
    track: float | None = None,
    roller: float | None = None,
    lock: Sequence[str] = (),
    free: Sequence[str] = (),
    arm_tip: str | None = None,
    package_dirs: Sequence[str | Path] = (),
    strict: bool = False,
) -> Robot:
    """Load a robot. What is not said is found in the file, after `NAME.mmnn.toml` beside it (see docs/robots.md).

    Args:
        robot: Name of a bundled robot or of one of example-robot-data, or path of a URDF file.
        base: `differential_drive`, `holonomic` or `fixed`.
        wheels: Joints of the drive wheels; left, right for a differential drive.
        radius: Radius of the drive wheels [m].
        track: Lateral distance of the drive wheels [m].
        roller: Angle of the rollers of a holonomic base [rad], see `Overrides`.
        lock: Joints that stand still: `joint` where it rests, or `joint=position` [rad or m].
        free: Joints that are not locked though heads and fingers are by default; `all` for all.
        arm_tip: Link at the end of the arm; joints that do not lead to it are locked.
        package_dirs: Folders that hold the packages of `package://` meshes.
        strict: Whether impossible inertias and implausible sizes are errors.

    Raises:
        UnknownName: Neither a name nor a path; a joint, link or kind of base that does not exist.
        ConfigError: Something said that does not suit the robot, or a file of overrides that cannot be read.
        RobotError: The file cannot be used, the base is undecided or of a kind not supported; with the line.
    """
    said = Overrides(
        base=base,
        wheels=None if wheels is None else tuple(wheels),
        radius=radius,
        track=track,
        roller=roller,
        lock=tuple(lock),
        free=tuple(free),
        arm_tip=arm_tip,
        package_dirs=tuple(map(str, package_dirs)),
        strict=strict,
    )
    return load_with(robot, said)


def load_with(robot: str | Path, said: Overrides) -> Robot:
    """`load` with all that is said in one; arguments and errors as there."""
    path = find(robot)
    said, notes = said_of(path, said)
    built = build(read(path, said.strict, folders_of(path, said)), said)
    return replace(built, findings=(*built.findings, *notes))


def build(document: Document, said: Overrides | None = None) -> Robot:
    """Robot of an audited URDF.

    Args:
        document: The URDF.
        said: What the user says about it.

    Raises:
        UnknownName: A joint or link that does not exist.
        ConfigError: Something said that does not suit the robot.
        RobotError: The base is undecided or of a kind not supported, or the dynamics are singular.
    """
    said = said or Overrides()
    document, welds = welded(document)
    rest = AtRest(document, folders_of(document.path, said))
    found = find_base(rest, said)
    arm = choose_arm(rest, found.base, said)
    model, printed = pinocchio_model(document, mobile=found.base.kind != "fixed")
    require_sane(document, model)
    notes = (*arm_notes(rest, arm), *weld_notes(rest, welds), *printed_notes(rest, printed))
    findings = (*settled(document.findings, found.findings, said.strict), *notes)
    robot = replace(assemble(document, found.base, arm, model), findings=findings, said=said)
    require_finite(document, robot)
    return robot

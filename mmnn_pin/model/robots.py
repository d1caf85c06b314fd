"""Robots by name: those that come with the package, and those of the `robots` extra (example-robot-data).

The extra is data only, without a Python module, so its folder is looked for here: the environment variable
`EXAMPLE_ROBOT_DATA`, then `cmeel.prefix/share/example-robot-data/robots` beside the installed packages.
"""

from __future__ import annotations

import os
import sys
from pathlib import Path

import mmnn_pin
from mmnn_pin.errors import RobotError, UnknownName

VARIABLE = "EXAMPLE_ROBOT_DATA"
INSIDE = Path("cmeel.prefix/share/example-robot-data/robots")
# Names that users know, where the file is called otherwise or stands in a folder with others.
FILES = {
    "tiago": "tiago_description/robots/tiago.urdf",
    "tiago_no_hand": "tiago_description/robots/tiago_no_hand.urdf",
    "tiago_dual": "tiago_description/robots/tiago_dual.urdf",
    "tiago_pro": "tiago_pro_description/robots/tiago_pro.urdf",
    "pr2": "pr2_description/urdf/pr2.urdf",
    "panda": "panda_description/urdf/panda.urdf",
    "ur3": "ur_description/urdf/ur3_robot.urdf",
    "ur5": "ur_description/urdf/ur5_robot.urdf",
    "ur10": "ur_description/urdf/ur10_robot.urdf",
    "ur3_gripper": "ur_description/urdf/ur3_gripper.urdf",
    "ur5_gripper": "ur_description/urdf/ur5_gripper.urdf",
    "ur3_limited": "ur_description/urdf/ur3_joint_limited_robot.urdf",
    "ur5_limited": "ur_description/urdf/ur5_joint_limited_robot.urdf",
    "ur10_limited": "ur_description/urdf/ur10_joint_limited_robot.urdf",
    "kinova": "kinova_description/robots/kinova.urdf",
    "xarm7": "xarm_description/urdf/xarm7.urdf",
    "z1": "z1_description/urdf/z1.urdf",
    "so100": "so_arm_description/urdf/so100.urdf",
    "so101": "so_arm_description/urdf/so101.urdf",
    "baxter": "baxter_description/urdf/baxter.urdf",
    "talos_left_arm": "talos_data/robots/talos_left_arm.urdf",
    "two_dofs": "asr_twodof_description/urdf/TwoDofs.urdf",
    "double_pendulum": "double_pendulum_description/urdf/double_pendulum.urdf",
    "finger_edu": "finger_edu_description/robots/finger_edu.urdf",
    "allegro_left_hand": "allegro_hand_description/urdf/allegro_left_hand.urdf",
    "allegro_right_hand": "allegro_hand_description/urdf/allegro_right_hand.urdf",
}


def bundled() -> dict[str, Path]:
    """The robots that come with the package: name to URDF file."""
    package = Path(mmnn_pin.__file__).parent
    folder = next((f for f in (package / "urdf", package.parent / "urdf") if f.is_dir()), package / "urdf")
    return {file.stem: file for file in sorted(folder.glob("*.urdf"))}


def robot_data() -> Path | None:
    """Folder of example-robot-data's robots, None where it is not installed."""
    given = os.environ.get(VARIABLE)
    places = [Path(given), Path(given) / "robots", Path(given) / INSIDE] if given else []
    places += [Path(entry or ".") / INSIDE for entry in sys.path]
    return next((place for place in places if place.is_dir() and place.name == "robots"), None)


def extra() -> dict[str, Path]:
    """The robots of example-robot-data that are installed: name to URDF file."""
    folder = robot_data()
    return {} if folder is None else {n: folder / file for n, file in FILES.items() if (folder / file).is_file()}


def package_dirs_of(path: Path) -> tuple[Path, ...]:
    """Folders that `package://example-robot-data/...` points to for a file of that package; none for any other file."""
    folder = robot_data()
    if folder is None or not path.absolute().is_relative_to(folder.absolute()):
        return ()
    return (folder.parent.parent,)


def find(robot: str | Path) -> Path:
    """The URDF file of a name or path.

    Raises:
        UnknownName: Neither a name nor a path.
        RobotError: A name of example-robot-data, which is not installed.
    """
    names = bundled() | extra()
    if isinstance(robot, str) and robot in names:
        return names[robot]
    path = Path(robot)
    if isinstance(robot, str) and not (path.suffix or os.sep in robot or os.path.exists(path)):
        if robot in FILES:
            why = "it is a robot of example-robot-data, which is not installed"
            fix = f"pip install 'mmnn_pin[robots]', or set {VARIABLE} to its folder"
            raise RobotError(f"no robot '{robot}' here", why=why, fix=fix)
        raise UnknownName("robot", robot, names)
    return path

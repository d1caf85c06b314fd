"""What a node feels, as real ROS 2 brings it to a process that knows nothing of this package."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from graph import SETTINGS, drive

from mmnn_pin import Recording


def test_the_wrench_of_the_hand_is_heard_in_its_frame(tmp_path: Path) -> None:
    """The recording has it in the world's axes; a planar arm's hand is turned by heading and joints."""
    felt = SETTINGS.replace("    set:\n", "    set:\n      touch: {model: urdf}\n")
    run = drive(tmp_path, "kilted", 71, "no_plan", seconds=30.0, planner="wrench_node.py", text=felt)
    heard, recording = run.robot["planner"], Recording.open(tmp_path / "run.h5")
    assert len(heard) > 100 and {one[0] for one in heard} == {"arm_tip"}
    told = np.array([one[2:] for one in heard], float)
    turned = recording["pose"][:, 2] + recording["q"].sum(axis=1)
    c, s, world = np.cos(turned), np.sin(turned), recording["external_wrench"]
    own = np.stack((c * world[:, 0] + s * world[:, 1], c * world[:, 1] - s * world[:, 0], world[:, 5]), axis=1)
    apart = np.abs(told[:, None, [0, 1, 5]] - own[None]).max(axis=2)  # every message stands somewhere in the recording
    assert np.abs(own).max() > 1.0 and np.median(apart.min(axis=1)) < 1e-6
    stamps = np.array([one[1] for one in heard])
    assert np.all(np.diff(stamps) > 0.0)

"""What an editor sees: a user's script under mypy's strict rules, with the package as it is installed."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest
from places import ROOT

pytest.importorskip("mypy", reason="pip install mypy: it reads the types")

SCRIPT = '''
from pathlib import Path
from typing import assert_type

import numpy as np
from numpy.typing import NDArray

from mmnn_pin import (
    PD, Hold, LearningLaw, Line, Loop, Neural, Recording, Robot, Sine, Stepper, Timing, TorqueController, Trajectory,
    check, compare, embed, identify, judge, load, load_experiment, run_experiment, sweep,
)
from mmnn_pin.deploy.embed.export import Embedded
from mmnn_pin.deploy.identify.identification import Identification
from mmnn_pin.elementary import sin
from mmnn_pin.lab.experiments.result import Result
from mmnn_pin.lab.psi.judgement import Judgement
from mmnn_pin.lab.study.choice import Level
from mmnn_pin.loop.servo import Command
from mmnn_pin.model.checks.properties import CheckReport
from mmnn_pin.shown import ShownPage, ShownPicture, ShownTable
from mmnn_pin.signals import Measurement, Setpoint, VelocityCommand
from mmnn_pin.torque.controller import Context, ControllerState
from mmnn_pin.torque.learning_law import Sample

Array = NDArray[np.float64]
State = dict[str, Array]

robot = assert_type(load("platform_arm"), Robot)
q = assert_type(robot.random(np.random.default_rng(0)), Array)
for matrix in (robot.mass_matrix(q), robot.coriolis(q, [0.0] * 4), robot.gravity(q), robot.jacobian("arm_1", q)):
    assert_type(matrix, Array)
reference = Trajectory(base=Line(speed=0.3), arm=[Sine(amplitude=0.8, period=4.0), Hold(0.8)])
assert_type(Trajectory.from_csv(robot, Path("motion.csv")), Trajectory)
runs = assert_type(compare(robot, reference, ["pd", PD(), Neural()], duration=0.4), Result)
assert_type(runs["pd"], Recording)
assert_type(runs.table(), ShownTable)
assert_type(runs.plot().save("errors.svg"), Path)
assert_type(runs.replay(fps=30.0), ShownPage)
assert_type(runs.report(with_replay=False), ShownPage)
assert_type(runs["pd"].errors(start=0.1)["x"].rms, float)
found = sweep(robot, reference, "feedback.arm", [1.0, 5.0])
assert_type(found.plot(), ShownPicture)
assert_type(found.errors("pd")[5.0], Level)
assert_type(check(robot), CheckReport)
assert_type(judge(Recording.open("run.h5")), Judgement)
assert_type(identify(robot, "log.csv"), Identification)
loop = Loop(robot, reference, PD(), timing=Timing(duration=0.1))
assert_type(loop.run(), Recording)
assert_type(embed(loop, "folder"), Embedded)
assert_type(run_experiment(load_experiment("track"), "track", out="runs"), Result)
assert_type(sin(0.5), float)  # a compiled function keeps its types


def drive(stepper: Stepper, measurement: Measurement, setpoint: Setpoint) -> Command:
    """A loop of one's own."""
    return stepper.step(0.0, measurement, setpoint)


class Sleeper(TorqueController):
    """No torque."""

    name = "sleeper"

    def init(self, context: Context) -> State:
        return {"zero": np.zeros(context.layout.dof)}

    def step(
        self, time: float, reference: Setpoint, measurement: Measurement, command: VelocityCommand, state: State
    ) -> Array:
        return state["zero"] * np.concatenate((command.z, command.r))


class Nothing(LearningLaw):
    """Learns nothing."""

    def init(self, context: Context) -> ControllerState:
        return ControllerState.of(bias=(context.layout.dof,))

    def estimate(self, sample: Sample, state: ControllerState) -> Array:
        return state["bias"]

    def learn(self, sample: Sample, state: ControllerState) -> None:
        state["bias"] += 0.0 * sample.s


compare(5, reference)  # type: ignore[arg-type]
compare(robot, reference, [PD])  # type: ignore[list-item]
robot.mass_matrix()  # type: ignore[call-arg]
Line(sped=0.3)  # type: ignore[call-arg]
runs.show()  # type: ignore[attr-defined]
runs.report(replay=False)  # type: ignore[call-arg]
'''


def test_a_users_script_and_the_readmes_pass_strict_types(tmp_path: Path) -> None:
    """An `ignore` that nothing needs is an error, too: what is wrong in the script is seen."""
    script = tmp_path / "script.py"
    script.write_text(SCRIPT)
    (tmp_path / "mypy.ini").write_text("[mypy]\nstrict = True\n")  # a user's, not that of this project
    command = [sys.executable, "-m", "mypy", "--cache-dir", str(tmp_path), "script.py"]
    done = subprocess.run(
        [*command, str(ROOT / "examples/quickstart.py")], cwd=tmp_path, capture_output=True, text=True
    )
    assert (done.returncode, done.stdout.splitlines()[-1:]) == (0, [done.stdout.strip()]), done.stdout + done.stderr

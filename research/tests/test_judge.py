"""The judge: its plant against closed forms and scipy's DOP853, its draws, its scores against hand-made examples."""

from __future__ import annotations

import json
import math
import os
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.linalg import eigh

from mmnn_pin import PD, Stepper, StepperSettings, TorqueController, load, load_experiment
from mmnn_pin.errors import InputError
from mmnn_pin.files import locked
from mmnn_pin.loop.suited import SCALED
from mmnn_pin.model.dynamics import Dynamics
from mmnn_pin.model.robot import carrying
from mmnn_pin.model.tree.body import energy_of, parameters
from mmnn_pin.torque.controller import Feedback
from research.judge import __main__ as command
from research.judge import draws
from research.judge.draws import draw_of, plant_of, preregistered
from research.judge.page import publish
from research.judge.plant import AT, World, advance, lugre, motor_rows, new_drives, new_plant, tell
from research.judge.run import errors_of, shipped
from research.judge.score import paired, parts_of_table, ratio_of, score_of

ROW = np.array([2.0, 1.0, 0.1, 0.2, 0.05, 0.3, 0.5, 0.2, 3.0, 4000.0, 5.0, 0.05])


def world(robot: Any, **other: Any) -> World:
    m = robot.dimensions.motors
    none, some = np.zeros((m, len(AT))), np.arange(m)
    none[:, AT.speed] = none[:, AT.fade] = none[:, AT.warm] = 1.0
    usual = {
        "rows": motor_rows(robot), "rotor": 0.1 + 0.05 * some, "spring": 300.0 + 100.0 * some, "damper": np.zeros(m),
        "creep": np.zeros(m), "grip": np.full(m, np.inf), "limit": np.full(m, 50.0), "lag": 0.003, "friction": none,
        "free": np.zeros(0, np.int64), "drag": np.zeros((0, len(AT))),
    }  # fmt: skip
    return World(**(usual | other))


def plant(
    robot: Any, own: World, dt: float = 2.5e-4, q: Any = (0.3, -0.4), loaded: Any = None, carries: Any = None
) -> Any:
    position = robot.neutral_position()
    position[robot.arm_index] = q
    made = new_plant(
        robot, loaded, own, (position, np.zeros(robot.dimensions.motors)), (dt, 10), new_drives(robot, 2000), carries
    )
    return made


def second_lugre(f: Any, v: float, z: float, load: float, time: float) -> tuple[float, float]:
    """Friction and the bristle's rate, written from the papers."""
    coulomb, static, share, static_share, stribeck, viscous, thick, stiff, warm, sigma0, sigma1, fade = f
    cold = np.exp(-time / warm)
    g = (1 + stiff * cold) * (
        coulomb + share * abs(load) + (static + static_share * abs(load)) * np.exp(-(abs(v / stribeck) ** 1.3))
    )
    a = sigma0 * abs(v) / g
    zdot = (v - a * z) / (1 + a / 2000)
    return sigma0 * z + sigma1 * np.exp(-((v / fade) ** 2)) * zdot + viscous * (1 + thick * cold) * v, zdot


@pytest.mark.parametrize("v", [-1.3, -0.02, 0.004, 0.4, 6.0])
def test_friction_comes_to_its_steady_state(v: float) -> None:
    z, dt, time, load = 0.0, max(5e-5, 5e-6 / abs(v)), 1.0, -7.0
    for _ in range(20000):
        z += dt * lugre(ROW, v, z, load, time)[1]
    cold = math.exp(-1.0 / 3.0)
    level = (1 + 0.2 * cold) * (2.0 + 0.7 + (1.0 + 1.4) * math.exp(-((abs(v) / 0.05) ** 1.3)))
    assert lugre(ROW, v, z, load, time)[0] == pytest.approx(math.copysign(level, v) + 0.3 * (1 + 0.5 * cold) * v)


def test_friction_sticks() -> None:
    """Near rest it is a spring: what is below the level comes back."""
    assert lugre(ROW, 0.0, 1e-4, 0.0, 0.0) == (pytest.approx(0.4), 0.0)


def test_plant_is_that_of_a_second_solver() -> None:
    """Arm, gears, friction, lag, a command and a payload, against DOP853 on Pinocchio's matrices."""
    robot = load("two_axis_arm")
    friction = np.array([ROW, 0.5 * ROW])
    friction[:, AT.warm : AT.bristle + 1] = [0.2, 2000.0]
    drag = ROW[None] * 0.1
    drag[0, AT.bristle], drag[0, AT.damping] = 100.0, 0.1
    loaded = carrying(robot, 2.0, at=(0.3, 0.0, 0.0))
    own = world(robot, damper=np.array([1.0, 0.5]), friction=friction, free=np.array([1]), drag=drag)
    made = plant(robot, own, loaded=loaded, carries=np.array([800, 2**60]))
    made.commands[0], made.commands[1], made.arrive[1] = [20.0, -8.0], [-70.0, 5.0], 400
    advance(1200, made)

    def rates(t: float, y: Any) -> Any:
        q, nu, delta, omega, _, u, z, drag_z = np.split(y, np.cumsum([2] * 7))
        carried = Dynamics(loaded if t >= 0.2 else robot)
        carried.refresh(q, nu)
        command = np.array([-50.0, 5.0] if t >= 0.1 else [20.0, -8.0])
        force = own.spring * delta + own.damper * (omega - nu)
        own_friction = [second_lugre(friction[j], omega[j], z[j], force[j], t) for j in range(2)]
        braked, drag_rate = second_lugre(drag[0], nu[1], drag_z[0], 0.0, t)
        resist, zdot = np.array(own_friction).T
        nudot = np.linalg.solve(carried.M, force - [0.0, braked] - carried.h)
        pieces = nu, nudot, omega - nu, (u - force - resist) / own.rotor, omega, (command - u) / 0.003, zdot
        return np.concatenate((*pieces, [drag_rate]))

    y = np.concatenate(([0.3, -0.4], np.zeros(4), np.zeros(2), [0.3, -0.4], np.zeros(4), [0.0]))
    for begin, end in ((0.0, 0.1), (0.1, 0.2), (0.2, 0.3)):
        y = solve_ivp(rates, (begin + 1e-12, end - 1e-12), y, "DOP853", rtol=1e-10, atol=1e-12).y[:, -1]
    assert np.abs(y[2:4]).min() > 0.1
    np.testing.assert_allclose(made.y, y, rtol=1e-5, atol=1e-6)


def test_without_friction_energy_is_kept() -> None:
    robot = load("panda")
    own = world(robot, lag=1.0)
    made = plant(robot, own, q=robot.neutral_position()[robot.arm_index] + 0.2)
    made.state.twist[:] = 0.03

    def energy() -> float:
        s = made.state
        rigid = energy_of(made.body, made.work, s.position, s.nu)
        return float(rigid + 0.5 * own.rotor @ s.omega**2 + 0.5 * own.spring @ s.twist**2)

    before = energy()
    advance(2000, made)
    assert np.abs(made.state.nu).max() > 1.0
    assert energy() == pytest.approx(before, rel=1e-6)


def test_gear_swings_at_the_frequency_of_two_masses() -> None:
    """A small free oscillation in each mode comes back after its period."""
    robot = load("two_axis_arm")
    own = world(robot)
    dynamics = Dynamics(robot)
    position = np.array([0.3, -0.4])
    dynamics.refresh(position, np.zeros(2))
    k, zero = np.diag(own.spring), np.zeros((2, 2))
    values, modes = eigh(np.block([[k, -k], [-k, k]]), np.block([[dynamics.M, zero], [zero, np.diag(own.rotor)]]))
    for value, mode in zip(values[2:], modes.T[2:], strict=True):
        steps = 2000
        made = plant(robot, own, dt=2 * np.pi / math.sqrt(value) / steps)._replace(per_reading=10**9)
        held = np.zeros(2) if not dynamics.h.any() else dynamics.h / own.spring
        made.state.position[:], small = position + 1e-6 * mode[:2], 1e-6 * (mode[2:] - mode[:2])
        made.state.twist[:], made.state.torque[:] = held + small, dynamics.h
        made.commands[0] = dynamics.h
        advance(steps // 2, made)
        np.testing.assert_allclose(made.state.twist - held, -small, atol=1e-9)
        advance(steps, made)
        np.testing.assert_allclose(made.state.twist - held, small, atol=1e-9)


def test_tyre_creeps_and_spins() -> None:
    """Driven steadily it creeps by delta over the relaxation length; it gives no more than its grip."""
    robot = load("platform_arm")
    creep, grip = np.array([20.0, 20.0, 0.0, 0.0]), np.array([4.0, 4.0, np.inf, np.inf])
    own = world(robot, spring=np.full(4, 3000.0), damper=np.full(4, 5.0), creep=creep, grip=grip)
    made = plant(robot, own, q=np.zeros(2))
    made.commands[0] = [3.0, 3.0, 0.0, 0.0]
    advance(8000, made)
    rolled, s = made.work.v[own.rows[0]], made.state
    force = grip[0] * math.tanh(3000.0 * s.twist[0] / grip[0])
    assert (s.omega[0] - rolled) == pytest.approx(20.0 * abs(rolled) * s.twist[0], rel=0.02)
    assert 0.0 < force < 3.0
    made.commands[0] = [30.0, 30.0, 0.0, 0.0]
    before = s.nu[0]
    advance(9000, made)
    radius = robot.base.wheels[0].radius
    gained = (s.nu[0] - before) / 0.25
    mass = 1.0 / np.linalg.inv(made.work.M)[0, 0]
    assert gained < (2 * grip[0] / radius + 2 * 5.0 * (s.omega[0] - made.work.v[own.rows[0]]) / radius) / mass


def test_sensors_tell_the_truth_where_nothing_is_wrong() -> None:
    for name in ("platform_arm", "swerve_arm", "two_axis_arm"):
        robot = load(name)
        made = plant(
            robot, world(robot, spring=np.full(robot.dimensions.motors, 3000.0)), q=np.zeros(robot.dimensions.arm)
        )
        made.commands[0] = 0.5
        d = robot.dimensions
        seen = np.zeros(d.pose + d.base + 2 * d.arm + len(robot.shape_index))
        advance(1200, made._replace(drives=made.drives._replace(between=10**6)))
        tell(made.drives, made.world.rows, seen)
        pose, velocity, q, qdot, shape = np.split(seen, np.cumsum([d.pose, d.base, d.arm, d.arm]))
        s = made.state
        np.testing.assert_allclose(q, s.turned[d.motors - d.arm :], atol=1e-9)
        np.testing.assert_allclose(qdot, s.omega[d.motors - d.arm :], atol=0.05)
        np.testing.assert_allclose(velocity, s.nu[: d.base], atol=0.02)
        np.testing.assert_allclose(pose, s.position[: d.pose], atol=2e-3)
        np.testing.assert_allclose(shape, s.position[robot.shape_index], atol=1e-9)


def test_draws_depend_on_robot_family_and_number_alone() -> None:
    first = draw_of("platform_arm", "dev", 1)
    others = [draw_of("platform_arm", "dev", 0), draw_of("platform_arm", "final", 1), draw_of("kinova", "dev", 1)]
    again = draw_of("platform_arm", "dev", 1)
    assert first.table.tobytes() == again.table.tobytes()
    assert plant_of(first).world.friction.tobytes() == plant_of(again).world.friction.tobytes()
    assert first.true.mass == again.true.mass
    assert len({first.said["delay"], *(other.said["delay"] for other in others)}) == 4


@pytest.mark.parametrize("name", ["feedforward", "learned", "pd_gravity"])
def test_rotors_are_told(name: str) -> None:
    """What a controller knows of the robot are its parameters with the rotors of the arm, without anything true."""
    draw = draw_of("platform_arm", "dev", 1)
    rotors = draw.robot.model.armature[draw.robot.arm_index]
    assert (rotors > 0.0).all() and not np.isin(rotors, draw.said["rotor"]).any()
    asked = load("platform_arm").with_armature(rotors)
    np.testing.assert_array_equal(shipped(name, draw.robot).theta, parameters(asked))


def test_networks_are_scaled_as_track_scales_them() -> None:
    """Gains and robust terms come from one share of the bandwidths, where `track` has the robot's inertias."""
    draw = draw_of("kinova", "dev", 0)
    stepper = Stepper(draw.robot, shipped("two_layer", draw.robot), StepperSettings(period=draw.period))
    made = stepper.setup.controller
    gains, robust = np.array(made.feedback.arm), np.array(made.robust.arm)
    np.testing.assert_allclose(gains / robust, gains[0] / robust[0])
    assert load_experiment("track").robust == SCALED and made.inertia is not None


def test_draws_are_within_what_is_written() -> None:
    said = preregistered()
    assert len(said["robots"]["dev"] + said["robots"]["final_only"]) >= 12
    assert len(said["robots"]["final_only"]) >= 4
    for number in range(4):
        draw = draw_of("platform_arm", "dev", number)
        assert said["control"]["delay"][0] <= draw.said["delay"] <= said["control"]["delay"][1]
        assert 0.8 * draw.robot.mass <= draw.true.mass <= 1.2 * draw.robot.mass
        radii = [a.radius / b.radius for a, b in zip(draw.true.base.wheels, draw.robot.base.wheels, strict=True)]
        assert all(0.98 < ratio < 1.02 and ratio != 1.0 for ratio in radii)
        late = np.diff(plant_of(draw).arrive[1:]) * plant_of(draw).dt
        assert abs(late.mean() - draw.period) < 1e-5
        assert draw.said["jitter"] < 2 * draws.STEP or late.std() > 0.0


def test_half_a_step_gives_the_same_run(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("platform_arm", "kinova"):
        draw = draw_of(name, "dev", 1)
        whole = errors_of(draw, "feedforward")
        monkeypatch.setattr("research.judge.run.plant_of", lambda one: plant_of(one, plant_of(one).dt / 2))
        half = errors_of(draw, "feedforward")
        monkeypatch.undo()
        for part in ("arm", "base"):
            assert whole[part] == half[part] or whole[part] == pytest.approx(half[part], rel=0.01)


class Fails(TorqueController):
    """A controller that raises."""

    name = "fails"

    def step(self, *_: Any) -> Any:
        raise RuntimeError("broken")


def test_what_is_better_by_construction_wins_and_what_fails_is_lost() -> None:
    draw = draw_of("platform_arm", "dev", 1)
    gains = [Feedback(base=30.0 * k, arm=60.0 * k, scaling="inertia") for k in (0.2, 0.8)]
    weak, strong = (errors_of(draw, PD(one)) for one in gains)
    assert ratio_of(strong, weak) < 0.5
    broken = errors_of(draw, Fails())
    assert "broken" in broken["lost"]
    assert errors_of(draw, "nobody")["lost"] == "there is no controller 'nobody'"
    assert score_of([(broken, weak)]).alone == 1


def rows(controller: str, *errors: tuple[float | None, float | None]) -> list[dict[str, Any]]:
    own = {"robot": "r", "plant": "judge", "controller": controller}
    return [
        own | {"draw": k, "arm": arm, "base": base, "lost": "" if arm else "gone"}
        for k, (arm, base) in enumerate(errors)
    ]


def test_scores_of_a_hand_made_example() -> None:
    baseline = rows("feedforward", (1.0, 4.0), (1.0, None), (1.0, 1.0), (None, None), (None, None))
    mine = rows("mine", (1.0, 1.0), (1.5, None), (None, None), (None, None), (1.0, 1.0))
    score = score_of(paired(baseline + mine, "mine"))
    # ratios: 0.5, 1.5, lost, both lost, 0
    assert (score.draws, score.better, score.median, score.worst) == (5, 0.5, 0.5, math.inf)
    assert (score.lost, score.alone) == (2, 1)
    assert (score.arm, score.base) == (1.0, 0.25)  # of 0, 1, 1.5, lost; of 0, 0.25, lost
    assert score_of(paired(baseline, "feedforward")).better == 0.0


def test_parts_of_a_table_divide_the_draws() -> None:
    said = {
        "period": 0.01,
        "delay": 0.004,
        "encoder": "motor",
        "payload": True,
        "coulomb": 0.02,
        "static": 0.1,
        "bits": 18,
    }
    parts = parts_of_table([{"robot": "r", "said": said}, {"robot": "s", "said": said | {"payload": False}}])
    assert [len(own) for own in parts["robots"].values()] == [1, 1]
    for name in preregistered()["disturbances"]:
        assert len(parts["disturbances"][name]) + len(parts["disturbances"][f"not {name}"]) == 2
    assert [len(parts["disturbances"][side]) for side in ("payload", "100 to 200 Hz", "coarse encoder")] == [1, 2, 0]


def test_resumes_with_the_same_rows(tmp_path: Any, capsys: pytest.CaptureFixture[str]) -> None:
    arguments = [
        str(tmp_path),
        "--robots",
        "platform_arm",
        "--draws",
        "1",
        "--controllers",
        "pd_gravity",
        "--workers",
        "1",
    ]
    command.main(arguments)
    file = tmp_path / "results.jsonl"
    whole = file.read_text(encoding="utf-8")
    first, second = whole.splitlines()
    file.write_text(f"{first}\n{second[:40]}", encoding="utf-8")
    command.main(arguments)
    found = [json.loads(line) for line in file.read_text(encoding="utf-8").splitlines()]
    same = [{k: v for k, v in row.items() if k != "seconds"} for row in found]
    assert same == [{k: v for k, v in json.loads(line).items() if k != "seconds"} for line in (first, second)]
    command.main(arguments)
    assert len(file.read_text(encoding="utf-8").splitlines()) == 2
    assert "feedforward" in capsys.readouterr().out


def test_second_plant_errs_alike_where_both_roll() -> None:
    """Two independent rigid bodies, contacts and frictions, one draw: feedforward's errors are of one size."""
    pytest.importorskip("mujoco")
    draw = draw_of("platform_arm", "dev", 1)
    one, other = (errors_of(draw, "feedforward", name) for name in ("judge", "contact"))
    assert other["lost"] == ""
    for part in ("arm", "base"):
        assert 0.6 < one[part] / other[part] < 1.6


def test_page_has_the_scores_between_its_markers(tmp_path: Any) -> None:
    said = dict.fromkeys(command.SAID, 0.01) | {"encoder": "motor", "payload": True, "bits": 18}
    made = rows("feedforward", (1.0, 4.0), (1.0, 1.0)) + rows("learned", (1.0, 1.0), (None, None))
    made += [row | {"plant": "contact"} for row in made[:2]]
    made = [row | {"said": said, "seconds": 1800.0} for row in made]
    page = tmp_path / "judge.md"
    text = "".join(f"{name}\n<!-- judge: {name} -->\nold\n<!-- /judge -->\n" for name in ("facts", "all", "target"))
    page.write_text(f"{text}end\n", encoding="utf-8")
    for _ in range(2):
        publish(made, page)
        found = page.read_text(encoding="utf-8")
        assert "old" not in found and found.endswith("end\n")
        assert "| `learned` | 50 | 0.500 | lost | lost | 1 | 1 | 1.00 | 0.250 | 2 |" in found
        assert "| median ratio | 0.5 or less | 0.500 |" in found
        assert "6 runs of 2 controllers on 4 draws of 1 robots, 3.0 hours" in found
    table = page.with_suffix(".csv").read_text(encoding="utf-8").splitlines()
    assert len(table) == 7 and table[0].startswith("robot,draw,plant,controller,arm [rad],base [m],ratio,lost,period")


def test_final_robots_are_refused_for_tuning(tmp_path: Any) -> None:
    with pytest.raises(SystemExit):
        command.main([str(tmp_path), "--robots", "z1"])


ROOT = Path(__file__).parents[2]
SLOW = """
import sys, time
from multiprocessing import active_children
from pathlib import Path
from threading import Timer
from research.judge import __main__ as judge
def rows_of(wanted):
    time.sleep(600)
rows_of.__module__, judge.rows_of = judge.__name__, rows_of
Timer(0.5, lambda: print(*[child.pid for child in active_children()], flush=True)).start()
judge.run_missing([("a", "dev", 0, "judge", ("pd",))] * 2, Path(sys.argv[1]), 2)
"""


@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGTERM])
def test_a_judge_that_is_killed_takes_its_processes_along(number: int, tmp_path: Path) -> None:
    command = [sys.executable, "-c", SLOW, str(tmp_path / "rows")]
    process = subprocess.Popen(command, cwd=ROOT, stdout=subprocess.PIPE, text=True)
    assert process.stdout is not None
    workers = [Path(f"/proc/{word}") for word in process.stdout.readline().split()]
    assert len(workers) == 2 and all(place.exists() for place in workers)
    process.send_signal(number)
    process.communicate(timeout=20)
    until = time.monotonic() + 20
    while any(place.exists() for place in workers) and time.monotonic() < until:
        time.sleep(0.05)
    assert not [os.kill(int(place.name), signal.SIGKILL) for place in workers if place.exists()]


def test_two_judges_do_not_write_one_file(tmp_path: Path) -> None:
    with locked(tmp_path / "results.jsonl", "rows"), pytest.raises(InputError, match=f"process {os.getpid()} on"):
        command.main([str(tmp_path), "--robots", "platform_arm", "--controllers", "pid", "--draws", "1"])

"""Learning on recordings of robots: how they are read, that nothing of the judged motion leaks, what is found there."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from robots import arm

from mmnn_pin import load
from mmnn_pin.deploy.identify.log import Log
from mmnn_pin.model.robot import Robot
from mmnn_pin.signals import Layout
from research.studies.real_data import learned, sources
from research.studies.real_data.__main__ import errors, main, predicted
from research.studies.real_data.motion import Stretch
from research.studies.real_data.sources import Case

PERIOD, DURATION = 0.01, 20.0
FREQUENCIES = np.array([[0.23, 0.41], [0.17, 0.31]])  # of the motion to learn on, of the other, by joint [Hz]
BY_LOAD, DRY = 0.15, 0.5  # friction over the torque through the gear, and without any [N m]


@pytest.fixture(scope="module")
def robot(tmp_path_factory: pytest.TempPathFactory) -> Robot:
    file = tmp_path_factory.mktemp("robot") / "arm.urdf"
    file.write_text(f'<robot name="arm"><link name="base"/>{arm(2, 3, 0.0, sliding=False)}</robot>')
    return load(file)


def log_of(robot: Robot, motion: int, by_load: float) -> Log:
    """A motion of the arm of the URDF without its friction, by Pinocchio, and friction that grows with the torque."""
    time, w = np.arange(0.0, DURATION, PERIOD), 2 * np.pi * FREQUENCIES[motion]
    q, v, a = np.sin(np.outer(time, w)), w * np.cos(np.outer(time, w)), -(w**2) * np.sin(np.outer(time, w))
    model, data = robot.model.copy(), robot.model.createData()
    tau = []
    for position, velocity, acceleration in zip(q, v, a, strict=True):
        full = pin.neutral(model)
        for i, name in enumerate(robot.joint_names):
            at = model.joints[model.getJointId(name)].idx_q
            full[at : at + 2] = (np.cos(position[i]), np.sin(position[i]))  # of a joint without ends
        tau.append(pin.rnea(model, data, full, velocity, acceleration))
    tau = np.array(tau)
    tau += (DRY + by_load * np.abs(tau)) * np.tanh(v / 0.01)
    names = robot.joint_names, robot.actuator_names
    return Log.of(time, dict(zip(names[0], q.T, strict=True)), dict(zip(names[1], tau.T, strict=True)), name="made")


def case_of(robot: Robot, by_load: float) -> Case:
    return Case("arm", "other sines", robot, [log_of(robot, 0, by_load)], [log_of(robot, 1, by_load)])


@pytest.fixture(scope="module")
def outcome(robot: Robot, tmp_path_factory: pytest.TempPathFactory):
    return predicted(case_of(robot, BY_LOAD), tmp_path_factory.mktemp("case"))


# -- reading -----------------------------------------------------------------------------------------------------------


def test_a_table_without_heads_is_read_and_its_broken_line_left_out(tmp_path: Path) -> None:
    class Named:
        joint_names = tuple("abcdef")

    table = np.arange(4 * 31, dtype=float).reshape(4, 31)
    lines = [",".join(f"{x:.4f}" for x in row) for row in table]
    (file := tmp_path / "log.csv").write_text("\n".join([*lines[:2], lines[2][:40], lines[3]]) + "\n")
    log = sources.columns_of_ur10e(file, Named())  # type: ignore[arg-type]
    kept = table[[0, 1, 3]]
    assert (log.time == kept[:, 0]).all()
    for i, name in enumerate("abcdef"):
        assert (log.position[name] == kept[:, 1 + i]).all()
        assert (log.velocity[name] == kept[:, 7 + i]).all()
        assert (log.effort[name] == kept[:, 13 + i]).all()


def test_recordings_that_are_not_there_are_named_with_how_to_get_them(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    main([str(tmp_path)])
    said = capsys.readouterr().out
    assert said.count("git clone") == len(sources.SOURCES) == 3
    assert all(source.address in said for source in sources.SOURCES)


def test_the_first_half_of_a_periodic_motion_is_learned_on_and_no_later_period(tmp_path: Path) -> None:
    folder = tmp_path / "matlab/data/Exciting_Traj/Trajectory_1/rbt_log"
    folder.mkdir(parents=True)
    time = np.arange(0.0, 21.0, 0.1)
    np.savetxt(folder / "exciting_traj_time.txt", time)
    for k, name in enumerate(("positions", "torques")):
        np.savetxt(folder / f"exciting_traj_{name}.txt", (k + np.outer(time, np.arange(1, 8))).ravel())
    (case,) = sources.gaz(tmp_path)
    (first,), (second,) = case.learned, case.judged
    assert (first.time == time[time < 6.0]).all() and (second.time == time[(time >= 6.0) & (time < 12.0)]).all()
    last = case.robot.joint_names[-1]
    assert second.position[last] == pytest.approx(7 * second.time)
    assert second.effort[case.robot.actuator_names[0]] == pytest.approx(1 + second.time)


def test_halves_share_no_row(robot: Robot) -> None:
    log = log_of(robot, 0, 0.0)
    there, back = sources.halves("arm", robot, log)
    assert np.concatenate((there.learned[0].time, there.judged[0].time)) == pytest.approx(log.time)
    assert (back.learned[0].time == there.judged[0].time).all() and (back.judged[0].time == there.learned[0].time).all()


# -- learning ----------------------------------------------------------------------------------------------------------


def test_the_weight_of_a_ridge_is_the_best_on_blocks_left_out() -> None:
    rng = np.random.default_rng(1)
    Phi, block = rng.standard_normal((60, 12)) * 10.0 ** rng.uniform(-2, 2, 12), np.repeat(np.arange(4), 15)
    y = Phi[:, 0] / np.abs(Phi[:, 0]).max() + rng.standard_normal(60)
    found, scale = learned.ridge(Phi, y, block), np.sqrt((Phi**2).mean(axis=0))

    def weights(use, ridge: float):
        A = np.vstack((Phi[use] / scale, np.sqrt(ridge * use.sum()) * np.eye(12)))
        return np.linalg.lstsq(A, np.concatenate((y[use], np.zeros(12))), rcond=None)[0] / scale

    left = [
        sum(((y - Phi @ weights(block != b, ridge))[block == b] ** 2).sum() for b in range(4))
        for ridge in learned.RIDGES
    ]
    best = int(np.argmin(left))
    assert 0 < best < len(left) - 1
    assert found.left == pytest.approx(left[best], rel=1e-6)
    assert found.w == pytest.approx(weights(np.ones(60, bool), learned.RIDGES[best]), rel=1e-5, abs=1e-9)


def test_a_row_has_the_mean_torque_of_the_period_that_it_begins(robot: Robot) -> None:
    layout, x = Layout.of(robot.dimensions), np.arange(12.0).reshape(6, 2)
    rows = Stretch(PERIOD * np.arange(6), x, x + 1, x + 2, x**2).rows(layout, 5.0)
    assert rows[:-1, layout.where("torque")] == pytest.approx((x[1:] ** 2 + x[:-1] ** 2) / 2)
    assert rows[:, layout.where("time")][:, 0] == pytest.approx(5.0 + PERIOD * np.arange(6))
    for name, value in (("q", x), ("qdot", x + 1), ("nu_ref", x + 1), ("nudot_ref", x + 2)):
        assert (rows[:, layout.where(name)] == value).all()


def test_friction_that_grows_with_the_torque_is_found_and_holds_on_the_other_motion(outcome) -> None:
    judged, said, chosen = outcome
    all_joints = {name: each[-1] for name, each in errors(judged, said).items()}
    assert all_joints["identified"] > 0.02
    assert all_joints["identified + friction by load"] < 0.4 * all_joints["identified"]
    assert all_joints["identified + chosen"] < 0.5 * all_joints["identified"]
    assert set(chosen) <= {"friction by load", "friction by load and place"}


def test_errors_are_root_mean_squares_where_joints_move(outcome) -> None:
    judged, said, _ = outcome
    rows, name = judged.stacked, "urdf"
    error, size = ((part * rows.use) ** 2 for part in (rows.y - said[name], rows.y))
    wanted = np.sqrt(np.append(error.sum(axis=0) / size.sum(axis=0), error.sum() / size.sum()))
    assert errors(judged, said)[name] == pytest.approx(wanted)


def test_no_prediction_looks_at_the_torques_that_it_is_judged_by(robot: Robot, outcome, tmp_path: Path) -> None:
    case = case_of(robot, BY_LOAD)
    (log,) = case.judged
    other = replace(log, effort={name: 3.0 - 2.0 * values for name, values in log.effort.items()})
    judged, said, chosen = predicted(replace(case, judged=[other]), tmp_path)
    assert not np.allclose(judged.stacked.y, outcome[0].stacked.y)
    assert chosen == outcome[2] and said.keys() == outcome[1].keys()
    for name, each in said.items():
        assert each == pytest.approx(outcome[1][name], rel=1e-9, abs=1e-9), name


def test_a_learner_of_equations_that_hold_knows_the_other_motion(robot: Robot, tmp_path: Path) -> None:
    """Rigid bodies and constant dry friction: what `kalman_regressor` can say; it also keeps what it begins with."""
    judged, said, _ = predicted(case_of(robot, 0.0), tmp_path)
    found = {name: each[-1] for name, each in errors(judged, said).items()}
    assert found["kalman_regressor, patient"] < 0.02
    assert found["kalman_regressor from identified, patient"] < 0.02


def test_a_network_that_sees_errors_alone_ends_where_its_feedback_is_not_needed(robot: Robot) -> None:
    found = type("Found", (), {"robot": robot})()
    rival = learned.Rival("two_layer", "two_layer")
    learner = learned.new_learner(rival, found, PERIOD)
    q, torque = np.array([0.3, -0.4]), np.array([4.0, -2.0])
    still = Stretch(PERIOD * np.arange(3000), *(np.tile(x, (3000, 1)) for x in (q, 0 * q, 0 * q, torque)))
    before, after = (
        learned.along(learner, state)(still)[-1] for state in (learner.start, learned.taught(learner, [still], rival))
    )
    assert np.abs(before - torque).max() > 1.0
    assert after == pytest.approx(torque, abs=0.1)


def test_gains_are_the_motors_limits_at_one_radian_per_second(robot: Robot) -> None:
    assert learned.gains(robot) == pytest.approx([99.0, 99.0])

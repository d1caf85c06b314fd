"""The contest: numbers of its rows against plain NumPy, the same for any number of workers, stopped and gone on."""

from __future__ import annotations

import csv
import json
import math
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import msgspec
import numpy as np
import pytest

from mmnn_pin.cli import main
from mmnn_pin.errors import ConfigError, RecordingError, UnknownName
from mmnn_pin.lab.experiments.cases import chosen_cases
from mmnn_pin.lab.experiments.config import load_experiment, recorded_experiment
from mmnn_pin.loop.batch import BatchRun
from mmnn_pin.loop.loop import Loop
from mmnn_pin.model.regressor import Regressor
from mmnn_pin.recording.recording import Outcome, Recording
from mmnn_pin.reference import Eight
from mmnn_pin.signals import Layout
from research.contest import contest as running
from research.contest.contest import Store, run_contest
from research.contest.settings import PLAIN, Contest, Targets, load_contest
from research.contest.show import cell, relative_curves, render
from research.contest.standing import everywhere, learning_time, targets
from research.contest.task import frozen, tasks_of
from research.contest.trial import (
    Stopped,
    Tracking,
    Trial,
    TrialResult,
    arm_of,
    base_of,
    psi_hat_along,
    run_trial,
    state_after,
    train,
)

QUICK = [
    *("time.duration=1.6", "time.control_period=0.0025", "time.plant_step=0.00125", "windows=[[0, 0.5], [0.8, 1.6]]"),
    *("contest.seeds=2", "weights_interval=0.5", "contest.beside=['pd','two_layer','computed_torque']"),
    *(f"held_out.{name}.duration=0.9" for name in ("similar", "tight", "circle")),
]
SET = [word for text in QUICK for word in ("--set", text)]
NAMES = ("pd", "two_layer", "adaptive", "computed_torque")
VELOCITY = ("pd", "pd_gravity", "two_layer", "adaptive", "computed_torque")


def quick(cases=("eight",), more=(), controllers=NAMES):
    experiment = chosen_cases(load_contest("contest", [*QUICK, *more]), cases)
    return msgspec.structs.replace(experiment, controllers=controllers)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("contest")


@pytest.fixture(scope="module")
def standing(folder):
    return run_contest(quick(), "contest", out=folder, workers=2)


def plain(rows):
    return [msgspec.to_builtins(row) for row in rows]


# -- the numbers of a row --


@pytest.mark.parametrize("name", ["two_layer", "adaptive"])
def test_a_row_says_what_its_recording_shows(standing, folder, name):
    recording, row = Recording.open(folder / "eight" / f"{name}.h5"), standing.of("eight", name)[0]
    late, h = recording.time > 0.799, 0.0025
    x, y, phi = recording["true_pose_error"][late].T
    arm = recording["true_e"][late]
    assert row.rms["x"] == pytest.approx(np.sqrt(np.mean(x**2))) and row.peak["y"] == pytest.approx(abs(y).max())
    assert row.rms["phi"] == pytest.approx(np.linalg.norm(phi) / np.sqrt(len(phi)))
    assert base_of(row.rms) == pytest.approx(np.sqrt(np.mean(x**2 + y**2)))
    assert arm_of(row.rms) == pytest.approx(np.sqrt(np.mean(arm**2)))
    assert row.peak_of_all["x"] == pytest.approx(abs(recording["true_pose_error"][:, 0]).max())
    motors, limits = recording["motor_torque"], np.array([60.0, 60.0, 200.0, 200.0])
    assert row.effort == pytest.approx(np.sum(motors**2) * h)
    assert row.torque == pytest.approx((abs(motors) / limits).max())
    assert row.kick == pytest.approx((abs(motors[:40]) / limits).max())  # 0.1 s at 2.5 ms
    psi, error = recording["psi"][late], (recording["psi"] - recording["psi_hat"])[late]
    fvu = np.mean(error**2, axis=0) / np.var(psi, axis=0)
    assert row.online_fvu == pytest.approx(fvu.mean()) and row.online_worst == pytest.approx(fvu.max())
    errors = np.hstack([recording["true_pose_error"], recording["true_e"]])
    assert len(row.curve) == 3  # of 0.5 s in 1.6 s
    np.testing.assert_allclose(row.curve[1], np.mean(errors[200:400] ** 2, axis=0))


def test_the_recording_can_be_proved_and_names_its_experiment(folder):
    recording = Recording.open(folder / "eight" / "two_layer.h5")
    experiment = recorded_experiment(recording)
    assert experiment is not None and not experiment.cases and experiment.time.duration == 1.6
    assert recording.meta["experiment"] == "contest/eight"


def test_frozen_weights_say_what_the_regressor_times_the_estimate_says(standing):
    """The adaptive controller's estimate out of its memory, times Pinocchio's regressor, row by row."""
    (task,) = tasks_of(quick(), NAMES)
    controller, row = task.controller("adaptive"), standing.of("eight", "adaptive")[1]
    run = task.training(controller, row.seed).run()
    state = state_after(task, controller, row.seed, BatchRun(run.outcome, {}, run.final))
    regressor, layout, found = Regressor.of(task.robot), Layout.of(task.robot.dimensions), []
    for name, rows in task.rows.items():
        loop = task.held_out_loop(controller, row.seed, name, False)
        theta = state["theta"]
        at = [np.ascontiguousarray(rows[:, layout.where(k)]) for k in ("position", "nu", "nu_ref", "nudot_ref")]
        at[0][:, 5:] = 0.0  # the turn of the wheels, which is not measured
        wanted = np.array([regressor.matrix(*line) @ theta for line in zip(*at, strict=True)])
        np.testing.assert_allclose(psi_hat_along(loop, layout, state.snapshot(), rows), wanted, rtol=1e-7, atol=1e-7)
        late = rows[:, layout.where("time")][:, 0] > 0.499
        psi = rows[late][:, layout.where("psi")]
        found.append((np.mean((psi - wanted[late]) ** 2, axis=0) / psi.var(axis=0)).max())
        assert row.frozen_on[name] == pytest.approx(found[-1], rel=1e-6)
    assert row.frozen_worst == pytest.approx(max(found), rel=1e-6)


def test_what_learns_nothing_is_frozen_as_it_is(standing):
    (task,) = tasks_of(quick(), NAMES)
    for name in ("pd", "computed_torque"):
        controller = task.controller(name)
        assert frozen(controller) is controller
    assert frozen(task.controller("two_layer")).learning is False
    for row in standing.of("eight", "computed_torque"):
        assert row.frozen_fvu < 1e-20  # Psi itself
    psi = task.rows["tight"][200:, Layout.of(task.robot.dimensions).where("psi")]  # from 0.5 s on
    nothing = ((psi**2).mean(axis=0) / psi.var(axis=0)).max()
    assert standing.of("eight", "pd")[0].frozen_on["tight"] == pytest.approx(nothing)


def test_held_out_runs_are_those_of_the_final_weights(standing):
    """Run again from the memory in the recording, through the loop itself."""
    (task,) = tasks_of(quick(), NAMES)
    controller, row = task.controller("two_layer"), standing.of("eight", "two_layer")[0]
    for how in ("frozen", "learning"):
        loop = task.held_out_loop(controller, row.seed, "circle", how == "learning")
        state = controller.init(loop.context())
        state.values[:] = Recording.open(standing.folder / "eight" / "two_layer.h5").final["controller_state"]
        run = loop.run(state=state)
        late = run.time > 0.499
        found = np.sqrt(np.mean(run["true_e"][late] ** 2, axis=0))
        tracked = row.held_out["circle"][how]
        assert tracked.outcome == "completed"
        assert [tracked.rms["arm_1_joint"], tracked.rms["arm_2_joint"]] == pytest.approx(found.tolist())
        moved = not np.array_equal(run.final["controller_state"], state.values)
        assert moved == (how == "learning") or how == "frozen"


def test_the_held_out_robot_carries_nothing_once_it_was_put_down():
    more = ['disturbances=[{type="payload", mass=3.0, start=0.4, end=0.8}]']
    (task,) = tasks_of(quick(more=more), NAMES)
    assert task.at_the_end is task.robot and task.since == 0.8


def test_the_held_out_robot_carries_what_was_picked_up():
    more = ['disturbances=[{type="payload", mass=3.0, start=0.8, at=[0.4, 0.0, 0.04]}]']
    (task,) = tasks_of(quick(more=more), NAMES)
    gained = task.at_the_end.model.inertias[-1].mass + task.at_the_end.model.inertias[4].mass
    assert sum(i.mass for i in task.at_the_end.model.inertias) == pytest.approx(
        sum(i.mass for i in task.robot.model.inertias) + 3.0
    )
    assert gained > 3.0 and task.since == 0.8
    loop = task.held_out_loop(task.controller("computed_torque"), 1, "circle", True)
    assert loop.robot.model.inertias != task.robot.model.inertias and not loop.disturbances
    assert loop.nominal is not None  # the oracle is not told


# -- learning time --


def row(**changes):
    one = TrialResult(
        task="t", controller="c", seed=1, outcome="completed", ended=4.0, rms={"x": 2.0, "a": 0.5}, peak={}, curve=[],
        peak_of_all={}, effort=0.0, torque=0.0, kick=0.0, online_fvu=None, online_worst=None, frozen_fvu=None,
        frozen_worst=None, frozen_on={}, held_out={}, findings=(), since=0.0,
    )  # fmt: skip
    return msgspec.structs.replace(one, **changes)


@pytest.mark.parametrize(
    ("shares", "since", "wanted"),
    [
        ([1.0, 0.5, 0.19, 0.1], 0.0, 1.0),
        ([0.1, 0.1, 0.3, 0.1], 0.0, 1.5),  # once good does not count
        ([0.1, 0.1, 0.1, 0.1], 0.0, 0.0),
        ([0.1, 0.1, 0.1, 0.21], 0.0, math.inf),
        ([1.0, 1.0, 1.0, 0.1], 1.0, 0.5),  # from the last change on
        ([1.0, 1.0, 0.1, 0.1], 1.0, 0.0),
    ],
)
def test_learned_is_when_the_error_stays_below_a_share_of_the_rivals(shares, since, wanted):
    """Shares of their error on both axes; then all of it on one axis, which has the same mean."""
    both = [[(2.0 * s) ** 2, (0.5 * s) ** 2] for s in shares]
    one = [[2 * (2.0 * s) ** 2, 0.0] for s in shares]
    for curve in (both, one):
        assert learning_time(row(curve=curve, since=since), [2.0, 0.5], 0.5, 0.2) == wanted


def test_a_lost_run_never_learns_and_without_a_scale_nobody_does():
    curve = [[0.0, 0.0]] * 4
    assert learning_time(row(curve=curve, outcome="diverged"), [2.0, 0.5], 0.5, 0.2) == math.inf
    for rivals in ([], [math.nan, 0.5], [0.0, 0.5]):
        assert math.isnan(learning_time(row(curve=curve), rivals, 0.5, 0.2))


def test_the_rivals_are_the_best_plain_controllers_that_ran_to_their_end(standing):
    """Axis by axis, with the same seed; a learner is none, PD alone is one where nothing else ran."""
    others = {
        "pd": [row(), row(seed=2)],
        "pd_gravity": [row(rms={"x": 3.0, "a": 0.3}), row(seed=2, rms={"x": None, "a": None}, outcome="diverged")],
        "pid": [row(rms={"x": 1.0, "a": 4.0})],
        "adaptive": [row(rms={"x": 0.01, "a": 0.01})],
    }
    trials = {("t", name): Trial("", None, rows) for name, rows in others.items()}
    mixed = replace(standing, trials=trials)
    assert mixed.plain_errors("t", 1) == [1.0, 0.3]
    assert mixed.plain_errors("t", 2) == [2.0, 0.5] and mixed.plain_errors("t", 3) == []
    half = [[0.25, 0.0225], [0.0, 0.0]]  # of the rivals' error, then none
    trials["t", "late"] = Trial("", None, [row(curve=half), row(curve=half, outcome="diverged")])
    mixed = replace(standing, trials=trials)
    assert relative_curves(mixed, "t", "late") == [pytest.approx([0.5, 0.0])]
    assert mixed.learning_times("t", "late") == [0.5, math.inf]


def test_the_contest_runs_them_beside_any_controller():
    assert set(PLAIN) <= set(load_contest().contest.beside) and set(PLAIN) <= set(Contest().beside)


# -- the same rows, however they are made --


def test_workers_change_no_bit(standing):
    alone = run_contest(quick(controllers=("two_layer", "adaptive")), "contest", workers=1)
    for name in ("two_layer", "adaptive", "pd", "computed_torque"):
        assert plain(alone.of("eight", name)) == plain(standing.of("eight", name))
    assert alone.controllers == ("two_layer", "adaptive", "pd", "computed_torque")  # those that all are measured by


def test_it_goes_on_where_it_was_stopped(standing, tmp_path, monkeypatch):
    done = []

    def stops(task, name, *rest):
        if len(done) == 2:
            raise Stopped
        done.append(name)
        return run_trial(task, name, *rest)

    monkeypatch.setattr(running, "run_trial", stops)
    first = run_contest(quick(), "contest", out=tmp_path)
    assert first.interrupted and not first.completed and [name for _, name in first.trials] == ["pd", "two_layer"]
    kept = json.loads((tmp_path / "rows.json").read_text())
    assert list(kept) == ["eight/pd", "eight/two_layer"]
    assert "two_layer" in render(first) and first.to_dict()["comparison"]["interrupted"]
    done[:] = [None, None, None]
    monkeypatch.setattr(
        running, "run_trial", lambda task, name, *rest: (done.append(name), run_trial(task, name, *rest))[1]
    )
    second = run_contest(quick(), "contest", out=tmp_path)
    assert done[3:] == ["adaptive", "computed_torque"] and second.completed
    assert plain(second.results) == plain(standing.results)


def test_ctrl_c_ahead_of_the_first_run_is_no_error_of_a_trajectory(monkeypatch):
    monkeypatch.setattr(Loop, "run", lambda loop: SimpleNamespace(outcome=Outcome("interrupted", 0.0)))
    with pytest.raises(KeyboardInterrupt):
        _ = tasks_of(quick(), NAMES)[0].rows


def test_ctrl_c_within_a_batch_drops_what_was_under_way(monkeypatch):
    (task,) = tasks_of(quick(), NAMES)

    def press(fraction):
        raise KeyboardInterrupt

    with pytest.raises((Stopped, KeyboardInterrupt)):
        train(task, task.controller("pd"), None, 1, press)


def test_rows_of_other_settings_are_not_mixed(standing, folder):
    kept = (folder / "rows.json").read_bytes()
    with pytest.raises(RecordingError, match="pd on eight are of other settings"):
        run_contest(quick(more=["feedback.arm=29.0"]), "contest", out=folder)
    assert (folder / "rows.json").read_bytes() == kept
    again = run_contest(quick(), "another name, title and targets do not count", out=folder)
    assert plain(again.results) == plain(standing.results)


def test_a_broken_file_of_rows_is_refused(tmp_path):
    (tmp_path / "rows.json").write_text('{"eight/pd": {"rows": 3}}')
    with pytest.raises(RecordingError, match="not a file of rows"):
        Store.opened(tmp_path)


def test_the_table_holds_the_same_numbers(standing, folder):
    with (folder / "rows.csv").open() as file:
        lines = list(csv.DictReader(file))
    assert len(lines) == len(standing.results)
    for line, one in zip(lines, standing.results, strict=True):
        assert (line["controller"], int(line["seed"])) == (one.controller, one.seed)
        assert float(line["rms_base"]) == base_of(one.rms) and float(line["frozen_on.tight"]) == one.frozen_on["tight"]
        assert float(line["held_out.circle.frozen.rms.x"]) == one.held_out["circle"]["frozen"].rms["x"]


# -- what is asked of the motors --


def test_the_eight_is_at_the_limit_of_the_wheels(standing):
    """Wheels turn at |v -+ w track/2| / radius; Tables 4.1 of the thesis, 30 rad/s of the URDF."""
    v, w = Eight(3.0, 1.5, 6.25).sample(np.linspace(0, 6.25, 20001)).velocity.T
    fastest = max(np.abs(v + sign * 0.171 * w).max() for sign in (-1, 1)) / 0.075
    (task,) = tasks_of(chosen_cases(load_contest(), ["eight"]), ("pd",))
    found = running.demand(task)
    assert found.motors[:2] == ("wheel_left_joint", "wheel_right_joint")
    assert found.speed[:2] == pytest.approx([fastest / 30.0] * 2, rel=1e-4)
    assert 0.95 < fastest / 30.0 < 0.951  # 5 % are left
    assert 6.25 * fastest / 30.0 == pytest.approx(5.94, abs=0.005)  # the lap at the limit, as eight.toml says
    assert found.speed[2] == pytest.approx(np.pi / 4 * 2 * np.pi / 3.1 / 12.0, rel=1e-4)
    quiet = running.demand(tasks_of(quick(), NAMES)[0])
    recording = Recording.open(standing.folder / "eight" / "computed_torque.h5")
    asked = abs(recording["motor_torque"][recording.time > 1.0]).max(axis=0) / np.array([60, 60, 200, 200])
    assert max(quiet.torque) == pytest.approx(asked.max(), rel=0.1)


# -- targets --


def rows_of(table):
    """Rows per task and controller out of a few numbers."""

    def of(task, name):
        spec = table.get((task, name))
        if spec is None:
            return []
        fvu, learning, fixed, findings, kick = spec
        ways = {"learning": Tracking("completed", {"x": learning, "a": 2 * learning})}
        if fixed is not None:
            ways["frozen"] = Tracking("completed" if math.isfinite(fixed) else "diverged", {"x": fixed, "a": fixed})
            if not math.isfinite(fixed):
                ways["frozen"] = Tracking("diverged", {"x": None, "a": None})
        return [
            row(
                frozen_fvu=fvu / 10,
                frozen_worst=fvu,
                held_out={"h": ways},
                findings=findings,
                kick=kick,
                seed=seed,
                controller=name,
                rms={"x": learning, "a": learning},
            )
            for seed in (1, 2, 3)
        ]

    return of


ASKED = Contest(
    knows={"kinematics": ("knows",), "form": ("form",), "nothing": ("two_layer",)},
    targets=Targets("eight", "rich", "poor", {"kinematics": 0.001, "form": 0.01, "nothing": 0.1}),
)


def judged(table):
    found = targets(ASKED, ("knows", "form", "two_layer"), ("eight", "rich", "poor"), rows_of(table))
    return {target.about: target for target in found}


def about(found, *words):
    (one,) = [target for text, target in found.items() if all(word in text for word in words)]
    return one


def test_targets_are_met_or_not():
    table = {
        ("eight", "knows"): (0.0009, 0.01, 0.02, (), 0.5),
        ("eight", "form"): (0.02, 0.05, math.inf, (), 0.4),
        ("eight", "two_layer"): (1.2, 0.04, 0.07, (), 0.3),
        ("eight", "computed_torque"): (0.0, 0.008, 0.01, (), 0.9),
        ("rich", "two_layer"): (0.05, 0.04, 0.07, (), 0.3),
        ("poor", "pd"): (2.0, 0.1, 0.1, (), 0.2),
        ("poor", "computed_torque"): (0.0, 0.1, 0.1, (), 0.25),
        ("poor", "knows"): (2.0, 0.01, 0.02, ("c: not excited: 30 % of what random motion excites",), 0.5),
        ("poor", "two_layer"): (2.0, 0.01, math.inf, (), 1.2),
    }
    found = judged(table)
    assert about(found, "frozen FVU after 'eight'", "kinematics").met
    form = about(found, "frozen FVU after 'eight'", "form")
    assert not form.met and form.reached == 0.02 and form.by == "form"
    assert not about(found, "frozen FVU after 'eight'", "nothing").met  # its value after an ordinary motion
    assert about(found, "frozen FVU after 'rich'", "nothing").met
    learning, fixed = (about(found, "two_layer's", "tuned", how) for how in ("learning", "frozen"))
    assert not any("printed" in text for text in found)
    assert learning.met and learning.reached == pytest.approx(4.0) and learning.by == "knows"
    assert fixed.met and fixed.reached == pytest.approx(3.5) and fixed.by == "knows"  # a lost run does not win
    near, far = about(found, "computed_torque", "learning"), about(found, "computed_torque", "frozen")
    assert near.met and near.reached == pytest.approx(0.01 / 0.008)
    assert not far.met and far.reached == pytest.approx(0.02 / 0.008)
    going, fixed = (about(found, "after 'poor'", "over PD's", how) for how in ("learning", "frozen"))
    assert going.met and going.reached == pytest.approx(0.1)
    assert not fixed.met and fixed.reached == math.inf and fixed.by == "two_layer"  # a lost run has no bound
    said_so = about(found, "not excited")
    assert not said_so.met and said_so.by == "all but two_layer"
    kick = about(found, "largest torque of the start")
    assert not kick.met and kick.reached == pytest.approx(1.2 / 0.25) and kick.by == "two_layer on poor"
    base, arm = (about(found, "computed_torque's error of the", part) for part in ("base", "arm"))
    assert not base.met and not arm.met and arm.reached == pytest.approx(16.0)  # mrad


def test_one_learner_is_measured_by_the_best_in_every_task_and_by_pd_with_gravity():
    table = {
        ("eight", "pd_gravity"): (1.0, 0.10, 0.1, (), 0.2),
        ("eight", "knows"): (0.1, 0.01, 0.1, (), 0.2),
        ("eight", "form"): (0.1, 0.02, 0.1, (), 0.2),
        ("late", "pd_gravity"): (1.0, 0.10, 0.1, (), 0.2),
        ("late", "knows"): (0.1, 0.30, 0.1, (), 0.2),
        ("late", "form"): (0.1, 0.11, 0.1, (), 0.2),
        ("printed", "form"): (0.1, 90.0, 0.1, (), 0.2),  # without the others it is no comparison
    }
    of = rows_of(table)
    tasks = ("eight", "late", "printed")
    far, gravity = everywhere(("pd_gravity", "knows", "form"), ("knows", "form"), tasks, 1.2, of)
    assert far.by == "form" and far.reached == pytest.approx(2.0) and not far.met
    assert gravity.by == "form" and gravity.reached == pytest.approx(1.1) and not gravity.met
    lost = [row(rms={"x": 1.0, "a": 1.0}, outcome="diverged")]
    lose = everywhere(
        ("pd_gravity", "form"), ("form",), ("eight",), 1.2, lambda t, n: lost if n == "form" else of(t, n)
    )
    assert [one.reached for one in lose] == [None, None] and not any(one.met for one in lose)


def test_nobody_to_judge_is_not_met():
    found = judged({})
    assert found and not any(target.met for target in found.values())
    assert all(target.reached is None for target in found.values())


# -- what it shows --


def test_a_cell_tells_the_median_and_the_spread():
    assert cell([1.0, 3.0, 2.0]).text == "2.00\n±50 %"
    assert cell([2.0, 2.001, 2.002]).text == "2.00"
    assert cell([1.0, 3.0]).text == "2.00\n±50 %"
    assert cell([1.0, math.inf, 2.0], "never").text == "2.00\n(1.00 to never)"
    assert cell([1.0, math.nan]).text == "-" and cell([90.0, 120.0, 130.0], above=100.0).kind == "bad"


def test_the_text_names_everyone_and_what_was_asked(standing):
    text = render(standing)
    assert max(map(len, text.splitlines())) <= 120
    for name in (*NAMES, "not met", "never", "FVU", "% of a motor's speed limit", "kick"):
        assert name in text
    ratio = standing.step_ratio("eight", "adaptive")
    assert ratio > 1 and standing.step_ratio("eight", "pd") == 1.0


# -- the command line --


def test_the_command_runs_draws_and_resumes(capsys, tmp_path, folder, standing):
    asked = ["contest", "--case", "eight", *SET, "--controller", "two_layer", "--out", str(tmp_path), "--json"]
    assert main(asked) == 0
    told = json.loads(capsys.readouterr().out)
    rows = told["comparison"]["rows"]
    assert len(rows) == 6 and {row["controller"] for row in rows} == {"two_layer", "pd", "computed_torque"}
    mine = standing.of("eight", "two_layer")[1]
    (same,) = [row for row in rows if row["controller"] == "two_layer" and row["seed"] == mine.seed]
    assert same["frozen_fvu"] == mine.frozen_fvu and same["rms_base"] == base_of(mine.rms)
    assert {"task", "rms_arm", "rms_heading", "learning_time", "held_out", "findings"} <= set(same)
    for file in told["plots"].values():
        assert Path(file).read_bytes()[:4] == b"\x89PNG"
    before = (tmp_path / "eight" / "pd.h5").stat().st_mtime_ns
    assert main([*asked[:-1], "--controller", "adaptive"]) == 0
    assert "adaptive" in capsys.readouterr().out
    assert (tmp_path / "eight" / "pd.h5").stat().st_mtime_ns == before  # not run again
    assert main([*asked[:-1], "--seed", "7"]) == 2
    assert "--force" in capsys.readouterr().err
    assert main(["plot", str(tmp_path / "eight" / "two_layer.h5"), "--out", str(tmp_path / "plots")]) == 0


@pytest.mark.parametrize(
    ("more", "says"),
    [
        (["--case", "nine"], "unknown case 'nine'"),
        (["--controller", "pd_effective"], "pd_effective takes no part"),
        (["--set", "contest.seeds=0"], "contest.seeds"),
        (["--set", "contest.knows.all=['pd']"], "contest.knows.all"),
        (["--set", "contest.targets.frozen_fvu.form=0"], "contest.targets.frozen_fvu.form"),
        (["--set", "contest.windw=1"], "unknown key 'windw'"),
        (["--set", "held_out.circle.base.radius=-1"], "held_out.circle"),
        (["--set", "cases.eight.set.robot='no_robot'"], "no_robot"),
        (["--set", "cases.eight.experiment='no_experiment'"], "no_experiment"),
        (["--set", "sensor.velocity_noise=[1.0, 2.0]"], "2 numbers for 4 velocities"),
    ],
)
def test_what_cannot_be_is_one_line(capsys, tmp_path, more, says):
    out = tmp_path / "out"
    assert main(["contest", "--case", "eight", *SET, *more, "--out", str(out)]) == 2
    error = capsys.readouterr().err
    assert says in error and error.count("\n") == 1 and not out.exists()


def test_only_cases_can_be_chosen():
    with pytest.raises(ConfigError, match="has no cases"):
        chosen_cases(load_experiment("chapter4"), ["eight"])
    with pytest.raises(UnknownName):
        chosen_cases(load_experiment("faults"), ["eight"])
    assert list(chosen_cases(load_experiment("faults"), ["noise", "none"]).cases) == ["noise", "none"]


def test_a_lost_run_is_a_row_too(tmp_path):
    """Learning rates that are far too high: the run diverges, and everything else goes on."""
    more = ["two_layer.F=[3e5, 3e5]", "two_layer.G=[3e5, 3e5]", "bounds.speed=5.0"]
    lost = run_contest(quick(more=more, controllers=("two_layer",)), "contest", out=tmp_path)
    one = lost.of("eight", "two_layer")[0]
    assert one.outcome == "diverged" and one.rms["x"] is None and one.frozen_fvu is None and not lost.completed
    assert "2 of 2 lost" in render(lost)
    assert main(["list"]) == 0


def test_all_tasks_of_the_bundled_contest_can_be_made():
    """Without TIAGo and Panda, which are not bundled, and without the contact plant, which is an extra."""
    experiment = load_contest()
    names = [name for name in experiment.cases if name not in ("tiago", "arm7", "wheels")]
    found = tasks_of(chosen_cases(experiment, names), ("pd", "adaptive"))
    for task in found:
        own = {"printed": ("pd", "one_layer", "two_layer"), "velocity": VELOCITY}.get(task.name, ("pd", "adaptive"))
        assert task.experiment.controllers == own
        assert task.experiment.lead == (task.name != "unled")
    by_name = {task.name: task.experiment for task in found}
    printed, chapter4 = by_name["printed"], by_name["chapter4"]
    assert (printed.two_layer, printed.one_layer) == (chapter4.two_layer, chapter4.one_layer)
    assert [task.name for task in found] == names
    eights = ("eight", "unled", "printed", "payload", "rich", "poor")
    outside = ("friction", "lag", "late1", "late3", "encoders", "observed", "drop", "velocity")  # of the model class
    fewer = dict.fromkeys((*outside, "arm7", "rig"), 2) | dict.fromkeys(("velocity", "wheels", "tiago"), 1)
    for task in found:
        assert len(task.seeds) == task.contest.seeds == fewer.get(task.name, 5)
    for task in found:
        if task.name in (*outside, *eights):
            loop = task.training(task.controller("computed_torque"), 1)
            assert loop.delay_margin() - loop.latency.total > 0.003
    gains = {task.name: task.controller("pd").feedback for task in found}
    assert len({gains[name] for name in eights}) == 1
    assert replace(found[0], name="x").name == "x"

"""`mmnn prove`: its numbers are those of the parts, figures and report show them, bad input is one line."""

from __future__ import annotations

import json
import re
import shutil
import subprocess
import sys
from pathlib import Path

import h5py
import msgspec
import numpy as np
import pytest
from places import ROOT
from proofs import SLOW, learner, loop_of
from test_report import Page

from mmnn_pin import PD, Feedback, Line, Loop, Recording, Timing, TorqueController, Trajectory, load, load_experiment
from mmnn_pin.cli import main
from mmnn_pin.errors import InputError, RecordingError
from mmnn_pin.lab.experiments.config import recorded_experiment
from mmnn_pin.lab.psi import judgement as cache
from mmnn_pin.lab.psi.psi import worst
from mmnn_pin.lab.show.gallery import PICTURES
from mmnn_pin.lab.show.psi import Judged, judgement
from mmnn_pin.lab.show.psi_figures import frozen_figure, fvu_figure, ranks_figure, shares_figure
from mmnn_pin.lab.show.report import report
from mmnn_pin.safety import Safety
from research.proof.certified_run import prove
from research.proof.figures import COLOURS, equality_figure, lyapunov_figure, terms_figure
from research.proof.linear import LinearFit, least_squares, moving
from research.proof.lyapunov import TERMS
from research.proof.proof import Proof
from research.proof.text import ideal_rows, render

compiled_only = pytest.mark.skipif(SLOW, reason="half a second of uncompiled code")
SETTINGS = ("time.duration=0.8", "windows=[[0.0, 0.4], [0.4, 0.8]]", "plots=[]", "weights_interval=0.05")


@pytest.fixture(scope="module")
def runs(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Recording]:
    """A learner and PD on chapter 4's robot, as files."""
    folder = tmp_path_factory.mktemp("runs")
    experiment = load_experiment("chapter4", SETTINGS if not SLOW else ("time.duration=0.02", "plots=[]"))
    robot, made = experiment.load_robot(), {}
    for name in ("two_layer", "pd"):
        loop = experiment.loop(robot, experiment.controller(name, robot=robot))
        made[name] = loop.run(folder / f"{name}.h5", meta={"experiment": "chapter4", "config": experiment.to_json()})
    return made


@pytest.fixture(scope="module")
def proof(runs: dict[str, Recording]) -> Proof:
    return Proof(runs["two_layer"], budget=2000)


def told(capsys: pytest.CaptureFixture[str], *arguments: object) -> tuple[int, dict, str]:
    """Exit code, JSON and standard error of the command."""
    code = main(["prove", *map(str, arguments), "--json"])
    captured = capsys.readouterr()
    return code, json.loads(captured.out), captured.err


# -- numbers --


@compiled_only
def test_the_numbers_are_those_of_the_parts(runs: dict[str, Recording], capsys: pytest.CaptureFixture[str]) -> None:
    code, found, _ = told(capsys, runs["two_layer"].path, "--payload", "3", "--windows", "2")
    proof = Proof(runs["two_layer"], payload=3.0, windows=2)
    assert code == 0 and found["holds"] and found["controller"] == "two_layer" and found["robot"] == "platform_arm"
    psi = found["psi"]
    assert list(psi["online"]["components"].values()) == pytest.approx(list(proof.psi.online))
    assert psi["online"]["arm"] == pytest.approx(worst(proof.psi.online[2:])) and len(psi["windows"]) == 2
    assert psi["frozen"]["payload"]["about"] == "the same with 3 kg at the arm's tip"
    for name in ("same", "held_out", "payload"):
        components = list(psi["frozen"][name]["components"].values())
        assert components == pytest.approx(list(proof.psi.frozen[name].fvu))
        assert psi["frozen"][name]["base"] == pytest.approx(max(components[:2]))
    for component in psi["torque_share"]["network"]:
        assert sum(part[component] for part in psi["torque_share"].values()) == pytest.approx(1)
    assert set(psi["networks"]["arm"]["effective_rank"]) == {"W", "V", "activations"}
    assert found["ideal"]["base"]["norm"] == pytest.approx(proof.ideal[1].norm) and found["ideal"]["arm"]["ZB"] == 5.0
    v = proof.lyapunov
    assert found["lyapunov"]["V"]["end"] == pytest.approx(v.total[-1])
    assert sum(found["lyapunov"]["terms"].values()) == pytest.approx(v.measured.sum() * 0.002)
    assert sum(found["lyapunov"]["largest_where_growing"].values()) == pytest.approx(1)
    assert found["equality"]["periods"] == found["equality"]["of"] == 399 and found["equality"]["model"] < 1e-6
    assert found["remarks"] == []


@compiled_only
def test_the_text_tells_them(runs: dict[str, Recording], capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["prove", str(runs["two_layer"].path)]) == 0
    text = " ".join(capsys.readouterr().out.split())
    for words in ("FVU online", "frozen, held out: an eight", "effective rank of W", "Equality", ": holds,", "leakage"):
        assert words in text
    assert max(map(len, render(Proof(runs["two_layer"])).splitlines())) <= 100


@pytest.mark.parametrize(
    ("numbers", "words"),
    [
        ((0.01, 2.6, 1.5), "adapting, it explains 99 % of Psi; frozen, it predicts worse than a constant"),
        ((1.4, 1.1, 0.99), "adapting, it predicts worse than a constant; frozen, it predicts worse than a constant"),
        ((0.01, 0.02, 3.0), "explains 98 % of Psi on its own trajectory and predicts worse than a constant on a"),
        ((0.01, 0.02, 0.05), "frozen, it explains 95 % of Psi on a trajectory that it never saw"),
        ((0.01, 0.02, float("nan")), "frozen, it explains 98 % of Psi on its own trajectory ("),
        ((float("nan"), float("nan"), 1.0), "nothing to judge"),
    ],
)
def test_the_verdict_follows_from_three_numbers(numbers: tuple[float, float, float], words: str) -> None:
    assert words in judgement(*map(Judged, numbers))


def test_the_verdict_names_the_joints() -> None:
    """Which component the number is of, and which are lost; all of them are not named."""
    names = ["v", "w", "arm_1_joint", "arm_2_joint", "arm_3_joint", "arm_4_joint"]
    good, some, all_lost = (np.array(values) for values in ([0.1] * 5 + [0.2], [0.1, 2, 3, 2, 2, 2], [2.0] * 5 + [3]))
    text = judgement(*(Judged.of(names, values) for values in (good, some, all_lost)))
    assert "explains 80 % of Psi; frozen, it predicts w, arm_1, arm_2 and 2 others worse than a constant" in text
    assert text.endswith("(FVU online 0.200 of arm_4, frozen 3.00 of arm_1, held out 3.00 of arm_4).")
    assert Judged.of(names, all_lost).prediction() == "predicts worse than a constant"
    one = np.array([0.1, 0.1, 0.1, 1.5, 0.1, 0.1])
    assert Judged.of(names, one).prediction() == "predicts arm_2 worse than a constant"


def test_weights_of_features_that_do_not_move_are_not_determined() -> None:
    """A feature of rounding alone would get a weight of 1e28, and the others none of their own."""
    rng = np.random.default_rng(0)
    moved, rounding = rng.normal(size=(200, 3)), 1e-29 * rng.normal(size=(200, 1))
    W, target = np.array([[1.0], [2.0], [-3.0]]), 0.1 * rng.normal(size=(200, 1))
    table = np.hstack((moved, rounding, np.zeros((200, 1))))
    found = least_squares(table, moved @ W + target)
    expected = np.linalg.solve(moved.T @ moved, moved.T @ (moved @ W + target))
    np.testing.assert_allclose(found, [*expected, [0.0], [0.0]], rtol=1e-9)
    assert moving(table).tolist() == [True, True, True, False, False]
    fit = LinearFit(found, 3e28, np.zeros(1), np.zeros(1), np.zeros(2), still=2)
    rows = {row.cells[0].text: row.cells[1].text for row in ideal_rows(fit)}
    assert rows["|W*| of the best fixed weights, fitted offline"] == "not determined: features hardly move"
    assert rows["weights that this run does not determine: their features stay 0"] == "2"


def test_a_violated_equality_ends_with_exit_code_1(
    tmp_path: Path, runs: dict[str, Recording], capsys: pytest.CaptureFixture[str]
) -> None:
    path = shutil.copy(runs["pd"].path, tmp_path / "changed.h5")
    with h5py.File(path, "r+") as file:
        file["signals/torque"][3:] *= 1.01
    code, found, _ = told(capsys, path)
    assert code == 1 and not found["holds"] and found["equality"]["steps"] > 1e-4 > found["equality"]["model"]
    main(["prove", str(path)])
    assert "IS VIOLATED" in capsys.readouterr().out


# -- what cannot be told --


def test_a_controller_that_learns_nothing(runs: dict[str, Recording], capsys: pytest.CaptureFixture[str]) -> None:
    code, found, _ = told(capsys, runs["pd"].path)
    assert code == 0 and found["psi"] is None and found["ideal"] is None and found["equality"]["holds"]
    assert found["remarks"] == ["pd gives no Psi_hat: it estimates nothing"]
    assert found["lyapunov"]["parts"]["weights"] == {"start": 0.0, "end": 0.0}


class Own(TorqueController):
    """A user's own controller: it returns a torque and nothing else."""

    name = "own"

    def step(self, time, reference, measurement, command, state):
        return 20.0 * np.concatenate((command.z, command.r))


def test_a_controller_in_plain_python_is_told_plainly() -> None:
    proof = Proof(loop_of("differential", Own(), duration=0.02).run())
    assert proof.remarks()[0].startswith(
        "own gives no Psi_hat: a controller of your own whose step returns a torque alone"
    )
    assert proof.balance.holds and not proof.lyapunov.weights.any()


def test_a_short_run_tells_what_it_can(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "short.h5"
    loop_of("fixed", learner("fixed"), duration=0.03).run(path)
    code, found, _ = told(capsys, path)
    assert code == 0 and found["psi"] is None and found["ideal"] is not None and found["lyapunov"] is not None
    assert found["remarks"][0].startswith("too short for Psi: it ends at 0.029 s")
    loop_of("fixed", duration=0.001).run(tmp_path / "one.h5")
    code, found, err = told(capsys, tmp_path / "one.h5")
    assert code == 2 and "too short to judge" in err and err.count("\n") == 1


def test_a_run_that_was_killed_or_lost_says_so(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "killed.h5"
    loop_of("fixed", learner("fixed"), duration=0.03, weights_interval=0.01).run(path)
    with h5py.File(path, "r+") as file:
        file.attrs["complete"] = False
        del file["final"]
    code, found, _ = told(capsys, path)
    assert code == 0 and found["outcome"] == "interrupted"
    assert found["remarks"][0] == "the run was interrupted; this is about the time before 0.029 s"
    wild = PD(Feedback(arm=1e5))
    lost = loop_of("fixed", wild, period=0.01, duration=0.5).run(tmp_path / "lost.h5")
    assert lost.outcome.status == "diverged"
    _, found, _ = told(capsys, tmp_path / "lost.h5")
    assert "diverged" in found["remarks"][0] and found["lyapunov"]["growing_share"] > 0.5


def edited(path: Path, target: Path, edit) -> Path:
    shutil.copy(path, target)
    with h5py.File(target, "r+") as file:
        edit(file)
    return target


@pytest.mark.parametrize(
    ("edit", "words"),
    [
        (lambda file: file.__delitem__("urdf"), "does not hold its robot's URDF"),
        (lambda file: file.attrs.__delitem__("time"), "does not hold the periods"),
        (lambda file: file.attrs.__delitem__("kinematic"), "does not hold the gains"),
        (lambda file: file.attrs.__delitem__("mass_factors"), "does not tell 'mass_factors'"),
        (lambda file: file["signals"].__delitem__("psi"), "'psi' is not in the recording"),
    ],
    ids=["urdf", "periods", "gains", "masses", "signal"],
)
def test_a_recording_that_lacks_something_is_refused_in_one_line(
    edit, words: str, runs: dict[str, Recording], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = edited(runs["pd"].path, tmp_path / "edited.h5", edit)
    code, found, err = told(capsys, path)
    assert code == 2 and words in err and str(path) in err and err.count("\n") == 1 and "error" in found


def test_a_learner_of_an_older_version_still_has_its_errors(runs: dict[str, Recording], tmp_path: Path, capsys) -> None:
    path = edited(runs["two_layer"].path, tmp_path / "old.h5", lambda f: f.attrs.__delitem__("controller_settings"))
    code, found, _ = told(capsys, path)
    assert code == 0 and found["psi"] is None and found["lyapunov"] is not None and found["equality"]["holds"]
    assert any("settings of two_layer" in remark for remark in found["remarks"]) or SLOW


def test_other_bad_input(runs: dict[str, Recording], tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for arguments, words in (
        ((tmp_path,), "a folder"),
        ((tmp_path / "none.h5",), "no such recording"),
        ((runs["pd"].path, "--payload", "0"), "payload"),
        ((runs["pd"].path, "--windows", "0"), "windows"),
    ):
        code, _, err = told(capsys, *arguments)
        assert code == 2 and words in err and err.count("\n") == 1


def test_the_contact_plant_is_told_apart(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    pytest.importorskip("mujoco")
    loop = loop_of("fixed", duration=0.01)  # a fixed arm has no wheels: the recording is made to say otherwise
    loop.run(tmp_path / "run.h5")
    path = edited(tmp_path / "run.h5", tmp_path / "contact.h5", lambda f: f.attrs.__setitem__("plant", "contact"))
    code, found, _ = told(capsys, path)
    assert code == 0 and found["equality"] is None
    assert any("its wheels may slip" in remark for remark in found["remarks"])


# -- figures --


def line_with(axes, values: np.ndarray) -> bool:
    """Whether an axes has a curve with these values."""
    return any(len(line.get_ydata()) == len(values) and np.allclose(line.get_ydata(), values) for line in axes.lines)


@compiled_only
def test_figures_draw_the_parts(runs: dict[str, Recording], proof: Proof) -> None:
    cache.keep(proof)
    v, psi, b = proof.lyapunov, proof.psi, proof.balance
    both = lyapunov_figure(runs).axes
    assert line_with(both[0], v.total) and line_with(both[1], v.pose + v.motion) and line_with(both[-1], v.measured)
    (panel,) = terms_figure({"two_layer": runs["two_layer"]}).axes
    assert line_with(panel, np.cumsum(v.terms["leakage"]) * v.period) and line_with(panel, v.total - v.total[0])
    upper, middle, lower = equality_figure({"two_layer": runs["two_layer"]}).axes
    for axes, error in ((upper, b.model - b.work), (middle, b.increment - b.again), (lower, b.increment - b.work)):
        assert line_with(axes, np.maximum(np.abs(error) / b.scale, 1e-17))
    figure = frozen_figure(runs)
    assert len(figure.axes) == 8
    assert line_with(figure.axes[0], psi.frozen["same"].psi_hat[:, 0])
    assert line_with(figure.axes[1], psi.frozen["held_out"].psi_hat[:, 0])
    right = fvu_figure(runs).axes[1]
    drawn = sorted(float(line.get_ydata()[0]) for line in right.lines if len(line.get_ydata()) == 1)
    assert drawn == pytest.approx(sorted(told.fvu[0] for told in psi.frozen.values()))
    bars = [patch.get_width() for patch in shares_figure(runs).axes[0].patches]
    assert sum(bars) == pytest.approx(4) and bars[0] == pytest.approx(psi.shares["feedback"][0])
    spectrum = psi.networks[0].singular["V"]
    assert line_with(ranks_figure(runs).axes[1], np.maximum(spectrum / spectrum[0], 1e-17))


def test_figures_of_what_learns_nothing_say_why(runs: dict[str, Recording]) -> None:
    for name in ("fvu", "frozen", "shares", "ranks"):
        with pytest.raises(RecordingError, match="nothing to plot"):
            PICTURES[name].make({"pd": runs["pd"]})


def test_every_term_of_the_derivative_has_a_colour_of_its_own() -> None:
    assert len(set(COLOURS)) == len(COLOURS) == len(TERMS)


@compiled_only
def test_the_command_writes_its_figures_once(runs: dict[str, Recording], tmp_path: Path, capsys) -> None:
    code, found, _ = told(capsys, runs["pd"].path, "--plots", tmp_path / "plots")
    assert code == 0 and set(found["files"]) == {"lyapunov", "lyapunov-terms", "equality"}
    assert all(Path(file).read_bytes()[1:4] == b"PNG" for file in found["files"].values())
    code, _, err = told(capsys, runs["pd"].path, "--plots", tmp_path / "plots")
    assert code == 2 and "exists" in err
    assert told(capsys, runs["pd"].path, "--plots", tmp_path / "plots", "--force")[0] == 0


# -- the report --


@compiled_only
def test_the_report_tells_what_is_proved(runs: dict[str, Recording], proof: Proof) -> None:
    for recording in runs.values():
        cache.KEPT.pop(recording, None)
    cache.keep(proof)
    page = Page(report(runs, with_replay=False).html)
    text = " ".join(" ".join(words) for words in page.texts.values())
    assert {"learned", "plot-fvu", "plot-lyapunov"} <= set(page.ids)
    assert f"FVU online {judgement_number(proof)}" in text
    for words in ("FVU frozen, held out", "V grows in", f"{100 * proof.growth.samples:.0f}", "equality"):
        assert words in text
    alone = Page(report({"pd": runs["pd"]}, with_replay=False).html)
    assert "plot-lyapunov" in alone.ids and "plot-fvu" not in alone.ids


def judgement_number(proof: Proof) -> str:
    from mmnn_pin.lab.show.table import number

    return number(worst(proof.psi.online[proof.psi.halves["arm"]]))


# -- the documents --

DOCUMENT = (ROOT / "docs/explanation/proof.md").read_text()


def numbers_of(line: str) -> list[float]:
    return [float(number) for number in re.findall(r"(?<![\w.])\d+\.?\d*(?:e-\d+)?(?![\w.]*\d)", line)]


@compiled_only
def test_the_example_prints_what_the_document_says(tmp_path: Path) -> None:
    script = ROOT / "examples/fast_adaptation.py"
    done = subprocess.run([sys.executable, script], cwd=tmp_path, capture_output=True, text=True, check=True)
    printed = done.stdout.splitlines()
    told = [line for line in DOCUMENT.splitlines() if line.startswith(("    two_layer  FVU", "    integrator FVU"))]
    assert len(printed) == len(told) == 2
    for one, other in zip(printed, told, strict=True):
        assert numbers_of(one) == pytest.approx(numbers_of(other), rel=0.05, abs=1e-4)


@compiled_only
def test_the_documents_table_is_what_the_command_says() -> None:
    experiment = load_experiment("track")
    robot = experiment.load_robot()
    run = experiment.loop(robot, experiment.controller("two_layer", robot=robot)).run(
        meta={"config": experiment.to_json()}
    )
    psi = Proof(run).psi
    for half, where in psi.halves.items():
        (row,) = (line for line in DOCUMENT.splitlines() if line.startswith(f"| {half} |"))
        found = [worst(psi.online[where]), *(worst(psi.frozen[n].fvu[where]) for n in ("same", "held_out", "payload"))]
        assert found == pytest.approx(numbers_of(row), rel=0.06)


def test_runs_with_faults_are_told(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Motors, a supervisor and events without an end, whose config has an infinite time in it."""
    experiment = load_experiment("chapter4", ("time.duration=0.02", 'disturbances=[{type="push", on="v", force=9.0}]'))
    experiment = msgspec.structs.replace(experiment, safety=Safety(weights=1e-3))
    robot = experiment.load_robot()
    loop = experiment.loop(robot, experiment.controller("two_layer", robot=robot))
    loop.run(tmp_path / "run.h5", meta={"config": experiment.to_json()})
    assert recorded_experiment(Recording.open(tmp_path / "run.h5")) == experiment
    code, found, _ = told(capsys, tmp_path / "run.h5")
    assert code == 0 and found["equality"]["holds"] and found["lyapunov"]["terms"]["push"] < 0
    # the supervisor scales the weights: stepping the learner again does not give them
    assert found["lyapunov"]["parts"]["weights"] == {"start": 0.0, "end": 0.0}
    assert any("under a supervisor" in remark for remark in found["remarks"])


def test_a_base_that_steers_is_refused_by_name() -> None:
    robot = load("loader_arm")
    run = Loop(robot, Trajectory.of(robot, base=Line(speed=0.3)), PD(), timing=Timing(duration=0.05)).run()
    with pytest.raises(InputError, match="the base of 'loader_arm' steers"):
        prove(run)

"""From a log to a corrected URDF: a wrong robot is found, what stays unknown is named, files are whole."""

from __future__ import annotations

import json
import re
import shlex
import tomllib
from dataclasses import replace
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest
from lxml import etree
from motions import efforts, rubbing, simulated, sines

from mmnn_pin import PD, Loop, Sine, Timing, Trajectory, identify, load, load_experiment
from mmnn_pin.cli import main
from mmnn_pin.cli.identify import why_nothing
from mmnn_pin.deploy.identify import programme
from mmnn_pin.deploy.identify.constants import constants_of
from mmnn_pin.deploy.identify.corrected import new_links, pseudo_inertia_of, said_of, transport, write
from mmnn_pin.deploy.identify.equations import Equations
from mmnn_pin.deploy.identify.excitation import excite
from mmnn_pin.deploy.identify.identification import Identification, misfits
from mmnn_pin.deploy.identify.least_squares import BaseParameters
from mmnn_pin.deploy.identify.log import Log
from mmnn_pin.deploy.identify.payload import payload
from mmnn_pin.deploy.identify.report import inertia_of, links_of, report_of
from mmnn_pin.deploy.identify.rotors import rotors_of
from mmnn_pin.errors import ConfigError, InputError, MmnnError, RecordingError, RobotError, UnknownName
from mmnn_pin.lab.show.identified import headline, percent, text_of
from mmnn_pin.model.inspection import inspection_of
from mmnn_pin.model.loading import load_with
from mmnn_pin.model.robot import Robot
from mmnn_pin.model.robots import extra
from mmnn_pin.model.tree.body import parameters
from mmnn_pin.torque.pseudo_inertia import pseudo_inertias

ROTORS = np.array([0.05, 0.02])


@pytest.fixture(scope="module")
def urdf() -> Robot:
    """What the maker says."""
    return load("two_axis_arm")


@pytest.fixture(scope="module")
def truth(urdf: Robot) -> Robot:
    """The robot itself: 30 % heavier and lighter, with friction."""
    return rubbing(urdf.with_masses({"arm_1_joint": 1.3, "arm_2_joint": 0.7}), 0.2, 0.1)


@pytest.fixture(scope="module")
def found(urdf: Robot, truth: Robot) -> Identification:
    return identify(urdf, simulated(truth, 40.0, 0.02, rotors=ROTORS))


def test_a_robot_whose_file_is_30_percent_off_is_found(found: Identification, truth: Robot) -> None:
    assert found.follows.all() and found.better
    assert found.error("urdf") > 0.2 and found.error("friction") > 0.1
    assert found.error("identified") < 0.02  # the filtered noise
    new = simulated(truth, 15.0, seed=7, rotors=ROTORS)
    again = identify(found.robot, new, cutoff=found.training.cutoff)  # its equations: of another motion
    error = np.where(again.training.use, again.training.y - again.training.Y @ found.theta, 0.0)
    assert np.sqrt((error**2).sum() / (again.training.use * again.training.y**2).sum()) < 0.01


def test_base_parameters_are_the_truth_within_their_intervals(found: Identification, truth: Robot) -> None:
    theta = np.concatenate((parameters(truth.with_armature(ROTORS)), np.zeros(2)))
    away = (found.fit.value - found.fit.base.combination @ theta) / found.fit.sd
    assert np.abs(away).max() < 4.0 and found.fit.seen.all()
    assert min(programme.positive_bodies(found.theta, found.unknowns.regressor.inertial)) > 0


def test_the_constrained_fit_is_the_truth_in_all_that_matters(found: Identification, truth: Robot) -> None:
    theta = np.concatenate((parameters(truth.with_armature(ROTORS)), np.zeros(2)))
    C = found.fit.base.combination
    sd = np.sqrt(np.diag(C @ found.consistent.covariance @ C.T))
    assert (np.abs(C @ (found.theta - theta)) < 4 * sd + 1e-3).all()


def test_a_rotor_far_above_what_its_link_weighs_is_found(urdf: Robot) -> None:
    """As of a geared wrist: what the last joint feels is its motor, hundreds of times its light link."""
    light = urdf.with_masses({"arm_2_joint": 0.01})
    found = identify(light, simulated(rubbing(light, 0.5, 0.3), 40.0, 0.05, rotors=np.array([0.05, 0.2])))
    np.testing.assert_allclose(found.theta[found.unknowns.columns("rotor")[1]], 0.2, rtol=0.02)
    assert found.errors("identified")[1] < 0.1 * found.errors("friction")[1]


# -- what is written ---------------------------------------------------------------------------------------------------


def test_the_written_urdf_is_the_fit_and_loads_like_the_robot(found: Identification, tmp_path: Path) -> None:
    files = write(found, tmp_path)
    robot = load(files["urdf"])
    meant, read = found.in_urdf[: found.unknowns.regressor.size], parameters(robot)
    np.testing.assert_allclose(read, meant, rtol=1e-9, atol=1e-9)
    assert robot.velocity_names == found.robot.velocity_names
    kinds = [finding["severity"] for finding in inspection_of(robot)["findings"]]
    assert "error" not in kinds
    toml = tomllib.loads(files["toml"].read_text())
    assert set(toml["rotor"]) == {"arm_2_joint"}  # the first joint's says what its link's inertia says
    assert toml["rotor"]["arm_2_joint"] == pytest.approx(ROTORS[1], abs=0.01)
    assert toml["held_out_with"] < toml["held_out_without"]
    report = json.loads(files["json"].read_text())
    assert set(report["joints"]) == set(robot.joint_names) and report["file"] == str(files["urdf"])
    assert np.shape(report["covariance"]) == (len(report["labels"]),) * 2
    np.testing.assert_allclose(report["covariance"], np.transpose(report["covariance"]), atol=1e-12)


def test_a_base_that_scrubs_turns_as_it_was_found_to(tmp_path: Path) -> None:
    """A URDF has no friction of the floor: its coefficient stands beside it, for the masses that were found."""
    urdf = load("tracked_arm")
    slippery = load("tracked_arm", mu=0.6).with_masses(1.3)
    found = identify(urdf, simulated(slippery, 30.0, 0.01))
    again = load(write(found, tmp_path)["urdf"])
    assert slippery.coulomb[2] < 0.9 * urdf.coulomb[2]
    assert again.coulomb[2] == pytest.approx(slippery.coulomb[2], rel=0.02)
    np.testing.assert_allclose(parameters(again)[-1], found.theta[found.unknowns.labels.index("w.coulomb")])


def test_only_inertias_and_dynamics_change_and_comments_stay(found: Identification, tmp_path: Path) -> None:
    files = write(found, tmp_path)
    before, after = found.robot.path.read_text(), files["urdf"].read_text()
    comments = re.findall(r"(?s)<!--.*?-->", before)
    assert [c for c in re.findall(r"(?s)<!--.*?-->", after) if "Identified by mmnn_pin" not in c] == comments
    (said,) = [c for c in re.findall(r"(?s)<!--.*?-->", after) if "Identified by mmnn_pin" in c]
    assert "inertias of arm_2;" in said and "from simulated" in said and "--" not in said[4:-3]

    def rest(text: str) -> list[Any]:
        root = etree.fromstring(text.encode())
        for name in ("inertial", "dynamics"):
            for element in list(root.iter(name)):
                element.getparent().remove(element)
        return [(e.tag, dict(e.attrib)) for e in root.iter() if isinstance(e.tag, str)]

    assert rest(before) == rest(after)


HAND = """<link name="hand"><inertial><origin xyz="0 0.05 0.1" rpy="0.3 0 0.2"/><mass value="0.4"/>
<inertia ixx="0.002" ixy="0" ixz="0.0001" iyy="0.0028" iyz="0" izz="0.001"/></inertial></link><link name="frame"/>
<link name="finger"><inertial><mass value="0.1"/><inertia ixx="1e-4" ixy="0" ixz="0" iyy="1e-4" iyz="0" izz="1e-4"/>
</inertial></link>
<joint name="palm" type="fixed"><origin xyz="0.1 0 0.4" rpy="0 0.5 0"/><parent link="arm_2"/><child link="hand"/>
</joint>
<joint name="sight" type="fixed"><parent link="hand"/><child link="frame"/></joint>
<joint name="grip" type="prismatic"><origin xyz="0 0 0.2"/><parent link="hand"/><child link="finger"/>
<axis xyz="1 0 0"/>
<limit lower="0" upper="0.05" effort="5" velocity="1"/></joint></robot>"""


def test_a_body_of_several_links_is_laid_on_them(tmp_path: Path) -> None:
    """Also on links that hang on locked joints; the sum is the body, every part stays possible."""
    (tmp_path / "hand.urdf").write_text(load("two_axis_arm").path.read_text().replace("</robot>", HAND))
    robot = load(tmp_path / "hand.urdf", lock=["grip=0.02"])
    found = identify(robot, simulated(rubbing(robot.with_masses({"arm_1_joint": 1.5, "arm_2_joint": 0.7})), 30.0, 0.01))
    files = write(found, tmp_path / "out")
    again = parameters(load(files["urdf"]))  # with the lock that is written beside it
    np.testing.assert_allclose(again, found.in_urdf[: found.unknowns.regressor.size], rtol=1e-7, atol=1e-8)
    links, made = links_of(robot), new_links(found)
    assert [name for name, _ in links["arm_2_joint"]] == ["arm_2", "hand", "finger"]
    root = etree.fromstring(robot.urdf.encode())
    own = {e.get("name"): pseudo_inertia_of(e) for e in root.iter("link") if e.find("inertial") is not None}
    for b, name in enumerate(found.unknowns.regressor.bodies):
        total = np.sum([H @ made.get(link, own[link]) @ H.T for link, H in links[name]], axis=0)
        P = pseudo_inertias(found.theta[10 * b : 10 * b + 10])[0]
        np.testing.assert_allclose(total, P, rtol=1e-7, atol=1e-8 * np.abs(P).max())
    assert set(made) >= {"arm_2", "hand", "finger"}
    assert all(np.linalg.eigvalsh(P)[0] > 0 for P in made.values())


def test_transport_is_exact_and_the_identity_where_nothing_changes() -> None:
    rng = np.random.default_rng(0)
    A, B = ((lambda M: M @ M.T)(rng.standard_normal((4, 4))) for _ in range(2))
    G = transport(A, B)
    np.testing.assert_allclose(G @ A @ G.T, B, rtol=1e-8)
    np.testing.assert_allclose(transport(A, A), np.eye(4), atol=1e-8)
    mass, centre, inertia = inertia_of(np.diag([0.1, 0.2, 0.3, 2.0]))
    assert mass == 2.0 and not centre.any()
    np.testing.assert_allclose(np.diag(inertia), [0.5, 0.4, 0.3])


def test_nothing_is_replaced_unasked_and_nothing_is_half_written(
    found: Identification, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with pytest.raises(RecordingError, match="would replace the URDF itself"):
        write(found, found.robot.path, force=True)
    write(found, tmp_path)
    with pytest.raises(RecordingError, match="the file exists"):
        write(found, tmp_path)
    monkeypatch.setattr("mmnn_pin.deploy.identify.corrected.curves_of", lambda of: {"a": object()})
    monkeypatch.setattr(
        "mmnn_pin.deploy.identify.corrected.np.savez_compressed", lambda *a, **k: (_ for _ in ()).throw(OSError("full"))
    )
    with pytest.raises(RecordingError, match="cannot write the file: full"):
        write(found, tmp_path / "other")
    assert not (tmp_path / "other").exists()


# -- what is not identified --------------------------------------------------------------------------------------------


def test_a_joint_that_stands_still_stays_at_the_urdf_and_is_named(urdf: Robot, truth: Robot) -> None:
    t, x, v, a = sines(truth, 30.0)
    x[:, 1], v[:, 1], a[:, 1] = 0.4, 0.0, 0.0
    tau = efforts(truth, x, v, a) + 0.02 * np.random.default_rng(0).standard_normal(v.shape)
    names = urdf.joint_names
    log = Log.of(t, dict(zip(names, x.T, strict=True)), dict(zip(names, tau.T, strict=True)))
    found = identify(urdf, log)
    assert found.follows.tolist() == [True, False] and found.why == {"arm_2_joint": "it hardly moves"}
    report = report_of(found)
    assert not report["joints"]["arm_2_joint"]["identified"]
    assert "arm_2_joint" not in report["friction"]
    text = text_of(report, width=80)
    assert "infinite" not in text and "\n joint\n" not in text  # no table for the one word "not identified"
    row = next(line for line in text.splitlines() if line.startswith(" arm_2_joint"))
    assert row.split()[1:] == ["-"] * 4  # it stands still in the motion held out, too
    assert "arm_2_joint: stays at the URDF: it hardly moves" in text


def test_parameters_that_a_motion_does_not_tell_apart_are_counted_in_plain_words(found: Identification) -> None:
    report = report_of(found)
    assert f"number of the weighted regressor {report['condition']:.3g}" in " ".join(text_of(report).split())
    every = [one | {"identified": i > 1} for i, one in enumerate(report["base_parameters"])]
    text = text_of(report | {"condition": None, "base_parameters": every})
    assert f"{len(every)} base parameters, of which the motion tells {len(every) - 2} apart" in text
    assert "infinite" not in text


# -- what makes it doubtful --------------------------------------------------------------------------------------------


def test_efforts_that_no_motor_gives_are_told_with_their_joint_and_how_many(
    urdf: Robot, truth: Robot, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    log = simulated(truth, 30.0, 0.02)
    sizes = np.sort(np.abs(log.effort["arm_1_joint"]))
    limits = np.array([sizes[-7] / 1.01, np.inf])
    count = np.count_nonzero(sizes > 1.001 * limits[0])  # what rounding adds is none
    weak = replace(urdf, effort_limits=limits)
    (line,) = identify(weak, log).beyond
    assert line.startswith(f"effort.arm_1_joint is above the URDF's limit of {limits[0]:g} in {count} of 3000 samples")
    assert f"at most {sizes[-1]:.4g}" in line and "--torque-constant arm_1_joint=K" in line
    assert identify(urdf, log).beyond == ()
    currents = log.with_signals(log.signals | {"effort.arm_1_joint": log.effort["arm_1_joint"] * 50.0})
    assert identify(weak, currents, torque_constants={"arm_1_joint": None}).beyond == ()  # no torques yet
    file = csv_of(log.with_signals({k: 1e3 * v if k[0] == "e" else v for k, v in log.signals.items()}), tmp_path / "l")
    main(["identify", str(file), "--robot", "two_axis_arm", "--out", str(tmp_path / "o"), "--json"])
    told = json.loads(capsys.readouterr().out)["warnings"]
    assert [text.split()[0] for text in told][:2] == ["effort.arm_1_joint", "effort.arm_2_joint"]


def test_a_joint_that_fits_far_worse_than_the_others_is_told(urdf: Robot, truth: Robot) -> None:
    log = simulated(truth, 40.0, 0.02)
    buzz = 0.3 * np.std(log.effort["arm_2_joint"]) * np.sin(2 * np.pi * 0.9 * log.time)
    found = identify(urdf, log.with_signals(log.signals | {"effort.arm_2_joint": log.effort["arm_2_joint"] + buzz}))
    (line,) = found.warnings
    assert line.startswith(f"arm_2_joint fits badly: held-out error {100 * found.errors('identified')[1]:.3g} %")
    assert f"the other joints' median {100 * found.errors('identified')[0]:.3g} %" in line and "--stribeck" in line
    assert f"warning: {line}" in " ".join(str(found).split()) and identify(urdf, log).warnings == ()


def test_a_joint_is_told_that_least_squares_fit_and_no_body_does() -> None:
    errors = {"identified": np.array([0.2, 0.02, 0.5, 0.6]), "least_squares": np.array([0.05, 0.01, 0.4, 0.02])}
    errors |= {"urdf": np.array([0.9, 0.9, 0.1, 0.9])}
    follows = np.array([True, True, True, False])
    first, third = misfits(["a", "b", "c", "d"], errors, follows)
    assert first.startswith("a fits badly: held-out error 20 %, 5 % by least squares without regard to masses")
    assert third.startswith("c fits badly: held-out error 50 %, the other joints' median 11 %: by the URDF 10 %")


def test_a_long_fit_says_how_far_it_is(urdf: Robot, truth: Robot) -> None:
    told: list[tuple[str, float]] = []
    identify(urdf, simulated(truth, 10.0, 0.02), progress=lambda what, fraction: told.append((what, fraction)))
    parts = list(dict.fromkeys(what for what, _ in told))
    assert parts[:2] == ["looking at the logs", "making equations"] and parts[-1] == "fitting all parameters"
    assert all(0.0 <= fraction < 1.0 for _, fraction in told)


def test_an_effort_of_another_unit_does_not_spoil_the_others(urdf: Robot, truth: Robot) -> None:
    log = simulated(truth, 40.0, 0.02)
    noise = np.random.default_rng(0).standard_normal(len(log.time))
    wrong = log.with_signals(log.signals | {"effort.arm_2_joint": noise})
    found = identify(urdf, wrong)
    assert found.follows.tolist() == [True, False]
    assert "does not follow the rigid body" in found.why["arm_2_joint"]
    assert found.errors("identified")[0] < 0.05
    at = found.unknowns.labels.index("arm_2_joint.viscous")
    assert found.theta[at] == found.unknowns.prior[at]


def test_currents_become_torques_by_their_constants(urdf: Robot, truth: Robot, found: Identification) -> None:
    log = simulated(truth, 40.0, 0.02, rotors=ROTORS)
    currents = log.with_signals(log.signals | {"effort.arm_1_joint": log.effort["arm_1_joint"] / -13.6})
    again = identify(urdf, currents, torque_constants={"arm_1_joint": -13.6})
    np.testing.assert_allclose(again.theta, found.theta, rtol=1e-3, atol=1e-4)  # of the solver
    with pytest.raises(UnknownName, match="unknown motor 'elbow'"):
        identify(urdf, log, torque_constants={"elbow": 2.0})
    with pytest.raises(InputError, match="not 0"):
        identify(urdf, log, torque_constants={"arm_1_joint": 0.0})


@pytest.mark.parametrize("constant", [-13.6, 0.04])
def test_a_torque_constant_is_found_from_what_another_joint_feels(
    urdf: Robot, truth: Robot, found: Identification, constant: float
) -> None:
    log = simulated(truth, 40.0, 0.02, rotors=ROTORS)
    currents = log.with_signals(log.signals | {"effort.arm_1_joint": log.effort["arm_1_joint"] / constant})
    again = identify(urdf, currents, torque_constants={"arm_1_joint": None})
    (note,) = [note for note in again.notes if note.startswith("torque constant of arm_1_joint")]
    value, sd = (float(part.split()[-1]) for part in note.split(": ")[1].split(","))
    assert abs(value - constant) < 4 * sd and sd < 0.05 * abs(constant)
    assert again.error("identified") < 1.2 * found.error("identified")
    with pytest.raises(ConfigError, match="ratios only"):
        identify(urdf, currents, torque_constants=dict.fromkeys(urdf.actuator_names))
    with pytest.raises(UnknownName, match="unknown motor 'elbow'"):
        identify(urdf, log, torque_constants={"elbow": None})


def test_the_deviation_of_a_torque_constant_is_its_scatter() -> None:
    """Of rows that share parameters, white noise: over draws, no bias and the scatter that is told."""
    rng, constant, M = np.random.default_rng(0), 5.0, 400
    Y = rng.standard_normal((M, 2, 4)) * [1.0, 1.0, 1.0, 0.3]
    Y[:, 0, 3] = 0.0  # of the second row alone
    clean = Y @ np.array([1.0, -0.5, 0.3, 2.0])
    base, t = BaseParameters(np.arange(4), np.eye(4)), np.arange(M) * 0.5  # apart: the filter does not correlate them
    values, told = [], []
    for _ in range(200):
        y = clean + 0.5 * rng.standard_normal(clean.shape)
        y[:, 1] /= constant
        run = np.zeros(M, np.int64)
        of = Equations(t, Y, y, np.ones((M, 2), bool), np.zeros((M, 2)), run, cutoff=10.0)
        found = constants_of(of, base, [1], ["one", "other"])
        values.append(found.value[0])
        told.append(found.sd[0])
    assert abs(np.mean(values) - constant) < 4 * np.std(values) / np.sqrt(200) + 0.002 * constant
    assert np.mean(told) == pytest.approx(np.std(values), rel=0.2)
    quiet = replace(of, Y=Y * [[[1.0], [1e-3]]], y=0.5 * rng.standard_normal(clean.shape))
    with pytest.raises(RecordingError, match=r"no torque constant of other: .* standard deviation"):
        constants_of(quiet, base, [1], ["one", "other"])


def test_a_motion_too_still_and_a_solver_without_answer_are_one_line(
    urdf: Robot, truth: Robot, monkeypatch: pytest.MonkeyPatch
) -> None:
    with pytest.raises(RecordingError, match=r"too still or too short a motion: no joint moves in 40 of the \d+ rows"):
        identify(urdf, simulated(truth, 20.0, 0.01, speed=0.01), cutoff=4.0)
    log = simulated(truth, 20.0, 0.02)

    def never(self: Any, **how: Any) -> None:
        self._status = "infeasible"

    monkeypatch.setattr("cvxpy.Problem.solve", never)
    with pytest.raises(MmnnError, match="the solver says infeasible") as error:
        identify(urdf, log)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize("failing", [1, 2])
def test_a_solver_that_gives_up_is_asked_again_with_more_care(
    failing: int, urdf: Robot, found: Identification, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Once by a status, once by an error: the next settings follow, one after the other, to the same answer."""
    cvxpy, asked = pytest.importorskip("cvxpy"), []
    solve = cvxpy.Problem.solve

    def gives_up(self: Any, solver: str, **how: Any) -> None:
        asked.append(how)
        if len(asked) > failing:
            solve(self, solver=solver, **how)
        elif len(asked) == 2:
            raise cvxpy.error.SolverError("Solver 'CLARABEL' failed.")
        else:
            self._status = "optimal_inaccurate"

    monkeypatch.setattr("cvxpy.Problem.solve", gives_up)
    R, z = programme.compressed(found.training.only(found.follows), found.prior, found.follows, found.fit)
    allowed, _ = rotors_of(R, z, found.prior, found.fit.inflation, "auto")
    again = programme.consistent_fit(
        R, z, found.prior, found.consistent.weight, found.fit.inflation, allowed,
    )  # fmt: skip
    assert asked == [{}, *programme.CAREFUL][: failing + 1]
    np.testing.assert_allclose(again.theta, found.theta, rtol=1e-3, atol=1e-4)


@pytest.mark.skipif("tiago" not in extra(), reason="needs example-robot-data")
def test_what_is_said_beside_a_file_keeps_the_joints_that_stand_still(found: Identification, tmp_path: Path) -> None:
    """Which branches are short is seen by their bodies: with another centre of mass a nameless head may be an arm."""
    (nameless := tmp_path / "nameless.urdf").write_text(load("tiago").path.read_text().replace("head_", "part_"))
    robot, tree = load(nameless), etree.parse(nameless)
    (head,) = tree.xpath("//link[@name='part_2_link']/inertial/origin")
    head.set("xyz", "2 0 0")
    tree.write(file := tmp_path / "tiago.urdf")
    said = said_of(replace(found, robot=robot))
    assert load_with(file, said).joint_names == robot.joint_names
    with pytest.raises(RobotError, match="--lock part_1_joint"):  # asked
        load_with(file, msgspec.structs.replace(said, lock=()))


def test_stribeck_friction_is_found(urdf: Robot) -> None:
    rough = replace(rubbing(urdf), breakaway=np.full(2, 1.8), stribeck=0.1)
    t, x, v, a = sines(rough, 40.0, speed=0.4)
    tau = efforts(rough, x, v, a)
    more = rough.coulomb * 0.8 * np.exp(-((v / 0.1) ** 2)) * np.tanh(v / 0.01)
    names = urdf.joint_names
    log = Log.of(t, dict(zip(names, x.T, strict=True)), dict(zip(names, (tau + more).T, strict=True)))
    found = identify(urdf, log, stribeck=0.1)
    at = [found.unknowns.labels.index(f"{name}.stribeck") for name in names]
    np.testing.assert_allclose(found.theta[at], 0.8 * rough.coulomb, rtol=0.1)
    assert found.error("identified") < 0.5 * identify(urdf, log).error("identified")


# -- the command -------------------------------------------------------------------------------------------------------


def csv_of(log: Log, path: Path) -> Path:
    rows = np.column_stack([log.time, *log.signals.values()])
    np.savetxt(path, rows, "%.9g", ",", header=",".join(["time", *log.signals]), comments="")
    return path


def test_the_command_writes_and_reports(truth: Robot, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    log = csv_of(simulated(truth, 30.0, 0.02), tmp_path / "log.csv")
    command = ["identify", str(log), "--robot", "two_axis_arm", "--out", str(tmp_path / "out")]
    assert main([*command, "--json"]) == 0
    report = json.loads(capsys.readouterr().out)
    assert {
        "robot",
        "rows",
        "joints",
        "held_out",
        "urdf_held_out",
        "base_parameters",
        "bodies",
        "friction",
        "file",
    } <= set(report)
    assert main(["inspect", report["file"], "--json"]) == 0
    assert main([*command, "--force"]) == 0
    text = capsys.readouterr().out
    assert "Held-out torque error" in text and "wrote" in text
    page = tmp_path / "page.html"
    assert main(["report", str(tmp_path / "out"), "--html", str(page)]) == 0
    html = page.read_text()
    assert "two_axis_arm identified" in html and html.count("<svg") == 1 and "arm_2_joint.viscous" in html
    assert main(command) == 2
    assert "the file exists" in capsys.readouterr().err


def test_the_printed_command_shows_what_the_correction_changes(
    truth: Robot, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """The old model errs on the identified robot as it errs on the true one; the new one does not."""
    monkeypatch.chdir(tmp_path)
    csv_of(simulated(truth, 30.0, 0.02), Path("log.csv"))
    assert main(["identify", "log.csv", "--robot", "two_axis_arm", "--base", "fixed"]) == 0
    (line,) = (line for line in capsys.readouterr().out.splitlines() if line.startswith("  mmnn run "))
    assert main([*shlex.split(line)[1:], "--json"]) == 0
    runs = json.loads(capsys.readouterr().out)["runs"]
    key = "e.arm_1_joint.rms_2_10"
    old, new = (runs[name]["metrics"][key] for name in ("nominal", "computed_torque"))
    loop = load_experiment("track", ["robot='two_axis_arm'", "nominal.masses=1.0", "nominal.friction=true"])
    errs = loop.loop(truth, loop.controller("nominal", robot=load("two_axis_arm"))).run().errors(start=2.0)
    assert old == pytest.approx(errs["arm_1_joint"].rms, rel=0.1) and new < 0.2 * old


def test_a_fit_that_is_worse_writes_nothing(urdf: Robot, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The URDF is the truth, and the training is of another load: the fit cannot win."""
    fit, test = simulated(urdf.with_masses({"arm_2_joint": 3.0}), 20.0, 0.02), simulated(urdf, 20.0, 0.0, seed=3)
    assert not identify(urdf, fit, held_out=test).better
    paths = [csv_of(log, tmp_path / f"{name}.csv") for name, log in (("fit", fit), ("test", test))]
    words = [
        "identify",
        str(paths[0]),
        "--held-out",
        str(paths[1]),
        "--robot",
        "two_axis_arm",
        "--out",
        str(tmp_path / "o"),
    ]
    assert main(words) == 1
    assert "nothing written" in capsys.readouterr().err and not (tmp_path / "o").exists()


def test_efforts_that_no_robot_has_are_not_believed(
    truth: Robot, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Currents of unlike motors, taken for torques: what the second link asks of the first joint cannot be."""
    log = simulated(truth, 30.0, 0.02)
    motors = list(log.effort)
    currents = replace(log, effort={motors[0]: log.effort[motors[0]] / 40.0, motors[1]: log.effort[motors[1]] * 3.0})
    file = csv_of(currents, tmp_path / "currents.csv")
    assert main(["identify", str(file), "--robot", "two_axis_arm", "--out", str(tmp_path / "o")]) == 1
    err = capsys.readouterr().err
    assert "--torque-constant" in err and not (tmp_path / "o").exists()
    (advice,) = re.findall(r"--mend 'effort[^']*'", err)
    without = ["--out", str(tmp_path / "p"), *shlex.split(advice)]
    assert main(["identify", str(file), "--robot", "two_axis_arm", *without]) == 0
    words = ["--torque-constant", f"{motors[0]}=40", "--torque-constant", f"{motors[1]}={1 / 3}"]
    assert main(["identify", str(file), "--robot", "two_axis_arm", "--out", str(tmp_path / "o"), *words]) == 0


def test_bad_input_is_one_line_and_exit_code_2(
    truth: Robot, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    log = simulated(truth, 10.0)
    still = log.with_signals(
        log.signals | {k: np.full_like(v, 0.1) for k, v in log.signals.items() if "effort" not in k}
    )
    bad = {
        "missing": tmp_path / "none.csv",
        "names": csv_of(replace(log, position={"leg": log.time}, velocity={}), tmp_path / "names.csv"),
        "short": csv_of(log.rows(slice(0, 50)), tmp_path / "short.csv"),
        "still": csv_of(still, tmp_path / "still.csv"),
        "zero": csv_of(replace(log, effort={k: 0 * v for k, v in log.effort.items()}), tmp_path / "zero.csv"),
        "nan": csv_of(replace(log, effort={k: np.nan * v for k, v in log.effort.items()}), tmp_path / "nan.csv"),
        "shuffled": csv_of(log.rows(np.random.default_rng(0).permutation(1000)), tmp_path / "shuffled.csv"),
        "solver": csv_of(log, tmp_path / "sound.csv"),
    }
    for name, path in bad.items():
        if name == "solver":
            monkeypatch.setattr("cvxpy.Problem.solve", lambda self, **how: setattr(self, "_status", "infeasible"))
        code = main(["identify", str(path), "--robot", "two_axis_arm", "--out", str(tmp_path / "out")])
        said = capsys.readouterr()
        assert code == (1 if name == "solver" else 2), name
        assert said.out == "" and said.err.count("\n") == 1 and "error:" in said.err, (name, said.err)
        assert not (tmp_path / "out").exists()


LIFT = """<robot name="lift"><link name="base"/>
<link name="carriage"><inertial><origin xyz="0.1 0 0"/><mass value="4"/>
<inertia ixx="0.05" ixy="0" ixz="0" iyy="0.05" iyz="0" izz="0.05"/></inertial></link>
<link name="turn"><inertial><origin xyz="0.2 0 0"/><mass value="2"/>
<inertia ixx="0.02" ixy="0" ixz="0" iyy="0.02" iyz="0" izz="0.03"/></inertial></link>
<joint name="lift" type="prismatic"><parent link="base"/><child link="carriage"/><axis xyz="0 0 1"/>
<limit lower="0" upper="1" effort="500" velocity="2"/><dynamics damping="0.8"/></joint>
<joint name="waist" type="revolute"><parent link="carriage"/><child link="turn"/><axis xyz="0 0 1"/>
<limit lower="-3" upper="3" effort="50" velocity="5"/><dynamics damping="0.3"/></joint></robot>"""


def test_a_lift_has_its_weight_in_its_mass_and_not_in_a_constant(tmp_path: Path) -> None:
    """A constant effort and the weight of a lift are one force; a URDF can hold the weight alone."""
    (tmp_path / "lift.urdf").write_text(LIFT)
    robot = load(tmp_path / "lift.urdf")
    path = Trajectory.of(robot, arm={"lift": Sine(0.1, 1.9, offset=0.4), "waist": Sine(0.8, 1.3)})
    run = Loop(robot.with_masses({"lift": 1.4}), path, PD(), timing=Timing(duration=6.0)).run()
    found = identify(robot, run)
    theta = dict(zip(found.unknowns.labels, found.theta, strict=True))
    assert found.unknowns.weighed.tolist() == [True, False]
    assert theta["lift.offset"] == 0.0 and abs(theta["lift.m"] + theta["waist.m"] - (1.4 * 4.0 + 2.0)) < 0.05
    assert found.error("urdf_file") < 0.01 < found.error("urdf") and found.better


def test_a_fit_that_a_urdf_cannot_hold_is_not_better(found: Identification) -> None:
    assert found.better and found.helps_in_urdf
    other = replace(found)
    other.__dict__["in_urdf"] = 3.0 * found.unknowns.prior
    assert not other.helps_in_urdf and not other.better
    held, before = (percent(other.error(model)) for model in ("urdf_file", "urdf"))
    assert f"predicts no better ({held}) than the URDF ({before}); what helps are constants" in why_nothing(other)
    assert f"of what a URDF can hold of it {held}: NOT better than both the URDF ({before})" in headline(
        report_of(other)
    )
    assert "better than the URDF" in headline(report_of(found))


def test_a_base_that_steers_is_refused_by_name() -> None:
    """One line says what can be done, for logs, loads and the search for a motion; its arm alone is taken."""
    robot = load("car_arm")
    for ask in (lambda: identify(robot, "no.csv"), lambda: payload(robot, []), lambda: excite(robot)):
        with pytest.raises(RobotError, match=r"'car_arm' cannot be identified: .*car_like.* steers.*--base fixed"):
            ask()
    assert load("car_arm", base="fixed").dimensions.base == 0

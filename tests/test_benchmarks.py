"""The benchmark runs and says what it promises; what it gives to the peers is the thesis's robot and law."""

import json
import subprocess
import sys

import numpy as np
import pinocchio as pin
import pytest
from places import ROOT

from mmnn_pin import load
from mmnn_pin.model.dynamics import Dynamics

FOLDER = ROOT / "benchmarks"


@pytest.fixture
def modules(monkeypatch):
    monkeypatch.syspath_prepend(str(FOLDER))
    import numpy_law
    import report
    import run
    import workload

    return {"numpy_law": numpy_law, "report": report, "run": run, "workload": workload}


def test_quick_prints_the_keys_of_the_contract_as_json(modules):
    command = [sys.executable, str(FOLDER / "run.py"), "--json", "--quick"]
    done = subprocess.run(command, capture_output=True, text=True, check=True, timeout=300)
    result = json.loads(done.stdout)
    assert {"loop", "compiled", "plain_python", "tiago_compiled"} <= set(result["us_per_step"])
    assert all(us > 0 for us in result["us_per_step"].values())
    assert result["robots"]["tiago_compiled"]["robot"]
    assert all(rate > 0 for rate in result["rollouts_per_s"].values()) and result["rollouts_per_s"]
    assert {"mujoco_numpy", "drake", "pybullet", "jiminy"} <= set(result["peers"])
    assert all("us_per_step" in peer or peer["skipped"] for peer in result["peers"].values())
    assert {"python", "numpy", "numba", "pin"} <= set(result["versions"])
    assert "plain_python/loop" in result["ratios"]
    text = modules["report"].table(result)
    assert "plain_python" in text and "pybullet" in text


def test_peers_robot_has_the_reduced_dynamics_of_the_thesis_robot():
    robot, peer = load("platform_arm"), pin.buildModelFromUrdf(str(FOLDER / "planar_arm.urdf"))
    data, dynamics = peer.createData(), Dynamics(robot)
    rng = np.random.default_rng(3)
    for _ in range(5):
        position, nu = rng.uniform(-2, 2, robot.dimensions.full), rng.uniform(-2, 2, robot.dimensions.dof)
        q = np.concatenate((position[:3], position[robot.arm_index]))
        c, s, w = np.cos(q[2]), np.sin(q[2]), nu[1]
        T = np.array([[c, 0, 0, 0], [s, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]], float)
        Tdot = w * np.array([[-s, 0, 0, 0], [c, 0, 0, 0], *np.zeros((3, 4))])
        M = pin.crba(peer, data, q)
        C = pin.computeCoriolisMatrix(peer, data, q, T @ nu)
        np.testing.assert_allclose(T.T @ M @ T, dynamics.mass_matrix(position), rtol=1e-6, atol=1e-5)
        reduced = T.T @ (M @ Tdot + C @ T)
        np.testing.assert_allclose(reduced @ nu, dynamics.coriolis_matrix(position, nu) @ nu, rtol=1e-5, atol=1e-5)


def test_peers_law_gives_the_torques_of_ours(modules):
    work = modules["workload"].peer_work(0.02)
    law, worst = modules["numpy_law"].Controller(work), 0.0
    for i, (pose, q, nu, torque) in enumerate(zip(work["pose"], work["q"], work["nu"], work["torque"], strict=True)):
        worst = max(worst, np.abs(law.torque(i, pose, q, nu) - torque).max() / np.abs(torque).max())
    assert worst < 1e-12


def test_exponent_of_a_power_law(modules):
    assert modules["run"].exponent({n: 0.3 * n**1.7 for n in (6, 20, 60)}) == pytest.approx(1.7)
    assert modules["run"].exponent({6: 1.0}) is None


def test_what_cannot_run_is_asked_once(modules):
    calls = {"a": 0, "b": 0}

    def ask(name, answer):
        def once():
            calls[name] += 1
            return answer

        return once

    asks = {"a": ask("a", {"wall": 1.0}), "b": ask("b", {"skipped": "not installed"})}
    samples = modules["run"].in_turn(asks, 3)
    assert calls == {"a": 4, "b": 1} and len(samples["a"]) == 3 and samples["b"] == [{"skipped": "not installed"}]


def test_reading_makes_a_file_that_is_understood_and_times_it(monkeypatch, tmp_path, capsys):
    monkeypatch.syspath_prepend(str(FOLDER))
    import reading

    file = tmp_path / "made.urdf"
    file.write_text(reading.made(20_000))
    robot = load(file)
    assert robot.base.kind == "differential_drive" and robot.dimensions.arm == 7 and not robot.findings
    monkeypatch.setattr(sys, "argv", ["reading.py", str(file), "--repetitions", "2", "--json"])
    reading.main()
    result = json.loads(capsys.readouterr().out)
    assert result["bytes"] == file.stat().st_size >= 20_000
    assert 0 < result["audit"]["min"] <= result["audit"]["median"] and result["both"]["min"] > 0
    monkeypatch.setattr(sys, "argv", ["reading.py", "--repetitions", "1"])
    reading.main()
    assert "understanding" in capsys.readouterr().out


def test_ratios_of_a_result_are_kept_and_plotted(modules, monkeypatch, tmp_path):
    import history

    us = {"loop": 12.0, "compiled": 3.0}
    result = {
        "us_per_step": us,
        "us_per_step_file": {"compiled": 3.6},
        "us_per_step_whole_run": {"compiled": 4.5},
        "rollouts_per_s": {"same_1_thread": 60.0, "same_all_threads": 110.0, "masses_all_threads": 88.0},
        "floor": {"us_per_step": {"cpp": 4.0}, "rollouts_per_s": {"cpp_all_threads": 100.0}},
        "machine": {"processor": "some", "load_before_after": [0.1, 0.2]},
    }
    assert history.ratios(result) == pytest.approx(
        {
            "file/memory": 1.2,
            "compiled/floor": 0.75,
            "loop/compiled": 4.0,
            "whole/compiled": 1.5,
            "rollouts/floor": 1.1,
            "masses/same": 0.8,
            "threads/thread": 110 / 60,
        }
    )
    without = result | {"floor": {}, "rollouts_per_s": {}}
    assert set(history.ratios(without)) == {"file/memory", "loop/compiled", "whole/compiled"}
    for one in (without, result):
        history.append(tmp_path / "kept.jsonl", one)
    monkeypatch.setattr(sys, "argv", ["history.py", str(tmp_path / "kept.jsonl"), "--out", str(tmp_path / "plot.svg")])
    history.main()
    assert "times the C++ floor" in (tmp_path / "plot.svg").read_text()
    assert len((tmp_path / "kept.jsonl").read_text().splitlines()) == 2


def test_an_installation_is_measured_by_what_each_dependency_alone_brings(monkeypatch, tmp_path):
    def package(name, size, *requires, extras=()):
        files = [f"fake_{name}.py", f"fake_{name}-1.dist-info/METADATA"]
        (tmp_path / f"fake_{name}-1.dist-info").mkdir()
        (tmp_path / files[0]).write_bytes(b"#" * size)
        lines = ["Metadata-Version: 2.1", f"Name: fake_{name}", "Version: 1"]
        lines += [f"Provides-Extra: {extra}" for extra in extras] + [f"Requires-Dist: {one}" for one in requires]
        (tmp_path / files[1]).write_text("\n".join(lines) + "\n")
        (tmp_path / f"fake_{name}-1.dist-info" / "RECORD").write_text("".join(f"{file},,\n" for file in files))

    M = 1_000_000
    plot, both = 'fake_plot; extra == "plot"', 'fake_robot[plot]; extra == "all"'
    package("robot", M, "fake_solver>=1", "fake_reader[full]", plot, both, extras=("plot", "all"))
    package("solver", 2 * M, "fake_shared", "fake_matrices")
    package("matrices", 3 * M)
    package(
        "reader", 4 * M, "fake_shared", 'fake_fast; extra == "full"', 'fake_never; extra == "other"', extras=("full",)
    )
    package("shared", 5 * M, 'fake_absent; python_version < "3"')
    package("fast", 6 * M)
    package("plot", 7 * M, "fake_solver", "fake_missing")
    monkeypatch.syspath_prepend(str(FOLDER))
    monkeypatch.syspath_prepend(str(tmp_path))
    import install

    result = install.measured("fake_robot")
    assert result["total_mb"] == pytest.approx(20, abs=0.1)
    assert result["dependencies"] == {
        "fake-reader": {"own_mb": 4.0, "only_it_brings_mb": 10.0},  # with `fast`, without what `solver` needs, too
        "fake-solver": {"own_mb": 2.0, "only_it_brings_mb": 5.0},
    }
    assert result["extras_mb"] == {"plot": 7.0, "all": 7.0} and result["not_installed"] == ["fake-missing"]
    assert "fake-missing" in install.table(result)

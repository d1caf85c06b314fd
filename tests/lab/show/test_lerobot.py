"""LeRobot datasets: pandas alone reads of a written one what the recording has; logs are read back, others refused."""

from __future__ import annotations

import json

import numpy as np
import pytest

from mmnn_pin import PD, Feedback, Line, Sine, Timing, Trajectory, load
from mmnn_pin.cli import main
from mmnn_pin.deploy.identify.reading import read_logs
from mmnn_pin.errors import ConfigError, RecordingError
from mmnn_pin.lab.show.export import export
from mmnn_pin.loop.loop import Loop

pandas = pytest.importorskip("pandas")
ROBOT = load("platform_arm")


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    path = Trajectory(Line(0.3), (Sine(0.5, 2.0), Sine(0.3, 1.0)))
    loop = Loop(ROBOT, path, PD(Feedback(200.0, 3.0)), timing=Timing(duration=0.4), engine="ordinary")
    return loop.run(tmp_path_factory.mktemp("runs") / "pd.h5")


def test_a_dataset_is_what_lerobots_readers_expect(run, tmp_path):
    """Files, columns and indices of v3.0, read by pandas; values are the recording's as float32."""
    folder = export(run, tmp_path / "pd", "lerobot", rate=50.0)
    info = json.loads((folder / "meta/info.json").read_text())
    frames = pandas.read_parquet(folder / info["data_path"].format(chunk_index=0, file_index=0))
    every, count = 10, len(frames)
    assert info["codebase_version"] == "v3.0" and info["fps"] == 50 and info["total_frames"] == count == 20
    assert set(frames) == set(info["features"])
    for name, about in info["features"].items():
        first = frames[name][0]
        assert about["shape"] == [len(first)] if name.startswith(("observation", "action")) else [1]
    np.testing.assert_allclose(frames["timestamp"], np.arange(count) / 50.0, atol=1e-6)
    assert (frames["index"] == np.arange(count)).all() and (frames["episode_index"] == 0).all()
    names = info["features"]["observation.state"]["names"]
    assert names == ["arm_1_joint.pos", "arm_2_joint.pos", "x.vel", "theta.vel"]
    state = np.stack(frames["observation.state"])
    np.testing.assert_array_equal(state, np.float32(np.hstack([run["q"], run["velocity"]])[::every]))
    np.testing.assert_array_equal(
        np.stack(frames["action"]), np.float32(np.hstack([run["q_ref"], run["velocity_ref"]])[::every])
    )
    tasks = pandas.read_parquet(folder / "meta/tasks.parquet")
    assert tasks.index.name == "task" and tasks["task_index"].tolist() == [0]
    episodes = pandas.read_parquet(folder / "meta/episodes/chunk-000/file-000.parquet").iloc[0]
    assert episodes["length"] == episodes["dataset_to_index"] == count and list(episodes["tasks"]) == [tasks.index[0]]
    stats = json.loads((folder / "meta/stats.json").read_text())["observation.state"]
    np.testing.assert_allclose(stats["mean"], np.hstack([run["q"], run["velocity"]])[::every].mean(axis=0))
    assert list(episodes["stats/observation.state/max"]) == pytest.approx(stats["max"])


def test_a_dataset_is_read_as_a_log(run, tmp_path):
    folder = export(run, tmp_path / "pd", "lerobot")
    (log,) = read_logs([folder], ROBOT)
    np.testing.assert_allclose(log.position["arm_2_joint"], run["q"][:, 1], atol=1e-6)
    np.testing.assert_allclose(log.velocity["arm_1_joint"], run["qdot"][:, 0], rtol=1e-6)
    np.testing.assert_allclose(log.base["base.w"], run["velocity"][:, 1], rtol=1e-6, atol=1e-7)
    np.testing.assert_allclose(log.effort["arm_1_joint"], run["motor_torque"][:, 2], rtol=1e-6, atol=1e-6)
    np.testing.assert_allclose(log.time, run.time - run.time[0], atol=1e-5)


def test_two_episodes_in_degrees_are_two_logs(run, tmp_path):
    """As LeRobot records hobby arms: degrees, no efforts unless a column has them."""
    folder = export(run, tmp_path / "pd", "lerobot", rate=50.0)
    file = folder / "data/chunk-000/file-000.parquet"
    frames = pandas.read_parquet(file)
    frames["observation.state"] = [np.rad2deg(row) for row in frames["observation.state"]]
    frames["episode_index"] = np.arange(len(frames)) // 10
    frames.to_parquet(file)
    first, second = read_logs([folder], ROBOT, degrees=True)
    assert len(first.time) == len(second.time) == 10 and "episode 1" in second.name
    np.testing.assert_allclose(second.position["arm_1_joint"], run["q"][::10][10:, 0], atol=1e-6)


def test_what_is_no_dataset_is_refused_in_a_line(run, tmp_path, capsys):
    with pytest.raises(ConfigError, match="--signals"):
        export(run, tmp_path / "a", "lerobot", signals=["q"])
    folder = export(run, tmp_path / "pd", "lerobot")
    with pytest.raises(RecordingError, match="exist"):
        export(run, folder, "lerobot")
    (folder / "meta/info.json").write_text("{}")
    with pytest.raises(RecordingError, match="no LeRobot dataset that can be read"):
        read_logs([folder], ROBOT)
    assert main(["export", str(run.path), "--to", "lerobot", "--rate", "50", "--out", str(tmp_path / "all")]) == 0
    assert (tmp_path / "all/pd.lerobot/meta/info.json").is_file() and "pd.lerobot" in capsys.readouterr().out

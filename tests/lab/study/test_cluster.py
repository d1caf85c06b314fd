"""Studies on a real Dask cluster: a scheduler in its own network, workers that die and join, no shared files."""

from __future__ import annotations

import contextlib
import re
import shutil
import signal
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

import msgspec
import pytest
import trimesh
from clusters import Cluster, network
from numba import config
from places import ROOT
from study_files import SHORT, numbers, planned, run_here, stored, written

from mmnn_pin.cli import main
from mmnn_pin.errors import MmnnError, StudyError
from mmnn_pin.lab.study import pools as dask
from mmnn_pin.lab.study import worker
from mmnn_pin.lab.study.execution import execute, fill, missing_trials, probe
from mmnn_pin.lab.study.store import NAME, writing
from mmnn_pin.lab.study.worker import Bundle
from mmnn_pin.model.robots import bundled

pytest.importorskip("distributed")

pytestmark = pytest.mark.skipif(config.DISABLE_JIT, reason="slow in plain Python")


@pytest.fixture(scope="module")
def cluster(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Cluster]:
    """A scheduler in a network of its own, one worker beside it, one outside; what they run was compiled before."""
    first = tmp_path_factory.mktemp("first")
    run_here(planned(first), first)
    with network() as within:
        made = Cluster(tmp_path_factory.mktemp("cluster"), within)
        try:
            for inside in (True, False):
                made.worker(inside)
            for log in made.folder.glob("worker*/log"):
                made.told(log, r"(Registered to)")
            yield made
        finally:
            made.stop()


@pytest.fixture
def study(tmp_path: Path) -> str:
    """A study of a robot whose wheels are meshes in a package, which tell their radius."""
    package = tmp_path / "elsewhere" / "my_robot"
    (package / "urdf").mkdir(parents=True)
    (package / "meshes").mkdir()
    trimesh.creation.cylinder(radius=0.075, height=0.04, sections=64).export(package / "meshes" / "wheel.stl")
    text, count = re.subn(
        r'<geometry><cylinder radius="0.075" length="0.04"/></geometry>',
        '<geometry><mesh filename="package://my_robot/meshes/wheel.stl"/></geometry>',
        bundled()["platform_arm"].read_text(),
    )
    assert count >= 2
    (package / "urdf" / "mine.urdf").write_text(text)
    text = SHORT.replace("points = 4", "points = 16").replace("0.04", "0.1")
    return text.replace("[set]\n", f'[set]\nrobot = "{package}/urdf/mine.urdf"\n')


@pytest.mark.long
def test_a_cluster_gives_the_local_rows_while_workers_die_and_join(
    cluster: Cluster, study: str, tmp_path: Path
) -> None:
    here = planned(tmp_path / "here", study)
    local = run_here(here, tmp_path / "here")
    plan = planned(tmp_path / "there", study)
    assert len(list(plan.fingerprints)) == 96
    assert any(name.endswith(".stl") for bundle in plan.bundles.values() for name in bundle.files)
    victims = [cluster.processes[2]]

    def kill(done: object) -> None:
        if len(seen) == 10:
            victims[0].send_signal(signal.SIGKILL)
            cluster.worker()
            cluster.told(cluster.folder / f"worker{len(cluster.processes) - 1}" / "log", "(Registered to)")
        seen.append(done)

    seen: list[object] = []
    far = run_far(plan, tmp_path / "there", cluster.address, kill)
    assert victims[0].wait(10) == -signal.SIGKILL
    assert [row.id for row in far] == list(range(96)) and len(seen) == 96
    assert numbers(far) == numbers(local)


def run_far(plan, folder: Path, address: str, progress: Callable[[object], None]):
    """Make a study's rows on a cluster, its robot's files gone from this machine as soon as they were read."""
    with writing(folder / NAME) as store, dask.cluster(address) as pool:
        missing = missing_trials(store, plan, probe(plan), False)
        package = Path(plan.base.robot).parents[1]
        package.rename(package.with_name("gone"))
        fill(store, plan, missing, pool, progress)
    return stored(folder)


def test_the_command_line_runs_a_study_on_a_cluster(cluster: Cluster, tmp_path: Path, capsys) -> None:
    file = written(tmp_path / "there")
    assert main(["study", str(file), "--out", str(tmp_path / "there"), "--cluster", cluster.address]) == 0
    said = capsys.readouterr()
    assert f"24 runs, on the cluster at {cluster.address}" in said.err and "Traceback" not in said.err
    assert "open to whoever reaches it: `mmnn docs how-to/cluster`" in said.err
    assert main(["docs", "how-to/cluster"]) == 0
    local = run_here(planned(tmp_path / "here"), tmp_path / "here")
    assert numbers(stored(tmp_path / "there")) == numbers(local)


@contextlib.contextmanager
def holding(files: tuple[Path, Path] | None) -> Iterator[None]:
    """This machine holds a certificate and its key, and speaks to nobody without TLS; None holds nothing."""
    import dask as settings

    cert, key = files or (None, None)
    tls = {"ca-file": cert, "client.cert": cert, "client.key": key}
    given = {f"distributed.comm.tls.{name}": file and str(file) for name, file in tls.items()}
    with settings.config.set(given | {"distributed.comm.require-encryption": True}):
        yield


def certificate(folder: Path, name: str) -> tuple[Path, Path]:
    """A certificate and its key, made as docs/how-to/cluster.md says."""
    (folder / name).mkdir()
    command = re.search(r"^    (openssl req .*)$", (ROOT / "docs/how-to/cluster.md").read_text(), re.M)
    assert command is not None
    subprocess.run(command[1].split(), cwd=folder / name, check=True, capture_output=True)
    return folder / name / "cert.pem", folder / name / "key.pem"


@pytest.mark.skipif(shutil.which("openssl") is None, reason="no openssl here to make certificates: apt install openssl")
def test_a_cluster_with_tls_lets_in_who_holds_its_certificate_and_nobody_else(tmp_path: Path, capsys) -> None:
    cert, key = certificate(tmp_path, "ours")
    tls = ("--protocol", "tls", "--tls-ca-file", str(cert), "--tls-cert", str(cert), "--tls-key", str(key))
    (tmp_path / "cluster").mkdir()
    made = Cluster(tmp_path / "cluster", None, tls)
    try:
        assert made.address.startswith("tls://")
        worker = made.worker()
        made.told(made.folder / "worker1" / "log", "(Registered to)")
        file = written(tmp_path, SHORT.replace("points = 4", "points = 1"))
        foreign = certificate(tmp_path, "foreign")

        def study(where: str, holds: tuple[Path, Path] | None, address: str) -> tuple[int, str]:
            with holding(holds):
                code = main(["study", str(file), "--out", str(tmp_path / where), "--cluster", address])
            return code, capsys.readouterr().err

        for holds, address, words in (
            (None, made.address, "use tls:// and name your certificates"),
            (foreign, made.address, "cannot be reached"),
            ((cert, key), made.address.replace("tls", "tcp"), "use tls:// and name your certificates"),
        ):
            code, said = study("none", holds, address)
            assert code == 2 and said.count("\n") == 1 and said.startswith("--cluster: error: ") and words in said, said
            assert not stored(tmp_path / "none")
        code, said = study("there", (cert, key), made.address)
        assert code == 0 and "whoever" not in said, said
        assert worker.poll() is None and len(stored(tmp_path / "there")) == 6
    finally:
        made.stop()


@pytest.mark.parametrize("end", [signal.SIGKILL, signal.SIGSTOP])
def test_a_scheduler_that_goes_away_or_says_nothing_is_told_and_loses_nothing(end, tmp_path: Path, monkeypatch) -> None:
    monkeypatch.setattr(dask, "SILENCE", 3.0)
    made = Cluster(tmp_path, None)
    try:
        plan = planned(tmp_path)
        with dask.cluster(made.address) as pool, pytest.raises(MmnnError, match="the same command goes on with what"):
            threading.Timer(1.0, made.processes[0].send_signal, (end,)).start()
            list(execute(pool, plan, [0]))
    finally:
        made.stop()


def test_a_process_that_found_no_scheduler_ends_at_once() -> None:
    """Dask's client waited 20 s for itself, and told so by a traceback."""
    told = (
        "import distributed; from mmnn_pin.lab.study.pools import connected; from mmnn_pin.errors import StudyError\n"
    )
    told += "import contextlib\nwith contextlib.suppress(StudyError): connected(distributed, 'inproc://x')\n"
    ended = subprocess.run([sys.executable, "-c", told + "print('tried', flush=True)"], capture_output=True, text=True)
    assert (ended.stdout, ended.stderr, ended.returncode) == ("tried\n", "", 0)


def test_a_scheduler_that_cannot_be_reached_is_told(tmp_path: Path, capsys, monkeypatch) -> None:
    monkeypatch.setattr(dask, "TIMEOUT", 1.0)
    file = written(tmp_path)
    for address, words in {
        "tcp://127.0.0.1:1": "the scheduler at tcp://127.0.0.1:1 cannot be reached",
        "nowhere": "'nowhere' is no address: missing port",
        "foo://10.0.0.1:8786": "'foo://10.0.0.1:8786' is no address: unknown address scheme",
    }.items():
        assert main(["study", str(file), "--out", str(tmp_path), "--cluster", address]) == 2
        said = capsys.readouterr().err
        assert words in said and said.startswith("--cluster: error:") and said.count("\n") == 1


def test_a_scheduler_or_a_worker_with_other_versions_is_told() -> None:
    ours = dask.installed()
    dask.require_alike({"scheduler": ours, "tcp://w": ours})
    for name, theirs, words in (
        ("scheduler", {"distributed": "2024.1.0"}, "the scheduler has distributed 2024.1.0, this machine 20"),
        ("tcp://w", {"python": "3.9"}, f"the worker at tcp://w has python 3.9, this machine {ours['python']}: install"),
        ("tcp://w", {"code of mmnn_pin": "0"}, "the worker at tcp://w has code of mmnn_pin 0, this machine"),
    ):
        with pytest.raises(StudyError) as raised:
            dask.require_alike({"scheduler": ours} | {name: ours | theirs})
        assert words in str(raised.value)
    with pytest.raises(StudyError, match="the worker at tcp://w cannot run mmnn_pin: ModuleNotFoundError: none"):
        dask.require_alike({"tcp://w": ModuleNotFoundError("none")})


def test_a_worker_that_joins_later_judges_itself(tmp_path: Path, monkeypatch) -> None:
    task = planned(tmp_path).trial(0)
    with pytest.raises(StudyError, match="runs other code of mmnn_pin than this machine"):
        worker.run(replace(task, code="other"))
    monkeypatch.setattr(worker.importlib.util, "find_spec", lambda module: None)
    contact = replace(task, experiment=msgspec.structs.replace(task.experiment, plant="contact"))
    with pytest.raises(
        StudyError, match=r"has no mujoco: the contact plant needs it: pip install 'mmnn_pin\[contact\]'"
    ):
        worker.run(contact)


def test_without_dask_it_is_said_how_to_get_it(tmp_path: Path, capsys, monkeypatch) -> None:
    monkeypatch.setitem(sys.modules, "distributed", None)
    assert main(["study", str(written(tmp_path)), "--out", str(tmp_path), "--cluster", "tcp://127.0.0.1:8786"]) == 2
    assert "no cluster without dask.distributed" in (said := capsys.readouterr().err)
    assert "pip install 'mmnn_pin[cluster]'" in said


def test_a_bundle_is_the_same_robot_without_its_folder(study: str, tmp_path: Path) -> None:
    robot = re.search(r'robot = "(.*)"', study)
    assert robot is not None
    plan = planned(tmp_path, study)
    bundle = Bundle.of(robot[1], plan.base.overrides)
    again = Bundle.of(robot[1], plan.base.overrides)
    assert bundle.digest == again.digest and set(bundle.files) == {"mine.urdf", "meshes/0.stl"}
    shutil.rmtree(tmp_path / "elsewhere")
    loaded = bundle.load()
    assert [wheel.radius for wheel in loaded.base.wheels] == pytest.approx([0.075, 0.075], rel=1e-3)

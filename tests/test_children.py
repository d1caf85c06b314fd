"""Processes of ours run nothing that lies where one stands, and end with a parent that is killed."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from functools import partial
from importlib.metadata import packages_distributions
from importlib.util import find_spec
from pathlib import Path

import pytest
from places import ROOT
from study_files import SHORT

from mmnn_pin.lab.study.pools import processes

NAMES = {*sys.stdlib_module_names, *packages_distributions(), "mmnn_pin", "sitecustomize", "usercustomize"}
PLANT = "import os\nopen({marker!r}, 'a').write(__name__ + '\\n')\nos._exit(0)\n"
BEGIN = """
import sys
from pathlib import Path
import mmnn_pin as mm
"""
KINDS = {
    "study": """
from mmnn_pin.lab.study.pools import number_of, processes
with processes(1) as pool:
    assert pool.executor.submit(number_of, 3).result() == 3
""",
    "xacro": """
from mmnn_pin.model.urdf.expansion import expand
assert b"<link" in expand(Path(sys.argv[1]) / "one.xacro").data
""",
    "live view": """
from mmnn_pin.lab.show.live import LiveView
with mm.Stepper(mm.load("platform_arm"), mm.PD()) as stepper, LiveView(stepper, port=0) as view:
    assert view.url.startswith("http://127.0.0.1")
""",
}
XACRO = '<robot name="one" xmlns:xacro="http://www.ros.org/wiki/xacro"><link name="${\'base\'}"/></robot>'


def plant(folder: Path, marker: Path, names: set[str] = NAMES) -> None:
    """A file for each module that a process may import."""
    for name in names:
        (folder / f"{name}.py").write_text(PLANT.format(marker=str(marker)))


def python(script: Path, *arguments: str, cwd: Path) -> subprocess.CompletedProcess[str]:
    """A script of the user, as `mmnn` is one: Python looks for modules beside it, not in the current folder."""
    variables = os.environ | {"NUMBA_DISABLE_JIT": "1", "PYTHONPATH": str(ROOT)}
    command = [sys.executable, str(script), *arguments]
    return subprocess.run(command, cwd=cwd, env=variables, capture_output=True, text=True, timeout=300)


@pytest.mark.parametrize("kind", KINDS)
def test_a_process_runs_nothing_that_lies_in_the_current_folder(kind: str, tmp_path: Path) -> None:
    own, strange, marker = tmp_path / "own", tmp_path / "strange", tmp_path / "marker"
    own.mkdir()
    strange.mkdir()
    plant(strange, marker)
    (own / "one.xacro").write_text(XACRO)
    body = "\n    ".join(KINDS[kind].strip().splitlines())
    (own / "script.py").write_text(f"{BEGIN}\nif __name__ == '__main__':\n    {body}\n    print('done')\n")
    done = python(own / "script.py", str(own), cwd=strange)
    assert not marker.exists(), marker.read_text()
    assert done.stdout.strip().endswith("done"), done.stderr


STANDING = """
import sys
from mmnn_pin.cli import main
if __name__ == "__main__":
    for words in sys.argv[1:]:
        assert main(words.split()) == 0
"""


def test_what_libraries_read_where_one_stands_is_not_read(tmp_path: Path) -> None:
    """Numba's settings and matplotlib's: here one is no YAML, and the other keeps one waiting for ever."""
    (tmp_path / "own").mkdir()
    (tmp_path / "own" / "mmnn").write_text(STANDING)
    (tmp_path / "short.toml").write_text(SHORT.replace("points = 4", "points = 1"))
    (tmp_path / ".numba_config.yaml").write_text("[[[ : {")
    os.mkfifo(tmp_path / "matplotlibrc")
    (tmp_path / "robot.xacro").write_bytes((ROOT / "urdf" / "platform_arm.urdf").read_bytes())
    runs = "run track --controller pd --set time.duration=0.004 --out r", "study short.toml --workers 2 --out s"
    done = python(tmp_path / "own" / "mmnn", "inspect robot.xacro", *runs, cwd=tmp_path)
    assert done.returncode == 0, done.stderr


def test_a_planted_module_would_have_run(tmp_path: Path) -> None:
    plant(tmp_path, tmp_path / "marker", {"struct"})
    subprocess.run([sys.executable, "-c", "import struct"], cwd=tmp_path, check=True)
    assert (tmp_path / "marker").read_text() == "struct\n"


def test_a_worker_finds_the_users_own_module_and_takes_no_other_from_beside_it(tmp_path: Path) -> None:
    """The parent has imported all that it needs before others lie there."""
    (tmp_path / "own_module.py").write_text("def twice(x):\n    return 2 * x\n")
    names = sorted(name for name in NAMES if name not in ("__main__", "distutils") and find_spec(name))
    assert len(names) > 300
    (tmp_path / "script.py").write_text(
        f"""
import sys
from mmnn_pin.lab.study.pools import processes
from own_module import twice
if __name__ == "__main__":
    for name in {names!r}:
        open(f"{tmp_path}/{{name}}.py", "w").write({PLANT.format(marker=str(tmp_path / "marker"))!r})
    with processes(1) as pool:
        print(pool.executor.submit(twice, 21).result())
"""
    )
    done = python(tmp_path / "script.py", cwd=tmp_path)
    assert (done.stdout.strip(), (tmp_path / "marker").exists()) == ("42", False), done.stderr


# -- a parent that is killed -------------------------------------------------------------------------------------------

WORKERS = """
import os, time
from mmnn_pin.lab.study.pools import processes
if __name__ == "__main__":
    with processes(2) as pool:
        waiting = [pool.executor.submit(time.sleep, 600) for _ in range(2)]
        print(*pool.executor._processes, flush=True)
        time.sleep(600)
"""
WATCHED = """
import os, sys, time
from mmnn_pin import children
parent = os.getpid()
if (child := os.fork()) == 0:
    sys.platform = "darwin"
    children.end_with(parent)
    time.sleep(600)
print(child, flush=True)
time.sleep(600)
"""


def is_alive(number: int) -> bool:
    """Whether a process runs; one that has ended and that nobody has asked after does not."""
    try:
        state = Path(f"/proc/{number}/stat").read_text().rsplit(")", 1)[1].split()[0]
    except OSError:
        return False
    return state != "Z"


def are_over(numbers: list[int], patience: float = 20.0) -> bool:
    """Whether processes end; those that do not are ended."""
    until = time.monotonic() + patience
    while any(map(is_alive, numbers)) and time.monotonic() < until:
        time.sleep(0.05)
    left = [number for number in numbers if is_alive(number)]
    for number in left:
        os.kill(number, signal.SIGKILL)
    return not left


@pytest.fixture
def started(tmp_path: Path) -> Iterator[list[subprocess.Popen[str]]]:
    """Processes that are ended after a test."""
    made: list[subprocess.Popen[str]] = []
    yield made
    for process in made:
        process.kill()
        process.communicate()


def start(tmp_path: Path, text: str, *arguments: str) -> subprocess.Popen[str]:
    """A script, begun."""
    (tmp_path / "script.py").write_text(text)
    variables = os.environ | {"PYTHONPATH": f"{ROOT}{os.pathsep}{tmp_path}"}
    command = [sys.executable, str(tmp_path / "script.py"), *arguments]
    heeds = partial(signal.signal, signal.SIGHUP, signal.SIG_DFL)  # also where the tests were started with nohup
    return subprocess.Popen(command, stdout=subprocess.PIPE, text=True, env=variables, preexec_fn=heeds)


@pytest.mark.skipif(sys.platform != "linux", reason="looks into /proc")
@pytest.mark.parametrize("end", [signal.SIGTERM, signal.SIGHUP, signal.SIGKILL])
@pytest.mark.parametrize("text", [WORKERS, WATCHED], ids=["workers", "watched"])
def test_a_parent_that_is_killed_takes_its_processes_along(text, end, tmp_path, started) -> None:
    started.append(process := start(tmp_path, text, "600"))
    assert process.stdout is not None
    numbers = [int(word) for word in process.stdout.readline().split()]
    assert numbers and all(map(is_alive, numbers))
    process.send_signal(end)
    assert are_over(numbers)


def test_nothing_of_theirs_is_waited_for_after_ctrl_c() -> None:
    with pytest.raises(KeyboardInterrupt), processes(1) as pool:
        waiting = pool.executor.submit(time.sleep, 600)
        numbers = list(pool.executor._processes)  # type: ignore[attr-defined]
        raise KeyboardInterrupt
    assert numbers and are_over(numbers, 0.0) and waiting.exception(0) is not None

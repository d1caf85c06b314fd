"""The package as a whole: names, versions, true documents, robots found wherever it is installed, import direction."""

from __future__ import annotations

import ast
import importlib.util
import inspect
import json
import os
import re
import subprocess
import sys
import textwrap
import tomllib
import types
from pathlib import Path

import numpy as np
import pytest
from places import ROOT

import mmnn_pin
from mmnn_pin import load_experiment, run_experiment
from mmnn_pin.cli import main
from mmnn_pin.kinematic import Kinematic
from mmnn_pin.loop.stepper import CALM
from mmnn_pin.recording.versions import commit

PACKAGE = ROOT / "mmnn_pin"
README = (ROOT / "README.md").read_text()
PAGES = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *sorted((ROOT / "docs").rglob("*.md"))]
EXAMPLES = sorted((ROOT / "examples").glob("*.py"))
# Examples and wheels are slow, and say nothing more when coverage is measured on uncompiled code.
compiled_only = pytest.mark.skipif(os.environ.get("NUMBA_DISABLE_JIT") == "1", reason="slow in plain Python")


def python(*arguments: str | Path, cwd: Path, **environment: str) -> str:
    """Standard output of a Python program in another folder."""
    command = [sys.executable, *map(str, arguments)]
    done = subprocess.run(command, cwd=cwd, env=os.environ | environment, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    return done.stdout


# -- names and versions -----------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", mmnn_pin.__all__)
def test_every_public_name_resolves_and_is_documented(name: str) -> None:
    thing = getattr(mmnn_pin, name)
    assert name in dir(mmnn_pin)
    if not name.startswith("__"):
        assert inspect.getdoc(thing)


def test_an_unknown_name_is_an_attribute_error() -> None:
    with pytest.raises(AttributeError, match="no_such_thing"):
        _ = mmnn_pin.no_such_thing


def test_versions_agree() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    cited = re.search(r"^version: (.*)$", (ROOT / "CITATION.cff").read_text(), re.M)
    assert project["version"] == mmnn_pin.__version__ == (cited and cited[1])


def git(folder: Path, *words: str) -> str:
    identity = ["-c", "user.name=t", "-c", "user.email=t@t"]
    return subprocess.run(
        ["git", "-C", str(folder), *identity, *words], check=True, capture_output=True, text=True
    ).stdout


def test_the_commit_of_a_clone_is_told_and_whether_its_files_are_changed(tmp_path: Path) -> None:
    package = tmp_path / "mmnn_pin"
    package.mkdir()
    assert commit(package) == ""  # neither a clone nor installed from one
    (package / "a.py").write_text("1\n")
    git(tmp_path, "init", "-q")
    git(tmp_path, "add", ".")
    git(tmp_path, "commit", "-qm", "one")
    head = git(tmp_path, "rev-parse", "HEAD").strip()
    git(tmp_path, "tag", "-am", "v1", "v1")
    assert commit(package) == head
    (package / "untracked.py").write_text("")
    assert commit(package) == head
    (package / "a.py").write_text("2\n")
    assert commit(package) == f"{head}+changes"


def test_an_installation_from_a_repository_tells_what_its_installer_noted(tmp_path: Path, monkeypatch) -> None:
    noted = {"url": "https://x/y.git", "vcs_info": {"vcs": "git", "commit_id": "a1" * 20}}
    one = types.SimpleNamespace(read_text=lambda name: json.dumps(noted) if name == "direct_url.json" else None)
    monkeypatch.setattr("mmnn_pin.recording.versions.metadata.distribution", lambda name: one)
    assert commit(tmp_path / "mmnn_pin") == "a1" * 20


def test_the_command_line_and_recordings_tell_version_and_commit(capsys, monkeypatch) -> None:
    told = {"mmnn_pin": mmnn_pin.__version__, "commit": "c0" * 20}
    monkeypatch.setattr("mmnn_pin.recording.versions.versions", lambda: told)
    monkeypatch.setattr("mmnn_pin.recording.recorder.versions", lambda: told)
    assert main(["--version"]) == 0
    assert capsys.readouterr().out == f"mmnn, version {mmnn_pin.__version__} (commit {'c0' * 20})\n"
    changes = ["controllers=['pd']", "time.duration=0.004", "windows=[[0.0,0.004]]"]
    (run,) = run_experiment(load_experiment("track", changes), "track").values()
    assert run.meta["versions"] == told


def public_definitions() -> list[tuple[str, ast.AST]]:
    """Modules, public classes, functions and methods of the package, with their places."""
    found: list[tuple[str, ast.AST]] = []
    for file in sorted(PACKAGE.rglob("*.py")):
        where = str(file.relative_to(ROOT))
        tree = ast.parse(file.read_text())
        found.append((where, tree))
        for node in tree.body:
            if isinstance(node, ast.ClassDef | ast.FunctionDef) and not node.name.startswith("_"):
                found.append((f"{where}:{node.name}", node))
                inner = node.body if isinstance(node, ast.ClassDef) else []
                found += [
                    (f"{where}:{node.name}.{method.name}", method)
                    for method in inner
                    if isinstance(method, ast.FunctionDef) and not method.name.startswith("_")
                ]
    return found


def test_public_things_have_docstrings() -> None:
    without = [where for where, node in public_definitions() if not ast.get_docstring(node)]  # type: ignore[arg-type]
    assert [where for where in without if "Protocol" not in where] == []


# -- README, examples, docs -------------------------------------------------------------------------------------------


def blocks(language: str, page: str = README) -> list[str]:
    return re.findall(rf"^```{language}\n(.*?)^```", page, re.M | re.S)


def test_readme_shows_the_quickstart_as_it_is() -> None:
    source = (ROOT / "examples/quickstart.py").read_text()
    head, guard, body = source[source.index("from mmnn_pin") :].partition('if __name__ == "__main__":\n')
    assert guard and head + textwrap.dedent(body) in blocks("python")


def test_two_minutes_of_reading_lead_to_the_first_replay() -> None:
    """From README's first word to the end of what one must know to watch an own robot: 500 words take two minutes."""
    before, _, _ = README.partition("That is all there is to read before your first replay.")
    assert "mmnn run track --robot urdf/platform_arm.urdf && mmnn replay runs/track" in before and before != README
    assert len(before.split()) <= 500


def test_examples_run_only_where_they_are_the_program() -> None:
    """Processes that they start import them again."""
    for file in sorted((ROOT / "examples").rglob("*.py")):
        module = ast.parse(file.read_text())
        ours = {name.name for node in module.body for name in names_from(node)}
        loose = [ast.unparse(node) for node in module.body if runs_when_imported(node, ours)]
        assert loose == [], file.name


def names_from(node: ast.stmt) -> list[ast.alias]:
    """Names that a statement imports from the package."""
    return node.names if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("mmnn_pin") else []


def runs_when_imported(node: ast.stmt, ours: set[str]) -> bool:
    """Whether a statement of a module does more than import, define, or set a constant without a function of ours."""
    if isinstance(node, ast.If):
        return "__name__ == '__main__'" not in ast.unparse(node.test)
    if isinstance(node, ast.Assign | ast.AnnAssign):
        called = [ast.unparse(call.func) for call in ast.walk(node) if isinstance(call, ast.Call)]
        return any(re.split(r"\W", name)[0] in ours and name.split(".")[-1][0].islower() for name in called)
    is_text = isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant)
    return not is_text and not isinstance(node, ast.Import | ast.ImportFrom | ast.FunctionDef | ast.ClassDef)


@compiled_only
def test_the_loop_of_ones_own_reaches_what_it_is_asked_for(tmp_path: Path) -> None:
    printed = python(ROOT / "examples/own_loop.py", cwd=tmp_path)
    assert printed.startswith("completed after 4 s")
    numbers = [float(word) for word in re.findall(r"-?\d+\.\d*", printed.partition(":")[2])]
    np.testing.assert_allclose(numbers, [0.3, 0.2, 0.8, -0.5], atol=0.1)


def test_the_quickstart_prints_what_the_readme_says(tmp_path: Path) -> None:
    assert python(ROOT / "examples/quickstart.py", cwd=tmp_path) in blocks("text")


@pytest.mark.long
@compiled_only
def test_the_example_of_the_hand_draws_its_path(tmp_path: Path) -> None:
    assert python(ROOT / "examples/hand.py", cwd=tmp_path).startswith("completed; ")


def test_every_example_is_run_by_a_test() -> None:
    tests = "".join(
        file.read_text() for folder in ("tests", "research/tests") for file in (ROOT / folder).rglob("test_*.py")
    )
    assert [file.name for file in EXAMPLES if file.name not in tests] == []


@compiled_only
def test_the_first_run_shows_the_table_that_chapter4_prints(tmp_path: Path) -> None:
    program = "from mmnn_pin.cli import main; import sys; sys.exit(main(['run', 'chapter4', '--details']))"
    printed, _, _ = python("-c", program, cwd=tmp_path).partition("\nwrote ")
    page = (ROOT / "docs/thesis/first-run.md").read_text()
    shown = next(block for block in blocks("text", page) if "pose x [mm]" in block)
    real, at = printed.rstrip().splitlines(), 0
    parts = [part.splitlines() for part in shown.rstrip().split("\n...\n")]  # three dots stand for any lines
    assert len(parts) > 3 and sum(map(len, parts)) > 30
    for told in parts:
        at = next(i for i in range(at, len(real)) if alike(real[i], told[0]))
        assert at or told is parts[0]
        assert [line for line, other in zip(real[at:], told, strict=False) if not alike(line, other)] == []
        at += len(told)
    assert at == len(real)


def alike(one: str, other: str) -> bool:
    """Whether two lines have the same words and, within 2 %, the same numbers."""
    words = [[word.strip("()") for word in line.split()] for line in (one, other)]
    return len(words[0]) == len(words[1]) and all(
        float(a) == pytest.approx(float(b), rel=0.02)
        if all(re.fullmatch(r"\d+\.?\d*", word) for word in (a, b))
        else a == b
        for a, b in zip(*words, strict=True)
    )


def test_examples_are_short() -> None:
    most = {"own_law.py": 60, "on_a_base.py": 70}  # a whole learning law, a whole robot
    most |= {"lekiwi.py": 60, "turtlebot3.py": 60}  # a bus and back
    assert [f.name for f in EXAMPLES if len(f.read_text().splitlines()) > most.get(f.name, 40)] == []


LINK = re.compile(r"\[([^\]]*)\]\(([^)\s]+)\)")
FENCED = re.compile(r"^```.*?^```$", re.M | re.S)


def anchors(page: str) -> set[str]:
    """The anchors of a page's headings, as a git host and the site make them."""
    heads = re.findall(r"^#+ (.*)$", FENCED.sub("", page), re.M)
    return {re.sub(r"[^\w -]", "", LINK.sub(r"\1", head).lower()).replace(" ", "-") for head in heads}


def bad_links(document: Path, written: set[Path], text: str) -> list[str]:
    """Links of a page that lead nowhere in a clone, but for those to pages of the site that say `site`."""
    bad = []
    for words, link in LINK.findall(FENCED.sub("", text)):
        target, _, anchor = link.partition("#")
        there = (document.parent / target).resolve() if target else document
        if "://" in link or there in written:
            bad += [link] * (there in written and "site" not in words.split())
        elif not there.exists() or (anchor and anchor not in anchors(there.read_text("utf-8"))):
            bad.append(link)
    return bad


def test_links_lead_somewhere_in_a_clone_or_say_that_they_are_of_the_site() -> None:
    """Pages that the site's build writes are not in a clone; the build itself warns of other dead links."""
    written = {ROOT / line[1:] for line in (ROOT / ".gitignore").read_text().split() if line.startswith("/docs/")}
    assert ROOT / "docs/reference/python.md" in written
    pages = [page for page in PAGES if page not in written]
    found = {page.relative_to(ROOT).as_posix(): bad_links(page, written, page.read_text("utf-8")) for page in pages}
    assert {name: links for name, links in found.items() if links} == {}
    odd = "[a](README.md) [b](none.md) [c](README.md#nothing) [keys](docs/reference/python.md) "
    odd += "[keys, on the site](docs/reference/python.md) [d](README.md#what-you-can-do) [e](https://x.y)"
    assert bad_links(ROOT / "README.md", written, odd) == ["none.md", "README.md#nothing", "docs/reference/python.md"]


def test_the_page_on_controllers_knows_the_gain_k() -> None:
    page = (ROOT / "docs/tutorials/first-controller.md").read_text()
    assert f"K is `kinematic.K`, {Kinematic().K:g} 1/s (in a `Stepper` {CALM.K:g} 1/s)" in page


def test_documents_name_modules_and_commands_that_exist() -> None:
    from mmnn_pin.cli import mmnn

    beside = tomllib.loads((ROOT / "research/pyproject.toml").read_text())["project"]["entry-points"]
    commands = {*mmnn.commands, *beside["mmnn_pin.commands"]}
    for document in (page.read_text() for page in PAGES):
        for module in re.findall(r"`(?:mmnn_pin/)?((?:[a-z_]+/)*[a-z_]+\.(?:py|toml))`", document):
            folders = (PACKAGE, ROOT / "examples", ROOT / "research")
            assert (ROOT / module).exists() or any(any(folder.rglob(module)) for folder in folders), module
        for command in re.findall(r"(?<!/)\bmmnn ([a-z]+)\b", document):
            assert command in commands, command


# -- where the robots are found ---------------------------------------------------------------------------------------

ROBOTS = sorted(file.name for file in (ROOT / "urdf").glob("*.urdf"))
FIND = "import mmnn_pin; from mmnn_pin.model import bundled; print(mmnn_pin.__file__, *bundled().values(), sep='\\n')"


def test_robots_are_found_from_another_folder(tmp_path: Path) -> None:
    _, *robots = python("-c", FIND, cwd=tmp_path).split()
    assert [Path(robot).name for robot in robots] == ROBOTS
    assert all(Path(robot).is_file() for robot in robots)


@compiled_only
def test_a_wheel_brings_robots_experiments_and_types(tmp_path: Path) -> None:
    isolation = ["--no-build-isolation"] if importlib.util.find_spec("hatchling") else []
    python("-m", "pip", "wheel", ROOT, "--no-deps", *isolation, "-q", "-w", tmp_path / "wheels", cwd=tmp_path)
    (wheel,) = (tmp_path / "wheels").glob("*.whl")
    python("-m", "pip", "install", wheel, "--no-deps", "-q", "--target", tmp_path / "site", cwd=tmp_path)
    site = tmp_path / "site"
    here, *robots = python("-c", FIND, cwd=tmp_path, PYTHONPATH=str(site)).split()
    assert Path(here).is_relative_to(site)
    assert [Path(robot).name for robot in robots] == ROBOTS
    assert all(Path(robot).is_relative_to(site) for robot in robots)
    assert (site / "mmnn_pin/py.typed").exists() and (site / "mmnn_pin/lab/experiments/chapter4.toml").exists()
    assert not (site / "tests").exists()
    load = "from mmnn_pin import load, load_experiment; print(load(load_experiment('chapter4').robot).dimensions.dof)"
    assert python("-c", load, cwd=tmp_path, PYTHONPATH=str(site)).strip() == "4"
    names = python("-c", "from mmnn_pin.cli import main; main(['list'])", cwd=tmp_path, PYTHONPATH=str(site))
    assert "platform_arm" in names and "chapter4" in names

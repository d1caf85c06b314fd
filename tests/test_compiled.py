"""How compiled functions meet: by what name they are linked, and what stands in memory for large tuples."""

from __future__ import annotations

import copy
import importlib
import math
import os
import pickle
import subprocess
import sys
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numba import config, typeof
from numba._dispatcher import compute_fingerprint

from mmnn_pin import load_experiment
from mmnn_pin.actuator import STATES, motor_state
from mmnn_pin.by_address import by_address
from mmnn_pin.compiled import by_type, compiled, internal, linked
from mmnn_pin.compiled import folders as module
from mmnn_pin.compiled.folders import KEPT, cache_folder, source_key
from mmnn_pin.compiled.linking import OwnNames
from mmnn_pin.loop.hardware import MotorSide
from mmnn_pin.loop.latency import Transport
from mmnn_pin.loop.servo_model import Servos
from mmnn_pin.parts import Cube, Matrix, Vector, cube, layout_of, matrix, vector, views
from mmnn_pin.sensing import FrozenEncoders
from mmnn_pin.torque.controller import CompiledController
from mmnn_pin.torque.entries import CONTROLLERS

compiles = pytest.mark.skipif(config.DISABLE_JIT, reason="nothing is compiled")


@by_address
class Inner(NamedTuple):
    """A part with memory of its own."""

    first: bool
    values: np.ndarray


@by_address
class Outer(NamedTuple):
    """One of every kind of field, with what needs less than a word between the others."""

    on: bool
    cube: np.ndarray
    number: int
    off: bool
    share: float
    nothing: None
    inner: Inner
    pair: tuple[float, float]
    mixed: tuple[Any, ...]
    last: np.ndarray


@compiled
def read_all(o: Outer, out: np.ndarray) -> None:
    """Every number of the tuple, in order."""
    out[0], out[1], out[2], out[3] = 1.0 if o.on else 0.0, float(o.number), 1.0 if o.off else 0.0, o.share
    out[4], out[5], out[6] = 1.0 if o.inner.first else 0.0, o.pair[0], o.pair[1]
    out[7], out[8] = 1.0 if o.mixed[1].first else 0.0, o.mixed[0]
    k = 9
    if o.nothing is None:
        for i in range(o.cube.shape[0]):
            for j in range(o.cube.shape[1]):
                for n in range(o.cube.shape[2]):
                    out[k] = o.cube[i, j, n]
                    k += 1
    for array in (o.inner.values, o.mixed[1].values, o.last):
        for i in range(array.size):
            out[k] = array[i]
            k += 1


def whole(draw: Any) -> Outer:
    """A tuple of drawn numbers."""
    number = st.floats(-1e9, 1e9)
    rng = np.random.default_rng(draw(st.integers(0, 1000)))
    size = st.integers(0, 3)
    inner = [Inner(draw(st.booleans()), rng.normal(size=draw(size))) for _ in range(2)]
    cube = rng.normal(size=(draw(size), draw(size), draw(size)))
    pair, mixed = (draw(number), draw(number)), (draw(number), inner[1])
    on, n, off = draw(st.booleans()), draw(st.integers(-(2**62), 2**62)), draw(st.booleans())
    return Outer(on, cube, n, off, draw(number), None, inner[0], pair, mixed, rng.normal(size=draw(size)))


@given(st.data())
def test_compiled_code_reads_every_field_of_a_tuple_in_memory(data):
    o = whole(data.draw)
    expected = [o.on, o.number, o.off, o.share, o.inner.first, *o.pair, o.mixed[1].first, o.mixed[0]]
    expected += [*o.cube.ravel(), *o.inner.values, *o.mixed[1].values, *o.last]
    out = np.zeros(len(expected))
    read_all(o, out)
    np.testing.assert_array_equal(out, np.array(expected, float))


def test_an_array_that_changes_is_read_as_it_is_and_another_tuple_is_another():
    first = Inner(True, np.zeros(2))
    outer = Outer(True, np.zeros((1, 1, 1)), 3, False, 0.5, None, first, (1.0, 2.0), (3.0, first), np.zeros(1))
    out = np.zeros(15)
    read_all(outer, out)
    first.values[:] = 7.0
    read_all(outer, out)
    np.testing.assert_array_equal(out[10:14], 7.0)
    read_all(outer._replace(number=5), out)
    assert out[1] == 5.0


@pytest.mark.parametrize("again", [copy.copy, copy.deepcopy, lambda value: pickle.loads(pickle.dumps(value))])
def test_a_copy_stands_in_memory_of_its_own(again):
    value = Inner(True, np.arange(3.0))
    place = value.address
    other = again(value)
    assert type(other) is Inner and other.first is value.first
    np.testing.assert_array_equal(other.values, value.values)
    assert other.address != place


def test_threads_that_ask_at_once_get_one_place():
    with ThreadPoolExecutor(8) as pool:
        for _ in range(200):
            value = Inner(True, np.zeros(1))
            assert len({*pool.map(lambda _, value=value: value.address, range(8))}) == 1


@compiles
def test_a_field_that_is_no_number_of_a_known_kind_is_refused():
    with pytest.raises(KeyError):
        assert Inner("text", np.zeros(1)).address  # type: ignore[arg-type]


class One:
    """Has a class whose name and fields are those of another."""

    @by_address
    class Namesake(NamedTuple):
        """The one."""

        values: np.ndarray


class Other:
    """Likewise."""

    @by_address
    class Namesake(NamedTuple):
        """The other."""

        values: np.ndarray


def which(a: Any) -> float:
    """The number of the class."""
    return 1.0 if isinstance(a, One.Namesake) else 2.0


by_type(which, "a", lambda kind: first if kind is One.Namesake else second)


@internal
def first(a: Any) -> float:
    """Of one class."""
    return 1.0


@internal
def second(a: Any) -> float:
    """Of the other."""
    return 2.0


@linked
def asked(a: Any) -> float:
    """Calls what belongs to the class."""
    return which(a)


@compiled
def asked_through(a: Any) -> float:
    """Calls the linked one, by the name that it has for the class."""
    return asked(a)


@compiles
def test_classes_of_one_name_and_shape_are_not_taken_for_each_other():
    for kind, number in ((One.Namesake, 1.0), (Other.Namesake, 2.0), (One.Namesake, 1.0)):
        value = kind(np.zeros(1))
        assert asked_through.compile((typeof(value),))(value) == number  # type: ignore[attr-defined]


def test_what_may_stand_in_one_place_differs_in_its_parts():
    """Learners before one loop, and what may come first among the effects."""
    experiment = load_experiment("eight")
    robot, learners = experiment.load_robot(), {}
    for name in CONTROLLERS:
        if name.startswith("pd_effective"):  # a PD with the gains of a learner's run
            continue
        controller = experiment.controller(name, robot=robot)
        if isinstance(controller, CompiledController):
            loop = experiment.loop(robot, controller)  # which chooses rates that are left open
            learner = loop.controller.law(loop.context()).learner
            learners[type(learner)] = learner
    assert len(learners) > 6
    one, two, whole = np.zeros(1), np.zeros((1, 1)), np.zeros((1, 1), np.int64)
    states = motor_state(np.zeros((1, STATES)))
    servos = Servos(0.1, one, whole[0], two, whole[0], one, two, *[one] * 5, states, two, two)
    sensors = [FrozenEncoders(two, one), MotorSide(whole, states)]
    motors = [Transport(0.1, whole[0], two), servos]
    for group in (learners.values(), sensors, motors):
        assert len({compute_fingerprint(value) for value in group}) == len(group)


@compiled
def parts_written(values: np.ndarray, where: np.ndarray, out: np.ndarray) -> None:
    """Every number of three parts, which are changed as they are read."""
    a, b = vector(values, where[0], where[1]), matrix(values, where[2], where[3], where[4])
    c, k = cube(values, where[5], where[6], where[7], where[8]), 0
    for i in range(a.size):
        out[k], a[i], k = a[i], -a[i], k + 1
    for i in range(b.shape[0]):
        for j in range(b.shape[1]):
            out[k], b[i, j], k = b[i, j], b[i, j] + 1.0, k + 1
    for i in range(c.shape[0]):
        for j in range(c.shape[1]):
            for n in range(c.shape[2]):
                out[k], c[i, j, n], k = c[i, j, n], 2.0 * c[i, j, n], k + 1


@given(st.data())
def test_parts_of_a_flat_array_are_views_of_it(data):
    size = st.integers(0, 4)
    shapes = [tuple(data.draw(size) for _ in range(n)) for n in (1, 2, 3)]
    starts = [data.draw(st.integers(0, 10)) for _ in shapes]
    values = np.arange(100.0)
    wanted, read = values.copy(), []
    for start, shape, change in zip(starts, shapes, (np.negative, lambda x: x + 1.0, lambda x: 2.0 * x), strict=True):
        part = wanted[start : start + math.prod(shape)].reshape(shape)
        read.append(part.copy().ravel())
        part[:] = change(part)
    out, where = np.zeros(sum(map(len, read))), [n for i in range(3) for n in (starts[i], *shapes[i])]
    parts_written(values, np.array(where), out)
    assert np.array_equal(values, wanted) and np.array_equal(out, np.concatenate(read))


class Parts(NamedTuple):
    """What stands in a flat array."""

    a: Vector
    b: Matrix
    c: Cube


parts_of = views(Parts)


@compiled
def shapes_and_sums(values: np.ndarray, layout: np.ndarray, out: np.ndarray) -> None:
    """Shapes of the parts, and the sums of their numbers."""
    o = parts_of(values, layout)
    out[0], out[1], out[2] = o.a.shape[0], o.b.shape[0], o.b.shape[1]
    out[3], out[4], out[5] = o.c.shape[0], o.c.shape[1], o.c.shape[2]
    out[6], out[7], out[8] = o.a.sum(), o.b.sum(), o.c.sum()


def test_a_tuple_of_views_has_the_shapes_of_its_layout():
    shapes, values, out = {"c": (2, 3, 2), "a": (5,), "b": (3, 4)}, np.arange(29.0), np.zeros(9)
    shapes_and_sums(values, layout_of(Parts, shapes), out)
    assert out.tolist() == [5, 3, 4, 2, 3, 2, values[12:17].sum(), values[17:].sum(), values[:12].sum()]


@internal
def doubled(a: np.ndarray) -> float:
    """For compiled callers."""
    return 2.0 * a[0]


@compiled
def caller(a: np.ndarray) -> float:
    """One of them."""
    return doubled(a) + 1.0


def test_an_internal_function_can_be_called_from_python_too():
    assert caller(np.full(2, 3.0)) == 7.0
    assert doubled(np.full(2, 3.0)) == 6.0


@linked
def root(x: float) -> float:
    """Raises where there is none."""
    if x < 0.0:
        raise ValueError("negative")
    return x**0.5


@compiled
def twice_root(x: float) -> float:
    """Calls it by its address."""
    return 2.0 * root(x)


def test_what_a_linked_function_raises_reaches_the_caller():
    assert twice_root(9.0) == 6.0
    with pytest.raises(ValueError, match="negative"):
        twice_root(-1.0)


MODULE = """
from mmnn_pin.compiled import compiled, internal, linked

@internal
def low(x):
    return x + 1.0

@linked
def middle(x):
    return 10.0 * low(x)

@compiled
def high(x):
    return middle(x) + low(x)

@compiled
def highest(x):
    return 2.0 * high(x)
"""
SCRIPT = """
import part
print(part.high(1.0), [sum(f.stats.cache_misses.values()) for f in (part.high, part.middle, part.low)])
"""


@compiles
def test_code_from_the_cache_finds_what_it_is_linked_with(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    (tmp_path / "part.py").write_text(MODULE)
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path / "cache"))
    monkeypatch.syspath_prepend(tmp_path)

    def run(script: str = SCRIPT) -> str:
        path = {"PYTHONPATH": f"{tmp_path}:{Path(__file__).parents[1]}"}
        command = [sys.executable, "-c", script]
        done = subprocess.run(command, capture_output=True, text=True, env=os.environ | path, check=False)
        assert done.returncode == 0, done.stderr
        return done.stdout.strip()

    assert run() == "22.0 [1, 1, 1]"
    assert run() == "22.0 [0, 0, 0]"
    # linked code that is gone is compiled again, and what calls it finds it
    gone = list((tmp_path / "cache").rglob("part.low*.nb?"))
    assert gone
    for path in gone:
        path.unlink()
    assert run() == "22.0 [0, 0, 1]"
    # compiled on top of what came from the cache, it asks for what that needs when it comes from there itself
    top = "import part; print(part.highest(1.0), sum(part.highest.stats.cache_misses.values()))"
    assert [run(top), run(top)] == ["44.0 1", "44.0 0"]


@pytest.mark.skipif(config.DISABLE_JIT, reason="nothing is kept")
@pytest.mark.parametrize("moment", ["_save_index", "_save_data"])
def test_processes_that_compile_at_the_same_time_do_not_take_each_others_code(tmp_path, monkeypatch, moment):
    """Numba's own class fails this: both read an empty index, and take the file of number 1."""
    one, other = (OwnNames(str(tmp_path), "function", "stamp") for _ in range(2))
    goes_on = getattr(one, moment)

    def other_first(*arguments: Any) -> None:
        other.save("floats", "code for floats")
        goes_on(*arguments)

    monkeypatch.setattr(other, "_load_index", dict)
    monkeypatch.setattr(one, moment, other_first)
    one.save("integers", "code for integers")
    found = [OwnNames(str(tmp_path), "function", "stamp").load(key) for key in ("integers", "floats")]
    assert found[0] in (None, "code for integers") and found[1] in (None, "code for floats") and any(found)


@pytest.mark.skipif(config.DISABLE_JIT, reason="nothing is kept")
@pytest.mark.parametrize("kind", ["nbi", "nbc"])
@pytest.mark.parametrize("size", [0, 5, 12])
def test_a_file_that_was_cut_off_counts_as_none_and_is_written_anew(tmp_path, kind, size):
    files = OwnNames(str(tmp_path), "function", "stamp")
    files.save("floats", "code for floats")
    (path,) = tmp_path.glob(f"*.{kind}")
    os.truncate(path, size)
    assert files.load("floats") is None
    files.save("floats", "code for floats")
    assert files.load("floats") == "code for floats"


@pytest.mark.skipif(config.DISABLE_JIT, reason="nothing is kept")
def test_code_of_a_module_that_is_no_more_counts_as_none(tmp_path, monkeypatch):
    """As after an update that has taken a learner away: the index names the type of its numbers."""
    (tmp_path / "gone_learner.py").write_text("class Numbers:\n    pass\n")
    monkeypatch.syspath_prepend(str(tmp_path))
    files, numbers = OwnNames(str(tmp_path), "function", "stamp"), importlib.import_module("gone_learner").Numbers()
    files.save(numbers, "code for its numbers")
    monkeypatch.delitem(sys.modules, "gone_learner")
    os.remove(tmp_path / "gone_learner.py")
    importlib.invalidate_caches()
    assert files.load("floats") is None
    files.save("floats", "code for floats")
    assert files.load("floats") == "code for floats"


@pytest.mark.skipif(config.DISABLE_JIT, reason="nothing is kept")
def test_code_that_the_disk_does_not_take_is_not_kept(tmp_path, monkeypatch):
    files = OwnNames(str(tmp_path), "function", "stamp")

    def full(*arguments: Any) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(files, "_save_data", full)
    files.save("floats", "code for floats")
    assert files.load("floats") is None


@pytest.mark.skipif(config.DISABLE_JIT, reason="nothing is kept")
def test_all_compiled_functions_keep_their_code_under_own_names():
    functions = (read_all, doubled, root)  # type: ignore[unused-ignore]
    assert all(isinstance(one._cache._cache_file, OwnNames) for one in functions)  # type: ignore[attr-defined]


def test_a_module_is_compiled_anew_when_what_it_calls_is_edited_and_no_other(monkeypatch: pytest.MonkeyPatch) -> None:
    loops = ("loop.compiled", "loop.sample")
    places = ("torque.adaptive", "torque.concurrent", "torque.classical", *loops, "model.tree.body")
    modules = [f"mmnn_pin.{place}" for place in places]

    def changed_by(edited: str) -> set[str]:
        before = {one: source_key(one) for one in modules}
        text_of = module.text_of
        monkeypatch.setattr(module, "text_of", lambda one: text_of(one) + b"#" * (one == f"mmnn_pin.{edited}"))
        source_key.cache_clear()
        changed = {one.removeprefix("mmnn_pin.") for one in modules if source_key(one) != before[one]}
        monkeypatch.undo()
        source_key.cache_clear()
        return changed

    assert changed_by("torque.adaptive") == {"torque.adaptive", "torque.concurrent"}
    assert changed_by("safety.door") == set(loops)  # `safety` hands it on
    assert changed_by("model.tree.dynamics") == set(places)
    assert changed_by("loop.loop") == set()


PLAINLY = """
import numpy as np
from mmnn_pin.compiled import compiled
from mmnn_pin.elementary import sin
from mmnn_pin.parts import matrix, vector
@compiled
def summed(values):
    a, b = vector(values, 1, 3), matrix(values, 2, 2, 2)
    return sin(a[0]) + b[1, 1] + a[2]
print(float(sum(summed(np.arange(8.0) + k) for k in range(1000))).hex())
"""


@compiles
def test_without_numbas_insides_the_same_bits(tmp_path: Path) -> None:
    """Views of a flat array that numba counts references of, too."""
    (tmp_path / "part.py").write_text(PLAINLY)
    answers = []
    for plain in "01":
        variables = os.environ | {"MMNN_PLAIN_NUMBA": plain, "NUMBA_CACHE_DIR": str(tmp_path / "cache")}
        variables |= {"PYTHONPATH": str(Path(__file__).parents[1])}
        command = [sys.executable, str(tmp_path / "part.py")]
        answers.append(subprocess.run(command, env=variables, capture_output=True, text=True, check=True).stdout)
    assert answers[0] == answers[1]


def folder_of_a_new_process() -> Path | None:
    """The cache folder as it is found anew."""
    found = module.private_root(module.cache_root().resolve(), source_key("mmnn_pin.compiled"))
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(module, "checked_root", lambda: found)
        if found is not None:
            module.forget(found)
        return cache_folder.__wrapped__()


def test_code_of_other_versions_that_nothing_uses_is_removed_and_nothing_else(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path))
    old, used, foreign, alike = (tmp_path / name for name in ("0" * 16, "1" * 16, "somebody_elses", "2" * 16))
    for folder in (old, used, foreign, alike):
        (folder / "deep").mkdir(parents=True)
        (folder / "deep" / ("notes.txt" if folder == alike else "code.nbi")).write_bytes(b"code")
        age = 2 * 86400.0 if folder == used else KEPT + 60.0
        os.utime(folder, (time.time() - age,) * 2)
    own = folder_of_a_new_process()
    assert own is not None and own.exists() and not old.exists()
    assert used.exists() and foreign.exists() and alike.exists()
    os.utime(own, (0.0, 0.0))
    assert folder_of_a_new_process() == own and time.time() - own.stat().st_mtime < 60.0


def test_code_is_not_taken_from_a_folder_that_others_can_write_to(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Its files are unpickled, and their code is run."""
    shared, others = tmp_path / "shared", tmp_path / "others"
    for folder in (shared, others):
        folder.mkdir()
    shared.chmod(0o777)
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(shared))
    monkeypatch.setattr(module, "gettempdir", lambda: str(others))
    found = folder_of_a_new_process()
    assert (
        found is not None
        and found.parent == others / f"mmnn_pin-{os.getuid()}"
        and found.stat().st_mode & 0o777 == 0o700
    )
    assert not any(shared.iterdir())
    (line,) = capsys.readouterr().err.splitlines()
    assert f"warning: compiled code is not taken from {shared}: others can write to {shared} (mode 777)" in line
    found.parent.chmod(0o777)
    assert folder_of_a_new_process() is None and "it is not kept" in capsys.readouterr().err
    found.parent.rename(mine := tmp_path / "mine")
    mine.chmod(0o700)
    found.parent.symlink_to(mine)  # a link of theirs, which may lead elsewhere tomorrow
    assert folder_of_a_new_process() == mine / found.name and "it is kept in" in capsys.readouterr().err
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path / "own"))  # as the line says
    found = folder_of_a_new_process()
    assert found is not None and found.parent == tmp_path / "own" and capsys.readouterr().err == ""

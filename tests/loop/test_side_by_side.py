"""Several runs at once: every one has the bits that it has alone, whatever way it goes."""

from __future__ import annotations

import ctypes
import io
import json
import math
import os
import sys
from dataclasses import replace
from typing import Any

import llvmlite.binding as llvm
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numba import config

from mmnn_pin import PD, Circle, Feedback, Hold, Line, Loop, Neural, Sine, Timing, TorqueController, Trajectory, load
from mmnn_pin.loop import batch, side_by_side
from mmnn_pin.loop.batch import Run, simulate_many
from mmnn_pin.loop.before_run import Start
from mmnn_pin.loop.noting import Noted, Notes, noting
from mmnn_pin.loop.side_by_side import LANES, PIECE, WARM, Lanes, Program, aligned, forms_of, loaded, machine, ready
from mmnn_pin.loop.vector_code import vector_code
from mmnn_pin.sensing import Sensor
from mmnn_pin.torque.model_based import ComputedTorque
from mmnn_pin.torque.two_layer import TwoLayer

pytestmark = pytest.mark.skipif(bool(config.DISABLE_JIT), reason="plain Python runs one after the other")

GAINS = Feedback(base=500.0, arm=10.0)
LINE = Trajectory(Line(0.3), (Sine(0.5, 2.0), Hold(0.4)))
TURN = Trajectory(Circle(1.0, 0.4), (Hold(0.2), Sine(0.3, 1.0)))
TIMING = Timing(duration=0.7)
LOOP = Loop(load("platform_arm"), LINE, Neural(TwoLayer(), GAINS), timing=TIMING)
CONTROLLERS = {"two_layer": LOOP.controller, "pd": PD(GAINS), "computed_torque": ComputedTorque(GAINS)}


@pytest.fixture(autouse=True)
def counted(monkeypatch: pytest.MonkeyPatch) -> None:
    """What other tests have seen of a program says nothing here."""
    for *_, program in Program.made:
        monkeypatch.setattr(program, "pieces", 0)
        monkeypatch.setattr(program, "left", 0)


def program_of(loop: Loop) -> Program:
    """The program of a loop, made if it has to be."""
    assert ready(loop)
    engine = loop.engine_at()
    forms = forms_of([engine] * LANES)
    assert forms is not None
    program = Program.of(engine, forms[0], 0, False)
    assert program is not None
    program.pieces = program.left = 0
    return program


def alike(one: Run, other: Run) -> bool:
    """Whether two runs have the same outcome and bits."""
    same = one.outcome == other.outcome and repr(one.metrics) == repr(other.metrics)
    assert one.recording is not None and other.recording is not None
    pairs = [(one.final[name], other.final[name]) for name in one.final]
    pairs += [(one.recording[name], other.recording[name]) for name in ("position", "nu", "torque", "psi", "energy")]
    pairs += [(array, other.recording.weights[name]) for name, array in one.recording.weights.items()]
    return same and all(np.array_equal(a, b, equal_nan=True) for a, b in pairs)


def alone(loops: list[Loop], monkeypatch: pytest.MonkeyPatch) -> list[Run]:
    """The runs one after the other."""
    with monkeypatch.context() as patch:
        patch.setattr(batch, "groups_of", lambda loops, places, workers: [[i] for i in places])
        return simulate_many(loops, keep=True, workers=1)


@pytest.mark.parametrize("name", CONTROLLERS)
def test_runs_side_by_side_have_the_bits_that_they_have_alone(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    loop = replace(LOOP, controller=CONTROLLERS[name])
    program = program_of(loop)
    factors = (1.0, 0.8, 1.0, 1.3, 0.9)
    loops = [replace(loop, robot=loop.robot.with_masses(f), seed=i) for i, f in enumerate(factors)]
    loops[3] = replace(loops[3], trajectory=TURN)
    loops = [replace(one, weights_interval=0.3) for one in loops]
    together = simulate_many(loops, keep=True, workers=1)
    assert program.pieces > 2 and program.left == 0  # the first run is alone, four are together
    assert all(map(alike, together, alone(loops, monkeypatch)))
    assert len({float(run.final["position"][0]) for run in together[1:]}) == LANES


def test_a_run_that_goes_another_way_is_made_by_the_compiled_loop(monkeypatch: pytest.MonkeyPatch) -> None:
    program = program_of(LOOP)
    around = Start(pose_offset=(0.0, 0.0, -2 * math.pi + 0.1))  # the heading error is brought back by a turn
    loops = [replace(LOOP, seed=i) for i in range(5)]
    loops[2] = replace(loops[2], start=around)
    together = simulate_many(loops, keep=True, workers=1)
    assert program.left == program.pieces > 0
    assert all(map(alike, together, alone(loops, monkeypatch)))


def test_a_way_that_is_left_often_is_not_tried_any_more() -> None:
    program = program_of(LOOP)
    program.pieces, program.left = 20, 5
    simulate_many([replace(LOOP, seed=i) for i in range(5)], workers=1)
    assert (program.pieces, program.left) == (20, 5)


def test_a_run_that_diverges_ends_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    program_of(replace(LOOP, controller=PD(GAINS)))
    wild = PD(Feedback(base=4e5, arm=10.0))
    loops = [replace(LOOP, controller=wild if i == 3 else PD(GAINS), seed=i) for i in range(5)]
    together = simulate_many(loops, keep=True, workers=1)
    assert [run.outcome.status for run in together] == ["completed"] * 3 + ["diverged", "completed"]
    assert all(map(alike, together, alone(loops, monkeypatch)))


def test_the_state_can_be_put_back_into_the_engines_after_every_block() -> None:
    program_of(LOOP)
    engines = [LOOP.engine_at() for _ in range(LANES)]
    forms = forms_of(engines)
    assert forms is not None
    other, lanes = LOOP.engine_at(), Lanes(engines, forms, False)
    for first, last in ((0, 40), (40, 47), (47, 97)):
        assert lanes.advance(first, last) == [-1] * LANES
        lanes.put_back()
        other.advance(first, last)
        for engine in engines:
            assert np.array_equal(engine.state.values, other.state.values)
            assert np.array_equal(engine.rows[: last - first], other.rows[: last - first])
            assert engine.counter[0] == last - first


def test_runs_that_are_stopped_end_where_their_rows_end() -> None:
    program_of(LOOP)
    started = [batch.begun("", replace(LOOP, seed=i, weights_interval=0.7), None, (), True) for i in range(LANES)]
    for seed, run in enumerate(batch.simulate_group(started, True, lambda: True)):
        assert run.outcome.status == "interrupted" and run.recording is not None
        shorter = replace(LOOP, seed=seed, timing=Timing(duration=run.outcome.time))
        assert np.array_equal(run.final["position"], shorter.run().final["position"])


def test_only_loops_of_one_form_go_side_by_side() -> None:
    engines = [LOOP.engine_at() for _ in range(LANES)]
    assert forms_of(engines) is not None
    others = (
        replace(LOOP, sensor=Sensor(velocity_noise=1e-3)),
        replace(LOOP, controller=PD(GAINS)),
        replace(LOOP, engine="ordinary"),
        replace(LOOP, timing=Timing(duration=0.7, control_period=0.001)),
    )
    for other in others:
        assert forms_of([*engines[1:], other.engine_at()]) is None
    assert forms_of(engines[1:]) is None


def test_runs_of_unlike_loops_are_not_put_together() -> None:
    loops = [replace(LOOP, controller=PD(GAINS) if i % 3 == 0 else LOOP.controller) for i in range(12)]
    groups = batch.groups_of(loops, range(12), 1)
    assert sorted(i for group in groups for i in group) == list(range(12))
    assert sorted(map(len, groups)) == [4, 4, 4]
    assert sorted(map(len, batch.groups_of(loops, range(12), 2))) == [1] * 4 + [4, 4]
    assert sorted(map(len, batch.groups_of(loops, range(12), 4))) == [1] * 12
    assert all(len({type(loops[i].controller) for i in group}) == 1 for group in groups)


class Mine(TorqueController):
    """No torque, in plain Python."""

    name = "mine"

    def step(self, time, reference, measurement, command, state):
        """Nothing."""
        return np.zeros(command.nu_ref.size)


@pytest.mark.parametrize(
    "changes", [{"controller": Mine()}, {"engine": "ordinary"}, {"sensor": Sensor(velocity_noise=1e-3)}]
)
def test_runs_that_cannot_go_side_by_side_go_alone(changes: dict[str, Any], monkeypatch: pytest.MonkeyPatch) -> None:
    loops = [replace(LOOP, timing=Timing(duration=0.05), seed=i, **changes) for i in range(6)]
    assert all(map(alike, simulate_many(loops, keep=True, workers=1), alone(loops, monkeypatch)))
    monkeypatch.setattr(batch, "groups_of", lambda loops, places, workers: [list(range(1, 5)), [5]])
    assert all(map(alike, simulate_many(loops, keep=True, workers=1), alone(loops, monkeypatch)))


def test_runs_that_keep_their_weights_at_other_times_are_not_put_together(monkeypatch: pytest.MonkeyPatch) -> None:
    program_of(LOOP)
    loops = [replace(LOOP, seed=i, weights_interval=0.1 if i % 2 else 0.03) for i in range(6)]
    assert all(map(alike, simulate_many(loops, keep=True, workers=1), alone(loops, monkeypatch)))


def test_a_small_batch_begins_no_compilation(tmp_path: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[Any] = []
    monkeypatch.setattr(side_by_side, "ask_for", lambda *given: asked.append(given))
    monkeypatch.setattr(side_by_side, "file_of", lambda form, way: tmp_path / "program")
    monkeypatch.setattr(Program, "made", [])
    loops = [replace(LOOP, seed=i) for i in range(9)]
    simulate_many(loops, workers=1)
    assert asked == []
    monkeypatch.setattr(batch, "WORTH", 1)
    monkeypatch.setattr(Program, "asked", {})
    simulate_many(loops, workers=1)
    assert len(asked) == 1 and asked[0][-1] == WARM


def test_what_cannot_be_noted_leaves_an_empty_file(tmp_path: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    told = {"parts": ["run"], "form": [], "values": [], "numbers": 0, "setpoints": [[0.0], [0.0]], "time": 0.0}
    watched, held = os.pipe()  # held open: its parent lives
    monkeypatch.setattr(sys, "argv", ["", str(watched), str(tmp_path / "program")])
    monkeypatch.setattr(sys, "stdin", io.StringIO(json.dumps(told)))
    side_by_side.main()
    assert [file.name for file in tmp_path.iterdir()] == ["program"]
    assert (tmp_path / "program").read_bytes() == b""
    os.write(held, b".")


NUMBERS = st.floats(-1e3, 1e3, allow_nan=False)
STEPS = st.tuples(st.sampled_from("+-*/s|~mc<"), st.integers(0, 60), st.integers(0, 60))


@settings(max_examples=30, deadline=None)
@given(
    st.lists(st.tuples(*[NUMBERS] * LANES), min_size=4, max_size=6),
    st.lists(STEPS, min_size=1, max_size=40),
    st.integers(0, 3),
)
def test_noted_steps_are_those_of_numpy(state: list[tuple[float, ...]], steps: list[Any], settings_at: int) -> None:
    """Random steps on a state of which one number is never written, against numpy, lane by lane."""
    lanes = np.array(state)
    notes = Notes()
    things: list[Any] = [Noted(float(x), notes.op("state", i)) for i, x in enumerate(lanes[:, 0])]
    with noting(notes):
        outcomes = run(things, steps)
    results = [run(list(lanes[:, lane]), steps) for lane in range(LANES)]
    written = {i: notes.of(things[-1 - i]) for i in range(len(state)) if i != settings_at}
    told = {"ops": notes.ops, "guards": list(notes.guards), "written": written, "row": 0, "width": 3, "setpoints": 1}
    slots, text = vector_code(told, LANES)
    engine = loaded(bytes(machine().emit_object(llvm.parse_assembly(text))), ["cos"])
    memory, rows, done = stepped(engine, lanes, slots)
    same = [outcomes == other for other in results]
    assert done == int(all(same))
    if all(same):
        for lane in range(LANES):
            values = list(lanes[:, lane])
            run(values, steps)
            expected = [values[-1 - i] if i != settings_at else lanes[i, lane] for i in range(len(state))]
            assert np.array_equal(memory[:, lane], expected, equal_nan=True)
            assert np.array_equal(rows[lane], expected[:3], equal_nan=True)


def run(things: list[Any], steps: list[Any]) -> list[bool]:
    """Steps on numbers, noted or not; the outcomes of their comparisons."""
    outcomes: list[bool] = []
    with np.errstate(all="ignore"):
        for code, i, j in steps:
            a, b = things[i % len(things)], things[j % len(things)]
            if not isinstance(a, Noted):
                a, b = np.float64(a), np.float64(b)
            if code == "<":
                outcomes.append(bool(a < b))
                continue
            things.append(
                {
                    "+": lambda a, b: a + b,
                    "-": lambda a, b: a - 2.0 * b,
                    "*": lambda a, b: a * b,
                    "/": lambda a, b: a / b,
                    "s": lambda a, b: math.sqrt(abs(a)),
                    "|": lambda a, b: abs(b),
                    "~": lambda a, b: -a,
                    "m": lambda a, b: 0.5 - a,
                    "c": lambda a, b: a + 3.0,
                }[code](a, b)
            )
    return outcomes


def stepped(engine: Any, lanes: Any, slots: int) -> tuple[Any, Any, int]:
    """One sample of a program from a state (n, lanes): the state after it, rows, and how many samples were right."""
    pointer, integer = ctypes.c_void_p, ctypes.c_int64
    prepare = ctypes.CFUNCTYPE(integer, pointer, pointer)(engine.get_function_address("prepare"))
    arguments = [integer, *[pointer] * 5, integer, integer, ctypes.c_double]
    advance = ctypes.CFUNCTYPE(*arguments)(engine.get_function_address("advance"))
    memory, kept, setpoints = aligned(lanes.shape), aligned((slots, LANES)), aligned((2, 1, LANES))
    memory[:] = lanes
    rows, alive = np.zeros((LANES, 3)), aligned((LANES,), np.int64)
    alive[:] = -1
    places = np.array([row.ctypes.data for row in rows])
    bad = prepare(memory.ctypes.data, kept.ctypes.data)
    done = advance(*(a.ctypes.data for a in (memory, kept, setpoints, places, alive)), 5, 1, 0.001)
    return memory, rows, int(done) if not bad else 0


def test_a_piece_is_no_longer_than_what_engines_hand_over() -> None:
    assert len(LOOP.engine_at().rows) <= PIECE

"""The judge's sentences, held against the numbers that they were made of."""

from __future__ import annotations

import re
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mmnn_pin.errors import RecordingError
from mmnn_pin.lab.psi.judgement import Judgement
from mmnn_pin.lab.show.psi import verdicts

LABELS = ("v", "w", "arm_1_joint", "arm_2_joint", "arm_3_joint", "arm_4_joint", "arm_5_joint", "arm_6_joint")
HALVES = {"base": slice(0, 2), "arm": slice(2, 8)}
KINDS = {"online": "FVU online", "same": "frozen", "held_out": "held out"}


def short(where: slice) -> list[str]:
    return [label.removesuffix("_joint") for label in LABELS[where]]


def agrees(words: str, values: np.ndarray, names: list[str]) -> None:
    """Whether what is said of a prediction is so: a share of Psi, or which components are lost."""
    lost = {name for name, value in zip(names, values, strict=True) if value >= 1}
    if share := re.search(r"explains (more than )?(\S+) % of Psi", words):
        assert not lost
        known = 100 * (1 - np.nanmax(values))
        assert known > 99.9 if share[1] else float(share[2]) == pytest.approx(known, rel=0.006)
        return
    found = re.search(r"predicts (.*?) ?worse than a constant", words)
    assert found and lost
    if not found[1]:
        assert lost == set(names)
        return
    others = re.search(r"(\d+) others", found[1])
    told = set(re.findall(r"arm_\d|\bv\b|\bw\b", found[1]))
    assert told <= lost and len(told) + int(others[1] if others else 0) == len(lost)


def drawn(rng: np.random.Generator) -> np.ndarray:
    """FVU of every component: known, lost, at an end of the range, or of what does not vary."""
    kinds = [np.nan, 0.0, 1.0, rng.uniform(0, 0.002), rng.uniform(0, 0.99), rng.uniform(1, 300)]
    chances = rng.dirichlet(np.ones(len(kinds)) / 2)
    return rng.choice(kinds, len(LABELS), p=chances) * rng.uniform(1, 1.001, len(LABELS))


@given(st.integers(0, 2**32 - 1))
def test_what_the_judge_says_of_base_and_arm_is_so(seed: int) -> None:
    rng = np.random.default_rng(seed)
    for _ in range(100):
        kinds = {"online": drawn(rng), "same": drawn(rng), "held_out": drawn(rng)}
        holds({name: kinds[name] for name in [*kinds][: rng.integers(1, 4)]})


def holds(kinds: dict[str, np.ndarray]) -> None:
    """Hold the sentences of some FVU against them; without `same` nothing learns."""
    online, same, other = (kinds.get(name) for name in ("online", "same", "held_out"))
    learns = same is not None
    frozen = {name: SimpleNamespace(fvu=values) for name, values in kinds.items() if name != "online"}
    psi: Any = SimpleNamespace(labels=LABELS, halves=HALVES, online=online, frozen=frozen)
    for text, (half, where) in zip(verdicts(psi), HALVES.items(), strict=True):
        assert text.startswith(f"{half}: ")
        for name, values in kinds.items():
            own, names = values[where], short(where)
            if not np.isfinite(own).any():
                continue
            number, which = re.search(rf"{KINDS[name]} (\S+) of (\w+)", text).groups()
            assert float(number) == pytest.approx(np.nanmax(own), rel=0.006 if np.nanmax(own) > 1e-3 else 0.06)
            assert own[names.index(which)] == np.nanmax(own)
        if not learns:
            assert "it learns nothing" in text and "explains" not in text
            continue
        if "nothing to judge" in text:
            assert not all(np.isfinite(kinds[name][where]).any() for name in ("online", "same"))
            continue
        adapting, _, held = re.search(r"adapting, it (.*?); frozen, it (.*) \(FVU", text)[0].partition("; frozen, ")
        agrees(adapting, online[where], short(where))
        own, _, new = held.partition(" on its own trajectory and ")
        unseen = other is not None and np.isfinite(other[where]).any()
        if new:  # both are told
            agrees(own, same[where], short(where))
            agrees(new, other[where], short(where))
        else:
            seen = "never saw" in held
            assert seen or np.nanmax(same[where]) >= 1 or not unseen
            agrees(held, other[where] if seen else same[where], short(where))
            if seen:  # then the own trajectory is no worse than a constant
                assert np.nanmax(same[where]) < 1


@given(
    status=st.sampled_from(["completed", "diverged", "interrupted"]),
    plant=st.sampled_from(["ideal", "contact"]),
    rows=st.integers(2, 5000),
    late=st.sampled_from([None, 0, 1, 2, 100]),
    lacks=st.booleans(),
)
def test_what_the_judge_remarks_is_so(status: str, plant: str, rows: int, late: int | None, lacks: bool) -> None:
    """A run of samples of 2 ms that ended so, on such a plant; its weights are so many samples old, or it has none."""
    h, lost = 0.002, RecordingError("no such part", why="it is lost")
    time = h * np.arange(rows)[:, None]
    subject = SimpleNamespace(
        recording=SimpleNamespace(outcome=SimpleNamespace(status=status, time=h * rows)),
        signal={"time": time}.get,
        plant=plant,
        timing=SimpleNamespace(control_period=h),
    )
    psi = SimpleNamespace(remarks=("of psi",), frozen=late is not None, weights_time=h * max(rows - (late or 0), 0))
    judged: Any = SimpleNamespace(
        subject=subject, psi=psi, has=lambda part: not lacks, worth_telling={"psi": lost} if lacks else {}
    )
    said = Judgement.remarks(judged)
    ended = [text for text in said if text.startswith("the run was")]
    assert len(ended) == (status != "completed") and all(status in text for text in ended)
    assert all(seconds(text) == pytest.approx(time[-1, 0], rel=5e-3) for text in ended)
    slips = [text for text in said if "may slip" in text]
    assert len(slips) == (plant != "ideal") and all(f"the {plant} plant" in text for text in slips)
    old = [text for text in said if text.startswith("frozen weights are those of")]
    assert len(old) == (not lacks and bool(late))
    assert all(seconds(text) == pytest.approx(psi.weights_time, rel=5e-3) for text in old)
    assert ("no such part: it is lost" in said) == lacks == ("of psi" not in said)
    assert len(said) == len(ended) + len(slips) + len(old) + 1


def seconds(text: str) -> float:
    """The time that a sentence names [s]."""
    return float(re.findall(r"([\d.e-]+) s\b", text)[0])

"""The folder of a contest with rows of invented numbers."""

from __future__ import annotations

from pathlib import Path

import msgspec

from research.contest.contest import About, AboutTask
from research.contest.settings import load_contest
from research.contest.task import Demand
from research.contest.trial import Tracking, Trial, TrialResult


def contest(folder: Path) -> None:
    """The folder of a contest with rows of invented numbers."""
    folder.mkdir()
    asked = load_contest()
    who, trials = ("pd", "two_layer", "computed_torque"), {}
    for k, name in enumerate(who):
        trials[f"eight/{name}"] = Trial(f"{k:016x}", 1e-5, invented(name, 0.01 * (k + 1)))
    demand = Demand(("wheel_left_joint", "wheel_right_joint"), (0.4, 0.4), (0.2, 0.2))
    plain = msgspec.json.decode(msgspec.structs.replace(asked, cases={}).to_json())
    about = About("contest", plain, who, {"eight": AboutTask("An eight", who, demand)})
    (folder / "contest.json").write_bytes(msgspec.json.encode(about))
    (folder / "rows.json").write_bytes(msgspec.json.encode(trials))


def invented(controller: str, error: float) -> list[TrialResult]:
    """What two seeds of a controller would give in a contest."""
    axes = ("x", "y", "phi", "arm_1_joint", "arm_2_joint")
    return [
        TrialResult(
            task="eight", controller=controller, seed=seed, outcome="completed", ended=20.0, effort=3.0, torque=0.5,
            kick=0.6, rms=dict.fromkeys(axes, error), peak=dict.fromkeys(axes, 0.02),
            peak_of_all=dict.fromkeys(axes, 0.1), online_fvu=0.1, online_worst=0.3, frozen_fvu=0.2,
            frozen_worst=0.4, frozen_on={"similar": 0.2}, findings=(), since=0.0, curve=[[0.1] * 5, [0.01] * 5],
            held_out={"similar": dict.fromkeys(("frozen", "learning"), Tracking("completed", {"x": 0.01}))},
        )
        for seed in (0, 1)
    ]  # fmt: skip

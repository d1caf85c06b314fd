"""Studies before they run: distributions, draws, files that are wrong, and which runs a study consists of."""

from __future__ import annotations

import math
import time
from collections import Counter
from pathlib import Path

import msgspec
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import stats
from study_files import SHORT, planned, written

from mmnn_pin.cli import main
from mmnn_pin.errors import ConfigError, InputError
from mmnn_pin.lab.experiments.config import load_experiment
from mmnn_pin.lab.experiments.origins import nearest_line
from mmnn_pin.lab.study.factors import Factor, unit_cube
from mmnn_pin.lab.study.keys import leaves, near
from mmnn_pin.lab.study.plan import count_of

U = st.floats(0.0, 1.0, exclude_max=True)

# -- factors ----------------------------------------------------------------------------------------------------------

DISTRIBUTIONS = {
    "uniform": (Factor(uniform=(-1.0, 3.0)), stats.uniform(-1.0, 4.0)),
    "log_uniform": (Factor(log_uniform=(0.2, 5.0)), stats.loguniform(0.2, 5.0)),
    "normal": (Factor(normal=(2.0, 0.5)), stats.norm(2.0, 0.5)),
    "cut normal": (Factor(normal=(2.0, 0.5), within=(1.8, 4.0)), stats.truncnorm(-0.4, 4.0, 2.0, 0.5)),
    "log_normal": (Factor(log_normal=(3.0, 0.4)), stats.lognorm(0.4, scale=3.0)),
    "triangular": (Factor(triangular=(1.0, 1.5, 4.0)), stats.triang(0.5 / 3.0, 1.0, 3.0)),
    "triangle with its mode at the end": (Factor(triangular=(1.0, 4.0, 4.0)), stats.triang(1.0, 1.0, 3.0)),
}


@pytest.mark.parametrize("name", DISTRIBUTIONS)
@given(u=U)
def test_a_draw_is_the_quantile_of_its_distribution(name: str, u: float) -> None:
    factor, distribution = DISTRIBUTIONS[name]
    expected = distribution.ppf(max(u, 1e-300))
    assert factor.value(u) == pytest.approx(expected, rel=1e-6, abs=1e-6)


def test_an_endless_distribution_is_finite_at_its_ends() -> None:
    for u in (0.0, math.nextafter(1.0, 0.0)):
        assert math.isfinite(Factor(normal=(0.0, 1.0)).value(u))


@pytest.mark.parametrize("factor", [Factor(integer=(-1, 2)), Factor(choice=("a", "b", "c", "d"))])
def test_choices_and_integers_are_equally_likely(factor: Factor) -> None:
    found = Counter(factor.value((i + 0.5) / 1000) for i in range(1000))
    assert set(found.values()) == {250}
    assert factor.value(math.nextafter(1.0, 0.0)) in (2, "d")


def test_a_latin_hypercube_has_one_point_in_each_slice() -> None:
    slices = np.sort((unit_cube("lhs", 37, 3, 1) * 37).astype(int), axis=0)
    assert (slices == np.arange(37)[:, None]).all()


def test_a_sobol_sequence_is_even_and_goes_on_where_a_shorter_one_ends() -> None:
    points = unit_cube("sobol", 64, 4, 2)
    for axis in points.T:
        assert set(Counter((axis * 16).astype(int).tolist()).values()) == {4}
    np.testing.assert_array_equal(unit_cube("sobol", 20, 4, 2), points[:20])
    assert not np.array_equal(unit_cube("sobol", 64, 4, 3), points)


def test_random_points_are_in_the_cube() -> None:
    points = unit_cube("random", 500, 2, 0)
    assert points.shape == (500, 2) and (points >= 0).all() and (points < 1).all()
    assert stats.kstest(points[:, 0], "uniform").pvalue > 1e-3


IMPOSSIBLE = {
    "{ uniform = [2, 1] }": "uniform: error: [2.0, 1.0] is no uniform distribution: the lower end must be below",
    "{ log_uniform = [0, 1] }": "log_uniform: error: [0.0, 1.0] is no log-uniform distribution: a logarithm needs",
    "{ normal = [0, 0] }": "normal: error: [0.0, 0.0] is no normal distribution: the standard deviation must be > 0",
    "{ triangular = [0, 3, 1] }": "triangular: error: [0.0, 3.0, 1.0] is no triangular distribution: the mode",
    "{ uniform = [0, inf] }": "uniform: error: [0.0, inf] is not finite",
    "{ integer = [3, 2] }": "integer: error: [3, 2] is no integer distribution",
    "{ normal = [0, 1], within = [99, 100] }": "within: error: nothing within [99.0, 100.0]",
    "{ uniform = [0, 1], within = [0, 1] }": "within: error: bounds for uniform",
    "{ grid = [] }": "grid: error: no values, so no runs",
    "{ choice = [1, 1] }": "choice: error: 1 comes twice",
    "{ choice = [1, nan] }": "choice.1: error: nan is not finite",
    "{ grid = [1979-05-27] }": "grid.0: error: datetime.date(1979, 5, 27) is no setting",
    "{ uniform = [0, 1], choice = [1] }": ": error: uniform and choice at once: give one of: grid, uniform",
    "{ }": ": error: neither values nor a distribution",
    "{ uniform = [0] }": "uniform: error: [0] has one entry: give 2",
    "{ unform = [0, 1] }": ": error: unknown key 'unform': did you mean 'uniform'?",
}


@pytest.mark.parametrize("text", IMPOSSIBLE)
def test_an_impossible_distribution_is_told_with_its_line(text: str, tmp_path: Path) -> None:
    study = SHORT.replace("{ uniform = [0.5, 1.5] }", text)
    with pytest.raises(InputError) as error:
        planned(tmp_path, study)
    line = 1 + study.splitlines().index(f'"masses.root" = {text}')
    assert str(error.value).startswith(f"{tmp_path}/short.toml:{line}:factors.masses.root")
    assert IMPOSSIBLE[text] in str(error.value)


# -- files ------------------------------------------------------------------------------------------------------------

# What is changed, into what, where the error is then said to be, and what it says.
BAD = [
    ("points = 4", "points = 0", "points", "sampling.points: error: no points, so no runs: masses.root is drawn"),
    ("points = 4", "points = = 4", "points", "error: not valid TOML"),
    ("points = 4", "points = 'x'", "points", "sampling.points: error: 'x' is a text: give a whole number"),
    ("points = 4", "pionts = 4", "pionts", "sampling: error: unknown key 'pionts': did you mean 'points'?"),
    ('method = "sobol"', 'method = "sobl"', "method", "sampling.method: error: Invalid enum value 'sobl'"),
    ('title = "Short"', 'robot = "tiago"', "robot", "robot: error: unknown key 'robot': it is one of the"),
    ('["pd", "two_layer", "computed_torque"]', "[]", "contr", "controllers: error: no controllers, so no runs"),
    ('["pd", ', '["pdd", ', "contr", "controllers: error: unknown controller 'pdd': did you mean 'pd'?"),
    ('["pd", ', '["pd", "pd", ', "contr", "controllers: error: a controller appears twice"),
    ('"chapter4"', '"chapter5x"', "exper", "experiment: error: no experiment 'chapter5x': name a file"),
    ("time.duration", "time.durtion", "durtion", "unknown setting 'time.durtion': did you mean 'time.duration'?"),
    ("duration = 0.04", 'duration = "x"', "dura", "set.time.duration: error: 'x' is a text: give a number"),
    ("duration = 0.04", "duration = -1", "dura", "set.time.duration: error: -1.0 s"),
    ('"masses.root"', '"masses.rot"', "rot", "factors.masses.rot: error: unknown body 'rot': did you mean 'root'?"),
    ('"masses.root"', '"controllers"', '"contr', "factors.controllers: error: unknown setting 'controllers'"),
    ("[0.001, 0.002]", "[0.001, 0.003]", "[0.001", "time.control_period: 0.003 s does not divide 0.04 s"),
    (
        '"friction.base", ',
        '"friction.bsae", ',
        "keys",
        "unknown setting 'friction.bsae': did you mean 'friction.base'?",
    ),
    (
        '"friction.base", "friction.arm"',
        '"sensor.velocity"',
        "[factors.f",
        "'true' cannot be multiplied: it is no number",
    ),
    (
        "relative = true",
        'relative = "yes"',
        "rela",
        "factors.friction.relative: error: 'yes' is a text: give true or false",
    ),
    ('"e.*.peak"]', '"e.*.pek"]', "metrics", "metrics: error: unknown metric 'e.*.pek': did you mean 'e.*.peak'"),
    ('"e.*.peak"]', '"e.*.rms_3_7"]', "metrics", "did you mean 'e.*.rms_0_0.02'? there is: e.*.peak, e.*.rms_0_"),
    ("at_most =", "wanted = 2\nat_most =", "wanted", "success.wanted: error: 2.0: use a share between 0 and 1"),
    ("= 0.03 }", "= nan }", "at_most", "success.at_most.pose_error.[xy].peak: error: nan: use a finite number"),
    ('title = "Short"', "seeds = 0", "seeds", "seeds: error: no seeds, so no runs"),
    ('title = "Short"', "seeds = [1, 1]", "seeds", "seeds: error: a seed appears twice"),
    ('title = "Short"', "seeds = [1, 2]", "seeds", "seeds: error: the seed is a factor, too"),
]


def test_a_key_of_the_experiment_stands_below_set(tmp_path: Path) -> None:
    """As the refusal of it above `set` advises."""
    plan = planned(tmp_path, SHORT.replace("[set]", '[set]\nrobot = "casters_arm"'))
    assert plan.base.robot == "casters_arm"


@pytest.mark.parametrize(("old", "new", "where", "words"), BAD)
def test_a_wrong_file_is_told_with_line_and_key(old, new, where, words, tmp_path: Path, capsys, monkeypatch) -> None:
    monkeypatch.chdir(tmp_path)
    text = SHORT.replace(old, new)
    assert text != SHORT
    written(tmp_path, text)
    assert main(["study", "short.toml"]) == 2
    said = capsys.readouterr().err
    line = 1 + next(i for i, line in enumerate(text.splitlines()) if where in line)
    assert said.startswith(f"short.toml:{line}:") and words in said and said.count("\n") == 1, said
    assert [file.name for file in tmp_path.iterdir()] == ["short.toml"]


def test_a_file_that_is_not_there_is_told(tmp_path: Path, capsys) -> None:
    assert main(["study", str(tmp_path / "none.toml")]) == 2
    assert "none.toml: error: no such file: name the TOML file of a study" in capsys.readouterr().err


def test_lines_are_found_in_every_way_of_writing_keys() -> None:
    text = 'a = 1\n[b."c.d"]\n# e = 3\ne.f = 4\n  [ g . "h" ]\n"i j" = [\n  1,\n]\n'
    keys = ("a", "b.c.d.e.f", "b.c.d.e.f.0", "b.c.d.e", "b.c.d.x", "g.h.i j", "g", "z")
    assert [nearest_line(text, key)[1] for key in keys] == [1, 4, 4, 4, 2, 6, 5, None]
    lists = "[[p]]\nx = 1\n[p.q]\nx = 1\n[[p]]\nx = 1\n[p.q]\nx = 1\n[q]\n"
    keys = ("p.0.x", "p.0.q.x", "p.1", "p.1.x", "p.1.q.x", "p.2.x", "p", "q")
    assert [nearest_line(lists, key)[1] for key in keys] == [2, 4, 5, 6, 8, None, 1, 9]


@pytest.mark.parametrize(
    ("path", "expected"),
    [
        ("time.controlperiod", "time.control_period"),
        ("resolution", "sensor.resolution"),
        ("feedbak.base", "feedback.base"),
    ],
)
def test_near_keys_are_named(path: str, expected: str) -> None:
    assert expected in near(path, list(leaves(msgspec.to_builtins(load_experiment("chapter4")))))


def test_single_masses_are_those_of_the_robot_that_a_study_sets(tmp_path: Path) -> None:
    text = """
experiment = "track"
controllers = ["pd"]
[set]
"masses.arm_5_joint" = 1.2
robot = "tiago_no_hand"
[sampling]
points = 2
[factors]
"masses.arm_4_joint" = { uniform = [0.8, 2.5] }
[success]
at_most = { "z.v.peak" = 0.02 }
"""
    row = planned(tmp_path, text).trial(1)
    masses = row.experiment.masses
    assert row.experiment.robot == "tiago_no_hand" and "arm_1_joint" in masses and "root" in masses
    assert masses["arm_4_joint"] == row.parameters["masses.arm_4_joint"] != 1.0
    assert masses["arm_5_joint"] == 1.2 and masses["arm_3_joint"] == 1.0


ON_HARDWARE = """
experiment = "track"
controllers = ["pd"]
[set]
robot = "two_axis_arm"
{hardware}
servo.gain = 0.1
[sampling]
points = 1
[factors]
{factor} = {{ {values} }}
[success]
at_most = {{ "e.*.peak" = 0.5 }}
"""
MASSES = {"factor": "masses", "values": "uniform = [0.8, 1.2]"}


def test_hardware_that_a_study_sets_is_that_of_an_experiment_with_all_that_follows(tmp_path: Path) -> None:
    alone = load_experiment("track", ['robot="two_axis_arm"', 'hardware="unknown"', "servo.gain=0.1"])
    for hardware in ('hardware = "unknown"', 'hardware.profile = "unknown"'):
        plan = planned(tmp_path, ON_HARDWARE.format(hardware=hardware, **MASSES))
        made = plan.trial(0).experiment
        names = ("interfaces", "servo", "actuator", "sensor", "latency", "time", "kinematic", "friction")
        assert {name: getattr(made, name) for name in names} == {name: getattr(alone, name) for name in names}
        assert made.hardware.title == alone.hardware.title and made.masses != 1.0
    for hardware, words in (("unknow", "'unknow'"), ("feetech-sts3215", "too weak")):
        with pytest.raises(InputError, match=words) as error:
            planned(
                tmp_path, ON_HARDWARE.format(hardware=f'hardware = "{hardware}"', **MASSES).replace("two_axis", "car")
            )
        assert "set.hardware" in str(error.value)
    grid = {"factor": "hardware", "values": 'grid = ["unknown", "ideal"]'}
    with pytest.raises(ConfigError, match=r"factors\.hardware: error: hardware is no factor"):
        planned(tmp_path, ON_HARDWARE.format(hardware="", **grid).replace("[sampling]\npoints = 1\n", ""))


# -- runs -------------------------------------------------------------------------------------------------------------


def test_runs_are_all_draws_times_grid_times_controllers(tmp_path: Path) -> None:
    plan = planned(tmp_path)
    rows = [plan.trial(i) for i in range(len(plan))]
    assert len(rows) == 4 * 2 * 3 == count_of(plan.study.settings, 4, 3)
    assert {(r.controller, r.experiment.time.control_period) for r in rows} == {
        (c, p) for c in ("pd", "two_layer", "computed_torque") for p in (0.001, 0.002)
    }
    draws = {r.parameters["masses.root"] for r in rows}
    assert len(draws) == 4 and all(0.5 <= x <= 1.5 for x in draws)
    for row in rows:
        factor = row.parameters["friction"]
        assert row.experiment.friction.base == pytest.approx([30 * factor, 5 * factor])
        assert row.experiment.friction.arm == pytest.approx(0.5 * factor)
        assert row.experiment.masses["root"] == row.parameters["masses.root"]
        assert row.experiment.masses["arm_1_joint"] == 1.0
        assert row.seed == row.experiment.seed == row.parameters["seed"]
        assert row.nominal.masses["root"] == 1.0 and row.nominal.friction.arm == 0.5
    assert len({row.fingerprint for row in rows}) == len(rows)
    assert [row.fingerprint for row in rows] == list(plan.fingerprints)
    with pytest.raises(ConfigError, match="there is no row 24: use one from 0 to 23"):
        plan.trial(24)


def test_more_runs_than_can_be_are_refused_before_one_is_made(tmp_path: Path) -> None:
    grid = f"grid = {[1 + k / 100 for k in range(100)]}"
    masses = "".join(f'"masses.{name}" = {{ {grid} }}\n' for name in ("arm_1_joint", "arm_2_joint", "wheel_left_joint"))
    for old, new, runs in (
        ("[factors.friction]", f"{masses}[factors.friction]", 4 * 2 * 3 * 100**3),
        ('"seed" = { integer = [0, 1000] }', "", 0),
    ):
        text = SHORT.replace(old, new) if runs else f"seeds = {10**12}\n{SHORT.replace(old, new)}"
        with pytest.raises(ConfigError, match=rf"{runs or 24 * 10**12} runs: at most 10000000 are taken"):
            planned(tmp_path, text)


def test_values_are_compared_in_time_that_grows_with_their_number() -> None:
    begun = time.process_time()
    assert len(Factor(grid=tuple(range(50_000))).grid or ()) == 50_000
    assert time.process_time() - begun < 3
    for twice in ((1, True), (1, 1.0), ([1, [2]], [1.0, [2]]), ([{"a": [1]}], [{"a": [1]}])):
        with pytest.raises(ConfigError, match="comes twice"):
            Factor(choice=twice)


def test_seeds_count_from_the_experiments_own_or_are_given(tmp_path: Path) -> None:
    text = 'experiment = "chapter4"\ncontrollers = ["pd"]\n'
    assert [planned(tmp_path, f"{text}seeds = 3").trial(i).seed for i in range(3)] == [1, 2, 3]
    assert [planned(tmp_path, f"{text}seeds = [7, 5]").trial(i).seed for i in range(2)] == [7, 5]


def test_a_fingerprint_is_of_what_decides_the_numbers(tmp_path: Path) -> None:
    base = list(planned(tmp_path).fingerprints)
    same = SHORT.replace('title = "Short"', 'title = "Other"').replace("0.03", "0.5").replace('"e.*.peak"', '"effort"')
    assert list(planned(tmp_path, same).fingerprints) == base
    assert list(planned(tmp_path, SHORT.replace("points = 4", "points = 8")).fingerprints)[:24] == base
    for old, new in (("0.04]]", "0.03]]"), ("seed = 3", "seed = 4"), ('title = "Short"', 'model = "true"')):
        assert set(planned(tmp_path, SHORT.replace(old, new)).fingerprints).isdisjoint(base), new
    fewer = list(planned(tmp_path, SHORT.replace('["pd", ', "[")).fingerprints)
    assert len(fewer) == 16 and set(fewer) <= set(base)


def test_a_fingerprint_knows_the_content_of_the_robots_files(tmp_path: Path) -> None:
    from mmnn_pin.model.robots import bundled

    urdf = tmp_path / "robot.urdf"
    urdf.write_text(bundled()["platform_arm"].read_text())
    text = SHORT.replace("[set]\n", f'[set]\nrobot = "{urdf}"\n')
    before = list(planned(tmp_path, text).fingerprints)
    urdf.write_text(urdf.read_text().replace('mass value="5.0"', 'mass value="5.1"'))
    assert set(planned(tmp_path, text).fingerprints).isdisjoint(before)


def test_an_experiment_beside_the_study_is_found_from_any_folder(tmp_path: Path, monkeypatch) -> None:
    from mmnn_pin.lab.experiments.config import bundled

    (tmp_path / "mine.toml").write_text(bundled()["chapter4"].read_text())
    monkeypatch.chdir("/")
    plan = planned(tmp_path, SHORT.replace('"chapter4"', '"mine.toml"'))
    assert plan.base.time.duration == 0.04

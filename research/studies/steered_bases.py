"""Numbers of docs/explanation/steered-bases.md: what its theorems say beside random motions.

    python -m research.studies.steered_bases

Tables: the rate K that theorem 1 asks for beside what motions need; where a swerve drive comes to rest; angles within
which a trailer is backed, by the formula and by trying; what no theorem covers (a car that reverses, a loader).
"""

from __future__ import annotations

import numpy as np

from mmnn_pin.lab.show.table import Column, Row, Table, row_of, terminal_text
from mmnn_pin.signals import Array
from research.proof.steering import (
    CASES,
    SQUARE,
    SteeredMotion,
    backed,
    car,
    gyration,
    hitch_on_circle,
    least_second_eigenvalue,
)

COUNT, BEGIN, ANGLE, WITHIN = 200, 0.1, 1.0, 0.3  # motions, size, angle to the path at the start, size allowed
TRUCKS = ((0.12, 0.7, 1.05), (0.3, 0.7, 1.05), (0.3, 1.2, 0.6), (1.0, 5.0, 0.2))  # h, L [m], curvature [1/m]
RESTS = ((2.0, 6.0, 0.03), (2.0, 20.0, 0.03), (2.0, 6.0, 0.005))  # gain, K [1/s], eps [m/s]


def number(value: float) -> str:
    """Three digits."""
    return f"{value:.3g}"


def needed(case: str) -> Row:
    """A base: its constants, the K of theorem 1, and the least K with which random motions stay within."""
    motion, constants = CASES[case](1, COUNT)
    rate = constants.rate_for(BEGIN, ANGLE, WITHIN)
    low, high = 0.01, rate
    while high / low > 1.05:
        motion.rate = (low * high) ** 0.5
        low, high = (low, motion.rate) if largest(motion, case) <= WITHIN else (motion.rate, high)
    motion.rate = rate
    cells = (constants.m, constants.B0, constants.B1, rate, largest(motion, case), high)
    return row_of(case, *map(number, cells))


def largest(motion: SteeredMotion, case: str) -> float:
    """The largest size of random motions from errors of the size `BEGIN` and angles of `ANGLE`."""
    constants = CASES[case](1, COUNT)[1]
    e, _ = motion.begun(2, COUNT, 0.1, 0.0)
    e = e * (BEGIN / constants.size(e))[:, None]
    chi = np.random.default_rng(3).choice([-ANGLE, ANGLE], (COUNT, len(motion.pivots)))
    asked = motion.asked(e, motion.reference(0.0)[0])
    across, ahead = motion.places(asked, np.zeros((COUNT, len(motion.pivots))))
    _, errors, _ = motion.run(e, np.arctan2(across, ahead) + chi, 3.0, dt=0.01)
    return float(constants.size(errors).max())


def rest(gain: float, rate: float, slow: float) -> Row:
    """How far from a pose at rest a swerve drive is after 10 s, from 50 mm and every angle of its wheels."""
    count, none = 100, np.zeros((100, 3))
    motion = SteeredMotion(
        np.array(SQUARE), gyration(SQUARE), (gain,) * 3, rate, False, lambda _: (none, none), slow=slow
    )
    angle = np.linspace(-1.55, 1.55, count)
    _, errors, _ = motion.run(np.tile([0.05, 0.0, 0.0], (count, 1)), np.tile(angle[:, None], 4), 10.0, dt=0.005)
    left = 1e3 * np.hypot(errors[-1, :, 0], errors[-1, :, 1])
    level = (1e3 * slow / (np.pi**2 * gain**3 * rate**2 * 10.0) ** 0.25, left.max(), np.median(left))
    return row_of(number(gain), number(rate), number(1e3 * slow), *map(number, level))


def jackknife(h: float, length: float, most: float) -> Row:
    """Angles of a trailer: the bound, the largest that backing got straight from, and the trailer's own curvature."""
    hitch = np.array([h, length])
    gamma = np.linspace(0.01, 3.1, 400)
    ends = backed(hitch, most, gamma, lambda _: np.zeros(1), v=-length)[-1]
    got = gamma[np.abs(ends) < 0.1].max()
    own = most / np.sqrt(1 + most**2 * (h**2 - length**2)) if most * length < np.hypot(1, most * h) else np.inf
    return row_of(*map(number, (h, length, most, abs(hitch_on_circle(hitch, most)), got, own)))


def reversed_car(slow: float) -> Row:
    """A car whose reference stops and reverses every 3 s along an arc."""
    motion, constants = car(1, COUNT)
    bend, rate = np.linspace(-0.8, 0.8, COUNT), 2 * np.pi / 6

    def reference(time: float) -> tuple[Array, Array]:
        speed, more = 0.7 * np.cos(rate * time), -0.7 * rate * np.sin(rate * time)
        return np.stack((0 * bend + speed, 0 * bend, bend * speed), 1), np.stack(
            (0 * bend + more, 0 * bend, bend * more), 1
        )

    motion.reference, motion.slow = reference, slow
    _, errors, chis = motion.run(*motion.begun(5, COUNT, 0.02, 0.2), 12.0)
    late = constants.size(errors)[1500:].max(axis=0)
    turned = np.abs(motion.turned).max()
    cells = (1e3 * late.max(), np.abs(chis[1500:]).max(), turned)
    return row_of(f"car that reverses, eps {1e3 * slow:.0f} mm/s", *map(number, cells))


def loader(trail: float, exact: bool) -> Row:
    """A loader whose axle at the control frame leads, its waist 0.65 m behind it and the other axle behind that."""
    motion, constants = car(1, COUNT)
    motion.trail, motion.pivots, motion.length = -trail, np.array([[-0.65, 0.0]]), 0.65 + trail
    motion.exact, motion.slow = exact, 0.03
    _, errors, chis = motion.run(*motion.begun(6, COUNT, 0.02, 0.2), 12.0)
    cells = (1e3 * constants.size(errors)[1500:].max(), np.abs(chis[1500:]).max(), np.abs(motion.turned).max())
    law = "-s / t" if exact else "law that steers"
    return row_of(f"loader, axle {trail:.2f} m behind its waist, {law}", *map(number, cells))


def main() -> None:
    """Print the tables."""
    mu = least_second_eigenvalue(np.array(SQUARE), gyration(SQUARE))
    heads = ("m", "B0\nm/s", "B1\n1/s", "K of theorem 1\n1/s", "largest size\nwith it", "K that motions need\n1/s")
    columns = (Column(text=True), *map(Column, heads))
    tables = [
        Table(
            f"from size {BEGIN} and angles of {ANGLE} within size {WITHIN}; mu of the swerve drive {mu:.3g}",
            columns,
            tuple(map(needed, CASES)),
        )
    ]
    heads = ("gain\n1/s", "K\n1/s", "eps\nmm/s", "by the formula\nmm", "largest left\nmm", "median\nmm")
    tables.append(
        Table(
            "a swerve drive 10 s on its way to a pose at rest",
            tuple(map(Column, heads)),
            tuple(rest(*r) for r in RESTS),
        )
    )
    heads = ("h\nm", "L\nm", "curvature\n1/m", "gamma_J\nrad", "straight from\nrad", "trailer's own\n1/m")
    tables.append(Table("backing", tuple(map(Column, heads)), tuple(jackknife(*t) for t in TRUCKS)))
    columns = (Column(text=True), *map(Column, ("late size\nmm", "late angle\nrad", "fastest wheel\nrad/s")))
    trails = ((0.0, False), (0.02, False), (0.2, False), (0.6, False), (0.6, True))
    outside = (reversed_car(0.03), reversed_car(0.005), *(loader(*t) for t in trails))
    tables.append(Table("outside of the theorems", columns, outside))
    print(terminal_text(tables, False, 140))


if __name__ == "__main__":
    main()

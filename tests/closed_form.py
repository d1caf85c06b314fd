"""A planar mobile manipulator worked out by hand: platform, two drive wheels, two links. The tests' second answer.

Everything is written in the control frame (x forward, y left), which moves with `v` along its x and turns with `w`.
A body whose centre stands at `p` moves in that frame's axes with

    u = (v - w p_y, w p_x) + pdot = J(q) nu        and accelerates with        J nudot + (Jdot + w X J) nu

where X turns by a quarter, so by d'Alembert with the constant rows `j` of the angular rates

    M = sum m J' J + I j j'        C = sum m J' (Jdot + w X J)

No coordinate of the world appears, nor does Pinocchio. C is the one of Christoffel's symbols: `Mdot = C + C'`.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np

QUARTER = np.array([[0.0, -1.0], [1.0, 0.0]])
COULOMB_SPEED = 0.01  # [rad/s]


@dataclass(frozen=True)
class Link:
    """A link of the arm in its plane."""

    length: float = 0.4
    mass: float = 4.0
    centre: float = 0.2
    inertia: float = 0.0533  # about the centre
    damping: float = 0.0
    coulomb: float = 0.0


@dataclass(frozen=True)
class Planar:
    """The robot; the defaults are Tables 4.1 and 4.2 with the arm mounted where the shipped URDF has it.

    `root` is the control frame (x, y, heading) in the root link's frame; everything else is in the control frame.
    """

    half_track: float = 0.171
    radii: tuple[float, float] = (0.075, 0.075)
    flips: tuple[int, int] = (1, 1)
    wheel_mass: float = 5.0
    wheel_spin: float = 0.010  # Iw, about the axle
    wheel_turn: float = 0.135  # Im, about a diameter
    wheel_damping: float = 0.0
    wheel_coulomb: float = 0.0
    mass: float = 94.0
    inertia: float = 6.609  # about the centre of mass
    centre: tuple[float, float] = (0.0, 0.0)
    mount: tuple[float, float] = (0.12, 0.0)
    links: tuple[Link, Link] = field(default_factory=lambda: (Link(), Link()))
    root: tuple[float, float, float] = (0.0, 0.0, 0.0)

    # --- The closed form ----------------------------------------------------------------------------------------------

    def bodies(self, q: np.ndarray, qdot: np.ndarray) -> Iterator[tuple[float, np.ndarray, np.ndarray]]:
        """Mass, J (2, 4) and Jdot (2, 4) of every body's centre."""
        yield self.mass, still(*self.centre), np.zeros((2, 4))
        for side in (1, -1):
            yield self.wheel_mass, still(0.0, side * self.half_track), np.zeros((2, 4))
        first, second = self.links
        angles, rates = np.cumsum(q), np.cumsum(qdot)
        reach = [first.centre * along(angles[0])]
        reach += [first.length * along(angles[0]), second.centre * along(angles[1])]
        speed = [rate * QUARTER @ r for r, rate in zip(reach, [rates[0], *rates], strict=True)]
        for mass, chain in ((first.mass, [0]), (second.mass, [1, 2])):
            p = np.array(self.mount) + sum(reach[i] for i in chain)
            J, Jdot = still(*p), np.zeros((2, 4))
            Jdot[:, 1] = QUARTER @ sum(speed[i] for i in chain)
            for i in chain:
                for joint in range(2 if i == 2 else 1):
                    J[:, 2 + joint] += QUARTER @ reach[i]
                    Jdot[:, 2 + joint] += QUARTER @ speed[i]
            yield mass, J, Jdot

    def mass_matrix(self, q: np.ndarray) -> np.ndarray:
        """M, (4, 4), of nu = (v, w, q1dot, q2dot)."""
        M = sum(m * J.T @ J for m, J, _ in self.bodies(q, np.zeros(2)))
        rates = [(self.inertia, [0, 1, 0, 0]), (2 * self.wheel_turn, [0, 1, 0, 0])]
        rates += [(self.links[0].inertia, [0, 1, 1, 0]), (self.links[1].inertia, [0, 1, 1, 1])]
        rates += [(self.wheel_spin, row) for row in self.wheel_rows()]
        return M + sum(inertia * np.outer(row, row) for inertia, row in rates)

    def coriolis_matrix(self, q: np.ndarray, nu: np.ndarray) -> np.ndarray:
        """C, (4, 4)."""
        w, qdot = nu[1], nu[2:]
        return sum(m * J.T @ (Jdot + w * QUARTER @ J) for m, J, Jdot in self.bodies(q, qdot))

    def wheel_rows(self) -> np.ndarray:
        """(2, 4) joint velocities of the left and the right wheel, as the signs of their axes have it."""
        b = self.half_track
        return np.array(
            [[f / r, -f * y / r, 0, 0] for y, r, f in zip((b, -b), self.radii, self.flips, strict=True)], float
        )

    def friction(self, nu: np.ndarray) -> np.ndarray:
        """Friction of the joints on nu, (4,)."""
        wheels, arm = self.wheel_rows(), np.zeros(4)
        for i, link in enumerate(self.links, start=2):
            arm[i] = link.damping * nu[i] + link.coulomb * np.tanh(nu[i] / COULOMB_SPEED)
        rates = wheels @ nu
        return arm + wheels.T @ (self.wheel_damping * rates + self.wheel_coulomb * np.tanh(rates / COULOMB_SPEED))

    def acceleration(self, q: np.ndarray, nu: np.ndarray, tau: np.ndarray, viscous: np.ndarray) -> np.ndarray:
        """Acceleration nudot, (4,), under tau."""
        rest = tau - self.coriolis_matrix(q, nu) @ nu - self.friction(nu) - viscous * nu
        return np.linalg.solve(self.mass_matrix(q), rest)

    # --- The same robot as a URDF -------------------------------------------------------------------------------------

    def urdf(self) -> str:
        """URDF of this robot; wheels come after the arm and right before left, to keep nothing in the handy order."""
        a, c, psi = self.root
        R = np.column_stack((along(psi), QUARTER @ along(psi)))

        def place(x: float, y: float, z: float) -> str:
            x, y = (R @ (x, y) + (a, c)).tolist()
            return f'<origin xyz="{x!r} {y!r} {z!r}" rpy="0 0 {psi!r}"/>'

        text = f'<link name="base">{inertial(self.mass, (1.0, 1.0, self.inertia), place(*self.centre, 0.2))}</link>'
        first, second = self.links
        text += arm_link("one", "base", place(*self.mount, 0.4), first)
        text += arm_link("two", "one", f'<origin xyz="{first.length!r} 0 0"/>', second)
        sides = (("left", self.half_track), ("right", -self.half_track))
        for (name, y), r, flip in reversed(list(zip(sides, self.radii, self.flips, strict=True))):
            moments = (self.wheel_turn, self.wheel_spin, self.wheel_turn)
            shape = f'<collision><origin rpy="{np.pi / 2!r} 0 0"/><geometry><cylinder radius="{r!r}" length="0.03"/>'
            text += f'<link name="{name}">{inertial(self.wheel_mass, moments)}{shape}</geometry></collision></link>'
            rubs = f'<dynamics damping="{self.wheel_damping!r}" friction="{self.wheel_coulomb!r}"/>'
            text += joint(f"{name}_joint", "base", name, place(0.0, y, r), f"0 {flip} 0", rubs)
        return f'<robot name="planar">{text}</robot>'


def still(x: float, y: float) -> np.ndarray:
    """J of a point that stands at (x, y) in the control frame, (2, 4)."""
    return np.array([[1.0, -y, 0.0, 0.0], [0.0, x, 0.0, 0.0]])


def along(angle: float) -> np.ndarray:
    """Unit vector, (2,)."""
    return np.array([np.cos(angle), np.sin(angle)])


def inertial(mass: float, moments: tuple[float, float, float], origin: str = "") -> str:
    """`<inertial>` with principal moments."""
    names = zip(("ixx", "iyy", "izz"), moments, strict=True)
    tensor = " ".join(f'{name}="{value!r}"' for name, value in names)
    return f'<inertial>{origin}<mass value="{mass!r}"/><inertia {tensor} ixy="0" ixz="0" iyz="0"/></inertial>'


def joint(name: str, parent: str, child: str, origin: str, axis: str, more: str = "", kind: str = "continuous") -> str:
    """`<joint>`."""
    ends = f'<parent link="{parent}"/><child link="{child}"/>'
    return f'<joint name="{name}" type="{kind}">{ends}{origin}<axis xyz="{axis}"/>{more}</joint>'


def arm_link(name: str, parent: str, origin: str, link: Link) -> str:
    """A link of the arm and its joint about the vertical."""
    moments = (0.01, link.inertia, link.inertia)
    body = inertial(link.mass, moments, f'<origin xyz="{link.centre!r} 0 0"/>')
    rubs = f'<dynamics damping="{link.damping!r}" friction="{link.coulomb!r}"/>'
    return f'<link name="{name}">{body}</link>' + joint(f"{name}_joint", parent, name, origin, "0 0 1", rubs)

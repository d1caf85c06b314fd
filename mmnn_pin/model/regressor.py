"""The regressor of a robot whose masses are not known: `Y(q, nu, nu_ref, nudot_ref) theta = Psi`, linear in theta.

Only the kinematics of the robot are read: placements, axes and T. Its inertias are replaced by random ones, with which
the regressor is checked against Pinocchio when it is built, and then by zeros. `mmnn_pin.model.parameters` gives the
theta of a robot that is known; a controller does not import it.

theta: ten numbers `m, mc, Sigma` per body that moves (the pseudo-inertia, in the joint's frame turned so that its axis
is z; joints that stand still are lumped into the body that carries them), then the inertia of every joint's rotor,
viscous friction of the base's velocities, viscous and dry friction of every joint [kg, kg m, kg m^2; N s/m; N m].
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from mmnn_pin.errors import RobotError
from mmnn_pin.model.reduction import COULOMB_SPEED

from .checks.tree import TOLERANCE, configuration
from .tree.motion import AT, BASE, NUMBER, Array, Tree, new_scratch
from .tree.regressor import BODY, Massless, regress
from .tree.tree import flatten

if TYPE_CHECKING:
    from mmnn_pin.model.robot import Robot

MOMENTS = ("m", "mx", "my", "mz", "xx", "xy", "xz", "yy", "yz", "zz")
RANK = 1e-9  # relative size under which a singular value of stacked regressors counts as zero


@dataclass(frozen=True, eq=False)
class Regressor:
    """The regressor of one robot; k parameters.

    Attributes:
        massless: The arrays of the compiled functions; `workspace` makes those of another thread.
        bodies: Joint that carries each moving body, `root` for the base.
        joints: Joints that move.
        labels: Name of every parameter, `body.m` to `body.zz`, `joint.rotor`, `v.viscous`, `joint.coulomb` ...
    """

    massless: Massless
    bodies: tuple[str, ...]
    joints: tuple[str, ...]
    labels: tuple[str, ...]

    @classmethod
    def of(cls, robot: Robot, coulomb_speed: float = COULOMB_SPEED) -> Regressor:
        """Regressor of a robot, of which only the kinematics are read.

        Args:
            robot: The robot.
            coulomb_speed: Velocity in `tanh(velocity / coulomb_speed)` of the dry friction [rad/s or m/s].

        Raises:
            RobotError: A joint that cannot be flattened, or a regressor that differs from Pinocchio's dynamics.
        """
        layout, T = robot.layout, np.array(robot.T)
        frame = tuple(robot.frame) if layout.base else (0.0, 0.0, 0.0)
        model = with_any_inertias(robot.model)
        full = flatten(model, T, robot.neutral_position(), frame, absorb=False)
        theta, moving = inertial_parameters(full, layout.base), moving_joints(T, layout.base)
        offset, arm = robot.arm_map()
        massless = without_masses(full, T, layout.base, offset, arm, coulomb_speed)
        names = robot.full_velocity_names
        bodies = ("root",) * bool(layout.base) + tuple(names[i] for i in full.links[BASE.w + 1 :, 2])
        joints = tuple(names[i] for i in moving)
        labels = [f"{body}.{moment}" for body in bodies for moment in MOMENTS]
        labels += [f"{joint}.rotor" for joint in joints]
        labels += [f"{name}.viscous" for name in (*robot.velocity_names[: layout.base], *joints)]
        labels += [f"{joint}.coulomb" for joint in joints]
        regressor = cls(massless, bodies, joints, tuple(labels))
        regressor.verify(model, T, theta)
        return regressor

    @property
    def size(self) -> int:
        """Number of parameters k."""
        return len(self.labels)

    @property
    def inertial(self) -> int:
        """Number of inertial parameters, ten per body; they stand first."""
        return BODY * len(self.bodies)

    def workspace(self) -> Massless:
        """The same arrays with a memory of its own to work in."""
        m = self.massless
        return m._replace(
            scratch=m.scratch.copy(), position=m.position.copy(), nu=m.nu.copy(), out=m.out.copy(), Y=m.Y.copy()
        )

    def matrix(self, position: Array, nu: Array, nu_ref: Array, nudot_ref: Array) -> Array:
        """Y, (p, k): `Y theta = M nudot_ref + C(q, nu) nu_ref + gravity + friction`.

        Threads may share a regressor: each call works in a memory of its own.

        Args:
            position: (nv,) pose of the control frame and joint coordinates [m, rad].
            nu: (p,) velocities.
            nu_ref: (p,) reference velocities.
            nudot_ref: (p,) their time derivative.
        """
        own = self.workspace()
        own.position[:], own.nu[:] = position, nu
        regress(own, np.array(nu_ref, float), np.array(nudot_ref, float))
        return own.Y

    def gram(self, samples: int = 200, seed: int = 0) -> Array:
        """Mean of `Y' Y` over random states and references of unit size, (k, k)."""
        rng, m = np.random.default_rng(seed), self.massless
        stacked = [self.matrix(self.random_position(rng), *rng.standard_normal((3, m.nu.size))) for _ in range(samples)]
        Y = np.vstack(stacked)
        return np.asarray(Y.T @ Y / samples)

    def identifiable(self, samples: int = 200, seed: int = 0) -> Array:
        """Orthonormal basis of the directions of theta that Psi depends on, (k, number of base parameters).

        The others change nothing on any motion: Y times them is zero. (Base parameters, numerically: Gautier 1991,
        J. Robotic Systems 8(4).) After the reduction by T they are fewer than those of the robot on its own.
        """
        gram = self.gram(samples, seed)
        scale = 1.0 / np.sqrt(np.where(np.diag(gram) > 0, np.diag(gram), 1.0))
        values, vectors = np.linalg.eigh(gram * np.outer(scale, scale))
        kept = vectors[:, values > RANK * values[-1]] / scale[:, None]
        return np.asarray(np.linalg.qr(kept)[0])

    def unit(self, samples: int = 200, seed: int = 0) -> Array:
        """The same directions scaled so that random motion excites each with 1, (k, number of base parameters).

        With these columns W, `W' gram() W = 1`, and the eigenvalues of `W' G W` are the excitation of a motion whose
        mean `Y' Y` is G, relative to random motion.
        """
        gram = self.gram(samples, seed)
        scale = 1.0 / np.sqrt(np.where(np.diag(gram) > 0, np.diag(gram), 1.0))
        values, vectors = np.linalg.eigh(gram * np.outer(scale, scale))
        kept = values > RANK * values[-1]
        return np.asarray(scale[:, None] * vectors[:, kept] / np.sqrt(values[kept]))

    def random_position(self, rng: np.random.Generator) -> Array:
        """A pose and an arm somewhere, slaves with their masters, (nv,)."""
        m = self.massless
        position = m.offset + m.arm @ rng.uniform(-np.pi, np.pi, m.arm.shape[1])
        if m.base:
            position[:3] = rng.uniform(-np.pi, np.pi, 3)
        return position

    def verify(self, model: pin.Model, T: Array, theta: Array, samples: int = 5, seed: int = 0) -> None:
        """Compare `Y theta` with Pinocchio's full matrices at random states.

        Raises:
            RobotError: They differ by more than 1e-10 of the largest force.
        """
        rng, data, p = np.random.default_rng(seed), model.createData(), T.shape[1]
        worst = 0.0
        for _ in range(samples):
            position = self.random_position(rng)
            nu, nu_ref, nudot_ref = rng.standard_normal((3, p))
            q = configuration(model, position, self.massless.tree.frame)
            M, C = pin.crba(model, data, q), pin.computeCoriolisMatrix(model, data, q, T @ nu)
            full = M @ T @ nudot_ref + C @ T @ nu_ref + pin.computeGeneralizedGravity(model, data, q)
            psi = T.T @ full
            ours = self.matrix(position, nu, nu_ref, nudot_ref)[:, : theta.size] @ theta
            worst = max(worst, float(np.nan_to_num(np.abs(ours - psi) / np.abs(psi).max(), nan=np.inf).max()))
        if worst > TOLERANCE:
            raise RobotError(
                f"the regressor differs from Pinocchio's dynamics by {worst:.1e}, relative",
                why=f"at most {TOLERANCE:.0e} is accepted",
                fix="look for joints whose distances or rows of T are far apart in size",
            )


def without_masses(tree: Tree, T: Array, base: int, offset: Array, arm: Array, coulomb_speed: float) -> Massless:
    """What a tree says of the motion, and memory to work in.

    Args:
        tree: A tree with a body for every joint that moves (`flatten(..., absorb=False)`).
        T: (nv, p) the map it was made with.
        base: Number of base velocities.
        offset: (nv,) positions where the arm's joints stand at 0.
        arm: (nv, n) what each arm joint moves.
        coulomb_speed: As in `Regressor.of`.
    """
    numbers, joints = tree.numbers.copy(), T[moving_joints(T, base)]
    numbers[:, NUMBER.mass : NUMBER.weight] = 0.0
    first, p = first_body(base), T.shape[1]
    scratch = new_scratch(tree)
    scratch[BASE.w, AT.rotation : AT.rotation + 9] = np.eye(3).ravel()
    return Massless(
        tree=tree._replace(numbers=numbers, rotors=np.zeros((p, p)), root_energy=0.0),
        joints=joints,
        base=base,
        first=first,
        offset=offset,
        arm=arm,
        coulomb_speed=float(coulomb_speed),
        scratch=scratch,
        position=offset.copy(),
        nu=np.zeros(p),
        out=np.zeros(p),
        Y=np.zeros((p, BODY * (len(tree.links) - first) + 3 * len(joints) + base)),
    )


def inertial_parameters(tree: Tree, base: int) -> Array:
    """The ten numbers of every body of a tree, one after the other."""
    return np.array(tree.numbers[first_body(base) :, NUMBER.mass : NUMBER.weight].ravel())


def first_body(base: int) -> int:
    """Row of a tree with the first body that moves."""
    return BASE.w if base else BASE.w + 1


def moving_joints(T: Array, base: int) -> NDArray[np.int64]:
    """Rows of T of the joints that move, without the root."""
    root = 3 if base else 0
    return root + np.flatnonzero(T[root:].any(axis=1))


def with_any_inertias(model: pin.Model, seed: int = 0) -> pin.Model:
    """A copy of a model with random inertias of eight particles each, and no armature."""
    rng, copy = np.random.default_rng(seed), model.copy()
    for j in range(1, copy.njoints):
        masses, points = rng.uniform(0.1, 1.0, 8), rng.uniform(-0.3, 0.3, (8, 3))
        total = masses.sum()
        centre = masses @ points / total
        second = (points - centre).T @ np.diag(masses) @ (points - centre)
        copy.inertias[j] = pin.Inertia(total, centre, np.trace(second) * np.eye(3) - second)
    copy.armature = np.zeros(copy.nv)
    return copy

"""One control period of robots in any directions against (A), (B), (E) of docs/explanation/theory.md, torques held.

What runs of the certified robot cannot show, as its bounds are far above them: from states anywhere in boxes the
errors are moved over a period by Pinocchio's dynamics, under forces and a velocity error that feed the most energy in,
dry friction included, and compared with what the inequalities allow after that period.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import pytest
from proofs import SLOW
from robots import mobile_arm

from mmnn_pin import PD, Circle, Eight, Feedback, Line, Loop, Sine, Timing, Trajectory, load
from mmnn_pin.kinematic import Kinematic, command
from mmnn_pin.lab.psi.subject import Subject
from mmnn_pin.loop.before_run import Start
from mmnn_pin.model.dynamics import Dynamics
from mmnn_pin.signals import Array, Layout
from research.proof.boxes import Box, Boxes, Faces
from research.proof.certified_loop import CertifiedLoop, certified_loop

compiled_only = pytest.mark.skipif(SLOW, reason="thousands of uncompiled steps")
STEPS = 4  # RK4 steps in a period
BOXES = ((1e-3, 2e-4, 1e-3), (0.07, 0.02, 1e-3), (0.3, 0.1, 0.02), (0.6, 0.2, 0.3))  # pose, arm, energy, scaled below


def random_loop(seed: int) -> CertifiedLoop:
    """A robot, gains and a reference from a seed; PD, whose bounds stand for those of any controller."""
    rng = np.random.default_rng(seed)
    robot = load("platform_arm") if seed % 3 == 0 else mobile_arm(1 + seed % 3)
    n, h = robot.dimensions.arm, float(rng.choice([1e-4, 2e-4, 5e-4]))
    inertia = 1 / np.diag(np.linalg.inv(Dynamics(robot).mass_matrix(robot.neutral_position())))
    robot = robot.with_friction(rng.uniform(0, 1, n + 2) * inertia)
    robot = robot.with_joint_friction(0.0, rng.uniform(0, 0.5, n) * inertia[2:], rng.uniform(1, 1.5, n))
    path = (Line(0.5), Circle(1.0, 0.4, ramp=0.0), Eight(3.0, 1.5, 12.0, ramp=0.0))[seed % 3]
    arm = tuple(Sine(*rng.uniform((0.0, 3.0, -0.5), (0.4, 8.0, 0.8))) for _ in range(n))
    ky, gain = rng.uniform(2, 20), rng.uniform(0.05, 0.12) / h * inertia
    kinematic = Kinematic(
        rng.uniform(0.5, 3), ky, rng.uniform(0.5, 2.5) * ky**0.5, tuple(rng.uniform(1, 5, n).tolist())
    )
    loop = Loop(
        robot,
        Trajectory(path, arm),
        PD(Feedback(tuple(gain[:2].tolist()), tuple(gain[2:].tolist()))),
        kinematic=kinematic,
        timing=Timing(1000 * h, h, h),
        start=Start(moving=True),
        check_gains=False,
    )
    found = certified_loop(Subject.of(loop.run()))
    return replace(found, disturbance=rng.uniform(0, 3, n + 2) * inertia, weighs=seed >= 6)


@dataclass(frozen=True, eq=False)
class Period:
    """One control period from the k-th instant of a loop's reference; states are pose, q, nu, the reference's pose."""

    loop: CertifiedLoop
    k: int

    @cached_property
    def dynamics(self) -> Dynamics:
        return Dynamics(self.loop.robot)

    @cached_property
    def row(self) -> Array:
        return Layout.of(self.loop.robot.dimensions).new_row()

    def split(self, state: Array) -> list[Array]:
        n = self.loop.robot.dimensions.arm
        return np.split(state, np.cumsum([3, n, n + 2]))

    def position(self, state: Array) -> Array:
        robot, (pose, q, _, _) = self.loop.robot, self.split(state)
        position = robot.neutral_position()
        position[:3], position[robot.arm_index] = pose, q
        return robot.follow(position)

    def nu_ref(self, t: float, state: Array) -> Array:
        """The command; the row holds the errors then."""
        along, layout, k = self.loop.along, Layout.of(self.loop.robot.dimensions), self.k
        pose, q, nu, pose_ref = self.split(state)
        values = {"pose_ref": pose_ref, "velocity_ref": along.v_ref[k] + t * along.a_ref[k], "pose": pose, "q": q}
        values |= {"acceleration_ref": along.a_ref[k], "qddot_ref": along.qddot_ref[k]}
        values["q_ref"] = along.q_ref[k] + t * along.qdot_ref[k] + t**2 / 2 * along.qddot_ref[k]
        values |= {"qdot_ref": along.qdot_ref[k] + t * along.qddot_ref[k], "velocity": nu[:2], "qdot": nu[2:]}
        for name, value in values.items():
            self.row[layout.where(name)] = value
        command(self.row, layout.offsets, self.loop.kinematic.base_gains(layout), self.loop.K)
        return self.row[layout.where("nu_ref")].copy()

    def sizes(self, t: float, state: Array) -> Array:
        """Size of the pose error, of the arm's, and the energy, (3,)."""
        loop, where = self.loop, Layout.of(self.loop.robot.dimensions).where
        s = self.nu_ref(t, state) - self.split(state)[2]
        e, N = self.row[where("e")], loop.metric.N
        energy = s @ self.dynamics.mass_matrix(self.position(state)) @ s / 2
        return np.array([loop.pose.size(self.row[where("pose_error")][None])[0], np.sqrt(e @ N @ e), energy])

    def rates(self, t: float, state: Array, tau: Array) -> Array:
        (pose, _, nu, pose_ref), position, d = self.split(state), self.position(state), self.dynamics
        known = d.coriolis_matrix(position, nu) @ nu + d.gravity(position) + d.friction(nu)
        nudot = np.linalg.solve(d.mass_matrix(position), tau - known)
        v, w = self.loop.along.v_ref[self.k] + t * self.loop.along.a_ref[self.k]
        moved = [(u * np.cos(at[2]), u * np.sin(at[2]), r) for u, r, at in ((*nu[:2], pose), (v, w, pose_ref))]
        return np.concatenate((moved[0], nu[2:], nudot, moved[1]))

    def after(self, state: Array, tau: Array) -> Array:
        """The state a period later, by RK4."""
        dt = self.loop.period / STEPS
        for t in np.arange(STEPS) * dt:
            a = self.rates(t, state, tau)
            b = self.rates(t + dt / 2, state + dt / 2 * a, tau)
            c = self.rates(t + dt / 2, state + dt / 2 * b, tau)
            state = state + dt / 6 * (a + 2 * b + 2 * c + self.rates(t + dt, state + dt * c, tau))
        return state


def anywhere(period: Period, box: Box, rng: np.random.Generator) -> Array:
    """A state of a box with pose and arm errors near its faces, s = 0."""
    loop, along, k = period.loop, period.loop.along, period.k
    error = rng.standard_normal(3) * np.array([1, 1, np.sqrt(loop.pose.ky)])
    error *= 1.3 * box.pose / np.linalg.norm(error / np.array([1, 1, np.sqrt(loop.pose.ky)]))
    while loop.pose.size(error[None])[0] > 0.98 * box.pose:
        error *= 0.99
    y = rng.standard_normal(len(loop.K))
    e = loop.metric.root @ (y / np.linalg.norm(y)) * 0.98 * box.arm
    pose_ref = along.pose_ref[k]
    phi = pose_ref[2] - error[2]
    c, s = np.cos(phi), np.sin(phi)
    pose = pose_ref - np.array([c * error[0] - s * error[1], s * error[0] + c * error[1], error[2]])
    state = np.concatenate((pose, along.q_ref[k] - e, np.zeros(loop.robot.dimensions.dof), pose_ref))
    return moved(period, state, 0.0)


def moved(period: Period, state: Array, s: Array | float) -> Array:
    """The same with a velocity error s (p,)."""
    state = state.copy()
    period.split(state)[2][:] = period.nu_ref(0.0, state) - s
    return state


def worst_s(period: Period, state: Array, box: Box, force: Array, loss: Array, rng: np.random.Generator) -> Array:
    """S (p,) in a box: any, or where `s' (Psi +- force) - s' loss s` is the largest, Psi as it is at s = 0."""
    position, nu = period.position(state), period.split(state)[2]
    M, x = period.dynamics.mass_matrix(position), rng.standard_normal(nu.size)
    if rng.random() < 0.6:
        nudot_ref = period.row[Layout.of(period.loop.robot.dimensions).where("nudot_ref")].copy()
        psi = period.dynamics.psi(position, nu, nu, nudot_ref)
        if period.loop.weighs:
            psi = psi - period.dynamics.gravity(position)
        x = np.linalg.solve(loss, psi + np.where(psi < 0, -force, force)) / 2
    most = np.sqrt(2 * 0.98 * box.energy / (x @ M @ x))
    return x * (min(most, 1.0) if rng.random() < 0.5 else most)


def allowed(faces: Faces, loop: CertifiedLoop, before: Array) -> Array:
    """Largest sizes after a period from those before it, by (A), (B), (E): `x' <= -rate (x - stands)`."""
    stands = np.array([faces.pose, faces.arm, faces.motion.level])
    rates = np.array([faces.decay, loop.arm_decay, 2 * faces.motion.rate])
    left = np.exp(-rates * loop.period)
    return np.where(np.isfinite(stands), np.where(np.isfinite(stands), stands, 0) * (1 - left) + before * left, np.inf)


def gained(before: float, after: float, faces: Faces, period: float) -> float:
    """What a period adds to the energy without its decay, over the largest that (E) allows; 1 where it is sharp."""
    rate, level = faces.motion.rate, faces.motion.level
    return float((after - before * np.exp(-2 * rate * period)) / (level * -np.expm1(-2 * rate * period)))


@compiled_only
@pytest.mark.parametrize("seed", range(9))
def test_no_held_torque_within_its_bounds_beats_the_inequalities(seed: int) -> None:
    loop, rng, seen, nearest = random_loop(seed), np.random.default_rng(seed), 0, -np.inf
    M0 = loop.cover(0.0).postures.M[0]
    scale = np.trace(M0) / loop.robot.dimensions.dof
    stretch = np.sqrt(np.linalg.eigvalsh(loop.metric.N).max())
    for pose, arm, energy in BOXES:
        box = Box(pose * loop.pose.largest, float(arm * stretch), float(energy * np.sqrt(scale)))
        boxes = Boxes(loop, box)
        faces, gains = boxes.faces(box), boxes.gains
        for _ in range(12 if np.isfinite(faces.motion.level) else 0):
            period = Period(loop, int(rng.integers(len(loop.along.v_ref))))
            state, force = anywhere(period, box, rng), gains.network + gains.disturbance
            loss = np.diag(gains.upper) - faces.motion.rate * M0
            s = worst_s(period, state, box, force, loss, rng)
            state, tau = moved(period, state, s), gains.upper * s - np.sign(s) * force
            if loop.weighs:
                tau = tau + period.dynamics.gravity(period.position(state))
            before, after = period.sizes(0.0, state), period.sizes(loop.period, period.after(state, tau))
            assert before[2] == pytest.approx(s @ period.dynamics.mass_matrix(period.position(state)) @ s / 2)
            assert (after <= allowed(faces, loop, before) * (1 + 1e-9)).all()
            seen, nearest = seen + 1, max(nearest, gained(before[2], after[2], faces, loop.period))
    assert seen >= 24 and nearest > 0.03  # of 1, where (E) is sharp

"""The contact plant: a free base on wheels that grip by friction, stepped by MuJoCo; a `Plant`, as the ideal one.

State and torques are those of the ideal plant: `nu` is the forward speed and yaw rate of the control frame and the
rates of the arm, whatever the wheels do; of a base that steers what the pivots, as they stand, make of the control
frame's velocity (`pivots`). What only this plant knows goes into the row by `observe`.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from ...elementary import arrays, cos_sin, hypot
from ...elementary.matrices import pseudo_inverse
from ...model.robot import Robot
from ...model.tree.twin import terms_of
from ...signals import Array, Layout
from .. import NO_PUSH
from ..integrators import PlantJoints, PlantTerms, plant_joints, plant_terms, respond
from .feet import Contact, feet_of, on_rollers
from .motion import BaseMotion, ContactFriction, FreeBase, tilt
from .steps import Steps
from .tree import NO_FRICTION, compile_tree, engine

FALLEN = 0.5  # inclination at which the base counts as fallen over [rad]
LOST = 1e5  # speed of anything at which the engine's state counts as lost [rad/s or m/s]
SLIPPING = 0.01  # a wheel whose contact point moves faster than this slips; contacts creep by less than 2 mm/s [m/s]


@dataclass
class Slip:
    """Slip of the wheels in a run: when, how fast, and what ended it.

    Args:
        wheels: Their joints.
        dt: Time between two samples [s].

    Attributes:
        samples: Samples so far.
        slipping: Those in which a wheel slipped.
        first: The first of them, -1 for none.
        fastest: Largest slip [m/s].
        wheel: The wheel that had it.
        ended: What ended the run, with its time; empty if nothing did.
    """

    wheels: tuple[str, ...]
    dt: float
    samples: int = 0
    slipping: int = 0
    first: int = -1
    fastest: float = 0.0
    wheel: str = ""
    ended: str = ""

    def take(self, speed: Array) -> None:
        """Take the speeds (wheels,) of the contact points over the floor [m/s]."""
        self.samples += 1
        worst = float(speed.max(initial=0.0))
        if worst <= SLIPPING:
            return
        self.slipping += 1
        if self.first < 0:
            self.first = self.samples
        if worst > self.fastest:
            self.fastest, self.wheel = worst, self.wheels[int(speed.argmax())]

    def end(self, what: str) -> None:
        """Say what ended the run; the first word counts."""
        self.ended = self.ended or f"{what} at t = {self.samples * self.dt:.3g} s"

    def findings(self) -> list[str]:
        """One line per thing to tell, none for wheels that rolled."""
        found = []
        if self.slipping:
            found.append(
                f"the wheels slipped for {self.slipping * self.dt:.3g} s, first at t = {self.first * self.dt:.3g} s, "
                f"by up to {self.fastest:.3g} m/s ('{self.wheel}')"
            )
        return [*found, self.ended] if self.ended else found


def sliding_rows(robot: Robot) -> tuple[Array, Array]:
    """Two (wheels, nv) maps from all velocities to each contact point's over the floor: along the wheel and across."""
    base, names = robot.base, robot.full_velocity_names
    along, across = np.zeros((2, len(base.wheels), len(names)))
    if on_rollers(robot):
        return along, across  # they slide as they please
    for i, wheel in enumerate(base.wheels):
        along[i, :3], across[i, :3] = wheel.grip @ base.to_control, base.to_control[1] + wheel.x * base.to_control[2]
        along[i, names.index(wheel.joint)] = -wheel.sign * wheel.radius
    return along, across


class ContactPlant:
    """A robot on a floor that it may slip on.

    Args:
        robot: The true robot, on plain wheels or a fixed arm.
        dt: Step of the plant [s]; the engine takes as many equal ones as `contact.step` asks for.
        method: "rk4", or MuJoCo's Euler with implicit friction, of first order, for any other.
        contact: The floor.
        touching: Frame at which `hand` acts; empty for none.

    Attributes:
        y: (nv + p + 1,) position, nu, and the work of motors and friction since the start; contacts take the rest of
            the energy. Not finite once the base has fallen over.
        position: View of the position in y.
        nu: View of nu in y.
        hold: (nv,) friction of joints that are blocked [N m or N].
        hand: (6,) where a force acts on the frame in the world, and that force, written by the loop [m, N]; (0,) for
            none.
        by_hand: (p,) what that is on nu, which is part of what is pushed.
        residual: (1,) `|A velocity|` (2.6), or (0,) without wheels [m/s].
        speed: (wheels,) speed of every wheel's contact point over the floor [m/s].
        traction: (wheels,) largest `|ft| / (mu N)` since the last `observe`, 0 in the air.
        slip: What the wheels did since the start.
        dynamics: Reduced dynamics of our model at the present state.

    Raises:
        ConfigError: MuJoCo is not installed.
        RobotError: A robot that this plant cannot carry.
    """

    def __init__(
        self, robot: Robot, dt: float, method: str = "rk4", contact: Contact | None = None, touching: str = ""
    ) -> None:
        self.robot, self.contact, self.mj, self.method = robot, contact or Contact(), engine(), method
        self.touching, self.on_rollers = touching, on_rollers(robot)
        self.mj.set_mju_user_warning(lambda text: None)  # it would print, and write a file
        self.steps = math.ceil(dt / self.contact.step - 1e-9)
        self.feet, self.h = feet_of(robot), dt / self.steps
        self.model = compile_tree(robot, self.feet, self.contact, self.h)
        self.data, self.dynamics = self.mj.MjData(self.model), terms_of(robot)
        nv, p, wheels = robot.dimensions.full, robot.dimensions.dof, len(self.feet.wheels)
        self.y = np.zeros(nv + p + 1)
        self.position, self.nu = self.y[:nv], self.y[nv : nv + p]
        self.velocity = np.zeros(nv)
        self.motion: BaseMotion | None = None
        self._index()
        self._take_model()
        self.hold, self.hand, self.by_hand = np.zeros(nv), NO_PUSH, NO_PUSH
        self.residual, self.speed, self.traction = np.zeros(min(1, wheels)), np.zeros(wheels), np.zeros(wheels)
        if not robot.steers:
            self.to_motors, (self.along, self.across) = pseudo_inverse(robot.E), sliding_rows(robot)
        self.slip = Slip(tuple(wheel.joint for wheel in robot.base.wheels), dt)

    def _index(self) -> None:
        """Where moving joints, motors and wheels of our model stand in MuJoCo's."""
        robot, model, names = self.robot, self.model, self.robot.full_velocity_names
        first = robot.dimensions.pose
        self.moving = np.array([i for i in range(first, len(names)) if names[i] not in robot.arm.locked], int)
        joints = [model.joint(names[i]) for i in self.moving]
        self.at_q = np.array([joint.qposadr[0] for joint in joints], int)
        self.at_v = np.array([joint.dofadr[0] for joint in joints], int)
        self.arm_v = np.array([model.joint(name).dofadr[0] for name in robot.joint_names], int)
        self.motor_v = np.array([model.joint(name).dofadr[0] for name in robot.actuator_names], int)
        self.motor_q = np.array([model.joint(name).qposadr[0] for name in robot.actuator_names], int)
        wheels = range(len(self.feet.wheels))
        self.pairs = [model.pair(f"wheel {i}").id for i in wheels]
        self.wheel_of = {model.geom(f"wheel {i}").id: i for i in wheels}
        if self.on_rollers:
            self.wheel_of = {}  # nothing of theirs grips
        self._wrench = np.zeros(6)

    def _take_model(self) -> None:
        """Base, friction and steps on MuJoCo's model."""
        robot, model = self.robot, self.model
        self.terms: tuple[PlantJoints, PlantTerms] | None = None
        self.base = FreeBase(robot, model) if robot.dimensions.base else None
        self.pivots = None if self.base is None else self.base.pivots
        self.friction = ContactFriction(robot, self.moving, self.at_v, model, self.base)
        self.engine = Steps(model, frozenset(self.wheel_of), self.method, self.pivots)
        self.body_touching = self._body_touching()
        if self.on_rollers:
            self._take_rollers()

    def _body_touching(self) -> int:
        """Id of the body on which `hand` acts; the world without one."""
        robot = self.robot
        if not self.touching:
            return 0
        joint = robot.model.frames[robot.model.getFrameId(self.touching)].parentJoint
        return int(self.model.body(f"{robot.model.names[joint]} body").id)

    def _take_rollers(self) -> None:
        """Wheels with rollers: the floor does not turn them, so what they weigh, and their friction, is the base's."""
        robot, model = self.robot, self.model
        rows = np.array([robot.rows[wheel.joint] for wheel in robot.base.wheels])
        turning = np.array([model.dof_M0[model.joint(wheel.joint).dofadr[0]] for wheel in robot.base.wheels])
        T = robot.T[rows, :3]
        model.dof_armature[:2] = np.mean(turning @ T[:, :2] ** 2)
        model.dof_armature[5] = turning @ T[:, 2] ** 2
        self.friction.roll(robot, rows, 0.0 if self.method == "rk4" else self.h)

    def start(self, position: Array, nu: Array) -> None:
        """Put the robot level on the floor at a position (nv,), rolling with nu (p,), no work done.

        Locked joints stand where the robot locks them, mimic joints follow.
        """
        data, v = self.data, self.robot.T_at(position) @ nu
        self._direct(np.zeros(3))
        self.mj.mj_resetData(self.model, data)
        data.qpos[self.at_q], data.qvel[self.at_v] = position[self.moving], v[self.moving]
        if self.base is not None:
            self.base.place(position[:3], v[:3], data.qpos[:7], data.qvel[:6])
        self.position[:], self.y[-1], self.traction[:], self.friction.last = position, 0.0, 0.0, None
        self._read()
        self.refresh()

    def refresh(self) -> None:
        """Evaluate M and h of our model at the present state."""
        self.dynamics.refresh(self.position, self.nu)

    def carry(self, robot: Robot) -> None:
        """Go on with a robot that carries more."""
        before, n, self.robot = self.data, self.dynamics.maps.n.copy(), robot
        self.model = compile_tree(robot, self.feet, self.contact, self.h)
        self.data, self.dynamics = self.mj.MjData(self.model), terms_of(robot)
        for name in ("qpos", "qvel", "qacc_warmstart"):
            getattr(self.data, name)[:] = getattr(before, name)
        self._take_model()
        self._direct(n)
        self._read()
        self.refresh()

    def _direct(self, n: Array) -> None:
        """Give u its direction, (3,), zeros for one that rolls most wheels forwards; none where nothing steers."""
        for maps in (self.dynamics.maps, *([] if self.pivots is None else [self.pivots.maps])):
            maps.n[:] = n

    def motor_speeds(self, speeds: Array) -> None:
        """Speed of every motor's joint, (motors,) [rad/s or m/s]."""
        speeds[:] = self.data.qvel[self.motor_v]
        if self.on_rollers:
            wheels, nb = speeds.size - self.robot.dimensions.arm, self.robot.dimensions.base
            speeds[:wheels] = self.robot.E[:nb, :wheels].T @ self.nu[:nb]

    def respond(self, tau: Array, E: Array, free: Array, answer: Array) -> None:
        """See `integrators.respond`; by our model, whose wheels roll: a wheel that slips is lighter."""
        robot, d = self.robot, self.dynamics
        if self.terms is None:
            friction = robot.damping, robot.dry, robot.viscous
            joints = plant_joints(friction, robot.dimensions.base, robot.dimensions.sideways, d.maps)
            self.terms = joints, plant_terms(d.v, d.M, d.h, d.F, self.hold, np.zeros_like(self.y))
        respond(self.h * self.steps, *self.terms, self.nu, tau, E, free, answer)

    def step(self, tau: Array, pushed: Array = NO_PUSH) -> None:
        """Advance by dt under a held generalized torque, (p,); `pushed` is the part that motors do not give."""
        data = self.data
        pushes = bool(pushed.any())
        own = tau - pushed if pushes else tau
        data.ctrl[:] = self.to_motors @ own if self.pivots is None else self.pivots.drive(own)
        if self.on_rollers:
            nb, wheels = self.robot.dimensions.base, len(self.robot.base.wheels)
            data.ctrl[:wheels] = 0.0
            pushed = np.concatenate((tau[:nb], pushed[nb:] if pushes else np.zeros(tau.size - nb)))
            pushes = True
        for _ in range(self.steps):
            turned = data.qpos[self.motor_q]
            if self.contact.patches and self.motion is not None:
                self._take_floor(self.motion)
            self.engine.take(data, lambda: self._force(pushed if pushes else NO_PUSH))
            if self._is_lost():
                return
            self._take_traction()
            self._read()
            work = data.ctrl @ (data.qpos[self.motor_q] - turned)
            if pushes:
                work += self.h * (pushed @ self.nu)
            self.y[-1] += work - self.h * self.friction.power(data, self.motion)
        self._take_slip()

    def _force(self, pushed: Array) -> None:
        """Friction and a push on nu, at the control frame and on the joints of the arm, for MuJoCo's present state."""
        data, nb = self.data, self.robot.dimensions.base
        motion = None if self.base is None else self.base.motion(data)
        if self.pivots is not None:
            self.pivots.couple()
        data.qfrc_applied[:] = 0.0
        self.friction.apply(data, motion, self.hold[self.moving])
        if pushed.size and self.hand.size:
            pushed = pushed - self.by_hand
            point, force = self.hand[:3], self.hand[3:]
            self.mj.mj_applyFT(self.model, data, force, np.zeros(3), point, self.body_touching, data.qfrc_applied)
        if pushed.size:
            data.qfrc_applied[self.arm_v] += pushed[nb:]
            if self.base is not None and motion is not None:
                self.base.push(data, motion, pushed[:nb])

    def observe(self, row: Array, layout: Layout) -> None:
        """Write constraint residual, slip and traction into a row, and start anew with the largest traction."""
        where = layout.where
        row[where("constraint_residual")] = self.residual
        row[where("slip")], row[where("traction")] = self.speed, self.traction
        self.traction[:] = 0.0

    def findings(self) -> list[str]:
        """Findings of the run so far: when the wheels slipped, whether the base fell over."""
        return self.slip.findings()

    def _read(self) -> None:
        """State of our model, and how its wheels move over the floor, from MuJoCo's state."""
        data, robot, nb = self.data, self.robot, self.robot.dimensions.base
        self.position[self.moving], self.velocity[self.moving] = data.qpos[self.at_q], data.qvel[self.at_v]
        self.nu[nb:] = self.velocity[robot.arm_index]
        if self.base is None:
            return
        self.motion = motion = self.base.motion(data)
        self.position[:2] = motion.pose[:2]
        self.position[2] += math.remainder(motion.pose[2] - self.position[2], math.tau)
        self.nu[:nb] = motion.nu
        self.velocity[:3] = self.base.from_control @ motion.velocity

    def _is_lost(self) -> bool:
        """Whether the base has fallen over or the engine's state is lost; then y is not finite."""
        fast = not np.abs(self.data.qvel).max(initial=0.0) < LOST
        fallen = not fast and self.base is not None and tilt(self.data.qpos[3:7]) > FALLEN
        if fast or fallen:
            self.y[:] = np.nan
            self.slip.end("the base fell over" if fallen else "the engine's state was lost")
        return fast or fallen

    def _take_slip(self) -> None:
        """Constraint residual and the speed of the contact points."""
        if self.pivots is not None and self.motion is not None:
            along, across = self.pivots.sliding(self.data, self.motion.velocity)
            self.residual[0], self.speed[:] = np.linalg.norm((along, across)), arrays.hypot(along, across)
        elif self.base is not None:
            self.residual[0] = 0.0 if self.on_rollers else np.linalg.norm(self.robot.A @ self.velocity)
            self.speed[:] = arrays.hypot(self.along @ self.velocity, self.across @ self.velocity)
        self.slip.take(self.speed)

    def _take_floor(self, motion: BaseMotion) -> None:
        """Friction under every wheel, where it now is."""
        robot = self.robot
        carriers = robot.base.carriers(motion.pose.tolist(), self.position[robot.shape_index].tolist())
        for pair, wheel in zip(self.pairs, robot.base.wheels, strict=True):
            x, y, heading = carriers[wheel.pivot + 1]
            c, s = cos_sin(heading)
            place = x + c * wheel.x - s * wheel.y, y + s * wheel.x + c * wheel.y
            self.model.pair_friction[pair, :2] = max(NO_FRICTION, self.contact.at(*place))

    def _take_traction(self) -> None:
        """How much of its grip every wheel used in the last step."""
        data = self.data
        for i in range(data.ncon):
            contact = data.contact[i]
            wheel = self.wheel_of.get(int(contact.geom2), self.wheel_of.get(int(contact.geom1), -1))
            if wheel < 0:
                continue
            self.mj.mj_contactForce(self.model, data, i, self._wrench)
            normal, grip = self._wrench[0], contact.friction[0]
            if normal > 0:
                use = hypot(self._wrench[1], self._wrench[2]) / (grip * normal)
                self.traction[wheel] = max(self.traction[wheel], use)

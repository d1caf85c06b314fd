"""Other simulators doing the same run: planar_arm, the reference and horizon of ours, the numpy controller in the loop.

Nothing of mmnn_pin is imported here: a peer may bring a Pinocchio or a numpy of its own. Each function imports one
peer, builds its model once and gives back what starts one run: a function that runs it and returns where it ended.
None of them holds the rolling constraint exactly, none computes Psi.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from importlib import import_module, metadata
from pathlib import Path
from typing import Any

import numpy as np
from numpy_law import Array, PlanarLoop

URDF = Path(__file__).with_name("planar_arm.urdf")
RUNS = 8  # per call of mujoco.rollout and thread
Work = dict[str, Array]
Timed = Callable[[], dict[str, Any]]


@dataclass(frozen=True)
class Peer:
    """A simulator beside ours."""

    package: str  # what pip calls it
    build: Callable[[Work], Callable[[], Timed]]  # builds it; raises ImportError where it is not installed
    what: str  # what is measured
    lacks: str  # what it does not do, or does otherwise


def closed(samples: int, final: Sequence[float] | Array) -> dict[str, Any]:
    """Result of a run with the controller in the loop: its steps and where it ended, (x, y, phi, arm)."""
    return {"steps": samples, "final": np.asarray(final, float).tolist()}


def mujoco_model(mujoco: Any, period: float) -> Any:
    """planar_arm in MuJoCo, without contacts and limits."""
    spec = mujoco.MjSpec.from_file(str(URDF))
    spec.option.timestep, spec.option.gravity = period, (0.0, 0.0, -9.81)
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_EULER
    spec.option.disableflags |= mujoco.mjtDisableBit.mjDSBL_CONTACT | mujoco.mjtDisableBit.mjDSBL_LIMIT
    return spec.compile()


def mujoco_loop(work: Work) -> Callable[[], Timed]:
    """MuJoCo stepped from Python."""
    mujoco: Any = import_module("mujoco")
    model = mujoco_model(mujoco, float(work["period"]))

    def prepare() -> Timed:
        loop, data = PlanarLoop(work), mujoco.MjData(model)
        data.qpos[:] = loop.start

        def run() -> dict[str, Any]:
            for i in range(loop.samples):
                data.qfrc_applied[:] = loop.force(i, data.qpos, data.qvel)
                mujoco.mj_step(model, data)
            return closed(loop.samples, data.qpos)

        return run

    return prepare


def mujoco_rollout(threads: int) -> Callable[[Work], Callable[[], Timed]]:
    """mujoco.rollout on some threads, open loop: forces given beforehand, nobody in the loop."""

    def build(work: Work) -> Callable[[], Timed]:
        mujoco: Any = import_module("mujoco")
        rollout: Any = import_module("mujoco.rollout")
        model, loop = mujoco_model(mujoco, float(work["period"])), PlanarLoop(work)
        full = mujoco.mjtState.mjSTATE_FULLPHYSICS
        state, data = np.zeros(mujoco.mj_stateSize(model, full)), [mujoco.MjData(model) for _ in range(threads)]
        data[0].qpos[:] = loop.start
        mujoco.mj_getState(model, data[0], state, full)
        forces = np.zeros((RUNS * threads, loop.samples, model.nv))
        forces[:] = 0.1 * np.sin(np.arange(loop.samples) * float(work["period"]))[:, None]

        def run() -> dict[str, Any]:
            forced = int(mujoco.mjtState.mjSTATE_QFRC_APPLIED)
            rollout.rollout(model, data, np.tile(state, (len(forces), 1)), forces, control_spec=forced)
            return {"steps": loop.samples * len(forces), "rollouts": len(forces)}

        return lambda: run

    return build


def drake(work: Work) -> Callable[[], Timed]:
    """Drake's MultibodyPlant, stepped discretely, with a LeafSystem in Python."""
    pydrake: Any = import_module("pydrake.all")
    LeafSystem: Any = pydrake.LeafSystem
    period = float(work["period"])

    class Control(LeafSystem):
        """Torque of every period, held."""

        def __init__(self, n: int) -> None:
            super().__init__()
            self.n, self.loop = n, PlanarLoop(work)
            self.state_in = self.DeclareVectorInputPort("state", pydrake.BasicVector(2 * n))
            held = self.DeclareDiscreteState(n)
            self.DeclarePeriodicDiscreteUpdateEvent(period, 0.0, self.update)
            self.DeclareStateOutputPort("force", held)

        def update(self, context: Any, discrete: Any) -> None:
            """Forces of one sample."""
            state = self.state_in.Eval(context)
            i = min(round(context.get_time() / period), self.loop.samples - 1)
            discrete.set_value(self.loop.force(i, state[: self.n], state[self.n :]))

    def prepare() -> Timed:
        builder = pydrake.DiagramBuilder()
        plant, _ = pydrake.AddMultibodyPlantSceneGraph(builder, period)
        pydrake.Parser(plant).AddModels(str(URDF))
        plant.Finalize()
        control = builder.AddSystem(Control(plant.num_velocities()))
        builder.Connect(plant.get_state_output_port(), control.get_input_port())
        builder.Connect(control.get_output_port(), plant.get_applied_generalized_force_input_port())
        simulator = pydrake.Simulator(builder.Build())
        context = plant.GetMyContextFromRoot(simulator.get_mutable_context())
        plant.SetPositions(context, control.loop.start)
        simulator.Initialize()

        def run() -> dict[str, Any]:
            simulator.AdvanceTo(control.loop.samples * period)
            return closed(control.loop.samples, plant.GetPositions(context))

        return run

    return prepare


def pybullet(work: Work) -> Callable[[], Timed]:
    """PyBullet without a window, joints in torque control."""
    p: Any = import_module("pybullet")
    p.connect(p.DIRECT)
    period, free = float(work["period"]), {"linearDamping": 0.0, "angularDamping": 0.0, "jointDamping": 0.0}

    def prepare() -> Timed:
        loop = PlanarLoop(work)
        p.resetSimulation()
        p.setTimeStep(period)
        p.setGravity(0.0, 0.0, -9.81)
        robot = p.loadURDF(str(URDF), useFixedBase=True, flags=p.URDF_USE_INERTIA_FROM_FILE)
        joints = list(range(p.getNumJoints(robot)))
        for joint, q in zip(joints, loop.start, strict=True):
            p.resetJointState(robot, joint, q)
            p.changeDynamics(robot, joint, maxJointVelocity=1e3, **free)
        p.setJointMotorControlArray(robot, joints, p.VELOCITY_CONTROL, forces=[0.0] * len(joints))

        def run() -> dict[str, Any]:
            for i in range(loop.samples):
                states = np.array([state[:2] for state in p.getJointStates(robot, joints)])
                force = loop.force(i, states[:, 0], states[:, 1])
                p.setJointMotorControlArray(robot, joints, p.TORQUE_CONTROL, forces=force)
                p.stepSimulation()
            return closed(loop.samples, [state[0] for state in p.getJointStates(robot, joints)])

        return run

    return prepare


def jiminy(work: Work) -> Callable[[], Timed]:
    """Jiminy with a controller in Python, explicit Euler."""
    jiminy: Any = import_module("jiminy_py.core")
    period = float(work["period"])

    def prepare() -> Timed:
        loop, robot, engine = PlanarLoop(work), jiminy.Robot("planar_arm"), jiminy.Engine()
        robot.initialize(str(URDF), has_freeflyer=False)
        for name in robot.pinocchio_model.names[1:]:
            motor = jiminy.SimpleMotor(name)
            robot.attach_motor(motor)
            motor.initialize(name)

        def command(t: float, q: Array, v: Array, sensors: Any, u: Array) -> None:
            u[:] = loop.force(min(round(t / period), loop.samples - 1), q, v)

        robot.controller = jiminy.FunctionalController(command)
        engine.add_robot(robot)
        options = engine.get_options()
        options["stepper"] |= {"odeSolver": "euler_explicit", "dtMax": period, "controllerUpdatePeriod": period}
        engine.set_options(options)
        still = np.zeros(len(loop.start))
        engine.start(loop.start, still)

        def run() -> dict[str, Any]:
            for _ in range(loop.samples):
                engine.step(period)
            final = np.array(engine.robot_states[0].q)
            engine.stop()
            return closed(loop.samples, final)

        return run

    return prepare


SLIP = "exact rolling (lateral slip is damped), Psi"
CORES = os.cpu_count() or 1
PEERS = {
    "mujoco_numpy": Peer("mujoco", mujoco_loop, "mj_step from Python, numpy controller in the loop", SLIP),
    "mujoco_rollout_1": Peer("mujoco", mujoco_rollout(1), "mujoco.rollout, 1 thread", "a controller, rolling, Psi"),
    "mujoco_rollout_all": Peer(
        "mujoco", mujoco_rollout(CORES), f"mujoco.rollout, {CORES} threads", "a controller, rolling, Psi"
    ),
    "drake": Peer("drake", drake, "MultibodyPlant, controller a Python LeafSystem", SLIP + "; torque one sample late"),
    "pybullet": Peer("pybullet", pybullet, "torque control from Python, numpy controller", SLIP),
    "jiminy": Peer("jiminy-py", jiminy, "explicit Euler, numpy controller", SLIP),
}


def prepared(name: str, work: Work) -> tuple[Callable[[], Timed], str]:
    """A peer, built, and its version.

    Raises:
        ImportError: It is not installed.
    """
    peer = PEERS[name]
    built = peer.build(work)
    return built, metadata.version(peer.package)

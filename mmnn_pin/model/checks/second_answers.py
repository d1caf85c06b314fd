"""Second answers to the model: the thesis's world-frame form of the dynamics, and yourdfpy's forward kinematics.

`WorldFrame` is for reading beside the thesis. Coordinates q = [x, y, phi of the root link in the world; every joint],
as in (2.11), so S turns with the robot and its derivative counts:

    qdot = S nu (2.17), (2.18)        Mbar = S' M S        Cbar = S' C S + S' M Sdot        (2.23)

`dynamics` has the planar root in body velocities instead, where S is the constant T and Sdot = 0. Nothing is shared
with it but the URDF, the base found on it and the mass factors put on the robot: here the robot hangs on three joints
of its own (two slides and a turn) and S is written from the geometry of the base. The thesis's S for the pose alone
(2.7) is the upper left block.

`SecondKinematics` shares nothing with Pinocchio but the URDF's text. It never decides whether a file is good: yourdfpy
repairs broken XML in silence.
"""

from __future__ import annotations

import io
from collections.abc import Mapping

import numpy as np
import pinocchio as pin

from ...errors import RobotError
from ...signals import Array
from ..robot import Robot
from ..structure import scale_body


class WorldFrame:
    """World-frame form of one robot on a differential drive.

    Args:
        robot: The robot.

    Attributes:
        model: Pinocchio model of all joints behind the slides `x`, `y` and the turn `phi`.

    Raises:
        RobotError: The base is not a differential drive.
    """

    def __init__(self, robot: Robot) -> None:
        if not robot.base.two_sided:
            raise RobotError(f"the world-frame form is that of a differential drive, not of a base '{robot.base.kind}'")
        self.robot = robot
        self.model = chain_model(robot.urdf)
        for name, factor in robot.masses.items():
            scale_body(self.model, self.model.getJointId("world phi" if name == "root" else name), factor)
        self.data = self.model.createData()
        names = [*self.model.names[1:4], *robot.full_velocity_names[3:]]
        joints = [self.model.joints[self.model.getJointId(name)] for name in names]
        self._place = [(joint.idx_q, joint.nq, joint.idx_v) for joint in joints]

    def coordinates(self, position: Array) -> Array:
        """World coordinates q of a position, which has the control frame's pose instead of the root link's, (nv,)."""
        a, c, psi = self.robot.frame
        q = np.array(position, float)
        q[2] -= psi
        q[:2] -= rotation(q[2]) @ (a, c)
        return q

    def mass_matrix(self, q: Array) -> Array:
        """Mass matrix M of (2.11), (nv, nv)."""
        M = np.triu(pin.crba(self.model, self.data, self._configuration(q)))
        return self._ours(M + np.triu(M, 1).T)

    def coriolis_matrix(self, q: Array, qdot: Array) -> Array:
        """Coriolis matrix C of (2.11), (nv, nv)."""
        v = np.zeros(self.model.nv)
        v[self._order] = qdot
        return self._ours(pin.computeCoriolisMatrix(self.model, self.data, self._configuration(q), v))

    def gravity(self, q: Array) -> Array:
        """Gravity, the part of F in (2.11) that depends on q alone, (nv,)."""
        return pin.computeGeneralizedGravity(self.model, self.data, self._configuration(q))[self._order]

    def null_space(self, phi: float) -> Array:
        """S, (nv, p): all velocities qdot from nu when the root link has heading phi (2.7), (2.17)."""
        S = self._joint_rows()
        a, c, psi = self.robot.frame
        S[:2, 0] = np.cos(phi + psi), np.sin(phi + psi)
        S[:2, 1] = rotation(phi) @ (c, -a)  # the control frame turns on the spot, the root link around it
        S[2, 1] = 1.0
        return S

    def null_space_rate(self, phi: float, phidot: float) -> Array:
        """Sdot, (nv, p), when the heading phi turns with phidot [rad/s]."""
        Sdot = np.zeros(self.robot.T.shape)
        a, c, psi = self.robot.frame
        Sdot[:2, 0] = -np.sin(phi + psi) * phidot, np.cos(phi + psi) * phidot
        Sdot[:2, 1] = rotation(phi) @ (a, c) * phidot
        return Sdot

    def reduced_mass_matrix(self, q: Array) -> Array:
        """Mbar = S' M S (2.23), (p, p)."""
        S = self.null_space(q[2])
        return S.T @ self.mass_matrix(q) @ S

    def reduced_coriolis_matrix(self, q: Array, nu: Array) -> Array:
        """Cbar = S' C S + S' M Sdot (2.23), (p, p)."""
        S = self.null_space(q[2])
        qdot = S @ nu
        Sdot = self.null_space_rate(q[2], qdot[2])
        return S.T @ self.coriolis_matrix(q, qdot) @ S + S.T @ self.mass_matrix(q) @ Sdot

    @property
    def _order(self) -> list[int]:
        return [idx_v for _, _, idx_v in self._place]

    def _ours(self, matrix: Array) -> Array:
        """Rows and columns in the order of q."""
        return matrix[np.ix_(self._order, self._order)]

    def _configuration(self, q: Array) -> Array:
        """Pinocchio's configuration: cosine and sine in place of a continuous joint's angle."""
        out = np.zeros(self.model.nq)
        for value, (at, size, _) in zip(q, self._place, strict=True):
            out[at : at + size] = value if size == 1 else (np.cos(value), np.sin(value))
        return out

    def _joint_rows(self) -> Array:
        """The constant rows of S: wheels that roll without slipping, arm joints, locked joints."""
        robot, names = self.robot, self.robot.full_velocity_names
        S = np.zeros((len(names), robot.dimensions.dof))
        for wheel in robot.base.rolling:
            S[names.index(wheel.joint), :2] = wheel.sign / wheel.radius, -wheel.sign * wheel.y / wheel.radius
        for i, name in enumerate(robot.joint_names, start=robot.dimensions.base):
            S[names.index(name), i] = 1.0
        return S


def chain_model(urdf: str) -> pin.Model:
    """Pinocchio model of a robot behind two slides and a turn.

    Three joints, not one composite: Pinocchio's `computeCoriolisMatrix` (seen in 4.1) is wrong for that.
    """
    chain, parent = pin.Model(), 0
    for name, kind in (("x", pin.JointModelPX()), ("y", pin.JointModelPY()), ("phi", pin.JointModelRZ())):
        parent = chain.addJoint(parent, kind, pin.SE3.Identity(), f"world {name}")
    frame = chain.addFrame(pin.Frame("world root", parent, 0, pin.SE3.Identity(), pin.FrameType.OP_FRAME))
    return pin.appendModel(chain, pin.buildModelFromXML(urdf), frame, pin.SE3.Identity())


def rotation(angle: float) -> Array:
    """Rotation in the plane, (2, 2)."""
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[c, -s], [s, c]])


class SecondKinematics:
    """Placements of the links of one robot, by yourdfpy and by Pinocchio.

    Args:
        robot: The robot.

    Raises:
        RobotError: yourdfpy cannot read its URDF, or a mimic joint follows another one, which yourdfpy does not know.
    """

    def __init__(self, robot: Robot) -> None:
        import yourdfpy  # slow to import

        self.robot, self.data = robot, robot.model.createData()
        try:
            self.urdf = yourdfpy.URDF.load(io.BytesIO(robot.urdf.encode()), load_meshes=False)
        except Exception as error:  # whatever a parser that guesses raises
            raise RobotError("yourdfpy cannot read the URDF", why=str(error), file=robot.path) from None
        mimics = {joint.name: joint.mimic.joint for joint in self.urdf.robot.joints if joint.mimic is not None}
        if chained := sorted(mimics.keys() & mimics.values()):
            raise RobotError(
                f"yourdfpy does not let joints mimic '{chained[0]}', which mimics another", file=robot.path
            )
        for joint in self.urdf.robot.joints:  # URDF counts the direction of an axis alone; yourdfpy slides along all
            if joint.type == "prismatic":
                joint.axis = joint.axis / np.linalg.norm(joint.axis)

    def placements(self, position: Array) -> dict[str, Array]:
        """(4, 4) placement of every link in the root link, by yourdfpy, at a position (nv,)."""
        root = self.robot.dimensions.pose
        self.urdf.update_cfg(dict(zip(self.robot.position_names[root:], position[root:].tolist(), strict=True)))
        return {name: np.asarray(self.urdf.get_transform(name)) for name in self.urdf.link_map}

    def by_pinocchio(self, position: Array) -> dict[str, Array]:
        """(4, 4) placement of every link in the root link, by Pinocchio, at a position (nv,)."""
        model, body = self.robot.model, pin.FrameType.BODY
        pin.framesForwardKinematics(model, self.data, self.robot.configuration(position))
        placed = {name: self.data.oMf[model.getFrameId(name, body)] for name in self.urdf.link_map}
        return {name: (placed[self.urdf.base_link].inverse() * place).homogeneous for name, place in placed.items()}

    def residual(self, position: Array) -> float:
        """Largest difference of the two in an entry of a placement, lengths over the robot's reach, at least 1 m."""
        ours, theirs = self.by_pinocchio(position), self.placements(position)
        return largest_difference(ours, theirs)


def largest_difference(ours: Mapping[str, Array], theirs: Mapping[str, Array]) -> float:
    """Largest difference of placements of the same links, see `SecondKinematics.residual`; nan where there is one."""
    ours_by_link, theirs_by_link = (np.array([placements[name] for name in ours]) for placements in (ours, theirs))
    reach = max(1.0, float(np.linalg.norm(ours_by_link[:, :3, 3], axis=1).max()))
    difference = np.abs(ours_by_link - theirs_by_link)
    difference[:, :3, 3] /= reach
    return float(difference.max())

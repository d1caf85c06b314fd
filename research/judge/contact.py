"""The judge's second plant: MuJoCo's wheels on a floor, its contacts, and its own dry friction.

Rigid bodies, contacts and friction are MuJoCo's (`mmnn_pin.plant.contact` makes its model): wheels may slip every way,
a skid-steer base scrubs, joints have its `frictionloss`, which sticks, and rotors are its `armature`. Gears are rigid.
Delays, lags, limits, encoders and odometry are those of the first plant.
"""

from __future__ import annotations

import math

import numpy as np

from mmnn_pin.loop.before_run import Start
from mmnn_pin.plant.contact.feet import Contact
from mmnn_pin.plant.contact.plant import ContactPlant
from mmnn_pin.signals import Array

from .draws import STEP, Draw, at_rest, sensors_of, world_of
from .plant import AT, ENCODER, begin_reading, parts_of, read, tell

FINE = 2 * STEP  # a step of MuJoCo [s]


class Floor:
    """A draw's robot on MuJoCo's floor; attributes and methods as of `plant.Moved`.

    Args:
        draw: The draw.

    Raises:
        RobotError: A base that MuJoCo's floor cannot carry.
        ConfigError: MuJoCo is not installed.
    """

    def __init__(self, draw: Draw) -> None:
        self.draw, self.world, self.dt = draw, world_of(draw), FINE
        self.drives, arrive = sensors_of(draw)
        self.arrive, d, w = np.append(0, np.ceil(arrive * STEP / FINE)), draw.robot.dimensions, self.world
        position, _ = Start().state(draw.robot, draw.table[0])
        self.plant = ContactPlant(draw.true.without_friction(), FINE, "euler", Contact(draw.said["mu"], step=FINE))
        self.plant.start(position, np.zeros(d.dof))
        self.own()
        self.position, self.commands = self.plant.position, np.zeros((len(draw.table) + 1, d.motors))
        self.torque = at_rest(draw, position)[2]
        self.commands[0], self.step, self.acts = self.torque, 0, 0
        self.state = parts_of(np.zeros(d.full + d.dof + 5 * d.motors), d.full, d.dof, d.motors)
        self.look()
        begin_reading(self.state, self.drives, w.rows)

    def own(self) -> None:
        """Rotors and friction on MuJoCo's model."""
        model, w, plant = self.plant.model, self.world, self.plant
        model.dof_armature[plant.motor_v] = w.rotor
        model.dof_damping[plant.motor_v] = w.friction[:, AT.viscous]
        model.dof_frictionloss[plant.motor_v] = w.friction[:, AT.coulomb]

    def look(self) -> None:
        """The state as the sensors see it: gears are rigid."""
        self.state.position[:] = self.plant.position
        self.state.turned[:] = self.plant.position[self.world.rows]

    def tell(self, seen: Array) -> None:
        """Write what a controller is told."""
        tell(self.drives, self.world.rows, seen)

    def advance(self, until: int) -> None:
        """Step until a number of steps is done."""
        said, w, keep = self.draw.said, self.world, math.exp(-FINE / self.world.lag)
        E = self.plant.robot.E_at(self.plant.position)
        for step in range(self.step, until):
            if said["payload"] and step == round(said["payload_from"] / FINE) and self.draw.loaded is not None:
                self.plant.carry(self.draw.loaded.without_friction())
                self.own()
            while self.acts + 1 < len(self.arrive) and self.arrive[self.acts + 1] <= step:
                self.acts += 1
            asked = np.clip(self.commands[self.acts], -w.limit, w.limit)
            self.torque = keep * self.torque + (1.0 - keep) * asked
            self.plant.step(E @ self.torque)
            if (step + 1) % round(ENCODER / FINE) == 0:
                self.look()
                read((step + 1) // round(ENCODER / FINE), self.state, self.drives, w.rows)
        self.step = until

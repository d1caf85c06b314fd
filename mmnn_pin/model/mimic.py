"""Mimic joints: slaves whose position is `multiplier q + offset` of a master's, so whose rate is `multiplier qdot`.

Pinocchio builds them as joints of their own (its algorithms refuse its mimic joint); here T gives them their
master's row times the multiplier, and the offset enters the position at rest.
"""

from __future__ import annotations

from dataclasses import dataclass

from mmnn_pin.errors import RobotError

from .urdf.parsing import Document, number


@dataclass(frozen=True)
class Slave:
    """A joint that follows another one that does not itself follow.

    Attributes:
        master: The joint that it follows.
        multiplier: Its rate over the master's.
        offset: Its position where the master's is 0 [rad or m].
    """

    master: str
    multiplier: float
    offset: float

    def at(self, position: float) -> float:
        """Its position at a position of the master."""
        return self.multiplier * position + self.offset


def slaves_of(document: Document) -> dict[str, Slave]:
    """All moving joints that follow others, each with the joint at the end of its chain of masters.

    Raises:
        RobotError: A master that does not exist, or a circle.
    """
    direct: dict[str, Slave] = {}
    for element in document.root.iterchildren("joint"):
        mimic = element.find("mimic")
        if mimic is not None and document.joints[element.get("name")].moves:
            gain, offset = number(mimic, "multiplier", 1.0), number(mimic, "offset", 0.0)
            direct[element.get("name")] = Slave(mimic.get("joint", ""), gain, offset)
    return {name: resolved(document, name, direct) for name in direct}


def resolved(document: Document, name: str, direct: dict[str, Slave]) -> Slave:
    """A slave of a slave, as slave of the first master."""
    slave, seen = direct[name], {name}
    while slave.master in direct:
        above = direct[slave.master]
        if slave.master in seen:
            raise broken(document, name, "follows itself in a circle")
        seen.add(slave.master)
        slave = Slave(above.master, slave.multiplier * above.multiplier, slave.at(above.offset))
    if slave.master not in document.joints:
        raise broken(document, name, f"mimics '{slave.master}', which does not exist")
    return slave


def broken(document: Document, name: str, what: str) -> RobotError:
    """The refusal of a mimic joint."""
    fix = "name a joint that moves by itself"
    return RobotError(f"joint '{name}' {what}", fix=fix, file=document.path, line=document.joints[name].line)

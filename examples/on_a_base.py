"""Put an arm on a differential drive: `python examples/on_a_base.py panda panda_on_base.urdf`.

The base is a box of 40 kg with two wheels and two casters that slide; the arm's root link stands on it.
"""

from __future__ import annotations

import sys
from pathlib import Path

from lxml import etree

from mmnn_pin import load

BASE = """
<robot name="base">
  <link name="platform">
    <inertial><origin xyz="0 0 0.18"/><mass value="40"/>
      <inertia ixx="0.9" iyy="1.2" izz="1.6" ixy="0" ixz="0" iyz="0"/></inertial>
    <visual><origin xyz="0 0 0.2"/><geometry><box size="0.6 0.44 0.2"/></geometry></visual>
  </link>
  {wheels}
  {casters}
  <joint name="mount" type="fixed"><parent link="platform"/><child link="{root}"/><origin xyz="0.1 0 0.3"/></joint>
</robot>
"""
WHEEL = """
<x><link name="wheel_{side}">
    <inertial><mass value="1.5"/><inertia ixx="0.005" iyy="0.0075" izz="0.005" ixy="0" ixz="0" iyz="0"/></inertial>
    <visual><origin rpy="1.5708 0 0"/><geometry><cylinder radius="0.1" length="0.05"/></geometry></visual>
    <collision><origin rpy="1.5708 0 0"/><geometry><cylinder radius="0.1" length="0.05"/></geometry></collision>
  </link>
  <joint name="wheel_{side}_joint" type="continuous"><parent link="platform"/><child link="wheel_{side}"/>
    <origin xyz="0 {y} 0.1"/><axis xyz="0 1 0"/><limit effort="40" velocity="20"/></joint></x>
"""
CASTER = """
<x><link name="caster_{end}">
    <inertial><mass value="0.5"/>
    <inertia ixx="0.0005" iyy="0.0005" izz="0.0005" ixy="0" ixz="0" iyz="0"/></inertial>
    <collision><geometry><sphere radius="0.04"/></geometry></collision></link>
  <joint name="caster_{end}_joint" type="fixed"><parent link="platform"/><child link="caster_{end}"/>
    <origin xyz="{x} 0 0.04"/></joint></x>
"""


def on_a_base(arm: str) -> str:
    """The URDF of an arm on the base, by its name or file."""
    robot = etree.fromstring(load(arm).urdf.encode())
    moved = {joint.find("child").get("link") for joint in robot.findall("joint")}
    (root,) = (link.get("name") for link in robot.findall("link") if link.get("name") not in moved)
    inner = [WHEEL.format(side=side, y=y) for side, y in (("left", 0.25), ("right", -0.25))]
    casters = [CASTER.format(end=end, x=x) for end, x in (("front", 0.26), ("rear", -0.26))]
    base = etree.fromstring(BASE.format(wheels="".join(inner), casters="".join(casters), root=root))
    for part in list(base.iter("x")):
        for each in part:
            base.append(each)
        base.remove(part)
    for each in base:
        robot.append(each)
    robot.set("name", f"{robot.get('name')}_on_base")
    return etree.tostring(robot, pretty_print=True).decode()


if __name__ == "__main__":
    Path(sys.argv[2]).write_text(on_a_base(sys.argv[1]))

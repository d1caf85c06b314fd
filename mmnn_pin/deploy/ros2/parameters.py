"""The settings as parameters of a ROS 2 node: declared with descriptions and ranges, and read."""

from __future__ import annotations

from array import array
from collections.abc import Iterator
from typing import Any

import msgspec
from rcl_interfaces.msg import FloatingPointRange, ParameterDescriptor
from rclpy.exceptions import InvalidParameterValueException
from rclpy.node import Node as RosNode
from rclpy.parameter import Parameter

from ...errors import ConfigError
from ...settings.meanings import meanings
from .settings import FREE, LIVE, Node, is_part

OWN = ("use_sim_time", "start_type_description_service", "qos_overrides.")  # of rclpy itself
RANGES = {"rate": (1.0, 2000.0), "latency": (0.0, 10.0), "setpoint_timeout": (0.0, 10.0), "speed_scaling": (0.0, 1.0)}
USUAL = (0.0, 1e6)  # no number of ours is negative


def declare(node: RosNode) -> None:
    """Declare all parameters of a node that declares what it was given by itself.

    Raises:
        ConfigError: A number out of range, with the parameter's name.
    """
    for name, default, kind, meaning in fields(Node):
        floats = kind in (float, float | None)
        least, most = RANGES.get(name, USUAL)
        ranges = [FloatingPointRange(from_value=least, to_value=most)] if floats else []
        live = "; live" if is_live(name) else ""
        told = ParameterDescriptor(
            description=meaning + live, floating_point_range=ranges, dynamic_typing=kind not in (bool, str, float)
        )
        value = plain(default)
        if node.has_parameter(name):  # declared as it was given, without all this
            value = node.get_parameter(name).value
            node.undeclare_parameter(name)
        if floats and isinstance(value, int) and not isinstance(value, bool):
            value = float(value)  # `rate: 200`
        try:
            node.declare_parameter(name, value, told, ignore_override=True)
        except InvalidParameterValueException as error:
            fix = f"give a number from {least:g} to {most:g}"
            raise ConfigError(f"{value} is out of range", fix=fix, key=name) from error


def given(node: RosNode) -> dict[str, Any]:
    """The values of all parameters of a node but rclpy's own."""
    found = node.get_parameters_by_prefix("")
    return {name: value_of(one) for name, one in found.items() if not name.startswith(OWN)}


def value_of(parameter: Parameter) -> Any:
    """A parameter's value; arrays are lists."""
    value = parameter.value
    return list(value) if isinstance(value, array | tuple) else value


def is_live(name: str) -> bool:
    """Whether a parameter may be changed while the node is configured."""
    return name.startswith(LIVE)


def fields(kind: Any, before: str = "") -> Iterator[tuple[str, Any, Any, str]]:
    """Name, default, type and meaning of all values of a kind of settings."""
    told = meanings(kind)
    for field in msgspec.structs.fields(kind):
        name = f"{before}{field.name}"
        if is_part(field.type):
            yield from fields(field.type, f"{name}.")
        elif name not in FREE:
            yield name, field.default, field.type, told.get(field.name, "")


def plain(value: Any) -> Any:
    """A default as a parameter has it."""
    return list(value) if isinstance(value, tuple) else value

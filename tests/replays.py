"""Recordings without a run, for what shows them; a reader of the page that shares nothing with its writer."""

from __future__ import annotations

import base64
import gzip
import json
import re
from collections.abc import Callable
from dataclasses import replace

import numpy as np

from mmnn_pin.model.chain import chain_of, poses, track
from mmnn_pin.model.robot import Robot
from mmnn_pin.recording.recorder import Recorder
from mmnn_pin.recording.recording import Outcome, Recording
from mmnn_pin.signals import HAND, Layout

TYPES = {"f4": "<f4", "u2": "<u2", "u4": "<u4"}


def motion(robot: Robot, time: np.ndarray) -> np.ndarray:
    """Positions (k, nv) on a bent path, every free joint in its limits, mimic joints with their masters."""
    table = np.tile(robot.rest, (len(time), 1))
    lower, upper = np.maximum(robot.lower, -1.0), np.minimum(robot.upper, 1.0)
    for i in robot.arm_index:
        middle, swing = (lower[i] + upper[i]) / 2, (upper[i] - lower[i]) / 2
        table[:, i] = middle + 0.9 * swing * np.sin(1.5 * time + i)
    if robot.dimensions.pose:
        table[:, :3] = np.column_stack((0.6 * time, 0.2 * time**2, np.arctan2(0.4 * time, 0.6)))
        for wheel in robot.base.wheels:
            table[:, robot.position_names.index(wheel.joint)] = 0.6 * time / wheel.radius
        for i, place in enumerate(robot.shape_index):
            table[:, place] = 0.5 * np.sin(2.0 * time + i)
    robot.follow(table.T)
    return table


def recorded(
    robot: Robot,
    controller: str = "two_layer",
    /,
    duration: float = 2.0,
    period: float = 0.002,
    lag: float = 0.1,
    wheels: int = 0,
    hands: tuple[str, ...] = (),
    outcome: Outcome | None = None,
    change: Callable[[np.ndarray, Callable[[str], slice]], None] = lambda table, where: None,
    **meta: object,
) -> Recording:
    """A run in which the robot does what the reference asked `lag` seconds ago; `change` edits the table of rows.

    `wheels` is the number of wheels whose slip is recorded, as on the contact plant; `hands` are frames on a path.
    """
    time = np.arange(round(duration / period)) * period
    layout = replace(Layout.of(robot.dimensions), wheels=wheels, hands=len(hands))
    table, where = np.zeros((len(time), layout.width)), layout.where
    wish, done = motion(robot, time), motion(robot, time - lag)
    table[:, where("time")] = time[:, None]
    table[:, where("position")] = done
    table[:, where("pose")], table[:, where("pose_ref")] = (
        done[:, : robot.dimensions.pose],
        wish[:, : robot.dimensions.pose],
    )
    table[:, where("q")], table[:, where("q_ref")] = done[:, robot.arm_index], wish[:, robot.arm_index]
    for i, frame in enumerate(hands):
        for signal, motion_of in (("hand", done), ("hand_ref", wish)):
            begin = where(signal).start + len(HAND) * i
            table[:, begin : begin + len(HAND)] = poses(track(chain_of(robot, frame), motion_of))
    change(table, where)
    facts = {"controller": controller, "hands": dict.fromkeys(hands, True)}
    recorder = Recorder(layout, robot.facts() | facts | meta)
    recorder.append_block(table)
    return recorder.finish(outcome or Outcome("completed", duration))


def unpacked(html: str, name: str) -> bytes:
    """What is in a compressed element of the page."""
    (text,) = re.findall(rf'<script type="text/plain" id="{name}">([^<]*)</script>', html)
    return gzip.decompress(base64.b64decode(text))


def data_of(html: str) -> dict:
    """The header of a page, with arrays in the place of references to them."""
    data = unpacked(html, "data")
    length = int.from_bytes(data[:4], "little")
    arrays = data[4 + length :]

    def resolve(value: dict) -> object:
        if value.get("type") not in TYPES:
            return value
        return np.frombuffer(arrays, TYPES[value["type"]], value["size"], value["at"])

    return json.loads(data[4 : 4 + length], object_hook=resolve)

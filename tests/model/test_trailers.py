"""A guided trailer: its velocities against the rolling of its wheels, the truck's command by differences of motions."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mmnn_pin.kinematic import body_error
from mmnn_pin.model.base.differential import kanayama
from mmnn_pin.model.base.rolling import AXLE, Pivot, new_maps, roll
from mmnn_pin.model.base.steered import DriveWithTrailer
from mmnn_pin.model.base.trailers import towed, towing, trailer_pose
from mmnn_pin.signals import Array

GAINS = np.array([1.0, 1.5, 2.5])
hitches = st.tuples(st.sampled_from([-0.4, -0.1, 0.1, 0.3]), st.floats(0.3, 1.5)).map(np.array)  # h, L
angles, speeds = st.floats(-1.4, 1.4), st.floats(-1.0, 1.0)


def rolled(hitch: Array, gamma: float, velocity: Array) -> Array:
    """(vx, vy, w) of the trailer's axle by `rolling`: the hitch as a passive pivot, the axle on it."""
    pivot = Pivot("hitch", "passive", -hitch[0], 0.0, wheel=(-hitch[1], 0.0, 0.0))
    base = DriveWithTrailer(pivots=(pivot,))
    assert base.body == AXLE
    maps = new_maps(base.rolling_at({"hitch": 4}), np.zeros((5, 2)))
    roll(base.rolling_at({"hitch": 4}), np.array([0.0, 0.0, 1.0, 0.0, gamma]), velocity, maps)
    vx, vy, w = maps.V[1] @ velocity
    return np.array([vx, vy - hitch[1] * w, w])


@given(hitches, angles, speeds, speeds)
def test_a_trailer_moves_as_its_wheels_roll(hitch: Array, gamma: float, v: float, w: float) -> None:
    velocity, trailer = np.array([v, w]), np.empty(2)
    towed(hitch, gamma, velocity, trailer)
    assert rolled(hitch, gamma, velocity) == pytest.approx([trailer[0], 0.0, trailer[1]], abs=1e-12)
    towing(hitch, gamma, np.zeros(2), trailer, np.zeros(2))
    assert trailer == pytest.approx(velocity, abs=1e-12)


@given(hitches, angles, speeds, speeds, speeds, speeds, st.floats(-0.3, 0.3))
def test_the_trucks_command_has_its_derivative(
    hitch: Array, gamma: float, v: float, w: float, vr: float, wr: float, off: float
) -> None:
    """The derivative against differences along the motion: poses moved in the plane, the reference, too."""
    if abs(vr) < 0.05:
        vr = 0.5  # the law's |vr| has a corner
    a_ref = np.array([0.2, -0.3])
    place = np.empty(3)
    trailer_pose(hitch, gamma, np.array([0.1, -0.2, 0.3]), place)
    towed(hitch, gamma, np.array([v, w]), trailer := np.empty(2))

    def commanded(t: float) -> tuple[Array, Array]:
        """The truck's command at a time, all turning and driving at constant velocities."""
        phi = 0.3 + w * t
        at = np.array([0.1 + v * t * math.cos(0.3), -0.2 + v * t * math.sin(0.3), phi])
        trailer_pose(hitch, gamma + (trailer[1] - w) * t, at, moved := np.empty(3))
        ahead = vr * t * np.array([math.cos(place[2] + off), math.sin(place[2] + off), 0.0])
        body_error(place + np.array([0.1, off, off + wr * t]) + ahead, moved, error := np.empty(3))
        v_ref = np.array([vr, wr]) + a_ref * t
        alpha, alphadot = np.empty(2), np.empty(2)
        kanayama(error, v_ref, a_ref, trailer, GAINS, alpha, alphadot)
        towing(hitch, gamma + (trailer[1] - w) * t, trailer, alpha, alphadot)
        return alpha, alphadot

    h = 1e-5
    slope = (commanded(h)[0] - commanded(-h)[0]) / (2 * h)
    assert commanded(0.0)[1] == pytest.approx(slope, rel=1e-5, abs=1e-5)

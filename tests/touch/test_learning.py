"""Learning while the world pushes back: what contact freezes, and covariances that learners tell."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from learning import made
from numba import config

from mmnn_pin.disturbance import Push
from mmnn_pin.torque.controller import ControllerState
from mmnn_pin.torque.law import doubt
from mmnn_pin.torque.learning_law import LearningLaw
from mmnn_pin.touch import Touch

SLOW = bool(config.DISABLE_JIT)
LEARNERS = ("two_layer", "one_layer", "kalman_regressor", "pid", "extended_state")
LEARNERS = LEARNERS if SLOW else (*LEARNERS, "adaptive", "learned", "concurrent")


FAST = {"pid": ("pid.rate=5",), "extended_state": ("extended_state.bandwidth=5",)}  # what suits this loop is none
STATED = {"bandwidth": 1000.0, "masses": 0.0, "friction": 0.0, "torque": 0.0, "unknown": 1e-3}


class Bias(LearningLaw):
    """A constant per velocity."""

    rate: float = 100.0

    def init(self, context):
        return ControllerState.of(bias=(context.layout.dof,))

    def estimate(self, sample, state):
        return state["bias"]

    def learn(self, sample, state):
        state["bias"] += self.rate * sample.period * sample.s


def pushed(name, mode):
    """A run that is pushed hard from its middle on, with all states that the controller had."""
    duration = 0.06 if SLOW else 0.2
    half = 0.5 * duration
    loop = made(name, "sensor.noise=0", "sensor.velocity_noise=0", *FAST.get(name, ()), duration=duration)
    touch = Touch(**{**STATED, "learning": mode})
    push = Push(on="arm_1_joint", force=5.0, start=half)
    loop = replace(loop, nominal=loop.robot, touch=touch, disturbances=(push,), check_gains=False, engine="ordinary")
    engine = loop.engine_at()
    states, felt = [], []
    contact = loop.layout.where("contact")
    for k in range(loop.timing.samples):
        if engine.advance(k, k + 1) != -1:
            break
        states.append(engine.state.values.copy())
        felt.append(engine.row[contact][0])
    return np.array(states), np.array(felt)


def places_of(name):
    """Which numbers of a controller's state belong to its weights."""
    loop = made(name)
    state = loop.state_from()
    names = [part for part in loop.controller.weights(state) if part in state.shapes]
    state.values[:] = 0.0
    for part in names or state.shapes:
        state[part] = 1.0
    return state.values > 0.0


@pytest.mark.parametrize("name", LEARNERS)
def test_contact_freezes_every_learner(name):
    """From the sample after that which feels it on the weights stand still; where learning goes on they move."""
    states, felt = pushed(name, "frozen")
    inside, places = np.flatnonzero(felt), places_of(name)
    assert inside.size and np.array_equal(inside, np.arange(inside[0], len(felt)))
    assert places.any() and not np.ptp(states[inside][:, places], axis=0).any()
    going_on, felt = pushed(name, "on")
    assert np.ptp(going_on[np.flatnonzero(felt)][:, places], axis=0).any()


def test_a_dead_zone_learns_as_soon_as_nothing_is_felt():
    states, felt = pushed("pid", "deadzone")
    assert felt.any() and not np.ptp(states[np.flatnonzero(felt)], axis=0).any()


def test_a_law_in_python_is_frozen_too():
    loop = made("pd")
    law = Bias(feedback=loop.controller.feedback)
    push = Push(on="arm_1_joint", force=5.0, start=0.01)
    run = replace(loop, controller=law, nominal=loop.robot, disturbances=(push,), check_gains=False)
    frozen, going_on = (replace(run, touch=Touch(**{**STATED, "learning": mode})).run() for mode in ("frozen", "on"))
    felt = np.flatnonzero(frozen["contact"])
    assert felt.size and not np.ptp(frozen["psi_hat"][felt], axis=0).any()
    assert np.ptp(going_on["psi_hat"][felt], axis=0).any()


@pytest.mark.parametrize("name", ["kalman_regressor", "kalman_features", "learned"])
def test_a_learner_tells_the_covariance_of_psi_hat(name):
    """`Phi P Phi'` by numpy's matrices from the factors; random features have one for all velocities, over K."""
    loop = made(name)
    state, rng = loop.state_from(), np.random.default_rng(0)
    state["U"], state["D"] = rng.normal(size=state["U"].shape), rng.uniform(0.0, 1.0, state["D"].shape)
    law = loop.controller.law(loop.context())
    learner, p = law.learner, loop.layout.dof
    learner.Phi[:] = rng.normal(size=learner.Phi.shape)
    U = np.triu(state["U"].T, 1) + np.eye(state["D"].size)
    P, found = (U * state["D"]) @ U.T, np.zeros((p, p))
    doubt(learner, state.values, found)
    wanted = learner.Phi @ P @ learner.Phi.T
    if len(wanted) < p:
        wanted = np.diag(learner.gain**2 * wanted[0, 0])
    np.testing.assert_allclose(found, wanted, rtol=1e-9, atol=1e-12 * np.abs(wanted).max())


def test_a_learner_without_a_covariance_says_so():
    loop, found = made("adaptive"), np.zeros((4, 4))
    doubt(loop.controller.law(loop.context()).learner, loop.state_from().values, found)
    assert found[0, 0] < 0.0

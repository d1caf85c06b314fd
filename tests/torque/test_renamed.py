"""Keys and values of experiments that have another name now: a clear error, and recordings made before are read."""

from __future__ import annotations

import pytest

from mmnn_pin import load_experiment
from mmnn_pin.errors import ConfigError
from mmnn_pin.lab.experiments.controllers import renamed
from mmnn_pin.torque.adaptive import AdaptiveSettings


@pytest.mark.parametrize(
    ("said", "new"),
    [
        ("prediction.weight=1.0", "adaptive_composite"),
        ("adaptive_composite.memory=1.0", "forgetting_time"),
        ("disturbance_observer.gamma=1.0", "extended_state"),
        ("adaptive.initial=guess", "prior"),
        ("concurrent.initial=guess", "prior"),
    ],
)
def test_an_old_name_is_refused_with_the_new_one(said, new):
    with pytest.raises(ConfigError) as error:
        load_experiment("track", [said])
    assert f"is now called '{new}'" in str(error.value) and "\n" not in str(error.value)


def test_in_python_too():
    from mmnn_pin import load
    from mmnn_pin.model.regressor import Regressor
    from mmnn_pin.torque.adaptive import Adaptive

    with pytest.raises(ConfigError, match="'guess' is now called 'prior'"):
        Adaptive(Regressor.of(load("platform_arm")), settings=AdaptiveSettings(initial="guess"))


def test_the_config_of_an_older_recording_is_read():
    old = {"prediction": {"memory": 3.0, "weight": 2.0}, "replay": {"rate": 1.0}, "adaptive": {"initial": "guess"}}
    old |= {
        "disturbance_observer": {"gamma": 1.0},
        "controllers": ["pd", "two_layer_composite", "disturbance_observer"],
    }
    new = renamed(old | {"robot": "differential"})
    assert new == {
        "adaptive_composite": {"forgetting_time": 3.0, "weight": 2.0},
        "adaptive": {"initial": "prior"},
        "controllers": ["pd", "extended_state"],
        "robot": "differential",
    }

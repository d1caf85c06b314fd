"""One run of the judge: a controller as shipped through `Stepper`, fed with what the plant's sensors tell."""

from __future__ import annotations

import math
from operator import attrgetter
from typing import Any

import numpy as np

from mmnn_pin import Measurement, Stepper, load_experiment
from mmnn_pin.errors import InputError
from mmnn_pin.lab.experiments.controllers import Granted
from mmnn_pin.loop.stepper import StepperSettings
from mmnn_pin.loop.suited import SCALED
from mmnn_pin.model.robot import Robot, revolute
from mmnn_pin.reference.limits import Limits
from mmnn_pin.signals import Array
from mmnn_pin.torque.controller import CompiledController, ControllerSettings, Feedback
from mmnn_pin.torque.entries import CONTROLLERS
from mmnn_pin.torque.neural import Robust

from .contact import Floor
from .draws import TENTH, Draw, plant_of, preregistered, setpoints
from .plant import Moved


def settings_of(name: str) -> dict[str, Any]:
    """The settings that `track` has for a controller: its tables, those of networks, the nominal robot.

    Raises:
        KeyError: There is none of that name.
    """
    experiment, entry = load_experiment("track"), CONTROLLERS[name]
    beside = [attrgetter(CONTROLLERS[other].key)(experiment) for other in entry.beside]
    own, switches = attrgetter(entry.key)(experiment) if entry.settings else None, experiment.learning
    robust = experiment.robust_term(name)
    networks = {
        "robust": Robust() if robust == SCALED else robust,  # one that a stepper scales, as `track` does
        "inputs": experiment.inputs,
        "rates": switches.rates,
        "leakage": switches.leakage,
        "update": switches.update,
        "projection": switches.projection,
    }
    return {"tables": (*beside, own) if beside else own, "networks": networks, "nominal": experiment.nominal}


def shipped(name: str, robot: Robot) -> CompiledController:
    """A controller with the settings of `track`, its gains left to the stepper.

    Raises:
        KeyError: There is none of that name.
    """
    experiment, entry, settings = load_experiment("track"), CONTROLLERS[name], settings_of(name)
    made: CompiledController = entry.load().build(
        ControllerSettings(
            name=name,
            settings=settings["tables"],
            feedback=Feedback(),
            learning=True,
            told=Granted(entry, robot, experiment.nominal, experiment.overrides),
            networks=settings["networks"],
        )
    )
    return made


def moved(draw: Draw, plant: str) -> Moved | Floor:
    """The plant of a draw, "judge" or "contact"."""
    return Moved(plant_of(draw)) if plant == "judge" else Floor(draw)


def errors_of(draw: Draw, controller: Any, plant: str = "judge") -> dict[str, Any]:
    """What a run of a draw comes to.

    Args:
        draw: The draw.
        controller: A controller's name, or one of one's own.
        plant: "judge", or "contact" for MuJoCo.

    Returns:
        `arm` and `base`, the errors of the file's scoring [rad, m], None where lost or where there is none, and
        `lost`, why and when it was lost, empty where it was not.
    """
    try:
        made = shipped(controller, draw.robot) if isinstance(controller, str) else controller
        within = load_experiment("track").learning.within_limits
        settings = StepperSettings(period=draw.period, limits=Limits(samples="exact"), within_limits=within)
        stepper = Stepper(draw.robot, made, settings)
        found, lost = follow(draw, stepper, moved(draw, plant))
    except KeyError as error:
        return {"arm": None, "base": None, "lost": f"there is no controller {error}"}
    except InputError as error:
        return {"arm": None, "base": None, "lost": f"refused: {error}"}
    except Exception as error:  # a learner that raises has lost
        return {"arm": None, "base": None, "lost": f"{type(error).__name__}: {error}"}
    if lost:
        return {"arm": None, "base": None, "lost": lost}
    late = found[round(preregistered()["settle"] / draw.period) :]
    arm, base = np.sqrt(np.mean(late**2, axis=0))
    sizes = draw.robot.dimensions
    return {"arm": float(arm) if sizes.arm else None, "base": float(base) if sizes.base else None, "lost": ""}


def follow(draw: Draw, stepper: Stepper, plant: Moved | Floor) -> tuple[Array, str]:
    """Drive a plant along a draw's reference.

    Returns:
        (samples, 2) errors of arm and base at every control sample [rad, m], and why it was lost, if it was.
    """
    d, h, found = draw.robot.dimensions, draw.period, np.zeros((len(draw.table), 2))
    seen = np.zeros(d.pose + d.base + 2 * d.arm + len(draw.robot.shape_index))
    measurement = Measurement(*np.split(seen, np.cumsum([d.pose, d.base, d.arm, d.arm])))
    unit = np.where(revolute(draw.robot)[draw.robot.arm_index], 1.0, TENTH)
    steps = round(h / plant.dt)
    for k, setpoint in enumerate(setpoints(draw)):
        plant.tell(seen)
        e = (setpoint.q - plant.position[draw.robot.arm_index]) / unit
        found[k] = math.sqrt(float(e @ e) / max(d.arm, 1)), base_error(setpoint.pose, plant.position)
        if why := loss(e, setpoint.pose, plant.position, seen):
            return found, f"{why} at {k * h:.2f} s"
        command = stepper.step(k * h, measurement, setpoint)
        if stepper.tripped:
            return found, stepper.finish().outcome.message
        plant.commands[k + 1] = command.motor_effort
        plant.advance((k + 1) * steps)
    return found, ""


def base_error(pose: Array, position: Array) -> float:
    """Distance from a pose, the heading's error as `lever` times itself [m]; 0 without a base."""
    if not pose.size:
        return 0.0
    turn = math.remainder(float(pose[2] - position[2]), 2.0 * math.pi)
    return math.hypot(*(pose[:2] - position[:2]), preregistered()["scoring"]["lever"] * turn)


def loss(e: Array, pose: Array, position: Array, seen: Array) -> str:
    """Why a robot is lost; empty where it is not."""
    scoring = preregistered()["scoring"]
    if not np.isfinite(seen).all() or not np.isfinite(position).all():
        return "not finite"
    if np.abs(e).max(initial=0.0) > scoring["lost_arm"]:
        return f"a joint {np.abs(e).max():.1f} rad off"
    if pose.size and math.hypot(*(pose[:2] - position[:2])) > scoring["lost_base"]:
        return "the base is off its path"
    return ""

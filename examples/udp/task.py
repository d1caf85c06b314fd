"""What both processes must agree on, and how they end."""

import argparse
import math
import sys
from pathlib import Path

from mmnn_pin import InputError, load_experiment
from mmnn_pin.errors import ConfigError, UnknownName
from mmnn_pin.lab.experiments.controllers import CONTROLLERS, EFFECTIVE

PORT = 47800
TASK = Path(__file__).with_name("task.toml")
OFFERED = [name for name in CONTROLLERS if name not in EFFECTIVE]  # those need the gains of another run
COARSEST = 0.001  # step of the plant [s]


def parser(description):
    """Parser with the options that both processes have."""
    options = argparse.ArgumentParser(description=description)
    options.add_argument("--rate", type=float, default=200.0, help="control samples per second (200)")
    options.add_argument("--seconds", type=float, default=10.0, help="length of the run (10)")
    options.add_argument("--experiment", default=TASK, help="robot, reference, gains and limits (task.toml)")
    options.add_argument("--controller", default="two_layer", help="which of its controllers (two_layer)")
    options.add_argument("--set", action="append", default=[], metavar="KEY=VALUE", help="changes the experiment")
    options.add_argument("--port", type=int, default=PORT, help=f"UDP port of the plant ({PORT})")
    options.add_argument("--out", default="runs/realtime", help="folder for the recordings (runs/realtime)")
    options.add_argument("--force", action="store_true", help="replace recordings that exist")
    return options


def task(options):
    """Experiment and its robot."""
    for name, value, most in (("rate", options.rate, 1e4), ("seconds", options.seconds, 1e5)):
        if not 0 < value <= most:
            raise ConfigError(f"{value:g}", fix=f"use a number > 0, at most {most:g}", key=f"--{name}")
    if options.controller not in OFFERED:
        raise UnknownName("controller", options.controller, OFFERED, key="--controller")
    period = 1 / options.rate
    samples = max(1, round(options.seconds * options.rate))
    times = f"time.control_period={period!r}", f"time.duration={samples * period!r}"
    step = f"time.plant_step={period / math.ceil(period / COARSEST - 1e-9)!r}"
    experiment = load_experiment(options.experiment, [*times, step, *options.set])
    return experiment, experiment.load_robot()


def call(main):
    """Run a script's main: bad input is one line and exit code 2."""
    try:
        sys.exit(main())
    except InputError as error:
        print(" ".join(str(error).split()), file=sys.stderr)
        sys.exit(2)
    except KeyboardInterrupt:
        print("stopped by Ctrl-C", file=sys.stderr)
        sys.exit(130)

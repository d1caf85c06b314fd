"""Starts both processes.

python examples/udp/run.py [--rate 200] [--seconds 10] [--fault kill|late|nan|shuffle|short ...]
"""

import json
import subprocess
import sys
from pathlib import Path

import task
from control import control
from faults import FAULTS

from mmnn_pin.lab.experiments.runner import require_free

HERE = Path(__file__).parent


def main():
    """Start the plant, control it, and see that it ends."""
    options = task.parser(__doc__.splitlines()[0])
    options.add_argument("--fault", nargs="+", default=(), choices=FAULTS, help="of the sensor, from the middle on")
    options.set_defaults(port=0)
    options = options.parse_args()
    found = task.task(options)
    require_free([Path(options.out) / name for name in ("controller.h5", "plant.h5")], options.force)
    command = [sys.executable, HERE / "plant.py", "--port", "0", *sys.argv[1:]]  # the last --port counts
    plant = subprocess.Popen(command, stdout=subprocess.PIPE, text=True, start_new_session=True)  # Ctrl-C is ours
    try:
        word, _, port = plant.stdout.readline().partition(" ")
        if word != "port":
            return plant.wait() or 1  # it has said why
        code = control(options, *found, int(port), patience=60.0)
        try:
            told = plant.communicate(timeout=30)[0]
            print(f"  plant      {story(json.loads(told)) if told else 'was killed'}")
        except subprocess.TimeoutExpired:
            print("  plant      did not end, killed")
        return code
    finally:
        plant.kill()
        plant.wait()


def story(told):
    """What the plant tells of itself."""
    counts = f"{told['out_of_order']:,} out of order, {told['malformed']:,} malformed"
    end = told["outcome"] if told["ramped"] is None else f"no more torque from t = {told['ramped']:.3g} s on"
    return f"{told['received']:,} packets received, {counts}; {end}; recorded in {told['recording']}"


if __name__ == "__main__":
    task.call(main)

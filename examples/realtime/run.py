"""Both processes: `python examples/realtime/run.py [--rate 200] [--seconds 10] [--fault kill|late|nan|shuffle|short]`."""

import subprocess
import sys
from pathlib import Path

import task
from control import control
from faults import FAULTS

from mmnn_pin.errors import InputError

HERE = Path(__file__).parent


def main():
    """Start the plant, control it, and see that it ends."""
    options = task.parser(__doc__)
    options.add_argument("--fault", choices=FAULTS, help="what happens to the sensor in the middle of the run")
    options.set_defaults(port=0)
    options = options.parse_args()
    found = task.task(options)
    given = [argument for argument in sys.argv[1:]]
    command = [sys.executable, HERE / "plant.py", *given, *([] if "--port" in given else ["--port", "0"])]
    plant = subprocess.Popen(command, stdout=subprocess.PIPE, text=True, start_new_session=True)  # Ctrl-C is ours
    try:
        word, _, port = plant.stdout.readline().partition(" ")
        if word != "port":
            raise InputError("the plant did not start", why=f"it ended with exit code {plant.wait()}")
        code = control(options, *found, int(port), patience=60.0)
        try:
            print(f"  plant      {plant.communicate(timeout=30)[0].strip() or 'was killed'}")
        except subprocess.TimeoutExpired:
            print("  plant      did not end, killed")
        return code
    finally:
        plant.kill()
        plant.wait()


if __name__ == "__main__":
    task.call(main)

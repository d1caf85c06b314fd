"""A report from scratch: the thesis's chapter 4 with four controllers, in one HTML page that opens anywhere."""

from pathlib import Path

from mmnn_pin import load_experiment
from mmnn_pin.lab.experiments.runner import run_experiment
from mmnn_pin.lab.show.report import report

if __name__ == "__main__":
    controllers = "controllers=['two_layer', 'pd', 'pd_effective', 'computed_torque']"
    runs = run_experiment(load_experiment("chapter4", [controllers]), "chapter4").recordings
    page = report(runs, command="python examples/report.py").save(Path("report.html"))
    print(f"{page} is ready: open it in a browser")

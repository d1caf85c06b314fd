"""FIGAROH's fits of equations in a file: `PYTHON benchmarks/by_figaroh.py EQUATIONS.npz`, by a Python that has figaroh.

`benchmarks/identification.py --figaroh PYTHON` calls it. The steps are those of figaroh 1.0.2's `BaseIdentification`:
columns below its tolerance are dropped, `QRDecomposer.double_decomposition` chooses base parameters and solves them
(`ols`), `_calculate_joint_variances` and `_solve_weighted_least_squares` weigh joints by their residuals (`wls`), and
`solve_direct_effort_fit` fits bodies that are possible (`physical`). Printed as JSON are predicted efforts of the
motion held out.
"""

from __future__ import annotations

import json
import sys

import numpy as np
from figaroh.identification.base_identification import BaseIdentification
from figaroh.identification.physical_fit import build_problem, solve_direct_effort_fit
from figaroh.tools.qrdecomposition import QRDecomposer
from figaroh.tools.regressor import get_index_eliminate

SMALLEST = 0.001  # `zero_tolerance` of BaseIdentification.solve


class Given(BaseIdentification):  # type: ignore[misc]  # no types where figaroh is not installed
    """Its methods, for equations that are there."""

    def load_trajectory_data(self, data_source: str | None = None) -> None:
        """There is nothing to load."""


def main(path: str) -> None:
    """Fit and predict."""
    given = np.load(path)
    W, tau, joint, test, names = (given[name] for name in ("W", "tau", "joint", "test", "names"))
    names = [str(name) for name in names]
    gone, left = get_index_eliminate(W, dict.fromkeys(names, 0.0), SMALLEST)
    kept = np.setdiff1d(np.arange(len(names)), gone)
    found = QRDecomposer(tolerance=1e-6)
    base, _, _, ols = found.double_decomposition(tau, W[:, kept], left)
    columns = kept[found.get_base_indices()]
    left_over = tau - base @ ols
    variance = np.array([np.mean(left_over[joint == i] ** 2) for i in range(joint.max() + 1)])[joint]
    wls, _ = object.__new__(Given)._solve_weighted_least_squares(base, tau, variance)
    prior, joints = given["prior"], [str(name) for name in given["joints"]]
    record = solve_direct_effort_fit(
        build_problem(W, tau, names, joints, prior=prior, row_weight=1 / np.sqrt(variance + 1e-12))
    )
    answer = {"ols": test[:, columns] @ ols, "wls": test[:, columns] @ wls}
    answer |= {} if record.theta is None else {"physical": test @ np.asarray(record.theta)}
    print(json.dumps({name: np.asarray(one).tolist() for name, one in answer.items()} | {"parameters": len(columns)}))


if __name__ == "__main__":
    main(sys.argv[1])

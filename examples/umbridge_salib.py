"""Compute Sobol indices of the critical angle with SALib, using the service as an UM-Bridge model.

Install both packages (`pip install umbridge SALib`), start the service with `make serve`, then run
`.venv/bin/python examples/umbridge_salib.py [ADDRESS]`.
"""

import sys
from typing import Any

import numpy as np
import umbridge
from SALib.analyze import sobol as indices
from SALib.sample import sobol as points

ADDRESS = "http://127.0.0.1:8000"
BASE_SAMPLES = 64  # SALib needs a power of two.
PROBLEM: dict[str, Any] = {
    "num_vars": 2,
    "names": ["velocity", "compressive strength"],
    "dists": ["norm", "norm"],
    "bounds": [[238.0, 2.4], [39.0, 4.7]],  # Mean and standard deviation in m/s and MPa.
}


def main() -> None:
    """Sample the inputs, evaluate the model and print the indices."""
    address = sys.argv[1] if len(sys.argv) > 1 else ADDRESS
    model = umbridge.HTTPModel(f"{address}/umbridge", "cra")
    inputs = points.sample(PROBLEM, BASE_SAMPLES, calc_second_order=False, seed=7)
    outputs = np.array([model([point])[0] for point in inputs.tolist()])
    angles, statuses = outputs.T
    if statuses.any():
        sys.exit(f"{np.count_nonzero(statuses)} of {len(outputs)} strikes have no critical angle")
    found = indices.analyze(PROBLEM, angles, calc_second_order=False, seed=7)
    print(f"critical angle {angles.mean():.2f}° ± {angles.std():.2f}° from {angles.size} searches")
    for row, name in enumerate(PROBLEM["names"]):
        first, total = (f"{found[index][row]:.2f} ± {found[f'{index}_conf'][row]:.2f}" for index in ("S1", "ST"))
        print(f"{name:22} first order {first}, total {total}")


if __name__ == "__main__":
    main()

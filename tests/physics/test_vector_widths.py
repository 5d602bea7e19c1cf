"""Loads on a body in a wall do not depend on the width of the processor's vector instructions."""

import json
import os
import subprocess
import sys

import numpy as np
import pytest

from solver import Impact, Numerics, Profile, Projectile, Resistance, Target
from solver.arrays import FloatArray
from solver.motion import sample_loads
from solver.prepared import prepare


def loads_on_many_cones() -> FloatArray:
    """Return the loads on a nose of 89 cones in random states; its rings need several vectors."""
    axial = np.linspace(0.0, 0.12, 90)
    nose = Profile(points=tuple(zip(axial.tolist(), (0.04 * np.sqrt(axial / 0.12)).tolist(), strict=True)))
    prepared = prepare(
        projectile=Projectile(nose=nose, diameter=0.08, length=0.53, mass=13.0),
        target=Target(compressive_strength=39e6, density=2250.0, thickness=0.2),
        resistance=Resistance(),
        numerics=Numerics(stations=7).resolved(termination_time=0.02),
    )
    model = prepared.model._replace(law=prepared.law_at(Impact(velocity=238.0, oblique_angle=0.5)))
    random = np.random.default_rng(1)
    lower, upper = np.array([(-0.1, 0.3), (-0.1, 0.1), (-0.6, 0.6), (50.0, 200.0), (0.0, 150.0), (-5.0, 5.0)]).T
    return sample_loads(random.uniform(lower, upper, size=(10, 6)), model)


@pytest.mark.parametrize("processor", ["haswell", "znver4"], ids=["4 numbers", "8 numbers"])
def test_loads_of_interpreted_and_compiled_code_agree(processor: str) -> None:
    """Interpreted Python stands in for code compiled for other processors, which this one might not be able to run."""
    environment = os.environ | {"NUMBA_DISABLE_JIT": "1", "NUMBA_CPU_NAME": processor}
    script = f"import json, {__name__} as module; print(json.dumps(module.loads_on_many_cones().tolist()))"
    done = subprocess.run(
        [sys.executable, "-W", "ignore", "-c", script], env=environment, capture_output=True, text=True, check=True
    )
    np.testing.assert_allclose(json.loads(done.stdout), loads_on_many_cones(), rtol=1e-9)

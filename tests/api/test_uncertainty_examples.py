"""The example scripts that use other tools for uncertainty quantification run without an error."""

import os
import re
import subprocess
import sys
from pathlib import Path

import httpx
import pytest

from service.schemas.strike import PAPER

EXAMPLES = Path(__file__).parents[2] / "examples"


def run(name: str, *arguments: str) -> str:
    command = [sys.executable, str(EXAMPLES / name), *arguments]
    environment = os.environ | {"NO_PROXY": "*"}
    done = subprocess.run(command, env=environment, capture_output=True, text=True, timeout=240, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


def test_emcee_calibrates_the_strength_factor_with_its_interval() -> None:
    pytest.importorskip("emcee", reason="emcee is not installed")
    printed = run("calibrate_emcee.py")
    [row] = re.findall(r"^S +([\d.]+) \(95 %: ([\d.]+) to ([\d.]+)\)", printed, re.MULTILINE)
    median, low, high = map(float, row)
    assert median == pytest.approx(8.4, abs=0.5)  # Least squares give 8.38, with an interval from 7.1 to 9.6.
    assert 6.0 < low < 7.9
    assert 8.9 < high < 12.0


def test_client_of_umbridge_evaluates_300_points(live_url: str, client: httpx.Client) -> None:
    umbridge = pytest.importorskip("umbridge", reason="umbridge is not installed")
    address = f"{live_url}/umbridge"
    assert umbridge.supported_models(address) == ["cra", "trajectory"]
    model = umbridge.HTTPModel(address, "cra")
    assert (model.get_input_sizes(), model.get_output_sizes()) == ([2], [2])
    assert model.supports_evaluate()
    assert not model.supports_gradient()
    points = [[238.0 + 0.05 * number, 39.0 + 0.01 * number] for number in range(300)]
    outputs = [model([point])[0] for point in points]
    assert all(len(output) == 2 and output[1] == 0.0 for output in outputs)
    for (speed, strength), (angle, _) in zip(points[::100], outputs[::100], strict=True):
        target = PAPER["target"] | {"compressive_strength_pa": strength * 1e6}
        alone = client.post("/cra", json=PAPER | {"impact": {"velocity_m_s": speed}, "target": target})
        assert angle == alone.json()["critical_angle_deg"]


def test_salib_finds_the_indices_of_the_critical_angle(live_url: str) -> None:
    pytest.importorskip("umbridge", reason="umbridge is not installed")
    pytest.importorskip("SALib", reason="SALib is not installed")
    printed = run("umbridge_salib.py", live_url)
    assert "from 256 searches" in printed
    totals = [float(total) for total in re.findall(r"total (-?[\d.]+)", printed)]
    speed, strength = totals
    assert 0.0 <= speed < 0.3
    assert strength == pytest.approx(1.0, abs=0.3)  # Strength scatters by 12 %, speed by 1 % only.

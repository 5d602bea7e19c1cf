"""Python code in the documentation passes `mypy --strict`."""

import subprocess
import sys
from pathlib import Path

import pytest

from .blocks import PAGES, ROOT, blocks, name_of

pytestmark = [pytest.mark.system, pytest.mark.timeout(600)]  # mypy has no cache here for the types of numpy and xarray.
OPTIONAL = """
import matplotlib.axes
import matplotlib.figure
import xarray
from solver import Impact, Ogive, Projectile, Target, critical_angle, critical_angle_sweep, simulate

projectile = Projectile(nose=Ogive(caliber_radius_head=3.0), diameter=0.08, length=0.53, mass=13.0)
target = Target(compressive_strength=39e6, density=2250.0)
strike = simulate(projectile=projectile, target=target, impact=Impact(velocity=238.0, oblique_angle=0.5))
velocities = xarray.DataArray([200.0, 250.0], dims="velocity")
sweep: xarray.Dataset = critical_angle_sweep(projectile=projectile, target=target, axes={"velocity": velocities})
figure: matplotlib.figure.Figure = strike.plot()
axes: matplotlib.axes.Axes = figure.subplots()
critical_angle(projectile=projectile, target=target, velocity=238.0).plot(ax=axes)
reveal_type(strike.plot())
reveal_type(sweep)
"""


def test_python_in_the_pages_passes_strict_type_checks(tmp_path: Path) -> None:
    pages = 0
    for page in PAGES:
        python = [block.text for block in blocks(page) if block.language == "python" and block.runs]
        (tmp_path / f"{name_of(page).replace('/', '_').replace('-', '_')}.py").write_text("\n".join(python))
        pages += bool(python)
    assert pages >= 6
    (tmp_path / "optional.py").write_text(OPTIONAL)
    command = [sys.executable, "-m", "mypy", "--strict", "--config-file=", "--cache-dir", str(tmp_path / "cache")]
    files = sorted(map(str, tmp_path.glob("*.py")))
    done = subprocess.run([*command, *files], cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    assert 'Revealed type is "matplotlib.figure.Figure"' in done.stdout
    assert 'Revealed type is "xarray.core.dataset.Dataset"' in done.stdout

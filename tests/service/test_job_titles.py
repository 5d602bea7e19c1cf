"""Titles of sweeps."""

import pytest

from service.jobs.models import StoredSweep, title_of
from service.schemas.strike import PAPER


@pytest.mark.parametrize(
    ("fields", "title"),
    [
        (("impact.velocity_m_s", "target.compressive_strength_pa"), "speed × strength, 80 mm, 13 kg"),
        (("projectile.mass_kg",), "mass, 80 mm"),
        (("projectile.diameter_m", "projectile.nose.caliber_radius_head"), "diameter × caliber radius head ψ, 13 kg"),
    ],
)
def test_title_names_the_axes_and_the_fixed_projectile(fields: tuple[str, ...], title: str) -> None:
    sweep = StoredSweep({"base": PAPER, "axes": []}, fields, ((1.0,),) * len(fields))
    assert title_of(sweep) == title

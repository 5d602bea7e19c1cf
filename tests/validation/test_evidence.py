"""The table of evidence, and the errors of the decay laws for metal plates and for motions by finite elements."""

import pytest

from validation.evidence import evidence, evidence_section, motion_misfits, plate_misses


def test_every_row_of_evidence_has_number_source_exclusions_and_a_short_verdict() -> None:
    rows = evidence()
    assert [row.number for row in rows] == [251, 64, 3, 2, 4, 1, 11]
    for row in rows:
        assert row.source
        assert row.left_out
        assert row.result
        assert row.verdict.endswith(".")
        assert len(row.verdict) < 160


@pytest.mark.parametrize(
    ("law", "expected"),
    [
        ("elastic_plastic", (-0.011, -0.023, -0.013)),
        ("mohr_coulomb", (-0.017, -0.057, -0.016)),
        ("none", (-0.012, -0.030, -0.050)),
        ("sec θ", (-0.005, -0.006, 0.005)),
    ],
)
def test_oblique_limits_of_metal_plates_follow_from_the_limit_in_normal_impact(
    law: str, expected: tuple[float, ...]
) -> None:
    assert plate_misses()[law] == pytest.approx(expected, abs=0.003)


def test_mohr_coulomb_fits_motions_best_and_no_decay_worst() -> None:
    found = motion_misfits()
    for mesh in ("coarse", "fine"):
        assert found[mesh, "mohr_coulomb"] < found[mesh, "elastic_plastic"] < found[mesh, "none"]


def test_page_begins_with_the_reason_for_the_default() -> None:
    section = evidence_section()
    text = " ".join(section.text)
    assert "Why elastic-plastic decay is the default" in text
    assert "{" not in text
    (table,) = section.tables
    assert all(len(row) == len(table.columns) for row in table.rows)

"""The report of `ricochet reproduce`: the paper, figure by figure, beside its own numbers."""

from collections.abc import Callable, Iterator
from typing import Final

from service.reports import finite_elements
from service.reports.contents import Section, Tell, paragraphs
from service.reports.paper import cost, depth, motion, obliquity, open_points, searches, sensitivity, turning
from solver import ENGINE_VERSION

TITLE = "The paper, reproduced"
INTRODUCTION = paragraphs(
    f"""
    “Efficient Method to Evaluate Critical Ricochet Angle of Projectile Penetrating into a Concrete Target”
    (published 21 October 2018) finds the smallest oblique angle at which a rigid projectile is turned away by
    concrete. This page repeats it with ricochet: every table and figure of results, and every number of ours beside
    the one printed.

    The strike is the paper's: a projectile of 80 × 530 mm and 13 kg with an ogive of calibre-radius-head 3, at 238
    m/s on concrete of 39 MPa and 2250 kg/m³. Angles are **from the inward normal** of the face: 0° is a head-on
    strike. Depth is positive inside the concrete. A difference is ours minus the reference.

    The paper's numbers are those in its text and tables. Its figures were not digitised, and its finite element
    runs are not published: in their place stand runs made for this project with another code. Where something is
    compared with them, it says so.

    Each figure lies in the folder `figures` beside this page as PNG, SVG and CSV, each table in `tables`, all
    comparisons in `comparisons.csv`. Solver engine {ENGINE_VERSION}.
    """
)

SECTIONS: Final[tuple[Callable[[Tell], Section], ...]] = (
    depth.section,
    motion.section,
    obliquity.section,
    searches.section,
    turning.section,
    cost.section,
    sensitivity.section,
    finite_elements.section,
    open_points.section,
)
"""In the order of the page."""
COUNT: Final = len(SECTIONS)


def sections(tell: Tell) -> Iterator[Section]:
    """Yield the sections one by one, each computed when it is needed."""
    for section in SECTIONS:
        yield section(tell)

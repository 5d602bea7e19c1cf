"""The validation report: depths of published tests beside the model's, and what they do not show."""

from collections.abc import Callable, Iterator, Mapping
from typing import Final

from service.reports.contents import Section, Tell
from service.reports.validation.assessment import Assessment, assess
from service.reports.validation.crater import crater_section
from service.reports.validation.limits import limits_section
from service.reports.validation.listing import tests_section
from service.reports.validation.ratios import ratios_section
from service.reports.validation.size_law_section import size_law_section

TITLE = "Validation: depths of published tests"
INTRODUCTION = (
    "Normal impact of ogive-nosed steel projectiles on concrete, as measured by others, beside this model.",
    (
        "A ratio is **predicted over measured** depth: above 1 the prediction is too deep. The coefficient of "
        "variation is the sample standard deviation of the ratios, with n - 1, over their mean."
    ),
)
PARTS: Final[Mapping[str, Callable[[Assessment], Section]]] = {
    "tests": tests_section,
    "predicted over measured depth": ratios_section,
    "what the model misses": limits_section,
    "strength, diameter and speed": size_law_section,
    "closed form and trajectory model": crater_section,
}
"""In the order of the page."""
COUNT: Final = len(PARTS)


def sections(tell: Tell) -> Iterator[Section]:
    """Compute and write the sections one by one.

    Parameters
    ----------
    tell
        Is told what comes next.

    Yields
    ------
    Section
        In their order in the report.
    """
    yield from parts(assess(tell), tell)


def parts(assessment: Assessment, tell: Tell) -> Iterator[Section]:
    """Sections from the computed depths."""
    for what, section in PARTS.items():
        tell(what)
        yield section(assessment)

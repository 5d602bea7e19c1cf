"""The model beside finite elements of the same strike, calibrated on some of them."""

from service.reports.finite_elements.comparison import section

__all__ = ["section"]

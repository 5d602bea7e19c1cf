"""What can go wrong in the solver.

    RicochetError
    ├── ParameterError      an input is outside what the model accepts
    └── IntegrationError    the motion could not be integrated
        └── StepLimitError  more steps than a run may take

Ways for a run or a search to end (embedded, no ricochet, ...) are results, not errors.
"""


class RicochetError(Exception):
    """Root of every error the solver raises on purpose."""


class ParameterError(RicochetError, ValueError):
    """An input is outside what the model accepts.

    Parameters
    ----------
    field
        Dotted name of the input, such as ``projectile.length``.
    requirement
        What it must satisfy, with the bound and the value found.
    """

    def __init__(self, field: str, requirement: str) -> None:
        super().__init__(field, requirement)
        self.field = field
        self.requirement = requirement

    def __str__(self) -> str:
        return f"{self.field}: {self.requirement}"


class IntegrationError(RicochetError):
    """The motion could not be integrated, for instance because the state is no longer finite."""


class StepLimitError(IntegrationError):
    """The integration needed more steps than one run may take."""

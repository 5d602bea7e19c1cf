"""The settings of the service, as the environment has them."""

from typing import TYPE_CHECKING, Any

from service.commands.errors import UsageError

if TYPE_CHECKING:
    from service.settings import Settings


def read_settings(**fixed: Any) -> "Settings":
    """Return the settings; those that are fixed go before the environment.

    Raises
    ------
    UsageError
        If one of them is wrong.
    """
    from pydantic import ValidationError

    from service.settings import Settings

    try:
        return Settings(**fixed)
    except ValidationError as error:
        raise UsageError(f"a RICOCHET_... variable is wrong: {error}") from None

"""Columns as a table of pandas, for those who have it: nothing here needs it otherwise."""

from collections.abc import Mapping
from importlib import import_module
from typing import Any, TypeAlias

import numpy as np
import numpy.typing as npt

Columns: TypeAlias = dict[str, npt.NDArray[Any]]
"""Arrays of equal length by name."""


def dataframe(columns: Mapping[str, npt.NDArray[np.generic]]) -> Any:
    """Return the columns as a ``pandas.DataFrame``.

    Raises
    ------
    ModuleNotFoundError
        If pandas is not installed.
    """
    try:
        pandas = import_module("pandas")
    except ModuleNotFoundError as error:
        if error.name != "pandas":
            raise
        raise ModuleNotFoundError(
            "to_dataframe() needs pandas: pip install pandas; columns() gives the same as arrays", name="pandas"
        ) from None
    return pandas.DataFrame(dict(columns))

"""The content of a body as a validated request, from wherever it comes; what is wrong with it is one error."""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import Any, TypeVar

from pydantic import BaseModel, ValidationError

from service.errors import InvalidBodyError, field_errors, validation_errors
from service.schemas.sweeps import AxisError, Grid, Outline
from solver import ParameterError

Model = TypeVar("Model", bound=BaseModel)


def validated_as(model: type[Model], content: Any, pointer: str = "") -> Model:
    """Return the content of a body, or of the part at a pointer, as this model.

    Raises
    ------
    InvalidBodyError
        If it is not valid.
    """
    try:
        return model.model_validate(content)
    except ValidationError as error:
        raise InvalidBodyError(validation_errors(error.errors(), pointer)) from error


def grid_of(model: type[BaseModel], outline: Outline) -> Grid:
    """Return the points of a sweep.

    Parameters
    ----------
    model
        Request that the base and every point have to be.

    Raises
    ------
    InvalidBodyError
        If the base is not valid or an axis cannot be laid.
    """
    validated_as(model, outline.base, "/base")
    try:
        return Grid(model, outline)
    except AxisError as error:
        raise InvalidBodyError([{"pointer": error.pointer, "detail": error.detail}]) from error


@contextmanager
def errors_of_point(grid: Grid, number: int, point: Sequence[float]) -> Iterator[None]:
    """Turn what is wrong with the request of a point into an error that names its place in the sweep."""
    try:
        yield
    except (ValidationError, ParameterError) as error:
        found = field_errors(error) if isinstance(error, ParameterError) else validation_errors(error.errors())
        place = "at " + ", ".join(f"{field} = {value:g}" for field, value in zip(grid.fields, point, strict=True))
        errors = [{**each, "pointer": grid.pointer(number, each["pointer"])} for each in found]
        raise InvalidBodyError(errors, place) from error

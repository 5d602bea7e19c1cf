"""Uncertain inputs of a strike by the names of the solver."""

from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from functools import partial
from typing import Any

from solver.prepared import check_case
from solver.resistance import (
    ConstantStrengthFactor,
    ObliquityPolynomial,
    PublishedTests,
    StrengthFactor,
)
from solver.strike import is_part, put
from solver.uncertainty.distributions import Discrete, Distribution, stated_values
from solver.validation import ParameterError, require, require_positive

RESIDUAL = "resistance.strength_residual"
"""Field of a factor on S, whatever the law of S: the part of its scatter that no input of the law explains."""
MOST_INPUTS = 24


@dataclass(frozen=True, slots=True)
class Uncertain:
    """An input and its distribution, independent of the others.

    Parameters
    ----------
    field
        Dotted name, as in ``impact.velocity``, ``target.compressive_strength``, ``projectile.mass``,
        ``numerics.retention_energy_fraction``; a model with discrete values, as in
        ``resistance.free_surface``; or ``resistance.strength_residual``, a factor on the strength factor.
    distribution
        In the unit of the field.
    """

    field: str
    distribution: Distribution


def check_inputs(uncertain: Sequence[Uncertain]) -> None:
    """Refuse no input, too many of them, and the same field twice."""
    require(1 <= len(uncertain) <= MOST_INPUTS, "uncertain", f"must hold 1 to {MOST_INPUTS} inputs")
    for index, (field, count) in enumerate(Counter(each.field for each in uncertain).items()):
        if count > 1:
            later = [i for i, each in enumerate(uncertain) if each.field == field][1]
            raise ParameterError(f"uncertain.{later}.field", f"{field!r} is the field of another input, {index}")


def check_values(index: int, uncertain: Uncertain, check: Callable[[Any], object]) -> None:
    """Refuse a distribution whose discrete values, bounds, mean or median are not accepted as values of its field.

    Parameters
    ----------
    index
        Place of the input.
    check
        Takes a value; raises ParameterError if it is not accepted.
    """
    for name, value in stated_values(uncertain.distribution):
        try:
            check(value)
        except ParameterError as error:
            field = f"uncertain.{index}.distribution.{name}"
            raise ParameterError(field, f"is no value of {uncertain.field!r}: {error.requirement}") from None


def scaled(model: StrengthFactor, factor: float) -> StrengthFactor:
    """Return a strength factor model with all its values multiplied."""
    require_positive(RESIDUAL, factor)
    if isinstance(model, ConstantStrengthFactor):
        return replace(model, value=factor * model.value)
    if isinstance(model, ObliquityPolynomial):
        return ObliquityPolynomial(coefficients=tuple(factor * each for each in model.coefficients))
    if isinstance(model, PublishedTests):
        model = replace(model.law, obliquity_shape=model.obliquity_shape)
    return replace(model, coefficient=factor * model.coefficient)


class Strike:
    """One strike, of which samples differ in the uncertain inputs.

    Parameters
    ----------
    parts
        ``projectile``, ``target``, ``impact``, ``resistance``, ``numerics``.
    uncertain
        Inputs.

    Raises
    ------
    ParameterError
        If a field is no number of the strike, or a distribution is not of values that the model accepts.
    """

    def __init__(self, parts: Mapping[str, Any], uncertain: Sequence[Uncertain]) -> None:
        check_inputs(uncertain)
        self._parts = dict(parts)
        self._paths = [each.field.split(".") for each in uncertain]
        for index, each in enumerate(uncertain):
            self._check(index, each)
        for index, each in enumerate(uncertain):
            check_values(index, each, partial(self.check, index))

    def check(self, index: int, value: Any) -> None:
        """Refuse a value of one input that the model does not accept, the others as in the strike.

        Raises
        ------
        ParameterError
            If it is not accepted.
        """
        parts = self._with([(self._paths[index], value)])
        check_case(parts["projectile"], parts["target"])

    def accepts(self, index: int, value: Any) -> bool:
        """Return whether the model accepts a value of one input, the others as in the strike."""
        try:
            self.check(index, value)
        except ParameterError:
            return False
        return True

    def sample(self, values: Sequence[Any]) -> dict[str, Any]:
        """Return the parts with these values of the inputs.

        Raises
        ------
        ParameterError
            If a value is outside what the model accepts.
        """
        return self._with(zip(self._paths, values, strict=True))

    def _with(self, values: Iterable[tuple[Sequence[str], Any]]) -> dict[str, Any]:
        parts, residual = dict(self._parts), None
        for (name, *path), value in sorted(values, key=lambda each: len(each[0])):
            if ".".join((name, *path)) == RESIDUAL:
                residual = value
            else:
                parts[name] = put(parts[name], path, value)
        if residual is not None:
            resistance = parts["resistance"]
            parts["resistance"] = replace(resistance, strength_factor=scaled(resistance.strength_factor, residual))
        return parts

    def _check(self, index: int, uncertain: Uncertain) -> None:
        field = f"uncertain.{index}.field"
        if uncertain.field == RESIDUAL:
            return
        part: Any = self._parts
        for name in self._paths[index]:
            holder = part if isinstance(part, Mapping) else None
            known = (
                list(holder) if holder is not None else [each.name for each in fields(part)] if is_part(part) else []
            )
            require(name in known, field, f"{uncertain.field!r} is not there: known are {', '.join(known) or 'none'}")
            part = holder[name] if holder is not None else getattr(part, name)
        discrete = isinstance(uncertain.distribution, Discrete)
        number = part is None or (isinstance(part, float | int) and not isinstance(part, bool))
        require(number or (discrete and len(self._paths[index]) > 1), field, f"{uncertain.field!r} is no number")

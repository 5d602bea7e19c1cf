"""Who asks, and what of it counts: one visit a request, in the scope of the request."""

from dataclasses import dataclass
from typing import Annotated

from fastapi import Depends, Request
from starlette.types import Scope as RequestScope

from service.access.key import SCOPES, Key, Scope
from service.access.keyring import LOCAL
from service.access.usage import Usage

VISIT = "ricochet.visit"
"""In the scope of a request."""


@dataclass(frozen=True, slots=True)
class Caller:
    """Who asks.

    Parameters
    ----------
    owner
        Of the jobs that are made.
    key
        None where no key is asked for.
    usage
        What is counted of the key.
    """

    owner: str
    key: Key | None = None
    usage: Usage | None = None

    def may(self, scope: Scope) -> bool:
        """Tell whether this is allowed."""
        return self.key is None or self.key.may(scope)

    @property
    def sees(self) -> str | None:
        """Owner whose jobs are there for the caller; None for those of all."""
        return None if self.may(SCOPES[-1]) else self.owner


ANYONE = Caller(LOCAL)


class Visit:
    """A request as far as access goes.

    Parameters
    ----------
    caller
        Who asks.
    """

    __slots__ = ("caller", "cases", "job")

    def __init__(self, caller: Caller) -> None:
        self.caller = caller
        self.cases = 0
        """Asked for, as they count against the limit of the key."""
        self.job = ""
        """Made or ended, if one was."""

    def take(self, count: int) -> None:
        """Count cases.

        Raises
        ------
        QuotaError
            If the key may not ask for so many now.
        """
        if self.caller.usage is not None:
            self.caller.usage.take(count)
        self.cases += count

    def give_back(self) -> None:
        """Count nothing of this request: it was refused, or had been counted before."""
        if self.caller.usage is not None:
            self.caller.usage.give_back(self.cases)
        self.cases = 0


async def visit_of(request: Request) -> Visit:
    """Return the visit of a request."""
    return visit_in(request.scope)


def visit_in(scope: RequestScope) -> Visit:
    """Return the visit in the scope of a request."""
    visit: Visit = scope[VISIT]
    return visit


AskedVisit = Annotated[Visit, Depends(visit_of)]

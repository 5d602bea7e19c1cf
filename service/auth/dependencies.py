"""Authorization by FastAPI's means: who sends a request, what its key permits, and what it may hold while it lasts."""

from collections import Counter
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import lru_cache
from http import HTTPStatus
from ipaddress import IPv6Network
from typing import Annotated

from fastapi import HTTPException, Request, Security
from fastapi.security import HTTPBearer, SecurityScopes
from starlette.types import Receive, Send
from starlette.types import Scope as RequestScope

from service.auth.api_keys import LOCAL, SCOPES, ApiKey, ApiKeyStore
from service.auth.quotas import Quota, QuotaStore
from service.errors import InvalidBodyError, PoolUnavailableError, QueueFullError, ServiceError
from service.jobs.models import Charge
from solver import ParameterError

CONTEXT = "ricochet.context"
"""Key of the context in the scope of a request."""
REFUSALS = (InvalidBodyError, ParameterError, PoolUnavailableError, QueueFullError)
"""Errors of cases that were not computed."""
CHALLENGE = {"WWW-Authenticate": "Bearer"}
INVALID_TOKEN = {"WWW-Authenticate": 'Bearer error="invalid_token"'}


@dataclass(frozen=True, slots=True)
class Principal:
    """The sender of a request.

    Parameters
    ----------
    owner
        Owner of the jobs that are made.
    key
        None where no key is required.
    quota
        Quota of the key.
    """

    owner: str
    key: ApiKey | None = None
    quota: Quota | None = None

    @property
    def visible_owner(self) -> str | None:
        """Owner whose jobs are visible; None for those of all."""
        return None if self.key is None or self.key.may(SCOPES[-1]) else self.owner


ANONYMOUS = Principal(LOCAL)


class RequestContext:
    """Principal and quota use of one request; one object in the scope of each.

    Parameters
    ----------
    keys, quotas
        Stores of the data folder.
    key_required
        Whether the request needs a key unless its route is public.
    client
        Address of the client.
    """

    __slots__ = ("_client", "_keys", "_quotas", "cases", "job", "key_required", "principal")

    def __init__(self, keys: ApiKeyStore, quotas: QuotaStore, *, key_required: bool, client: str | None = None) -> None:
        self._client = client
        self._keys = keys
        self._quotas = quotas
        self.key_required = key_required
        self.principal = ANONYMOUS
        self.cases = 0
        """Cases counted against the quota."""
        self.job = ""
        """Id of the job that was made or ended."""

    @property
    def queue_owner(self) -> str:
        """Owner in whose turn work is computed: without a key, the address of the client."""
        return self.principal.owner if self.principal.key else f"address {network_of(self._client)}"

    def authorize(self, token: str | None, scopes: Iterable[str]) -> None:
        """Identify the principal, and check that its key has these scopes.

        Raises
        ------
        HTTPException
            401 without a valid key, 403 if it lacks a scope.
        """
        if not self.key_required:
            return
        if token is None:
            detail = "an API key is required: `Authorization: Bearer ...`"
            raise HTTPException(HTTPStatus.UNAUTHORIZED, detail, headers=CHALLENGE)
        key = self._keys.find(token.strip())
        if key is None:
            raise HTTPException(HTTPStatus.UNAUTHORIZED, "invalid or expired API key", headers=INVALID_TOKEN)
        # Before the scopes are checked, so that the audit log names whose key was refused.
        self.principal = Principal(key.owner, key, self._quotas.quota(key.id, key.cases_per_hour))
        for scope in scopes:
            if not key.may(scope):
                raise HTTPException(HTTPStatus.FORBIDDEN, f"the API key lacks the scope `{scope}`")

    def take(self, count: int) -> None:
        """Count cases.

        Raises
        ------
        QuotaError
            If the key has fewer left.
        """
        if self.principal.quota is not None:
            self.principal.quota.take(count, self.cases)
        self.cases += count

    def charge(self, count: int) -> Charge | None:
        """Count cases that a job may take; return what it keeps to give back the rest, None without a key.

        Raises
        ------
        QuotaError
            If the key has fewer left.
        """
        charge: Charge | None = None
        principal = self.principal
        if principal.quota is not None and principal.key is not None:
            charge = Charge(principal.key.id, count, principal.quota.take(count, self.cases))
        self.cases += count
        return charge

    def give_back(self, count: int | None = None) -> None:
        """Take back cases, all of this request if no number is given: refused, or counted before."""
        count = self.cases if count is None else count
        if self.principal.quota is not None:
            self.principal.quota.give_back(count)
        self.cases -= count

    @contextmanager
    def taking(self, count: int) -> Iterator[None]:
        """Count cases that are computed in the block, unless they are refused there: a failed run counts.

        Raises
        ------
        QuotaError
            If the key has fewer left.
        """
        self.take(count)
        try:
            yield
        except REFUSALS:
            self.give_back(count)
            raise


@lru_cache(maxsize=1024)
def network_of(address: str | None) -> str | None:
    """Return an IPv4 address, or the /64 of an IPv6 address: one client has all of it."""
    try:
        return str(IPv6Network((address or "", 64), strict=False))
    except ValueError:
        return address


def context_in(scope: RequestScope) -> RequestContext:
    """Return the context in the scope of a request."""
    context: RequestContext = scope[CONTEXT]
    return context


class Authorization(HTTPBearer):
    """FastAPI's declaration of keys, which also checks them: a dependency of a dependency would cost each request more.

    `__call__` has the parameters that FastAPI fills in, one more than that of its base.
    """

    async def __call__(self, request: Request, required: SecurityScopes) -> RequestContext:  # type: ignore[override]
        """Return the context of a request whose key has the scopes of its route.

        Raises
        ------
        HTTPException
            401 without a valid key, 403 if it lacks a scope.
        """
        context, credentials = context_in(request.scope), await super().__call__(request)
        context.authorize(None if credentials is None else credentials.credentials, required.scopes)
        return context


authorize = Authorization(
    scheme_name="key",
    description="A key of `ricochet keys add`, where the service requires one. A key with the scope `admin` has all "
    "scopes, and sees the jobs of all owners.",
    auto_error=False,
)


async def authorize_unrouted(scope: RequestScope, _: Receive, __: Send) -> None:
    """Refuse a path without a route: with 401 or 403 like the routes, so that only public paths need no key.

    Raises
    ------
    HTTPException
        404, or as `authorize`.
    """
    request = Request(scope)
    required = SecurityScopes(["read" if scope["method"] == "GET" else "run"])
    await authorize(request, required)
    raise HTTPException(HTTPStatus.NOT_FOUND)


READ, RUN = Security(authorize, scopes=["read"]), Security(authorize, scopes=["run"])
ReadContext = Annotated[RequestContext, READ]
RunContext = Annotated[RequestContext, RUN]


class ConcurrencyLimit:
    """Bounds what requests hold while they last, of each owner and in all.

    Parameters
    ----------
    per_owner, total
        Most at once; `total` is None if there is no such limit.
    owner_error, total_error
        Make the error from the limit that is reached.
    """

    def __init__(
        self,
        per_owner: int,
        owner_error: Callable[[int], ServiceError],
        total: int | None = None,
        total_error: Callable[[int], ServiceError] | None = None,
    ) -> None:
        self._per_owner, self._owner_error = per_owner, owner_error
        self._total, self._total_error = total, total_error
        self._held: Counter[str] = Counter()

    @contextmanager
    def held(self, owner: str) -> Iterator[None]:
        """Hold one during the block.

        Raises
        ------
        ServiceError
            If a limit is reached.
        """
        if self._held[owner] >= self._per_owner:
            raise self._owner_error(self._per_owner)
        if self._total is not None and self._total_error is not None and self._held.total() >= self._total:
            raise self._total_error(self._total)
        self._held[owner] += 1
        try:
            yield
        finally:
            self._held[owner] -= 1
            if not self._held[owner]:
                del self._held[owner]

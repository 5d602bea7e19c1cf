"""Authorization with FastAPI's security dependencies: principal, scopes, quota and concurrency limits of a request."""

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
"""Key of the `RequestContext` in the ASGI scope of a request."""
REFUSALS = (InvalidBodyError, ParameterError, PoolUnavailableError, QueueFullError)
"""Errors of requests that were refused before they were computed. Such requests are not charged to the quota."""
CHALLENGE = {"WWW-Authenticate": "Bearer"}
INVALID_TOKEN = {"WWW-Authenticate": 'Bearer error="invalid_token"'}


@dataclass(frozen=True, slots=True)
class Principal:
    """The sender of a request.

    Parameters
    ----------
    owner
        Owner of the jobs that the request creates.
    key
        API key; None where no key is required.
    quota
        Quota of the key.
    """

    owner: str
    key: ApiKey | None = None
    quota: Quota | None = None

    @property
    def visible_owner(self) -> str | None:
        """Owner whose jobs the principal can see; None if it can see the jobs of all owners."""
        return None if self.key is None or self.key.may(SCOPES[-1]) else self.owner


ANONYMOUS = Principal(LOCAL)


class RequestContext:
    """Principal, charged cases and job of one request, for its route and the audit log.

    Parameters
    ----------
    keys, quotas
        Stores of API keys and of their quotas.
    key_required
        True if the request needs a key unless its route is public.
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
        """Number of cases charged to the quota."""
        self.job = ""
        """Id of the job that the request created, changed or ended."""

    @property
    def queue_owner(self) -> str:
        """Owner whose share of the workers the work counts against; without a key, the address of the client."""
        return self.principal.owner if self.principal.key else f"address {network_of(self._client)}"

    def authorize(self, token: str | None, scopes: Iterable[str]) -> None:
        """Identify the principal by its token, and check that its key has the given scopes.

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
        # The principal is set before the scopes are checked, so that the audit log names the owner of a refused key.
        self.principal = Principal(key.owner, key, self._quotas.quota(key.id, key.cases_per_hour))
        for scope in scopes:
            if not key.may(scope):
                raise HTTPException(HTTPStatus.FORBIDDEN, f"the API key lacks the scope `{scope}`")

    def take(self, count: int) -> None:
        """Charge cases to the quota.

        Raises
        ------
        QuotaError
            If the quota has fewer cases left.
        """
        if self.principal.quota is not None:
            self.principal.quota.take(count, self.cases)
        self.cases += count

    def charge(self, count: int) -> Charge | None:
        """Charge the cases that a job may take, and return the charge; None without a quota.

        The unused part of the charge is given back at the end of the job.

        Raises
        ------
        QuotaError
            If the quota has fewer cases left.
        """
        charge: Charge | None = None
        principal = self.principal
        if principal.quota is not None and principal.key is not None:
            charge = Charge(principal.key.id, count, principal.quota.take(count, self.cases))
        self.cases += count
        return charge

    def give_back(self, count: int | None = None) -> None:
        """Give cases back to the quota, by default all that were charged for this request."""
        count = self.cases if count is None else count
        if self.principal.quota is not None:
            self.principal.quota.give_back(count)
        self.cases -= count

    @contextmanager
    def taking(self, count: int) -> Iterator[None]:
        """Charge cases that are computed in the block, and give them back if they are refused. Failed runs are charged.

        Raises
        ------
        QuotaError
            If the quota has fewer cases left.
        """
        self.take(count)
        try:
            yield
        except REFUSALS:
            self.give_back(count)
            raise


@lru_cache(maxsize=1024)
def network_of(address: str | None) -> str | None:
    """Return an IPv4 address unchanged. Return the /64 network of an IPv6 address, since a client may use all of it."""
    try:
        return str(IPv6Network((address or "", 64), strict=False))
    except ValueError:
        return address


def context_in(scope: RequestScope) -> RequestContext:
    """Return the context of a request from its ASGI scope."""
    context: RequestContext = scope[CONTEXT]
    return context


class Authorization(HTTPBearer):
    """Security scheme that declares API keys in the contract and also checks them.

    A separate dependency for the check would cost each request another call through FastAPI's dependency solver.
    FastAPI fills in the parameter `required` of `__call__`, which the base class lacks.
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
    description="API key made by `ricochet keys add`, where the service requires one. A key with the scope `admin` has "
    "all scopes and sees the jobs of all owners.",
    auto_error=False,  # The base class would require a key of an open service too, and send no problem document.
)


async def authorize_unrouted(scope: RequestScope, _: Receive, __: Send) -> None:
    """Refuse a path without a route, after the same checks as a route, so that paths cannot be probed without a key.

    Raises
    ------
    HTTPException
        401 or 403 like a route, else 404.
    """
    request = Request(scope)
    required = SecurityScopes(["read" if scope["method"] == "GET" else "run"])
    await authorize(request, required)
    raise HTTPException(HTTPStatus.NOT_FOUND)


READ, RUN = Security(authorize, scopes=["read"]), Security(authorize, scopes=["run"])
ReadContext = Annotated[RequestContext, READ]
RunContext = Annotated[RequestContext, RUN]


class ConcurrencyLimit:
    """Limit on concurrent uses of a resource, per owner and in total.

    Parameters
    ----------
    per_owner, total
        Largest number of concurrent uses. `total` is None for no limit.
    owner_error, total_error
        Functions that return the error to raise, given the limit that was reached.
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
        """Count a use during the block.

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
            if not self._held[owner]:  # Otherwise the table would grow with every new address.
                del self._held[owner]

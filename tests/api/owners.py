"""Keys of several owners, and a service that requires them."""

from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

import httpx

from service.auth.api_keys import add_key, make_key
from tests.conftest import NO_TLS, until


def key_in(folder: Path, owner: str, *scopes: str, **more: Any) -> str:
    """Add a key to a data folder; return its token."""
    key, token = make_key(owner, frozenset(scopes or ("read", "run")), **more)  # type: ignore[arg-type]
    add_key(folder, key)
    return token


def bearer(token: str) -> dict[str, str]:
    return {"Authorization": f"Bearer {token}"}


def holder(url: str, token: str = "") -> httpx.Client:
    """Return a client that sends this token, if any, and uses no proxy."""
    return httpx.Client(
        base_url=url, headers=bearer(token) if token else {}, timeout=60.0, trust_env=False, verify=NO_TLS
    )


class Guarded:
    """A service that requires keys, with clients of two owners and an administrator."""

    def __init__(self, url: str, folder: Path, clients: ExitStack) -> None:
        self.url = url
        self.folder = folder
        self.anna, self.bert, self.chief = (
            clients.enter_context(holder(url, key_in(folder, owner, *scopes)))
            for owner, scopes in {"anna": (), "bert": (), "chief": ("admin",)}.items()
        )
        with holder(url) as nobody:
            # The service accepts requests without a key until it has read the new ones.
            until(lambda: not is_known(nobody))
        for client in (self.anna, self.bert, self.chief):
            until(lambda: is_known(client))  # noqa: B023 (called at once)

    def with_key(self, owner: str, *scopes: str, **more: Any) -> httpx.Client:
        """Add a key; return a client that uses it, once the service has read it."""
        token = key_in(self.folder, owner, *scopes, **more)
        with holder(self.url, token) as client:
            until(lambda: is_known(client))
        return holder(self.url, token)


def is_known(client: httpx.Client) -> bool:
    """Return whether the service, which reads new keys periodically, accepts the key of this client."""
    return client.get("/jobs").status_code != httpx.codes.UNAUTHORIZED


@contextmanager
def guarded_service(url: str, folder: Path) -> Iterator[Guarded]:
    """Add keys to a running service, and wait until it requires them."""
    with ExitStack() as clients:
        yield Guarded(url, folder, clients)

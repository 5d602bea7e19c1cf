"""Headers that name the address of the client are trusted only if they come from a proxy in the settings."""

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import httpx
import pytest
from pydantic import ValidationError

from service.schemas.strike import PAPER
from service.settings import Settings
from tests.conftest import RunService, until

PROXY, OTHER, CLIENT = "127.0.0.2", "127.0.0.1", "203.0.113.9"


class ProxiedService(NamedTuple):
    """A service that trusts one proxy on this machine, and its audit log."""

    url: str
    audit_log: Path

    def post(self, address: str, **headers: str) -> tuple[httpx.Response, dict[str, Any]]:
        """Send a query from a loopback address; return the answer and its entry in the audit log."""
        transport = httpx.HTTPTransport(local_address=address)
        named = {name.replace("_", "-"): value for name, value in headers.items()}
        with httpx.Client(base_url=self.url, transport=transport, timeout=180.0) as client:
            known = len(self._entries())
            answer = client.post("/cra", json=PAPER, headers=named)
        until(lambda: len(self._entries()) > known)  # The entry is written after the answer.
        return answer, json.loads(self._entries()[-1])

    def _entries(self) -> list[str]:
        return self.audit_log.read_text().splitlines() if self.audit_log.exists() else []


@pytest.fixture(scope="module")
def proxied(service_on: RunService, tmp_path_factory: pytest.TempPathFactory) -> Iterator[ProxiedService]:
    folder = tmp_path_factory.mktemp("proxied")
    audit_log = folder / "audit.jsonl"
    with service_on(folder, executor="in-process", trusted_proxies=PROXY, audit_log=str(audit_log)) as service:
        yield ProxiedService(service.url, audit_log)


def test_client_is_the_last_address_that_a_trusted_proxy_names(proxied: ProxiedService) -> None:
    """A client on another machine needs a key, although the proxy is on this machine."""
    answer, entry = proxied.post(PROXY, X_Forwarded_For=f"{OTHER}, {CLIENT}")
    assert (answer.status_code, entry["client"]) == (401, CLIENT)
    answer, entry = proxied.post(PROXY, X_Forwarded_For=OTHER)
    assert (answer.status_code, entry["client"]) == (200, OTHER)


def test_forwarded_address_of_an_untrusted_client_is_ignored(proxied: ProxiedService) -> None:
    answer, entry = proxied.post(OTHER, X_Forwarded_For=CLIENT, X_Forwarded_Proto="https")
    assert (answer.status_code, entry["client"]) == (200, OTHER)
    assert "Strict-Transport-Security" not in answer.headers


def test_tls_at_a_trusted_proxy_is_tls(proxied: ProxiedService) -> None:
    answer, _ = proxied.post(PROXY, X_Forwarded_For=OTHER, X_Forwarded_Proto="https")
    assert answer.headers["Strict-Transport-Security"]


@pytest.mark.parametrize("proxies", ["*", "proxy.example.org", "10.0.0.1/8", "127.0.0.1,"])
def test_proxies_are_addresses_or_networks(monkeypatch: pytest.MonkeyPatch, proxies: str) -> None:
    monkeypatch.setenv("RICOCHET_TRUSTED_PROXIES", proxies)
    with pytest.raises(ValidationError, match="is not an address or a network"):
        Settings()

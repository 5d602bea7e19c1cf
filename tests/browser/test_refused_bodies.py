"""A script in a web page receives a refusal that is sent before the whole body has been read."""

from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager
from typing import Any

import pytest
from playwright.sync_api import Browser

from tests.api.certificates import make_certificate

FETCH = """async ([path, mediaType, size]) => {
    const headers = mediaType ? {"Content-Type": mediaType} : {};
    const answer = await fetch(path, {method: "POST", headers, body: new Uint8Array(size)});
    return [answer.status, await answer.json()];
}"""
REFUSALS = [(413, "/cra", "application/json"), (404, "/nothing", ""), (405, "/livez", ""), (415, "/cra", "text/plain")]


@pytest.fixture(scope="module", params=["plain", "tls"])
def url(
    request: pytest.FixtureRequest,
    service_on: Callable[..., AbstractContextManager[Any]],
    tmp_path_factory: pytest.TempPathFactory,
) -> Iterator[str]:
    folder = tmp_path_factory.mktemp(f"refusing-{request.param}")
    made = make_certificate(folder) if request.param == "tls" else None
    settings = {"verify": made.trusted(), **made.settings} if made else {}
    with service_on(folder, **settings) as service:
        yield service.url


@pytest.mark.parametrize("megabytes", [5, 50])
def test_page_reads_every_refusal_of_a_large_body(browser: Browser, url: str, megabytes: int) -> None:
    with browser.new_context(base_url=url, ignore_https_errors=True) as context:
        page = context.new_page()
        page.goto("/")
        for status, path, media_type in REFUSALS * 2 if megabytes < 10 else REFUSALS[:1]:
            found, problem = page.evaluate(FETCH, [path, media_type, megabytes * 1_000_000])
            assert found == status
            assert problem["status"] == status

"""The fixtures of the browser tests record errors and requests to other servers."""

import pytest
from playwright.sync_api import Error, Page


def test_errors_of_a_page_are_recorded(page: Page, faults: list[str]) -> None:
    page.goto("/docs")
    with page.expect_event("pageerror"):
        page.evaluate("() => { console.error('spilt'); setTimeout(() => { throw new Error('dropped') }) }")
    assert [fault.split(" (")[0] for fault in faults] == ["console error: spilt", "page error: dropped"]
    faults.clear()


def test_requests_to_other_servers_are_recorded(page: Page, faults: list[str]) -> None:
    page.goto("/docs")
    with pytest.raises(Error, match="ERR_NAME_NOT_RESOLVED"):
        page.goto("http://elsewhere.test/")
    assert faults == ["request that leaves the service: http://elsewhere.test/"]
    faults.clear()

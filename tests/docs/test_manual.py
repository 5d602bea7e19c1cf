"""The manual builds without warnings, loads nothing from other servers, and works with a strict security policy."""

import os
import re
import subprocess
import sys
import zlib
from collections.abc import Callable, Iterator
from html.parser import HTMLParser
from pathlib import Path
from typing import Any
from urllib.parse import unquote, urlsplit

import httpx
import pytest
from playwright.sync_api import Browser, ConsoleMessage, Page, Request

import solver
import solver.calibration
import solver.uncertainty
from tests.browser.chromium import NAMES, executable, running_chromium

from .blocks import ROOT

pytestmark = [pytest.mark.system, pytest.mark.timeout(900)]  # The build takes minutes on a busy machine.
STYLE_REFUSED = re.compile(r"(?:Refused to apply|Applying) inline style\b[^\n]*Content Security Policy directive")
"""Message of Chromium about style attributes, with which the theme hides icons. The policy forbids them, so manual.css
hides the icons instead."""
FIRST_PAGES = ("index.html", "tutorial/first-map.html", "explanation/model.html", "reference/http.html")


@pytest.fixture(scope="module")
def manual(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder with the manual, built as by `make docs`."""
    folder = tmp_path_factory.mktemp("manual")
    command = [sys.executable, "-m", "sphinx", "--builder", "html", "--fresh-env", "--fail-on-warning", "--keep-going"]
    command += ["--quiet", "--doctree-dir", str(folder / "doctrees"), str(ROOT / "docs"), str(folder / "html")]
    done = subprocess.run(command, cwd=ROOT, env=os.environ, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    assert "WARNING" not in done.stderr, done.stderr
    return folder / "html"


class References(HTMLParser):
    """HTML parser that collects links and anchors of a page."""

    def __init__(self, page: Path) -> None:
        super().__init__()
        self.loaded: list[str] = []
        self.linked: list[str] = []
        self.anchors: set[str] = set()
        self.feed(page.read_text(encoding="utf-8"))

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        given = dict(attrs)
        if identifier := given.get("id"):
            self.anchors.add(identifier)
        if tag in {"img", "script", "source"} and (source := given.get("src")):
            self.loaded.append(source)
        if href := given.get("href"):
            (self.linked if tag == "a" else self.loaded).append(href)


@pytest.fixture(scope="module")
def references(manual: Path) -> dict[Path, References]:
    return {page.resolve(): References(page) for page in manual.rglob("*.html")}


def test_pages_load_nothing_from_other_servers(references: dict[Path, References]) -> None:
    assert len(references) > 25
    for page, found in references.items():
        for address in found.loaded:
            assert not urlsplit(address).scheme or address.startswith("data:"), f"{page}: {address}"
            assert not address.startswith("/"), f"{page}: {address} would be lost behind a prefix"


def test_internal_links_have_existing_targets(manual: Path, references: dict[Path, References]) -> None:
    checked = 0
    for page, found in references.items():
        for address in (*found.linked, *found.loaded):
            parts = urlsplit(address)
            if parts.scheme or parts.netloc:
                continue
            target = (page.parent / unquote(parts.path)).resolve() if parts.path else page
            target = target / "index.html" if target == manual.resolve() else target
            assert target.is_file(), f"{page}: {address}"
            if parts.fragment and target in references:
                assert unquote(parts.fragment) in references[target].anchors | {""}, f"{page}: {address}"
            checked += 1
    assert checked > 1000


def test_every_public_name_of_the_solver_is_in_the_reference(manual: Path) -> None:
    inventory = (manual / "objects.inv").read_bytes().split(b"\n", 4)[4]
    documented = {line.split(" ", 1)[0] for line in zlib.decompress(inventory).decode().splitlines()}
    for package in (solver, solver.calibration, solver.uncertainty):
        assert {f"{package.__name__}.{name}" for name in package.__all__} <= documented


def test_every_route_and_object_of_the_contract_is_in_the_reference(manual: Path) -> None:
    contract = httpx.Response(200, content=(ROOT / "openapi" / "openapi.json").read_bytes()).json()
    routes, objects = ((manual / "reference" / name).read_text("utf-8") for name in ("http.html", "http-objects.html"))
    for operations in contract["paths"].values():
        for operation in operations.values():
            assert f'id="{operation["operationId"].replace("_", "-")}"' in routes
    for name in contract["components"]["schemas"]:
        assert f'id="object-{name.lower()}"' in objects


def test_no_page_shows_unrendered_markup(manual: Path) -> None:
    for page in manual.rglob("*.html"):
        text = page.read_text("utf-8")
        body = re.sub(r"<(script|style|pre|code)\b.*?</\1>", "", text, flags=re.DOTALL)
        assert "<!-- generated" not in text, page
        assert not re.search(r":::|\$\$|\{(py|ref|doc):|```", body), page


@pytest.fixture(scope="module")
def served(manual: Path, tmp_path_factory: pytest.TempPathFactory, service_on: Callable[..., Any]) -> Iterator[str]:
    """Address of a service that serves this manual."""
    with service_on(tmp_path_factory.mktemp("served"), manual_dir=str(manual)) as service:
        yield service.url


def test_manual_is_served_with_a_strict_security_policy(served: str, manual: Path) -> None:
    answer = httpx.get(f"{served}/manual", follow_redirects=True, trust_env=False)
    assert answer.url.path == "/manual/"
    assert answer.content == (manual / "index.html").read_bytes()
    policy = answer.headers["Content-Security-Policy"]
    assert policy.startswith("default-src 'none'; script-src 'self' 'sha256-")
    assert "unsafe" not in policy
    assert answer.headers["X-Content-Type-Options"] == "nosniff"
    for path in ("missing.html", "../settings.py", "%2e%2e/%2e%2e/etc/passwd"):
        url = httpx.URL(served, raw_path=f"/manual/{path}".encode())
        assert httpx.get(url, trust_env=False).status_code == 404
    again = httpx.get(f"{served}/manual/", headers={"If-None-Match": answer.headers["ETag"]}, trust_env=False)
    assert (again.status_code, again.headers["Content-Security-Policy"]) == (304, policy)


@pytest.fixture(scope="module")
def browser() -> Iterator[Browser]:
    if executable() is None:
        pytest.skip(f"no browser here: none of {', '.join(NAMES)}")
    with running_chromium() as chromium:
        yield chromium


def opened(browser: Browser, address: str, allowed: str) -> tuple[Page, list[str]]:
    """Open a page; return it with a list of its errors, including requests to addresses outside `allowed`."""
    page, served = browser.new_page(), allowed.startswith("http")
    faults: list[str] = []

    def hear(message: ConsoleMessage) -> None:
        if message.type in {"error", "warning"} and not (served and STYLE_REFUSED.match(message.text)):
            faults.append(message.text)

    def check(request: Request) -> None:
        if not request.url.startswith((allowed, "data:")):
            faults.append(request.url)

    page.on("console", hear)
    page.on("pageerror", lambda error: faults.append(str(error)))
    page.on("request", check)
    page.on("requestfailed", lambda request: faults.append(f"failed: {request.url}"))
    page.goto(address)
    return page, faults


@pytest.mark.parametrize("name", FIRST_PAGES)
def test_browser_shows_a_served_page_without_requests_to_other_servers(
    browser: Browser, served: str, name: str
) -> None:
    page, faults = opened(browser, f"{served}/manual/{name}", served)
    assert page.locator("h1").first.is_visible()
    assert page.evaluate("document.body.dataset.theme") == "auto"  # The script of the theme has set it.
    assert page.locator("body > svg").first.bounding_box() is None
    assert faults == []
    page.close()


@pytest.mark.parametrize("name", FIRST_PAGES)
def test_browser_shows_a_page_from_the_file_system(browser: Browser, manual: Path, name: str) -> None:
    page, faults = opened(browser, (manual / name).as_uri(), "file://")
    assert page.locator("h1").first.is_visible()
    assert faults == []
    page.close()


@pytest.mark.parametrize("where", ["served", "file system"])
def test_search_finds_a_page(browser: Browser, manual: Path, served: str, where: str) -> None:
    root, allowed = (f"{served}/manual", served) if where == "served" else (manual.as_uri(), "file://")
    page, faults = opened(browser, f"{root}/search.html?q=obliquity", allowed)
    page.locator("ul.search li a").first.wait_for()
    assert faults == []
    page.close()


def test_formulas_of_the_manual_are_rendered(browser: Browser, manual: Path) -> None:
    page, _ = opened(browser, (manual / "explanation" / "model.html").as_uri(), "file://")
    boxes = [each.bounding_box() for each in page.locator("div.math math").all()]
    assert len(boxes) > 15
    assert all(box is not None and box["height"] > 10.0 and box["width"] > 50.0 for box in boxes)
    page.close()

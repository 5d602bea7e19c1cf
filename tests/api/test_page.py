"""The web page as served: files, headers, and no reference to another server."""

import base64
import hashlib
import json
import re
from html.parser import HTMLParser
from pathlib import Path

import httpx
import pytest

from service import names
from service.api.page import FOLDER, MAP_STYLE, NO_STYLE, plotly_folder
from service.schemas.verdict import usual_scatter_of_page

PLOTLY = "page/plotly/plotly.min.js"
FILES = sorted(path.relative_to(FOLDER).as_posix() for path in FOLDER.rglob("*") if path.is_file())
MEDIA_TYPES = {".js": "text/javascript", ".css": "text/css", ".svg": "image/svg+xml", ".html": "text/html"}
LISTS = ("choices", "quantities", "formulas", "outcomes", "statuses", "warnings", "operations", "job_statuses")
"""Display names that the page takes from `service.names`."""
IMPORT = re.compile(r"""(?:from|import\()\s*["'`](\.[^"'`$]*)["'`]""")


class References(HTMLParser):
    """HTML parser that collects addresses and inline code of a document."""

    def __init__(self) -> None:
        super().__init__()
        self.addresses: list[str] = []
        self.inline: list[str] = []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        given = dict(attrs)
        self.addresses += [value for name in ("href", "src") if (value := given.get(name))]
        self.inline += [name for name in given if name == "style" or name.startswith("on")]
        if tag == "style" or (tag == "script" and "src" not in given):
            self.inline.append(tag)


@pytest.fixture(scope="module")
def references(client: httpx.Client) -> References:
    parser = References()
    parser.feed(client.get("/").text)
    return parser


def assert_guarded(response: httpx.Response) -> None:
    policy = dict(part.strip().split(" ", 1) for part in response.headers["Content-Security-Policy"].split(";"))
    assert policy["default-src"] == "'none'"
    assert policy["script-src"] == "'self'"
    assert policy["connect-src"] == "'self'"
    assert {policy[name] for name in ("base-uri", "form-action", "frame-ancestors")} == {"'none'"}
    assert "unsafe" not in response.headers["Content-Security-Policy"]
    assert response.headers["X-Content-Type-Options"] == "nosniff"
    assert response.headers["Referrer-Policy"] == "no-referrer"
    assert response.headers["Cross-Origin-Opener-Policy"] == "same-origin"


def test_page_is_at_the_root(client: httpx.Client) -> None:
    answer = client.get("/")
    assert answer.status_code == 200
    assert answer.headers["Content-Type"] == "text/html; charset=utf-8"
    assert '<main id="view"' in answer.text
    assert_guarded(answer)


def test_page_refers_to_served_files_by_relative_urls(client: httpx.Client, references: References) -> None:
    assert references.addresses
    for address in references.addresses:
        assert not address.startswith("/"), f"{address} would be lost behind a prefix"
        assert ":" not in address, f"{address} leaves the service"
        if not address.startswith("#"):
            answer = client.get(f"/{address}")
            is_unbuilt = address == "manual/" and "No manual here" in answer.text
            assert answer.status_code == 200 or is_unbuilt
    assert {"manual/", "docs", "openapi.json"} <= set(references.addresses)


def test_page_has_neither_script_nor_style_inline(references: References) -> None:
    assert references.inline == []


@pytest.mark.parametrize("name", FILES)
def test_file_is_served_with_media_type_and_security_headers(client: httpx.Client, name: str) -> None:
    answer = client.get(f"/page/{name}")
    assert answer.status_code == 200
    assert answer.content == (FOLDER / name).read_bytes()
    assert answer.headers["Content-Type"].startswith(MEDIA_TYPES[Path(name).suffix])
    assert_guarded(answer)


@pytest.mark.parametrize("name", [name for name in FILES if name.endswith(".js")])
def test_imported_modules_exist(name: str) -> None:
    for imported in IMPORT.findall((FOLDER / name).read_text("utf-8")):
        assert ((FOLDER / name).parent / imported).is_file(), imported


def test_no_file_names_another_host() -> None:
    for name in FILES:
        text = (FOLDER / name).read_text("utf-8").replace('"http://www.w3.org/2000/svg"', "SVG")  # This is only a name.
        assert not re.search(r"https?://|[\"'`]//", text), name


@pytest.mark.parametrize("address", ["/", "/page/main.js", f"/{PLOTLY}", "/page/contract.json"])
def test_page_is_compressed_for_clients_that_accept_it(client: httpx.Client, address: str) -> None:
    answer = client.get(address, headers={"Accept-Encoding": "gzip"})
    assert answer.headers["Content-Encoding"] == "gzip"
    assert int(answer.headers["Content-Length"]) < 0.6 * len(answer.content)
    assert_guarded(answer)


def test_page_is_sent_uncompressed_to_other_clients(client: httpx.Client) -> None:
    answer = client.get("/page/main.js", headers={"Accept-Encoding": "identity"})
    assert "Content-Encoding" not in answer.headers
    assert answer.headers["Vary"] == "Accept-Encoding"
    assert answer.content == (FOLDER / "main.js").read_bytes()


def test_page_takes_schemas_scatter_and_display_names_from_the_service(client: httpx.Client) -> None:
    schemas = json.loads(client.get("/openapi.json").text.replace('"x-default"', '"default"'))["components"]["schemas"]
    lists = {name: getattr(names, name.upper()) for name in LISTS}
    parts = {"schemas": schemas, "usual_scatter": usual_scatter_of_page(), "names": lists}
    assert client.get("/page/contract.json").json() == parts


def test_served_plotly_is_the_installed_version(client: httpx.Client) -> None:
    answer = client.get(f"/{PLOTLY}")
    assert answer.content == (plotly_folder() / "plotly.min.js").read_bytes()
    assert answer.headers["Content-Type"].startswith("text/javascript")
    assert_guarded(answer)


def test_content_policy_allows_the_style_sheets_of_the_installed_plotly() -> None:
    bundle = (plotly_folder() / "plotly.min.js").read_text("utf-8")
    sheets = re.findall(r"textContent='((?:[^'\\]|\\.)*)'", bundle)
    assert [hash_source(sheet) for sheet in sheets] == [MAP_STYLE]
    assert hash_source("") == NO_STYLE


def hash_source(text: str) -> str:
    return f"'sha256-{base64.b64encode(hashlib.sha256(text.encode()).digest()).decode()}'"


@pytest.mark.parametrize("coding", ["identity", "gzip"])
@pytest.mark.parametrize("address", ["/", "/page/main.js", f"/{PLOTLY}", "/page/contract.json"])
def test_unchanged_file_of_the_page_is_answered_with_304(client: httpx.Client, address: str, coding: str) -> None:
    accepted = {"Accept-Encoding": coding}
    first = client.get(address, headers=accepted)
    assert first.headers["Cache-Control"] == "no-cache"
    again = client.get(address, headers=accepted | {"If-None-Match": first.headers["ETag"]})
    assert again.status_code == 304
    assert again.content == b""
    assert again.headers["Content-Security-Policy"] == first.headers["Content-Security-Policy"]
    other = client.get(address, headers={"If-None-Match": '"another"'})
    assert other.status_code == 200


def test_versioned_files_are_cached_forever(client: httpx.Client, references: References) -> None:
    files = [address for address in references.addresses if address.startswith("page/")]
    files.remove("page/contract.json")
    assert len(files) > 40
    _, version, _ = files[0].split("/", 2)
    for address in files:
        answer = client.get(f"/{address}")
        assert answer.headers["Cache-Control"] == "public, max-age=31536000, immutable"
        name = address.removeprefix(f"page/{version}/")
        assert answer.content == (FOLDER / name).read_bytes()
        assert client.get(f"/page/{name}").headers["Cache-Control"] == "no-cache"
    old = client.get(f"/page/{'0' * len(version)}/main.js")
    assert old.headers["Cache-Control"] == "no-cache", "of a page that was open while the service was replaced"
    assert old.content == (FOLDER / "main.js").read_bytes()


@pytest.mark.parametrize(
    "address",
    [
        "/page/missing.js",
        "/page/0123456789abcdef/missing.js",
        "/page/0123456789abcdef/../../app.py",
        "/page/",
        "/page/views",
        "/page/plotly/",
        "/page/plotly/widgetbundle.js",
        "/page/../app.py",
        "/page/%2e%2e/app.py",
        "/page/..%2fapp.py",
        "/page/views/%2e%2e/%2e%2e/settings.py",
        "/page/%2fetc/passwd",
        "/page/plotly/%2e%2e/%2e%2e/__init__.py",
        "/page/main.js%00.css",
    ],
)
def test_no_other_file_can_be_read(client: httpx.Client, address: str) -> None:
    url = httpx.URL(client.base_url, raw_path=address.encode())
    answer = client.send(client.build_request("GET", url))
    assert answer.status_code == 404
    assert answer.headers["Content-Type"] == "application/problem+json"


def test_page_is_not_part_of_the_contract(client: httpx.Client) -> None:
    paths = client.get("/openapi.json").json()["paths"]
    assert not [path for path in paths if path == "/" or path.startswith("/page")]

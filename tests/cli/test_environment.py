"""The command in unusual environments: variables, encodings, closed streams."""

import json
import subprocess
from pathlib import Path

import pytest

from tests.cli.commands import COMMAND, LIMIT_S, case_at, environment, run, run_process, write_cases

ANSWER = "Critical angle 48.6"
ELSEWHERE = "http://ricochet.invalid:1"


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("ALL_PROXY", "socks5://127.0.0.1:1"),
        ("all_proxy", "socks5://127.0.0.1:1"),
        ("HTTPS_PROXY", "socks4://127.0.0.1:1"),
        ("NO_PROXY", "[::1]"),
        ("no_proxy", "localhost,[::1]"),
        ("SSL_CERT_FILE", "/missing/certificates.pem"),
        ("SSL_CERT_FILE", __file__),
        ("HTTP_PROXY", "http://127.0.0.1:1"),
    ],
)
def test_invalid_variable_is_named_and_ignored_in_local_computations(
    folder: Path, live_url: str, name: str, value: str
) -> None:
    settings = {"NO_PROXY": "", name: value}
    here = run(folder, "cra", "strike.toml", "--url", live_url, **settings)
    assert here.status == 0, here.err
    assert here.out.startswith(ANSWER)
    elsewhere = run(folder, "cra", "strike.toml", "--url", ELSEWHERE, **settings)
    assert (elsewhere.status in {1, 2}, elsewhere.out) == (True, "")
    assert name in elsewhere.err
    assert "127.0.0.1:1" not in elsewhere.err  # An address may contain a password.
    for stray in ("Traceback", "[Errno"):
        assert stray not in elsewhere.err


@pytest.mark.parametrize(
    "address", ["http://127.0.0.1:1", "http://localhost:1", "http://[::1]:1", "http://127.9.9.9:1"]
)
def test_loopback_addresses_bypass_the_proxy(folder: Path, live_url: str, address: str) -> None:
    """A running service is set as the proxy: if it were used, it would answer."""
    done = run(folder, "cra", "strike.toml", "--url", address, HTTP_PROXY=live_url, NO_PROXY="")
    assert (done.status, done.out) == (1, "")
    assert done.err.startswith(f"ricochet cra: no service answers at {address}: ")
    assert "[Errno" not in done.err


@pytest.mark.parametrize("backend", ["module://matplotlib_inline.backend_inline", "nonsense"])
def test_backend_of_a_notebook_does_not_affect_plots(folder: Path, backend: str) -> None:
    args = ("trajectory", "strike.toml", "--angle", "45", "--plot", "plot.svg")
    done = run_process(folder, *args, MPLBACKEND=backend)
    assert done.status == 0, done.err
    assert (folder / "plot.svg").stat().st_size


STYLE = """\
text.usetex: True
savefig.bbox: tight
savefig.pad_inches: -9
savefig.dpi: 10000
savefig.format: nonsense
figure.figsize: 900, 900
svg.fonttype: none
font.family: nothing
axes.prop_cycle: cycler('color', ['red'])
interactive: True
backend: tkagg
"""


def drawn(folder: Path, *words: str, **settings: str) -> bytes:
    done = run_process(folder, *words, **settings)
    assert done.status == 0, done.err
    return (folder / words[-1]).read_bytes()


def test_settings_of_matplotlib_do_not_change_plots(folder: Path) -> None:
    """Plots ignore a `matplotlibrc` in the working folder, and a file named by MATPLOTLIBRC that is not valid UTF-8."""
    words = ("trajectory", "strike.toml", "--angle", "45", "--plot", "plot.svg")
    assert run(folder, *words, SOURCE_DATE_EPOCH="0").status == 0
    usual = (folder / "plot.svg").read_bytes()
    (folder / "matplotlibrc").write_text(STYLE)
    assert drawn(folder, *words, SOURCE_DATE_EPOCH="0") == usual
    (folder / "matplotlibrc").rename(folder / "own")
    (folder / "own").write_bytes(f"{STYLE}# é\n".encode("latin-1"))
    assert drawn(folder, *words, SOURCE_DATE_EPOCH="0", MATPLOTLIBRC="own") == usual


def test_settings_of_matplotlib_do_not_change_reports(folder: Path) -> None:
    (folder / "matplotlibrc").write_text(STYLE)
    assert b"data:image/svg+xml" in drawn(folder, "report", "strike.toml", "-o", "report.html")


def test_unreadable_settings_of_matplotlib_are_named(folder: Path) -> None:
    (folder / "matplotlibrc").write_bytes("# é\n".encode("latin-1"))
    done = run_process(folder, "cra", "strike.toml", "--plot", "plot.svg")
    assert (done.status, "Traceback" in done.err) == (1, False)
    assert "ricochet cra: matplotlibrc: " in done.err


@pytest.mark.parametrize("encoding", ["ascii", "gbk", "cp437"])
@pytest.mark.parametrize(
    "words",
    [
        ["--help"],
        ["cra", "--help"],
        ["calibrate", "motion", "--help"],
        ["cra", "strike.toml", "-v", "--alternatives"],
        ["cra", "strike.toml", "--angle-of-attack", "100"],
    ],
    ids=" ".join,
)
def test_characters_missing_from_an_encoding_are_replaced(folder: Path, encoding: str, words: list[str]) -> None:
    done = run(folder, *words, encoding=encoding)
    assert done.status == (2 if "100" in words else 0), done.err
    assert "Traceback" not in done.err
    assert "?" not in done.out + done.err
    if "-v" in words:
        assert ANSWER + ("°" if encoding != "ascii" else "deg") in done.out


def test_json_is_utf_8_whatever_the_encoding_of_the_process(folder: Path, live_url: str) -> None:
    write_cases(folder / "cases.jsonl", case_at(238.0, custom_id="α°"))
    done = run_process(folder, "batch", "cases.jsonl", "--url", live_url, PYTHONIOENCODING="ascii")
    assert json.loads(done.out)["custom_id"] == "α°"
    done = run_process(folder, "calibrate", "motion", "--help", PYTHONIOENCODING="ascii")
    assert done.status == 0, done.err
    assert done.out.isascii()


@pytest.mark.parametrize(
    ("line", "status"),
    [
        ("{} trajectory strike.toml --angle 45 >&-", 0),
        ("{} trajectory strike.toml --angle 45 2>&-", 0),
        ("{} formulas strike.toml <&-", 0),
        ("{} cra strike.toml --json >&- 2>&- <&-", 0),
        ("{} cra --help >&-", 0),
        ("{} batch - --url {url} <&-", 2),
        ("{} cra - <&-", 2),
        ("set -o pipefail; {} trajectory strike.toml --angle 45 --csv | head -n 1", 0),
        ("set -o pipefail; {} sweep strike.toml --axis impact.velocity_m_s=200:300:60 --json | head -n 1", 0),
        ("set -o pipefail; {} sweep strike.toml --axis impact.velocity_m_s=200:300:60 --csv | true", 0),
    ],
)
def test_streams_may_be_closed(folder: Path, live_url: str, line: str, status: int) -> None:
    done = subprocess.run(
        ["bash", "-c", line.format(" ".join(COMMAND), url=live_url)],  # noqa: S607
        cwd=folder,
        env=environment(),
        capture_output=True,
        text=True,
        timeout=LIMIT_S,
        check=False,
    )
    assert done.returncode == status, done.stderr
    for stray in ("Traceback", "Broken pipe", "[Errno", "Exception ignored"):
        assert stray not in done.stderr


def test_settings_unusable_by_numba_are_named_in_one_sentence(folder: Path) -> None:
    (folder / ".numba_config.yaml").write_text("opt: [")
    ended = run_process(folder, "cra", "strike.toml")
    assert (ended.status, ended.out) == (1, "")
    assert ended.err.startswith("ricochet cra: numba cannot be used with the settings found (.numba_config.yaml in")
    assert len(ended.err.splitlines()) == 1

"""`ricochet serve`, `cache` and `version`."""

import os
import pty
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path

import httpx
import pytest

from service import cli
from service.cache.cache import ResultCache
from service.cli.serve import check_proxy
from service.schemas.strike import PAPER_AT_45
from service.settings import Settings
from service.version import VERSION
from tests.cli.commands import COMMAND, LIMIT_S, case_at, environment, run, run_process, write_cases
from tests.conftest import Service, free_port, until
from tests.faults.processes import processor_seconds, workers_of
from tests.service.records import critical_angle, trajectory


def test_version_flag_prints_the_version_of_the_package(tmp_path: Path) -> None:
    done = run(tmp_path, "--version")
    assert (done.status, done.out, done.err) == (0, f"ricochet {VERSION}\n", "")


def test_settings_come_from_the_environment(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    for name, value in {"HOST": "0.0.0.0", "PORT": "9000", "DATA_DIR": str(tmp_path), "WORKERS": "3"}.items():  # noqa: S104
        monkeypatch.setenv(f"RICOCHET_{name}", value)
    settings = Settings()
    assert (settings.host, settings.port, settings.data_dir, settings.workers) == ("0.0.0.0", 9000, tmp_path, 3)  # noqa: S104


def test_default_address_is_reachable_only_from_this_machine(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("HOST", "PORT", "WORKERS"):
        monkeypatch.delenv(f"RICOCHET_{name}", raising=False)
    settings = Settings()
    assert (settings.host, settings.port) == ("127.0.0.1", 8000)
    assert settings.workers >= 1
    assert all(field.description for field in Settings.model_fields.values())


@pytest.mark.parametrize(
    ("host", "proxies", "warned"),
    [("127.0.0.1", (), False), ("192.0.2.1", (), True), ("192.0.2.1", ("192.0.2.9",), False)],
)
def test_service_reachable_by_others_without_a_proxy_warns(
    caplog: pytest.LogCaptureFixture, host: str, proxies: tuple[str, ...], warned: bool
) -> None:
    check_proxy(Settings(host=host, trusted_proxies=proxies))
    assert ("does not limit slow clients" in caplog.text) == warned


@pytest.mark.skipif(sys.platform != "linux", reason="finds processes in /proc")
@pytest.mark.parametrize("stop", [signal.SIGTERM, signal.SIGINT])
def test_running_query_is_answered_before_shutdown(
    dedicated_service: Service, tmp_path: Path, stop: signal.Signals
) -> None:
    url, process = dedicated_service.url, dedicated_service.process
    before = {worker: processor_seconds(worker) for worker in workers_of(tmp_path / "data", process.pid)}
    body = PAPER_AT_45 | {"numerics": {"method": "panels", "panels": 40_000}}
    answers: list[httpx.Response] = []
    asking = threading.Thread(
        target=lambda: answers.append(httpx.post(f"{url}/trajectory", json=body, timeout=30.0, trust_env=False))
    )
    asking.start()
    until(lambda: any(processor_seconds(worker) > seconds + 0.05 for worker, seconds in before.items()))
    process.send_signal(stop)
    assert process.wait(Settings().grace_seconds + 1) == 0
    asking.join()
    assert answers[0].status_code == 200


def test_cache_commands_count_verify_rebuild_and_evict_results(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("RICOCHET_DATA_DIR", str(tmp_path / "data"))
    with ResultCache(tmp_path / "data", memory_bytes=0, disk_bytes=10**9) as cache:
        for record in (*map(trajectory, range(3)), critical_angle(3)):
            cache.put(record)
        assert cli.main(["cache", "stat"]) == 0
        # The results are still in the journal, not in files.
        assert capsys.readouterr().out.startswith("4 results, 0 files, ")
        assert cli.main(["cache", "verify"]) == 1  # The folder is in use.
        assert "in use" in capsys.readouterr().err
    (tmp_path / "data" / "results" / "index.sqlite").unlink()
    assert cli.main(["cache", "rebuild"]) == 0
    assert capsys.readouterr().out.startswith("4 results, 2 files, ")
    segment = next((tmp_path / "data" / "results" / "segments").rglob("*.h5"))
    segment.write_bytes(segment.read_bytes()[:-100])
    assert cli.main(["cache", "verify"]) == 1
    assert f"damaged, set aside: {segment.stem}" in capsys.readouterr().out
    assert cli.main(["cache", "verify"]) == 0
    assert capsys.readouterr().out.startswith(("1 results, 1 files, ", "3 results, 1 files, "))
    assert cli.main(["cache", "evict", "--bytes", "1"]) == 0
    assert capsys.readouterr().out == "0 results, 0 files, 0 bytes\n"


def test_folder_without_results_is_an_error(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("RICOCHET_DATA_DIR", str(tmp_path))
    assert cli.main(["cache", "stat"]) == 1
    assert "there are no results" in capsys.readouterr().err


def test_second_service_on_a_folder_is_refused(tmp_path: Path) -> None:
    with ResultCache(tmp_path / "data", memory_bytes=0, disk_bytes=10**9):
        done = run_process(tmp_path, "serve", RICOCHET_PORT="0", RICOCHET_DATA_DIR="data")
    assert done.status == 3
    assert done.err.splitlines()[-1].startswith("ricochet serve: ")
    assert "in use by another service" in done.err
    assert "Traceback" not in done.err


@pytest.mark.parametrize(
    ("name", "value", "flags", "reason"),
    [
        ("RICOCHET_WORKERS", "none", [], "RICOCHET_WORKERS: must be a whole number, got 'none'"),
        ("RICOCHET_PORT", "9000", ["--port", "none"], "--port: must be a whole number, got 'none'"),
        ("RICOCHET_DATA_DIR", "'~/x'", [], "RICOCHET_DATA_DIR: has quotes around it: '~/x'; leave them out"),
        ("RICOCHET_HOST", '"127.0.0.1"', [], "RICOCHET_HOST: has quotes around it"),
        ("RICOCHET_AUDIT_LOG", '"audit.log"', [], "RICOCHET_AUDIT_LOG: has quotes around it"),
        ("RICOCHET_EXECUTOR", "dask", [], "ricochet serve: RICOCHET_EXECUTOR=dask needs RICOCHET_DASK_SCHEDULER"),
    ],
)
def test_invalid_setting_is_named(
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    name: str,
    value: str,
    flags: list[str],
    reason: str,
) -> None:
    monkeypatch.setenv(name, value)
    assert cli.main(["serve", *flags]) == 2
    assert reason in capsys.readouterr().err


@pytest.mark.parametrize(
    "words", [["keys", "list"], ["batch", "cases.jsonl"], ["batch", "cases.jsonl", "--data-dir", "~/x"]]
)
def test_tilde_in_the_data_folder_is_the_home_directory(folder: Path, words: list[str]) -> None:
    write_cases(folder / "cases.jsonl", case_at(238.0))
    (folder / "home").mkdir()
    done = run(folder, *words, HOME=str(folder / "home"), RICOCHET_DATA_DIR="~/x")
    assert done.status == 0, done.err
    assert not (folder / "~").exists()
    assert (folder / "home" / "x").is_dir() == (words[0] == "batch")


def test_port_in_use_is_reported_in_one_sentence(live_url: str, tmp_path: Path) -> None:
    port = str(httpx.URL(live_url).port)
    done = run(tmp_path, "serve", RICOCHET_HOST="127.0.0.1", RICOCHET_PORT=port, RICOCHET_DATA_DIR="data")
    assert (done.status, done.out) == (3, "")
    assert (
        done.err == f"ricochet serve: port {port} of 127.0.0.1 is in use; choose another with --port or RICOCHET_PORT\n"
    )
    assert not (tmp_path / "data").exists()


def test_flags_of_serve_override_variables_and_a_foreign_address_is_one_sentence(tmp_path: Path) -> None:
    done = run(tmp_path, "serve", "--host", "192.0.2.1", "--port", "9", RICOCHET_HOST="::1", RICOCHET_PORT="70000")
    assert (done.status, done.err.count("\n")) == (3, 1)
    assert done.err.startswith("ricochet serve: cannot listen on port 9 of 192.0.2.1: ")


def test_service_ends_on_sigterm_while_it_compiles(tmp_path: Path) -> None:
    empty = {"NUMBA_CACHE_DIR": str(tmp_path / "compiled"), "XDG_CACHE_HOME": str(tmp_path / "user")}
    settings = {"RICOCHET_PORT": str(free_port()), "RICOCHET_DATA_DIR": "data", "RICOCHET_WORKERS": "1"}
    with subprocess.Popen(
        [*COMMAND, "serve"], cwd=tmp_path, env=environment(**empty, **settings), start_new_session=True
    ) as process:
        try:
            until(lambda: any(tmp_path.glob("compiled/*/*.nbi")))  # Now some functions are compiled, but not all.
            process.send_signal(signal.SIGTERM)
            process.wait(10.0)  # Compiling the others would take far longer.
        finally:
            process.kill()
    assert process.returncode == 0


@pytest.mark.parametrize("seconds", [0.5, 1.0, 2.0, 4.0])
def test_interrupt_while_the_workers_start_prints_no_traceback(seconds: float, tmp_path: Path) -> None:
    """Ctrl-C signals every process of the terminal while the workers are being started.

    Warnings are not errors here, because a process interrupted during an import warns of a file that is still open.
    """
    settings = {"RICOCHET_PORT": "0", "RICOCHET_DATA_DIR": "data", "RICOCHET_WORKERS": "4"}
    with subprocess.Popen(
        [sys.executable, "-m", "service.cli", "serve"],
        cwd=tmp_path,
        env=environment(**settings),
        start_new_session=True,
        stderr=subprocess.PIPE,
        text=True,
    ) as process:
        time.sleep(seconds)
        os.killpg(process.pid, signal.SIGINT)
        _, errors = process.communicate(timeout=60.0)
    assert process.returncode in {0, 130}
    assert "Traceback" not in errors


def test_terminal_shows_the_address_and_readable_log_lines(tmp_path: Path) -> None:
    """The log warns once about the unknown variable RICOCHET_WORKER."""
    port = free_port()
    settings = {"RICOCHET_PORT": str(port), "RICOCHET_DATA_DIR": "data", "RICOCHET_WORKERS": "1", "NO_COLOR": "1"}
    settings["RICOCHET_WORKER"] = "3"
    ours, theirs = pty.openpty()
    with subprocess.Popen(
        [*COMMAND, "serve"], cwd=tmp_path, env=environment(**settings), stdin=theirs, stdout=theirs, stderr=theirs
    ) as process:
        os.close(theirs)
        try:
            shown = read_until(ours, f"on http://127.0.0.1:{port}")
            httpx.get(f"http://127.0.0.1:{port}/livez", trust_env=False)
            shown += read_until(ours, "route=/livez")
            process.send_signal(signal.SIGINT)
            shown += read_until(ours, None)
        finally:
            process.kill()
            os.close(ours)
    named, first, *others = shown.splitlines()
    assert "not settings: RICOCHET_WORKER " in named
    assert "RICOCHET_WORKER " not in "".join(others)
    assert first == f"ricochet {VERSION} on http://127.0.0.1:{port}"
    assert process.returncode == 0, shown
    [line] = [line for line in others if "route=/livez" in line]
    assert "method=GET" in line
    assert "status=200" in line
    assert "{" not in shown
    assert "uvicorn" not in shown.lower()


def read_until(terminal: int, text: str | None) -> str:
    """Return the output on a terminal until it contains this text or the process ends."""
    shown = b""
    deadline = time.monotonic() + LIMIT_S
    while text is None or text.encode() not in shown:
        assert time.monotonic() < deadline, shown
        try:
            shown += os.read(terminal, 65536)
        except OSError:  # The process has ended.
            assert text is None, shown
            break
    return shown.decode()

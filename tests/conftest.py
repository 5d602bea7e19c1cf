"""Fixtures that run a real service, shared by the tests because starting its workers takes time."""

import os
import signal
import socket
import ssl
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TypeAlias

import httpx
import pytest
from hypothesis import HealthCheck, settings

# The matrices of the tests are small, and BLAS threads that wait for work would occupy a core that another test could
# use. The variable is read when numpy is imported, here and in each process that a test starts.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
# A shell lets its background processes ignore SIGINT, and the commands that tests interrupt would inherit that.
signal.signal(signal.SIGINT, signal.default_int_handler)

ROOT = Path(__file__).parents[1]
# The first start on a machine compiles the solver, which takes a minute on idle cores and several beside other tests.
# The service allows its workers the same time.
START_LIMIT_S = 600.0
"""Time limit of the start of a service. [s]"""
STOP_LIMIT_S = 20.0
NO_TLS = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
"""TLS context for clients of plain HTTP; reading the default certificates would take 20 ms for each client."""
settings.register_profile("any machine", deadline=None, suppress_health_check=[HealthCheck.too_slow])
settings.load_profile("any machine")

ROBUSTNESS = (
    "tests/api/test_attacks.py",
    "tests/api/test_liveness.py",
    "tests/api/test_refused_bodies.py",
    "tests/api/test_schemathesis.py",
    "tests/browser/",
    "tests/container/",
    "tests/faults/",
    "tests/physics/test_compiled_code.py",
    "tests/service/test_crashes.py",
    "tests/service/test_dask_faults.py",
    "tests/service/test_faults.py",
    "tests/supply/",
)
"""Tests of faults, attacks, the supply chain, the image, the compiled code and the page in a browser. Few changes
affect them, so `make test-robustness` and CI run them, and `make test` does not."""


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    for item in items:
        if item.nodeid.startswith(ROBUSTNESS):
            item.add_marker(pytest.mark.robustness)


@pytest.fixture(scope="session")
def anyio_backend() -> str:
    return "asyncio"


def free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port: int = probe.getsockname()[1]
    return port


def until(claim: Callable[[], bool]) -> None:
    """Wait until a condition holds; fail after a minute."""
    deadline = time.monotonic() + 60.0
    while not claim():
        assert time.monotonic() < deadline
        time.sleep(0.02)


def wait_until_ready(service: "Service", verify: ssl.SSLContext = NO_TLS) -> None:
    deadline = time.monotonic() + START_LIMIT_S
    with httpx.Client(trust_env=False, verify=verify) as client:
        while time.monotonic() < deadline:
            assert service.process.poll() is None, f"the service ended by itself with {service.process.returncode}"
            try:
                if client.get(f"{service.url}/readyz").is_success:
                    return
            except httpx.TransportError:
                pass  # The service is not listening yet.
            time.sleep(0.05)
    pytest.fail(f"the service was not ready after {START_LIMIT_S} s")


@dataclass(frozen=True)
class Service:
    """A service on a free port."""

    url: str
    process: subprocess.Popen[bytes]


RunService: TypeAlias = Callable[..., AbstractContextManager[Service]]
"""Type of the function that the fixture `service_on` returns."""


@contextmanager
def running_service(folder: Path, verify: ssl.SSLContext = NO_TLS, **settings: str) -> Iterator[Service]:
    """Run a service with the data folder `folder`/data; it must exit with status 0 and log no traceback.

    `verify` is the TLS context for requests to it, needed if `settings` contain a certificate.
    """
    port = free_port()
    names = {"host": "127.0.0.1", "port": str(port), "data_dir": str(folder / "data"), "workers": "2"}
    names |= {"log_level": "warning"} | settings
    environment = os.environ | {f"RICOCHET_{name.upper()}": value for name, value in names.items()}
    command = [sys.executable, "-W", "error", "-m", "service.cli", "serve"]
    with (
        (folder / "log").open("wb") as log,
        subprocess.Popen(command, cwd=ROOT, env=environment, stdout=log, stderr=subprocess.STDOUT) as process,
    ):
        service = Service(f"{'http' if verify is NO_TLS else 'https'}://127.0.0.1:{port}", process)
        try:
            wait_until_ready(service, verify)
            yield service
        finally:
            process.terminate()
            status = process.wait(STOP_LIMIT_S)
    report = (folder / "log").read_text(errors="replace")
    assert status == 0, report
    assert "Traceback" not in report, report


@pytest.fixture(scope="session")
def service_on() -> Callable[..., AbstractContextManager[Service]]:
    """Function that runs a service with given settings."""
    return running_service


@pytest.fixture
def dedicated_service(tmp_path: Path) -> Iterator[Service]:
    """A service for one test, which may stop it."""
    with running_service(tmp_path) as service:
        yield service


@pytest.fixture(scope="session")
def live_url(tmp_path_factory: pytest.TempPathFactory) -> Iterator[str]:
    """Address of the service that the tests share."""
    with running_service(tmp_path_factory.mktemp("service")) as service:
        yield service.url


@pytest.fixture(scope="session")
def hurried_url(tmp_path_factory: pytest.TempPathFactory) -> Iterator[str]:
    """Address of a service that ends queries after 2 s and turns a study of more than 300 samples into a job.

    Queries wait up to 100 s for a worker, so a test that sends few of them at a time never receives 503.
    """
    with running_service(
        tmp_path_factory.mktemp("hurried"), task_seconds="2", small_samples="300", queue_seconds="100"
    ) as service:
        yield service.url


@pytest.fixture(scope="session")
def client(live_url: str) -> Iterator[httpx.Client]:
    with httpx.Client(base_url=live_url, timeout=180.0, trust_env=False) as session:
        yield session

"""Settings of the service, read from environment variables (`RICOCHET_*`). Each limit states its reason."""

import os
from importlib.util import find_spec
from ipaddress import ip_network
from pathlib import Path
from typing import Annotated, Any, Literal, Self, TypeAlias

from pydantic import BeforeValidator, Field, field_validator, model_validator
from pydantic_settings import BaseSettings, NoDecode, SettingsConfigDict

from service.cores import available_cores

LOOPBACK = frozenset({"127.0.0.1", "::1", "localhost"})
"""Addresses that are reachable from this machine only."""
Names: TypeAlias = Annotated[
    tuple[str, ...],
    NoDecode,
    BeforeValidator(lambda text: [name.strip() for name in text.split(",")] if isinstance(text, str) else text),
]
"""Names separated by commas; `NoDecode` keeps pydantic-settings from parsing the text as JSON."""


def missing_package(feature: str, package: str, extra: str) -> str:
    """Return the message for a feature whose package is not installed, with the command that installs it."""
    return (
        f"{feature} needs {package}, which is not installed: install the extra {extra} from the wheel or from the "
        f'repository, pip install -e ".[{extra}]"'
    )


def built_manual() -> Path:
    """Return the folder `build/manual` beside the packages."""
    return Path(__file__).parents[1] / "build" / "manual"


class SettingsGroup(BaseSettings):
    """Base class of the groups of settings. The docstring of a setting is also its description in the manual."""

    model_config = SettingsConfigDict(use_attribute_docstrings=True)


class ServerSettings(SettingsGroup):
    """Address, TLS, logging and shutdown of the server."""

    host: str = "127.0.0.1"
    """Address to listen on. The default is reachable from this machine only."""
    port: Annotated[int, Field(ge=0, le=65535)] = 8000
    """Port to listen on. 0 selects a free port."""
    tls_certificate: Path | None = None
    """File with the certificate for HTTPS (PEM, with its chain). Requires `RICOCHET_TLS_KEY`."""
    tls_key: Path | None = None
    """File with the private key of the certificate (PEM). Requires `RICOCHET_TLS_CERTIFICATE`."""
    trusted_proxies: Names = ()
    """Addresses or networks of proxies, such as `127.0.0.1,10.0.0.0/8`, whose `X-Forwarded-For` and `X-Forwarded-Proto`
    headers are trusted. The headers of other senders are ignored, since any client can forge them."""
    root_path: Annotated[str, Field(pattern=r"^(/[A-Za-z0-9._~-]+)*$")] = ""
    """Path prefix, such as `/ricochet`, under which a proxy publishes the service. The proxy strips it from the
    requests that it forwards."""
    data_dir: Path = Path("data")
    """Folder of results and jobs. It is created if it is missing."""
    manual_dir: Annotated[Path, Field(default_factory=built_manual)]
    """Folder of the manual, served at `/manual`. `make docs` builds it in a copy of the repository; a wheel has no
    manual."""
    gzip: bool = True
    """Compress responses of 1 kB and more with gzip for clients that accept it, except event streams and formats that
    are already compressed, such as HDF5 and Parquet."""
    log_level: Literal["debug", "info", "warning", "error"] = "info"
    """Lowest severity that is logged. `warning` omits the line for each request."""
    telemetry: bool = False
    """Send a trace of each request to the collector at `OTEL_EXPORTER_OTLP_ENDPOINT`. Requires the extra
    `telemetry`."""
    # At least the two phases of a shutdown: REFUSAL_SECONDS and STOP_SECONDS of service/api/app.py.
    grace_seconds: Annotated[int, Field(ge=3)] = 8
    """Longest time from SIGTERM to the end of the service, shorter than the 10 s after which container managers kill a
    process. [s]"""

    @property
    def on_loopback(self) -> bool:
        """True if the service is reachable from this machine only."""
        return self.host in LOOPBACK

    @field_validator("trusted_proxies")
    @classmethod
    def check_proxies(cls, proxies: tuple[str, ...]) -> tuple[str, ...]:
        """Check that each proxy is an address or a network."""
        for proxy in proxies:
            try:
                ip_network(proxy)
            except ValueError as error:
                raise ValueError(f"{proxy!r} is not an address or a network: {error}") from None
        return proxies

    @model_validator(mode="after")
    def check_tls(self) -> Self:
        """Check that the certificate and the key are set together."""
        if (self.tls_certificate is None) != (self.tls_key is None):
            raise ValueError("tls_certificate and tls_key go together: set both or none")
        return self


class AccessSettings(SettingsGroup):
    """Authentication, accepted hosts and origins, and the audit log."""

    access: Literal["auto", "keys", "open"] = "auto"
    """Clients that are served: with `keys`, clients with an API key; with `open`, everybody who can connect; with
    `auto`, everybody on this machine until a key exists, and from then on clients with a key."""
    allowed_hosts: Names = ()
    """Accepted names in the `Host` header, separated by commas. If the list is empty, every name is accepted where keys
    are required; otherwise only `localhost`, `127.0.0.1` and `[::1]` are, because another site could point its own host
    name at this machine (DNS rebinding)."""
    cors_origins: Names = ()
    """Other origins whose pages may send requests from a browser, such as `https://a.example`, separated by commas."""
    metrics_open: bool = False
    """Serve `/metrics` without a key. The metrics are totals, sizes and times, and reveal nothing about single
    cases."""
    audit_log: Path | None = None
    """File of the audit log, reopened after log rotation has moved it. Without a file the entries go to standard
    error."""


class LimitSettings(SettingsGroup):
    """Limits on request bodies, waiting queries and open event streams."""

    max_body_bytes: Annotated[int, Field(ge=1024)] = 128 * 1024
    """Largest request body. [bytes] A profile of 1,000 points with all its digits takes 50 kB. Listing the errors of a
    body of 1 MiB would block other requests for half a second."""
    max_batch_bytes: Annotated[int, Field(ge=1024)] = 2 * 1024 * 1024
    """Largest JSON body of a batch or a sweep. [bytes] A thousand cases take some 400 kB; parsing 2 MiB blocks other
    requests for some 20 ms."""
    max_jsonl_bytes: Annotated[int, Field(ge=1024)] = 200 * 1024 * 1024
    """Largest JSONL body, which is read as a stream. [bytes] It holds 100,000 cases of 2 kB, five times the usual
    length."""
    # The bound of 190 is below the depth that the parser refuses, so that the error names this setting.
    max_body_depth: Annotated[int, Field(ge=10, le=190)] = 20
    """Deepest nesting of objects and lists in a body. [1] The deepest request has 7 levels; the parser accepts some
    200."""
    max_panel_steps: Annotated[float, Field(gt=0.0)] = 5e9
    """Largest product of panels and time steps of one run of the paper's method, up to its termination time. [1]
    96,000 panels with steps of 1 µs over the usual 0.05 s make 4.8e9, some 100 s of work."""
    max_streams: Annotated[int, Field(ge=1)] = 200
    """Largest number of open event streams. [1] Each one is woken at every change of its job, so the limit bounds the
    work of a change; 200 is an arbitrary choice, ten owners with 20 streams each."""
    max_owner_streams: Annotated[int, Field(ge=1)] = 20
    """Largest number of open event streams of one owner. [1] It is more than a browser opens, and leaves room for ten
    owners."""
    max_owner_queries: Annotated[int, Field(ge=1)] = 100
    """Largest number of single queries of one owner that wait or run, where keys are required. [1] They amount to half
    a second to a few seconds of work."""
    max_waiting_queries: Annotated[int, Field(ge=1)] = 1000
    """Largest number of single queries that wait for a worker. [1] At 10 ms each they keep one worker busy for 10 s.
    When the queue is full, the newest query of the owner with the most waiting queries is evicted in favour of an owner
    with fewer."""
    queue_seconds: Annotated[float, Field(gt=0.0)] = 30.0
    """Longest time that a single query waits for a worker, shorter than the 60 s after which proxies give up. [s]"""


class CacheSettings(SettingsGroup):
    """Sizes of the caches of results in memory and on disk."""

    memory_cache_bytes: Annotated[int, Field(ge=0)] = 128 * 1024 * 1024
    """Memory for the most recent results: some 1,300 with a history, tens of thousands without. [bytes]"""
    cache_bytes: Annotated[int, Field(ge=0)] = 10 * 1024**3
    """Disk space for results, a tenth of it for downloads of whole jobs. [bytes] The least recently used results are
    evicted first. 10 GiB hold ten million critical angles or a hundred thousand histories."""


class JobSettings(SettingsGroup):
    """Size above which work becomes a job, and limits on waiting and finished jobs."""

    # The bound of 1,000 is the largest batch that the contract accepts as JSON.
    small_cases: Annotated[int, Field(ge=0, le=1000)] = 100
    """Largest number of cases that are answered in the response; a larger batch becomes a job. [1] A hundred cases
    take about a second. A search for perforation counts as 20."""
    small_samples: Annotated[int, Field(ge=0, le=16_384)] = 16_384
    """Largest number of samples of a study of uncertainty, or of all studies of a sweep or batch, that is answered in
    the response; a larger request becomes a job. [1] Sixteen thousand samples take about a minute."""
    max_queued_cases: Annotated[int, Field(ge=1)] = 2_000_000
    """Largest number of cases that wait in all jobs. [1] The cases of one owner may fill half of the space that other
    owners leave. On an idle service that is a million cases: ten of the largest batches, hours of work."""
    job_days: Annotated[float, Field(gt=0.0)] = 7.0
    """Time for which a job is kept after its end. A week includes five working days. [days]"""
    owner_jobs_bytes: Annotated[int, Field(ge=1)] = 1024**3
    """Disk space for the jobs of one owner without their results, enough for ten million usual cases. [bytes] The jobs
    that ended first are removed to make room for a new one."""
    most_wait_seconds: Annotated[float, Field(ge=0.0)] = 30.0
    """Longest wait that a client can request with `Prefer: wait`, shorter than the 60 s after which proxies give up.
    [s]"""


class ExecutorSettings(SettingsGroup):
    """Workers that compute cases, and their time limits."""

    executor: Literal["pool", "dask", "in-process"] = "pool"
    """Executor of batches: worker processes (`pool`), a Dask cluster (`dask`) or, for use with a debugger, a thread of
    the service (`in-process`). With the first two, worker processes compute single queries."""
    # The bound of 1,024 only catches typing errors: few machines have more cores, and a process takes 100 MB.
    workers: Annotated[int, Field(default_factory=available_cores, ge=1, le=1024)]
    """Number of worker processes. [1] One per core, since a worker computes without waiting."""
    dask_scheduler: Annotated[str, Field(pattern=r"^((tcp|tls|ws|wss)://.+)?$")] = ""
    """Address of the Dask scheduler, such as `tcp://host:8786`. Required with `RICOCHET_EXECUTOR=dask`, and otherwise
    unused."""
    task_seconds: Annotated[float, Field(gt=0.0)] = 60.0
    """Longest time that a single query may run. [s] The paper's case takes well under a second; the largest query
    within the other limits would take minutes."""
    study_seconds: Annotated[float, Field(gt=0.0)] = 300.0
    """Longest time for a study of uncertainty that is answered in the response, five times as long as the largest one
    takes on two cores. [s] A verdict and a report, which contain a study, may take twice as long. A job has no such
    limit; each of its cases is limited by `RICOCHET_TASK_SECONDS`."""
    probe_seconds: Annotated[float, Field(gt=0.0)] = 2.0
    """Longest time that the readiness probe waits for a worker. [s] The probe is served before waiting queries, but
    cannot interrupt a running query."""

    @model_validator(mode="after")
    def _check_dask(self) -> Self:
        if self.executor == "dask" and not self.dask_scheduler:
            raise ValueError("RICOCHET_EXECUTOR=dask needs RICOCHET_DASK_SCHEDULER, such as tcp://scheduler:8786")
        if self.executor == "dask" and find_spec("distributed") is None:
            raise ValueError(missing_package("RICOCHET_EXECUTOR=dask", "distributed", "dask"))
        return self


OTHER_VARIABLES = frozenset({"RICOCHET_URL", "RICOCHET_API_KEY"})
"""Environment variables that the command line reads as a client of a service."""


def unknown_variables() -> list[str]:
    """Return the environment variables that have the prefix of settings but name no setting, and so may be misspelt."""
    known = {f"RICOCHET_{name.upper()}" for name in Settings.model_fields} | OTHER_VARIABLES
    return sorted(name for name in os.environ if name.upper().startswith("RICOCHET_") and name.upper() not in known)


GROUPS: dict[str, type[SettingsGroup]] = {
    "server": ServerSettings,
    "access": AccessSettings,
    "limit": LimitSettings,
    "cache": CacheSettings,
    "job": JobSettings,
    "executor": ExecutorSettings,
}
"""Groups of settings, keyed by their headings in docs/operating.md."""


class Settings(ServerSettings, AccessSettings, LimitSettings, CacheSettings, JobSettings, ExecutorSettings):
    """All settings. `RICOCHET_PORT=9000` sets `port`."""

    model_config = SettingsConfigDict(env_prefix="RICOCHET_", frozen=True)

    @field_validator("*", mode="before")
    @classmethod
    def check_text(cls, value: Any) -> Any:
        """Refuse quotes around a value and expand `~` in a path.

        Programs that read a file of variables without a shell, such as `docker --env-file`, leave quotes in a value.
        """
        text = str(value) if isinstance(value, Path) else value
        if isinstance(text, str) and len(text) > 1 and text[0] == text[-1] and text[0] in "\"'":
            raise ValueError(f"has quotes around it: {text}; leave them out")
        return Path(text).expanduser() if isinstance(text, str) and text.startswith("~") else value

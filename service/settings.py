"""Settings of the service, from the environment (`RICOCHET_*`); each limit with its reason."""

import os
from importlib.util import find_spec
from ipaddress import ip_network
from pathlib import Path
from typing import Annotated, Any, Literal, Self, TypeAlias

from pydantic import BeforeValidator, Field, field_validator, model_validator
from pydantic_settings import BaseSettings, NoDecode, SettingsConfigDict

from service.cores import available_cores

LOOPBACK = frozenset({"127.0.0.1", "::1", "localhost"})
"""Addresses that only this machine reaches."""
Names: TypeAlias = Annotated[
    tuple[str, ...],
    NoDecode,
    BeforeValidator(lambda text: [name.strip() for name in text.split(",")] if isinstance(text, str) else text),
]
"""Separated by commas."""


def missing_package(feature: str, package: str, extra: str) -> str:
    """Return what to do about a feature whose package is not installed."""
    return (
        f"{feature} needs {package}, which is not installed: install the extra {extra} from the wheel or from the "
        f'repository, pip install -e ".[{extra}]"'
    )


def built_manual() -> Path:
    """`build/manual` beside the packages."""
    return Path(__file__).parents[1] / "build" / "manual"


class SettingsGroup(BaseSettings):
    """Base of the groups. The docstring of a setting is its description, in docs/operating.md too."""

    model_config = SettingsConfigDict(use_attribute_docstrings=True)


class ServerSettings(SettingsGroup):
    """Where the service listens, what it logs, and how it ends."""

    host: str = "127.0.0.1"
    """Address to listen on; by default this machine only."""
    port: Annotated[int, Field(ge=0, le=65535)] = 8000
    """Port to listen on; 0 takes a free one."""
    tls_certificate: Path | None = None
    """Certificate (PEM, with its chain) for HTTPS; takes a `tls_key`."""
    tls_key: Path | None = None
    """Private key of the certificate (PEM)."""
    trusted_proxies: Names = ()
    """Addresses or networks of proxies, such as `127.0.0.1,10.0.0.0/8`, whose `X-Forwarded-For` and `X-Forwarded-Proto`
    are believed, and nobody else's: any client could name another address."""
    root_path: Annotated[str, Field(pattern=r"^(/[A-Za-z0-9._~-]+)*$")] = ""
    """Path, such as `/ricochet`, below which a proxy serves the service and which it takes off the requests it passes
    on."""
    data_dir: Path = Path("data")
    """Folder of results and jobs; made if it is missing."""
    manual_dir: Annotated[Path, Field(default_factory=built_manual)]
    """Folder of the manual that `make docs` builds in a copy of the repository, served at `/manual`; a wheel has
    none."""
    gzip: bool = True
    """Whether answers of 1 kB and more are compressed with gzip for clients that accept it; streams of events
    never are."""
    log_level: Literal["debug", "info", "warning", "error"] = "info"
    """Least weight of what is logged; `warning` leaves out the line for each request."""
    telemetry: bool = False
    """Whether a trace of each request goes to the collector that `OTEL_EXPORTER_OTLP_ENDPOINT` names; needs the extra
    `telemetry`."""
    grace_seconds: Annotated[int, Field(ge=3)] = 8
    """Longest that the service takes to end after SIGTERM: less than the 10 s after which container managers kill."""

    @property
    def on_loopback(self) -> bool:
        """Whether only this machine reaches the service."""
        return self.host in LOOPBACK

    @field_validator("trusted_proxies")
    @classmethod
    def check_proxies(cls, proxies: tuple[str, ...]) -> tuple[str, ...]:
        """Check that each is an address or a network."""
        for proxy in proxies:
            try:
                ip_network(proxy)
            except ValueError as error:
                raise ValueError(f"{proxy!r} is no address or network: {error}") from None
        return proxies

    @model_validator(mode="after")
    def check_tls(self) -> Self:
        """Check that both files of TLS are named, or none."""
        if (self.tls_certificate is None) != (self.tls_key is None):
            raise ValueError("tls_certificate and tls_key go together: set both or none")
        return self


class AccessSettings(SettingsGroup):
    """Who is answered, and what is recorded of it."""

    access: Literal["auto", "keys", "open"] = "auto"
    """Who is answered: `keys` those with a key, `open` everybody who reaches the service, `auto` those with a key once
    there is one, before that everybody on this machine."""
    allowed_hosts: Names = ()
    """Names in the `Host` header that are answered, with commas between them. If none is set, any where keys are
    required, else `localhost`, `127.0.0.1` and `[::1]`: a page elsewhere could have its own name point here."""
    cors_origins: Names = ()
    """Other origins whose pages may send requests from a browser, such as `https://a.example`, with commas between
    them."""
    metrics_open: bool = False
    """Whether `/metrics` is open without a key: it holds counts, no case."""
    audit_log: Path | None = None
    """File of the audit log, opened anew once it has been moved away; standard error if none is set."""


class LimitSettings(SettingsGroup):
    """Bounds on what one client can send or hold."""

    max_body_bytes: Annotated[int, Field(ge=1024)] = 128 * 1024
    """Largest request body: a profile of 1,000 points with all its digits takes 50 kB; listing all that is wrong with 1
    MiB would hold up other requests for half a second."""
    max_batch_bytes: Annotated[int, Field(ge=1024)] = 2 * 1024 * 1024
    """Largest JSON body of a batch or a sweep: a thousand cases take some 400 kB, and parsing 2 MiB holds up all else
    for some 20 ms."""
    max_jsonl_bytes: Annotated[int, Field(ge=1024)] = 200 * 1024 * 1024
    """Largest JSONL body, read as a stream: 100,000 cases of 2 kB each, five times the usual."""
    max_body_depth: Annotated[int, Field(ge=10, le=190)] = 20
    """Objects and lists in one another in a body: the deepest request has 7, the parser takes some 200."""
    max_panel_steps: Annotated[float, Field(gt=0.0)] = 5e9
    """Panels times time steps of one run of the paper's method, up to its termination time. [1] 96,000 panels with
    steps of 1 µs over the usual 0.05 s are 4.8e9, some 100 s of work."""
    max_streams: Annotated[int, Field(ge=1)] = 200
    """Event streams open at once: each wakes up with every change of its job."""
    max_owner_streams: Annotated[int, Field(ge=1)] = 20
    """Event streams of one owner, where no key is required of one address: more than a browser opens, and ten owners
    still find room."""
    max_owner_queries: Annotated[int, Field(ge=1)] = 100
    """Single queries of one owner that may wait for a worker or run, where keys are required: half a second to some
    seconds of work."""
    max_waiting_queries: Annotated[int, Field(ge=1)] = 1000
    """Single queries that may wait for a worker: at 10 ms each, some seconds of work. Beyond, the last of the owner
    with most waiting gives way to an owner with fewer."""
    queue_seconds: Annotated[float, Field(gt=0.0)] = 30.0
    """Longest that a single query waits for a worker: less than the 60 s after which proxies give up."""


class CacheSettings(SettingsGroup):
    """How much is kept of results."""

    memory_cache_bytes: Annotated[int, Field(ge=0)] = 128 * 1024 * 1024
    """Memory for the latest results: some 1,300 with a history, tens of thousands without."""
    cache_bytes: Annotated[int, Field(ge=0)] = 10 * 1024**3
    """Disk for results, a tenth of it for downloads of whole jobs; those used longest ago go first. Ten million
    critical angles or a hundred thousand histories."""


class JobSettings(SettingsGroup):
    """What becomes a job, and how long jobs wait and are kept."""

    small_cases: Annotated[int, Field(ge=0, le=1000)] = 100
    """Up to so many cases are answered at once, more become a job: a hundred take about a second. A search for
    perforation counts as 20."""
    small_samples: Annotated[int, Field(ge=0, le=16_384)] = 16_384
    """Up to so many samples a study of uncertainty is answered at once, with more it becomes a job: sixteen thousand
    take about a minute."""
    max_queued_cases: Annotated[int, Field(ge=1)] = 2_000_000
    """Cases that may wait in all jobs, an owner's up to half of what the others leave: ten of the largest batches of
    one owner, some hours of work."""
    job_days: Annotated[float, Field(gt=0.0)] = 7.0
    """How long a job is kept after its end: over a weekend and some days more."""
    owner_jobs_bytes: Annotated[int, Field(ge=1)] = 1024**3
    """Disk for the jobs of one owner, their results aside: ten million usual cases. Those that ended first make room
    for a new one."""
    most_wait_seconds: Annotated[float, Field(ge=0.0)] = 30.0
    """Longest that `Prefer: wait` is obeyed: less than the 60 s after which proxies give up."""


class ExecutorSettings(SettingsGroup):
    """Where cases are computed, and for how long."""

    executor: Literal["pool", "dask", "in-process"] = "pool"
    """Where batches are computed: in the worker processes, on a Dask cluster or, for a debugger, in a thread of the
    service. Single queries go to the worker processes in the first two."""
    workers: Annotated[int, Field(default_factory=available_cores, ge=1, le=1024)]
    """Worker processes: one a core."""
    dask_scheduler: Annotated[str, Field(pattern=r"^((tcp|tls|ws|wss)://.+)?$")] = ""
    """Address of the Dask scheduler: tcp://host:8786."""
    task_seconds: Annotated[float, Field(gt=0.0)] = 60.0
    """Longest a single query may run: the paper's case takes well under a second, the largest that the other limits let
    through takes minutes."""
    study_seconds: Annotated[float, Field(gt=0.0)] = 300.0
    """Longest that a study of uncertainty may take that is answered at once; a verdict and a report, which have one in
    them, twice as long. Five times what the largest takes on two cores. A job has no such limit, its cases have
    `task_seconds`."""
    probe_seconds: Annotated[float, Field(gt=0.0)] = 2.0
    """How long the readiness probe waits for a worker. It overtakes waiting queries, not running ones."""

    @model_validator(mode="after")
    def _dask_is_there(self) -> Self:
        if self.executor == "dask" and not self.dask_scheduler:
            raise ValueError("RICOCHET_EXECUTOR=dask needs RICOCHET_DASK_SCHEDULER, such as tcp://scheduler:8786")
        if self.executor == "dask" and find_spec("distributed") is None:
            raise ValueError(missing_package("RICOCHET_EXECUTOR=dask", "distributed", "dask"))
        return self


OTHER_VARIABLES = frozenset({"RICOCHET_URL", "RICOCHET_API_KEY"})
"""Variables of the command as a client of a service."""


def unknown_variables() -> list[str]:
    """Return the variables of the environment that are named as settings are, and are not one: they may be misspelt."""
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
"""Groups of settings, by the headings of docs/operating.md."""


class Settings(ServerSettings, AccessSettings, LimitSettings, CacheSettings, JobSettings, ExecutorSettings):
    """What can be set. `RICOCHET_PORT=9000` sets `port`."""

    model_config = SettingsConfigDict(env_prefix="RICOCHET_", frozen=True)

    @field_validator("*", mode="before")
    @classmethod
    def check_text(cls, value: Any) -> Any:
        """Refuse quotes around a value, as from a file of variables that no shell has read; expand ~ in a path."""
        text = str(value) if isinstance(value, Path) else value
        if isinstance(text, str) and len(text) > 1 and text[0] == text[-1] and text[0] in "\"'":
            raise ValueError(f"has quotes around it: {text}; leave them out")
        return Path(text).expanduser() if isinstance(text, str) and text.startswith("~") else value

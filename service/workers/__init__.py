"""The interface of executors: what the service computes with."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Protocol, TypeAlias, TypeVar, TypeVarTuple

Arguments = TypeVarTuple("Arguments")
Result = TypeVar("Result")
Call: TypeAlias = tuple[Callable[..., Any], tuple[Any, ...]]
"""A picklable function and its arguments."""


@dataclass(frozen=True, slots=True)
class CallResult:
    """Outcome of a call.

    Parameters
    ----------
    value
        What it returned; None if it did not.
    error
        What it raised, or why the executor could not finish it; None if it returned.
    seconds
        Time it took in the worker.
    """

    value: Any
    error: Exception | None
    seconds: float


class Executor(Protocol):
    """Runs calls elsewhere. `tests/service/test_executor_contract.py` holds every executor to this."""

    @property
    def worker_pids(self) -> list[int]:
        """Process ids of the workers on this machine that are up."""

    @property
    def restarts(self) -> int:
        """Workers on this machine that had to be replaced."""

    @property
    def queued(self) -> int:
        """Calls submitted singly, probes among them, that wait for a worker."""

    @property
    def capacity(self) -> int:
        """Chunks that can run at the same time, now; it may change as workers come and go."""

    @property
    def on_cluster(self) -> bool:
        """Whether chunks run on a cluster now, rather than in the pool of this machine."""

    @property
    def single_capacity(self) -> int:
        """Calls submitted singly that can run at the same time."""

    @property
    def prefetch(self) -> int:
        """Chunks beyond these that should wait with it, so that no worker has to wait for its next one."""

    @property
    def last_error(self) -> str:
        """Why the last probe failed."""

    @property
    def busy(self) -> bool:
        """Whether the last probe failed only because all workers were at work."""

    async def start(self) -> None:
        """Bring the workers up, warm.

        Raises
        ------
        PoolUnavailableError
            If there can be none.
        """

    async def submit(self, function: Callable[[*Arguments], Result], *arguments: *Arguments) -> Result:
        """Run a picklable function and return what it returns, or raise what it raises.

        Cancelled while it waits for a worker, it never runs; once running, it ends or its worker is ended within 0.5 s,
        where it has a process for itself.

        Raises
        ------
        WorkerCrashedError, TaskTimeoutError, PoolUnavailableError
            If it could not be brought to an end.
        """

    async def run(self, calls: Sequence[Call]) -> list[CallResult]:
        """Run a chunk of calls one after the other, behind what is submitted singly.

        A call that fails, takes too long or ends one worker after another says so in its place; the others are run
        all the same. Cancelled while it waits, it never runs; once running, the calls after the one it is on do not
        run.

        Raises
        ------
        PoolUnavailableError
            If no worker can take it, or the executor is stopping.
        """

    async def probe(self, seconds: float) -> bool:
        """Return whether a worker answers within this time; overtakes all that waits, and chunks between two calls."""

    async def stop(self, grace: float) -> None:
        """Take no more work, let what there is finish, and give up the rest at the end of the grace time. [s]"""

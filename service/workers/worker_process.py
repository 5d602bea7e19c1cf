"""Handle of a worker process in the service, and the task that sends the process work from the queue."""

import asyncio
import os
import pickle
import signal
import socket
from collections import deque
from collections.abc import Callable, Sequence
from contextlib import suppress
from pathlib import Path

from service.errors import PoolUnavailableError, TaskTimeoutError, WorkerCrashedError
from service.workers import Call, CallResult
from service.workers.executor import dumps, loads
from service.workers.template import LIMIT_HINT, template
from service.workers.work_queue import Accepts, Kind, Work, WorkQueue
from service.workers.worker import BEGUN, LENGTH, NUMBER, STOP, VERSIONS, Hello

START_SECONDS = 600.0
"""Timeout for the start of a worker [s]. A start takes seconds, but the first one of an installation compiles the
solver, which takes about a minute on two quiet cores and longer on a busy machine."""
CANCEL_SECONDS = 0.3
"""Time allowed for a call to stop before its worker is killed [s]. The compiled code of most calls returns to Python
within milliseconds. Including the kill, a cancelled call ends within the 0.5 s that `Executor.submit` promises."""
DEATHS = 2
"""Number of workers that a call may kill before it fails. The first may have died for another reason, such as a lack of
memory on the machine."""
IDLE_CHECK_SECONDS = 1.0
"""Interval between checks of an idle worker, so that a dead one is replaced before it is needed. [s]"""
LARGE_BYTES = 1 << 18
"""Size above which a reply is unpickled in a thread [bytes]. Unpickling a history of 4 MB takes 3 ms."""
RETRY_SECONDS, LONGEST_RETRY_SECONDS = 0.2, 5.0
"""First and longest backoff between attempts to start a worker, doubled each time [s]. Chosen by judgement: a lack of
processes may pass within a second, and longer delays would needlessly leave a service without workers."""

SCRATCH_BYTES = 1 << 16
"""Largest message, including its header, that is read into the shared buffer [bytes]. A longer one gets a buffer of its
own, so that megabytes of a history are not copied. Messages without a history are some kilobytes."""


class WorkerDiedError(Exception):
    """The worker died or was killed."""


class Messages(asyncio.BufferedProtocol):
    """Protocol that splits the bytes of a socket into messages."""

    def __init__(self) -> None:
        self.closed = False
        self._arrived: deque[bytes | bytearray] = deque()
        self._scratch, self._held = bytearray(SCRATCH_BYTES), 0
        """Buffer of small messages, and number of bytes of incomplete messages in it."""
        self._body: bytearray | None = None
        """Buffer of a large message that is being read; None between large messages."""
        self._filled = 0
        self._waiting: asyncio.Future[None] | None = None

    async def next(self) -> bytes | bytearray:
        """Wait for the next message.

        Raises
        ------
        WorkerDiedError
            If the other end is closed.
        """
        while not self._arrived:
            if self.closed:
                raise WorkerDiedError
            self._waiting = asyncio.get_running_loop().create_future()
            await self._waiting
        return self._arrived.popleft()

    def get_buffer(self, sizehint: int) -> memoryview:
        """Return the buffer for the next bytes."""
        if self._body is not None:
            return memoryview(self._body)[self._filled :]
        return memoryview(self._scratch)[self._held :]

    def buffer_updated(self, nbytes: int) -> None:
        """Take the complete messages out of the buffers."""
        if self._body is not None:
            self._filled += nbytes
            if self._filled == len(self._body):
                self._arrived.append(self._body)
                self._body = None
        else:
            self._held += nbytes
            self._take_small()
        if self._arrived:
            self._wake()

    def _take_small(self) -> None:
        begin = 0
        while self._held - begin >= LENGTH.size:
            (length,) = LENGTH.unpack_from(self._scratch, begin)
            end = begin + LENGTH.size + length
            if end > self._held:
                if LENGTH.size + length > SCRATCH_BYTES:
                    self._filled = self._held - begin - LENGTH.size
                    self._body = bytearray(length)
                    self._body[: self._filled] = self._scratch[begin + LENGTH.size : self._held]
                    begin = self._held
                break
            self._arrived.append(bytes(memoryview(self._scratch)[begin + LENGTH.size : end]))
            begin = end
        self._scratch[: self._held - begin] = self._scratch[begin : self._held]
        self._held -= begin

    def connection_lost(self, exc: Exception | None) -> None:
        """Record that the other end is closed."""
        self.closed = True
        self._wake()

    def _wake(self) -> None:
        if self._waiting is not None and not self._waiting.done():
            self._waiting.set_result(None)


class WorkerProcess:
    """A worker process, which runs `service.workers.worker.serve`, and the socket to it.

    An executor of `concurrent.futures` is no substitute: it hangs, and keeps the interpreter from ending, if a worker
    dies while it sends a result that does not fit into a pipe. Here only the worker holds the other end of the socket,
    which is therefore closed whenever the worker dies.
    """

    def __init__(self) -> None:
        self.yielding = False
        """True from sending `STOP` until the worker acknowledges it."""
        self.begun = False
        """True once the worker has begun to read the latest calls."""
        self._number = 0
        """Number of the list of calls that was sent last."""
        self.pid = 0
        """Process id; 0 before `start` and after `close`."""
        self._lifeline = -1
        self._killing: asyncio.TimerHandle | None = None
        self._messages = Messages()
        self._transport: asyncio.Transport | None = None

    async def start(self) -> None:
        """Start the process, and wait until it is ready for calls.

        Raises
        ------
        PoolUnavailableError
            If the process cannot be started.
        """
        ours = self._fork()
        try:
            self._transport, _ = await asyncio.get_running_loop().create_connection(lambda: self._messages, sock=ours)
            async with asyncio.timeout(START_SECONDS):
                hello: Hello = pickle.loads(await self._messages.next())  # noqa: S301 (from our own worker)
        except (WorkerDiedError, TimeoutError):
            self.close()
            raise PoolUnavailableError("a worker process did not start; its messages are on standard error") from None
        except BaseException:
            self.close()
            raise
        self.pid = hello.pid
        if hello.error or hello.versions != VERSIONS:
            self.close()
            changed = "ricochet was changed on the disk while it runs: restart the service"
            raise PoolUnavailableError(hello.error or changed)

    @property
    def alive(self) -> bool:
        """True until the worker's end of the socket is closed. A process stopped by a signal counts as alive."""
        return not self._messages.closed

    @property
    def stopped(self) -> bool:
        """True if a signal or a debugger has stopped the process. Without /proc this is unknown, and so False."""
        with suppress(OSError):
            return Path(f"/proc/{self.pid}/stat").read_text().rpartition(")")[2].split()[0] in {"T", "t"}
        return False

    def send(self, calls: Sequence[Call]) -> None:
        """Send a list of calls to the worker, which replies to each call in turn."""
        self.begun = False
        self._number += 1
        self._write(pickle.dumps((self._number, [dumps(call) for call in calls])))

    async def receive(self) -> memoryview | None:
        """Wait for the reply to the next call, which `loads` unpickles; None if the worker has skipped the rest.

        Raises
        ------
        WorkerDiedError
            If the worker has died.
        """
        while (message := await self._messages.next()) != STOP:
            if message == BEGUN:
                self.begun = True
            elif NUMBER.unpack_from(message) == (self._number,):
                return memoryview(message)[NUMBER.size :]
        self.yielding = False
        if self._killing is not None:
            self._killing.cancel()
            self._killing = None
        return None

    def make_way(self) -> None:
        """Ask the worker to skip the calls that it has not begun."""
        if not self.yielding:
            self.yielding = True
            self._write(STOP)

    def stop_call(self) -> None:
        """Ask the worker to stop the running call as well, and kill it after `CANCEL_SECONDS` if it does not."""
        self.make_way()
        if self._killing is None:
            self._signal(signal.SIGUSR1)
            self._killing = asyncio.get_running_loop().call_later(CANCEL_SECONDS, self.kill)

    def kill(self) -> None:
        """Send SIGKILL to the process, without waiting for its end."""
        self._signal(signal.SIGKILL)

    def close(self) -> None:
        """Kill the process, and close its socket and pipe."""
        self.kill()
        self.pid, self._messages.closed = 0, True
        if self._killing is not None:
            self._killing.cancel()
        if self._transport is not None:
            self._transport.abort()
        with suppress(OSError):
            os.close(self._lifeline)
        self._lifeline = -1

    def _fork(self) -> socket.socket:
        """Have the template process fork the worker, and return this end of the socket."""
        ours, theirs = socket.socketpair()
        watched, self._lifeline = os.pipe()
        try:
            template.fork([theirs.fileno(), watched])
        except OSError as error:
            ours.close()
            os.close(self._lifeline)
            hint = f"; {LIMIT_HINT}" if isinstance(error, BlockingIOError) else ""
            raise PoolUnavailableError(f"no worker process could be started: {error}{hint}") from error
        finally:
            theirs.close()  # Only the worker then holds this end, so that its death closes the stream.
            os.close(watched)
        return ours

    def _signal(self, number: signal.Signals) -> None:
        # A dead worker has been reaped, and its process id may belong to another process by now.
        if self.pid and not self._messages.closed:
            with suppress(ProcessLookupError):
                os.kill(self.pid, number)

    def _write(self, message: bytes) -> None:
        if self._transport is not None and not self._transport.is_closing():
            self._transport.write(LENGTH.pack(len(message)) + message)


class WorkerServer:
    """Takes work from the queue and has its worker process run it.

    Parameters
    ----------
    queue
        Queue that the servers of a pool share.
    accepts
        Function that returns True for the work that the pool takes.
    task_seconds
        Timeout of a call, in wall time. [s]
    on_start
        Function called after each attempt to start a worker, with the error message, or an empty string on success.
    """

    def __init__(
        self, queue: WorkQueue, accepts: Accepts, task_seconds: float, on_start: Callable[[str], None]
    ) -> None:
        self.worker: WorkerProcess | None = None
        self.starts = 0
        """Number of workers started so far, the first one included."""
        self._queue = queue
        self._accepts = accepts
        self._task_seconds = task_seconds
        self._on_start = on_start

    async def start_worker(self) -> None:
        """Start a worker, and wait until it is ready for calls.

        Raises
        ------
        PoolUnavailableError
            If the worker cannot be started.
        """
        worker = WorkerProcess()
        await worker.start()
        self.worker = worker
        self.starts += 1

    async def run(self) -> None:
        """Serve the queue until this task is cancelled."""
        worker = await self._live_worker()
        while True:
            try:
                async with asyncio.timeout(IDLE_CHECK_SECONDS):
                    work = await self._queue.get(self._accepts)
            except TimeoutError:
                worker = await self._live_worker()
                continue
            if worker.alive:
                await self._serve(worker, work)
            else:
                self._queue.put_back(work)
            if not worker.alive:
                worker = await self._live_worker()

    def close(self) -> None:
        """Kill the worker, if there is one."""
        worker, self.worker = self.worker, None
        if worker is not None:
            worker.close()

    async def _live_worker(self) -> WorkerProcess:
        """Return the worker, and replace it if it has died or is stopped; retry until there is one."""
        delay = RETRY_SECONDS
        while self.worker is None or not self.worker.alive or self.worker.stopped:
            self.close()
            try:
                await self.start_worker()
            except PoolUnavailableError as error:
                self._on_start(str(error))
                await asyncio.sleep(delay)
                delay = min(2.0 * delay, LONGEST_RETRY_SECONDS)
            else:
                self._on_start("")
        return self.worker

    async def _serve(self, worker: WorkerProcess, work: Work) -> None:
        """Have the worker run the calls of an item, and put the item back if calls are left."""
        work.begin()
        if work.kind is Kind.CHUNK:
            self._queue.begin_chunk(work, worker.make_way)

        serving = True

        def abandon(_: object) -> None:
            # The event loop calls this some time after the future is cancelled. By then the reply may have been read,
            # and the worker may be running other work.
            if serving:
                worker.stop_call()

        work.future.add_done_callback(abandon)
        try:
            await self._converse(worker, work)
        except PoolUnavailableError as error:
            self.close()
            work.fail(error)
        except WorkerDiedError:
            self.close()
            # If the worker had not begun to read the calls, it was killed while idle, and the call is not to blame.
            work.crashes += worker.begun
            if work.crashes == DEATHS:
                work.finish(CallResult(None, WorkerCrashedError(f"the task ended {DEATHS} worker processes"), 0.0))
        finally:
            serving = False
            work.future.remove_done_callback(abandon)
            self._queue.end_chunk(work)
        if work.left:
            self._queue.put_back(work)
        elif not work.future.done():
            work.future.set_result(work.results)

    async def _converse(self, worker: WorkerProcess, work: Work) -> None:
        """Send the unfinished calls, and receive results until the last one, or until the worker skips the rest."""
        calls, overdue = len(work.left), False
        worker.send(work.left)
        while calls or worker.yielding:
            try:
                async with asyncio.timeout(None if overdue else self._task_seconds):
                    reply = await worker.receive()
            except TimeoutError:
                if worker.stopped:  # Somebody has stopped the process (SIGSTOP, a debugger); the call is not at fault.
                    raise PoolUnavailableError(
                        "the worker process was stopped from outside and is being replaced"
                    ) from None
                # `stop_call` kills the worker if the call does not stop, so the next wait needs no timeout.
                overdue = bool(calls)
                worker.stop_call()
                continue
            except WorkerDiedError:
                if not overdue:
                    raise
                self._time_out(work)
                self.close()
                return
            if reply is None:
                return
            calls -= 1
            if overdue:
                overdue = False
                self._time_out(work)
            else:
                large = len(reply) > LARGE_BYTES
                work.finish(await asyncio.to_thread(loads, reply) if large else loads(reply))

    def _time_out(self, work: Work) -> None:
        """Set the timeout as the result of the first unfinished call."""
        error = TaskTimeoutError(f"not finished after {self._task_seconds:g} s")
        work.finish(CallResult(None, error, self._task_seconds))

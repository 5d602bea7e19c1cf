"""Handle of a worker process in the service: start, end, and messages in both directions."""

import asyncio
import os
import pickle
import signal
import socket
from collections import deque
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path

from service.errors import PoolUnavailableError
from service.workers import Call
from service.workers.executor import dumps
from service.workers.template import LIMIT_HINT, template
from service.workers.worker import BEGUN, LENGTH, NUMBER, STOP, VERSIONS, Hello

START_SECONDS = 600.0
"""Timeout for the start of a worker [s]. A start takes seconds, but the first one of an installation compiles the
solver, which takes half a minute on two quiet cores and longer on a busy machine."""
CANCEL_SECONDS = 0.3
"""Time allowed for a call to stop before its worker is killed [s]. The compiled code of most calls returns to Python
within milliseconds. Including the kill, a cancelled call ends within the 0.5 s that `Executor.submit` promises."""

SCRATCH_BYTES = 1 << 16
"""Largest message, including its header, that is read into the shared buffer [bytes]. A longer one gets a buffer of its
own, so that megabytes of a history are not copied. Messages without a history are some kilobytes."""


class WorkerDiedError(Exception):
    """The worker died or was killed."""


class Messages(asyncio.BufferedProtocol):
    """Protocol that splits the bytes of a socket into messages.

    Large messages are read into buffers of their own, so that the megabytes of a history are not copied.
    """

    def __init__(self) -> None:
        self.closed = False
        self._arrived: deque[bytes | bytearray] = deque()
        self._scratch, self._held = bytearray(SCRATCH_BYTES), 0
        """Buffer of small messages, and the number of bytes in it."""
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
    which its death closes at any time.
    """

    def __init__(self) -> None:
        self.yielding = False
        """True from sending `STOP` until the worker acknowledges it."""
        self.begun = False
        """True once the worker has begun to read the latest calls."""
        self._number = 0
        """Number of the list of calls that was sent last."""
        self.pid = 0
        """Process id; 0 before the start and after the end of the process."""
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
            raise PoolUnavailableError("a worker process did not come up; standard error has what it said") from None
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
        """True if the process exists, running or stopped."""
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
        """Wait for the reply to the next call, to be unpickled by `loads`; None if the worker has skipped the rest.

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
        """Kill the process."""
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

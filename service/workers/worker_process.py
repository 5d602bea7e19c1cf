"""The parent's side of a worker process: its start, its end, and the messages to and from it."""

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
from service.workers.template import LIMIT_HINT, template
from service.workers.worker import BEGUN, LENGTH, NUMBER, STOP, VERSIONS, Hello, dumps

START_SECONDS = 600.0
"""Time for a worker to come up: seconds, but the first ever on a machine compiles the solver. [s]"""
CANCEL_SECONDS = 0.3
"""Time allowed for a call to stop when asked; then its worker is killed. [s]"""

SCRATCH_BYTES = 1 << 16
"""Largest message, with its length, that shares a buffer with others; a longer one is read to where it stays."""


class WorkerDiedError(Exception):
    """The worker died or was killed."""


class Messages(asyncio.BufferedProtocol):
    """Messages that arrive at a socket, each read to where it stays: answers with a history take megabytes."""

    def __init__(self) -> None:
        self.closed = False
        self._arrived: deque[bytes | bytearray] = deque()
        self._scratch, self._held = bytearray(SCRATCH_BYTES), 0
        """Where small messages are read to, as many as have arrived, and how much of it is in use."""
        self._body: bytearray | None = None
        """Message that the rest of is being read, if it is longer than that."""
        self._filled = 0
        self._waiting: asyncio.Future[None] | None = None

    async def next(self) -> bytes | bytearray:
        """Return the next message.

        Raises
        ------
        WorkerDiedError
            If the other end has closed.
        """
        while not self._arrived:
            if self.closed:
                raise WorkerDiedError
            self._waiting = asyncio.get_running_loop().create_future()
            await self._waiting
        return self._arrived.popleft()

    def get_buffer(self, sizehint: int) -> memoryview:
        """Return where to read the next bytes to."""
        if self._body is not None:
            return memoryview(self._body)[self._filled :]
        return memoryview(self._scratch)[self._held :]

    def buffer_updated(self, nbytes: int) -> None:
        """Take the messages that are whole."""
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
        """Note that the other end has closed."""
        self.closed = True
        self._wake()

    def _wake(self) -> None:
        if self._waiting is not None and not self._waiting.done():
            self._waiting.set_result(None)


class WorkerProcess:
    """A process that runs `service.workers.worker.serve`, and the socket to it.

    Not an executor of `concurrent.futures`: that never returns, and keeps its interpreter from ending, if a worker dies
    while it sends a result that a pipe cannot hold. Here the death of the worker closes the only other end of the
    socket, whenever it comes.
    """

    def __init__(self) -> None:
        self.yielding = False
        """True while a request to abandon its calls has not been acknowledged."""
        self.begun = False
        """True once the worker has begun to read the latest calls."""
        self._number = 0
        """Number of the list of calls that it was sent last."""
        self.pid = 0
        """Process id; 0 before it is up and after its end."""
        self._lifeline = -1
        self._killing: asyncio.TimerHandle | None = None
        self._messages = Messages()
        self._transport: asyncio.Transport | None = None

    async def start(self) -> None:
        """Start the process and wait until it is warm.

        Raises
        ------
        PoolUnavailableError
            If it does not come up.
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
        """Whether a signal or a debugger has stopped the process; unknown, so False, where there is no /proc."""
        with suppress(OSError):
            return Path(f"/proc/{self.pid}/stat").read_text().rpartition(")")[2].split()[0] in {"T", "t"}
        return False

    def send(self, calls: Sequence[Call]) -> None:
        """Have the worker run these calls."""
        self.begun = False
        self._number += 1
        self._write(pickle.dumps((self._number, [dumps(call) for call in calls])))

    async def receive(self) -> memoryview | None:
        """Return the reply to the next call, for `loads`; None if the worker has left the others.

        Raises
        ------
        WorkerDiedError
            If there will be none.
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
        """Ask the worker to leave the calls that it has not begun."""
        if not self.yielding:
            self.yielding = True
            self._write(STOP)

    def stop_call(self) -> None:
        """Ask the worker to stop the running call too, and kill it if it does not do so soon."""
        self.make_way()
        if self._killing is None:
            self._signal(signal.SIGUSR1)
            self._killing = asyncio.get_running_loop().call_later(CANCEL_SECONDS, self.kill)

    def kill(self) -> None:
        """End the process now, whatever it is doing."""
        self._signal(signal.SIGKILL)

    def close(self) -> None:
        """End the process, and free what it took."""
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
        """Have the process forked; return our end of the socket."""
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
            theirs.close()  # The worker's copies are then the only ones: its death is the end of the stream.
            os.close(watched)
        return ours

    def _signal(self, number: signal.Signals) -> None:
        # A worker that has gone has been reaped, and its id may belong to another process by now.
        if self.pid and not self._messages.closed:
            with suppress(ProcessLookupError):
                os.kill(self.pid, number)

    def _write(self, message: bytes) -> None:
        if self._transport is not None and not self._transport.is_closing():
            self._transport.write(LENGTH.pack(len(message)) + message)

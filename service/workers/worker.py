"""A worker process: receives calls, parses, solves and encodes, and sends the answers back."""

import fcntl
import multiprocessing
import os
import pickle
import select
import signal
import socket
import struct
import sys
import threading
import time
import traceback
from collections.abc import Callable, Sequence
from contextlib import suppress
from multiprocessing.context import ForkServerContext
from pathlib import Path
from typing import Any

from service.cache.hdf5 import Segment, encode_segments
from service.cache.record import FloatColumns, Record
from service.errors import PoolUnavailableError, field_errors
from service.schemas.quantities import Part
from service.workers import Call, CallResult
from service.workers.fork_server import existing_folder
from solver import ParameterError, warm_up

Compute = Callable[[bytes], tuple[dict[str, Any], FloatColumns | None]]

_chunks: dict[str, list[Record]] = {}
"""Records of the chunk being computed, by its id. A worker runs one chunk at a time."""


def compute_single(compute: Compute, operation: str, key: str, request: bytes) -> tuple[bytes, str]:
    """Return the answer to one request as it is sent, and its outcome."""
    record = Record(key, operation, request, *compute(request))
    return record.json, record.outcome


def compute_case(compute: Compute, operation: str, key: str, request: bytes, chunk: str) -> tuple[bytes, str]:
    """Return the answer to one case of a chunk and its outcome; keep it for the file of the chunk."""
    record = Record(key, operation, request, *compute(request))
    if chunk not in _chunks:
        _chunks.clear()  # one that never ended
    _chunks.setdefault(chunk, []).append(record)
    return record.json, record.outcome


def close_chunk(chunk: str) -> Sequence[Segment]:
    """Return the files of the cases of this chunk that this process has computed."""
    return encode_segments(_chunks.pop(chunk, []))


def check_requests(model: type[Part], requests: Sequence[bytes]) -> dict[int, list[dict[str, str]]]:
    """Return what the solver finds wrong with these requests, each valid by itself, by their place."""
    wrong = {}
    for number, request in enumerate(requests):
        try:
            model.model_validate_json(request).arguments()  # type: ignore[attr-defined] # all requests have it
        except ParameterError as error:
            wrong[number] = field_errors(error)
    return wrong


READY = b"ready"
STOP = b""
"""Requests that a worker leave the calls it has not begun, and is its answer that it has."""
LENGTH = struct.Struct("!Q")
GULP = 1 << 18
"""Bytes to read at once: more than a socket holds. A reader that lags behind catches up in one read."""
NICENESS = 5
"""Below the server, which has to answer others while the workers fill the cores."""


class Channel:
    """One end of a private socket, for whole messages.

    The connections of multiprocessing let go of the interpreter lock three times a message; in a busy server each time
    may cost the switch interval of 5 ms. This one does so twice, for as many messages as have arrived.
    """

    def __init__(self, end: socket.socket) -> None:
        self._end = end
        self._arrived = bytearray()
        self._readable = select.poll()
        self._readable.register(end, select.POLLIN)

    def send(self, message: bytes, seconds: float | None = None) -> None:
        """Send a message; TimeoutError if the other end has not taken it in this time."""
        self._end.settimeout(seconds)
        self._end.sendall(LENGTH.pack(len(message)) + message)
        self._end.settimeout(None)  # with one, each recv would wait and let go of the lock once more

    def receive(self, seconds: float | None = None) -> bytes | None:
        """Next message, None if this time passes without a byte; EOFError if the other end has gone."""
        while (message := self._next()) is None:
            if not self._readable.poll(None if seconds is None else 1000.0 * seconds):
                return None
            gulp = self._end.recv(GULP)
            if not gulp:
                raise EOFError
            self._arrived += gulp
        return message

    def waiting(self) -> bool:
        """Return whether there is something to receive, be it the end."""
        return bool(self._arrived or self._readable.poll(0))

    def close(self) -> None:
        """Hang up."""
        self._end.close()

    def _next(self) -> bytes | None:
        if len(self._arrived) < LENGTH.size:
            return None
        end = LENGTH.size + LENGTH.unpack_from(self._arrived)[0]
        if len(self._arrived) < end:
            return None
        with memoryview(self._arrived) as arrived:
            message = bytes(arrived[LENGTH.size : end])
        del self._arrived[:end]
        return message


class WorkerDiedError(Exception):
    """The worker has gone or has to go, and with it the call it was on."""


class WorkerProcess:
    """One process, and the parent's end of the channel to it."""

    _starting = threading.Lock()  # multiprocessing's own bookkeeping is not made for threads

    def __init__(self, context: ForkServerContext) -> None:
        ours, theirs = socket.socketpair()
        self._channel = Channel(ours)
        self._process = context.Process(target=serve, args=(theirs,), name="ricochet-worker", daemon=True)
        try:
            with self._starting, existing_folder():
                self._process.start()
        except (OSError, EOFError) as error:
            self._channel.close()
            cause = str(error) or type(error).__name__
            raise PoolUnavailableError(f"no worker process could be started: {cause}") from error
        finally:
            theirs.close()  # the worker's copy is then the only one: its death is the end of the stream

    @property
    def pid(self) -> int:
        """Process id."""
        return self._process.pid or 0

    @property
    def alive(self) -> bool:
        """Whether an idle worker still holds its end of the channel: it has nothing to say but its end."""
        return not self._channel.waiting()

    @property
    def stopped(self) -> bool:
        """Whether a signal or a debugger has stopped the process; unknown, so False, where there is no /proc."""
        with suppress(OSError):
            return Path(f"/proc/{self.pid}/stat").read_text().rpartition(")")[2].split()[0] in {"T", "t"}
        return False

    def receive(self, seconds: float) -> bytes | None:
        """Next message of the worker; None if nothing has come within this time."""
        try:
            return self._channel.receive(seconds)
        except (EOFError, OSError) as error:
            raise WorkerDiedError from error

    def send(self, message: bytes, seconds: float) -> None:
        """Send a message, which the worker has this long to take."""
        try:
            self._channel.send(message, seconds)
        except OSError as error:  # also for a worker that does not read: it is as good as dead
            raise WorkerDiedError from error

    def kill(self) -> None:
        """End the process now, whatever it is doing."""
        if self._process.is_alive():
            self._process.kill()

    def close(self) -> None:
        """Give up the channel; an idle worker ends by itself then."""
        self._channel.close()


def serve(end: socket.socket) -> None:
    """Body of a worker process: work off one chunk after the other until the other end of the channel closes."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C reaches the whole group; the parent ends its workers itself
    end_with_parent()
    os.nice(NICENESS)
    warm_up()
    channel = Channel(end)
    with suppress(EOFError, BrokenPipeError, ConnectionResetError):
        channel.send(READY)
        while True:
            message = channel.receive()
            if message == STOP:
                channel.send(STOP)
            elif message is not None:
                work_off(pickle.loads(message), channel)  # noqa: S301 (from the parent only)


def work_off(calls: Sequence[bytes], channel: Channel) -> None:
    """Answer these calls one after the other, until there is word from the parent: that can only be to stop."""
    for call in calls:
        if channel.waiting():
            return
        channel.send(answer(call))


def answer(call: bytes) -> bytes:
    """Run a pickled call; return the pickled (value, error, seconds) of what became of it."""
    started = time.perf_counter()
    try:
        function, arguments = pickle.loads(call)  # noqa: S301 (from the parent only)
        result = function(*arguments)
        return pickle.dumps((result, None, time.perf_counter() - started), pickle.HIGHEST_PROTOCOL)
    except Exception as error:  # noqa: BLE001 (whatever it is, the parent has to know)
        seconds = time.perf_counter() - started
        error.add_note("".join(traceback.format_exception(error)))
        try:
            return pickle.dumps((None, error, seconds), pickle.HIGHEST_PROTOCOL)
        except Exception:  # noqa: BLE001 (an exception may hold anything)
            described = RuntimeError("\n".join(error.__notes__))
            return pickle.dumps((None, described, seconds), pickle.HIGHEST_PROTOCOL)


def dumps(call: Call) -> bytes:
    """Pickle a call; one that cannot be pickled becomes a call that says so."""
    try:
        return pickle.dumps(call, pickle.HIGHEST_PROTOCOL)
    except Exception as error:  # noqa: BLE001 (arguments may hold anything)
        return pickle.dumps((refuse, (str(error),)))


def refuse(why: str) -> None:
    """Stand in for a call that could not be pickled."""
    raise pickle.PicklingError(why)


def loads(reply: bytes) -> CallResult:
    """Unpickle what became of a call."""
    try:
        return CallResult(*pickle.loads(reply))  # noqa: S301 (from our own worker)
    except Exception as error:  # noqa: BLE001 (some exceptions can be pickled, but not back)
        return CallResult(None, error, 0.0)


def end_with_parent() -> None:
    """Have the kernel end this process as soon as its parent has gone.

    A thread watching the parent would never run while compiled code holds the interpreter lock. SIGIO needs no
    interpreter: the kernel raises it when the pipe that only the parent holds open closes, and it is not caught.
    """
    parent = multiprocessing.parent_process()
    if parent is None:
        return
    signal.signal(signal.SIGIO, signal.SIG_DFL)
    fcntl.fcntl(parent.sentinel, fcntl.F_SETOWN, os.getpid())
    fcntl.fcntl(parent.sentinel, fcntl.F_SETFL, fcntl.fcntl(parent.sentinel, fcntl.F_GETFL) | os.O_ASYNC)
    if not parent.is_alive():  # it ended before the kernel was set up
        sys.exit()

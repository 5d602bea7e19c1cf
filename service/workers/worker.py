"""A worker process: receives calls, parses, solves and encodes, and sends the answers back."""

import fcntl
import os
import pickle
import select
import signal
import socket
import struct
import sys
import time
import traceback
from collections.abc import Callable, Sequence
from contextlib import suppress
from typing import Any, NamedTuple, NoReturn

from service.cache.hdf5 import Segment, encode_segments
from service.cache.record import FloatColumns, Record
from service.errors import field_errors
from service.operations import SCHEMA_VERSION
from service.schemas.quantities import Part
from service.workers import Call, CallResult
from service.workers.template import LIMIT_HINT
from solver import ENGINE_VERSION, ParameterError, warm_up

Compute = Callable[[bytes], tuple[dict[str, Any], FloatColumns | None]]

MOST_CHUNKS = 4
"""Chunks whose records are kept until they end here: smaller chunks may pass one, and others may end elsewhere."""

_chunks: dict[str, list[Record]] = {}
"""Records of the chunks being computed, by their ids."""


def compute_single(compute: Compute, operation: str, key: str, request: bytes) -> tuple[bytes, str]:
    """Return the answer to one request as it is sent, and its outcome."""
    record = Record(key, operation, request, *compute(request))
    return record.json, record.outcome


def compute_case(compute: Compute, operation: str, key: str, request: bytes, chunk: str) -> tuple[bytes, str]:
    """Return the answer to one case of a chunk and its outcome; keep it for the file of the chunk."""
    record = Record(key, operation, request, *compute(request))
    _chunks.setdefault(chunk, []).append(record)
    if len(_chunks) > MOST_CHUNKS:
        del _chunks[next(iter(_chunks))]
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


VERSIONS = ENGINE_VERSION, SCHEMA_VERSION
"""What a worker has to have in common with the service: both may be installed anew while the service runs."""
STOP = b"stop"
"""Request that a worker leave the calls it has not begun; echoed as acknowledgement."""
BEGUN = b"begun"
"""Said before a message is read: a worker that dies before is not ended by a call."""
LENGTH = struct.Struct("!Q")
"""Length of a message, which goes before it."""
NUMBER = struct.Struct("!Q")
"""Number of a list of calls, which goes before each answer to one of them: no answer can be taken for another's."""
NICENESS = 5
"""Lower priority than the server, which must stay responsive while the workers fill the cores."""


class Hello(NamedTuple):
    """First message of a worker, when it can take calls.

    Parameters
    ----------
    error
        Why there is no worker.
    """

    pid: int
    versions: tuple[str, str] = VERSIONS
    error: str = ""


class CallStopped(BaseException):
    """The service no longer wants the call that is running."""


REPEAT_SECONDS = 0.001
"""Delay before a running call is stopped again where Python has ignored the exception. [s]"""


class StopSignal:
    """Ends the running call on a signal: in Python code at once, in compiled code when that returns."""

    def __init__(self) -> None:
        self._running = False

    def install(self) -> None:
        """Handle the signals of this process, and what Python ignores of them."""
        signal.signal(signal.SIGUSR1, self)
        signal.signal(signal.SIGALRM, self)
        sys.unraisablehook = self.repeat

    def __call__(self, *_: object) -> None:
        """Handle the signal. One that comes when a call has just ended is for no other."""
        if self._running:
            raise CallStopped

    def repeat(self, ignored: "sys.UnraisableHookArgs") -> None:
        """Send the signal again if the exception was raised where Python ignores all, as in a destructor."""
        if isinstance(ignored.exc_value, CallStopped):
            signal.setitimer(signal.ITIMER_REAL, REPEAT_SECONDS)
        else:
            sys.__unraisablehook__(ignored)

    def run(self, function: Callable[..., Any], arguments: Sequence[Any]) -> Any:
        """Return what a call returns.

        Raises
        ------
        InterruptedError
            If it was stopped.
        """
        try:
            self._running = True
            try:
                return function(*arguments)
            finally:
                self._running = False
        except CallStopped:
            raise InterruptedError("the call was stopped") from None


stop_signal = StopSignal()


def fork_workers(end: int) -> None:
    """Run the template process: load the solver, then fork a worker for each message, until the socket closes.

    Parameters
    ----------
    end
        File descriptor of the socket to the service.
    """
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    warm_up()
    signal.signal(signal.SIGCHLD, signal.SIG_IGN)  # The kernel reaps the workers.
    with socket.socket(fileno=end) as requests:
        while True:
            message, descriptors, _, _ = socket.recv_fds(requests, 1, 2)
            if not message:
                return
            with socket.socket(fileno=descriptors[0]) as channel:
                try:
                    child = os.fork() == 0
                except OSError as error:
                    reason = f"no worker process could be started: {error}; {LIMIT_HINT}"
                    with suppress(ConnectionError):  # The service may have given it up.
                        send(channel, pickle.dumps(Hello(0, error=reason)))
                    child = False
                if child:
                    requests.close()
                    serve(channel, descriptors[1])
            os.close(descriptors[1])


def serve(channel: socket.socket, lifeline: int) -> NoReturn:
    """Run a worker process: work off one list of calls after the other until the other end of the socket closes.

    Parameters
    ----------
    lifeline
        Reading end of a pipe that the service alone holds open.
    """
    signal.signal(signal.SIGCHLD, signal.SIG_DFL)
    stop_signal.install()
    end_with_parent(lifeline)
    os.nice(NICENESS)
    with suppress(ConnectionError):
        send(channel, pickle.dumps(Hello(os.getpid())))
        while message := receive(channel, BEGUN):
            if message == STOP:
                send(channel, STOP)
            else:
                number, calls = pickle.loads(message)  # noqa: S301 (from the service only)
                work_off(number, calls, channel)
    sys.exit()


def work_off(number: int, calls: Sequence[bytes], channel: socket.socket) -> None:
    """Answer these calls one after the other, until there is word from the parent: that can only be to stop."""
    for call in calls:
        if select.select([channel], [], [], 0.0)[0]:
            return
        send(channel, answer(call), NUMBER.pack(number))


def send(channel: socket.socket, message: bytes, before: bytes = b"") -> None:
    """Send a message, with something before it."""
    channel.sendall(LENGTH.pack(len(before) + len(message)) + before + message)


def receive(channel: socket.socket, said_before: bytes = b"") -> bytes:
    """Return the next message, an empty one if there will be none; say this once it begins to arrive."""
    head = _receive_exactly(channel, LENGTH.size)
    if not head:
        return b""
    if said_before:
        send(channel, said_before)
    return _receive_exactly(channel, LENGTH.unpack(head)[0])


def _receive_exactly(channel: socket.socket, length: int) -> bytes:
    """Return so many bytes, none if the other end closes before."""
    message = bytearray()
    while len(message) < length:
        part = channel.recv(length - len(message))
        if not part:
            return b""
        message += part
    return bytes(message)


def end_with_parent(lifeline: int) -> None:
    """Have the kernel end this process as soon as its parent has gone.

    A thread watching the parent would never run while compiled code holds the interpreter lock. SIGIO needs no
    interpreter: the kernel raises it when the pipe that only the parent holds open closes, and it is not caught.
    """
    signal.signal(signal.SIGIO, signal.SIG_DFL)
    fcntl.fcntl(lifeline, fcntl.F_SETOWN, os.getpid())
    fcntl.fcntl(lifeline, fcntl.F_SETFL, fcntl.fcntl(lifeline, fcntl.F_GETFL) | os.O_ASYNC)
    if select.select([lifeline], [], [], 0.0)[0]:  # The parent ended before the kernel was set up.
        sys.exit()


def answer(call: bytes) -> bytes:
    """Run a pickled call; return the pickled (value, error, seconds) of what became of it."""
    started = time.perf_counter()
    try:
        function, arguments = pickle.loads(call)  # noqa: S301 (from the parent only)
        result = stop_signal.run(function, arguments)
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


def loads(reply: bytes | memoryview) -> CallResult:
    """Unpickle what became of a call."""
    try:
        return CallResult(*pickle.loads(reply))  # noqa: S301 (from our own worker)
    except Exception as error:  # noqa: BLE001 (some exceptions can be pickled, but not back)
        return CallResult(None, error, 0.0)

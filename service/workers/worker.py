"""Worker process: receives calls, parses requests, solves, encodes the answers and sends them back."""

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

from service.cache.record import FloatColumns, Record
from service.cache.segments import Segment, encode_segments
from service.operations import SCHEMA_VERSION
from service.schemas.quantities import Part
from service.schemas.uncertainty import UncertainCase
from service.workers.template import LIMIT_HINT
from solver import ENGINE_VERSION, ParameterError, warm_up

Compute = Callable[[bytes], tuple[dict[str, Any], FloatColumns | None]]

MOST_CHUNKS = 4
"""Largest number of chunks whose records a worker keeps, chosen by judgement. Another chunk may run before a chunk is
closed, and a chunk may be closed in another worker, so its records here may never be collected."""

_chunks: dict[str, list[Record]] = {}
"""Records of the chunks being computed, by the id of the chunk."""


def compute_single(compute: Compute, operation: str, key: str, request: bytes) -> tuple[bytes, str]:
    """Compute one request, and return the JSON of the answer and its outcome."""
    record = Record(key, operation, request, *compute(request))
    return record.json, record.outcome


def compute_case(compute: Compute, operation: str, key: str, request: bytes, chunk: str) -> tuple[bytes, str]:
    """Compute one case of a chunk, keep its record for `close_chunk`, and return the answer's JSON and outcome."""
    record = Record(key, operation, request, *compute(request))
    _chunks.setdefault(chunk, []).append(record)
    if len(_chunks) > MOST_CHUNKS:
        del _chunks[next(iter(_chunks))]
    return record.json, record.outcome


def close_chunk(chunk: str) -> Sequence[Segment]:
    """Encode the cases of a chunk that this process has computed as segments of the cache."""
    return encode_segments(_chunks.pop(chunk, []))


def check_requests(model: type[Part], requests: Sequence[bytes]) -> dict[int, ParameterError]:
    """Return the errors that the solver finds in requests which satisfy their schema, by position."""
    wrong: dict[int, ParameterError] = {}
    for number, request in enumerate(requests):
        try:
            case: Any = model.model_validate_json(request)
            case.study() if isinstance(case, UncertainCase) else case.arguments()
        except ParameterError as error:
            wrong[number] = error
    return wrong


VERSIONS = ENGINE_VERSION, SCHEMA_VERSION
"""Versions that worker and service must share. The package may be upgraded on the disk while the service runs, and a
new template process would then load the new code."""
STOP = b"stop"
"""Message that asks a worker to skip the calls it has not begun; echoed as acknowledgement."""
BEGUN = b"begun"
"""Reply that a worker sends before it reads the body of a message, such as a list of calls. A worker that dies without
having sent it was not killed by a call."""
LENGTH = struct.Struct("!Q")
"""Header of every message: its length, without this header. [bytes]"""
NUMBER = struct.Struct("!Q")
"""Header of a reply with the number of the list of calls that it belongs to, so that a late reply to a cancelled list
is not mistaken for a reply to the next list."""
NICENESS = 5
"""Niceness of workers, chosen by judgement, so that the service stays responsive while they fill the cores."""


class Hello(NamedTuple):
    """First message that a worker sends, to say that it is ready for calls or could not be started.

    Parameters
    ----------
    error
        Reason why the worker could not be started; empty if it is ready.
    """

    pid: int
    versions: tuple[str, str] = VERSIONS
    error: str = ""


class CallStopped(BaseException):
    """The service has cancelled the running call.

    It derives from BaseException so that no `except Exception` of the solver or a library catches it.
    """


REPEAT_SECONDS = 0.001
"""Delay before a call is stopped again after Python has ignored the exception [s]. It only has to be longer than a
destructor takes, and shorter than the 0.3 s after which the worker is killed."""


class StopSignal:
    """Signal handler that stops the running call: in Python code at once, in compiled code when that returns."""

    def __init__(self) -> None:
        self._running = False

    def install(self) -> None:
        """Install the signal handler, and a hook for exceptions that Python ignores."""
        signal.signal(signal.SIGUSR1, self)
        signal.signal(signal.SIGALRM, self)
        sys.unraisablehook = self.repeat

    def __call__(self, *_: object) -> None:
        """Raise `CallStopped` if a call is running. A signal that comes too late must not stop the next call."""
        if self._running:
            raise CallStopped

    def repeat(self, ignored: "sys.UnraisableHookArgs") -> None:
        """Repeat the signal if Python has ignored its exception, as it does in a destructor."""
        if isinstance(ignored.exc_value, CallStopped):
            signal.setitimer(signal.ITIMER_REAL, REPEAT_SECONDS)
        else:
            sys.__unraisablehook__(ignored)

    def run(self, function: Callable[..., Any], arguments: Sequence[Any]) -> Any:
        """Run a call, and return its value.

        Raises
        ------
        InterruptedError
            If the call was stopped.
        """
        # The outer block catches a signal that arrives in the inner `finally`, before `_running` is False.
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
    """Run the template process: load the solver, then fork a worker for each request until the socket closes.

    Parameters
    ----------
    end
        File descriptor of the socket to the service.
    """
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    warm_up()
    signal.signal(signal.SIGCHLD, signal.SIG_IGN)  # The kernel then reaps workers that have ended.
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
                    with suppress(ConnectionError):  # The service may have closed the socket of this worker.
                        send(channel, pickle.dumps(Hello(0, error=reason)))
                    child = False
                if child:
                    requests.close()
                    serve(channel, descriptors[1])
            os.close(descriptors[1])


def serve(channel: socket.socket, lifeline: int) -> NoReturn:
    """Run a worker process: run lists of calls until the service closes its end of the socket.

    Parameters
    ----------
    lifeline
        Reading end of a pipe whose writing end only the service holds.
    """
    # The template process ignores SIGCHLD, and a worker inherits that, which would break `subprocess`.
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
    """Run calls one after the other, until all are done or the service sends `STOP` or closes the socket."""
    for call in calls:
        if select.select([channel], [], [], 0.0)[0]:
            return
        send(channel, answer(call), NUMBER.pack(number))


def send(channel: socket.socket, message: bytes, before: bytes = b"") -> None:
    """Send a message, preceded by its length and by `before`."""
    channel.sendall(LENGTH.pack(len(before) + len(message)) + before + message)


def receive(channel: socket.socket, said_before: bytes = b"") -> bytes:
    """Return the next message, or an empty one if the socket is closed; send `said_before` before reading its body."""
    head = _receive_exactly(channel, LENGTH.size)
    if not head:
        return b""
    if said_before:
        send(channel, said_before)
    return _receive_exactly(channel, LENGTH.unpack(head)[0])


def _receive_exactly(channel: socket.socket, length: int) -> bytes:
    """Return `length` bytes, or no bytes if the other end is closed before all have arrived."""
    message = bytearray()
    while len(message) < length:
        part = channel.recv(length - len(message))
        if not part:
            return b""
        message += part
    return bytes(message)


def end_with_parent(lifeline: int) -> None:
    """Have the kernel end this process as soon as the service has ended.

    A thread that watches the service would not run while compiled code holds the interpreter lock. SIGIO needs no
    interpreter: the kernel sends it when the service's end of the pipe closes, and its default action ends the process.
    """
    signal.signal(signal.SIGIO, signal.SIG_DFL)
    fcntl.fcntl(lifeline, fcntl.F_SETOWN, os.getpid())
    fcntl.fcntl(lifeline, fcntl.F_SETFL, fcntl.fcntl(lifeline, fcntl.F_GETFL) | os.O_ASYNC)
    if select.select([lifeline], [], [], 0.0)[0]:  # The service ended before the signal was armed.
        sys.exit()


def answer(call: bytes) -> bytes:
    """Run a pickled call, and return the pickled fields of its `CallResult`."""
    started = time.perf_counter()
    try:
        function, arguments = pickle.loads(call)  # noqa: S301 (from the service only)
        result = stop_signal.run(function, arguments)
        return pickle.dumps((result, None, time.perf_counter() - started), pickle.HIGHEST_PROTOCOL)
    except Exception as error:  # noqa: BLE001 (the service has to know any error)
        seconds = time.perf_counter() - started
        # Pickling drops the traceback of an exception, but keeps its notes.
        error.add_note("".join(traceback.format_exception(error)))
        try:
            return pickle.dumps((None, error, seconds), pickle.HIGHEST_PROTOCOL)
        except Exception:  # noqa: BLE001 (an exception may hold objects that cannot be pickled)
            described = RuntimeError("\n".join(error.__notes__))
            return pickle.dumps((None, described, seconds), pickle.HIGHEST_PROTOCOL)

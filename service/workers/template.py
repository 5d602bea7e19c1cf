"""The template process: it loads the compiled solver once, and every worker is a fork of it.

A worker that is started anew takes 2 s of processor time and 80 MB of its own; as a fork it takes 10 ms and 13 MB. The
fork server of `multiprocessing` does the same through a socket in the folder for temporary files: once that is emptied,
no worker can be replaced any more. This one has an unnamed socket.
"""

import atexit
import os
import signal
import socket
import subprocess
import sys
import threading
from collections.abc import Sequence
from contextlib import suppress

# Only the standard library is imported here: a command starts the process before its own imports.

LIMIT_HINT = "too many processes or threads are running (pids.max of the container, ulimit -u)"


class Template:
    """The template process of this process, started when it is first needed, and anew when it has died."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._process: subprocess.Popen[bytes] | None = None
        self._channel: socket.socket | None = None

    def start(self) -> None:
        """Start the process unless it runs, and return without waiting for what it loads.

        A command that will need workers calls this before its own imports, so that both load side by side. If there
        can be no process, `fork` says so.
        """
        with self._lock, suppress(OSError):
            self._ensure_running()

    def fork(self, descriptors: Sequence[int]) -> None:
        """Have a worker forked that gets these file descriptors, those of `service.workers.worker.serve`.

        Raises
        ------
        OSError
            If there can be no process, or it dies at this very moment.
        """
        with self._lock:
            self._ensure_running()
            assert self._channel is not None  # noqa: S101 (it runs)
            socket.send_fds(self._channel, [b"f"], descriptors)

    def stop(self) -> None:
        """End the process with all its children: workers, and what compiles the solver for them."""
        with self._lock:
            if self._process is not None:
                with suppress(ProcessLookupError):
                    os.killpg(self._process.pid, signal.SIGKILL)
            self._discard()

    def _ensure_running(self) -> None:
        if self._process is None or self._process.poll() is not None:
            self._discard()
            self._spawn()

    def _spawn(self) -> None:
        self._channel, theirs = socket.socketpair()
        # It imports from where this process does: from the working folder only if that is among these.
        program = f"import sys; sys.path[:] = {sys.path!r}\nfrom service.workers.worker import fork_workers\n"
        warnings = [f"-W{option}" for option in sys.warnoptions]
        with theirs:
            # A process group of its own: Ctrl-C in a terminal reaches all processes of the foreground group, and would
            # end this one with a traceback. Not a session, which Linux may schedule apart, without regard to `nice`.
            self._process = subprocess.Popen(  # noqa: S603 (our own)
                [sys.executable, *warnings, "-P", "-c", f"{program}fork_workers({theirs.fileno()})"],
                stdin=subprocess.DEVNULL,
                pass_fds=[theirs.fileno()],
                process_group=0,
                # One thread each: the workers fill the cores already.
                env={"OPENBLAS_NUM_THREADS": "1"} | os.environ,
            )

    def _discard(self) -> None:
        if self._channel is not None:
            self._channel.close()
            self._channel = None
        if self._process is not None:
            self._process.send_signal(signal.SIGKILL)
            self._process.wait()
            self._process = None


template = Template()
atexit.register(template.stop)

"""Template process, which loads the compiled solver once and forks every worker.

A worker started from scratch takes 2 s of processor time and 80 MB of memory; a fork takes 10 ms and 13 MB. The fork
server of `multiprocessing` does the same through a socket in the folder for temporary files, and cannot start another
worker once that folder has been emptied. This process uses an unnamed socket.
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

# Only the standard library is imported here, because the command line starts the process before its own slow imports.

LIMIT_HINT = "too many processes or threads are running (pids.max of the container, ulimit -u)"
"""Probable cause of a failed fork, for messages."""


class Template:
    """Handle of the template process, which is started on first use and again when it has died."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._process: subprocess.Popen[bytes] | None = None
        self._channel: socket.socket | None = None

    def start(self) -> None:
        """Start the process if it is not running, without waiting until it has loaded the solver.

        A command that will need workers calls this before its own imports, so that both load at the same time. A
        failure is reported later, by `fork`.
        """
        with self._lock, suppress(OSError):
            self._ensure_running()

    def fork(self, descriptors: Sequence[int]) -> None:
        """Have the process fork a worker, and pass it the file descriptors of `service.workers.worker.serve`.

        Raises
        ------
        OSError
            If the process cannot be started, or dies before it receives the request.
        """
        with self._lock:
            self._ensure_running()
            assert self._channel is not None  # noqa: S101 (it runs)
            socket.send_fds(self._channel, [b"f"], descriptors)

    def stop(self) -> None:
        """Kill the process group: the template process, the workers, and the compilers of the solver."""
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
        # The template process gets the search path of this process, so that both import the same code. -P keeps Python
        # from adding the working folder, whose files could hide modules.
        program = f"import sys; sys.path[:] = {sys.path!r}\nfrom service.workers.worker import fork_workers\n"
        warnings = [f"-W{option}" for option in sys.warnoptions]
        with theirs:
            # The process has its own group, because Ctrl-C in a terminal reaches all processes of the foreground group
            # and would end the template process with a traceback. It stays in the session of the service: Linux may
            # divide processor time evenly between sessions (autogroups), and niceness counts only within one, so in
            # another session the workers would not yield to the service.
            self._process = subprocess.Popen(  # noqa: S603 (our own)
                [sys.executable, *warnings, "-P", "-c", f"{program}fork_workers({theirs.fileno()})"],
                stdin=subprocess.DEVNULL,
                pass_fds=[theirs.fileno()],
                process_group=0,
                # One BLAS thread per worker is enough, because the workers already fill the cores.
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

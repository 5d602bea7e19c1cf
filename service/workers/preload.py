"""Imported by the fork server alone: what is loaded and compiled here, every worker inherits without cost."""

import os
from contextlib import suppress
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # before numpy; the workers already fill the cores

from solver import warm_up
from solver.compilation import cache_folders, compilation_progress


def compile_in_child() -> None:
    """Compile what is not compiled yet in a process that ends and takes the memory of the compiler with it.

    Only where its code can be kept: elsewhere this process has to compile all the same.
    """
    compiled, functions = compilation_progress()
    if compiled == functions or not any(map(_is_writable, cache_folders())):
        return
    child = os.fork()
    if child == 0:
        status = 1
        with suppress(BaseException):  # this process compiles what is missing, and reports what is wrong
            warm_up()
            status = 0
        os._exit(status)
    os.waitpid(child, 0)


def _is_writable(folder: Path) -> bool:
    with suppress(OSError):
        folder.mkdir(parents=True, exist_ok=True)
    return os.access(folder, os.W_OK)


compile_in_child()
warm_up()

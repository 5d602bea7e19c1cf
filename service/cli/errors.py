"""Errors that end a command, and the exit statuses."""

from collections.abc import Mapping
from typing import Any

FAILED, WRONG, SOME_FAILED, INTERRUPTED = 1, 2, 3, 130
"""Exit statuses: the computation or the service failed; the input or the usage is wrong; some cases of a batch have no
result; Ctrl-C."""
EXIT_STATUSES = f"""\
exit status:
  0  success
  {FAILED}  the computation failed, or the service failed or cannot be reached
  {WRONG}  a file, a flag or a value is wrong
  {SOME_FAILED}  finished, but some cases of a batch have a problem instead of a result
  {INTERRUPTED}  interrupted (Ctrl-C)"""
INPUT_STATUSES = frozenset({400, 404, 405, 406, 413, 415})
"""HTTP statuses caused by the request."""
INVALID = "urn:ricochet:problem:invalid-request"


class CommandError(Exception):
    """The command cannot continue; the text is printed for the user.

    Parameters
    ----------
    text
        What is wrong.
    status
        Exit status of the command.
    """

    def __init__(self, text: str, status: int = WRONG) -> None:
        super().__init__(text)
        self.status = status


class UsageError(CommandError):
    """The flags do not go together; the usage of the command is printed too."""


class RefusedError(CommandError):
    """A problem document (RFC 9457) instead of an answer.

    Parameters
    ----------
    problem
        The document.
    """

    def __init__(self, problem: Mapping[str, Any]) -> None:
        self.problem = problem
        status = problem.get("status", 0)
        wrong = problem.get("type") == INVALID or status in INPUT_STATUSES
        super().__init__(problem_text(problem), WRONG if wrong else FAILED)

    @property
    def errors(self) -> list[dict[str, str]]:
        """Invalid fields of the request, each a `pointer` and a `detail`."""
        return list(self.problem.get("errors", ()))


def problem_text(problem: Mapping[str, Any]) -> str:
    """Return a problem document as one sentence."""
    return ": ".join(str(problem[name]) for name in ("title", "detail") if problem.get(name))

"""How a command ends that cannot do what it was asked for."""

from collections.abc import Mapping
from typing import Any

FAILED, WRONG, SOME_FAILED, INTERRUPTED = 1, 2, 3, 130
"""Exit statuses: it could not be computed, or the service failed; the input or the usage is wrong; some cases of many
have no result; Ctrl-C."""
EXIT_STATUSES = f"""\
exit status:
  0  done
  {FAILED}  it could not be computed, or the service failed or is not there
  {WRONG}  a file, a flag or a value is wrong
  {SOME_FAILED}  done, but some cases of many have a problem instead of a result
  {INTERRUPTED}  interrupted (Ctrl-C)"""
OF_THE_INPUT = frozenset({400, 404, 405, 406, 413, 415})
"""Statuses of HTTP that tell of what was sent."""
INVALID = "urn:ricochet:problem:invalid-request"


class CommandError(Exception):
    """What was asked for cannot be done; the text is for people.

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
    """The command cannot be used like this; its usage is told too."""


class RefusedError(CommandError):
    """There is a problem instead of an answer.

    Parameters
    ----------
    problem
        As the contract has it (RFC 9457).
    """

    def __init__(self, problem: Mapping[str, Any]) -> None:
        self.problem = problem
        status = problem.get("status", 0)
        wrong = problem.get("type") == INVALID or status in OF_THE_INPUT
        super().__init__(told(problem), WRONG if wrong else FAILED)

    @property
    def errors(self) -> list[dict[str, str]]:
        """What is wrong in the request, by `pointer` and `detail`."""
        return list(self.problem.get("errors", ()))


def told(problem: Mapping[str, Any]) -> str:
    """Return a problem as a sentence."""
    return ": ".join(str(problem[name]) for name in ("title", "detail") if problem.get(name))

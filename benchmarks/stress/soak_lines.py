"""What the soak has to tell: results, memory, open files."""

from collections.abc import Sequence
from typing import Any

from benchmarks.stress.faults_found import Found
from benchmarks.stress.lines import Line
from benchmarks.stress.soak_footprint import Footprint, largest_change

NUMBER = 11
WHAT = "mixed load of two owners"
WARM_UP_SHARE = 0.2
"""Of the calm rounds; what is held after it is compared with."""
GROWTH = 0.1


def as_lines(found: Found, details: dict[str, Any], calm: Sequence[Footprint]) -> list[Line]:
    """Line 11; `calm` is what was seen after each calm round."""
    warm = calm[max(1, round(WARM_UP_SHARE * len(calm))) - 1 :]
    told = f"{len(calm)} rounds without a restart, {details['calm_cases']:,} cases, against round {warm[0].round}"
    return [_results(found, details), _memory(told, warm), _handles(told, warm)]


def not_measured() -> Line:
    """The line of a system that does not tell what its processes hold."""
    return Line(number=NUMBER, what=WHAT, required="", measured="takes Linux", held=None)


def _results(found: Found, details: dict[str, Any]) -> Line:
    asked = details["asked"]
    what = f"{WHAT}: {asked['cases of jobs']:,} cases in jobs, {details['different_cases']:,} different, and single "
    what += f"queries, downloads, events, cancelled jobs, invalid bodies; {details['seconds'] / 60:.0f} minutes"
    required = "no result lost, none there twice, none wrong; no job left running"
    computed = f"{details['computed_anew']} computed anew alike"
    return found.line(NUMBER, what, required, computed, details)


def _memory(told: str, warm: Sequence[Footprint]) -> Line:
    server, together = largest_change(warm, "server_bytes"), largest_change(warm, "all_bytes")
    measured = f"server {_megabytes(warm[0].server_bytes, warm[-1].server_bytes)}, farthest {server:.1%}; "
    measured += f"with workers {_megabytes(warm[0].all_bytes, warm[-1].all_bytes)}, farthest {together:.1%}"
    return Line(
        number=NUMBER,
        what=f"memory, without mapped files, over {told}",
        required=f"never more than {GROWTH:.0%} away from it",
        measured=measured,
        held=max(server, together) <= GROWTH,
    )


def _handles(told: str, warm: Sequence[Footprint]) -> Line:
    first, last = warm[0], warm[-1]
    return Line(
        number=NUMBER,
        what=f"open files over {told}",
        required="as many at the end",
        measured=f"server {first.server_handles}, {last.server_handles} at the end; "
        f"with workers {first.all_handles}, {last.all_handles} at the end",
        held=(first.server_handles, first.all_handles) == (last.server_handles, last.all_handles),
    )


def _megabytes(first: float, last: float) -> str:
    return f"{first / 1e6:.0f} MB, {last / 1e6:.0f} at the end"

"""Answers of the soak: the same case has one key and one answer, whenever, however and by whom it is asked for."""

import hashlib
import threading

import orjson

from benchmarks.stress.bodies import to_arguments
from benchmarks.stress.faults_found import Found
from benchmarks.stress.soak_work import Work, asked
from service.schemas import TrajectoryRequest
from service.schemas.quantities import degrees
from solver import critical_angle, simulate

RESULT = b',"result":'


class Answers:
    """What each case was answered with first; all later answers are held to it.

    Parameters
    ----------
    found
        Told of what should not be.
    """

    def __init__(self, found: Found) -> None:
        self._found = found
        self._of_names: dict[str, bytes] = {}
        self._lock = threading.Lock()

    def __len__(self) -> int:
        """How many different cases were answered."""
        return len(self._of_names)

    def hold(self, name: str, answer: bytes) -> None:
        """Compare with the first answer to this case."""
        digest = hashlib.blake2b(answer, digest_size=16).digest()
        with self._lock:
            self._found.claim(self._of_names.setdefault(name, digest) == digest, f"{name} was answered in two ways")

    def hold_results(self, work: Work, lines: list[bytes], *, first: int = 0) -> int:
        """Compare results of a job, which are to be in order, each of them once; return the index that follows."""
        for index, line in enumerate(lines, first):
            head, result, answer = line.partition(RESULT)
            if not result:
                self._found.claim(None, f"{work.token}: a case has no result: {line[:300]!r}")
                continue
            told = orjson.loads(head + b"}")
            told.pop("point", None)
            right = {"index": index} | ({"custom_id": custom} if (custom := work.custom_id(index)) else {})
            self._found.claim(told == right, f"{work.token}: result {told} in place of {right}")
            if index < len(work.names):
                self.hold(work.names[index], answer[:-1])
        return first + len(lines)


def is_right(name: str, answer: bytes) -> bool:
    """Tell whether the solver says the same."""
    told = orjson.loads(answer)
    if name.startswith("search"):
        angle = critical_angle(**to_arguments(asked(name))).angle
        return bool(told.get("critical_angle_deg") == (None if angle is None else degrees(angle)))
    arguments = TrajectoryRequest.model_validate(asked(name)).arguments()
    run = simulate(**arguments)
    return bool((told["outcome"], told["maximum_depth_m"]) == (run.outcome.value, run.maximum_depth))

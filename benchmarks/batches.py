"""Answers to cases, an error in the place of a case that failed."""

from benchmarks.random_cases import Case, Cases
from solver import CriticalAngle, RicochetError, critical_angle, critical_angle_many


def answer_or_error(case: Case) -> CriticalAngle | RicochetError:
    """The answer to one case, or why there is none."""
    try:
        return critical_angle(**case)
    except RicochetError as error:
        return error


def answers_or_errors(cases: Cases, *, threads: int) -> list[CriticalAngle | RicochetError]:
    """Answers in the order of the cases."""
    return list(critical_angle_many(**cases, threads=threads))

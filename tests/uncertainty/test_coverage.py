from collections import Counter
from typing import Any

import pytest

from tests.uncertainty.functions import Ishigami, Linear, misses, run

SEEDS = 100
MOST_MISSES = 7


@pytest.mark.slow
@pytest.mark.timeout(1200)
@pytest.mark.parametrize(
    ("function", "method"),
    [(Linear(), "auto"), (Linear(), "direct"), (Ishigami(), "auto")],
    ids=["linear auto", "linear direct", "Ishigami auto"],
)
def test_true_values_are_within_their_intervals(function: Any, method: str) -> None:
    found: Counter[str] = Counter()
    for seed in range(SEEDS):
        answer = run(function, seed=seed, method=method)
        assert answer.converged
        found.update(misses(function, answer))
    print(found.most_common())  # noqa: T201 (the measured coverage)
    assert all(count <= MOST_MISSES for count in found.values())

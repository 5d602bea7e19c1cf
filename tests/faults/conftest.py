"""Skip the tests of this folder on systems without /proc, where they find the processes of a service."""

from pathlib import Path

import pytest

HERE = Path(__file__).parent


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    no_proc = pytest.mark.skipif(not Path("/proc/self/environ").exists(), reason="finds processes in /proc")
    for item in items:
        if item.path.parent == HERE:
            item.add_marker(no_proc)

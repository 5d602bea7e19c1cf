from collections.abc import AsyncIterator

import pytest

from service.pool.executor import PoolExecutor


@pytest.fixture
async def pool() -> AsyncIterator[PoolExecutor]:
    """Two warm workers, and a time limit that nothing healthy comes near."""
    executor = PoolExecutor(workers=2, task_seconds=60.0)
    await executor.start()
    yield executor
    await executor.stop(2.0)

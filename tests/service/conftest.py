from collections.abc import AsyncIterator

import pytest

from service.workers.process_pool import ProcessPool


@pytest.fixture
async def pool() -> AsyncIterator[ProcessPool]:
    """Two warm workers, and a time limit that nothing healthy comes near."""
    executor = ProcessPool(workers=2, task_seconds=60.0)
    await executor.start()
    yield executor
    await executor.stop(2.0)

"""Script: run the jobs of a folder until they are done, or until the process is killed; if there is no job, submit one.

Workers are separate processes, as in the service, and each run of a case creates a file.
"""

import asyncio
import sys
from pathlib import Path

from service.workers.process_pool import ProcessPool
from tests.service.squares import accepted, cases, ended, running

CASES = 300


async def main(folder: Path) -> None:
    pool = ProcessPool(workers=2, task_seconds=60.0)
    await pool.start()
    async with running(folder, pool) as manager:
        print("started", flush=True)  # noqa: T201
        if not await manager.jobs():
            await accepted(manager, cases(range(CASES), folder / "log", seconds=0.01))
        for job in await manager.jobs():
            await ended(manager, job)
    await pool.stop(1.0)


if __name__ == "__main__":
    asyncio.run(main(Path(sys.argv[1])))

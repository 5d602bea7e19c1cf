"""Starts a pool, keeps it busy or idle, and waits to be killed."""

import asyncio
import sys

from service.workers.process_pool import ProcessPool


async def main(task: str) -> None:
    pool = ProcessPool(workers=2, task_seconds=1000.0)
    await pool.start()
    busy = [asyncio.ensure_future(pool.submit(pow, 7, 10**8)) for _ in range(2 if task == "busy" else 0)]
    await asyncio.sleep(0.2)
    print("started", flush=True)  # noqa: T201
    await asyncio.sleep(1000.0)
    await asyncio.gather(*busy)


if __name__ == "__main__":
    asyncio.run(main(sys.argv[1]))

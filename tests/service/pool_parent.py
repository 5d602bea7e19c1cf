"""Script: start a pool with a busy and an idle worker, print the process ids of both, and wait to be killed."""

import asyncio
import hashlib

from service.workers.process_pool import ProcessPool


async def main() -> None:
    pool = ProcessPool(workers=2, task_seconds=1000.0)
    await pool.start()
    busy = asyncio.ensure_future(pool.submit(hashlib.pbkdf2_hmac, "sha256", b"", b"", 10**9))
    await asyncio.sleep(0.2)
    print(*pool.worker_pids, flush=True)  # noqa: T201
    await asyncio.sleep(1000.0)
    await busy


if __name__ == "__main__":
    asyncio.run(main())

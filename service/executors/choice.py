"""Which executor the settings ask for."""

from service.executors.face import Executor
from service.executors.in_process import InProcessExecutor
from service.pool.executor import PoolExecutor
from service.settings import Settings


def executor_for(settings: Settings) -> Executor:
    """Return what is to compute for the service; nothing runs until it is started."""
    if settings.executor == "in-process":
        return InProcessExecutor(task_seconds=settings.task_seconds)
    if settings.executor == "dask":
        from service.executors.dask import DaskExecutor  # noqa: PLC0415 (an extra that few have installed)

        return DaskExecutor(
            address=settings.dask_scheduler, workers=settings.workers, task_seconds=settings.task_seconds
        )
    return PoolExecutor(workers=settings.workers, task_seconds=settings.task_seconds)

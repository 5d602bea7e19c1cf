"""Times and answers of a service with a Dask cluster, compared with those of a service with its own pool.

    python benchmarks/cluster.py [--cases 2000] [--quick]

The same batches go to a service with a pool of two workers, and to one whose batches are computed on a Dask cluster of
two workers over TCP: critical angles of a study, and short trajectories, for which the overhead of service and cluster
is a larger part of the time. All processes share the cores of this machine. Takes about two minutes; `--quick` uses 100
cases.
"""

import argparse
import sys
from typing import Any

from distributed import LocalCluster

from benchmarks.clients import Batch, run_batch, to_request
from benchmarks.machine import print_machine, print_table
from benchmarks.random_cases import one_by_one, study_cases
from benchmarks.servers import Server, service
from solver import warm_up

WORKERS = 2
SEED = 3


def measure(server: Server, count: int) -> dict[str, Batch]:
    searches = [to_request(case) for case in one_by_one(study_cases(count + 200, SEED))]
    run_batch(server, "/cra/batch", searches[count:])  # This warms up the workers.
    short = [case | {"impact": case["impact"] | {"oblique_angle_deg": 80.0}} for case in searches[:count]]
    return {
        "critical angles of a study": run_batch(server, "/cra/batch", searches[:count]),
        "trajectories at 80°": run_batch(server, "/trajectory/batch", short),
    }


def main() -> int:
    parser = argparse.ArgumentParser(description="Compare a Dask cluster with the pool.")
    parser.add_argument("--cases", type=int, default=2_000)
    parser.add_argument("--quick", action="store_true", help="compute 100 cases")
    options = parser.parse_args()
    print_machine()
    warm_up()
    count = 100 if options.quick else options.cases
    with service(workers=str(WORKERS)) as server:
        pool = measure(server, count)
    with (
        LocalCluster(  # type: ignore[no-untyped-call]
            n_workers=WORKERS, threads_per_worker=1, protocol="tcp://", dashboard_address=None
        ) as dask,
        service(workers=str(WORKERS), executor="dask", dask_scheduler=dask.scheduler_address) as server,
    ):
        cluster = measure(server, count)
    rows, different = list[list[Any]](), 0
    for name, batch in pool.items():
        changed = sum(one != other for one, other in zip(batch.results, cluster[name].results, strict=True))
        times = [1e3 * found.seconds / count for found in (batch, cluster[name])]
        rows.append([f"{count:,} {name}", *(f"{each:.2f} ms" for each in times), f"{times[0] / times[1]:.0%}", changed])
        different += changed
    print_table(["batch", "pool, a case", "cluster, a case", "throughput kept", "different"], rows)
    return 1 if different else 0


if __name__ == "__main__":
    sys.exit(main())

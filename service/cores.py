"""Number of cores that this process may use, from its CPU affinity and the quota of its control group."""

import math
import os
from contextlib import suppress
from pathlib import Path

CONTROL_GROUPS = Path("/sys/fs/cgroup")
"""Mount point of control groups version 2. With version 1, its folder `cpu` has the quotas."""
MEMBERSHIP = Path("/proc/self/cgroup")
"""File that names the control groups of this process. In a container the path is usually `/`."""


def available_cores(control_groups: Path = CONTROL_GROUPS, membership: Path = MEMBERSHIP) -> int:
    """Return the number of cores that this process may use, within the quota of its container or systemd unit."""
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    groups = {"": "", "cpu": ""}
    with suppress(OSError, ValueError):
        for line in membership.read_text().splitlines():
            _, controllers, path = line.split(":", 2)
            groups |= dict.fromkeys(controllers.split(","), path.strip("/"))
    for controller, names in (("", ("cpu.max",)), ("cpu", ("cpu.cfs_quota_us", "cpu.cfs_period_us"))):
        inside = Path(groups[controller])
        for group in (inside, *inside.parents):  # The kernel also enforces the quotas of all parent groups.
            with suppress(OSError, ValueError):
                folder = control_groups / controller / group
                quota, period = " ".join((folder / name).read_text() for name in names).split()
                if int(quota) > 0:  # Without a quota it is -1 in version 1 and "max" in version 2.
                    cores = min(cores, math.ceil(int(quota) / int(period)))
    return cores

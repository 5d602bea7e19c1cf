"""The default number of workers: the cores that this process may use by its affinity and its control group."""

import os
from pathlib import Path

import pytest

from service.cores import available_cores

HERE = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def write(folder: Path, files: dict[str, str]) -> Path:
    for name, text in files.items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_text(text)
    return folder


@pytest.mark.parametrize(
    ("files", "cores"),
    [
        ({"cpu.max": "50000 100000\n"}, 1),
        ({"cpu.max": f"{100000 * HERE - 50000} 100000\n"}, HERE),
        ({"cpu.max": "max 100000\n"}, HERE),
        ({"cpu.max": "9900000 100000\n"}, min(HERE, 99)),
        ({"cpu/cpu.cfs_quota_us": "100000\n", "cpu/cpu.cfs_period_us": "100000\n"}, 1),
        ({"cpu/cpu.cfs_quota_us": "-1\n", "cpu/cpu.cfs_period_us": "100000\n"}, HERE),
        ({}, HERE),
    ],
    ids=["half a core", "half a core less", "no quota", "more than there are", "version 1", "version 1, none", "none"],
)
def test_processor_quota_of_the_container_limits_the_workers(files: dict[str, str], cores: int, tmp_path: Path) -> None:
    assert available_cores(write(tmp_path, files)) == cores


@pytest.mark.skipif(HERE < 2, reason="a quota of one core is no limit here")
@pytest.mark.parametrize(
    ("group", "files"),
    [
        ("0::/system.slice/a.service", {"system.slice/a.service/cpu.max": "100000 100000\n"}),
        ("0::/a.slice/b.scope", {"a.slice/cpu.max": "100000 100000\n", "a.slice/b.scope/cpu.max": "max 100000\n"}),
        (
            "7:memory:/x\n4:cpu,cpuacct:/a/b",
            {"cpu/a/b/cpu.cfs_quota_us": "100000\n", "cpu/a/b/cpu.cfs_period_us": "100000\n"},
        ),
    ],
    ids=["unit of systemd", "slice above", "version 1"],
)
def test_processor_quotas_of_all_enclosing_groups_limit_the_workers(
    group: str, files: dict[str, str], tmp_path: Path
) -> None:
    membership = tmp_path / "membership"
    membership.write_text(group + "\n")
    assert available_cores(write(tmp_path / "groups", files), membership) == 1

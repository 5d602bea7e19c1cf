"""Script: store 10,000 batches of results in a folder, evicting the oldest, unless the process is killed first."""

import os
import sys
from pathlib import Path

import numpy as np

from service.cache.cache import ResultCache
from service.cache.record import Record

cache = ResultCache(Path(sys.argv[1]), memory_bytes=0, disk_bytes=int(sys.argv[2]))
rows = {"time_s": np.random.default_rng(0).normal(size=4000)}
for _ in range(10_000):
    cache.put_many([Record(os.urandom(32).hex(), "trajectory", b"{}", {}, rows) for _ in range(5)])
    sys.stdout.write("stored\n")
    sys.stdout.flush()

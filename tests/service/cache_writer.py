"""Writes one result after the other into a folder until it is killed."""

import os
import sys
from pathlib import Path

import numpy as np

from service.cache import ResultCache
from service.record import Record

cache = ResultCache(Path(sys.argv[1]), memory_bytes=0)
for _ in range(10_000):
    cache.put(Record(os.urandom(32).hex(), "trajectory", {}, {}, {"time_s": np.ones(20_000)}, "1", "1"))

"""Imported by the fork server alone: what is loaded and compiled here, every worker inherits without cost."""

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # before numpy; the workers already fill the cores

from solver import warm_up

warm_up()

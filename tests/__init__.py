"""Tests of lunarsim."""

import os

# `make test` has two processes on two cores: threads of BLAS would only wait for each other.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

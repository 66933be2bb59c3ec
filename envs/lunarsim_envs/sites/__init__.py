"""Site selection over a pool of worlds, flown by compiled kernels."""

"""Where to land, decided over a pool of worlds and flown by kernels."""

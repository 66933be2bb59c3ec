"""Calibrated safety of the Gaussian DEM, the quadtree and the fused map."""

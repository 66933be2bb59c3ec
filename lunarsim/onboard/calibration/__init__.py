"""Calibrated p_safe of the Gaussian DEM, the quadtree and the fused map."""

"""Calibrated probabilities of landing safety of the Gaussian DEM, quadtree and fused map."""

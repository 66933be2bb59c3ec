"""Compiled functions that the simulation and the batched environments share."""

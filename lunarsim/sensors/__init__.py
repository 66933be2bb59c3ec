"""Sensors: each converts the true world and state to a measurement with its own noise model."""

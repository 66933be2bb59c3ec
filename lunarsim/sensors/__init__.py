"""Sensors: each turns the true world and state into a measurement with its own noise figures."""

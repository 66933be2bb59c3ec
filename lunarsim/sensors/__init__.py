"""Sensors: each converts the true world and state to a noisy measurement."""

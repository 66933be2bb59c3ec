"""Descents that an agent flies itself; one kernel flies one lander or thousands in parallel."""

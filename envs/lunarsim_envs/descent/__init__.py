"""Descents flown by the agent itself: one kernel for one lander or for thousands side by side."""

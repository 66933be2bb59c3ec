"""Paths that are chosen for what they let the lander see."""

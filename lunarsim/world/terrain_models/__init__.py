"""Terrain models that scenarios choose from, each with its settings."""

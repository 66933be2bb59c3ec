"""Descents of least propellant: the yardstick of every guidance law."""

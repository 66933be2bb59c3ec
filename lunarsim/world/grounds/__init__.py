"""Terrain models that scenarios choose from; each file has the settings and the builder of one."""

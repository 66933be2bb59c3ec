"""Grounds that scenarios choose from, each a part: settings and building in one file."""

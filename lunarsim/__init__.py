"""Closed-loop lunar descent: terrain, sensing, hazard maps, retargeting, guidance, touchdown."""

__version__ = "0.1.0"

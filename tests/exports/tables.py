"""Vectors of the tables of a flight record."""

import numpy as np


def columns(table, name, axes="xyz"):
    """Return a vector or quaternion (n, axes) from the columns of a table."""
    return np.column_stack([table[f"{name}_{axis}"] for axis in axes])

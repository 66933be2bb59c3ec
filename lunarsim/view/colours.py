"""Colours of hazard maps and terrain, legible to colour-blind people."""

from __future__ import annotations

import matplotlib as mpl
import numpy as np
from matplotlib.colors import to_rgb
from numpy.typing import ArrayLike, NDArray

from lunarsim.onboard.hazards.hazard_map import HazardMap
from lunarsim.viz.style import COLOURS

Image = NDArray[np.uint8]

# The palette of the figures (Okabe and Ito) as RGB, by role.
TRUTH, ESTIMATE, SITE, COMMAND, FUEL, LIDAR = (
    tuple(round(255 * c) for c in to_rgb(name)) for name in COLOURS[:6]
)
LIMIT = (150, 150, 150)
# Cells that a map has not observed.
UNKNOWN = (128, 128, 128)


def p_safe_colours(p_safe: ArrayLike) -> Image:
    """Return RGB colours (..., 3) of probabilities (...,): viridis from 0 to 1."""
    rgba = mpl.colormaps["viridis"](np.asarray(p_safe, dtype=np.float64), bytes=True)
    return np.asarray(rgba[..., :3], dtype=np.uint8)


def hazard_map_image(hazard_map: HazardMap) -> Image:
    """Return an RGB image (rows, cols, 3) of a hazard map, with north at the top.

    Observed cells have the colour of `p_safe`, others are grey.
    """
    image = p_safe_colours(hazard_map.p_safe)
    image[~hazard_map.observed] = UNKNOWN
    return np.ascontiguousarray(image[::-1])

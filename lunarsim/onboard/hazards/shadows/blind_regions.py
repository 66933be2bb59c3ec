"""Parts of a picture in which nothing would show: what they show lit tells of no clear ground.

A picture is judged as a whole, by the best that it shows. A part of it may show nothing all the
same: saturated, behind dust or dirt, out of focus, read out wrongly. There shadows are missing that
the rest of the picture has. Ground on which rocks are few looks so too, and is not seen either
where the picture has many: nothing tells the two apart but the next picture from lower down.
"""

from __future__ import annotations

from itertools import product
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.special import pdtr

from lunarsim.models.camera import CameraModel
from lunarsim.onboard.hazards.shadows.viewing_geometry import viewing_geometry
from lunarsim.onboard.perception.along_plane import model_on_plane
from lunarsim.onboard.perception.detector import Detections
from lunarsim.onboard.perception.ground_plane import GroundPlane
from lunarsim.onboard.perception.shadow_model import ShadowModel
from lunarsim.onboard.perception.shape_mixture import ShapeMixture
from lunarsim.rocks.laws import golombek_number

Array = NDArray[np.float64]

# The picture is cut into so many rows and columns.
ROWS, COLS = 12, 16
# Sides of the windows of these in which shadows are counted.
_WINDOW_ROWS, _WINDOW_COLS = (3, 4, 6, 9, 12), (4, 6, 8, 11, 16)
# A window is blind if chance leaves so few in it less often than this, were they this share of what
# the rest of the picture has: rocks come in clusters.
_MAX_CHANCE, _CLUSTERING_FACTOR = 1e-3, 0.5
# Root of the dark pixels of the least shadow that is found.
_MIN_Q = 2.0
# Saturated patches count that are wider than this, pixels; and ground about them as far.
_GLARE_PX = 5


def cell_centres(width: int, height: int) -> Array:
    """Return the pixels in the middle of the cells of a picture, row after row (cells, 2)."""
    u = (np.arange(COLS) + 0.5) * width / COLS - 0.5
    v = (np.arange(ROWS) + 0.5) * height / ROWS - 0.5
    return np.stack(np.meshgrid(u, v), -1).reshape(-1, 2)


def ground_of_cells(
    camera: CameraModel,
    points: Array,
    camera_position: Array,
    sun: Array,
    plane: GroundPlane,
    model: ShadowModel | ShapeMixture,
) -> tuple[Array, Array]:
    """Return how sharply cells show rocks, and their ground, as `expected_shares` has it (cells,).

    Parameters
    ----------
    camera
        Whose picture it is.
    points
        Ground in the `middles` of the cells (cells, 3), m; NaN for none.
    eye
        Place of the camera (3,), m.
    sun, plane
        Direction towards the Sun (3,), ENU, and the ground along which shadows fall.
    model
        What shadows rocks have.
    """
    focal = float(np.sqrt(camera.fx * camera.fy))
    azimuth, depression, pixel = viewing_geometry(points, camera_position, focal, sun, plane)
    sharpness = model_on_plane(model, plane, sun).visible_pixels(1.0, azimuth, depression, pixel)
    # A pixel off the boresight sees less of the sky, by the cube of the cosine.
    off = cell_centres(camera.width, camera.height) - [camera.cx, camera.cy]
    solid = (1.0 + ((off / [camera.fx, camera.fy]) ** 2).sum(1)) ** -1.5
    pixels = camera.width * camera.height / len(points)
    return sharpness, pixels * solid * pixel**2 / np.sin(depression)


def expected_shares(sharpness: Array, area: Array, cover: float) -> Array:
    """Return what number of shadows cells should have, but for a factor (2, cells).

    Once as the law of sizes has it for the least rock that shows there, once as if all rocks
    showed everywhere: the law ends somewhere.

    Parameters
    ----------
    sharpness
        Root of the dark pixels of a rock of radius 1 m there (cells,); 0 or NaN where there is no
        ground.
    area
        Of the ground in the cells (cells,), m^2.
    cover
        Share of the ground under rocks (Golombek).
    """
    shown = np.isfinite(area) & (sharpness > 0.0)
    least = 2.0 * _MIN_Q / np.where(shown, sharpness, 1.0)
    ground = np.where(shown, area, 0.0)
    return np.stack((ground * golombek_number(least, cover), ground))


def empty_cells(found: NDArray[np.int64], expected: Array) -> NDArray[np.bool_]:
    """Return the cells that lie in a window with far fewer shadows than the rest has.

    Parameters
    ----------
    found
        Shadows in each cell (ROWS, COLS).
    expected
        By one law or another, but for a factor (laws, ROWS, COLS): a window must be too empty by
        each.
    """
    out = np.zeros(found.shape, np.bool_)
    count = _corner_sums(found[None].astype(np.float64))[0]
    share = _corner_sums(expected)
    for high, wide in product(_WINDOW_ROWS, _WINDOW_COLS):
        inside = _in_windows(count, high, wide)
        due = _in_windows(share, high, wide)
        rest = count[-1, -1] - inside
        left = np.maximum(share[:, -1:, -1:] - due, 1e-300)
        number = (rest * due / left).min(0)
        empty = (due.min(0) > 0.0) & (pdtr(inside, _CLUSTERING_FACTOR * number) < _MAX_CHANCE)
        for i, j in zip(*np.nonzero(empty), strict=True):
            out[i : i + high, j : j + wide] = True
    return out


def _corner_sums(values: Array) -> Array:
    """Return sums over all that is above and left of corners (n, rows + 1, cols + 1)."""
    out = np.zeros((len(values), values.shape[1] + 1, values.shape[2] + 1))
    out[:, 1:, 1:] = values.cumsum(1).cumsum(2)
    return out


def _in_windows(sums: Array, high: int, wide: int) -> Array:
    """Return the sums over windows by where they begin (..., rows, cols)."""
    low, top = sums[..., high:, :], sums[..., :-high, :]
    return np.asarray(low[..., wide:] - low[..., :-wide] - top[..., wide:] + top[..., :-wide])


def glare(counts: NDArray[Any]) -> NDArray[np.bool_]:
    """Return which pixels (height, width) lie in or beside large patches of the greatest count."""
    most = (counts >= np.nanmax(counts)).astype(np.uint8)
    inner = cv2.erode(most, np.ones((_GLARE_PX, _GLARE_PX), np.uint8))
    side = 3 * _GLARE_PX
    return np.asarray(cv2.dilate(inner, np.ones((side, side), np.uint8)) > 0)


def blind_regions(
    counts: NDArray[Any], seen: Detections, sharpness: Array, area: Array, cover: float
) -> NDArray[np.bool_]:
    """Return in which pixels (height, width) nothing would show.

    Parameters
    ----------
    counts
        The picture (height, width).
    seen
        What was found in it.
    sharpness, area, cover
        See `expected_shares`; of the cells about `middles`.
    """
    height, width = counts.shape
    found = np.histogram2d(
        seen.pixel[:, 1], seen.pixel[:, 0], (ROWS, COLS),
        ((-0.5, height - 0.5), (-0.5, width - 0.5)),
    )[0].astype(np.int64)  # fmt: skip
    expected = expected_shares(sharpness, area, cover).reshape(2, ROWS, COLS)
    empty = empty_cells(found, expected).astype(np.uint8)
    blind = cv2.resize(empty, (width, height), interpolation=cv2.INTER_NEAREST) > 0
    return np.asarray(blind | glare(counts))

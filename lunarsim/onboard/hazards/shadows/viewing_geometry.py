"""Viewing geometry of shadows, and image regions where they would be invisible.

The quality check uses the best parts of an image. A region may still be useless: saturated, behind
dust or dirt, out of focus, or read out wrongly. Such a region lacks the shadows that the rest of
the image has. Terrain with few rocks has the same appearance and is also excluded if the rest of
the image has many. Only an image from a lower altitude can separate the two.
"""

from __future__ import annotations

from itertools import product
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.special import pdtr

from lunarsim.models.camera import CameraModel
from lunarsim.onboard.perception.detector import Detections
from lunarsim.onboard.perception.ground_plane import GroundPlane
from lunarsim.onboard.perception.plane_models import model_on_plane
from lunarsim.onboard.perception.shadow_model import ShadowModel
from lunarsim.onboard.perception.shape_mixture import ShapeMixture
from lunarsim.rocks.size_distribution import golombek_number
from lunarsim.typing import Array, BoolArray, IntArray

# Minimum height of the camera above the terrain, m.
_MIN_HEIGHT_M = 1e-3


def viewing_geometry(
    xyz: Array, camera_position: Array, focal: float, sun: Array, plane: GroundPlane
) -> tuple[Array, Array, Array]:
    """Return the camera's azimuth from the Sun, depression and pixel size at rocks.

    Angles (...) are in rad and pixel sizes (...) in m. On a slope they are the values at which
    horizontal terrain would look the same.

    Parameters
    ----------
    xyz
        Positions of the rocks (..., 3), m.
    camera_position, focal
        Position of the camera (3,), m, and focal length, pixels.
    sun
        Direction towards the Sun (3,), ENU.
    plane
        Plane of the terrain.
    """
    to_camera = camera_position - xyz
    to_camera[..., 2] = np.maximum(to_camera[..., 2], _MIN_HEIGHT_M)
    horizontal = np.hypot(to_camera[..., 0], to_camera[..., 1])
    azimuth = np.arctan2(to_camera[..., 0], to_camera[..., 1]) - np.arctan2(sun[0], sun[1])
    pixel = np.hypot(horizontal, to_camera[..., 2]) / focal
    if plane.is_horizontal:
        return azimuth, np.arctan2(to_camera[..., 2], horizontal), pixel
    levelled_to_camera = plane.level_vectors(to_camera)
    levelled_to_camera[..., 2] = np.maximum(levelled_to_camera[..., 2], _MIN_HEIGHT_M)
    return (
        azimuth,
        np.arctan2(levelled_to_camera[..., 2], horizontal),
        plane.equivalent_pixel(pixel, to_camera, levelled_to_camera),
    )


# Rows and columns of cells into which the image is divided.
ROWS, COLS = 12, 16
# Sides of the windows, in cells, in which shadows are counted.
_WINDOW_ROWS, _WINDOW_COLS = (3, 4, 6, 9, 12), (4, 6, 8, 11, 16)
# A window is blind if the probability of so few shadows is below the first value, given the second
# fraction of the density elsewhere, because rocks are clustered.
_MAX_CHANCE, _CLUSTERING_FACTOR = 1e-3, 0.5
# Minimum q of a detected shadow.
_MIN_Q = 2.0
# Minimum width of saturated patches, and width of the region excluded around them, pixels.
_GLARE_PX = 5


def cell_centres(width: int, height: int) -> Array:
    """Return the pixels at the centres of 12 x 16 image cells, row by row (cells, 2).

    `width` and `height` are the size of the image, pixels.
    """
    u = (np.arange(COLS) + 0.5) * width / COLS - 0.5
    v = (np.arange(ROWS) + 0.5) * height / ROWS - 0.5
    return np.stack(np.meshgrid(u, v), -1).reshape(-1, 2)


def sharpness_and_area_of_cells(
    camera: CameraModel,
    points: Array,
    camera_position: Array,
    sun: Array,
    plane: GroundPlane,
    model: ShadowModel | ShapeMixture,
) -> tuple[Array, Array]:
    """Return shadow sharpness and terrain area of image cells, both (cells,).

    Sharpness is the square root of the number of dark pixels of a rock of radius 1 m; the area is
    in m^2. `relative_shadow_counts` uses both.

    Parameters
    ----------
    camera
        Camera model.
    points
        Terrain points at the `cell_centres` (cells, 3), m; NaN for none.
    camera_position
        Position of the camera (3,), m.
    sun, plane
        Direction towards the Sun (3,), ENU, and the plane on which shadows fall.
    model
        Model of the shadows of rocks.
    """
    focal = float(np.sqrt(camera.fx * camera.fy))
    azimuth, depression, pixel = viewing_geometry(points, camera_position, focal, sun, plane)
    sharpness = model_on_plane(model, plane, sun).visible_q(1.0, azimuth, depression, pixel)
    # The solid angle of a pixel decreases with the cube of the cosine off the boresight.
    off = cell_centres(camera.width, camera.height) - [camera.cx, camera.cy]
    solid = (1.0 + ((off / [camera.fx, camera.fy]) ** 2).sum(1)) ** -1.5
    pixels = camera.width * camera.height / len(points)
    return sharpness, pixels * solid * pixel**2 / np.sin(depression)


def relative_shadow_counts(sharpness: Array, area: Array, cover: float) -> Array:
    """Return expected numbers of shadows in image cells, up to a factor (2, cells).

    Row 0 follows the size distribution of rocks above the smallest visible size. Row 1 is the
    terrain area, as if all rocks were visible everywhere, because the distribution does not hold
    for very small rocks. `sharpness` (cells,) is the square root of the number of dark pixels of a
    rock of radius 1 m, 0 or NaN without terrain, and `area` (cells,) the terrain area, m^2. `cover`
    is the fraction of the terrain covered by rocks (Golombek size distribution).
    """
    shown = np.isfinite(area) & (sharpness > 0.0)
    min_diameter = 2.0 * _MIN_Q / np.where(shown, sharpness, 1.0)
    terrain_area = np.where(shown, area, 0.0)
    return np.stack((terrain_area * golombek_number(min_diameter, cover), terrain_area))


def empty_cells(shadow_counts: IntArray, expected: Array) -> BoolArray:
    """Return the image cells in windows with far fewer shadows than the rest.

    The result has shape (ROWS, COLS).

    Parameters
    ----------
    shadow_counts
        Number of shadows in each cell (ROWS, COLS).
    expected
        Expected number of shadows, up to a factor, by each of several assumptions about sizes (k,
        ROWS, COLS). A window must have too few shadows under all of them.
    """
    out = np.zeros(shadow_counts.shape, np.bool_)
    count = _summed_area_table(shadow_counts[None].astype(np.float64))[0]
    share = _summed_area_table(expected)
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


def _summed_area_table(values: Array) -> Array:
    """Return the sum of all cells before each corner, for fast sums over windows.

    `values` has shape (n, rows, cols), the result (n, rows + 1, cols + 1).
    """
    out = np.zeros((len(values), values.shape[1] + 1, values.shape[2] + 1))
    out[:, 1:, 1:] = values.cumsum(1).cumsum(2)
    return out


def _in_windows(corner_sums: Array, row_count: int, col_count: int) -> Array:
    """Return the sums over all windows of a size (..., rows, cols).

    `corner_sums` is the result of `_summed_area_table`, and a window has `row_count` x `col_count`
    cells. The result is indexed by the first cell of the window.
    """
    low, top = corner_sums[..., row_count:, :], corner_sums[..., :-row_count, :]
    return np.asarray(
        low[..., col_count:] - low[..., :-col_count] - top[..., col_count:] + top[..., :-col_count]
    )


def glare(counts: NDArray[Any]) -> BoolArray:
    """Return which pixels are in or near large saturated patches (height, width).

    `counts` (height, width) is the image. Pixels at the image's maximum count as saturated, and a
    patch is large if it contains a square of 5 x 5 pixels.
    """
    most = (counts >= np.nanmax(counts)).astype(np.uint8)
    inner = cv2.erode(most, np.ones((_GLARE_PX, _GLARE_PX), np.uint8))
    side = 3 * _GLARE_PX
    return np.asarray(cv2.dilate(inner, np.ones((side, side), np.uint8)) > 0)


def blind_regions(
    counts: NDArray[Any], detections: Detections, sharpness: Array, area: Array, cover: float
) -> BoolArray:
    """Return the pixels in which rock shadows would not be visible (height, width).

    These are large saturated patches, and cells with far fewer shadows than the rest of the image.

    Parameters
    ----------
    counts
        Image (height, width).
    detections
        Rocks detected in the image.
    sharpness, area, cover
        Sharpness and terrain area of the image cells, from `sharpness_and_area_of_cells` (cells,),
        and the fraction of the terrain covered by rocks.
    """
    height, width = counts.shape
    shadow_counts = np.histogram2d(
        detections.pixel[:, 1], detections.pixel[:, 0], (ROWS, COLS),
        ((-0.5, height - 0.5), (-0.5, width - 0.5)),
    )[0].astype(np.int64)  # fmt: skip
    expected = relative_shadow_counts(sharpness, area, cover).reshape(2, ROWS, COLS)
    empty = empty_cells(shadow_counts, expected).astype(np.uint8)
    blind = cv2.resize(empty, (width, height), interpolation=cv2.INTER_NEAREST) > 0
    return np.asarray(blind | glare(counts))

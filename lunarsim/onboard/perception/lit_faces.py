"""Lit faces of rocks beside their shadows under a high Sun.

Under a low Sun the face towards the Sun is the brightest part of the scene. At 45 deg an upright
face is at most as bright as horizontal terrain. Most faces are darker, some so dark that they are
taken for shadow; rounded and faceted rocks are similar. But faces are lit, and shadow is not:
within and around the dark patch, pixels that are neither black nor as bright as the terrain lie on
the Sun's side of the black ones. The directions for which this holds, and the lateral shift by
faces towards the camera, are tabulated here by ray casting. Terrain and rocks are taken as
Lambertian with equal albedo, because only the side of the black pixels matters.

Under a lower Sun this does not hold: the tips of long shadows are filled with light by the optics,
which makes them grey on the wrong side.
"""

from __future__ import annotations

from functools import lru_cache
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import RegularGridInterpolator

from lunarsim.frames import direction_from_angles
from lunarsim.onboard.perception.shadow_model import (
    ShadowModel,
    shadow_reach,
    visible_points_around_rock,
)
from lunarsim.rocks.field import RockModel
from lunarsim.rocks.rock_on_plane import RockOnPlane
from lunarsim.typing import Array

Complex = NDArray[np.complex128]

# Minimum Sun elevation at which grey pixels are lit faces, not tips of shadows.
LEAST_ELEVATION = float(np.deg2rad(40.0))
# Faces below this fraction of the terrain's brightness are taken for shadow; it lies between the
# thresholds for large and small shadows.
DARK = 0.56
# Black pixels are darker than the first value and are weighted by the difference. Grey pixels are
# brighter than the second and are weighted by the difference, up to the third.
BLACK, GREY, MOST_GREY = 0.35, 0.15, 0.5
# Bright pixels exceed the terrain by more than this factor.
_BRIGHT_RATIO = 1.05
# Tabulated camera directions, rad; rocks of each shape, and samples across a radius.
_DEPRESSIONS = np.radians([15.0, 30.0, 45.0, 60.0, 75.0, 90.0])
_AZIMUTHS = np.radians(np.arange(-180.0, 181.0, 30.0))
_ROCKS_PER_SHAPE, _SAMPLES_PER_RADIUS = 12, 8
# Minimum area of black and of grey to be visible, in squared radii.
_MIN_AREA = 0.02
# Blur of optics and pixels, in radii, for a radius of about three pixels.
_BLUR_RADII = 0.22


def lit_faces(model: ShadowModel, azimuth: Any, depression: Any) -> tuple[Complex, Complex]:
    """Return the expected directions of lit rock faces and dark patches, high Sun.

    Both are means over a population of rocks. Directions are complex numbers in the terrain plane:
    the real axis points towards the Sun, the imaginary axis to the left of it.

    Parameters
    ----------
    model
        Shadow model of the rocks, which defines Sun elevation and shapes.
    azimuth, depression
        Azimuth of the camera from the rock minus that of the Sun, clockwise from above, and
        depression of the line of sight (n,), rad.

    Returns
    -------
    direction
        Mean direction from lit faces to black pixels (n,); length 1 if it is equal for all rocks, 0
        if it is random.
    axis
        Mean axis of dark patches including dark faces (n,), at twice the angle; length 1 for lines,
        0 for round patches.
    """
    turn = np.mod(np.asarray(azimuth, dtype=np.float64) + np.pi, 2.0 * np.pi) - np.pi
    down = np.clip(depression, _DEPRESSIONS[0], _DEPRESSIONS[-1])
    table = _direction_table(round(model.elevation, 3), model.shapes)
    found = RegularGridInterpolator((_AZIMUTHS, _DEPRESSIONS), table)(np.column_stack((turn, down)))
    return np.asarray(found[:, 0]), np.asarray(found[:, 1])


@lru_cache(maxsize=32)
def _direction_table(elevation: float, shapes: RockModel) -> Complex:
    """Tabulate the mean directions of faces and patches for a population of rocks.

    `elevation` is that of the Sun, rad. The result has shape (azimuths, depressions, 2).
    """
    field = shapes.draw(np.full(_ROCKS_PER_SHAPE, 2.0), np.random.default_rng(1966))
    scenes = [RockOnPlane(field, k) for k in range(len(field))]
    sun = direction_from_angles(0.0, elevation)
    out = np.zeros((_AZIMUTHS.size, _DEPRESSIONS.size, 2), np.complex128)
    for i, azimuth in enumerate(_AZIMUTHS[:-1]):
        for j, depression in enumerate(_DEPRESSIONS):
            camera = direction_from_angles(azimuth, depression)
            out[i, j] = np.mean([_directions_of_rock(one, sun, camera) for one in scenes], axis=0)
    out[-1] = out[0]
    return out


def _directions_of_rock(scene: RockOnPlane, sun: Array, camera: Array) -> tuple[complex, complex]:
    """Return image directions of one rock: lit face to shadow, and long dark axis.

    The first points from the lit face to the black shadow; the second is the squared direction of
    the long axis of the dark patch. Both are complex numbers in the terrain plane, 0 where not
    visible; the real axis points towards the Sun. `sun` and `camera` (3,) are directions, with the
    Sun in the north. `scene` is the rock on a plane.
    """
    place, brightness = _render(scene, sun, camera)
    dark = brightness < DARK
    if dark.sum() < _MIN_AREA * _SAMPLES_PER_RADIUS**2:
        return 0.0, 0.0
    away = place[dark] - place[dark].mean()
    axis = (away**2).sum() / (abs(away) ** 2).sum()
    black = np.clip(BLACK - brightness, 0.0, None)
    grey = np.where(dark, np.clip(brightness - GREY, 0.0, MOST_GREY), 0.0)
    lit = grey + np.clip(brightness - _BRIGHT_RATIO, 0.0, 1.0)
    if min(lit.sum(), black.sum()) < _MIN_AREA * _SAMPLES_PER_RADIUS**2:
        return 0.0, axis
    gap = (black @ place) / black.sum() - (lit @ place) / lit.sum()
    return gap / max(abs(gap), 1e-9), axis


def _render(scene: RockOnPlane, sun: Array, camera: Array) -> tuple[Complex, Array]:
    """Render a rock; return positions on the terrain and their brightness, both (n,).

    `sun` and `camera` (3,) are directions, with the Sun in the north; `scene` is the rock on a
    plane. Positions are complex, north real and west imaginary, in rock radii. Brightness is
    relative to horizontal terrain and blurred.
    """
    reach = shadow_reach(float(np.arcsin(sun[2])))
    shape, position, point, normal = visible_points_around_rock(
        scene, camera, reach, 1.0 / _SAMPLES_PER_RADIUS
    )
    brightness = np.clip(normal @ sun, 0.0, None) / sun[2]
    at = np.flatnonzero(brightness > 0.0)
    shaded = np.isfinite(scene.cast(point[at], np.broadcast_to(sun, (at.size, 3)))[0])
    brightness[at[shaded]] = 0.0
    image = brightness.reshape(shape)
    blurred = cv2.GaussianBlur(
        image, (0, 0), _BLUR_RADII * _SAMPLES_PER_RADIUS, borderType=cv2.BORDER_REPLICATE
    )
    return position[:, 1] - 1j * position[:, 0], blurred.ravel()

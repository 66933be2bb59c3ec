"""Where a rock's lit faces show beside its shadow, under a Sun so high that they are no brighter.

Under a low Sun the face turned towards it is the brightest thing about. At 45 deg an upright face
is as bright as level ground at best, and most are darker, some so dark that they pass for shadow;
the rounded and faceted ones fare little better. But they are lit, and shadow is not: within the
dark patch and about it, what is neither black nor as bright as the ground lies on the Sun's side of
what is black. From which directions that is so, and how far to the side the faces turned to the
camera draw it, is tabulated here by casting rays. Ground and rocks are taken to reflect alike, by
Lambert's law: of the true law only the side of the black counts.

Under a lower Sun this does not hold. Long shadows end in tips that optics fill with light: grey
that lies on the wrong side.
"""

from __future__ import annotations

from functools import lru_cache
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import RegularGridInterpolator

from lunarsim.frames import direction_from_angles
from lunarsim.onboard.perception.shadow_model import ShadowModel, ground_about, shadow_reach
from lunarsim.rocks.field import RockModel
from lunarsim.rocks.level_ground import RockOnLevelGround

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]

# From this elevation on grey is a lit face, not the tip of a shadow.
LEAST_ELEVATION = float(np.deg2rad(40.0))
# Below this share of the ground's brightness a face passes for shadow: between the thresholds for
# large shadows and small ones.
DARK = 0.56
# Black is darker than this, by so much; grey is brighter than this, and counts by what it has more,
# up to so much.
BLACK, GREY, MOST_GREY = 0.35, 0.15, 0.5
# Bright is what is brighter than the ground by more than this.
_BRIGHT_RATIO = 1.05
# Directions of the camera that are tabulated, rad; rocks of each shape, samples across a radius.
_DEPRESSIONS = np.radians([15.0, 30.0, 45.0, 60.0, 75.0, 90.0])
_AZIMUTHS = np.radians(np.arange(-180.0, 181.0, 30.0))
_ROCKS_PER_SHAPE, _SAMPLES_PER_RADIUS = 12, 8
# Black and grey of less area than this, in squares of a radius, do not show.
_MIN_AREA = 0.02
# What optics and pixels blur, in radii, where a radius is some three pixels.
_BLUR_RADII = 0.22


def lit_faces(model: ShadowModel, azimuth: Any, depression: Any) -> tuple[Complex, Complex]:
    """Return how faces and patches of a population lie under a high Sun, on average.

    As vectors on the ground, of which the real axis points towards the Sun and the imaginary one to
    the left of it.

    Parameters
    ----------
    model
        Of the rocks.
    azimuth, depression
        See `ShadowModel.patch` (n,), rad.

    Returns
    -------
    direction
        From lit faces to what is black (n,); of length 1 where it is the same for all rocks, 0
        where it may be any.
    axis
        Of dark patches (n,), faces that pass for shadow among them, at twice the angle; of length
        1 for lines, 0 for round ones.
    """
    turn = np.mod(np.asarray(azimuth, dtype=np.float64) + np.pi, 2.0 * np.pi) - np.pi
    down = np.clip(depression, _DEPRESSIONS[0], _DEPRESSIONS[-1])
    table = _table(round(model.elevation, 3), model.shapes)
    found = RegularGridInterpolator((_AZIMUTHS, _DEPRESSIONS), table)(np.column_stack((turn, down)))
    return np.asarray(found[:, 0]), np.asarray(found[:, 1])


@lru_cache(maxsize=32)
def _table(elevation: float, shapes: RockModel) -> Complex:
    """Return direction and axis (azimuths, depressions, 2) of a population."""
    field = shapes.draw(np.full(_ROCKS_PER_SHAPE, 2.0), np.random.default_rng(1966))
    scenes = [RockOnLevelGround(field, k) for k in range(len(field))]
    sun = direction_from_angles(0.0, elevation)
    out = np.zeros((_AZIMUTHS.size, _DEPRESSIONS.size, 2), np.complex128)
    for i, azimuth in enumerate(_AZIMUTHS[:-1]):
        for j, depression in enumerate(_DEPRESSIONS):
            camera = direction_from_angles(azimuth, depression)
            out[i, j] = np.mean([_directions_of_rock(one, sun, camera) for one in scenes], axis=0)
    out[-1] = out[0]
    return out


def _directions_of_rock(
    scene: RockOnLevelGround, sun: Array, camera: Array
) -> tuple[complex, complex]:
    """Return direction and axis of one rock of radius 1; 0 where they do not show.

    The Sun is in the north, so left of it is the west.
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


def _render(scene: RockOnLevelGround, sun: Array, camera: Array) -> tuple[Complex, Array]:
    """Return places on the ground (n,) and their brightness over that of lit ground, blurred."""
    reach = shadow_reach(float(np.arcsin(sun[2])))
    shape, ground, point, normal = ground_about(scene, camera, reach, 1.0 / _SAMPLES_PER_RADIUS)
    brightness = np.clip(normal @ sun, 0.0, None) / sun[2]
    at = np.flatnonzero(brightness > 0.0)
    shaded = np.isfinite(scene.cast(point[at], np.broadcast_to(sun, (at.size, 3)))[0])
    brightness[at[shaded]] = 0.0
    image = brightness.reshape(shape)
    blurred = cv2.GaussianBlur(
        image, (0, 0), _BLUR_RADII * _SAMPLES_PER_RADIUS, borderType=cv2.BORDER_REPLICATE
    )
    return ground[:, 1] - 1j * ground[:, 0], blurred.ravel()

"""Detect rocks in one image by their shadows (shadow EKF paper, III.A)."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property, lru_cache

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from lunarsim.errors import InputError
from lunarsim.frames import is_rotation
from lunarsim.models.camera import CameraModel
from lunarsim.models.pinhole import View
from lunarsim.models.pose import Pose
from lunarsim.onboard.perception import _patch_kernels as kernels
from lunarsim.onboard.perception.ground_plane import GroundPlane
from lunarsim.onboard.perception.plane_models import model_on_plane
from lunarsim.onboard.perception.segmentation import Segmentation, segment
from lunarsim.onboard.perception.shadow_model import (
    MAX_SUN_ELEVATION,
    MIN_SUN_ELEVATION,
    ShadowModel,
    ShadowPatch,
)
from lunarsim.onboard.perception.shape_mixture import RadiusEstimate, ShapeMixture
from lunarsim.onboard.perception.sun_direction import (
    has_usable_shadows,
    observation_scatter_factor,
    unit_vector,
)
from lunarsim.typing import Array, BoolArray
from lunarsim.value_checks import check_finite, check_shape

# The threshold enlarges patches: typical ratio of measured to expected area, and the fraction of it
# below which a patch is taken for several merged shadows.
_AREA_RATIO = 1.25
_MERGED_AREA_RATIO = 0.78
# Minimum visible length of a patch, in radii. A shorter one is mostly hidden by its rock.
_MIN_LENGTH = 0.3
# Minimum number of dark pixels of a patch, minimum fraction of its rim on an edge of the image, and
# minimum fraction that is darker than half way from shadow to lit terrain.
_MIN_PIXELS, _MIN_EDGE_FRACTION, _MIN_DEEP_FRACTION = 4, 0.5, 0.5
# Lower and upper Canny threshold on the gradient of the gamma-corrected 8-bit image.
_CANNY = (40.0, 100.0)
# Maximum radius of a rock, m, and minimum fraction of its bounding box on the terrain that a patch
# fills; other dark patches are shadows of the terrain.
_MAX_RADIUS, _MIN_FILL_FRACTION = 5.0, 0.3
# Standard deviation of the position of an end of a patch, pixels.
_PIXEL_SIGMA = 0.4
# Standard deviations of a rock centre between observations, along the Sun and across, relative to
# the size of a pixel on the terrain; determined by scenarios/shadows/rock_measurements.py.
OBSERVATION_SIGMA = (0.26, 0.095)
# Additional standard deviations for patches of one pixel per radius, along the Sun and across,
# pixels; they decrease as patches grow. Tuned on filters in flight, because the study does not pair
# patches that merge with a neighbour in some images only.
SMALL_PATCH_SIGMA = (0.62, 0.22)


@dataclass(frozen=True)
class Detections:
    """Rocks detected by their shadows in one image, and its other dark patches.

    Attributes
    ----------
    pixel
        Image position of the rock centres on the terrain (n, 2), undistorted.
    pixel_covariance
        Covariance of `pixel` (n, 2, 2), pixels^2.
    independent_covariance
        Part of `pixel_covariance` that is independent between observations (n, 2, 2), pixels^2. The
        effect of the shape of a rock on its patch persists and is not included.
    terrain_xy
        Centres (n, 2), ENU, m, for the given pose and plane.
    radius, radius_sigma
        Radius and its standard deviation (n,), m.
    height
        Rock height, estimated from the length of the patch only (n,), m.
    length
        Length of the dark patch on the terrain along the Sun: side of the rectangle with the same
        variance (n,), m.
    width, skew
        Width of the patch across the Sun, defined in the same way (n,), m, and covariance of the
        coordinates along and across (n,), m^2.
    q
        Square root of the number of dark pixels (n,).
    label
        Patch of each rock (n,), a value of `labels`.
    labels
        Dark patch of each pixel (height, width), 0 for none.
    excluded_labels
        Labels of patches that belong to no rock but hide terrain: terrain in its own shadow,
        patches cut by the image border, and invalid pixels.
    relative
        Brightness relative to nearby slopes outside shadows (height, width).
    relative_to_lit_terrain
        Brightness relative to lit terrain in a wider neighbourhood (height, width); lit slopes
        differ from 1.
    largest
        Longest half axis of the largest rock that each label may be the shadow of (labels + 1,), m;
        0 for none, infinite where unknown.
    shapes
        Weights of the rock shape hypotheses of `ShapeMixture` for each rock (n, hypotheses).
    """

    pixel: Array
    pixel_covariance: Array
    independent_covariance: Array
    terrain_xy: Array
    radius: Array
    radius_sigma: Array
    height: Array
    length: Array
    width: Array
    skew: Array
    q: Array
    label: NDArray[np.int32]
    labels: NDArray[np.int32]
    excluded_labels: NDArray[np.int32]
    relative: NDArray[np.float32]
    relative_to_lit_terrain: NDArray[np.float32]
    largest: NDArray[np.float32]
    shapes: Array

    def __len__(self) -> int:
        return int(self.radius.size)

    @cached_property
    def rock(self) -> NDArray[np.uint16]:
        """Number of the rock at each pixel: index in `label` plus 1; 0 for none.

        Shape (height, width).
        """
        place = np.zeros(int(self.labels.max(initial=0)) + 1, np.uint16)
        place[self.label] = np.arange(1, len(self) + 1)
        return np.asarray(place[self.labels])

    def with_invalid(self, invalid: BoolArray) -> Detections:
        """Return a copy in which the `invalid` pixels (height, width) hide the terrain.

        They form one new patch in `labels` and `excluded_labels`. Without invalid pixels, the
        detections themselves are returned.
        """
        if not invalid.any():
            return self
        label = np.int32(len(self.largest))
        return replace(
            self,
            labels=np.where(invalid, label, self.labels),
            excluded_labels=np.append(self.excluded_labels, label),
            largest=np.append(self.largest, np.float32(np.inf)),
        )

    def contours(self) -> list[NDArray[np.int32]]:
        """Return the outline (k, 2) of each rock's patch, pixels."""
        lines = []
        for label in self.label:
            mask = (self.labels == label).astype(np.uint8)
            found, _ = cv2.findContours(mask, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
            lines.append(max(found, key=len)[:, 0])
        return lines


def detect_rocks(
    image: ArrayLike,
    camera: CameraModel,
    pose: Pose,
    sun: ArrayLike,
    *,
    terrain: float | GroundPlane = 0.0,
    model: ShadowModel | ShapeMixture | None = None,
) -> Detections:
    """Detect rocks in one image by their shadows.

    The image is segmented into light and shadow. Each dark patch with a complete edge is projected
    onto the terrain. The end towards the Sun gives the position of the rock, the length along the
    azimuth of the Sun its height. `model` predicts the patch of a rock of radius 1 from this
    direction, including the part that the rock itself hides.

    Parameters
    ----------
    image
        Counts or radiance (camera.height, camera.width); NaN for invalid pixels.
    camera, pose
        Camera model, and pose of the camera.
    sun
        Direction towards the Sun (3,), ENU, unit vector.
    terrain
        Plane on which rocks stand, or the elevation of a horizontal plane, m.
    model
        Model of the shadows for the Sun elevation above horizontal terrain; default: half spheres.

    Returns
    -------
    detections
        Detected rocks; none if no shadow can be visible: Sun elevation outside 2 to 80 deg, camera
        below the plane, or only sky in the image.

    Raises
    ------
    InputError
        If the image is not numeric or its shape differs from the camera's, the pose is not finite
        or not a rotation, or the Sun direction is not a unit vector.
    """
    direction = unit_vector(sun)
    _check_pose(pose)
    check_shape("image", image, (camera.height, camera.width), "like the detector of the camera")
    segmentation = segment(image)
    plane = terrain if isinstance(terrain, GroundPlane) else GroundPlane(float(terrain))
    view, onto = plane.level_view(camera.view(pose)), plane.level_direction(direction)
    labels, table = _label_patches(segmentation, camera, view, onto)
    if len(table) == 0 or not has_usable_shadows(onto) or not view.position[2] > 0.0:
        seen = _no_detections(labels, np.arange(1, len(table) + 1, dtype=np.int32), segmentation)
    else:
        mixture = _mixture_of(model, direction, plane)
        seen = _measure_rocks(labels, table, view, onto, mixture, segmentation)
    return seen if segmentation.invalid is None else seen.with_invalid(segmentation.invalid)


def _mixture_of(
    model: ShadowModel | ShapeMixture | None, sun: Array, plane: GroundPlane
) -> ShapeMixture:
    """Return the shadow model adapted to a plane, for a Sun direction (3,), ENU.

    A `ShadowModel` becomes a mixture of one shape; None stands for half spheres.
    """
    if not isinstance(model, ShapeMixture):
        elevation = float(np.clip(np.arcsin(sun[2]), MIN_SUN_ELEVATION, MAX_SUN_ELEVATION))
        model = ShapeMixture.known(model or _half_spheres(elevation))
    return model_on_plane(model, plane, sun)


def _check_pose(pose: Pose) -> None:
    """Raise InputError if the pose of the camera is not finite or not a rotation."""
    check_shape("pose.position", pose.position, (3,))
    check_finite("pose.position", pose.position)
    if not is_rotation(pose.attitude):
        raise InputError("pose.attitude", pose.attitude, "must be a unit quaternion (4,)")


@lru_cache(maxsize=8)
def _half_spheres(elevation: float) -> ShadowModel:
    """Return the cached shadow model of half spheres for a Sun elevation (rad)."""
    return ShadowModel(elevation)


def _no_detections(
    labels: NDArray[np.int32], excluded_labels: NDArray[np.int32], segmentation: Segmentation
) -> Detections:
    """Return detections without rocks: no dark patch is taken as the shadow of a rock.

    `labels` (height, width) are the dark patches. `excluded_labels` (n,) are the numbers of all
    patches; the terrain under them counts as hidden.
    """
    none = np.empty(0)
    return Detections(
        np.empty((0, 2)), np.empty((0, 2, 2)), np.empty((0, 2, 2)), np.empty((0, 2)),
        none, none, none, none, none, none, none,
        np.empty(0, np.int32), labels, excluded_labels, segmentation.relative,
        segmentation.relative_to_lit_terrain, _unknown_largest(len(excluded_labels)),
        np.empty((0, 1)),
    )  # fmt: skip


def _unknown_largest(count: int) -> NDArray[np.float32]:
    """Return an infinite maximum rock radius for `count` patches of unknown origin.

    The result (count + 1,) has the format of `Detections.largest`.
    """
    largest = np.full(count + 1, np.inf, np.float32)
    largest[0] = 0.0
    return largest


def _label_patches(
    segmentation: Segmentation,
    camera: CameraModel,
    view: View,
    sun: Array,
) -> tuple[NDArray[np.int32], Array]:
    """Label the dark patches of an image and measure them on the terrain plane.

    Returns the label image and the table of patches (n, columns), label 1 first. `view` and `sun`
    (3,) are in coordinates in which the plane is at height 0.
    """
    count, labels = cv2.connectedComponents(segmentation.dark, connectivity=8, ltype=cv2.CV_32S)
    if count == 1:
        return labels, np.empty((0, kernels.COLUMNS))
    edges = cv2.Canny(segmentation.brightness, *_CANNY, L2gradient=True)
    # An edge may lie one pixel beside the threshold.
    edges = cv2.dilate(edges, np.ones((3, 3), np.uint8))
    x, y = camera.tangents
    horizontal = np.hypot(sun[0], sun[1])
    east, north = (sun[0] / horizontal, sun[1] / horizontal) if horizontal > 0.0 else (1.0, 0.0)
    table = kernels.measure_patches(
        labels,
        count - 1,
        edges,
        segmentation.deep,
        x,
        y,
        view.position,
        view.axes,
        0.0,
        east,
        north,
    )[1:]
    focal = np.sqrt(view.fx * view.fy)
    table[:, kernels.SPAN_ALONG] /= focal
    table[:, kernels.SPAN_ACROSS] /= focal
    return labels, table


def _measure_rocks(
    labels: NDArray[np.int32],
    table: Array,
    view: View,
    sun: Array,
    model: ShapeMixture,
    segmentation: Segmentation,
) -> Detections:
    """Convert measured dark patches to rocks, and reject those that are not shadows.

    Patches that are noise or mostly hidden by their rock are dropped; patches cut by the image
    border or caused by the terrain become excluded labels. `labels` (height, width) and `table`
    (n, columns) are the results of `_label_patches`. Terrain is at height 0 of `view`; `sun` (3,)
    is in the same coordinates.
    """
    k = kernels
    is_noise = (
        (table[:, k.PIXELS] < _MIN_PIXELS)
        | (table[:, k.SEEN] < _MIN_EDGE_FRACTION * table[:, k.EDGE])
        | (table[:, k.DEEP] < _MIN_DEEP_FRACTION * table[:, k.PIXELS])
    )
    is_cut = table[:, k.BORDER] > 0.0
    is_complete = ~is_noise & ~is_cut
    number = np.flatnonzero(is_complete).astype(np.int32) + 1
    t = table[is_complete]
    azimuth, depression = _viewing_angles(t, view, sun)
    along_px, across_px = t[:, k.SPAN_ALONG], t[:, k.SPAN_ACROSS]
    length, width = t[:, k.LENGTH], t[:, k.WIDTH]
    estimate = model.estimate_radius(
        length, width, azimuth, depression, along_px, across_px, _PIXEL_SIGMA
    )
    unit = estimate.unit
    area_fraction = _area_fraction(estimate, view, t)
    rocks = _CorrectedRadii.for_merged(estimate, area_fraction)
    fill = t[:, k.PIXELS] * along_px * across_px / np.maximum(length * width, 1e-9)
    is_terrain = (rocks.radius > _MAX_RADIUS) | (fill < _MIN_FILL_FRACTION)
    frame = _sun_frame(sun)
    observation_sigma = _observation_sigma(rocks.radius, along_px, across_px, sun)
    offset, spread = _rock_centres(t, rocks, unit, observation_sigma)
    offset = offset @ frame.T
    pixel, jacobian = _to_pixels(offset, view, frame)
    covariance, independent_covariance = (
        _pixel_covariance(jacobian, spread),
        _pixel_covariance(jacobian, observation_sigma),
    )
    keep = ~is_terrain & (unit.length >= _MIN_LENGTH)
    height = model.height * length / np.maximum(unit.length, _MIN_LENGTH)
    largest = _unknown_largest(len(table))
    is_single = keep & (area_fraction >= _MERGED_AREA_RATIO)
    largest[number[is_single]] = estimate.largest[is_single]
    excluded_labels = np.union1d(number[is_terrain], np.flatnonzero(is_cut) + 1).astype(np.int32)
    return Detections(
        pixel[keep], covariance[keep], independent_covariance[keep],
        (offset + view.position[:2])[keep],
        rocks.radius[keep], rocks.sigma[keep], height[keep], length[keep], width[keep],
        t[keep, k.SKEW], np.sqrt(t[keep, k.PIXELS]), number[keep],
        labels, excluded_labels, segmentation.relative, segmentation.relative_to_lit_terrain,
        largest, estimate.weight[keep],
    )  # fmt: skip


def _observation_sigma(radius: Array, along: Array, across: Array, sun: Array) -> Array:
    """Return the scatter of rock centres between observations (n, 2), m.

    The columns are along the Sun and across. `radius` (n,) is that of the rocks, m; `along` and
    `across` (n,) are the sizes of a pixel on the terrain, m. Under a Sun below the reference
    elevation, the end of a shadow scatters more than the shadow lengthens, because it merges with
    others and falls on uneven terrain.
    """
    wide = np.maximum(radius / np.sqrt(along * across), 0.25)
    spans = np.column_stack((observation_scatter_factor(sun) * along, across))
    return np.asarray(
        spans * np.hypot(OBSERVATION_SIGMA, np.divide(SMALL_PATCH_SIGMA, wide[:, None]))
    )


def _sun_frame(sun: Array) -> Array:
    """Return the matrix (2, 2) from along and across the Sun to east and north.

    `sun` (3,) is the direction towards the Sun.
    """
    s = sun[:2] / np.hypot(sun[0], sun[1])
    return np.array([[s[0], -s[1]], [s[1], s[0]]])


def _rock_centres(
    table: Array, rocks: _CorrectedRadii, unit_patch: ShadowPatch, observation_sigma: Array
) -> tuple[Array, Array]:
    """Return rock centres along and across the Sun, m, and their standard deviations.

    Both have shape (n, 2). `table` are the measured patches, `rocks` the radii, `unit_patch` the
    expected patches for a radius of 1, and `observation_sigma` (n, 2) the scatter of centres
    between observations, m.
    """
    k, r = kernels, rocks.radius
    centre = np.column_stack(
        (table[:, k.ALONG] - r * unit_patch.along, table[:, k.ACROSS] - r * unit_patch.across)
    )
    lever = rocks.sigma[:, None] * np.column_stack((unit_patch.along, unit_patch.across))
    shape = r[:, None] * np.column_stack((unit_patch.along_sigma, unit_patch.across_sigma))
    return centre, np.sqrt(observation_sigma**2 + lever**2 + shape**2)


def _area_fraction(estimate: RadiusEstimate, view: View, table: Array) -> Array:
    """Return measured over expected number of pixels of dark patches (n,).

    `estimate` are the radii from length and width of the patches, and `table` the measured
    patches. The ratio is scaled so that a single shadow typically has 1; a small value indicates
    several merged shadows.
    """
    line_of_sight = np.column_stack(
        (table[:, kernels.TX], table[:, kernels.TY], np.ones(len(table)))
    )
    line_of_sight /= np.linalg.norm(line_of_sight, axis=1, keepdims=True)
    # Sine of the depression of the line of sight, and size of a pixel there.
    sin_depression = np.maximum(-(line_of_sight @ view.axes[2]), 1e-3)
    pixel = view.position[2] / sin_depression / np.sqrt(view.fx * view.fy)
    expected = estimate.radius**2 * estimate.unit.area * sin_depression / pixel**2
    return np.asarray(table[:, kernels.PIXELS] / np.maximum(expected, 1e-9) / _AREA_RATIO)


@dataclass(frozen=True)
class _CorrectedRadii:
    """Radii of rocks and their standard deviations, corrected for merged shadows.

    Attributes
    ----------
    radius, sigma
        Radius and its standard deviation (n,), m.
    """

    radius: Array
    sigma: Array

    @classmethod
    def for_merged(cls, estimate: RadiusEstimate, area_fraction: Array) -> _CorrectedRadii:
        """Return the radii, reduced for patches that consist of several merged shadows.

        `estimate` are the radii from length and width of the patches; `area_fraction` (n,) is the
        measured over the expected area. Merged patches have far less area than their length and
        width imply. Their area is the sum of the shadows, so the radius of a rock with this area
        bounds the radius of each.
        """
        merged = area_fraction < _MERGED_AREA_RATIO
        radius = np.where(merged, estimate.radius * np.sqrt(area_fraction), estimate.radius)
        return cls(
            radius, np.where(merged, np.maximum(estimate.sigma, 0.25 * radius), estimate.sigma)
        )


def _viewing_angles(table: Array, view: View, sun: Array) -> tuple[Array, Array]:
    """Return the camera's azimuth from the Sun and depression at patches (n,), rad.

    `table` are the measured patches; `sun` (3,) is the direction towards the Sun.
    """
    line_of_sight = np.column_stack(
        (table[:, kernels.TX], table[:, kernels.TY], np.ones(len(table)))
    )
    line_of_sight = line_of_sight @ view.axes.T
    back = np.arctan2(-line_of_sight[:, 0], -line_of_sight[:, 1])
    depression = np.arctan2(
        -line_of_sight[:, 2], np.hypot(line_of_sight[:, 0], line_of_sight[:, 1])
    )
    return back - np.arctan2(sun[0], sun[1]), depression


def _to_pixels(offset: Array, view: View, sun_frame: Array) -> tuple[Array, Array]:
    """Return the pixels of terrain points, and the Jacobian in the Sun frame.

    `offset` (n, 2) are the points relative to the camera, east and north, m; `sun_frame` is the
    result of `_sun_frame`. Pixels are (n, 2) and Jacobians (n, 2, 2).
    """
    points = (
        np.column_stack((offset, np.full(len(offset), -view.position[2]))) @ view.enu_to_sensor.T
    )
    # The Jacobian by east and north is rotated to along the Sun and across.
    jacobian = view.pinhole.jacobian(points, view.enu_to_sensor[:, :2]) @ sun_frame
    return view.pinhole.project(points), jacobian


def _pixel_covariance(jacobian: Array, sigma: Array) -> Array:
    """Return pixel covariances (n, 2, 2) from errors along and across the Sun.

    `jacobian` (n, 2, 2) is that of `_to_pixels` and `sigma` (n, 2) are the standard deviations, m.
    """
    return np.asarray((jacobian * (sigma**2)[:, None, :]) @ np.swapaxes(jacobian, 1, 2))

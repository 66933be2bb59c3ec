"""Rocks from one image, by their shadows (shadow EKF paper, III.A)."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property, lru_cache

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from lunarsim.errors import InputError, check_types
from lunarsim.frames import is_rotation
from lunarsim.models.camera import CameraModel
from lunarsim.models.pinhole import View
from lunarsim.models.pose import Pose
from lunarsim.onboard.perception import _patch_kernels as kernels
from lunarsim.onboard.perception.along_plane import model_on_plane
from lunarsim.onboard.perception.ground_plane import GroundPlane
from lunarsim.onboard.perception.segmentation import Segmentation, segment
from lunarsim.onboard.perception.shadow_model import (
    LEAST_ELEVATION,
    MOST_ELEVATION,
    ShadowModel,
    ShadowPatch,
)
from lunarsim.onboard.perception.shape_mixture import RadiusEstimate, ShapeMixture
from lunarsim.onboard.perception.sun_direction import (
    has_usable_shadows,
    observation_scatter_factor,
    unit_vector,
)

Array = NDArray[np.float64]


# The threshold makes patches larger than they are: their usual area over the expected one, and the
# share of that below which a patch is taken for several.
_AREA_RATIO = 1.25
_MERGED_AREA_RATIO = 0.78
# A patch that the rock hides but for this length, in radii, tells too little.
_MIN_LENGTH = 0.3


@dataclass(frozen=True)
class DetectorSettings:
    """What counts as the shadow of a rock.

    Attributes
    ----------
    gamma, window
        See `segment`.
    least_pixels
        Dark pixels of the smallest patch.
    edge_share
        Share of a patch's rim that must lie on an edge of the image (Canny).
    deep_share
        Share of a patch that must be darker than half way from shadow to lit ground.
    canny
        Lower and upper threshold on the gradient of the gamma-corrected 8-bit image.
    largest_radius
        Larger dark patches are shadows of the terrain, m.
    least_fill
        Share of its bounding box on the ground that a rock's patch fills.
    pixel_sigma
        Standard deviation of where an end of a patch is found, pixels.
    look_sigma
        Standard deviations along the Sun and across by which a centre differs from one look to the
        next, in what a pixel spans on the ground; found by `scenarios/shadows/looks.py`.
    look_small
        What patches of one pixel a radius differ by besides, along the Sun and across, pixels; it
        falls as they grow. Found from what filters make of them in flight: a patch that is now one
        rock's and now also its neighbour's is not paired in the study.
    """

    gamma: float = 0.7
    window: float = 0.12
    least_pixels: int = 4
    edge_share: float = 0.5
    deep_share: float = 0.5
    canny: tuple[float, float] = (40.0, 100.0)
    largest_radius: float = 5.0
    least_fill: float = 0.3
    pixel_sigma: float = 0.4
    look_sigma: tuple[float, float] = (0.26, 0.095)
    look_small: tuple[float, float] = (0.62, 0.22)

    def __post_init__(self) -> None:
        check_types("detector", self)
        if not self.least_pixels >= 1:
            raise InputError("detector.least_pixels", self.least_pixels, "1 or more")
        for name in ("gamma", "largest_radius", "pixel_sigma"):
            value = getattr(self, name)
            if not (np.isfinite(value) and value > 0.0):
                raise InputError(f"detector.{name}", value, "a positive number")
        for name in ("window", "edge_share", "deep_share", "least_fill"):
            value = getattr(self, name)
            if not 0.0 < value <= 1.0:
                raise InputError(f"detector.{name}", value, "a share above 0, up to 1")
        for name, least in (("look_sigma", 1e-9), ("look_small", 0.0)):
            pair = np.ravel(getattr(self, name))
            if not (len(pair) == 2 and np.isfinite(pair).all() and (pair >= least).all()):
                what = "positive numbers" if least else "numbers, 0 or positive"
                raise InputError(f"detector.{name}", getattr(self, name), f"two {what}, in pixels")
        low, high = self.canny
        if not 0.0 < low < high < np.inf:
            raise InputError("detector.canny", self.canny, "two positive numbers that rise")


@dataclass(frozen=True)
class Detections:
    """Rocks found in one image, and what else was dark.

    Attributes
    ----------
    pixel
        Image of the rocks' centres on the ground (n, 2), distortion taken out.
    pixel_covariance
        Of `pixel` (n, 2, 2).
    look_covariance
        That part of it which is another in every look (n, 2, 2): what the shape of a rock makes
        of its patch lasts from look to look.
    ground
        Centres (n, 2), ENU, m, for the pose and plane given.
    radius, radius_sigma
        m (n,).
    height
        By the length of the patch alone (n,), m.
    length
        Of the dark patch along the Sun, as `ShadowPatch` has it (n,), m.
    width, skew
        Across the Sun (n,), m, and covariance along and across (n,), m^2, likewise.
    q
        Root of the number of dark pixels (n,).
    label
        Patch of each rock (n,), a value of `labels`.
    labels
        Dark patch of each pixel (height, width), 0 for none.
    extended
        Labels of what is no rock's and was not seen: terrain in its own shadow, patches cut by the
        edge, and pixels that are no numbers.
    relative
        Brightness over that of the slopes close by, were they lit (height, width).
    over_ground
        Brightness over that of the lit ground nearby, slopes as they are (height, width).
    largest
        Longest half axis of the largest rock that each label may be the shadow of (labels + 1,), m:
        0 for none, infinite where the patch does not tell.
    shapes
        Weights of the hypotheses under which each rock was read (n, hypotheses), see
        `ShapeMixture`.
    """

    pixel: Array
    pixel_covariance: Array
    look_covariance: Array
    ground: Array
    radius: Array
    radius_sigma: Array
    height: Array
    length: Array
    width: Array
    skew: Array
    q: Array
    label: NDArray[np.int32]
    labels: NDArray[np.int32]
    extended: NDArray[np.int32]
    relative: NDArray[np.float32]
    over_ground: NDArray[np.float32]
    largest: NDArray[np.float32]
    shapes: Array

    def __len__(self) -> int:
        return int(self.radius.size)

    @cached_property
    def rock(self) -> NDArray[np.uint16]:
        """Place in `label`, from 1 on, of each pixel's rock (height, width); 0 for none."""
        place = np.zeros(int(self.labels.max(initial=0)) + 1, np.uint16)
        place[self.label] = np.arange(1, len(self) + 1)
        return np.asarray(place[self.labels])

    def hiding(self, left_out: NDArray[np.bool_]) -> Detections:
        """Return the same with a label for pixels (height, width) that tell nothing."""
        if not left_out.any():
            return self
        label = np.int32(len(self.largest))
        return replace(
            self,
            labels=np.where(left_out, label, self.labels),
            extended=np.append(self.extended, label),
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
    ground: float | GroundPlane = 0.0,
    model: ShadowModel | ShapeMixture | None = None,
    settings: DetectorSettings | None = None,
) -> Detections:
    """Find rocks by their shadows.

    The image is segmented into light and shadow; each dark patch with an edge all round is
    projected onto the ground. Its end towards the Sun marks the rock, its length along the Sun's
    azimuth the height; `model` says what patch a rock of radius 1 shows from here, so that what
    the rock itself hides is accounted for.

    Parameters
    ----------
    image
        Counts or radiance (camera.height, camera.width); NaN for pixels to leave out.
    camera, pose
        What took it, and from where.
    sun
        Direction towards the Sun (3,), ENU, of unit length.
    ground
        Plane on which rocks are taken to stand, or the elevation of a level one, m.
    model
        Shapes of rocks, under the Sun's elevation above level ground; left out: half spheres.
    settings
        What counts as a shadow.

    Returns
    -------
    detections
        Empty if no shadow is to be seen: Sun not 2 to 80 deg, or camera not, above the plane; sky.

    Raises
    ------
    InputError
        If the image is not numeric or has not the camera's shape, the pose is not finite or no
        rotation, or the Sun's direction is not a unit vector.
    """
    settings = settings or DetectorSettings()
    direction = unit_vector(sun)
    _check_pose(pose)
    if np.shape(image) != (camera.height, camera.width):
        raise InputError(
            "image", np.shape(image), f"the camera's size ({camera.height}, {camera.width})"
        )
    shade = segment(image, gamma=settings.gamma, window=settings.window)
    plane = ground if isinstance(ground, GroundPlane) else GroundPlane(float(ground))
    view, onto = plane.view(camera.view(pose)), plane.direction(direction)
    labels, table = _label_patches(shade, camera, view, onto, settings)
    if len(table) == 0 or not has_usable_shadows(onto) or not view.position[2] > 0.0:
        seen = _no_detections(labels, np.arange(1, len(table) + 1, dtype=np.int32), shade)
    else:
        mixture = _mixture_of(model, direction, plane)
        seen = _measure_rocks(labels, table, view, onto, mixture, settings, shade)
    return seen if shade.left_out is None else seen.hiding(shade.left_out)


def _mixture_of(
    model: ShadowModel | ShapeMixture | None, sun: Array, plane: GroundPlane
) -> ShapeMixture:
    """Return what shadows on a plane are read by, the Sun's direction that over level ground."""
    if not isinstance(model, ShapeMixture):
        elevation = float(np.clip(np.arcsin(sun[2]), LEAST_ELEVATION, MOST_ELEVATION))
        model = ShapeMixture.known(model or _half_spheres(elevation))
    return model_on_plane(model, plane, sun)


def _check_pose(pose: Pose) -> None:
    if np.shape(pose.position) != (3,) or not np.isfinite(pose.position).all():
        raise InputError("pose.position", pose.position, "three finite numbers, ENU, m")
    if not is_rotation(pose.attitude):
        raise InputError("pose.attitude", pose.attitude, "a quaternion (4,) of length 1")


@lru_cache(maxsize=8)
def _half_spheres(elevation: float) -> ShadowModel:
    return ShadowModel(elevation)


def _no_detections(
    labels: NDArray[np.int32], extended: NDArray[np.int32], shade: Segmentation
) -> Detections:
    none = np.empty(0)
    return Detections(
        np.empty((0, 2)), np.empty((0, 2, 2)), np.empty((0, 2, 2)), np.empty((0, 2)),
        none, none, none, none, none, none, none,
        np.empty(0, np.int32), labels, extended, shade.relative, shade.over_ground,
        _unknown_largest(len(extended)), np.empty((0, 1)),
    )  # fmt: skip


def _unknown_largest(count: int) -> NDArray[np.float32]:
    """Return `Detections.largest` of patches (count,) that do not tell of what they are."""
    largest = np.full(count + 1, np.inf, np.float32)
    largest[0] = 0.0
    return largest


def _label_patches(
    shade: Segmentation,
    camera: CameraModel,
    view: View,
    sun: Array,
    settings: DetectorSettings,
) -> tuple[NDArray[np.int32], Array]:
    """Return the label image and the table of its patches (n, columns), label 1 first."""
    count, labels = cv2.connectedComponents(shade.dark, connectivity=8, ltype=cv2.CV_32S)
    if count == 1:
        return labels, np.empty((0, kernels.COLUMNS))
    edges = cv2.Canny(shade.brightness, *settings.canny, L2gradient=True)
    # An edge may run a pixel beside the threshold.
    edges = cv2.dilate(edges, np.ones((3, 3), np.uint8))
    x, y = camera.tangents
    horizontal = np.hypot(sun[0], sun[1])
    east, north = (sun[0] / horizontal, sun[1] / horizontal) if horizontal > 0.0 else (1.0, 0.0)
    table = kernels.measure_patches(
        labels,
        count - 1,
        edges,
        shade.deep,
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
    settings: DetectorSettings,
    shade: Segmentation,
) -> Detections:
    """Turn the table of patches into rocks: the view is that above ground at height 0."""
    k = kernels
    is_noise = (
        (table[:, k.PIXELS] < settings.least_pixels)
        | (table[:, k.SEEN] < settings.edge_share * table[:, k.EDGE])
        | (table[:, k.DEEP] < settings.deep_share * table[:, k.PIXELS])
    )
    is_cut = table[:, k.BORDER] > 0.0
    is_complete = ~is_noise & ~is_cut
    number = np.flatnonzero(is_complete).astype(np.int32) + 1
    t = table[is_complete]
    azimuth, depression = _viewing_angles(t, view, sun)
    along_px, across_px = t[:, k.SPAN_ALONG], t[:, k.SPAN_ACROSS]
    length, width = t[:, k.LENGTH], t[:, k.WIDTH]
    read = model.read(length, width, azimuth, depression, along_px, across_px, settings.pixel_sigma)
    unit = read.unit
    share = _area_fraction(read, view, t)
    rocks = _RadiusCorrection.for_merged(read, share)
    fill = t[:, k.PIXELS] * along_px * across_px / np.maximum(length * width, 1e-9)
    is_terrain = (rocks.radius > settings.largest_radius) | (fill < settings.least_fill)
    frame = _sun_frame(sun)
    look = _observation_sigma(settings, rocks.radius, along_px, across_px, sun)
    offset, spread = _rock_centres(t, rocks, unit, look)
    offset = offset @ frame.T
    pixel, turned = _to_pixels(offset, view, frame)
    covariance, white = _pixel_covariance(turned, spread), _pixel_covariance(turned, look)
    keep = ~is_terrain & (unit.length >= _MIN_LENGTH)
    height = model.height * length / np.maximum(unit.length, _MIN_LENGTH)
    largest = _unknown_largest(len(table))
    is_single = keep & (share >= _MERGED_AREA_RATIO)
    largest[number[is_single]] = read.largest[is_single]
    extended = np.union1d(number[is_terrain], np.flatnonzero(is_cut) + 1).astype(np.int32)
    return Detections(
        pixel[keep], covariance[keep], white[keep], (offset + view.position[:2])[keep],
        rocks.radius[keep], rocks.sigma[keep], height[keep], length[keep], width[keep],
        t[keep, k.SKEW], np.sqrt(t[keep, k.PIXELS]), number[keep],
        labels, extended, shade.relative, shade.over_ground, largest, read.weight[keep],
    )  # fmt: skip


def _observation_sigma(
    settings: DetectorSettings, radius: Array, along: Array, across: Array, sun: Array
) -> Array:
    """Return by how much centres differ from look to look along the Sun and across (n, 2), m.

    `radius` is that of the rocks (n,), `along` and `across` what a pixel spans there (n,), m. Where
    the Sun is lower than that by which the settings were found, the end of a shadow differs by more
    than the shadow is longer: it runs into others too, and over ground that is not quite level.
    """
    wide = np.maximum(radius / np.sqrt(along * across), 0.25)
    spans = np.column_stack((observation_scatter_factor(sun) * along, across))
    return np.asarray(
        spans * np.hypot(settings.look_sigma, np.divide(settings.look_small, wide[:, None]))
    )


def _sun_frame(sun: Array) -> Array:
    """Return the matrix (2, 2) from coordinates along the Sun and across to east and north."""
    s = sun[:2] / np.hypot(sun[0], sun[1])
    return np.array([[s[0], -s[1]], [s[1], s[0]]])


def _rock_centres(
    table: Array, rocks: _RadiusCorrection, unit: ShadowPatch, look: Array
) -> tuple[Array, Array]:
    """Return centres (n, 2) along the Sun and across, m, and their standard deviations (n, 2).

    `look` (n, 2) is what they differ by from look to look, m.
    """
    k, r = kernels, rocks.radius
    centre = np.column_stack(
        (table[:, k.ALONG] - r * unit.along, table[:, k.ACROSS] - r * unit.side)
    )
    lever = rocks.sigma[:, None] * np.column_stack((unit.along, unit.side))
    shape = r[:, None] * np.column_stack((unit.along_sigma, unit.side_sigma))
    return centre, np.sqrt(look**2 + lever**2 + shape**2)


def _area_fraction(read: RadiusEstimate, view: View, table: Array) -> Array:
    """Return what share of the pixels that they should have patches (n,) have."""
    line_of_sight = np.column_stack(
        (table[:, kernels.TX], table[:, kernels.TY], np.ones(len(table)))
    )
    line_of_sight /= np.linalg.norm(line_of_sight, axis=1, keepdims=True)
    # What ground falls away by along lines of sight, and how far away it is.
    sin_depression = np.maximum(-(line_of_sight @ view.axes[2]), 1e-3)
    pixel = view.position[2] / sin_depression / np.sqrt(view.fx * view.fy)
    expected = read.radius**2 * read.unit.area * sin_depression / pixel**2
    return np.asarray(table[:, kernels.PIXELS] / np.maximum(expected, 1e-9) / _AREA_RATIO)


@dataclass(frozen=True)
class _RadiusCorrection:
    radius: Array
    sigma: Array

    @classmethod
    def for_merged(cls, read: RadiusEstimate, share: Array) -> _RadiusCorrection:
        """Return the radii, those of patches that hold several shadows set right.

        Such a patch has far less area than its length and width promise. Its area is the sum of
        the shadows', so the radius of a rock with that area bounds each of theirs.
        """
        merged = share < _MERGED_AREA_RATIO
        radius = np.where(merged, read.radius * np.sqrt(share), read.radius)
        return cls(radius, np.where(merged, np.maximum(read.sigma, 0.25 * radius), read.sigma))


def _viewing_angles(table: Array, view: View, sun: Array) -> tuple[Array, Array]:
    """Return azimuth from the Sun's and depression of the lines of sight to patches (n,), rad."""
    line_of_sight = np.column_stack(
        (table[:, kernels.TX], table[:, kernels.TY], np.ones(len(table)))
    )
    line_of_sight = line_of_sight @ view.axes.T
    back = np.arctan2(-line_of_sight[:, 0], -line_of_sight[:, 1])
    depression = np.arctan2(
        -line_of_sight[:, 2], np.hypot(line_of_sight[:, 0], line_of_sight[:, 1])
    )
    return back - np.arctan2(sun[0], sun[1]), depression


def _to_pixels(offset: Array, view: View, frame: Array) -> tuple[Array, Array]:
    """Return the pixels of points on the ground (n, 2).

    And how they move with the points along the Sun and across (n, 2, 2).
    """
    points = np.column_stack((offset, np.full(len(offset), -view.position[2]))) @ view.into.T
    # By east and north, then along the Sun and across.
    turned = view.pinhole.jacobian(points, view.into[:, :2]) @ frame
    return view.pinhole.project(points), turned


def _pixel_covariance(turned: Array, sigma: Array) -> Array:
    """Return covariances of pixels (n, 2, 2) by deviations along the Sun and across (n, 2), m."""
    return np.asarray((turned * (sigma**2)[:, None, :]) @ np.swapaxes(turned, 1, 2))

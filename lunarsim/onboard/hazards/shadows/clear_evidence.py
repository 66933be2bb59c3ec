"""Evidence about untracked rocks: where images exclude a rock.

A rock darkens the terrain behind it. If an image shows this terrain lit, there is no rock of that
size, whatever was detected or tracked. If the terrain is dark, a rock is possible: its shadow may
merge with another, its size or shape may be misjudged, or the terrain may be in its own shadow.
The position then counts as not observed. This is evaluated for every position and several sizes,
with the shadow that even a low rock of this size would cast.

Untracked rocks are a Poisson field. Where their shadow would fall on lit terrain, the density is
that of the size law times the miss rate. Where it would fall on dark terrain, all remaining rocks
of the size are concentrated. The probability that no rock reaches into a disc follows from the
integral of the density over the disc.

Evidence is stored by position on the terrain; positions move in the local frame as rocks do.
"""

from __future__ import annotations

from collections.abc import Callable
from itertools import product

import numpy as np
from numpy.typing import NDArray

from lunarsim.grid import Grid
from lunarsim.models.pinhole import View
from lunarsim.onboard.hazards.shadows import _evidence_kernels as kernels
from lunarsim.onboard.hazards.shadows import _probability_kernels as density
from lunarsim.onboard.hazards.shadows.footprints import disc_mean
from lunarsim.onboard.hazards.shadows.map_motion import MapMotion
from lunarsim.onboard.hazards.shadows.viewing_geometry import viewing_geometry
from lunarsim.onboard.perception.detection_rates import DetectionRates
from lunarsim.onboard.perception.detector import Detections
from lunarsim.onboard.perception.ground_plane import LEVEL, GroundPlane
from lunarsim.onboard.perception.plane_models import model_on_plane
from lunarsim.onboard.perception.shadow_model import ShadowModel
from lunarsim.onboard.perception.shape_mixture import LOW_POWER, ShapeMixture
from lunarsim.typing import Array, BoolArray

Heights = Callable[[Array], Array]

# Spacing of the nodes at which shadows and terrain heights are computed, m.
_NODE_SPACING_M = 4.0
# Test points of a shadow's core: its centre, and points at these fractions of length and width.
_CORE_LENGTH_FRACTION, _CORE_WIDTH_FRACTION = 0.25, 0.2
# Ratio of the radius of a rock's disc to its longer half axis, for round and for elongated rocks.
_RADIUS_RATIOS = (1.0, 0.7)
# Minimum number of dark test points, of five, for a rock to be possible.
_MIN_DARK_POINTS = 4
# Minimum gain in sharpness over earlier observations.
_MIN_SHARPNESS_GAIN = 1.03
# Number of standard deviations of the terrain height to test, and maximum height error, m.
_HEIGHT_SIGMAS, _MAX_HEIGHT_ERROR_M = 2.0, 1e3
# Rocks of a size cannot be concentrated on less than this multiple of the rocks' area.
_MIN_AREA_PER_ROCK = 2.0
# A position is observed if the smallest hazard there is missed at most at this rate.
_MAX_MISS_RATE = 0.25
# Nothing is observed if more than this fraction of the rocks has no shadow under this Sun.
_MAX_SHADOWLESS_FRACTION = 0.02
# Minimum density that replaces zero, 1/m^2.
_MIN_DENSITY = 1e-30
# Maximum size ratio within one class, and maximum number of classes. The last class has few rocks:
# its sizes start at nearly three times the minimum.
_SIZE_CLASS_RATIO, _MAX_SIZE_CLASSES = 1.4, 4


class ClearEvidence:
    """Record of where camera images exclude undetected rocks of several sizes.

    For each position and size class, the class stores the sharpest observation of the place where
    the shadow of such a rock would fall. Sharpness is q (the square root of the number of dark
    pixels) per metre of radius.

    Parameters
    ----------
    grid
        Grid of the stored positions.
    model
        Shadow model, which predicts the number of dark pixels of a rock.
    diameters
        Diameters of the rocks (n,), ascending, m.
    number_density
        Expected number of rocks of these sizes per area (n,), 1/m^2.
    rates
        Detection rates, including the rate at which positions with a rock are declared free.

    Attributes
    ----------
    lit, dark
        Sharpness of the sharpest observation in which the shadow would fall on lit terrain, and on
        dark terrain (sizes, rows, cols); 0: none.
    explained
        Whether the dark terrain was the shadow of a tracked rock (sizes, rows, cols).
    motion
        Motion of the stored positions in the local frame.
    """

    def __init__(
        self,
        grid: Grid,
        model: ShadowModel | ShapeMixture,
        diameters: Array,
        number_density: Array,
        rates: DetectionRates,
    ) -> None:
        self.grid = grid
        self.motion = MapMotion(np.array(grid.centre))
        self.model = model
        # The shadow of a low rock lies within that of a higher one.
        self._low_rocks = ShadowModel(model.elevation, LOW_POWER)
        self.rates = rates
        self._radius = 0.5 * diameters
        self._number = np.maximum(number_density, _MIN_DENSITY)
        # Sizes within a ratio share one test.
        step = np.log(diameters / diameters[0]) / np.log(_SIZE_CLASS_RATIO)
        first = np.minimum((step + 1e-9).astype(int), _MAX_SIZE_CLASSES - 1)
        self._class = np.unique(first, return_inverse=True)[1]
        classes = int(self._class.max()) + 1
        self._tested = np.array([self._radius[self._class == s][0] for s in range(classes)])
        self.lit = np.zeros((classes, *grid.shape), np.float32)
        self.dark = np.zeros_like(self.lit)
        self.explained = np.zeros(self.lit.shape, np.bool_)

    def forget(self) -> None:
        """Discard all observations."""
        self.lit[:] = 0.0
        self.dark[:] = 0.0
        self.motion.forget()

    def recentre(self, offset: Array) -> Array:
        """Shift the grid by an offset (2,), m, and keep the observations on it.

        Observations off the shifted grid are dropped. Returns the shift applied (2,), east and
        north, m, which is an integer number of cells.
        """
        g = self.grid
        cols, rows = (int(v) for v in np.rint(np.asarray(offset) / g.posting))
        by = g.posting * np.array([cols, rows], dtype=np.float64)
        self.grid = g.moved(by)
        to = (slice(None), _overlap(rows, g.rows), _overlap(cols, g.cols))
        of = (slice(None), _overlap(-rows, g.rows), _overlap(-cols, g.cols))
        for name in ("lit", "dark", "explained"):
            old = getattr(self, name)
            moved = np.zeros_like(old)
            moved[to] = old[of]
            setattr(self, name, moved)
        return by

    def add_image(
        self,
        view: View,
        sun: Array,
        detections: Detections,
        heights: Heights,
        explained: BoolArray | None = None,
        position_sigma: Heights | None = None,
        plane: GroundPlane = LEVEL,
        height_sigma: Heights | None = None,
        blur: float = 0.0,
    ) -> None:
        """Add the observations of one image.

        An image without rock shadows is ignored, because shadows may not be visible in it.

        Parameters
        ----------
        view
            Pose and projection of the camera for the image.
        sun
            Direction towards the Sun (3,), ENU.
        detections
            Dark patches of the image, and the rocks that may cast them.
        heights
            Function that returns the terrain height (n,) at points (n, 2), m.
        explained
            Which detections are tracked rocks (rocks,); default: none.
        position_sigma
            Function that returns the error of points (n, 2) relative to the camera, 1 sigma per
            axis (n,), m. Where it exceeds the radius of the smallest hazard, nothing is recorded.
            Default: no error.
        plane
            Plane on which shadows fall; default: horizontal.
        height_sigma
            Function that returns the error of `heights` (n,), 1 sigma, m; lit terrain must be lit
            within two sigma above and below. Default: 0.
        blur
            Point spread of the camera, 1 sigma, pixels; it has no effect unless it is wider than
            that of the detection rates.
        """
        if len(detections) == 0:
            return
        every, xy = self._nodes()
        height = _evaluate(heights, xy)
        place = np.dstack((xy, height))
        focal = float(np.sqrt(view.fx * view.fy))
        azimuth, depression, pixel = viewing_geometry(place, view.position, focal, sun, plane)
        model, low_rocks = (
            model_on_plane(self.model, plane, sun),
            model_on_plane(self._low_rocks, plane, sun),
        )
        sharpness = model.visible_q(
            1.0, azimuth, depression, pixel * self.rates.relative_edge_width(blur)
        )
        view, place = plane.level_view(view), plane.level_points(place)
        is_visible = (view.position[2] > place[..., 2]) & self._is_position_known(
            xy, position_sigma
        )
        sharpness = np.where(is_visible, sharpness, 0.0)
        largest = (
            detections.largest if explained is None else _mark_explained(detections, explained)
        )
        reach = np.zeros(height.shape) if height_sigma is None else _evaluate(height_sigma, xy)
        core = _shadow_test_points(model, low_rocks, azimuth, depression, sun)
        coarse = np.dstack(
            (sharpness, place, np.minimum(_HEIGHT_SIGMAS * reach, _MAX_HEIGHT_ERROR_M), *core)
        )
        kernels.record_observation(
            self.lit, self.dark, self.explained, self._tested, coarse, every, view.position,
            np.ascontiguousarray(view.enu_to_sensor.T), view.fx, view.fy, view.cx, view.cy,
            detections.labels,
            largest, _MIN_DARK_POINTS, _MIN_SHARPNESS_GAIN, len(_RADIUS_RATIOS),
        )  # fmt: skip

    def _is_position_known(self, xy: Array, position_sigma: Heights | None) -> BoolArray:
        """Return where positions (rows, cols, 2) are accurate to the smallest rock radius.

        `position_sigma` returns the error of points (n, 2), m; None: no error.
        """
        if position_sigma is None:
            return np.ones(xy.shape[:2], np.bool_)
        return np.asarray(_evaluate(position_sigma, xy) <= self._radius[0])

    def _nodes(self) -> tuple[int, Array]:
        """Return the spacing of coarse grid points in cells, and their positions, m.

        The positions have shape (rows, cols, 2), in the local frame.
        """
        g = self.grid
        every = max(1, round(_NODE_SPACING_M / g.posting))
        x = g.x0 + every * g.posting * np.arange(-(-g.cols // every) + 1)
        y = g.y0 + every * g.posting * np.arange(-(-g.rows // every) + 1)
        return every, self.motion.to_current(np.stack(np.meshgrid(x, y), -1))

    def _possible(self, size_class: int) -> BoolArray:
        """Return where a rock of a size class may exist in the dark (rows, cols).

        These are the positions whose shadow would fall on terrain that images show dark, unless a
        considerably sharper image shows it lit.
        """
        possible = np.empty(self.grid.shape, np.bool_)
        density.mark_possible(
            possible, self.lit[size_class], self.dark[size_class], self._tested[size_class]
        )
        return possible

    def _density(self, size_class: int) -> NDArray[np.float32]:
        """Return the density of untracked rocks of a size class (rows, cols), 1/m^2.

        It is the expected density times the miss rate of the sharpest lit observation. Where a rock
        may exist in the dark, it is the expected density if a tracked rock explains the shadow;
        otherwise it is higher, because all rocks of the class are assumed to be in such places.
        """
        mine = self._class == size_class
        radius, number = self._radius[mine], self._number[mine]
        possible, explained = self._possible(size_class), self.explained[size_class]
        # All untracked rocks of the size are where one is possible. Behind the shadow of a tracked
        # rock, another rock is as probable as anywhere.
        crowded, looked = density.count_possible(self.lit[size_class], possible, explained)
        least = _MIN_AREA_PER_ROCK * float((number * np.pi * radius**2).sum())
        hidden = float(number.sum())
        out = np.empty(self.grid.shape, np.float32)
        density.compute_density(
            out, self.lit[size_class], possible, explained, radius, number,
            self.rates.false_clear_line,
            self.model.shadowless_fraction, hidden, hidden / max(crowded / max(looked, 1), least),
        )  # fmt: skip
        return out

    @property
    def size_class_diameters(self) -> Array:
        """Minimum diameter of the rocks of each size class (sizes,), ascending, m."""
        return np.asarray(2.0 * self._tested)

    def untracked_rock_ratios(self) -> NDArray[np.float32]:
        """Return the ratio of untracked rocks to those expected without observation.

        The result (sizes, rows, cols) is below 1 where the shadow of a rock would fall on lit
        terrain. It is 1 without an observation and where the dark terrain is the shadow of a
        tracked rock. Where the dark terrain is not explained by a tracked rock, it is 1 or more:
        all rocks of the size are assumed to be there, so that their density is divided by the
        fraction of such positions, and it is multiplied by the detector's miss rate.
        """
        out = np.ones(self.lit.shape, np.float32)
        for s in range(len(out)):
            looked = (self.lit[s] > 0.0) | (self.dark[s] > 0.0)
            number = np.float32(self._number[self._class == s].sum())
            out[s][looked] = self._density(s)[looked] / number
            crowded = self._possible(s) & ~self.explained[s]
            out[s][crowded] = np.maximum(out[s] * self._miss_fraction(s), np.float32(1.0))[crowded]
        return out

    def _miss_fraction(self, size_class: int) -> NDArray[np.float32]:
        """Return the detector's miss rate for a size class in the sharpest dark view.

        The result (rows, cols) is for the sharpest image in which the shadow of a rock at the
        position would fall on dark terrain, averaged over the sizes of the class.
        """
        mine = self._class == size_class
        dark = self.dark[size_class]
        table = np.linspace(0.0, max(float(dark.max()), 1e-6), 257)
        missed = self.rates.false_negative(self._radius[mine][:, None] * table)
        share = np.maximum(
            self._number[mine] @ missed / self._number[mine].sum(), self.model.shadowless_fraction
        )
        return np.asarray(np.interp(dark, table, share), np.float32)

    def expected_untracked(self, footprint: float = 0.0) -> NDArray[np.float32]:
        """Return the expected number of untracked rocks that reach into a disc.

        The result (rows, cols) is for a disc centred on each position. `footprint` is the radius of
        the disc, m; 0: rocks whose outline contains the position itself.
        """
        total = np.zeros(self.grid.shape, np.float32)
        for s in range(len(self._tested)):
            mine = self._class == s
            weight = self._number[mine] / self._number[mine].sum()
            radius = self._radius[mine]
            reach = footprint + float(weight @ radius)
            area = np.float32(np.pi * weight @ (footprint + radius) ** 2)
            total += area * disc_mean(
                self._density(s), reach / self.grid.posting, float(self._number[mine].sum())
            )
        return total

    def expected_unobserved(self, footprint: float = 0.0) -> float:
        """Return the number of rocks that reach into a disc, expected without observation.

        `footprint` is the radius of the disc, m; 0: rocks whose outline contains a given position.
        """
        return float(np.pi * self._number @ (footprint + self._radius) ** 2)

    def expected_detections(self, edge_cells: int = 0) -> float:
        """Return the number of rocks that should have been detected on observed terrain.

        It follows from the expected rocks and the detection rates. `edge_cells` cells along each
        edge are excluded.
        """
        total = 0.0
        inner = slice(edge_cells, -edge_cells or None)
        for s in range(len(self._tested)):
            mine = self._class == s
            sharpest = np.maximum(self.lit[s], self.dark[s])[inner, inner]
            # Sharpness is rounded to a tenth, because counting is faster than sorting.
            tenths = np.bincount(np.rint(sharpest[sharpest > 0.0] * np.float32(10.0)).astype(int))
            held = np.flatnonzero(tenths)
            levels, counts = held.astype(np.float32) / np.float32(10.0), tenths[held]
            found = 1.0 - self.rates.false_negative(self._radius[mine][:, None] * levels)
            total += float(self._number[mine] @ found @ counts)
        return total * self.grid.posting**2

    def is_observed(self) -> BoolArray:
        """Return where a rock of the smallest size would have been detected (rows, cols).

        There the place of the shadow was seen lit so sharply that less than 25 % of such rocks
        would be missed. The result is False everywhere if more than 2 % of the rocks cast no shadow
        under this Sun.
        """
        if self.model.shadowless_fraction > _MAX_SHADOWLESS_FRACTION:
            return np.zeros(self.grid.shape, np.bool_)
        missed = self.rates.false_clear(self._radius[0] * self.lit[0])
        return np.asarray((missed < _MAX_MISS_RATE) & ~self._possible(0))


def _evaluate(function: Heights, xy: Array) -> Array:
    """Evaluate a function of points (n, 2) at points (rows, cols, 2).

    The result has shape (rows, cols).
    """
    return function(xy.reshape(-1, 2)).reshape(xy.shape[:2])


def _shadow_test_points(
    model: ShadowModel | ShapeMixture,
    low_rocks: ShadowModel,
    azimuth: Array,
    depression: Array,
    sun: Array,
) -> list[Array]:
    """Return east and north of test points in the shadow that every rock shape casts.

    There are five points for round rocks and five for elongated rocks, whose discs are smaller. The
    list holds east and north of each point in turn. Each is an array over the viewing directions
    (`azimuth` and `depression`, rad), relative to the position of a rock with a longer half axis of
    1. `sun` (3,) is the direction towards the Sun. Terrain that rises away from the Sun shortens
    the shadow. The points are therefore computed for terrain with the slopes of `model`; they are
    also dark on flatter terrain. `low_rocks` is the shadow model of low rocks, whose shadow lies
    within that of a higher rock.
    """
    unit = low_rocks.patch(azimuth, depression)
    s = sun[:2] / np.hypot(sun[0], sun[1])
    height = np.tan(model.elevation)
    length = unit.length * height / (height + model.slope)
    middle = unit.along + 0.5 * (unit.length - length)
    points = []
    cross = (
        (0.0, 0.0),
        (_CORE_LENGTH_FRACTION, 0.0),
        (-_CORE_LENGTH_FRACTION, 0.0),
        (0.0, _CORE_WIDTH_FRACTION),
        (0.0, -_CORE_WIDTH_FRACTION),
    )
    for share, (a, b) in product(_RADIUS_RATIOS, cross):
        along, side = share * (middle + a * length), share * (unit.across + b * unit.width)
        points += [along * s[0] - side * s[1], along * s[1] + side * s[0]]
    return points


def _mark_explained(detections: Detections, explained: BoolArray) -> NDArray[np.float32]:
    """Return the radius of the largest rock of each patch, negative if it is tracked.

    The result (labels + 1,) is in m. `explained` (rocks,) marks the detections that are tracked
    rocks. A patch of several merged shadows, with an infinite radius, does not become negative.
    """
    # A patch of several merged shadows is not explained by one rock.
    label = detections.label[explained]
    label = label[np.isfinite(detections.largest[label])]
    largest = detections.largest.copy()
    largest[label] *= -1.0
    return largest


def _overlap(shift: int, count: int) -> slice:
    """Return the slice of cells that remain on an axis after a shift.

    The axis has `count` cells; `shift` is in cells.
    """
    return slice(max(-shift, 0), max(min(count, count - shift), 0))

"""What pictures say of rocks that are not tracked: where one could still stand.

A rock that stands at a place darkens the ground behind it. If a picture shows that ground lit,
there is no rock of that size at the place, whatever became of detections and tracks. If it is
dark, there may be one, be it that its shadow runs into another's, that it was read as too small or
too ragged, or that the terrain is in its own shadow: the place is not seen. This is asked for
every place and some sizes of rocks, of the shadow that even a low rock of the size would cast.

Rocks that are not tracked are then a Poisson field: as many a square metre as the law of sizes
expects, times the rate at which they are missed where their shadow would fall on lit ground, and
crowded together where it would fall on dark ground, since there they must all be. The
probability that none reaches into a disc follows from the field's integral over the disc.

What is seen is noted for places of the ground, which slide through the local frame as rocks do.
"""

from __future__ import annotations

from collections.abc import Callable
from itertools import product

import numpy as np
from numpy.typing import NDArray

from lunarsim.grid import Grid
from lunarsim.models.pinhole import View
from lunarsim.onboard.hazards.shadows import _density_kernels as density
from lunarsim.onboard.hazards.shadows import _evidence_kernels as kernels
from lunarsim.onboard.hazards.shadows.footprints import mean_over_discs
from lunarsim.onboard.hazards.shadows.map_motion import MapMotion
from lunarsim.onboard.hazards.shadows.viewing_geometry import viewing_geometry
from lunarsim.onboard.perception.along_plane import model_on_plane
from lunarsim.onboard.perception.detection_rates import DetectionRates
from lunarsim.onboard.perception.detector import Detections
from lunarsim.onboard.perception.ground_plane import LEVEL, GroundPlane
from lunarsim.onboard.perception.shadow_model import ShadowModel
from lunarsim.onboard.perception.shape_mixture import LOW, ShapeMixture

Array = NDArray[np.float64]
Heights = Callable[[Array], Array]

# Places at which the shadow of a rock and the height of the ground are worked out, m apart.
_NODE_SPACING_M = 4.0
# Points of a shadow's core: the middle, and these shares of its length and width off it.
_CORE_LENGTH_FRACTION, _CORE_WIDTH_FRACTION = 0.25, 0.2
# Radius of the disc of a rock over its longer half axis, by which it is a hazard: of a round rock,
# and of long ones.
_RADIUS_RATIOS = (1.0, 0.7)
# As many of the five must be dark for a rock to be possible.
_MIN_DARK_POINTS = 4
# A look counts if it is sharper than those before by this factor.
_MIN_SHARPNESS_GAIN = 1.03
# The ground is taken to be higher or lower by so many standard deviations; at most by so much, m.
_HEIGHT_SIGMAS, _MAX_HEIGHT_ERROR_M = 2.0, 1e3
# Rocks of a size cannot be crowded into less than this many of their own areas.
_MIN_AREA_PER_ROCK = 2.0
# A place is seen if the least rock there would be missed no more often than this.
_MAX_MISS_RATE = 0.25
# Nothing is seen where more of the rocks than this show nothing dark under such a Sun.
_MAX_SHADOWLESS_FRACTION = 0.02
# Rocks on a square metre, for none of a size.
_MIN_DENSITY = 1e-30
# Greatest ratio of the sizes that one test stands for, and tests at most: of the last one's sizes,
# nearly three times the least and more, there are few.
_SIZE_CLASS_RATIO, _MAX_SIZE_CLASSES = 1.4, 4


class ClearEvidence:
    """For each place, the sharpest looks at where the shadow of a rock there would fall.

    Parameters
    ----------
    grid
        The places, as they are noted.
    model
        What rocks look like: how many pixels their shadows have.
    diameters
        Of the rocks (n,), rising, m.
    number
        Of rocks of these sizes that are expected on a square metre (n,).
    rates
        How often the place of a rock is given as free of it.

    Attributes
    ----------
    lit, dark
        Sharpness, pixels of q for a metre of radius, of the sharpest look in which the shadow of a
        rock would fall on lit ground, and on dark (sizes, rows, cols); 0: none.
    explained
        Whether that dark ground was the shadow of a rock that is tracked (sizes, rows, cols).
    slide
        Where the places lie in the local frame by now.
    """

    def __init__(
        self,
        grid: Grid,
        model: ShadowModel | ShapeMixture,
        diameters: Array,
        number: Array,
        rates: DetectionRates,
    ) -> None:
        self.grid = grid
        self.motion = MapMotion(np.array(grid.centre))
        self.model = model
        # The shadow of a low rock lies within that of any higher one.
        self._low_rocks = ShadowModel(model.elevation, LOW)
        self.rates = rates
        self._radius = 0.5 * diameters
        self._number = np.maximum(number, _MIN_DENSITY)
        # One test for sizes within a factor.
        step = np.log(diameters / diameters[0]) / np.log(_SIZE_CLASS_RATIO)
        first = np.minimum((step + 1e-9).astype(int), _MAX_SIZE_CLASSES - 1)
        self._class = np.unique(first, return_inverse=True)[1]
        classes = int(self._class.max()) + 1
        self._tested = np.array([self._radius[self._class == s][0] for s in range(classes)])
        self.lit = np.zeros((classes, *grid.shape), np.float32)
        self.dark = np.zeros_like(self.lit)
        self.explained = np.zeros(self.lit.shape, np.bool_)

    def forget(self) -> None:
        """Take back all that was seen."""
        self.lit[:] = 0.0
        self.dark[:] = 0.0
        self.motion.forget()

    def recentre(self, off: Array) -> Array:
        """Lay the places about a point that is off (2,), m, to whole places; what was seen stays.

        Returns
        -------
        by
            How far they were moved (2,), m.
        """
        g = self.grid
        cols, rows = (int(v) for v in np.rint(np.asarray(off) / g.posting))
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

    def see(
        self,
        view: View,
        sun: Array,
        seen: Detections,
        heights: Heights,
        explained: NDArray[np.bool_] | None = None,
        position_sigma: Heights | None = None,
        plane: GroundPlane = LEVEL,
        height_sigma: Heights | None = None,
        blur: float = 0.0,
    ) -> None:
        """Take in a picture.

        One that shows no shadow of any rock has not shown that it can: it says nothing.

        Parameters
        ----------
        view
            Where it was taken from.
        sun
            Direction towards the Sun (3,), ENU.
        seen
            Its dark patches, and what rocks they may be the shadows of.
        heights
            Gives the elevation (n,) of the ground at points (n, 2), m.
        explained
            Which of its rocks are tracked (rocks,); left out: none.
        place_sigma
            Gives how well points (n, 2) are known from the camera, 1 sigma an axis (n,), m. Where
            that is no better than the radius of the least rock, what is seen belongs elsewhere, and
            nothing is taken in. Left out: places are known.
        plane
            Along which shadows fall at every place; left out: level ground.
        height_sigma
            Of `heights` (n,), m: what is lit must be so twice that higher and lower. Left out: 0.
        blur
            Point spread of the camera, 1 sigma, pixels; left out: at most that of the rates.
        """
        if len(seen) == 0:
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
        sharpness = model.visible_pixels(1.0, azimuth, depression, pixel * self.rates.wider(blur))
        view, place = plane.view(view), plane.points(place)
        is_visible = (view.position[2] > place[..., 2]) & self._is_position_known(
            xy, position_sigma
        )
        sharpness = np.where(is_visible, sharpness, 0.0)
        largest = seen.largest if explained is None else _mark_explained(seen, explained)
        reach = np.zeros(height.shape) if height_sigma is None else _evaluate(height_sigma, xy)
        core = _cores(model, low_rocks, azimuth, depression, sun)
        coarse = np.dstack(
            (sharpness, place, np.minimum(_HEIGHT_SIGMAS * reach, _MAX_HEIGHT_ERROR_M), *core)
        )
        kernels.look(
            self.lit, self.dark, self.explained, self._tested, coarse, every, view.position,
            np.ascontiguousarray(view.into.T), view.fx, view.fy, view.cx, view.cy, seen.labels,
            largest, _MIN_DARK_POINTS, _MIN_SHARPNESS_GAIN, len(_RADIUS_RATIOS),
        )  # fmt: skip

    def _is_position_known(self, xy: Array, position_sigma: Heights | None) -> NDArray[np.bool_]:
        """Return where points (rows, cols, 2) are known as well as the least rock is large."""
        if position_sigma is None:
            return np.ones(xy.shape[:2], np.bool_)
        return np.asarray(_evaluate(position_sigma, xy) <= self._radius[0])

    def _nodes(self) -> tuple[int, Array]:
        """Return of how many places one is a node, and where nodes lie now (rows, cols, 2), m."""
        g = self.grid
        every = max(1, round(_NODE_SPACING_M / g.posting))
        x = g.x0 + every * g.posting * np.arange(-(-g.cols // every) + 1)
        y = g.y0 + every * g.posting * np.arange(-(-g.rows // every) + 1)
        return every, self.motion.now(np.stack(np.meshgrid(x, y), -1))

    def _possible(self, test: int) -> NDArray[np.bool_]:
        """Return where the sharpest look does not rule out a rock (rows, cols)."""
        possible = np.empty(self.grid.shape, np.bool_)
        density.mark_possible(possible, self.lit[test], self.dark[test], self._tested[test])
        return possible

    def _density(self, test: int) -> NDArray[np.float32]:
        """Return rocks a square metre that may be there and are not tracked (rows, cols)."""
        mine = self._class == test
        radius, number = self._radius[mine], self._number[mine]
        possible, explained = self._possible(test), self.explained[test]
        # All rocks of the size that are not tracked are where one is possible. The shadow of a rock
        # that is tracked may hide another, no more probably than any ground.
        crowded, looked = density.count_crowded(self.lit[test], possible, explained)
        least = _MIN_AREA_PER_ROCK * float((number * np.pi * radius**2).sum())
        hidden = float(number.sum())
        out = np.empty(self.grid.shape, np.float32)
        density.fill(
            out, self.lit[test], possible, explained, radius, number, self.rates.cleared,
            self.model.shadowless_fraction, hidden, hidden / max(crowded / max(looked, 1), least),
        )  # fmt: skip
        return out

    @property
    def tested(self) -> Array:
        """Least diameter of the rocks that each test stands for (sizes,), rising, m."""
        return np.asarray(2.0 * self._tested)

    def ratios(self) -> NDArray[np.float32]:
        """Return rocks that may be there and are not tracked over those expected unseen.

        Below 1 where the ground was seen lit, and 1 where there was no look, or a tracked rock's
        shadow may hide one. Where it is dark and no rock that is tracked throws the shadow, the
        rocks stand crowded that are not tracked: of all that are expected, the share that so sharp
        a look misses; never below 1.

        Returns
        -------
        ratio
            (sizes, rows, cols).
        """
        out = np.ones(self.lit.shape, np.float32)
        for s in range(len(out)):
            looked = (self.lit[s] > 0.0) | (self.dark[s] > 0.0)
            number = np.float32(self._number[self._class == s].sum())
            out[s][looked] = self._density(s)[looked] / number
            crowded = self._possible(s) & ~self.explained[s]
            out[s][crowded] = np.maximum(out[s] * self._miss_fraction(s), np.float32(1.0))[crowded]
        return out

    def _miss_fraction(self, test: int) -> NDArray[np.float32]:
        """Return the share of rocks that the sharpest look at dark ground misses (rows, cols)."""
        mine = self._class == test
        dark = self.dark[test]
        table = np.linspace(0.0, max(float(dark.max()), 1e-6), 257)
        missed = self.rates.false_negative(self._radius[mine][:, None] * table)
        share = np.maximum(
            self._number[mine] @ missed / self._number[mine].sum(), self.model.shadowless_fraction
        )
        return np.asarray(np.interp(dark, table, share), np.float32)

    def expected(self, footprint: float = 0.0) -> NDArray[np.float32]:
        """Return how many rocks that are not tracked reach into a disc about each place.

        Parameters
        ----------
        footprint
            Radius of the disc, m; 0: rocks that cover the place.

        Returns
        -------
        number
            (rows, cols).
        """
        total = np.zeros(self.grid.shape, np.float32)
        for s in range(len(self._tested)):
            mine = self._class == s
            weight = self._number[mine] / self._number[mine].sum()
            radius = self._radius[mine]
            reach = footprint + float(weight @ radius)
            area = np.float32(np.pi * weight @ (footprint + radius) ** 2)
            total += area * mean_over_discs(
                self._density(s), reach / self.grid.posting, float(self._number[mine].sum())
            )
        return total

    def unseen(self, footprint: float = 0.0) -> float:
        """Return what `expected` is of places of which nothing was noted."""
        return float(np.pi * self._number @ (footprint + self._radius) ** 2)

    def expected_found(self, beyond: int = 0) -> float:
        """Return how many rocks should have been found where there was a look.

        Without so many places along each edge.
        """
        total = 0.0
        inner = slice(beyond, -beyond or None)
        for s in range(len(self._tested)):
            mine = self._class == s
            sharpest = np.maximum(self.lit[s], self.dark[s])[inner, inner]
            # To a tenth; counting is faster than sorting.
            tenths = np.bincount(np.rint(sharpest[sharpest > 0.0] * np.float32(10.0)).astype(int))
            held = np.flatnonzero(tenths)
            levels, counts = held.astype(np.float32) / np.float32(10.0), tenths[held]
            found = 1.0 - self.rates.false_negative(self._radius[mine][:, None] * levels)
            total += float(self._number[mine] @ found @ counts)
        return total * self.grid.posting**2

    def seen(self) -> NDArray[np.bool_]:
        """Return whether a rock of the least size would have shown (rows, cols)."""
        if self.model.shadowless_fraction > _MAX_SHADOWLESS_FRACTION:
            return np.zeros(self.grid.shape, np.bool_)
        missed = self.rates.false_clear(self._radius[0] * self.lit[0])
        return np.asarray((missed < _MAX_MISS_RATE) & ~self._possible(0))


def _evaluate(given: Heights, xy: Array) -> Array:
    """Return what a function gives for points (rows, cols, 2)."""
    return given(xy.reshape(-1, 2)).reshape(xy.shape[:2])


def _cores(
    model: ShadowModel | ShapeMixture,
    low_rocks: ShadowModel,
    azimuth: Array,
    depression: Array,
    sun: Array,
) -> list[Array]:
    """Return east and north of five points of the shadow's core, in half axes, one after other.

    Of round rocks, then of long ones, whose discs are smaller.
    Ground that rises away from the Sun cuts the shadow short: the core is that of what falls on
    ground as steep as slopes are here, which is dark on any that is less so.
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
        along, side = share * (middle + a * length), share * (unit.side + b * unit.width)
        points += [along * s[0] - side * s[1], along * s[1] + side * s[0]]
    return points


def _mark_explained(seen: Detections, explained: NDArray[np.bool_]) -> NDArray[np.float32]:
    """Return `Detections.largest`, negative for the patches of rocks that are tracked."""
    # What holds several shadows is not explained by one rock.
    label = seen.label[explained]
    label = label[np.isfinite(seen.largest[label])]
    largest = seen.largest.copy()
    largest[label] *= -1.0
    return largest


def _overlap(by: int, count: int) -> slice:
    """Return which of so many places in a row lie on the row moved back by some."""
    return slice(max(-by, 0), max(min(count, count - by), 0))

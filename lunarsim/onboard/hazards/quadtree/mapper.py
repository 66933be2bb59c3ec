"""The quadtree mapper: LiDAR scans in, ranked sites and a `HazardMap` out."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import ClassVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lunarsim.errors import InputError
from lunarsim.grid import Grid
from lunarsim.messages.briefing import Briefing
from lunarsim.messages.measurements import LidarScan
from lunarsim.models.lander import Lander
from lunarsim.onboard.hazards.early_ground import EarlyGround, turned_about
from lunarsim.onboard.hazards.hazard_map import FloatMap, HazardMap
from lunarsim.onboard.hazards.mapper import HazardMapper, is_aside, map_grid
from lunarsim.onboard.hazards.published import ReliefEvidence
from lunarsim.onboard.hazards.quadtree.settings import InterestMap, SiteSettings
from lunarsim.onboard.hazards.quadtree.site_probability import evidence_of, site_safety
from lunarsim.onboard.hazards.quadtree.sites import STATUS, Selection, SiteSelector
from lunarsim.onboard.hazards.quadtree.tree import QuadtreeMap
from lunarsim.onboard.hazards.scoreboard import Scoreboard
from lunarsim.onboard.navigation.estimate import Estimate, Navigation
from lunarsim.parts.quantity import quantity
from lunarsim.rocks.population import RockExpectation
from lunarsim.safety.ensemble import Ensemble

Array = NDArray[np.float64]


@dataclass(frozen=True)
class QuadtreeMapping:
    """A quadtree of LiDAR points on which sites are ranked.

    Attributes
    ----------
    sensor
        Whose scans it maps.
    posting, size
        Of the map, m.
    least, split_count
        Least cells of the quadtree, m, and points at which one divides.
    interval
        Between two selections of sites, s.
    interest_path
        See `InterestMap.load`; None: 1 everywhere.
    sites
        What a site must be like.
    """

    sensor: str = quantity("flash", help="whose scans it maps")
    posting: float = quantity(0.2, "m", gt=0, help="side of a cell of the map")
    size: float = quantity(100.0, "m", gt=0, help="side of the square about the target")
    least: float = quantity(0.1, "m", gt=0, help="least cells of the quadtree")
    split_count: int = quantity(8, ge=2, help="points at which a cell divides")
    interval: float = quantity(1.0, "s", gt=0, help="between two selections of sites")
    interest_path: Path | None = quantity(
        None, help="NumPy archive of value, x0, y0, posting, relative to the scenario file"
    )
    sites: SiteSettings = quantity(SiteSettings(), help="what a site must be like")

    takes: ClassVar[type] = LidarScan
    publishes: ClassVar[type] = ReliefEvidence

    def build(self, briefing: Briefing, navigation: Navigation) -> QuadtreeMapper:
        """Return the mapper of one flight."""
        return QuadtreeMapper(
            map_grid(briefing.target, self.size, self.posting, briefing.lander),
            self.sites,
            elevation=float(briefing.target[2]),
            least=self.least,
            split_count=self.split_count,
            interest=None if self.interest_path is None else InterestMap.load(self.interest_path),
            interval=self.interval,
            lander=briefing.lander,
            rocks=briefing.rocks,
        )


class QuadtreeMapper(HazardMapper):
    """Keeps a quadtree of scans and judges landing sites on it.

    Parameters
    ----------
    grid
        Cells of the hazard map, estimated ENU frame; the quadtree covers them.
    settings
        Tolerances, weights, sizes of cells.
    elevation
        Level from which the quadtree counts heights, m.
    least, split_count
        Of the quadtree.
    interest
        Left out: 1 everywhere.
    model
        Weights of `site_safety`; left out: the calibrated ones.
    interval
        Least time between two selections of sites while flying, s.
    lander, rocks
        Whose safety is asked for, and what rocks the mission expects; left out, the defaults.

    Raises
    ------
    InputError
        If the interval is negative or not finite, `rocks` are none, or the lander is wider than
        the map.

    Attributes
    ----------
    noise
        Standard deviation of a height in the noisiest scan on the map, m.
    """

    def __init__(
        self,
        grid: Grid,
        settings: SiteSettings | None = None,
        *,
        elevation: float = 0.0,
        least: float = 0.1,
        split_count: int = 8,
        interest: InterestMap | None = None,
        model: Ensemble | None = None,
        interval: float = 1.0,
        lander: Lander | None = None,
        rocks: RockExpectation | None = None,
    ) -> None:
        if not 0.0 <= interval < np.inf:
            raise InputError("interval", interval, "0 or a positive number of seconds")
        self._quadtree = (least, split_count)
        self._settings = settings
        self._interest = interest
        self.selection: Selection | None = None
        self._model = model
        self._lander = lander or Lander()
        self._lay(grid, elevation)
        self._target = np.array(grid.centre)
        self._rocks = RockExpectation.given(rocks)
        self._interval = interval
        self._early, self._unsure = EarlyGround(), 0
        self._refreshed = -np.inf
        self._judged = -1
        self._drawn: HazardMap | None = self._nothing(grid)

    def _lay(self, grid: Grid, elevation: float) -> None:
        """Begin an empty quadtree over a grid."""
        least, split_count = self._quadtree
        self.grid = grid
        west, east, south, north = grid.extent
        self.map = QuadtreeMap(
            (*grid.centre, elevation), max(east - west, north - south), least,
            split_count=split_count,
        )  # fmt: skip
        footprint = self._lander.leg_radius + 0.5 * self._lander.pad_diameter
        if 2.0 * footprint > max(east - west, north - south):
            raise InputError(
                "vehicle.leg_radius", self._lander.leg_radius,
                f"a lander that the map of {max(east - west, north - south):g} m has room for",
            )  # fmt: skip
        self.selector = SiteSelector(
            self.map, self._settings, self._interest, thorough=True, footprint=footprint
        )
        self.noise = 0.0

    def recentre(self, centre: Array) -> None:
        """Lay the map about another point (3,), local frame, m; what was of interest moves too."""
        by = np.asarray(centre, dtype=np.float64)[:2] - self._target
        # The mission's interest lies about the target, and is laid anew with the map.
        aside = self._interest is not None and np.abs(by).max() > self._interest.grid.posting
        if not (self.blank or aside or is_aside(self.grid, centre)):
            return
        self._target = self._target + by
        if self._interest is not None:
            self._interest = InterestMap(self._interest.grid.moved(by), self._interest.value)
        self._lay_anew(self.grid.about(centre), float(centre[2]), self.map.points)

    def _lay_anew(self, grid: Grid, elevation: float, points: Array) -> None:
        """Begin anew over a grid, with points (n, 3) of which the first are not sure."""
        noise = self.noise
        self._lay(grid, elevation)
        if len(points):
            # One after the other: the tree keeps the order of batches alone.
            self.map.insert(points[: self._unsure])
            sure = points[self._unsure :]
            self._unsure = self.map.count
            self.map.insert(sure)
            self.noise = noise
        self.selection, self._judged = None, -1
        self._drawn = self._nothing(grid)

    def level(self, turn: Array, pivot: Array, tilt_sigma: float) -> None:
        """Turn the points that came while the tilt was not known; see `HazardMapper.level`."""
        points, first = self.map.points, self._unsure
        if first == 0:
            return
        points[:first] = turned_about(points[:first], turn, pivot)
        self._lay_anew(self.grid, float(self.map.centre[2]), points)
        if self._early.known(tilt_sigma):
            self._unsure = 0

    def update(self, measurement: LidarScan, estimate: Estimate) -> None:
        """Add a scan taken at the estimated pose; without returns nothing changes.

        Raises
        ------
        InputError
            If the scan, or the pose, is none; see `LidarScan.check`.
        """
        measurement.check(estimate.position, estimate.attitude)
        if np.isnan(measurement.range).all():
            return
        self._insert(measurement, estimate.position, estimate.attitude)
        if self._early.takes(estimate.tilt_sigma):
            self._unsure = self.map.count

    def _insert(self, scan: LidarScan, position: Array, attitude: Array) -> None:
        self.map.insert(_returns(scan, position, attitude))
        # The noisiest scan's: the points of all are on the map.
        self.noise = max(self.noise, float(np.nanmedian(scan.height_sigma(attitude))))

    def select(self) -> Selection:
        """Return all sites as they stand."""
        if self.selection is None or self._judged != self.map.version:
            self._judged = self.map.version
            self.selection = self.selector.update()
            self._drawn = None
        return self.selection

    def refresh(self, time: float) -> None:
        """Select sites anew if it is time to."""
        if time >= self._refreshed + self._interval - 1e-9:
            self._refreshed = time
            self.select()

    @property
    def blank(self) -> bool:
        """Whether no scan has been mapped yet."""
        return self.map.count == 0

    def hazard_map(self) -> HazardMap:
        """Return the map as it was when sites were last selected, or first asked for since."""
        if self._drawn is None or self.selection is None:
            # What points tell of sites belongs to the same points that the sites were selected on.
            self._drawn = self._draw(self.select())
        return self._drawn

    def evidence(self) -> ReliefEvidence | None:
        """Return the map alone: what it follows from is that of sites, not of cells."""
        return None if self.blank else ReliefEvidence(self.hazard_map())

    def scoreboard(self, site: Array) -> Scoreboard:
        """Return the ranked sites as they were when sites were last selected, by Eq. 9."""
        if self.selection is None:
            self.select()
        s = self.selection
        assert s is not None
        sizes = self.map.sizes(s.nodes)
        under = (np.abs(s.position[:, :2] - np.asarray(site)[:2]) <= 0.5 * sizes[:, None]).all(1)
        return Scoreboard(
            np.array([one.position for one in s.ranked]).reshape(-1, 3),
            np.array([one.score for one in s.ranked]),
            float(s.score[under].min(initial=np.inf)),
        )

    def _draw(self, selection: Selection) -> HazardMap:
        """Return what is known of the sites on the grid: each cell has that of the site under it.

        The probability is the ground's alone; what the limits of the mission and its interest leave
        is the layer `eligible`.
        """
        g = self.grid
        if len(selection.nodes) == 0:
            return self._nothing(g)
        evidence = evidence_of(
            self.map, selection, self.selector.settings.zone, self.noise, self._lander, self._rocks
        )
        p, known = site_safety(evidence, self._model)
        xy, size = selection.position[:, :2], self.map.sizes(selection.nodes)
        eligible = rasterised(g, xy, size, selection.status == STATUS.index("eligible"), 0.0) > 0.0
        value = self._value(g)
        return HazardMap(
            g,
            rasterised(g, xy, size, p, 0.0).astype(np.float32),
            rasterised(g, xy, size, evidence.judged, 0.0) > 0.0,
            rasterised(g, xy, size, selection.position[:, 2], np.nan).astype(np.float32),
            eligible=eligible if value is None else eligible & (value > 0.0),
            value=value,
            in_domain=rasterised(g, xy, size, known, 0.0) > 0.0,
        )

    def _nothing(self, grid: Grid) -> HazardMap:
        """Return the map before anything was seen; what the mission says of it is known."""
        value = self._value(grid)
        return replace(
            HazardMap.unobserved(grid), eligible=np.zeros(grid.shape, np.bool_), value=value
        )

    def _value(self, grid: Grid) -> FloatMap | None:
        """Return the mission's interest (rows, cols); None: 1 everywhere."""
        if self._interest is None:
            return None
        return (
            self._interest.at(grid.centres().reshape(-1, 2)).reshape(grid.shape).astype(np.float32)
        )


def rasterised(grid: Grid, xy: Array, size: Array, value: ArrayLike, fill: float) -> Array:
    """Return the value of the cell under each centre of a grid (rows, cols).

    Parameters
    ----------
    grid
        The raster.
    xy, size
        Centres (n, 2) and sides (n,) of square cells that do not overlap, m.
    value
        Of each cell (n,).
    fill
        Where there is none.
    """
    out = np.full(grid.shape, fill)
    value = np.asarray(value, dtype=np.float64)
    for side in np.unique(size):
        # Cells of one size make a raster of their own: look up instead of filling.
        mine = np.flatnonzero(size == side)
        corner = xy[mine[0]] - 0.5 * side
        col0, row0 = np.rint((xy[mine] - 0.5 * side - corner) / side).astype(np.int64).T
        cols = np.floor((grid.x - corner[0]) / side + 1e-9).astype(np.int64)
        rows = np.floor((grid.y - corner[1]) / side + 1e-9).astype(np.int64)
        west, south = min(col0.min(), cols.min()), min(row0.min(), rows.min())
        shape = (max(row0.max(), rows.max()) - south + 1, max(col0.max(), cols.max()) - west + 1)
        index = np.full(shape, -1, np.int64)
        index[row0 - south, col0 - west] = mine
        under = index[np.ix_(rows - south, cols - west)]
        out[under >= 0] = value[under[under >= 0]]
    return out


def _returns(scan: LidarScan, position: Array, attitude: Array) -> Array:
    """Return the points (n, 3) of the pixels that got a return, taken at a pose."""
    points = np.asarray(scan.points(position, attitude)).reshape(-1, 3)
    return points[np.isfinite(scan.range).ravel()]

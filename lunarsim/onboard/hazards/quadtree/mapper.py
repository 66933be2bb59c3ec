"""Mapper that converts LiDAR scans to a quadtree, ranked sites and a `HazardMap`."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import ClassVar

import numpy as np
from numpy.typing import ArrayLike

from lunarsim.errors import InputError
from lunarsim.grid import Grid
from lunarsim.messages.briefing import Briefing
from lunarsim.messages.measurements import LidarScan
from lunarsim.models.lander import Lander
from lunarsim.onboard.calibration.calibrated_safety import calibrated_safety
from lunarsim.onboard.calibration.ensemble import Ensemble
from lunarsim.onboard.hazards.hazard_map import FloatMap, HazardMap
from lunarsim.onboard.hazards.isolated_returns import without_isolated_returns
from lunarsim.onboard.hazards.map_evidence import TerrainEvidence
from lunarsim.onboard.hazards.map_tilt_correction import UnleveledScans, rotate_about
from lunarsim.onboard.hazards.mapper import HazardMapper, is_off_centre, map_grid
from lunarsim.onboard.hazards.quadtree.settings import InterestMap, SiteSettings
from lunarsim.onboard.hazards.quadtree.site_evidence import quadtree_site_evidence
from lunarsim.onboard.hazards.quadtree.sites import SITE_STATUS, SiteSelection, SiteSelector
from lunarsim.onboard.hazards.quadtree.tree import QuadtreeMap
from lunarsim.onboard.hazards.scoreboard import Scoreboard
from lunarsim.onboard.navigation.estimate import Estimate, Navigation
from lunarsim.parts.quantity import quantity
from lunarsim.rocks.population import RockExpectation
from lunarsim.typing import Array


@dataclass(frozen=True)
class QuadtreeMapperSettings:
    """Settings of a hazard mapper that stores LiDAR points in a quadtree.

    The mapper ranks landing sites as in the quadtree paper.

    Attributes
    ----------
    sensor
        Name of the LiDAR.
    posting, size
        Sides of a cell and of the hazard map, m.
    min_cell_size, split_count
        Minimum cell side of the quadtree, m, and number of points at which a cell splits.
    interval
        Time between two site selections, s.
    interest_path
        File for `InterestMap.load`; None: all places have the same value to the mission.
    sites
        Criteria for landing sites.
    """

    sensor: str = quantity("flash", help="name of the LiDAR whose scans are mapped")
    posting: float = quantity(0.2, "m", gt=0, help="side of a map cell")
    size: float = quantity(100.0, "m", gt=0, help="side of the square map centred on the target")
    min_cell_size: float = quantity(0.1, "m", gt=0, help="minimum side of a quadtree cell")
    split_count: int = quantity(
        8, ge=2, help="number of LiDAR points at which a quadtree cell is split into four"
    )
    interval: float = quantity(1.0, "s", gt=0, help="time between two selections of landing sites")
    interest_path: Path | None = quantity(
        None,
        help="file with a map of the mission value of landing places, relative to the scenario "
        "file; omitted: value 1 everywhere. The .npz file has value (rows, cols), from 0 (no "
        "landing) to 1, x0 and y0 (east and north of the centre of cell (0, 0), m) and posting "
        "(cell size, m)",
    )
    sites: SiteSettings = quantity(SiteSettings(), help="criteria for landing sites")

    accepts: ClassVar[type] = LidarScan
    publishes: ClassVar[type] = TerrainEvidence

    def build(self, briefing: Briefing, navigation: Navigation) -> QuadtreeMapper:
        """Build the mapper of one flight from the data known before it."""
        return QuadtreeMapper(
            map_grid(briefing.target, self.size, self.posting, briefing.lander),
            self.sites,
            elevation=float(briefing.target[2]),
            min_cell_size=self.min_cell_size,
            split_count=self.split_count,
            interest=None if self.interest_path is None else InterestMap.load(self.interest_path),
            interval=self.interval,
            lander=briefing.lander,
            rocks=briefing.rocks,
        )


class QuadtreeMapper(HazardMapper):
    """Hazard mapper that stores LiDAR points in a quadtree and ranks landing sites.

    Parameters
    ----------
    grid
        Cells of the hazard map, estimated ENU frame; the quadtree covers them.
    settings
        Limits, weights and cell sizes of the site selection.
    elevation
        Reference height of the quadtree, m.
    min_cell_size, split_count
        Minimum cell side of the quadtree, m, and number of points at which a cell splits.
    interest
        Value of a landing at each place to the mission; default: 1 everywhere.
    model
        Regression weights for `calibrated_safety`; default: the weights supplied with lunarsim.
    interval
        Minimum time between two site selections in flight, s.
    lander, rocks
        Lander for which safety is evaluated, and rock population expected by the mission; default:
        the defaults of `Lander` and `RockExpectation`.

    Raises
    ------
    InputError
        If `interval` is negative or not finite, `rocks` is invalid, or the lander is wider than the
        map.

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
        min_cell_size: float = 0.1,
        split_count: int = 8,
        interest: InterestMap | None = None,
        model: Ensemble | None = None,
        interval: float = 1.0,
        lander: Lander | None = None,
        rocks: RockExpectation | None = None,
    ) -> None:
        if not 0.0 <= interval < np.inf:
            raise InputError("interval", interval, "must be 0 or more, and finite")
        self._quadtree = (min_cell_size, split_count)
        self._settings = settings
        self._interest = interest
        self.selection: SiteSelection | None = None
        self._model = model
        self._lander = lander or Lander()
        self._create_tree(grid, elevation)
        self._target = np.array(grid.centre)
        self._rocks = RockExpectation.or_default(rocks)
        self._interval = interval
        self._unleveled, self._provisional_count = UnleveledScans(), 0
        self._last_selection_s = -np.inf
        self._selected_version = -1
        self._hazard_map: HazardMap | None = self._empty_map(grid)

    def _create_tree(self, grid: Grid, elevation: float) -> None:
        """Create an empty quadtree and site selector for a grid.

        `elevation` is the reference height, m.
        """
        min_cell_size, split_count = self._quadtree
        self.grid = grid
        west, east, south, north = grid.extent
        side, pad = max(east - west, north - south), self._lander.pad_diameter
        self.map = QuadtreeMap(
            (*grid.centre, elevation), side, min_cell_size,
            split_count=split_count,
        )  # fmt: skip
        footprint = self._lander.leg_radius + 0.5 * pad
        if 2.0 * footprint > side:
            raise InputError(
                "vehicle.leg_radius_m", self._lander.leg_radius,
                f"must be at most {0.5 * (side - pad):g} on a map with a side of {side:g} m",
            )  # fmt: skip
        self.selector = SiteSelector(
            self.map, self._settings, self._interest, thorough=True, footprint=footprint
        )
        self.noise = 0.0

    def recentre(self, centre: Array) -> None:
        """Move the map to another centre (3,), local frame, m, if it is too far from it.

        An empty map is always moved. The interest map, which is centred on the target, moves too,
        and the map also moves if the target has moved by more than a cell of the interest map.
        """
        by = np.asarray(centre, dtype=np.float64)[:2] - self._target
        # The interest map is centred on the target and must move with it.
        interest_moves = (
            self._interest is not None and np.abs(by).max() > self._interest.grid.posting
        )
        if not (self.is_empty or interest_moves or is_off_centre(self.grid, centre)):
            return
        self._target = self._target + by
        if self._interest is not None:
            self._interest = InterestMap(self._interest.grid.moved(by), self._interest.value)
        self._rebuild(self.grid.about(centre), float(centre[2]), self.map.points)

    def _rebuild(self, grid: Grid, elevation: float, points: Array) -> None:
        """Create a new quadtree on a grid and insert all points (n, 3) into it.

        `elevation` is the reference height, m. The points measured before the tilt was known come
        first. The site selection and the hazard map are reset.
        """
        noise = self.noise
        self._create_tree(grid, elevation)
        if len(points):
            # Insert in two batches: the tree keeps the order of batches, but not within a batch.
            self.map.insert(points[: self._provisional_count])
            final_points = points[self._provisional_count :]
            self._provisional_count = self.map.count
            self.map.insert(final_points)
            self.noise = noise
        self.selection, self._selected_version = None, -1
        self._hazard_map = self._empty_map(grid)

    def correct_tilt(self, turn: Array, pivot: Array, tilt_sigma: float) -> None:
        """Rotate the points that were measured before the tilt of the lander was known.

        Parameters
        ----------
        turn, pivot
            Rotation matrix (3, 3) and the point (3,) about which the points are rotated, local
            frame, m.
        tilt_sigma
            Current standard deviation of the tilt, rad.
        """
        points, first = self.map.points, self._provisional_count
        if first == 0:
            return
        points[:first] = rotate_about(points[:first], turn, pivot)
        self._rebuild(self.grid, float(self.map.centre[2]), points)
        if self._unleveled.is_tilt_known(tilt_sigma):
            self._provisional_count = 0

    def update(self, measurement: LidarScan, estimate: Estimate) -> None:
        """Add a scan taken at the estimated pose; ignore isolated returns and empty scans.

        Raises
        ------
        InputError
            If the scan or the pose is invalid, as in `LidarScan.check`.
        """
        measurement.check(estimate.position, estimate.attitude)
        if np.isnan(measurement.range).all():
            return
        scan = without_isolated_returns(measurement, estimate.attitude)
        self._insert(scan, estimate.position, estimate.attitude)
        if self._unleveled.includes(estimate.tilt_sigma):
            self._provisional_count = self.map.count

    def _insert(self, scan: LidarScan, position: Array, attitude: Array) -> None:
        """Add the returns of a scan to the quadtree.

        `position` (3,), m, and `attitude` are the estimated pose of the lander.
        """
        self.map.insert(_return_points(scan, position, attitude))
        # The noisiest scan counts, because the points of all scans are on the map.
        self.noise = max(self.noise, float(np.nanmedian(scan.height_sigma(attitude))))

    def select(self) -> SiteSelection:
        """Select landing sites if the map has changed, and return the last selection."""
        if self.selection is None or self._selected_version != self.map.version:
            self._selected_version = self.map.version
            self.selection = self.selector.update()
            self._hazard_map = None
        return self.selection

    def refresh(self, time: float) -> None:
        """Select landing sites if the interval since the last selection has passed.

        `time` is the current time, s.
        """
        if time >= self._last_selection_s + self._interval - 1e-9:
            self._last_selection_s = time
            self.select()

    @property
    def is_empty(self) -> bool:
        """Whether no scan has been mapped yet."""
        return self.map.count == 0

    def hazard_map(self) -> HazardMap:
        """Return the hazard map of the last site selection, computed when first needed."""
        if self._hazard_map is None or self.selection is None:
            # The site evidence must use the same points as the site selection.
            self._hazard_map = self._compute_map(self.select())
        return self._hazard_map

    def evidence(self) -> TerrainEvidence | None:
        """Return the hazard map for fusion; None while it is empty.

        The inputs of its safety calibration are not included, because they refer to quadtree sites
        and not to cells of the map.
        """
        return None if self.is_empty else TerrainEvidence(self.hazard_map())

    def scoreboard(self, site: Array) -> Scoreboard:
        """Return the ranked sites of the last selection, scored by Eq. 9 of the paper.

        The score of the current target is that of the site whose cell contains it, inf for none.

        Parameters
        ----------
        site
            Current target site (3,), local frame, m.
        """
        if self.selection is None:
            self.select()
        s = self.selection
        assert s is not None
        sizes = self.map.sizes(s.nodes)
        at_site = (np.abs(s.position[:, :2] - np.asarray(site)[:2]) <= 0.5 * sizes[:, None]).all(1)
        return Scoreboard(
            np.array([one.position for one in s.ranked]).reshape(-1, 3),
            np.array([one.score for one in s.ranked]),
            float(s.score[at_site].min(initial=np.inf)),
        )

    def _compute_map(self, selection: SiteSelection) -> HazardMap:
        """Build a hazard map in which each cell has the values of the site at its centre.

        The probability depends on the terrain only. The limits of the mission on slope and hazards,
        and places without value to it, are in the layer `eligible`.
        """
        g = self.grid
        if len(selection.nodes) == 0:
            return self._empty_map(g)
        evidence = quadtree_site_evidence(
            self.map,
            selection,
            self.selector.settings.zone_half_side,
            self.noise,
            self._lander,
            self._rocks,
        )
        p, known = calibrated_safety(evidence, self._model)
        xy, size = selection.position[:, :2], self.map.sizes(selection.nodes)
        eligible = (
            rasterize_cells(g, xy, size, selection.status == SITE_STATUS.index("eligible"), 0.0)
            > 0.0
        )
        value = self._value(g)
        return HazardMap(
            g,
            rasterize_cells(g, xy, size, p, 0.0).astype(np.float32),
            rasterize_cells(g, xy, size, evidence.observed, 0.0) > 0.0,
            rasterize_cells(g, xy, size, selection.position[:, 2], np.nan).astype(np.float32),
            eligible=eligible if value is None else eligible & (value > 0.0),
            value=value,
            in_domain=rasterize_cells(g, xy, size, known, 0.0) > 0.0,
        )

    def _empty_map(self, grid: Grid) -> HazardMap:
        """Return a hazard map without observations, with the mission value of each cell."""
        value = self._value(grid)
        return replace(
            HazardMap.unobserved(grid), eligible=np.zeros(grid.shape, np.bool_), value=value
        )

    def _value(self, grid: Grid) -> FloatMap | None:
        """Return the value of each cell to the mission (rows, cols); None: 1 everywhere."""
        if self._interest is None:
            return None
        return (
            self._interest.at(grid.centres().reshape(-1, 2)).reshape(grid.shape).astype(np.float32)
        )


def rasterize_cells(grid: Grid, xy: Array, size: Array, value: ArrayLike, fill: float) -> Array:
    """Sample a quantity of quadtree cells at the cell centres of a grid (rows, cols).

    Parameters
    ----------
    grid
        Target grid.
    xy, size
        Centres (n, 2) and sides (n,) of square cells that do not overlap, m.
    value
        Value of each cell (n,).
    fill
        Value outside all cells.
    """
    out = np.full(grid.shape, fill)
    value = np.asarray(value, dtype=np.float64)
    for side in np.unique(size):
        # Cells of one size form a raster, which allows a lookup instead of filling cell by cell.
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


def _return_points(scan: LidarScan, position: Array, attitude: Array) -> Array:
    """Return the points (n, 3) of the pixels of a scan that got a return.

    Points are in the local frame, m. `position` (3,), in the same frame, m, and `attitude` are the
    estimated pose of the lander.
    """
    points = np.asarray(scan.points(position, attitude)).reshape(-1, 3)
    return points[np.isfinite(scan.range).ravel()]

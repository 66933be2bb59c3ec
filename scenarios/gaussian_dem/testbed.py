"""Simulate the testbed and nine scans of the Gaussian DEM paper (IV.B.1, IV.B.2)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from lunarsim import Grid, Heightfield, Terrain, exact_safety, gaussian_dem
from lunarsim.api import Lander, State
from lunarsim.frames import sensor_axes
from lunarsim.onboard.hazards.gaussian_dem import GaussianDem
from lunarsim.sensors.lidar import FlashLidar
from lunarsim.world import World
from lunarsim.world.terrain import place_rocks

LANDER = Lander()
RANGES, ANGLES = (200.0, 500.0, 1000.0), (0.0, 30.0, 60.0)
CONFIGURATIONS = [(r, a) for r in RANGES for a in ANGLES]
POSTING = 0.1  # posting of the truth and of the proposed maps, m
# Only sigma_f^2 / length_scale has an effect. The elevation density requires a smaller value than a
# margin against missed rocks, so Table 5 and Tables 6 and 7 use different settings.
DENSITY = {"sigma_f": 0.1, "length_scale": 10.0}  # Table 5
MARGIN = {"sigma_f": 0.5, "length_scale": 30.0}  # Tables 6 and 7


def growth(setting: dict[str, float]) -> float:
    """Return sigma_f^2 / length_scale, m, of a random field prior.

    It is the rate at which the height variance grows with distance.
    `setting` holds `sigma_f` and `length_scale` (m).
    """
    return setting["sigma_f"] ** 2 / setting["length_scale"]


def prior_of_growth(growth_m: float) -> dict[str, float]:
    """Return a random field prior with a value of sigma_f^2 / length_scale, m."""
    return {"sigma_f": float(np.sqrt(growth_m * 30.0)), "length_scale": 30.0}


@dataclass(frozen=True)
class TestbedField:
    """One simulated testbed: hemispheric rocks on a plane of 200 x 200 m.

    `elevation` (m) and `safety` (true slope, roughness and safety) are given on the cells of
    `grid`.
    """

    terrain: Terrain
    grid: Grid
    elevation: np.ndarray
    safety: Any


@dataclass(frozen=True)
class ScannedDem:
    """A LiDAR scan of a testbed and its Gaussian DEM.

    Attributes
    ----------
    points, sigma, shape
        Returns (n, 3), m; their standard deviation, m; rows and columns of the detector.
    dem
        Gaussian DEM on the evaluated grid.
    window
        Slices of rows and columns of the testbed grid that coincide with the DEM cells.
    """

    points: np.ndarray
    sigma: float
    shape: tuple[int, int]
    dem: GaussianDem
    window: tuple[slice, slice]

    @property
    def grid(self) -> Grid:
        """Grid of the Gaussian DEM."""
        return self.dem.grid


def testbed(
    seed: int, side: float = 100.0, *, rocks: int = 500, diameter: float = 1.0
) -> TestbedField:
    """Generate a testbed with rocks and compute its true safety over a central square.

    `side` is the side of the square and `diameter` that of the `rocks` hemispheres, m. The testbed
    of the Gaussian DEM paper has 500 rocks of 1 m.
    """
    plane = Heightfield(Grid.centred((0.0, 0.0), 202.0, 2.0), np.zeros((101, 101), np.float32))
    rng = np.random.default_rng(seed)
    terrain = Terrain(plane, place_rocks(plane, np.full(rocks, diameter), rng))
    grid = Grid.centred((0.0, 0.0), side, POSTING)
    elevation = terrain.raster(grid)
    return TestbedField(terrain, grid, elevation, exact_safety(elevation, grid, LANDER))


def scan(
    field: TestbedField,
    distance: float,
    angle_deg: float,
    rng: np.random.Generator,
    lidar: FlashLidar | None = None,
) -> tuple[np.ndarray, float, tuple[int, int]]:
    """Scan the center of a testbed with a flash LiDAR at a given range and angle.

    `distance` is the range (m), `angle_deg` the angle off nadir (deg); the sensor points towards
    +x. Returns the points (n, 3), m, their standard deviation, m, and rows and columns of the
    detector.
    """
    angle = np.deg2rad(angle_deg)
    position = distance * np.array([-np.sin(angle), 0.0, np.cos(angle)])
    upright = np.array([0.0, 0.0, 0.0, 1.0])
    state = State(position, np.zeros(3), upright, np.zeros(3), 1.0)
    lidar = lidar or FlashLidar()
    world = World(field.terrain, 1.622)
    flash = lidar.measure(world, state, 0.0, rng, sensor_axes(-position))
    return flash.points(position, upright), lidar.noise_ratio * distance, flash.shape


def view_grid(distance: float) -> Grid:
    """Return the square grid on which scans at a range are evaluated.

    Its side is the width of the scanned area at the range `distance` (m), at most 100 m.
    """
    return Grid.centred((0.0, 0.0), min(100.0, 0.2 * distance), POSTING)


def crop(field: TestbedField, grid: Grid) -> tuple[slice, slice]:
    """Return the row and column slices of the testbed grid that coincide with `grid`."""
    row, col = (int(v) for v in field.grid.cell((grid.x0, grid.y0)))
    return slice(row, row + grid.rows), slice(col, col + grid.cols)


def map_testbed(
    field: TestbedField,
    distance: float,
    angle_deg: float,
    rng: np.random.Generator,
    *,
    sigma_f: float,
    length_scale: float,
    grid: Grid | None = None,
    lidar: FlashLidar | None = None,
    assumed_sigma: float | None = None,
) -> ScannedDem:
    """Scan a testbed and compute its Gaussian DEM.

    `distance` is the range (m), `angle_deg` the angle off nadir (deg). `sigma_f` and `length_scale`
    (m) are the random field prior. The DEM covers `grid`; by default this is the scanned area, at
    most 100 m wide. The DEM uses `assumed_sigma` instead of the true standard deviation of a
    return, m.
    """
    points, sigma, shape = scan(field, distance, angle_deg, rng, lidar)
    sigma = sigma if assumed_sigma is None else assumed_sigma
    grid = grid or view_grid(distance)
    dem = gaussian_dem(
        points, grid, sigma_f=sigma_f, length_scale=length_scale, sigma_eps=sigma, image_shape=shape
    )
    return ScannedDem(points, sigma, shape, dem, crop(field, grid))

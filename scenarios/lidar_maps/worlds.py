"""Generate the matrix of simulated terrains for the evaluation of LiDAR maps.

The axes are relief, rocks, lander and scan. A terrain is identified by the names of its components,
so that complete rows of the matrix can be held out of a fit.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path

import numpy as np

from lunarsim import Grid, Heightfield, Terrain
from lunarsim.api import Estimate, Lander, LidarScan, State
from lunarsim.frames import sensor_axes
from lunarsim.rocks.field import RockField, RockModel
from lunarsim.rocks.size_distribution import sample_diameters
from lunarsim.sensors.lidar import FlashLidar
from lunarsim.world import World
from lunarsim.world.terrain import add_craters, fractal_relief, place_rocks
from lunarsim.world.terrain_models.measured import RasterTerrain

DATA = Path(__file__).resolve().parents[1] / "data"
SIDE = 130.0  # side of the relief, m
MAX_MAP_SIDE = 90.0  # maximum side of the evaluated area, m
POSTING = 0.2  # posting of map and truth, m
RELIEF_POSTING = 0.25
SHARP_POSTING = 0.125  # posting of relief with edges, m
UPRIGHT = np.array([0.0, 0.0, 0.0, 1.0])

RELIEFS = (
    "flat", "tilt-5", "tilt-9", "tilt-14", "fractal-3", "fractal-6", "fractal-10", "rough-5",
    "craters", "hirise-0.2", "hirise-0.5", "apollo15", "trenches", "pits",
)  # fmt: skip
ROCKS = (
    "none", "one-metre", "golombek-2", "golombek-5", "golombek-10", "cubes-5", "irregular-5",
    "small-0.6", "large-2", "posts",
)  # fmt: skip
LANDERS = {
    "paper": Lander(),
    "small": replace(Lander(), leg_radius=1.4, roughness_limit=0.18, pad_diameter=0.2),
    "large": replace(Lander(), leg_radius=3.6, roughness_limit=0.45, pad_diameter=0.6),
    "tripod": replace(Lander(), legs=3, leg_radius=2.0, slope_limit=np.deg2rad(12.0)),
    "gentle": replace(Lander(), slope_limit=np.deg2rad(6.0)),
    "steep": replace(Lander(), leg_radius=2.0, slope_limit=np.deg2rad(18.0)),
}
RANGES = (120.0, 250.0, 500.0, 1000.0)
ANGLES = (0.0, 30.0, 60.0)


@dataclass(frozen=True)
class LidarScene:
    """One test case of the calibration studies: terrain, lander and LiDAR scan.

    Attributes
    ----------
    relief, rocks, lander
        Names from `RELIEFS`, `ROCKS`, `LANDERS`.
    distance, angle_deg
        Distance of the LiDAR from the map center, m, and angle off nadir, deg.
    noise
        Factor on the default noise of the sensor.
    seed
        Seed of relief, rocks and noise.
    """

    relief: str
    rocks: str
    lander: str
    distance: float
    angle_deg: float
    noise: float
    seed: int

    def rng(self, stream: int) -> np.random.Generator:
        """Return the scene's random generator number `stream`."""
        return np.random.default_rng([self.seed, stream])

    def terrain(self) -> Terrain:
        """Generate the relief and its rocks."""
        heightfield = relief(self.relief, self.seed)
        return Terrain(heightfield, rocks(self.rocks, heightfield, self.rng(1)))

    def grid(self) -> Grid:
        """Return the map grid: the area covered by the scan, at most `MAX_MAP_SIDE` wide."""
        return Grid.centred((0.0, 0.0), min(MAX_MAP_SIDE, 0.2 * self.distance), POSTING)

    def simulate_scan(self, terrain: Terrain) -> tuple[LidarScan, np.ndarray]:
        """Simulate a LiDAR scan of the map center; return it and the sensor position.

        The position (3,) is in m.
        """
        angle, azimuth = np.deg2rad(self.angle_deg), self.rng(2).uniform(0.0, 2.0 * np.pi)
        away = np.array([np.cos(azimuth), np.sin(azimuth)])
        level = float(terrain.elevation(np.zeros(2)))
        position = np.array([*(self.distance * np.sin(angle) * away), 0.0])
        position[2] = level + self.distance * np.cos(angle)
        state = State(position, np.zeros(3), UPRIGHT, np.zeros(3), 1.0)
        lidar = FlashLidar()
        lidar = replace(lidar, noise_ratio=self.noise * lidar.noise_ratio)
        aim = np.array([0.0, 0.0, level]) - position
        world = World(terrain, 1.622)
        return lidar.measure(world, state, 0.0, self.rng(3), sensor_axes(aim)), position


def scan_from_above(
    terrain: Terrain, lidar: FlashLidar, distance: float, rng: np.random.Generator
) -> tuple[LidarScan, Estimate]:
    """Simulate a scan from vertically above the map center; return it and the estimated pose.

    `distance` is the height above the terrain, m. The standard deviations of the estimate are 1 m
    and 1 m/s, without attitude errors.
    """
    position = np.array([0.0, 0.0, float(terrain.elevation(np.zeros(2))) + distance])
    state = State(position, np.zeros(3), UPRIGHT, np.zeros(3), 1.0)
    mount = sensor_axes(np.array([0.0, 0.0, -1.0]))
    scan = lidar.measure(World(terrain, 1.622), state, 0.0, rng, mount)
    own = np.diag([1.0] * 6 + [0.0] * 3)
    return scan, Estimate(0.0, position, np.zeros(3), UPRIGHT, np.zeros(3), 1.0, own)


def relief(name: str, seed: int) -> Heightfield:
    """Generate the relief of a name in `RELIEFS`, without rocks.

    The relief is `SIDE` wide; measured terrain has its own size.
    """
    kind, _, figure = name.partition("-")
    grid = Grid.centred((0.0, 0.0), SIDE, RELIEF_POSTING)
    rng = np.random.default_rng([seed, 0])
    if kind in {"hirise", "apollo15"}:
        return _measured_relief(kind, float(figure or 1.0))
    if kind in {"flat", "tilt"}:
        tilt, azimuth = np.tan(np.deg2rad(float(figure or 0.0))), rng.uniform(0.0, 2.0 * np.pi)
        xy = grid.centres()
        z = tilt * (np.cos(azimuth) * xy[..., 0] + np.sin(azimuth) * xy[..., 1])
        return Heightfield(grid, z.astype(np.float32))
    if kind in {"trenches", "pits"}:
        return _trenches_or_pits(kind, rng)
    hurst = {"fractal": 0.85, "rough": 0.6, "craters": 0.9}[kind]
    slope = np.deg2rad(float(figure or 3.0))
    heightfield = fractal_relief(grid, rng, hurst=hurst, rms_slope=slope)
    if kind == "craters":
        heightfield = add_craters(heightfield, rng, minimum=2.0)
    return heightfield


def _trenches_or_pits(kind: str, rng: np.random.Generator) -> Heightfield:
    """Generate smooth terrain with parallel trenches or with pits of one size.

    `kind` is "trenches" or "pits".
    """
    grid = Grid.centred((0.0, 0.0), SIDE, SHARP_POSTING)
    z = fractal_relief(grid, rng, hurst=0.85, rms_slope=np.deg2rad(1.5)).z.astype(np.float64)
    x, y = np.moveaxis(grid.centres(), -1, 0)
    depth = rng.uniform(0.3, 1.2)
    if kind == "trenches":
        azimuth, width, apart = rng.uniform(0.0, np.pi), rng.uniform(0.2, 0.8), rng.uniform(5, 14)
        across = x * np.cos(azimuth) + y * np.sin(azimuth)
        z[(across + rng.uniform(0.0, apart)) % apart < width] -= depth
        return Heightfield(grid, z.astype(np.float32))
    radius, inside = 0.5 * rng.uniform(0.35, 1.2), np.zeros(z.shape, np.bool_)
    for east, north in rng.uniform(-0.5 * SIDE, 0.5 * SIDE, (int(rng.uniform(100, 500)), 2)):
        rows, cols = (
            slice(*np.searchsorted(axis, (at - radius, at + radius)))
            for axis, at in ((grid.y, north), (grid.x, east))
        )
        inside[rows, cols] |= np.hypot(x[rows, cols] - east, y[rows, cols] - north) < radius
    z[inside] -= depth
    return Heightfield(grid, z.astype(np.float32))


@lru_cache(maxsize=4)
def _measured_relief(kind: str, scale: float) -> Heightfield:
    """Load the relief "hirise" or "apollo15"; `scale` multiplies HiRISE heights."""
    part = {
        "hirise": RasterTerrain(
            path=DATA / "hirise_dteec_010228_1490_crop.tif", relief_scale=scale, detail=True,
            hurst=0.8, rms_slope=np.deg2rad(2.0), crater_density=0.0,
        ),
        "apollo15": RasterTerrain(
            path=DATA / "moon_apollo15_nac_dtm_2m.tif", dtm_posting=2.0, height_step=0.192,
            dtm_window=(90, 160, 90, 160), detail=True, preset="mare",
        ),
    }[kind]  # fmt: skip
    return part.relief()


def rocks(name: str, heightfield: Heightfield, rng: np.random.Generator) -> RockField:
    """Sample rocks of a name in `ROCKS` and place them on a relief."""
    kind, _, figure = name.partition("-")
    west, east, south, north = heightfield.bounds
    area = (east - west) * (north - south)
    if kind == "none":
        return RockField.empty()
    if kind in {"one", "small", "large"}:
        # The number that covers 1 % of the terrain: 500 rocks of 1 m on 200 x 200 m.
        diameter = {"one": 1.0, "small": 0.6, "large": 2.0}[kind]
        count = rng.poisson(0.01 * area / (0.25 * np.pi * diameter**2))
        return place_rocks(heightfield, np.full(count, diameter), rng)
    if kind == "posts":
        diameters = rng.uniform(0.2, 0.6, rng.poisson(0.005 * area / (0.25 * np.pi * 0.4**2)))
        tall = RockModel("ellipsoid", (0.95, 0.05), (0.0, 0.1), (0.6, 1.0))
        return place_rocks(heightfield, diameters, rng, model=tall)
    cover = 0.01 * float(figure)
    model = {
        "golombek": RockModel(), "cubes": RockModel("cube"), "irregular": RockModel("mixed"),
    }[kind]  # fmt: skip
    diameters = sample_diameters(area, cover, 0.15, 3.0, rng)
    return place_rocks(heightfield, diameters, rng, model=model)


def sample_matrix(count: int, seed: int) -> Iterator[LidarScene]:
    """Yield random scenes that use every relief, rock law and lander equally often."""
    rng = np.random.default_rng([seed, 99])
    decks: dict[str, list[str]] = {}
    for n in range(count):
        hand = {}
        for name, cards in (("relief", RELIEFS), ("rocks", ROCKS), ("lander", tuple(LANDERS))):
            if not decks.get(name):
                decks[name] = list(rng.permutation(cards))
            hand[name] = str(decks[name].pop())
        yield LidarScene(
            **hand,
            distance=float(RANGES[n % len(RANGES)] * rng.uniform(0.8, 1.25)),
            angle_deg=float(rng.choice(ANGLES)),
            noise=float(rng.choice([0.5, 1.0, 1.0, 2.0])),
            seed=seed * 100_003 + n,
        )

"""Scanning LiDAR: one ray after the other while the lander moves."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lunarsim.errors import InputError
from lunarsim.frames import quat_to_matrix
from lunarsim.sensors.lidar import FlashLidar, LidarScan
from lunarsim.world import World

Array = NDArray[np.float64]

# Positions (n, 3), ENU, and attitudes (n, 4) of the lander at times (n,), s.
Trajectory = Callable[[Array], tuple[Array, Array]]


@dataclass(frozen=True)
class ScanningLidar(FlashLidar):
    """A LiDAR that draws a raster, row by row, each row from left to right.

    Attributes
    ----------
    ray_rate
        Rays a second, Hz; the others are those of `FlashLidar`, for the raster's grid of angles.
    """

    ray_rate: float = 100_000.0

    def __post_init__(self) -> None:
        super().__post_init__()
        if not (np.isfinite(self.ray_rate) and self.ray_rate > 0.0):
            raise InputError("lidar.ray_rate", self.ray_rate, "a positive number of rays a second")

    def scan(
        self,
        world: World,
        trajectory: Trajectory,
        time: float,
        rng: np.random.Generator,
        mount: Array,
    ) -> LidarScan:
        """Draw one raster.

        Parameters
        ----------
        world
            The truth.
        trajectory
            The lander's true motion.
        time
            Of the first ray, s.
        rng
            Source of range noise and lost returns.
        mount
            Rotation (3, 3), sensor to body, held through the raster.
        """
        direction = self.directions()
        delay = np.arange(len(direction)) / self.ray_rate
        position, attitude = trajectory(time + delay)
        rotation = quat_to_matrix(attitude) @ mount
        rays = np.einsum("nij,nj->ni", rotation, direction)
        origin = np.ascontiguousarray(position, dtype=np.float64)
        measured, sigma, incidence = self._sense(world, origin, rays, rng)
        shape = (self.rows, self.cols)
        return LidarScan(time, measured, direction, mount, sigma, incidence, shape, delay)

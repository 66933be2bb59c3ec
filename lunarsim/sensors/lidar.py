"""Flash LiDAR: one range for every pixel of a detector, all at one instant."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import ClassVar, Literal

import numpy as np
from numpy.typing import NDArray

from lunarsim.errors import InputError
from lunarsim.frames import quat_from_rotation_vector, quat_multiply, quat_to_matrix
from lunarsim.messages.measurements import LidarScan
from lunarsim.models.camera import DOWN
from lunarsim.models.instruments import LidarInstrument
from lunarsim.parts.quantity import check_bounds, quantity
from lunarsim.vehicle.state import State
from lunarsim.world import World

Array = NDArray[np.float64]

_REFERENCE_RANGE = 500.0
# Of a detector: a map of more returns takes gigabytes.
_MOST_PIXELS = 2**22


@dataclass(frozen=True)
class FlashLidar:
    """A flash LiDAR: pixels even in the tangent of the angle (a pin-hole) or in the angle itself.

    Defaults are those of section IV.B of the Gaussian DEM paper: 256 x 256 pixels that cover
    100 x 100 m from 500 m straight above, noise along each ray with 3 sigma = 5 cm at 500 m,
    growing in proportion to range.

    Attributes
    ----------
    rows, cols
        Detector size, pixels.
    half_width
        Tangent of half the field of view, both axes.
    noise_ratio
        Standard deviation of the range over the range.
    max_range
        Longest range that gives a return, m.
    spacing
        "tangent" or "angle".
    max_incidence
        Greatest angle between ray and surface normal that gives a return, rad.
    photons
        Mean photons of a return from 500 m at normal incidence. They fall with the cosine of the
        incidence and the square of the range, and a pixel without a photon has no return; None:
        none is lost.
    divergence
        Half angle of the beam at 1/e^2 of its peak, rad; 0: a line. The range is the mean over the
        footprint.
    gimbal_limit
        Greatest angle of the boresight from straight down through the lander, rad.
    range_sigma, boresight_sigma, latency_sigma
        What a LiDAR errs by over a whole flight, 1 sigma, m, rad (an axis), s: drawn once a flight,
        and stated in the calibration.
    range_bias, boresight_off, late
        Errors besides that the calibration says nothing of, m, rad, s.
    """

    rows: int = quantity(256, ge=2, le=4096, help="of the detector")
    cols: int = quantity(256, ge=2, le=4096, help="of the detector")
    half_width: float = quantity(0.1, gt=0, lt=2, help="tangent of half the field of view")
    noise_ratio: float = quantity(
        0.05 / 3.0 / 500.0, ge=0, lt=0.1, help="1 sigma over the range, along the ray"
    )
    max_range: float = quantity(2000.0, "m", gt=0, help="no return beyond")
    spacing: Literal["tangent", "angle"] = quantity("tangent", help="pixels even in this")
    max_incidence: float = quantity(90.0, "deg", gt=0, le=90, help="no return beyond")
    photons: float | None = quantity(
        None, gt=0, help="mean of a return from 500 m head-on; left out: no return is lost"
    )
    divergence: float = quantity(0.0, "mrad", ge=0, lt=100, help="half angle at 1/e^2")
    gimbal_limit: float = quantity(
        180.0, "deg", gt=0, le=180, help="greatest angle of the boresight from body -z"
    )

    range_sigma: float = quantity(
        0.0, "m", ge=0, lt=10, help="constant of all ranges, 1 sigma, drawn and stated"
    )
    boresight_sigma: float = quantity(
        0.0, "deg", ge=0, lt=5, help="constant of the mount, 1 sigma an axis, drawn and stated"
    )
    latency_sigma: float = quantity(
        0.0, "s", ge=0, lt=1, help="of the times of flashes, 1 sigma, drawn and stated"
    )
    range_bias: float = quantity(
        0.0, "m", ge=-10, le=10, help="of all ranges besides, which nobody is told of"
    )
    boresight_off: float = quantity(
        0.0, "deg", ge=-5, le=5, help="about the sensor's x besides, which nobody is told of"
    )
    late: float = quantity(0.0, "s", ge=0, lt=1, help="of flashes besides, which nobody is told of")

    gives: ClassVar[type] = LidarScan
    tasked: ClassVar[bool] = True

    def __post_init__(self) -> None:
        check_bounds(self, "lidar")
        if self.spacing not in {"tangent", "angle"}:
            raise InputError("lidar.spacing", self.spacing, "tangent or angle")
        if self.rows * self.cols > _MOST_PIXELS:
            raise InputError(
                "lidar.rows", self.rows,
                f"at most {_MOST_PIXELS // self.cols} with {self.cols} columns: {_MOST_PIXELS} "
                "returns a flash",
            )  # fmt: skip

    def build(self, rng: np.random.Generator, step: float) -> FlashLidar | BiasedLidar:
        """Return the LiDAR of one flight."""
        constant = (self.range_bias, self.boresight_off, self.late)
        stated = (self.range_sigma, self.boresight_sigma, self.latency_sigma)
        return BiasedLidar(self, rng) if any(np.ravel((*constant, *stated))) else self

    def calibration(self) -> LidarInstrument:
        """Return what the onboard computer may know of it."""
        spread = self.half_width if self.spacing == "tangent" else np.arctan(self.half_width)
        return LidarInstrument(
            self.gimbal_limit, self.range_sigma, self.boresight_sigma, self.latency_sigma,
            2.0 * float(spread) / min(self.rows, self.cols), self.half_width, self.max_range,
            self.max_incidence,
        )  # fmt: skip

    def directions(self) -> Array:
        """Return the pixels' unit vectors (rows * cols, 3) in the sensor frame, row by row."""
        u = (np.arange(self.cols) + 0.5) / self.cols * 2.0 - 1.0
        v = (np.arange(self.rows) + 0.5) / self.rows * 2.0 - 1.0
        if self.spacing == "angle":
            half = np.arctan(self.half_width)
            u, v = np.tan(u * half), np.tan(v * half)
        else:
            u, v = u * self.half_width, v * self.half_width
        uu, vv = np.meshgrid(u, v)
        rays = np.stack((uu, vv, np.ones_like(uu)), axis=-1).reshape(-1, 3)
        return np.asarray(rays / np.linalg.norm(rays, axis=1, keepdims=True))

    def measure(
        self,
        world: World,
        state: State,
        time: float,
        rng: np.random.Generator,
        mount: Array | None = None,
    ) -> LidarScan:
        """Flash once.

        Parameters
        ----------
        world, state, time
            The truth now.
        rng
            Source of the range noise.
        mount
            Rotation (3, 3), sensor to body, that the gimbal holds; left out: straight down.
        """
        mount = DOWN if mount is None else mount
        direction = self.directions()
        rotation = quat_to_matrix(state.attitude) @ mount
        origin = np.asarray(state.position, dtype=np.float64)
        measured, sigma = self._sense(world, origin, direction @ rotation.T, rng)
        shape = (self.rows, self.cols)
        return LidarScan(time, measured, direction, mount, sigma, shape)

    def _sense(
        self, world: World, origin: Array, rays: Array, rng: np.random.Generator
    ) -> tuple[Array, Array]:
        """Return measured range and its stated deviation of rays (n, 3), ENU.

        `origin` is (3,) for all or (n, 3).
        """
        hits = world.terrain.cast(origin, rays, self.max_range)
        true = hits.range if self.divergence == 0.0 else self._beam(world, origin, rays, hits.range)
        cosine = np.clip(-np.einsum("ij,ij->i", hits.normal, rays), 0.0, 1.0)
        incidence = np.arccos(cosine)
        measured = true * (1.0 + self.noise_ratio * rng.standard_normal(true.size))
        # What is stated goes by what was measured: the truth stays here.
        sigma = self.noise_ratio * np.abs(measured)
        lost = ~(incidence <= self.max_incidence)
        if self.photons is not None:
            mean = self.photons * cosine * (_REFERENCE_RANGE / true) ** 2
            lost |= rng.random(mean.size) < np.exp(-mean)
        for values in (measured, sigma):
            values[lost] = np.nan
        return measured, sigma

    def _beam(self, world: World, origin: Array, rays: Array, centre: Array) -> Array:
        """Return the mean range over the beam's footprint, NaN where its centre finds nothing.

        Seven rays, the centre and a hexagon, have the second moments of a Gaussian beam.
        """
        across = np.cross(
            rays, np.where(np.abs(rays[:, 2:]) < 0.9, [0.0, 0.0, 1.0], [1.0, 0.0, 0.0])
        )
        across /= np.linalg.norm(across, axis=1, keepdims=True)
        third = np.cross(rays, across)
        radius = 0.5 * self.divergence * np.sqrt(7.0 / 3.0)
        total, count = centre.copy(), np.ones(centre.size)
        for angle in np.arange(6) * np.pi / 3.0:
            aside = radius * (np.cos(angle) * across + np.sin(angle) * third)
            ray = rays + aside
            ray /= np.linalg.norm(ray, axis=1, keepdims=True)
            found = world.terrain.cast(origin, ray, self.max_range, normals=False).range
            seen = np.isfinite(found)
            total[seen] += found[seen]
            count += seen
        return np.asarray(total / count)


class BiasedLidar:
    """A LiDAR with what it errs by over a whole flight.

    Parameters
    ----------
    figures
        Of the LiDAR.
    rng
        Source of its errors.

    Attributes
    ----------
    range_bias
        Added to all ranges, m.
    boresight
        Small rotation between sensor and what the gimbal tells (3,), sensor axes, rad.
    latency
        By which a flash comes before the time that it is given, s.
    """

    def __init__(self, figures: FlashLidar, rng: np.random.Generator) -> None:
        f, drawn = figures, rng.standard_normal(5)
        self.figures = figures
        self.range_bias = f.range_bias + f.range_sigma * float(drawn[0])
        self.boresight = f.boresight_sigma * drawn[1:4] + [f.boresight_off, 0.0, 0.0]
        self.latency = f.late + f.latency_sigma * float(drawn[4])

    def measure(
        self,
        world: World,
        state: State,
        time: float,
        rng: np.random.Generator,
        mount: Array | None = None,
    ) -> LidarScan:
        """Flash once; the lander is taken to have moved evenly over the latency."""
        told = DOWN if mount is None else mount
        aim = quat_to_matrix(quat_from_rotation_vector(self.boresight))
        turn = quat_from_rotation_vector(-self.latency * np.asarray(state.rate))
        then = replace(
            state,
            position=state.position - self.latency * state.velocity,
            attitude=quat_multiply(state.attitude, turn),
        )
        scan = self.figures.measure(world, then, time, rng, told @ aim)
        # A range biased to below nothing is no return.
        biased = scan.range + self.range_bias
        return replace(scan, range=np.where(biased > 0.0, biased, np.nan), mount=told)

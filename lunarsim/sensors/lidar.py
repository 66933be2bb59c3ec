"""Flash LiDAR: the ranges of all pixels of a detector at one instant."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import ClassVar, Literal

import numpy as np
from numpy.typing import ArrayLike

from lunarsim.errors import InputError
from lunarsim.frames import quat_from_rotation_vector, quat_multiply, quat_to_matrix
from lunarsim.messages.measurements import LidarScan
from lunarsim.models.camera import DOWNWARD_MOUNT
from lunarsim.models.instruments import LidarInstrument
from lunarsim.parts.quantity import check_bounds, quantity
from lunarsim.typing import Array
from lunarsim.vehicle.state import State
from lunarsim.world import World

_REFERENCE_RANGE = 500.0
# Limit of a detector: a map of more returns takes gigabytes of memory.
_MAX_PIXELS = 2**22


@dataclass(frozen=True)
class FlashLidar:
    """Settings of a flash LiDAR, which measures all pixels' ranges at one instant.

    Defaults are those of section IV.B of the Gaussian DEM paper: 256 x 256 pixels that cover
    100 x 100 m from 500 m vertically above, noise along each ray with 3 sigma = 5 cm at 500 m,
    proportional to range. Noise floor, quantization and false returns are 0 there.

    A false return is a noise count of the detector before the pulse arrives: background light or a
    dark count. The pixel then reports its time. Noise counts at a constant low rate are uniform
    over the gate, here from the sensor to the terrain (D. G. Fouche, "Detection and false-alarm
    probabilities for laser radars that use Geiger-mode detectors", Applied Optics 42, 2003).

    Attributes
    ----------
    photons
        Mean photons of a return from 500 m at normal incidence. They scale with the cosine of the
        incidence and the inverse square of the range. A pixel without a photon has no return; None:
        no return is lost.
    divergence
        Half angle of the beam at 1/e^2 of its peak, rad; 0: a line. The range is the mean over the
        footprint.
    range_sigma, boresight_sigma, latency_sigma
        Standard deviations of errors that are constant over a flight, m, rad (per axis), s. The
        errors are sampled for every flight; the onboard computer knows the standard deviations.
    range_bias, boresight_bias, latency_bias
        Additional constant errors that are unknown to the onboard computer, m, rad, s.
    """

    rows: int = quantity(256, ge=2, le=4096, help="number of pixel rows of the detector")
    cols: int = quantity(256, ge=2, le=4096, help="number of pixel columns of the detector")
    half_fov_tangent: float = quantity(
        0.1,
        gt=0,
        lt=2,
        help="tangent of half the field-of-view angle, equal along rows and columns",
    )
    noise_ratio: float = quantity(
        0.05 / 3.0 / 500.0, ge=0, lt=0.1, help="range noise divided by range, 1 sigma"
    )
    noise_floor: float = quantity(
        0.0,
        "m",
        ge=0,
        lt=10,
        help="range noise that does not depend on range, 1 sigma; combined in quadrature with "
        "noise_ratio",
    )
    range_step: float = quantity(
        0.0, "m", ge=0, lt=10, help="step to which ranges are rounded; 0: no rounding"
    )
    false_return_fraction: float = quantity(
        0.0,
        ge=0,
        lt=1,
        help="fraction of the returns that are noise counts; their ranges are uniformly "
        "distributed between 0 and the range of the terrain",
    )
    max_range: float = quantity(
        2000.0, "m", gt=0, help="maximum range at which the sensor receives a return"
    )
    pixel_spacing: Literal["tangent", "angle"] = quantity(
        "tangent",
        help="spacing of the pixels: tangent (equal steps in the image plane, as in a pinhole "
        "camera) or angle (equal steps in angle)",
    )
    max_incidence: float = quantity(
        90.0,
        "deg",
        gt=0,
        le=90,
        help="maximum angle between laser ray and surface normal at which the sensor receives a "
        "return",
    )
    photons: float | None = quantity(
        None,
        gt=0,
        help="mean number of photons in a return from 500 m at normal incidence; a pixel without "
        "photons has no return; omitted: no return is lost",
    )
    divergence: float = quantity(
        0.0,
        "mrad",
        ge=0,
        lt=100,
        help="half angle of the laser beam at 1/e^2 of its peak intensity; 0: a line",
    )
    gimbal_limit: float = quantity(
        180.0,
        "deg",
        gt=0,
        le=180,
        help="maximum angle between the boresight and body -z to which the gimbal can turn",
    )

    range_sigma: float = quantity(
        0.0,
        "m",
        ge=0,
        lt=10,
        help="range bias that is random in each flight, 1 sigma; the onboard computer knows this "
        "sigma",
    )
    boresight_sigma: float = quantity(
        0.0,
        "deg",
        ge=0,
        lt=5,
        help="misalignment of the boresight that is random in each flight, 1 sigma per axis; the "
        "onboard computer knows this sigma",
    )
    latency_sigma: float = quantity(
        0.0,
        "s",
        ge=0,
        lt=1,
        help="latency (measurements are older than their time stamps), random in each flight, 1 "
        "sigma; the onboard computer knows this sigma",
    )
    range_bias: float = quantity(
        0.0,
        "m",
        ge=-10,
        le=10,
        help="additional range bias, equal in all flights and unknown to the onboard computer",
    )
    boresight_bias: float = quantity(
        0.0,
        "deg",
        ge=-5,
        le=5,
        help="additional rotation of the boresight about the sensor's x axis, equal in all flights "
        "and unknown to the onboard computer",
    )
    latency_bias: float = quantity(
        0.0,
        "s",
        ge=0,
        lt=1,
        help="additional latency (measurements are older than their time stamps), equal in all "
        "flights and unknown to the onboard computer",
    )

    measurement_type: ClassVar[type] = LidarScan
    is_tasked: ClassVar[bool] = True

    def __post_init__(self) -> None:
        check_bounds(self, "lidar")
        if self.pixel_spacing not in {"tangent", "angle"}:
            raise InputError("lidar.pixel_spacing", self.pixel_spacing, "must be tangent or angle")
        if self.rows * self.cols > _MAX_PIXELS:
            raise InputError(
                "lidar.rows", self.rows,
                f"must be at most {_MAX_PIXELS // self.cols} if cols is {self.cols}, because a "
                "scan has "
                f"at most {_MAX_PIXELS} returns",
            )  # fmt: skip

    def build(self, rng: np.random.Generator, step: float) -> FlashLidar | BiasedLidar:
        """Return the LiDAR of one flight; constant errors come from `rng`.

        Without constant errors, the result is this object. `step` is not used.
        """
        constant = (self.range_bias, self.boresight_bias, self.latency_bias)
        stated = (self.range_sigma, self.boresight_sigma, self.latency_sigma)
        return BiasedLidar(self, rng) if any(np.ravel((*constant, *stated))) else self

    def calibration(self) -> LidarInstrument:
        """Return the calibration of the LiDAR for the onboard computer.

        It consists of the gimbal limit, the standard deviations of the constant errors, the pixel
        angle, the field of view, the limits of range and incidence, and the divergence. The biases
        with names that end in ``_bias`` are not part of it.
        """
        spread = (
            self.half_fov_tangent
            if self.pixel_spacing == "tangent"
            else np.arctan(self.half_fov_tangent)
        )
        return LidarInstrument(
            self.gimbal_limit, self.range_sigma, self.boresight_sigma, self.latency_sigma,
            2.0 * float(spread) / min(self.rows, self.cols), self.half_fov_tangent, self.max_range,
            self.max_incidence, self.divergence,
        )  # fmt: skip

    def stated_sigma(self, distance: ArrayLike) -> Array:
        """Return the stated standard deviation of measured ranges (...), m.

        Noise floor, proportional noise and the rounding error of a uniform distribution
        (``range_step / sqrt(12)``) are combined in quadrature. False returns are not included.

        Parameters
        ----------
        distance
            Measured ranges (...), m.
        """
        constant = np.hypot(self.noise_floor, self.range_step / np.sqrt(12.0))
        return np.asarray(np.hypot(constant, self.noise_ratio * np.abs(distance)))

    def directions(self) -> Array:
        """Return the viewing directions (rows * cols, 3) of the pixels, sensor frame.

        They are unit vectors, row by row.
        """
        u = (np.arange(self.cols) + 0.5) / self.cols * 2.0 - 1.0
        v = (np.arange(self.rows) + 0.5) / self.rows * 2.0 - 1.0
        if self.pixel_spacing == "angle":
            half = np.arctan(self.half_fov_tangent)
            u, v = np.tan(u * half), np.tan(v * half)
        else:
            u, v = u * self.half_fov_tangent, v * self.half_fov_tangent
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
        """Measure the ranges of all pixels in one flash, without constant errors.

        The range of a pixel without a return is NaN.

        Parameters
        ----------
        world, state, time
            True world and state, and the time, s.
        rng
            Source of the range noise, of lost and of false returns.
        mount
            Rotation (3, 3), sensor to body, of the gimbal; omitted: boresight along body -z.
        """
        return self.measure_with_bias(world, state, time, rng, mount, 0.0)

    def measure_with_bias(
        self,
        world: World,
        state: State,
        time: float,
        rng: np.random.Generator,
        mount: Array | None,
        bias: float,
    ) -> LidarScan:
        """Measure the ranges of all pixels in one flash, with a range bias.

        `bias` is added to all ranges before rounding, m. Ranges that are not positive are NaN. The
        other parameters are those of `measure`.
        """
        mount = DOWNWARD_MOUNT if mount is None else mount
        direction = self.directions()
        rotation = quat_to_matrix(state.attitude) @ mount
        origin = np.asarray(state.position, dtype=np.float64)
        rays = direction @ rotation.T
        measured, sigma = self._sense(world, origin, rays, rng)
        sheet = world.dust_sheet(origin, state.attitude, state.thrust)
        if sheet is not None:
            measured = sheet.ranges(origin, rays, measured, rng)
            sigma = self.stated_sigma(measured)
        measured = self._digitize(measured + bias)
        shape = (self.rows, self.cols)
        return LidarScan(time, measured, direction, mount, sigma, shape)

    def _sense(
        self, world: World, origin: Array, rays: Array, rng: np.random.Generator
    ) -> tuple[Array, Array]:
        """Return the measured ranges (n,) of rays and their standard deviations (n,), m.

        `rays` (n, 3) are unit vectors, ENU, and `origin` is their start, (3,) or (n, 3), m. Both
        results are NaN without a return.
        """
        hits = world.cast(origin, rays, self.max_range)
        true = (
            hits.range
            if self.divergence == 0.0
            else self._average_over_beam(world, origin, rays, hits.range)
        )
        cosine = np.clip(-np.einsum("ij,ij->i", hits.normal, rays), 0.0, 1.0)
        incidence = np.arccos(cosine)
        noise = np.hypot(self.noise_floor / true, self.noise_ratio)
        measured = true * (1.0 + noise * rng.standard_normal(true.size))
        lost = ~(incidence <= self.max_incidence)
        if self.photons is not None:
            mean = self.photons * cosine * (_REFERENCE_RANGE / true) ** 2
            lost |= rng.random(mean.size) < np.exp(-mean)
        if self.false_return_fraction > 0.0:
            is_false = rng.random(true.size) < self.false_return_fraction
            measured = np.where(is_false, true * rng.random(true.size), measured)
        measured[lost] = np.nan
        # The stated sigma depends on the measured range, so that it does not reveal the true one.
        return measured, self.stated_sigma(measured)

    def _digitize(self, distance: Array) -> Array:
        """Round ranges (n,), m, to the range step; NaN where the result is not positive."""
        if self.range_step > 0.0:
            distance = self.range_step * np.rint(distance / self.range_step)
        with np.errstate(invalid="ignore"):
            return np.where(distance > 0.0, distance, np.nan)

    def _average_over_beam(self, world: World, origin: Array, rays: Array, centre: Array) -> Array:
        """Return the mean range (n,), m, over the footprint of each beam.

        `origin` and `rays` are the start and the unit vectors (n, 3) of the beams, ENU; `centre`
        (n,) are the ranges of the beam centres, m. The result is NaN where the beam centre has no
        return. Seven rays, the centre and a hexagon, have the second moments of a Gaussian beam;
        rays without a return are omitted from the mean.
        """
        across = np.cross(
            rays, np.where(np.abs(rays[:, 2:]) < 0.9, [0.0, 0.0, 1.0], [1.0, 0.0, 0.0])
        )
        across /= np.linalg.norm(across, axis=1, keepdims=True)
        third = np.cross(rays, across)
        radius = 0.5 * self.divergence * np.sqrt(7.0 / 3.0)
        total, count = centre.copy(), np.ones(centre.size)
        for angle in np.arange(6) * np.pi / 3.0:
            offset = radius * (np.cos(angle) * across + np.sin(angle) * third)
            ray = rays + offset
            ray /= np.linalg.norm(ray, axis=1, keepdims=True)
            found = world.cast(origin, ray, self.max_range, normals=False).range
            seen = np.isfinite(found)
            total[seen] += found[seen]
            count += seen
        return np.asarray(total / count)


class BiasedLidar:
    """Simulated LiDAR of one flight, with constant errors.

    Parameters
    ----------
    params
        Parameters of the LiDAR.
    rng
        Source of the constant errors.

    Attributes
    ----------
    range_bias
        Error added to all ranges, m.
    boresight
        Small rotation between the sensor and the reported mounting (3,), sensor axes, rad.
    latency
        Reported time minus true time of a flash, s.
    """

    def __init__(self, params: FlashLidar, rng: np.random.Generator) -> None:
        f, drawn = params, rng.standard_normal(5)
        self.params = params
        self.range_bias = f.range_bias + f.range_sigma * float(drawn[0])
        self.boresight = f.boresight_sigma * drawn[1:4] + [f.boresight_bias, 0.0, 0.0]
        self.latency = f.latency_bias + f.latency_sigma * float(drawn[4])

    def measure(
        self,
        world: World,
        state: State,
        time: float,
        rng: np.random.Generator,
        mount: Array | None = None,
    ) -> LidarScan:
        """Measure the ranges of all pixels in one flash, with noise and constant errors.

        `state` is the true state at the reported `time`, s, and `mount` (3, 3) the reported
        rotation, sensor to body. The lander's motion is assumed constant over the latency. Ranges
        without a return, or not positive with their bias, are NaN.
        """
        used_mount = DOWNWARD_MOUNT if mount is None else mount
        aim = quat_to_matrix(quat_from_rotation_vector(self.boresight))
        turn = quat_from_rotation_vector(-self.latency * np.asarray(state.rate))
        then = replace(
            state,
            position=state.position - self.latency * state.velocity,
            attitude=quat_multiply(state.attitude, turn),
        )
        scan = self.params.measure_with_bias(
            world, then, time, rng, used_mount @ aim, self.range_bias
        )
        return replace(scan, mount=used_mount)

"""Dust that the engine's plume lifts, and what sensors detect through it.

Above a threshold, the pressure of the plume on the terrain erodes the regolith; it is proportional
to thrust over the square of the height (Roberts 1963, "The action of a hypersonic jet on a dust
layer", IAS paper 63-50). The optical depth of the dust is proportional to the excess over the
threshold. Grains leave radially, 1 to 3 deg above the horizontal (Immer et al. 2011, Icarus 214,
46-52), at hundreds of metres per second: they form a thin sheet, which follows the thrust without
delay and whose optical depth falls with the distance from the axis of the plume.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lunarsim.frames import quat_rotate
from lunarsim.models.pinhole import View
from lunarsim.parts.quantity import check_bounds, quantity
from lunarsim.typing import Array, BoolArray
from lunarsim.world.light import Light
from lunarsim.world.terrain import Terrain


@dataclass(frozen=True)
class Dust:
    """Settings of the dust under the engine.

    Defaults of height and optical depth are those of Apollo 12: dust first appeared at about 30 m,
    and from 12 m the terrain was almost completely obscured (Apollo 12 descent film; MSC review of
    22 December 1969). From 12 m, the optical depth is then about 3 at 45 deg below the horizontal.

    Attributes
    ----------
    onset_height, onset_thrust
        Height, m, at which this thrust, N, begins to erode the terrain.
    optical_depth
        Vertical optical depth on the axis of the plume, per excess of the pressure over its
        threshold (threshold = 1).
    core_radius
        Distance from the axis over which the dust is accelerated, m: an assumption.
    ejection_angle
        Angle of the top of the sheet above the horizontal, rad.
    radar_ratio
        Optical depth for a radar over that for light. Grains of 50 um in waves of 8 mm have the
        size parameter x = 0.02; their extinction efficiency ``4 x Im(K)`` with Im(K) = 0.02 is
        0.0016, in place of 2 for light.
    false_return_fraction
        Fraction of the light that the dust extinguishes and that a LiDAR detects as a return from
        the dust: an assumption.
    brightness
        Radiance factor of a dense sheet over that of horizontal terrain by Lambert's law: an
        assumption.
    """

    onset_height: float = quantity(
        30.0, "m", gt=0, le=1000, help="height of the centre of mass above the terrain at which "
        "onset_thrust_n begins to lift dust; other thrusts: proportional to the root of the thrust",
    )  # fmt: skip
    onset_thrust: float = quantity(
        13_000.0, "N", gt=0, help="thrust that lifts dust below onset_height_m"
    )
    optical_depth: float = quantity(
        1.0, ge=0, le=100, help="vertical optical depth on the axis of the plume if the plume's "
        "pressure on the terrain is twice the pressure that begins to lift dust",
    )  # fmt: skip
    core_radius: float = quantity(
        5.0, "m", gt=0, le=100, help="distance from the axis of the plume from which the optical "
        "depth decreases in inverse proportion to the distance",
    )  # fmt: skip
    ejection_angle: float = quantity(
        3.0, "deg", gt=0, le=45, help="angle of the dust sheet's scale height above the horizontal"
    )
    radar_ratio: float = quantity(
        1e-3, ge=0, le=1, help="optical depth for a radar altimeter divided by that for light"
    )
    false_return_fraction: float = quantity(
        0.3, ge=0, le=1, help="fraction of the LiDAR pulses lost in the dust that give a false "
        "return from the dust",
    )  # fmt: skip
    brightness: float = quantity(
        1.0, ge=0, le=10, help="brightness of dense dust in camera images, divided by that of "
        "horizontal sunlit terrain by Lambert's law",
    )  # fmt: skip

    def __post_init__(self) -> None:
        check_bounds(self, "dust")

    def sheet(
        self, terrain: Terrain, position: Array, attitude: Array, thrust: float
    ) -> DustSheet | None:
        """Return the dust that the engine lifts; None if there is none.

        Parameters
        ----------
        terrain
            True terrain.
        position, attitude
            Centre of mass (3,), ENU, m, and quaternion (4,), scalar last, body to ENU.
        thrust
            Thrust of the engine along body z, N.
        """
        reach = self.onset_height * np.sqrt(max(thrust, 0.0) / self.onset_thrust)
        if reach <= 0.0:
            return None
        down = -quat_rotate(attitude, [0.0, 0.0, 1.0])
        height = float(terrain.cast(position, down[None, :], reach, normals=False).range[0])
        if not height < reach:  # NaN: the terrain is farther away
            return None
        excess = (reach / height) ** 2 - 1.0
        return DustSheet(self, position + height * down, self.optical_depth * excess)


@dataclass(frozen=True)
class DustSheet:
    """Thin sheet of dust over the terrain around the axis of the plume.

    Attributes
    ----------
    settings
        Settings of the dust.
    foot
        Point of the terrain on the axis of the plume (3,), ENU, m.
    depth
        Vertical optical depth at the foot.
    """

    settings: Dust
    foot: Array
    depth: float

    def along(self, origin: Array, rays: Array) -> tuple[Array, Array]:
        """Return optical depth and scale height (m) of the dust along rays, both (...,).

        The sheet lies on the horizontal plane through the foot. At a distance r from the foot, its
        vertical optical depth is ``depth / sqrt(1 + (r / core_radius)^2)``, its scale height
        ``tan(ejection_angle) sqrt(core_radius^2 + r^2)``. A ray that does not descend to the plane
        has the optical depth 0.

        Parameters
        ----------
        origin, rays
            Start (3,) of the rays, ENU, m, and their unit vectors (..., 3).
        """
        fall = np.maximum(-rays[..., 2], 1e-3)
        distance = (origin[2] - self.foot[2]) / fall
        meets = (rays[..., 2] < 0.0) & (distance > 0.0)
        at = origin[:2] + distance[..., None] * rays[..., :2] - self.foot[:2]
        radius = np.hypot(self.settings.core_radius, np.linalg.norm(at, axis=-1))
        depth = self.depth * self.settings.core_radius / radius / fall
        return np.where(meets, depth, 0.0), np.tan(self.settings.ejection_angle) * radius

    def passes(
        self, origin: Array, rays: Array, ratio: float, rng: np.random.Generator
    ) -> BoolArray:
        """Return whether pulses return from the terrain through the dust (n,).

        The probability is the transmission of both ways, ``exp(-2 ratio depth)``.

        Parameters
        ----------
        origin, rays
            As in `along`.
        ratio
            Optical depth of the sensor's waves over that of light.
        rng
            Source of one random number per ray.
        """
        transmission = np.exp(-2.0 * ratio * self.along(origin, rays)[0])
        return np.asarray(rng.random(len(rays)) < transmission)

    def ranges(self, origin: Array, rays: Array, ranges: Array, rng: np.random.Generator) -> Array:
        """Return LiDAR ranges (n,), m, through the dust; NaN: extinguished.

        A pulse returns from the terrain with the probability ``exp(-2 depth)``. Of the others,
        `false_return_fraction` return from the dust, whose density falls exponentially with height.

        Parameters
        ----------
        origin, rays
            As in `along`.
        ranges
            Measured ranges without dust (n,), m; NaN without a return.
        rng
            Source of three random numbers per ray.
        """
        depth, scale_height = self.along(origin, rays)
        drawn = rng.random((3, len(rays)))
        lost = -np.expm1(-2.0 * depth)  # probability
        # Optical depth to the point in the dust that returns the pulse, over that of the sheet.
        with np.errstate(divide="ignore", invalid="ignore"):
            part = -0.5 * np.log1p(-drawn[1] * lost) / depth
            above = -scale_height * np.log(part) / -rays[:, 2]
        is_false = drawn[2] < self.settings.false_return_fraction
        dusty = np.where(is_false, ranges - above, np.nan)
        return np.where(drawn[0] < lost, np.where(dusty > 0.0, dusty, np.nan), ranges)

    def veil(self, view: View, light: Light, radiance: NDArray[np.float32]) -> NDArray[np.float32]:
        """Return the radiance factor of an image (height, width) seen through the dust.

        The terrain's radiance is multiplied by exp(-depth), and the sheet adds its brightness times
        1 - exp(-depth).

        Parameters
        ----------
        view, light
            Camera view, and light of the image.
        radiance
            Radiance factor without dust (height, width).
        """
        depth = self.along(view.position, view.rays().reshape(-1, 3))[0].reshape(radiance.shape)
        through = np.exp(-depth)
        sunlit = max(float(light.direction[2]), 0.0)
        dust = self.settings.brightness * light.albedo * (sunlit + light.ambient)
        return (radiance * through + dust * (1.0 - through)).astype(np.float32)

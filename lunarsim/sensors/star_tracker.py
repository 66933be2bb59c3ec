"""Star tracker: attitude from the stars, if they are visible."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from lunarsim.frames import quat_from_rotation_vector, quat_multiply, quat_rotate
from lunarsim.messages.measurements import AttitudeReading
from lunarsim.models.instruments import StarTrackerInstrument
from lunarsim.parts.quantity import check_bounds, check_direction, quantity
from lunarsim.typing import Array
from lunarsim.vehicle.state import State
from lunarsim.world import World


@dataclass(frozen=True)
class StarTracker:
    """Settings of a star tracker fixed to the body.

    The defaults are typical of small flight-proven trackers: 5 arc seconds across the boresight
    and 55 about it, at up to 3 deg/s.
    """

    boresight: tuple[float, float, float] = quantity(
        (0.0, 0.6, 0.8), help="direction in which the star tracker points, unit vector in body axes"
    )
    cross_boresight_noise: float = quantity(
        0.0014,
        "deg",
        gt=0,
        help="attitude noise about each of the two axes perpendicular to the boresight, 1 sigma",
    )
    roll_noise: float = quantity(
        0.0153, "deg", gt=0, help="attitude noise about the boresight, 1 sigma"
    )
    misalignment: float = quantity(
        0.005, "deg", ge=0, help="constant misalignment of the star tracker, 1 sigma per axis"
    )
    max_angular_rate: float = quantity(
        3.0,
        "deg/s",
        gt=0,
        help="maximum angular rate of the lander at which the star tracker works",
    )
    min_elevation: float = quantity(
        20.0,
        "deg",
        ge=0,
        le=90,
        help="minimum angle of the boresight above the horizon at which the star tracker works",
    )
    sun_exclusion_angle: float = quantity(
        30.0,
        "deg",
        ge=0,
        le=90,
        help="minimum angle between boresight and Sun at which the star tracker works",
    )

    measurement_type: ClassVar[type] = AttitudeReading
    is_tasked: ClassVar[bool] = False
    needs_sunlight: ClassVar[bool] = True

    def __post_init__(self) -> None:
        check_direction("star_tracker.boresight", self.boresight)
        check_bounds(self, "star_tracker")

    def build(self, rng: np.random.Generator, step: float) -> MisalignedStarTracker:
        """Return the tracker of one flight; its misalignment comes from `rng`."""
        return MisalignedStarTracker(self, rng)

    def calibration(self) -> StarTrackerInstrument:
        """Return the calibration for the onboard computer: sigma of the misalignment.

        The noise is not part of it, because each reading includes its covariance.
        """
        return StarTrackerInstrument(self.misalignment)

    def covariance(self) -> Array:
        """Return the covariance (3, 3), rad^2, of the attitude noise.

        The noise is a small rotation in body axes.
        """
        b = np.asarray(self.boresight)
        along = np.outer(b, b)
        return np.asarray(
            self.cross_boresight_noise**2 * (np.eye(3) - along) + self.roll_noise**2 * along
        )


class MisalignedStarTracker:
    """Simulated star tracker of one flight, with a constant misalignment.

    Parameters
    ----------
    params
        Parameters of the tracker.
    rng
        Source of its misalignment.
    """

    def __init__(self, params: StarTracker, rng: np.random.Generator) -> None:
        self.params = params
        self._misalignment = params.misalignment * rng.standard_normal(3)
        self._covariance = params.covariance()
        self._spread = np.linalg.cholesky(self._covariance)

    def measure(
        self,
        world: World,
        state: State,
        time: float,
        rng: np.random.Generator,
        mount: Array | None = None,
    ) -> AttitudeReading:
        """Measure the attitude with misalignment and noise; NaN if no stars are visible.

        `state` is the true state at `time`, s. Random numbers are drawn from `rng` even if no stars
        are visible. `mount` is not used.
        """
        turn = self._misalignment + self._spread @ rng.standard_normal(3)
        if not self._has_stars(world, state):
            return AttitudeReading(time, np.full(4, np.nan), np.full((3, 3), np.nan))
        measured = quat_multiply(state.attitude, quat_from_rotation_vector(turn))
        return AttitudeReading(time, measured, self._covariance.copy())

    def _has_stars(self, world: World, state: State) -> bool:
        f = self.params
        axis = quat_rotate(state.attitude, f.boresight)
        away = np.arccos(np.clip(axis @ world.light.direction, -1.0, 1.0))
        return bool(
            np.linalg.norm(state.rate) <= f.max_angular_rate
            and axis[2] >= np.sin(f.min_elevation)
            and away >= f.sun_exclusion_angle
        )

"""Settings of the rock tracker."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from lunarsim.errors import InputError, check_types
from lunarsim.onboard.navigation.rock_filter import MapRegion


@dataclass(frozen=True)
class TrackerSettings:
    """Criteria for adding, deleting, merging and splitting rocks.

    Attributes
    ----------
    least_radius
        Minimum radius of tracked rocks, m.
    landmark_radius, few
        While fewer than `few` tracked rocks are in view, rocks down to `landmark_radius` (m) are
        added as landmarks; they are kept until twice as many are in view.
    region
        West, east, south and north limits of the tracked area, m; None: unlimited.
    birth_q
        Minimum q of a detection that starts a track.
    birth_sigma
        Maximum position error of such a detection, m; for large rocks a third of the radius. Under
        a low Sun it scales with `observation_scatter_factor`.
    radius_wander
        Relative change of the measured radius per second as the view changes.
    relative_radius_sigma
        Relative standard deviation of a measured radius, in addition to the detector's.
    radius_floor
        See `RockFilter.update_rocks`.
    common_pixels
        Error common to all rocks of an image, see `RockFilter.update_rocks`, pixels.
    view_wander
        Process noise of centres as the view changes, see `RockFilter.turn`: along the Sun, across,
        and common to all rocks.
    range_wander
        Process noise of centres as the range decreases, see `RockFilter.turn`: common to all,
        pixels.
    most_off
        Maximum normalised innovation squared per degree of freedom of an accepted image.
    least_expected
        Minimum number of expected rocks for testing whether they are found.
    least_found
        Minimum fraction of them that must be found.
    large
        Above this number of rocks, those out of view are not updated, see `RockFilter.rest`, and an
        image updates half of `most_updates`, to save time.
    most_rocks
        Maximum number of rocks.
    most_updates
        Maximum number of position updates per image, longest waiting first, so that the cost does
        not grow with the square of the rocks in view. Radii of all rocks are updated.
    """

    least_radius: float = 0.1
    landmark_radius: float = 0.1
    few: int = 30
    region: MapRegion | None = None
    birth_q: float = 2.4
    birth_sigma: float = 0.25
    radius_wander: float = 0.02
    relative_radius_sigma: float = 0.15
    radius_floor: float = 0.25
    common_pixels: float = 0.12
    view_wander: tuple[float, float, float] = (0.2, 0.05, 0.25)
    range_wander: float = 0.9
    most_off: float = 3.0
    least_expected: float = 8.0
    least_found: float = 0.55
    large: int = 1200
    most_rocks: int = 2000
    most_updates: int = 60

    def __post_init__(self) -> None:
        check_types("tracker", self)
        for name in ("least_radius", "landmark_radius", "few", "radius_wander",
                     "relative_radius_sigma", "range_wander", "birth_q", "birth_sigma",
                     "radius_floor", "most_off", "least_expected", "large",
                     "most_rocks", "most_updates"):  # fmt: skip
            if not 0.0 <= getattr(self, name) < np.inf:
                raise InputError(f"tracker.{name}", getattr(self, name), "must be 0 or positive")
        if not 0.0 <= self.least_found <= 1.0:
            raise InputError("tracker.least_found", self.least_found, "must be between 0 and 1")
        if self.region is not None:
            limits = np.shape(self.region) == (4,)
            if not (limits and self.region[0] < self.region[1] and self.region[2] < self.region[3]):
                raise InputError(
                    "tracker.region", self.region, "must have west < east and south < north"
                )
        shares = np.ravel((*np.atleast_1d(self.view_wander), self.common_pixels))
        if not (len(shares) == 4 and np.isfinite(shares).all() and (shares >= 0.0).all()):
            given = (self.view_wander, self.common_pixels)
            raise InputError(
                "tracker.view_wander, tracker.common_pixels", given,
                "must be three numbers and one number, each 0 or positive",
            )  # fmt: skip

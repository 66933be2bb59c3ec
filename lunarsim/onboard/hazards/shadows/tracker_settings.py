"""Settings of the rock tracker."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from lunarsim.errors import InputError, check_types
from lunarsim.onboard.navigation.rock_filter import MapRegion
from lunarsim.value_checks import check_elements


@dataclass(frozen=True)
class TrackerSettings:
    """Criteria for adding, deleting, merging and splitting rocks.

    Attributes
    ----------
    min_radius
        Minimum radius of tracked rocks, m.
    min_landmark_radius, min_rocks_in_view
        While fewer than `min_rocks_in_view` tracked rocks are in view, rocks down to
        `min_landmark_radius` (m) are added as landmarks; they are kept until twice as many are in
        view.
    region
        West, east, south and north limits of the tracked area, m; None: unlimited.
    min_birth_q
        Minimum size q (square root of the number of dark pixels) of a detection that starts a
        track.
    max_birth_sigma
        Maximum position error of a detection that starts a track, m; for large rocks a third of the
        radius if that is larger. Under a low Sun it scales with `observation_scatter_factor`.
    radius_wander
        Relative change of the measured radius per second as the view changes.
    relative_radius_sigma
        Relative standard deviation of a measured radius, in addition to the detector's.
    radius_floor
        Minimum variance of a tracked radius relative to that of one observation, since observations
        from nearly the same place have correlated errors.
    common_pixels
        Position error common to all rocks of an image, pixels.
    view_wander
        Process noise of rock centres as the view changes (`RockFilter.add_view_noise`): along the
        Sun, across, and common to all rocks.
    range_wander
        Process noise of rock centres as the range decreases (`RockFilter.add_view_noise`), common
        to all rocks, pixels.
    max_normalised_innovation
        Maximum normalised innovation squared per degree of freedom of an accepted image.
    min_expected_rocks
        Minimum number of expected rocks in view for testing whether they are found.
    min_found_fraction
        Minimum fraction of the expected rocks that must be found.
    max_full_update_rocks
        Number of rocks above which those out of view are not updated (`RockFilter.freeze`) and an
        image updates half of `max_position_updates`, to save time.
    max_rocks
        Maximum number of rocks.
    max_position_updates
        Maximum number of position updates per image, longest waiting first, so that the cost does
        not grow with the square of the rocks in view. Radii of all rocks are updated.
    """

    min_radius: float = 0.1
    min_landmark_radius: float = 0.1
    min_rocks_in_view: int = 30
    region: MapRegion | None = None
    min_birth_q: float = 2.4
    max_birth_sigma: float = 0.25
    radius_wander: float = 0.02
    relative_radius_sigma: float = 0.15
    radius_floor: float = 0.25
    common_pixels: float = 0.12
    view_wander: tuple[float, float, float] = (0.2, 0.05, 0.25)
    range_wander: float = 0.9
    max_normalised_innovation: float = 3.0
    min_expected_rocks: float = 8.0
    min_found_fraction: float = 0.55
    max_full_update_rocks: int = 1200
    max_rocks: int = 2000
    max_position_updates: int = 60

    def __post_init__(self) -> None:
        check_types("tracker", self)
        for name in ("min_radius", "min_landmark_radius", "min_rocks_in_view", "radius_wander",
                     "relative_radius_sigma", "range_wander", "min_birth_q", "max_birth_sigma",
                     "radius_floor", "max_normalised_innovation", "min_expected_rocks",
                     "max_full_update_rocks", "max_rocks", "max_position_updates"):  # fmt: skip
            if not 0.0 <= getattr(self, name) < np.inf:
                raise InputError(
                    f"tracker.{name}", getattr(self, name), "must be 0 or more, and finite"
                )
        if not 0.0 <= self.min_found_fraction <= 1.0:
            raise InputError(
                "tracker.min_found_fraction", self.min_found_fraction, "must be between 0 and 1"
            )
        if self.region is not None:
            limits = np.shape(self.region) == (4,)
            if not (limits and self.region[0] < self.region[1] and self.region[2] < self.region[3]):
                raise InputError(
                    "tracker.region",
                    self.region,
                    "must be (west, east, south, north) with west < east and south < north",
                )
        for name in ("view_wander", "common_pixels"):
            shares = np.asarray(getattr(self, name))
            is_valid = np.isfinite(shares) & (shares >= 0.0)
            check_elements(f"tracker.{name}", shares, is_valid, "must be 0 or more, and finite")

"""When rocks come, go, join and part."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from lunarsim.errors import InputError, check_types
from lunarsim.onboard.navigation.rock_filter import Region


@dataclass(frozen=True)
class TrackerSettings:
    """When rocks come, go, join and part.

    Attributes
    ----------
    least_radius
        Smaller ones are not tracked, m.
    landmark_radius, few
        While fewer tracked rocks than so many are in view, smaller ones begin too, down to this
        radius, m, and until there are twice as many none of these is let go: by them places are
        known from the lander.
    region
        West, east, south, north limits of where rocks are tracked, m; None: everywhere.
    birth_q
        Least q of a detection that begins a rock.
    birth_sigma
        Greatest standard deviation of its place on the ground, m; for large rocks a third of the
        radius. Under a low Sun more, by `look_stretch`.
    radius_wander
        Share by which the measured radius changes in a second as the view turns.
    radius_doubt
        Standard deviation of a measured radius, a share of it, beyond the detector's.
    radius_floor
        See `RockFilter.update_rocks`.
    common_pixels
        Error that all rocks of an image share, see `RockFilter.update_rocks`, pixels.
    view_wander
        Of rocks' centres as the view turns, see `RockFilter.turn`: along the Sun, across, and what
        all share.
    range_wander
        Of rocks' centres as the range falls, see `RockFilter.turn`: what all share, pixels.
    most_off
        Normalised innovation squared a degree of freedom, beyond which an image is refused.
    least_expected
        Rocks that should show in an image to tell whether they do.
    least_found
        Share of them that should be found.
    large
        With more rocks than that, time is saved: those out of view are left as they are, see
        `RockFilter.rest`, and one image corrects half of `most_updates`.
    most_rocks
        Above this no rock is added.
    most_updates
        Rocks whose places one image may correct. Those that have waited longest come first, so
        that the cost of an image does not grow with the square of what is in view. Radii, which
        cost nothing, are corrected of all.
    """

    least_radius: float = 0.1
    landmark_radius: float = 0.1
    few: int = 30
    region: Region | None = None
    birth_q: float = 2.4
    birth_sigma: float = 0.25
    radius_wander: float = 0.02
    radius_doubt: float = 0.15
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
        for name in ("least_radius", "landmark_radius", "few", "radius_wander", "radius_doubt",
                     "range_wander", "birth_q", "birth_sigma", "radius_floor", "most_off",
                     "least_expected", "large", "most_rocks", "most_updates"):  # fmt: skip
            if not 0.0 <= getattr(self, name) < np.inf:
                raise InputError(f"tracker.{name}", getattr(self, name), "0 or a positive number")
        if not 0.0 <= self.least_found <= 1.0:
            raise InputError("tracker.least_found", self.least_found, "a share from 0 to 1")
        if self.region is not None:
            limits = np.shape(self.region) == (4,)
            if not (limits and self.region[0] < self.region[1] and self.region[2] < self.region[3]):
                raise InputError("tracker.region", self.region, "west < east, south < north")
        shares = np.ravel((*np.atleast_1d(self.view_wander), self.common_pixels))
        if not (len(shares) == 4 and np.isfinite(shares).all() and (shares >= 0.0).all()):
            given = (self.view_wander, self.common_pixels)
            raise InputError(
                "tracker.view_wander, tracker.common_pixels", given,
                "three numbers and one, 0 or positive",
            )  # fmt: skip

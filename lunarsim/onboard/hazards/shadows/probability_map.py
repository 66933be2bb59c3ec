"""Map of the probability of hazard (shadow EKF paper, Eqs. 12-23)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from lunarsim.errors import InputError, check_types
from lunarsim.grid import Grid
from lunarsim.models.pinhole import View
from lunarsim.onboard.hazards.hazard_map import HazardMap
from lunarsim.onboard.hazards.map_evidence import RockTracks
from lunarsim.onboard.hazards.shadows import _probability_kernels as kernels
from lunarsim.onboard.hazards.shadows.clear_evidence import ClearEvidence, Heights
from lunarsim.onboard.hazards.shadows.footprints import footprint_observed
from lunarsim.onboard.hazards.shadows.probability import Form, checked_form, cover_probability
from lunarsim.onboard.hazards.shadows.tracker import RockTracker
from lunarsim.onboard.perception.detection_rates import DetectionRates
from lunarsim.onboard.perception.detector import Detections
from lunarsim.onboard.perception.ground_plane import LEVEL, GroundPlane
from lunarsim.onboard.perception.shadow_model import ShadowModel
from lunarsim.onboard.perception.shape_mixture import ShapeMixture
from lunarsim.onboard.perception.sun_direction import has_usable_shadows, unit_vector
from lunarsim.rocks.size_distribution import golombek_cover, golombek_exponent
from lunarsim.typing import Array, BoolArray

# Cell size of the stored evidence, and its margin beyond the map, m, because it moves with the
# rocks.
_BLOCK_SIZE_M, _MARGIN_M = 0.25, 2.0
_SIZE_CLASSES = 24
_PROFILE_POINTS = 65
# A rock's reach ends at this many standard deviations.
_TAIL_SIGMAS = 3.9


@dataclass(frozen=True)
class HazardPrior:
    """Abundance and size of rocks expected before any observation.

    Attributes
    ----------
    cover
        Fraction k of the terrain covered by rocks of any size (Golombek).
    min_diameter
        Minimum diameter of a rock that is a hazard, m.
    max_diameter
        Maximum diameter of a rock, m.
    """

    cover: float = 0.05
    min_diameter: float = 0.3
    max_diameter: float = 4.0

    def __post_init__(self) -> None:
        check_types("prior", self)
        golombek_cover(1.0, self.cover)  # raises for a cover that is not a fraction
        if not 0.0 < self.max_diameter < np.inf:
            raise InputError("prior.max_diameter", self.max_diameter, "must be positive and finite")
        if not 0.0 < self.min_diameter < self.max_diameter:
            raise InputError(
                "prior.min_diameter", self.min_diameter,
                f"must be positive and less than max_diameter, which is {self.max_diameter:g} m",
            )  # fmt: skip


class ProbabilityMap:
    """Map of the probability that a rock is under the lander, from camera images.

    The rock may be tracked, missed by the detector on terrain seen clear, or on unobserved terrain.
    Eq. 23 of the shadow EKF paper adds these three probabilities, and a sum over rocks can exceed
    1. Here the events are independent: the probabilities that each does not occur are multiplied.
    The result never exceeds the sum of the probabilities and is nearly equal to it if it is small.

    Parameters
    ----------
    grid
        Grid of the map.
    model, rates
        Model of the shadows, and rates of missed and false detections.
    prior
        Rocks expected before any observation.
    terrain_height
        Height of horizontal terrain that `add_image` assumes by default, m, which is also the
        elevation of the hazard map; an attribute that can be changed.
    form
        Model of the probability that the outline of a rock contains a point, "rice" or "gaussian",
        as in `cover_probability`.
    """

    def __init__(
        self,
        grid: Grid,
        model: ShadowModel | ShapeMixture,
        prior: HazardPrior | None = None,
        rates: DetectionRates | None = None,
        *,
        terrain_height: float = 0.0,
        form: Form = "rice",
    ) -> None:
        self.grid = grid
        self.model = model
        self.prior = prior or HazardPrior()
        self.rates = rates or DetectionRates()
        self.terrain_height = float(terrain_height)
        self.form: Form = checked_form(form)
        every = max(1, round(_BLOCK_SIZE_M / grid.posting))
        margin_blocks = round(_MARGIN_M / (every * grid.posting))
        first = (0.5 * (every - 1) - margin_blocks * every) * grid.posting
        blocks = Grid(
            grid.x0 + first, grid.y0 + first, every * grid.posting,
            -(-grid.rows // every) + 2 * margin_blocks, -(-grid.cols // every) + 2 * margin_blocks,
        )  # fmt: skip
        self._every, self._margin_blocks = every, margin_blocks
        edges = np.geomspace(self.prior.min_diameter, self.prior.max_diameter, _SIZE_CLASSES + 1)
        sizes = np.sqrt(edges[1:] * edges[:-1])
        cover = golombek_cover(edges, self.prior.cover)
        self.evidence = ClearEvidence(
            blocks, model, sizes, (cover[:-1] - cover[1:]) / (0.25 * np.pi * sizes**2), self.rates,
        )  # fmt: skip

    # --- Evidence -------------------------------------------------------------------------

    def forget(self) -> None:
        """Discard all recorded clear terrain, because its rocks are no longer tracked."""
        self.evidence.forget()

    def recentre(self, centre: Array) -> None:
        """Move the map to another centre (2,) or (3,), m; recorded terrain does not move.

        The shift is rounded to the cells in which clear terrain is recorded.
        """
        self.grid = self.grid.moved(self.evidence.recentre(centre[:2] - self.grid.centre))

    def add_image(
        self,
        view: View,
        sun: Array,
        detections: Detections,
        heights: Heights | None = None,
        explained: BoolArray | None = None,
        position_sigma: Heights | None = None,
        plane: GroundPlane = LEVEL,
        height_sigma: Heights | None = None,
        blur: float = 0.0,
    ) -> None:
        """Record where an image excludes undetected rocks.

        The arguments are those of `ClearEvidence.add_image`. By default, the height is that of
        `terrain_height` everywhere. If the Sun casts no usable shadows (elevation outside 2 to 80
        deg), nothing is recorded.

        Raises
        ------
        InputError
            If the Sun direction is not a unit vector.
        """
        if not has_usable_shadows(unit_vector(sun)):
            return
        level = heights or (lambda xy: np.full(len(xy), self.terrain_height))
        self.evidence.add_image(
            view, sun, detections, level, explained, position_sigma, plane, height_sigma, blur
        )

    def untracked_rock_probability(self, footprint: float) -> Array:
        """Return the probability that an untracked rock is under the lander (rows, cols).

        Combines Eqs. 13-15 of the shadow EKF paper: each size has its expected number and its miss
        rate, which is 1 below the resolution. Rocks whose outline reaches into the footprint count.
        `footprint` is its radius, m; 0: rocks whose outline contains the cell's centre.
        """
        unobserved = self.evidence.expected_unobserved(footprint)
        expected = self._resample_to_map(
            self.evidence.expected_untracked(footprint), unobserved
        ).astype(np.float64)
        # Rocks do not overlap, but several may reach into one footprint.
        return np.minimum(expected, 1.0) if footprint == 0.0 else -np.expm1(-expected)

    def move_with_rocks(self, xy: Array, motion: Array) -> None:
        """Move the recorded clear terrain with the tracked rocks.

        `xy` (n, 2) are the positions of the rocks and `motion` (n, 2) is their motion, m.
        """
        self.evidence.motion.follow(xy, motion)

    def _resample_to_map(self, coarse_layer: NDArray[Any], outside: float) -> NDArray[Any]:
        """Resample a layer of recorded clear terrain to the cells of the map (rows, cols).

        `coarse_layer` is the layer on the grid of the records, and `outside` the value beyond it.
        """
        if self.evidence.motion.is_identity:
            inner = slice(self._margin_blocks, -self._margin_blocks or None)
            fine = np.repeat(np.repeat(coarse_layer[inner, inner], self._every, 0), self._every, 1)
            return fine[: self.grid.rows, : self.grid.cols]
        # Column and row of the evidence cell under the first map cell, the next one and the one
        # above.
        own, cell = self.evidence.grid, self.grid.posting
        start = np.array([self.grid.x0, self.grid.y0])
        at = self.evidence.motion.to_stored(start + cell * np.array([[0, 0], [1, 0], [0, 1]]))
        zero, right, up = (at - [own.x0, own.y0]) / own.posting
        matrix = np.column_stack((right - zero, up - zero, zero))
        layer = coarse_layer.astype(np.uint8) if coarse_layer.dtype == np.bool_ else coarse_layer
        fine = cv2.warpAffine(
            layer, matrix, (self.grid.cols, self.grid.rows),
            flags=cv2.INTER_NEAREST | cv2.WARP_INVERSE_MAP,
            borderMode=cv2.BORDER_CONSTANT, borderValue=outside,
        )  # fmt: skip
        return np.asarray(fine).astype(coarse_layer.dtype)

    @property
    def observed(self) -> BoolArray:
        """Whether a rock of the smallest hazardous size would be visible (rows, cols)."""
        return self._resample_to_map(self.evidence.is_observed(), 0.0)

    # --- Map ------------------------------------------------------------------------------

    def probability(
        self, tracker: RockTracker, footprint: float = 0.0, untracked: Array | None = None
    ) -> NDArray[np.float32]:
        """Return the probability that a rock is under the lander (rows, cols).

        Unobserved cells have the probability of the rock size distribution. A cell is clear only if
        the probability is small and the cell is `observed`.

        Parameters
        ----------
        tracker
            Tracker with the tracked rocks.
        footprint
            Radius of the disc that must be free of rocks, m; 0: probability that the outline of a
            rock contains the cell's centre, as in the paper.
        untracked
            Probability of an untracked rock, from `untracked_rock_probability` for this footprint
            (rows, cols); default: computed.
        """
        clear = 1.0 - (
            self.untracked_rock_probability(footprint) if untracked is None else untracked
        )
        self._multiply_clear_probability(clear, footprint, rock_tracks(tracker))
        return (1.0 - clear).astype(np.float32)

    def clear_of(self, rocks: RockTracks, footprint: float) -> Array:
        """Return the probability that no tracked rock is under the lander (rows, cols).

        `footprint` is the radius of the disc that must be free of rocks, m; 0: the cell's centre.
        Rocks smaller than the minimum diameter of a hazard do not count.
        """
        clear = np.ones(self.grid.shape)
        self._multiply_clear_probability(clear, footprint, rocks)
        return clear

    def _multiply_clear_probability(
        self, clear: Array, footprint: float, rocks: RockTracks
    ) -> None:
        """Multiply the probability that cells are clear by that for each tracked rock.

        `clear` (rows, cols) is updated. `footprint` is the radius of the disc that must be free of
        rocks, m. A rock counts with the probability that it exists and is large enough to be a
        hazard.
        """
        model, radius = self.model, rocks.radius
        # The filter treats the shape error of each observation as independent. The part that does
        # not average out is added here.
        variance = rocks.radius_variance + (model.radius_sigma * radius) ** 2
        sigma = np.hypot(rocks.sigma, model.centre_sigma * radius)
        # Small rocks are more numerous, so a rock is more probably smaller than estimated than
        # larger: Golombek's dN/dr has the logarithmic slope -2 q - 2 / r.
        slope = 2.0 * golombek_exponent(self.prior.cover) + 2.0 / np.maximum(radius, 0.05)
        radius = np.maximum(radius - np.minimum(variance * slope, 0.5 * radius), 0.01)
        # A rock counts with the probability that it is large enough to be a hazard.
        large = model.probability_longer_than(
            0.5 * self.prior.min_diameter, radius, np.sqrt(variance)
        )
        at = np.flatnonzero(large * rocks.existence > 1e-4)
        if at.size == 0:
            return
        outline, rough = model.outline
        r, sigma = radius[at], sigma[at]
        spread = np.sqrt(outline**2 * variance[at] + (r * rough) ** 2)
        mean = outline * r + footprint
        reach = mean + 1.5 * sigma + _TAIL_SIGMAS * np.hypot(sigma, spread)
        distance = np.linspace(0.0, 1.0, _PROFILE_POINTS) * reach[:, None]
        profile = cover_probability(distance, sigma, mean, spread, self.form)
        kernels.multiply_clear_probability(
            clear, self.grid.x0, self.grid.y0, self.grid.posting, rocks.xy[at], reach, profile,
            (rocks.existence * large)[at],
        )  # fmt: skip

    def untracked_rock_ratios(self) -> NDArray[np.float32]:
        """Return the ratio of untracked rocks to those expected without observation.

        The result (sizes, rows, cols) has the cells of the map, as explained for
        `ClearEvidence.untracked_rock_ratios`: it is below 1 where terrain was seen clear, 1 where
        it was not observed, and 1 or more on dark terrain.
        """
        return np.stack(
            [
                self._resample_to_map(of_size, 1.0)
                for of_size in self.evidence.untracked_rock_ratios()
            ]
        )

    def hazard_map(
        self, tracker: RockTracker, footprint: float, untracked: Array | None = None
    ) -> HazardMap:
        """Compute the hazard map for a lander with a footprint radius (m).

        `tracker` holds the tracked rocks. `untracked` (rows, cols) is the probability of an
        untracked rock; default: computed.
        """
        p = self.probability(tracker, footprint, untracked)
        observed = footprint_observed(self.observed, footprint / self.grid.posting)
        return HazardMap(
            self.grid,
            np.where(observed, np.float32(1.0) - p, np.float32(0.0)),
            observed,
            np.full(self.grid.shape, self.terrain_height, np.float32),
        )

    def expected_rocks(self) -> float:
        """Return the number of hazardous rocks that should have been detected on the map."""
        return self.evidence.expected_detections(self._margin_blocks)


def rock_tracks(tracker: RockTracker) -> RockTracks:
    """Return the tracked rocks, followed by detections that are not yet tracked."""
    f, tentative = tracker.filter, tracker.tentative
    own = np.sqrt(0.5 * np.trace(f.relative_covariance()[:, :2, :2], axis1=1, axis2=2))
    return RockTracks(
        np.concatenate((f.xy, tentative.xy)),
        np.concatenate((own, tentative.sigma)),
        np.concatenate((f.radius, tentative.radius)),
        np.concatenate((f.radius_variance, tentative.radius_variance)),
        np.concatenate((tracker.existence, tentative.existence)),
    )

"""The augmented multiplicative EKF: the lander and every rock it tracks (Eqs. 1-11).

Rocks do not move and their radius is measured directly, in metres and with errors of its own
(paper, III.B), so radii are correlated neither with the lander nor with each other: they are kept
apart as scalar filters, which is exact. What is left is the error state of the lander (15) and
two coordinates a rock. A measured rock depends on position, attitude and its own coordinates, so
products with its Jacobian cost a few rows of the covariance; all rocks of one image are taken in
one update, which equals the sequential one.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, ClassVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lunarsim._jit import threads_for
from lunarsim.errors import InputError
from lunarsim.frames import Shift, quat_to_matrix
from lunarsim.messages.briefing import Briefing
from lunarsim.messages.measurements import (
    AltimeterReading,
    AttitudeReading,
    DopplerReading,
    InertialSamples,
)
from lunarsim.models.camera import CameraModel
from lunarsim.onboard.navigation._rock_filter_kernels import measured_rows
from lunarsim.onboard.navigation.aids import Aids, LevelGround, blocks_of
from lunarsim.onboard.navigation.error_state import BLAS, POSE, ErrorState
from lunarsim.onboard.navigation.estimate import Estimate, NavigationEvent
from lunarsim.onboard.navigation.inertial import StartSigmas, StrapdownState
from lunarsim.onboard.navigation.planar import inverse

Array = NDArray[np.float64]
Index = NDArray[np.int64]


@dataclass(frozen=True)
class Sight:
    """Where rocks should be seen, and how that depends on the state.

    Attributes
    ----------
    pixel
        Predicted pixels (n, 2), distortion left out (Eq. 10).
    depth
        Along the boresight (n,), m; not positive behind the camera.
    by_pose
        Derivatives by position and attitude error (n, 2, 6).
    by_rock
        Derivatives by the rock's east and north (n, 2, 2).
    """

    pixel: Array
    depth: Array
    by_pose: Array
    by_rock: Array


@dataclass(frozen=True)
class RockNavigation:
    """Inertial unit, the rocks that a camera sees by their shadows, ranges, speeds and stars."""

    needs: ClassVar[tuple[type, ...]] = (InertialSamples,)
    takes: ClassVar[tuple[type, ...]] = (AltimeterReading, DopplerReading, AttitudeReading)
    uses_prior_map: ClassVar[bool] = False

    def build(self, briefing: Briefing) -> RockFilter:
        """Return the filter of one flight; its rocks stand at the level of the target."""
        state, sigmas = StrapdownState.of(briefing)
        return RockFilter(
            state, sigmas, ground=float(briefing.target[2]), instruments=briefing.instruments
        )


class RockFilter:
    """Lander and rocks in one filter.

    Parameters
    ----------
    inertial
        The lander's state at the start.
    errors
        Its standard deviations.
    ground
        Elevation of the plane on which rocks stand, m.
    capacity
        Rocks for which room is made at first; it grows as needed.
    instruments
        Calibrations of altimeters, velocimeters and star trackers, by name.
    """

    def __init__(
        self,
        inertial: StrapdownState,
        errors: StartSigmas | None = None,
        *,
        ground: float = 0.0,
        capacity: int = 128,
        instruments: Mapping[str, Any] | None = None,
    ) -> None:
        known = instruments or {}
        # Rocks stand on level ground, and so does what ranges are measured to.
        level = LevelGround(float(ground), None)
        self.state = ErrorState(
            inertial, errors, blocks=blocks_of(known, level), capacity=2 * capacity
        )
        self.state.listeners.append(self._corrected)
        self._first = self.state.head
        self.events: list[NavigationEvent] = []
        self._aids = Aids(self.state, known, level, self.events)
        self._raised = 0.0
        self.ground = float(ground)
        self.count = 0
        self._xy = np.zeros((capacity, 2))
        self._r = np.zeros((capacity, 2))
        self._rests = np.zeros(capacity, bool)

    @property
    def inertial(self) -> StrapdownState:
        """The lander's state."""
        return self.state.inertial

    def rest(self, rocks: NDArray[np.bool_]) -> None:
        """Leave rocks (n,) as they are until told otherwise; rocks that are added do not rest.

        See `ErrorState.rest`.
        """
        self._rests[: self.count] = rocks
        self._note_rests()

    def _note_rests(self) -> None:
        self.state.rest(np.repeat(self._rests[: self.count], 2))

    def _places(self, index: Index | None = None) -> Index:
        """Return where rocks' coordinates lie in the error state (n, 2)."""
        rocks = np.arange(self.count) if index is None else np.asarray(index)
        return self._first + 2 * rocks[:, None] + np.arange(2)

    # --- the state ------------------------------------------------------------------------

    @property
    def covariance(self) -> Array:
        """Of the lander's error state (15), what aids need, and the rocks' coordinates (2 n)."""
        return self.state.covariance

    @property
    def xy(self) -> Array:
        """Rocks' centres (n, 2), ENU, m."""
        return self._xy[: self.count]

    @property
    def radius(self) -> Array:
        """Rocks' radii (n,), m."""
        return self._r[: self.count, 0]

    @property
    def radius_variance(self) -> Array:
        """Variance of the radii (n,), m^2."""
        return self._r[: self.count, 1]

    def rock_covariance(self) -> Array:
        """Return the covariance of each rock's centre (n, 2, 2), m^2."""
        i = self._places()
        return np.asarray(self.state.p[i[:, :, None], i[:, None, :]])

    def relative_covariance(self) -> Array:
        """Return the covariance of each rock's centre less the lander's position (n, 2, 2), m^2.

        An error that lander and rocks share moves the map with the lander and misplaces nothing
        on it.
        """
        own = self.rock_covariance()
        if self.count == 0:
            return own
        p = self.state.p
        cross = np.moveaxis(p[np.arange(2)[:, None, None], self._places()[None]], 0, 1)
        return np.asarray(own + p[:2, :2] - cross - np.swapaxes(cross, 1, 2))

    def estimate(self, time: float, mass: float) -> Estimate:
        """Return the lander's state as the rest of the loop takes it, local frame."""
        found = self.inertial.estimate(self.covariance, time, mass)
        position = self.site_to_local.to_local(found.position)
        return replace(found, position=position, lost=self._aids.lost)

    @property
    def site_to_local(self) -> Shift:
        """The local frame: the filter's own, less all corrections of the height so far.

        The altimeter corrects the height by metres while the lander is high. In the local frame
        the ground moves instead, so that scans made before and after lie one on the other.
        """
        return Shift(np.array([0.0, 0.0, -self._raised]))

    def take(self, sensor: str, measurement: Any, time: float) -> None:
        """Take in a measurement; pictures come through the tracker."""
        if isinstance(measurement, InertialSamples):
            self.propagate(measurement.angle, measurement.velocity)
        else:
            self._aids.take(sensor, measurement, time)

    # --- time -----------------------------------------------------------------------------

    def propagate(self, angle: ArrayLike, velocity: ArrayLike) -> None:
        """Carry the filter over inertial samples (n, 3); NaN stands for a missing one."""
        self.state.propagate(angle, velocity)

    # --- rocks ----------------------------------------------------------------------------

    def sight(self, camera: CameraModel, xy: Array | None = None) -> Sight:
        """Return where rocks at `xy` (n, 2), or those tracked, should be seen (Eqs. 10-11)."""
        points = self.xy if xy is None else xy
        s = self.inertial
        rotation = quat_to_matrix(s.attitude)
        to_rock = np.column_stack((points, np.full(len(points), self.ground))) - s.position
        body = to_rock @ rotation
        seen = (body - np.asarray(camera.offset)) @ camera.mount
        with np.errstate(divide="ignore", invalid="ignore"):
            pixel = camera.pinhole.project(seen)
            by_seen = camera.pinhole.jacobian(seen)
        by_body = by_seen @ camera.mount.T
        by_point = by_body @ rotation.T
        # d(body) = [body x] d(attitude); (row @ [body x])_k = (row x body)_k.
        by_attitude = np.cross(by_body, body[:, None, :])
        return Sight(
            pixel, seen[:, 2], np.concatenate((-by_point, by_attitude), axis=-1), by_point[:, :, :2]
        )

    def innovation_covariance(self, sight: Sight) -> Array:
        """Return the covariance of the predicted pixels of all rocks (n, 2, 2)."""
        p = self.state.p
        pose = p[np.ix_(POSE, POSE)]
        cross = np.moveaxis(p[POSE[:, None, None], self._places()[None]], 0, 1)  # (n, 6, 2)
        own = self.rock_covariance()
        a, b = sight.by_pose, sight.by_rock
        mixed = a @ cross @ np.swapaxes(b, 1, 2)
        return np.asarray(
            a @ pose @ np.swapaxes(a, 1, 2)
            + mixed
            + np.swapaxes(mixed, 1, 2)
            + b @ own @ np.swapaxes(b, 1, 2)
        )

    def update_rocks(
        self,
        index: Index,
        sight: Sight,
        pixel: Array,
        pixel_covariance: Array,
        radius: Array,
        radius_variance: Array,
        common: float = 0.0,
        radius_floor: float = 0.0,
    ) -> float:
        """Take in what was seen of rocks in one image; return the normalised innovation squared.

        Parameters
        ----------
        index
            Rocks (m,), each at most once.
        sight
            Prediction for all rocks, made at the present state.
        pixel, pixel_covariance
            Measured centres (m, 2) and their covariances (m, 2, 2).
        radius, radius_variance
            Measured radii (m,), m and m^2.
        common
            Standard deviation of an error that all pixels of the image share, an axis, pixels:
            shadows stand for rocks with an error that depends on the view, so it does not
            average out over the rocks.
        radius_floor
            Share of one look's variance below which that of a radius does not fall: looks from
            nearly the same place err alike.

        Returns
        -------
        nis
            Of the 2 m pixel coordinates; chi-squared with 2 m degrees of freedom.
        """
        self.update_radii(index, radius, radius_variance, radius_floor)
        if len(index) == 0:
            return 0.0
        with BLAS.limit(limits=1, user_api="blas"):
            return self._update_places(index, sight, pixel, pixel_covariance, common)

    def update_radii(
        self, index: Index, radius: Array, radius_variance: Array, floor: float = 0.0
    ) -> None:
        """Take in the radii alone of rocks seen, as `update_rocks` does."""
        r = self._r[index]
        gain = r[:, 1] / (r[:, 1] + radius_variance)
        self._r[index, 0] = r[:, 0] + gain * (radius - r[:, 0])
        self._r[index, 1] = np.maximum((1.0 - gain) * r[:, 1], floor * radius_variance)

    def _update_places(
        self, index: Index, sight: Sight, pixel: Array, pixel_covariance: Array, common: float
    ) -> float:
        """Correct lander and centres; return the normalised innovation squared."""
        m = len(index)
        a, b = sight.by_pose[index], sight.by_rock[index]
        columns = self._places(index)
        with threads_for(1e-2 * m * self.state.size):
            hp = measured_rows(self.state.p, self.state.size, POSE, a, columns, b)
        s = hp[:, POSE] @ a.reshape(2 * m, 6).T
        own = hp[:, columns.ravel()].reshape(2 * m, m, 2)
        s += np.einsum("kmj,mij->kmi", own, b).reshape(2 * m, 2 * m)
        block = 2 * np.arange(m)[:, None] + np.arange(2)
        s[block[:, :, None], block[:, None, :]] += pixel_covariance
        s[::2, ::2] += common**2
        s[1::2, 1::2] += common**2
        innovation = (pixel - sight.pixel[index]).ravel()
        return self.state.absorb(hp, s, innovation).nis

    def _corrected(self, error: Array) -> None:
        """Move the rocks by a correction of the whole error state, and note the height's."""
        self._raised += float(error[2])
        self.xy[:] += error[self._first :].reshape(-1, 2)

    # --- coming and going -----------------------------------------------------------------

    def add(
        self,
        camera: CameraModel,
        xy: Array,
        pixel_covariance: Array,
        radius: Array,
        radius_variance: Array,
    ) -> Index:
        """Begin to track rocks seen at `xy` (b, 2), with their full cross-covariance.

        From ``by_pose d(pose) + by_rock d(rock) = d(pixel)`` a new rock's error is
        ``by_rock^-1 (d(pixel) - by_pose d(pose))``.

        Returns
        -------
        index
            Of the new rocks (b,).
        """
        b = len(radius)
        sight = self.sight(camera, xy)
        back = inverse(sight.by_rock)
        by_pose = -(back @ sight.by_pose).reshape(2 * b, 6)
        own = back @ pixel_covariance @ np.swapaxes(back, 1, 2)
        if not (np.isfinite(by_pose).all() and np.isfinite(own).all()):
            raise InputError("rocks", xy.tolist(), "points on the ground in front of the camera")
        self._reserve(self.count + b)
        old = self.state.size
        new = old + 2 * b
        p = self.state.p
        p[old:new, :old] = by_pose @ p[POSE, :old]
        p[:old, old:new] = p[old:new, :old].T
        block = by_pose @ p[np.ix_(POSE, POSE)] @ by_pose.T
        at = 2 * np.arange(b)[:, None] + np.arange(2)
        block[at[:, :, None], at[:, None, :]] += own
        p[old:new, old:new] = 0.5 * (block + block.T)
        index = np.arange(self.count, self.count + b)
        self._counted(self.count + b)
        self._xy[index] = xy
        self._r[index] = np.column_stack((radius, radius_variance))
        self._rests[index] = False
        self._note_rests()
        return index

    def add_known(self, xy: Array, sigma: Array, radius: Array, radius_variance: Array) -> None:
        """Begin to track rocks known beforehand (n,), with errors of their own."""
        n = len(xy)
        self._reserve(self.count + n)
        old = self.state.size
        new = old + 2 * n
        p = self.state.p
        p[old:new, :new] = 0.0
        p[:new, old:new] = 0.0
        p[np.arange(old, new), np.arange(old, new)] = np.repeat(np.square(sigma), 2)
        self._xy[self.count : self.count + n] = xy
        self._r[self.count : self.count + n] = np.column_stack((radius, radius_variance))
        self._rests[self.count : self.count + n] = False
        self._counted(self.count + n)
        self._note_rests()

    def remove(self, index: Index) -> Index:
        """Stop tracking rocks; those from the end take their places.

        Returns
        -------
        old
            Old numbers of the rocks left (n,), in their new order.
        """
        gone = np.zeros(self.count, bool)
        gone[index] = True
        left = self.count - int(gone.sum())
        holes = np.flatnonzero(gone[:left])
        movers = left + np.flatnonzero(~gone[left:])
        old = np.arange(left)
        old[holes] = movers
        to, source = self._places(holes).ravel(), self._places(movers).ravel()
        p, size = self.state.p, self.state.size
        p[to, :size] = p[source, :size]
        p[:size, to] = p[:size, source]
        self._xy[holes] = self._xy[movers]
        self._r[holes] = self._r[movers]
        self._rests[holes] = self._rests[movers]
        self._counted(left)
        self._note_rests()
        return old

    def widen(self, radius_rate: float, seconds: float) -> None:
        """Let radii wander by a share `radius_rate` in a second: rocks differ from side to side."""
        self._r[: self.count, 1] += (radius_rate * self.radius) ** 2 * seconds

    def _reserve(self, count: int) -> None:
        capacity = len(self._r)
        if count <= capacity:
            return
        capacity = max(count, 2 * capacity)
        self.state.reserve(2 * capacity)
        for name in ("_xy", "_r", "_rests"):
            old = getattr(self, name)
            more = np.zeros((capacity, *old.shape[1:]), old.dtype)
            more[: self.count] = old[: self.count]
            setattr(self, name, more)

    def _counted(self, count: int) -> None:
        self.count, self.state.tail = count, 2 * count

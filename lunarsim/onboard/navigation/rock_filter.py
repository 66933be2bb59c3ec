"""The augmented multiplicative EKF: the lander and every rock it tracks (Eqs. 1-11).

Its error state holds the lander, what other measurements need, and three coordinates a rock
(`rock_states.py`). A measured rock depends on position, attitude and its own coordinates, so
products with its Jacobian cost a few rows of the covariance; all rocks of one image are taken in
one update, which equals the sequential one.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lunarsim._blas import one_blas_thread
from lunarsim._jit import threads_for
from lunarsim.errors import InputError
from lunarsim.frames import turned_about_up
from lunarsim.models.camera import CameraModel
from lunarsim.onboard.navigation._rock_filter_kernels import add_few, measured_rows
from lunarsim.onboard.navigation.aids import Aids, blocks_of
from lunarsim.onboard.navigation.error_state import KEY, MAP, POSE, ErrorState, Outcome
from lunarsim.onboard.navigation.inertial import ATTITUDE, VELOCITY, StartSigmas, StrapdownState
from lunarsim.onboard.navigation.level_ground import LevelGround
from lunarsim.onboard.navigation.picture_watch import PictureWatch, Remedy
from lunarsim.onboard.navigation.planar import inverse, positive
from lunarsim.onboard.navigation.rock_sight import Sight, sight_of
from lunarsim.onboard.navigation.rock_states import AXES, RockStates
from lunarsim.onboard.navigation.wandering_ground import crossings

Array = NDArray[np.float64]
Index = NDArray[np.int64]

# Turns of the view, rad, and falls of the range, a share, are taken together up to this.
_LEAST_TURN = 0.02
# Rocks are not seen from nearer than this, m.
_NEAREST = 0.1
# Passes at most that find where a line of sight meets ground that is not level; none is made once
# heights change by less, m.
_PASSES, _FOUND = 8, 0.01
# A height may go beyond what was found there, and fall short of it, by these factors at most.
_STEPS = (0.2, 3.0)
# How far beside a region ground that is taken to be level at first may lie, m, and how steep ground
# may be that rises from the region's middle, a tangent.
_BESIDE, _STEEPEST = 10.0, 0.36
# Variances grow at least and at most by these factors where rocks are doubted; standard deviations
# not beyond: m, m/s, rad.
_LEAST_GROWTH, _MOST_GROWTH = 4.0, 1e3
_MOST_PLACE, _MOST_SPEED, _MOST_TURN = 100.0, 10.0, 0.1

# West, east, south and north limits, m.
Region = tuple[float, float, float, float]


class RockFilter(RockStates):
    """Lander and rocks in one filter.

    Parameters
    ----------
    state
        Error state of the lander; what stands behind its blocks is this filter's.
    aids
        The other measurements of that state, with what is known of the ground.
    capacity
        Rocks for which room is made at first; it grows as needed.

    Attributes
    ----------
    pictures
        Whether what pictures show can be believed.
    events
        What was reported, by the aids too.
    """

    def __init__(self, state: ErrorState, aids: Aids, *, capacity: int = 128) -> None:
        super().__init__(state, aids.ground, capacity)
        self.events = aids.events
        self.pictures = PictureWatch(self.events)
        self._aids = aids
        self._eye: Array | None = None
        self._pixel = 0.0

    @classmethod
    def of(
        cls,
        inertial: StrapdownState,
        errors: StartSigmas | None = None,
        *,
        ground: LevelGround | None = None,
        capacity: int = 128,
    ) -> RockFilter:
        """Return a filter of lander and rocks alone, in the frame that the lander is told in.

        Parameters
        ----------
        inertial
            The lander's state at the start.
        errors
            Its standard deviations.
        ground
            What is known of its height; left out: level, at 0 m.
        capacity
            Rocks for which room is made at first.
        """
        level = ground or LevelGround(0.0, None)
        state = ErrorState(inertial, errors, blocks=blocks_of({}, level))
        return cls(state, Aids(state, {}, level, []), capacity=capacity)

    @property
    def inertial(self) -> StrapdownState:
        """The lander's state."""
        return self.state.inertial

    # --- the state ------------------------------------------------------------------------

    @property
    def covariance(self) -> Array:
        """Of the lander's error state (15), what aids need, and the rocks' coordinates (3 n)."""
        return self.state.covariance

    def ground_points(self, camera: CameraModel, pixel: Array, near: Region | None = None) -> Array:
        """Return where lines of sight through pixels (n, 2), undistorted, meet the ground (n, 3).

        NaN where they do not, and for those that do so well beside a region that is given: west,
        east, south and north limits, m.
        """
        out = np.full((len(pixel), AXES), np.nan)
        if len(pixel) == 0:
            return out
        eye, per_drop = self._lines(camera, pixel)
        middle = None if near is None else np.reshape(near, (2, 2)).mean(axis=1)
        out[:, 2] = self.ground if middle is None else self.ground_at(middle)[0]
        out[:, :2] = eye[:2] + per_drop * (eye[2] - out[:, 2:])
        lie = np.isfinite(out[:, :2]).all(1)
        if near is not None:
            lie &= _beside(out[:, :2], per_drop, near)
            out[~lie] = np.nan
        out[lie] = self._met(eye, per_drop[lie], out[lie, 2])
        return out

    def _met(self, eye: Array, per_drop: Array, height: Array) -> Array:
        """Return where lines from a place (3,) meet the ground (n, 3), begun at heights (n,), m."""
        if self.measured is None and self.rocks_tell_ground:
            # The same passes, line by line and compiled.
            search = (_PASSES, _FOUND, *_STEPS)
            known = self._known_heights()
            return crossings(*known, eye, per_drop, height, self._level.growth, search)
        left, tried, off = np.arange(len(height)), height, np.full(len(height), np.nan)
        least, met = np.full(len(height), np.inf), np.empty((len(height), AXES))
        for _ in range(_PASSES):
            xy = eye[:2] + per_drop[left] * (eye[2] - height)[:, None]
            found = self.ground_at(xy)
            now = found - height
            # Of those that never arrive the pass counts that came nearest; NaN: there is no ground.
            nearer = ~(np.abs(now) >= least[left])
            met[left[nearer]] = np.column_stack((xy, found))[nearer]
            least[left[nearer]] = np.abs(now[nearer])
            on = np.abs(now) > _FOUND
            if not on.any():
                break
            # Where the line would meet ground that goes on as it did from the last height to this.
            with np.errstate(invalid="ignore", divide="ignore"):
                step = now / np.clip((off - now) / (height - tried), *_STEPS)
            onward = np.where(np.isfinite(step), height + step, found)
            left, tried, off, height = left[on], height[on], now[on], onward[on]
        return met

    def _lines(self, camera: CameraModel, pixel: Array) -> tuple[Array, Array]:
        """Return the camera's place (3,) and how far lines through pixels (n, 2) go east and north.

        That is for each metre that they go down (n, 2); NaN where they do not.
        """
        view = camera.view(self.inertial)
        tangent = (pixel - [view.cx, view.cy]) / [view.fx, view.fy]
        ray = np.column_stack((tangent, np.ones(len(tangent)))) @ view.axes.T
        with np.errstate(divide="ignore", invalid="ignore"):
            return view.position, np.where(ray[:, 2:] < 0.0, ray[:, :2] / -ray[:, 2:], np.nan)

    def in_frame(self, direction: Array) -> Array:
        """Return a direction (3,) of the site frame in that of lander and rocks."""
        if not self.state.has(MAP):
            return direction
        return turned_about_up(-float(self.state.value(MAP)[3])) @ direction

    @property
    def lost(self) -> bool:
        """Whether what was measured or seen cannot be explained."""
        return self._aids.lost or self.pictures.lost

    # --- time -----------------------------------------------------------------------------

    def propagate(self, angle: ArrayLike, velocity: ArrayLike) -> None:
        """Carry the filter over inertial samples (n, 3); NaN stands for a missing one."""
        self.state.propagate(angle, velocity)
        self._aids.travel()
        self._aids.doubt_units()

    # --- rocks ----------------------------------------------------------------------------

    def sight(self, camera: CameraModel, points: Array | None = None) -> Sight:
        """Return where rocks at points (n, 3), or those tracked, should be seen (Eqs. 10-11)."""
        return sight_of(self.inertial, camera, self.xyz if points is None else points)

    def innovation_covariance(self, sight: Sight) -> Array:
        """Return the covariance of the predicted pixels of all rocks (n, 2, 2)."""
        p = self.state.for_rows(POSE)
        pose = p[np.ix_(POSE, POSE)]
        cross = np.moveaxis(p[POSE[:, None, None], self.places()[None]], 0, 1)  # (n, 6, 3)
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
        gate: float = np.inf,
    ) -> Outcome:
        """Take in what was seen of rocks in one image.

        What is not finite, or has no positive variance, tells nothing.

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
        gate
            Normalised innovation squared a degree of freedom, beyond which the places of the image
            are refused as a whole.

        Returns
        -------
        outcome
            Of the pixel coordinates; chi-squared with two degrees of freedom a rock.
        """
        self.update_radii(index, radius, radius_variance, radius_floor)
        good = np.isfinite(pixel).all(1) & positive(pixel_covariance)
        if not good.any():
            return Outcome(0.0, 0, False)
        with one_blas_thread():
            return self._update_places(
                index[good], sight, pixel[good], pixel_covariance[good], common, gate
            )

    def _update_places(
        self,
        index: Index,
        sight: Sight,
        pixel: Array,
        pixel_covariance: Array,
        common: float,
        gate: float,
    ) -> Outcome:
        """Correct lander and rocks."""
        m = len(index)
        a, b = sight.by_pose[index], sight.by_rock[index]
        columns = self.places(index)
        with threads_for(1e-2 * m * self.state.size):
            p = self.state.for_rows(POSE, columns)
            hp = measured_rows(p, self.state.size, POSE, a, columns, b)
        s = hp[:, POSE] @ a.reshape(2 * m, 6).T
        own = hp[:, columns.ravel()].reshape(2 * m, m, AXES)
        s += np.einsum("kmj,mij->kmi", own, b).reshape(2 * m, 2 * m)
        block = 2 * np.arange(m)[:, None] + np.arange(2)
        s[block[:, :, None], block[:, None, :]] += pixel_covariance
        s[::2, ::2] += common**2
        s[1::2, 1::2] += common**2
        innovation = (pixel - sight.pixel[index]).ravel()
        return self.state.absorb(hp, s, innovation, 2 * m * gate)

    def turn(
        self, sun: Array, along: float, across: float, shared: float, *,
        closing: float = 0.0, pixel: float = 0.0,
    ) -> None:  # fmt: skip
        """Let what shadows tell of rocks' centres wander as the view turns and draws near.

        How a patch lies about its rock depends on where it is seen from. What the model of shadows
        has wrong of that is a rock's own in part and in part the same for all; what is shared lies
        along the Sun. A camera of other pixels shows the same rocks with more or fewer of them, as
        if from another range.

        Parameters
        ----------
        sun
            Direction towards the Sun (3,), ENU.
        along, across
            Standard deviation of a rock's own after a radian, along the Sun and across, in radii.
        shared
            The same of what all share.
        closing
            Of what all share when what a pixel spans has changed by a factor e, be it by the range
            or the camera; in what the coarser pixel spans.
        pixel
            What a pixel spans at a range of 1 m, m.
        """
        eye = self.inertial.position.copy()
        other, coarser = 0.0, pixel
        if min(pixel, self._pixel) > 0.0:
            other, coarser = abs(float(np.log(pixel / self._pixel))), max(pixel, self._pixel)
        if self._eye is None or self.count == 0:
            self._eye, self._pixel = eye, pixel
            return
        old, new = self.xyz - self._eye, self.xyz - eye
        angle = np.arctan2(
            np.linalg.norm(np.cross(old, new), axis=1), np.einsum("ij,ij->i", old, new)
        )
        far = np.maximum(np.linalg.norm(new, axis=1), _NEAREST)
        nearer = np.abs(np.log(far / np.maximum(np.linalg.norm(old, axis=1), _NEAREST)))
        if max(np.median(angle), np.median(nearer), other) < _LEAST_TURN:
            return
        self._eye, self._pixel = eye, pixel
        level = sun[:2] / np.hypot(sun[0], sun[1])
        root = np.sqrt(angle) * self.radius
        range_ = closing * np.sqrt(nearer + other) * coarser * far
        self._wander_together(np.stack((shared * root, range_)), level)
        axes = np.array([[*level, 0.0], [-level[1], level[0], 0.0]])
        i = self.places()
        own = (axes.T * [along**2, across**2]) @ axes
        own = 0.5 * (own + own.T)  # symmetric to the last bit
        self.state.for_rows()[i[:, :, None], i[:, None, :]] += (root**2)[:, None, None] * own

    def _wander_together(self, sigma: Array, axis: Array) -> None:
        """Let all rocks have moved along a level axis (2,), by m numbers times sigma (m, n), m."""
        size = self.state.size
        move = np.zeros((len(sigma), self.count, AXES))
        move[..., :2] = sigma[..., None] * axis
        with threads_for(4e-3 * size**2):
            add_few(
                self.state.for_rows()[self.first : size, self.first : size],
                move.reshape(len(sigma), -1),
            )

    def judge(self, kind: str, time: float, outcome: Outcome) -> Remedy:
        """Watch what came of a picture, see `PictureWatch`; widen the state where it is doubted.

        Rocks that are to be begun anew are left to the caller.
        """
        remedy = self.pictures.note(kind, time, outcome)
        if remedy is not Remedy.NONE and kind != "shadows":
            excess = self.pictures.watches[kind].excess
            growth = float(np.clip(excess, _LEAST_GROWTH, _MOST_GROWTH))
            size = self.state.size
            most = np.full(size, _MOST_PLACE)
            most[VELOCITY], most[ATTITUDE] = _MOST_SPEED, _MOST_TURN
            columns = np.r_[0:6, 9:12, self.first : size]
            # Had only the pose grown, scans would draw it back to the pose that is kept, and to
            # where the map was taken to lie.
            for name in (KEY, MAP):
                if self.state.has(name):
                    block = self.state.block(name)
                    most[block.start + 3 : block.stop] = _MOST_TURN
                    columns = np.r_[columns, block]
            self.state.inflate(columns, growth, most[columns])
        return remedy

    # --- coming and going -----------------------------------------------------------------

    def add(
        self,
        camera: CameraModel,
        points: Array,
        pixel_covariance: Array,
        radius: Array,
        radius_variance: Array,
    ) -> Index:
        """Begin to track rocks seen at points (b, 3), with their full cross-covariance.

        Their heights follow their neighbours'.

        Returns
        -------
        index
            Of the new rocks (b,).
        """
        told = self._told(camera, points, pixel_covariance)
        index = self.append(points, radius, radius_variance)
        for rock in index:
            self.follow_ground(rock)
        self._stand(index, *told)
        return index

    def begin_anew(
        self,
        index: Index,
        camera: CameraModel,
        pixel: Array,
        pixel_covariance: Array,
        radius: Array,
        radius_variance: Array,
    ) -> None:
        """Let rocks (b,) stand where one image shows them at pixels (b, 2), undistorted.

        How images before showed them is forgotten, and tells nothing of the lander. Heights stay.

        Raises
        ------
        InputError
            If a line of sight does not meet the ground; nothing changes then.
        """
        eye, per_drop = self._lines(camera, pixel)
        height = self.xyz[index, 2]
        points = np.column_stack((eye[:2] + per_drop * (eye[2] - height)[:, None], height))
        told = self._told(camera, points, pixel_covariance)
        self._xyz[index] = points
        self._r[index] = np.column_stack((radius, radius_variance))
        self._stand(index, *told)

    def _told(
        self, camera: CameraModel, points: Array, pixel_covariance: Array
    ) -> tuple[Array, Array, Array]:
        """Return what lines of sight to rocks at points (b, 3) tell of east and north.

        From ``by_pose d(pose) + by_rock d(rock) = d(pixel)``: how they err with the pose (b, 2, 6),
        with the rock's height (b, 2), and the covariance that the pixel adds (b, 2, 2).
        """
        sight = self.sight(camera, points)
        back = inverse(sight.by_rock[:, :, :2])
        by_pose = -(back @ sight.by_pose)
        by_height = -(back @ sight.by_rock[:, :, 2:])[:, :, 0]
        own = back @ pixel_covariance @ np.swapaxes(back, 1, 2)
        if not (np.isfinite(by_pose).all() and np.isfinite(own).all()):
            raise InputError("rocks", points.tolist(), "points on ground in front of the camera")
        return by_pose, by_height, own

    def _stand(self, index: Index, by_pose: Array, by_height: Array, own: Array) -> None:
        """Let east and north of rocks (b,) err as pose, height and pixel have it, see `_told`."""
        b = len(index)
        size, i = self.state.size, self.places(index)
        p, level = self.state.for_rows(POSE, i), i[:, :2].ravel()
        rows = by_pose.reshape(2 * b, 6) @ p[POSE, :size]
        rows += (by_height[:, :, None] * p[i[:, 2], :size][:, None, :]).reshape(2 * b, size)
        self.state.put(level, rows)
        block = rows[:, POSE] @ by_pose.reshape(2 * b, 6).T
        block += rows[:, i[:, 2]].repeat(2, 1) * by_height.ravel()
        at = np.arange(2 * b).reshape(b, 2)
        block[at[:, :, None], at[:, None, :]] += own
        p[np.ix_(level, level)] = 0.5 * (block + block.T)


def _beside(xy: Array, per_drop: Array, near: Region) -> NDArray[np.bool_]:
    """Return which points (n, 2) may lie in a region, or little beside it.

    They were found as if the ground were as high as the region's middle; along lines that go so far
    east and north for each metre that they go down (n, 2).
    """
    west, east, south, north = near
    rise = _STEEPEST * 0.5 * max(east - west, north - south)
    off = _BESIDE + rise * np.linalg.norm(per_drop, axis=1)
    x, y = xy.T
    return np.asarray((x > west - off) & (x < east + off) & (y > south - off) & (y < north + off))

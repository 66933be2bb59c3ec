"""Health of a picture: what must be so before anything in it, or missing from it, counts.

A map is drawn from what pictures do not show. So a picture counts only if it shows that rocks would
have been seen: it is exposed, sharp, new and whole, it has shadows, and these fall where the Sun
throws them. What shows nothing, be it a cap on the lens or ground without a rock, is not seen.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from enum import Enum
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.special import ndtri

from lunarsim.errors import InputError, check_types
from lunarsim.frames import is_place, is_rotation
from lunarsim.models.camera import CameraModel
from lunarsim.models.pinhole import View
from lunarsim.models.pose import Pose
from lunarsim.onboard.perception.detector import Detections
from lunarsim.onboard.perception.edges import MIN_WIDTH, EdgeWidths, edge_widths
from lunarsim.onboard.perception.sun_angle import SunAngle

Array = NDArray[np.float64]

# Every so many pixels and rows are looked at where a share of the picture is wanted.
_PIXEL_STRIDE = 4
# Sides of the picture are cut into so many bands, each of which must be as it should.
_BAND_COUNT = 8
# Share of the pixels, the quietest, that tell of noise.
_NOISE_QUANTILE = 0.25
# Counts that read noise may make of nothing; share of the pixels that must show more.
_MAX_BLACK_COUNTS, _MIN_LIT_FRACTION = 3, 0.02
# Ground darker than this share of what is lit may be missing; of a line that is, more than the one
# share is so dark, and of one beside a straight end less than the other.
_MISSING_BRIGHTNESS_RATIO, _MISSING_LINE_DARK, _NEIGHBOUR_LINE_DARK = 0.15, 0.98, 0.6
# Share of the pixels in shadow that tell how dark it is.
_SHADE_QUANTILE = 0.01
# Frames before the last that one is compared with: a buffer may be read over and over.
_COMPARED_FRAMES = 3


class Fault(Enum):
    """Why a picture does not count."""

    FORM = "it is not of the size and type of its camera's"
    POSE = "nobody knows where it was taken"
    NO_NUMBERS = "too many pixels are no numbers"
    FAINT = "lit ground is too dark"
    SATURATED = "too many pixels are saturated"
    VEILED = "shadows are too bright"
    NOISE = "noise hides shadows"
    STUCK = "it is one of the last, or a part of it is"
    GAPS = "rows or columns are missing"
    DARK = "too much lies in the dark"
    NO_SHADOWS = "it has too few shadows to show that rocks would be seen"
    BLURRED = "edges are not sharp"
    SMEARED = "edges are not sharp along one direction"
    SUN_ELSEWHERE = "shadows do not fall away from the Sun"
    MISPLACED = "rocks that were seen before are not where they should be"
    SUN_UNPROVEN = "shadows do not tell that the Sun is where it is taken to be"


# Nothing is wrong with the picture; it only proves nothing.
_INCONCLUSIVE = frozenset({Fault.NO_SHADOWS, Fault.SUN_UNPROVEN})


@dataclass(frozen=True)
class ImageQuality:
    """What a picture is good for.

    Attributes
    ----------
    fault
        The first that was found; None: the picture counts.
    figures
        What was measured until then, by name: `lit` (counts), `saturated`, `gaps`, `dark` (shares),
        `noise` (over the brightness of lit ground), `shadows` (number), `shade` (over lit ground),
        `width`, `smear` (pixels, 1 sigma of edges), `turn`, `turn_sigma` (rad), `turn_side`
        (standard deviations).
    """

    fault: Fault | None
    figures: dict[str, float]

    @property
    def good(self) -> bool:
        """Whether the picture counts."""
        return self.fault is None

    @property
    def alarm(self) -> bool:
        """Whether something is wrong with camera, picture or Sun: not that nothing was in view."""
        return self.fault is not None and self.fault not in _INCONCLUSIVE


@dataclass(frozen=True)
class HealthSettings:
    """When a picture counts.

    Attributes
    ----------
    blur_sigma
        Point spread of the camera as calibrated, 1 sigma, pixels.
    least_lit
        Counts of lit ground: one is then an eighth of its brightness.
    most_saturated
        Share of the pixels that may have the greatest count there is.
    most_noise
        Of a pixel, over the brightness of lit ground, in any part of the picture.
    most_dark
        Share of the picture that may be dark, be it shadow or sky.
    most_gaps
        Share of the pixels that may be no numbers, and of rows or columns that may be missing.
    most_same
        Share of the lit pixels of a band of the picture that may be as in one of the last.
    most_shade
        Brightness over that of lit ground of the darkest of what lies in shadow.
    least_shadows
        Of rocks, to judge by.
    most_width, most_smear
        Of edges of shadows, over what the point spread makes of them: of the sharpest, and of the
        sharpest along the direction in which they are least so.
    most_turn, least_turn
        By what angle shadows may fall beside where the Sun throws them for it to be there, and
        from what angle on it is not; between them they tell neither, rad.
    high_turn
        The latter under a high Sun: boulders brighter than the ground turn it by up to 18 deg.
    turn_sigma, least_side
        How well that angle must be known to tell, rad, and by how many standard deviations that it
        is not half a turn more.
    least_agreement
        Length of the mean direction from lit faces to shadows from which on it is rocks that tell
        that the Sun is elsewhere: craters and slopes turn it too, and agree less.
    proof_agreement
        The same from which on shadows show that the Sun is in its place: where shadows run into
        each other, what lies between them passes for lit faces on the wrong side, and fewer agree.
    wrong_turn, wrong_by
        What the Sun may be wrong by, rad. Under a high Sun an angle that is less well known shows
        it in its place too, if it is so many standard deviations from that.
    """

    blur_sigma: float = 0.6
    least_lit: float = 8.0
    most_saturated: float = 0.1
    most_noise: float = 0.08
    most_dark: float = 0.6
    most_gaps: float = 0.02
    most_same: float = 0.9
    most_shade: float = 0.35
    least_shadows: int = 4
    most_width: float = 1.25
    most_smear: float = 1.15
    most_turn: float = float(np.deg2rad(10.0))
    least_turn: float = float(np.deg2rad(15.0))
    high_turn: float = float(np.deg2rad(25.0))
    turn_sigma: float = float(np.deg2rad(5.0))
    least_side: float = 4.0
    least_agreement: float = 0.55
    proof_agreement: float = 0.2
    wrong_turn: float = float(np.deg2rad(30.0))
    wrong_by: float = 3.5

    def __post_init__(self) -> None:
        check_types("health", self)
        if not (np.isfinite(self.blur_sigma) and self.blur_sigma >= 0.0):
            raise InputError("health.blur_sigma", self.blur_sigma, "0 or a positive number")
        for name in ("most_saturated", "most_dark", "most_gaps", "most_same"):
            if not 0.0 < getattr(self, name) <= 1.0:
                raise InputError(f"health.{name}", getattr(self, name), "a share above 0, up to 1")
        for name in ("least_lit", "most_noise", "least_shadows", "most_shade", "most_width",
                     "most_smear", "most_turn", "least_turn", "high_turn", "turn_sigma",
                     "least_side", "least_agreement", "proof_agreement", "wrong_turn",
                     "wrong_by"):  # fmt: skip
            if not (np.isfinite(getattr(self, name)) and getattr(self, name) > 0.0):
                raise InputError(f"health.{name}", getattr(self, name), "a positive number")
        for name in ("least_agreement", "proof_agreement"):
            if getattr(self, name) > 1.0:
                raise InputError(f"health.{name}", getattr(self, name), "at most 1")
        if not self.most_turn <= self.least_turn <= np.pi:
            turns = (self.most_turn, self.least_turn)
            raise InputError("health.most_turn, least_turn", turns, "rising angles up to pi, rad")


@dataclass
class SunConfirmation:
    """Whether shadows have shown that the Sun is where it is taken to be.

    It stays there, so later pictures need not show it again, be they another camera's of the same
    lander; one that shows otherwise takes it back.

    Attributes
    ----------
    seen
        Whether they have.
    side
        Of the picture that showed it most surely, see `SunAngle.side`.
    """

    seen: bool = False
    side: float = 0.0


class PictureHealth:
    """Judges the pictures of one camera, one after the other.

    Parameters
    ----------
    settings
        See `HealthSettings`.
    sun
        What pictures have shown of the Sun, to share with the lander's other cameras; left out: its
        own.
    """

    def __init__(
        self, settings: HealthSettings | None = None, sun: SunConfirmation | None = None
    ) -> None:
        self.settings = settings or HealthSettings()
        self.sun = sun or SunConfirmation()
        self._last: deque[NDArray[Any]] = deque(maxlen=_COMPARED_FRAMES)

    def before_detection(self, counts: ArrayLike, camera: CameraModel, pose: Pose) -> ImageQuality:
        """Judge a picture by itself.

        Parameters
        ----------
        counts
            What should be unsigned counts, or numbers, (camera.height, camera.width).
        camera, pose
            What took it, and from where.
        """
        try:
            raw = np.asarray(counts)
        except ValueError:
            return ImageQuality(Fault.FORM, {})
        if raw.shape != (camera.height, camera.width) or raw.dtype.kind not in "uif":
            return ImageQuality(Fault.FORM, {})
        if not (is_place(pose.position) and is_rotation(pose.attitude)):
            return ImageQuality(Fault.POSE, {})
        figures: dict[str, float] = {}
        return ImageQuality(
            self._check_counts(raw, _looks_down(camera.view(pose)), figures), figures
        )

    def _check_counts(
        self, raw: NDArray[Any], ground: NDArray[np.bool_], figures: dict[str, float]
    ) -> Fault | None:
        s = self.settings
        sampled = raw[::_PIXEL_STRIDE, ::_PIXEL_STRIDE]
        is_finite = np.isfinite(sampled)
        figures["gaps"] = 1.0 - float(is_finite.mean())
        if figures["gaps"] > s.most_gaps:
            return Fault.NO_NUMBERS
        same = self._repeated_fraction(sampled, s.least_lit)
        self._last.append(sampled.copy())
        ground = ground & is_finite
        if not ground.any():
            return Fault.NO_SHADOWS
        figures["lit"] = _lit_brightness(sampled[ground])
        if not figures["lit"] >= s.least_lit:
            return Fault.FAINT
        figures["saturated"] = float((sampled[ground] == sampled[ground].max()).mean())
        if figures["saturated"] > s.most_saturated:
            return Fault.SATURATED
        figures["gaps"] = max(figures["gaps"], _missing_lines(raw, ground, figures["lit"]))
        if figures["gaps"] > s.most_gaps:
            return Fault.GAPS
        if same > s.most_same:
            return Fault.STUCK
        figures["noise"] = _noise(raw) / figures["lit"]
        return Fault.NOISE if not figures["noise"] <= s.most_noise else None

    def _repeated_fraction(self, sampled: NDArray[Any], lit: float) -> float:
        """Return the share of lit pixels as in one of the last, of the band that has most."""
        highest = 0.0
        bright = sampled >= lit
        for last in self._last:
            if last.shape != sampled.shape:
                continue
            same = bright & (sampled == last)
            for axis in (0, 1):
                for same_band, bright_band in zip(
                    np.array_split(same, _BAND_COUNT, axis),
                    np.array_split(bright, _BAND_COUNT, axis),
                    strict=True,
                ):
                    lit_here = np.count_nonzero(bright_band)
                    if lit_here >= 0.2 * bright_band.size:
                        highest = max(highest, np.count_nonzero(same_band) / lit_here)
        return highest

    def after_detection(self, seen: Detections, turn: SunAngle, noise: float) -> ImageQuality:
        """Judge a picture, good by itself, by the shadows found in it.

        Parameters
        ----------
        seen
            What was found in it.
        turn
            By what angle shadows fall beside where the Sun is taken to throw them.
        noise
            As `before_detection` measured it.
        """
        s = self.settings
        dark = float((seen.labels[::_PIXEL_STRIDE, ::_PIXEL_STRIDE] > 0).mean())
        figures = {"dark": dark, "shadows": float(len(seen))}
        if dark > s.most_dark:
            return ImageQuality(Fault.DARK, figures)
        widths = edge_widths(seen, noise)
        figures |= {"width": widths.sharpest, "smear": widths.least_sharp}
        figures |= {"turn": turn.angle, "turn_sigma": turn.sigma, "turn_side": turn.side}
        if widths.number < s.least_shadows:
            return ImageQuality(Fault.NO_SHADOWS, figures)
        fault = self._check_sharpness(widths)
        figures["shade"] = _shadow_brightness(seen)
        if fault is None and figures["shade"] > s.most_shade:
            fault = Fault.VEILED
        return ImageQuality(fault or self._check_sun(turn), figures)

    def _check_sharpness(self, widths: EdgeWidths) -> Fault | None:
        expected = EdgeWidths.expected(self.settings.blur_sigma)
        if not widths.sharpest <= self.settings.most_width * expected:
            return Fault.BLURRED
        if not widths.least_sharp <= self.settings.most_smear * max(expected, MIN_WIDTH):
            return Fault.SMEARED
        return None

    def tells(self, turn: SunAngle) -> bool:
        """Say whether shadows tell where the Sun is."""
        s = self.settings
        return turn.sigma <= s.turn_sigma and turn.side >= s.least_side

    def judges(self, turn: SunAngle) -> bool:
        """Say whether shadows tell that the Sun is in its place, or that it is not."""
        near = abs(turn.angle) < self.settings.least_turn
        return self.contradicts(turn) or (self.tells(turn) and near)

    def contradicts(self, turn: SunAngle) -> bool:
        """Say whether shadows tell that the Sun is elsewhere: so many that it is rocks that do.

        Where lit faces say that it is in its place, shadows that lie otherwise are not those of
        single rocks.
        """
        s = self.settings
        agrees = turn.high_sun or turn.agreement >= s.least_agreement
        wrong_angle = s.high_turn if turn.high_sun else s.least_turn
        contradicted_by_faces = abs(turn.by_faces) < wrong_angle
        return (
            self.tells(turn)
            and agrees
            and abs(turn.angle) >= wrong_angle
            and not contradicted_by_faces
        )

    def _check_sun(self, turn: SunAngle) -> Fault | None:
        s = self.settings
        if self.contradicts(turn):
            self.sun.seen, self.sun.side = False, 0.0
            return Fault.SUN_ELSEWHERE
        is_far = (
            turn.side >= s.least_side and abs(turn.angle) - s.wrong_by * turn.sigma > s.most_turn
        )
        if is_far or (self.tells(turn) and abs(turn.angle) >= s.least_turn):
            # Craters and shadows that run into each other do so, or the Sun is elsewhere.
            self.sun.seen &= turn.side <= self.sun.side
            return Fault.SUN_UNPROVEN
        agrees = turn.high_sun or turn.agreement >= s.proof_agreement
        is_proven = (self.tells(turn) and agrees) or (
            turn.high_sun
            and turn.side >= s.least_side
            and abs(turn.angle) + s.wrong_by * turn.sigma <= s.wrong_turn
        )
        if is_proven and abs(turn.angle) <= s.most_turn:
            self.sun.seen, self.sun.side = True, max(self.sun.side, turn.side)
        return None if self.sun.seen else Fault.SUN_UNPROVEN


def _shadow_brightness(seen: Detections) -> float:
    """Return how bright the darkest of what lies in rocks' shadows is, over lit ground."""
    shaded = seen.relative[seen.rock > 0]
    at = int(_SHADE_QUANTILE * shaded.size)
    return float(np.partition(shaded, at)[at]) if shaded.size else np.inf


def _lit_brightness(seen: NDArray[Any]) -> float:
    """Return the brightness of lit ground among pixels (n,), counts.

    What is bright is half as bright at least as the brightest but a few, be most of the picture
    in the dark.
    """
    shown = seen[seen > _MAX_BLACK_COUNTS]
    if len(shown) < _MIN_LIT_FRACTION * len(seen):
        return 0.0
    return float(np.median(shown[shown >= 0.5 * np.percentile(shown, 90.0)]))


def _looks_down(view: View) -> NDArray[np.bool_]:
    """Return which pixels look down, every few of them."""
    u = (np.arange(0, view.width, _PIXEL_STRIDE) - view.cx) / view.fx
    v = (np.arange(0, view.height, _PIXEL_STRIDE) - view.cy) / view.fy
    up = view.axes[2]
    return np.asarray(up[0] * u + up[1] * v[:, None] + up[2] < 0.0)


def _missing_lines(raw: NDArray[Any], ground: NDArray[np.bool_], lit: float) -> float:
    """Return the share of rows, or of columns, on the ground that never came.

    They repeat the one before, which no two lines of lit ground do, or all of them is dark up to a
    line next to it that is not, as no shadow is.
    """
    highest = 0.0
    for image, below in ((raw, ground), (raw.T, ground.T)):
        lines = image[:, ::_PIXEL_STRIDE]
        dark = (lines < _MISSING_BRIGHTNESS_RATIO * lit).mean(1)
        is_ground = np.repeat(below.all(1), _PIXEL_STRIDE)[: len(image)]
        is_ground = _exclude_sky(is_ground, dark > _MISSING_LINE_DARK)
        if not is_ground.any():
            continue
        repeats = np.zeros(len(lines), np.bool_)
        repeats[1:] = (lines[1:] == lines[:-1]).all(1)
        empty = dark > _MISSING_LINE_DARK
        ends = (empty[1:] & (dark[:-1] < _NEIGHBOUR_LINE_DARK)) | (
            empty[:-1] & (dark[1:] < _NEIGHBOUR_LINE_DARK)
        )
        straight = (ends & is_ground[1:] & is_ground[:-1]).any()
        is_missing = empty | repeats if straight else repeats & ~empty
        highest = max(highest, float(is_missing[is_ground].mean()))
    return highest


def _exclude_sky(ground: NDArray[np.bool_], dark: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Return which lines (n,) show ground, less dark ones next to the sky: ground may end there."""
    out = ground.copy()
    for order in (range(1, len(out)), range(len(out) - 2, -1, -1)):
        for i in order:
            before = i - 1 if order.step > 0 else i + 1
            if not out[before] and dark[i]:
                out[i] = False
    return out


def _noise(raw: NDArray[Any]) -> float:
    """Return the noise of a pixel, 1 sigma, of the part of the picture that has most.

    The Laplacian of Immerkaer (1996, Computer Vision and Image Understanding 64), which is 0 on a
    slope; its lower quartile passes over edges, be they half of a crowded picture.
    """
    h, w = raw.shape
    if min(h, w) < 3 * _BAND_COUNT:
        return 0.0

    def at(di: int, dj: int) -> NDArray[np.float32]:
        return raw[1 + di : h - 1 + di : _PIXEL_STRIDE, 1 + dj : w - 1 + dj : _PIXEL_STRIDE].astype(
            np.float32
        )

    corners = at(-1, -1) + at(-1, 1) + at(1, -1) + at(1, 1)
    sides = at(-1, 0) + at(1, 0) + at(0, -1) + at(0, 1)
    response = np.abs(corners - 2.0 * sides + 4.0 * at(0, 0)) / 6.0
    parts = [
        np.nanquantile(same_band, _NOISE_QUANTILE)
        for rows in np.array_split(response, _BAND_COUNT // 2)
        for same_band in np.array_split(rows, _BAND_COUNT // 2, 1)
    ]
    return float(np.max(parts)) / float(ndtri(0.5 + 0.5 * _NOISE_QUANTILE))

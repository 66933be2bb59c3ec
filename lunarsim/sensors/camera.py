"""Pinhole camera with real imperfections, each of which can be switched off."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from functools import cached_property
from itertools import pairwise
from typing import Any, Literal

import cv2
import numpy as np
from numpy.typing import NDArray

from lunarsim.errors import InputError
from lunarsim.frames import is_rotation, quat_from_rotation_vector, quat_multiply, quat_to_matrix
from lunarsim.messages.measurements import CameraImage
from lunarsim.models.camera import CameraModel
from lunarsim.models.pinhole import View, check_finite_position
from lunarsim.sensors.detector import counts_from_electrons, dark_current, illumination_falloff
from lunarsim.sensors.rendered_image import RenderedImage
from lunarsim.typing import Array
from lunarsim.vehicle.state import State
from lunarsim.world import World

# A rolling shutter is rendered in bands of lines. Maximum displacement of a line from its image at
# its own pose, pixels, and maximum number of bands.
_BAND_ERROR_PX = 0.25
_MAX_BANDS = 64
# Maximum number of warped images averaged for motion blur.
_MAX_BLUR_STEPS = 48


@dataclass(frozen=True)
class ExposedImage:
    """Counts of one exposed image and, if requested, its geometric ground truth.

    Attributes
    ----------
    time
        Middle of the exposure, s.
    counts
        Counts of the converter (height, width): uint8 up to 8 bits, else uint16.
    truth
        Range, normal and identity of every pixel, without blur and noise; None unless requested.
    """

    time: float
    counts: NDArray[np.unsignedinteger[Any]]
    truth: RenderedImage | None = None


@dataclass(frozen=True)
class Camera(CameraModel):
    """A framing camera fixed to the lander: geometry, shutter and detector.

    Attributes
    ----------
    exposure
        Exposure time, s.
    sensitivity
        Electrons per second in a pixel at a radiance factor of 1. With the defaults, a radiance
        factor of 0.2 saturates the pixel.
    blur_sigma
        Standard deviation of the point spread, pixels; 0: none.
    motion_blur
        Whether rotation of the lander blurs the image.
    shot_noise
        Whether photon shot noise is simulated.
    read_noise
        Read noise, electrons, 1 sigma; 0: none.
    full_well
        Electrons at which a pixel saturates.
    bits
        Bits of the converter, 1 to 16.
    gain
        Gain of the amplifier: full scale is the full well divided by the gain.
    vignetting
        Exponent of the cosine of the field angle in the illumination falloff; 4: natural law.
    stray_light
        Fraction of the light that is spread uniformly over the image.
    hot_pixels, hot_current
        Fraction of hot pixels, and the mean of their exponentially distributed dark current,
        electrons per second.
    shutter, line_time
        "global": all lines are exposed at once; "rolling": each line `line_time` (s) after the one
        above, the middle line at the time of the image. With distortion, the lines are those of
        the undistorted image.
    antialias
        Rays along each side of a pixel, whose radiance is averaged.
    detector_seed
        Seed of the positions of hot pixels.
    """

    exposure: float = 2e-3
    sensitivity: float = 5e7
    blur_sigma: float = 0.6
    motion_blur: bool = True
    shot_noise: bool = True
    read_noise: float = 12.0
    full_well: float = 20_000.0
    bits: int = 8
    gain: float = 1.0
    vignetting: float = 0.0
    stray_light: float = 0.0
    hot_pixels: float = 0.0
    hot_current: float = 2e5
    shutter: Literal["global", "rolling"] = "global"
    line_time: float = 2e-5
    antialias: int = 1
    detector_seed: int = 0

    def __post_init__(self) -> None:
        super().__post_init__()
        for name in ("exposure", "sensitivity", "full_well", "gain"):
            if not (np.isfinite(getattr(self, name)) and getattr(self, name) > 0.0):
                raise InputError(
                    f"camera.{name}", getattr(self, name), "must be positive and finite"
                )
        for name in ("blur_sigma", "read_noise", "vignetting", "hot_current", "line_time"):
            if not (np.isfinite(getattr(self, name)) and getattr(self, name) >= 0.0):
                raise InputError(
                    f"camera.{name}", getattr(self, name), "must be 0 or more and finite"
                )
        if not (isinstance(self.bits, int) and 1 <= self.bits <= 16):
            raise InputError("camera.bits", self.bits, "must be an integer from 1 to 16")
        for name in ("stray_light", "hot_pixels"):
            if not 0.0 <= getattr(self, name) <= 1.0:
                raise InputError(f"camera.{name}", getattr(self, name), "must be between 0 and 1")
        if self.detector_seed < 0:
            raise InputError("camera.detector_seed", self.detector_seed, "must be 0 or more")
        if self.shutter not in ("global", "rolling"):
            raise InputError("camera.shutter", self.shutter, "must be global or rolling")
        if not (isinstance(self.antialias, int) and 1 <= self.antialias <= 4):
            raise InputError("camera.antialias", self.antialias, "must be an integer from 1 to 4")

    @classmethod
    def with_field_of_view(cls, width: int, height: int, degrees: float, **more: object) -> Camera:
        """Return a camera with square pixels and a horizontal field of view of `degrees`.

        `width` and `height` are the size of the image, pixels; `more` are other fields of the
        camera.
        """
        if not (isinstance(degrees, float | int | np.floating) and 0.0 < degrees < 170.0):
            raise InputError(
                "camera.field_of_view_deg", degrees, "must be more than 0 and less than 170"
            )
        focal = 0.5 * width / np.tan(0.5 * np.deg2rad(degrees))
        return cls(width, height, focal, focal, **more)  # type: ignore[arg-type]

    @property
    def model(self) -> CameraModel:
        """Geometry of the camera, which is sent with every image."""
        return CameraModel(**{f.name: getattr(self, f.name) for f in fields(CameraModel)})

    def measure(
        self,
        world: World,
        state: State,
        time: float,
        rng: np.random.Generator,
        mount: Array | None = None,
    ) -> CameraImage:
        """Take an image of the true world.

        `state` is the true state at `time`, the middle of the exposure, s; `rng` is the source of
        the noise. `mount` (3, 3), sensor to body, replaces the mounting of the camera.
        """
        camera = self if mount is None else replace(self, mount=mount)
        exposure = camera.expose(world, state, time, rng)
        return CameraImage(exposure.time, exposure.counts, camera.model, camera.exposure)

    def expose(
        self,
        world: World,
        state: State,
        time: float,
        rng: np.random.Generator,
        *,
        truth: bool = False,
    ) -> ExposedImage:
        """Render and expose one image of the true world.

        Parameters
        ----------
        world, state, time
            True world and state in the middle of the exposure, and its time, s.
        rng
            Source of shot and read noise.
        truth
            Whether to return range, normal and identity of every pixel. They are distorted like
            the image, but have neither blur nor noise.

        Raises
        ------
        InputError
            If the camera is below the terrain, or position or attitude are not valid.
        RenderingError
            If OpenGL is missing.
        """
        from lunarsim.sensors.rendering import render_world  # noqa: PLC0415  (loads OpenGL)

        _check_pose(state)
        view = self._with_border(self.view(state))
        rate = self.mount.T @ np.asarray(state.rate)
        radiance = self._blur_motion(self._render(world, state, view), view, rate)
        radiance = self._distort(radiance, cv2.INTER_LINEAR)
        if self.blur_sigma > 0.0:
            radiance = cv2.GaussianBlur(
                radiance, (0, 0), self.blur_sigma, borderType=cv2.BORDER_REPLICATE
            )
        kept = None
        if truth:
            # Rendered separately at full detail, so that the request does not change the image.
            image = render_world(world, view, truth=True)
            assert image.range is not None
            assert image.normal is not None
            assert image.identity is not None
            identity = self._distort(image.identity.astype(np.float64), cv2.INTER_NEAREST)
            kept = RenderedImage(
                self._distort(image.radiance, cv2.INTER_NEAREST),
                self._distort(image.range, cv2.INTER_NEAREST),
                self._distort(image.normal, cv2.INTER_NEAREST),
                identity.astype(np.int32),
            )
        return ExposedImage(time, self._detect(radiance, rng), kept)

    def _render(self, world: World, state: State, view: View) -> NDArray[np.float32]:
        """Render the radiance factor of a view; a rolling shutter exposes band after band.

        `state` is the true state in the middle of the exposure; `view` includes the border that
        distortion requires, and so does the result (height, width).
        """
        bands = [(0, view.height, state)]
        if self.shutter == "rolling":
            bands = self._bands(world, state, view)
        images = []
        for first, last, then in bands:
            full = self._with_border(self.view(then))
            band = View(
                full.position, full.axes, full.fx, full.fy, full.cx, full.cy - first,
                full.width, last - first,
            )  # fmt: skip
            image = _supersample(world, band, self.antialias)
            sheet = world.dust_sheet(then.position, then.attitude, then.thrust)
            images.append(image if sheet is None else sheet.veil(band, world.light, image))
        return images[0] if len(images) == 1 else np.concatenate(images)

    def _bands(self, world: World, state: State, view: View) -> list[tuple[int, int, State]]:
        """Divide a rolling-shutter image into bands of lines that are rendered together.

        Returns, for each band, its first line, the line after its last, and the lander state at the
        mean time of its lines.
        """
        max_elevation = world.terrain.relief.z_range[1]
        near = max(float(view.position[2]) - max_elevation, 1.0)
        focal = max(view.fx, view.fy)
        speed = focal * (
            float(np.linalg.norm(state.velocity)) / near + float(np.linalg.norm(state.rate))
        )
        travel = speed * self.line_time * view.height
        count = int(
            np.clip(np.ceil(0.5 * travel / _BAND_ERROR_PX), 1, min(_MAX_BANDS, view.height))
        )
        edges = np.linspace(0, view.height, count + 1).astype(int)
        out = []
        for first, last in pairwise(edges):
            late = self.line_time * (0.5 * (first + last) - 0.5 * view.height)
            out.append((int(first), int(last), _propagate(state, late)))
        return out

    @property
    def dark_current(self) -> Array:
        """Dark current of each pixel (height, width), electrons per second."""
        shape = (self.height, self.width)
        return dark_current(shape, self.hot_pixels, self.hot_current, self.detector_seed)

    @cached_property
    def _border(self) -> int:
        """Width, pixels, of the extra border to render before applying distortion.

        It is 0 without distortion.
        """
        if not any(self.distortion):
            return 0
        x, y = self._source_pixels
        assert self.cx is not None
        over = max(
            -float(x.min()), float(x.max()) - self.width + 1,
            -float(y.min()), float(y.max()) - self.height + 1, 0.0,
        )  # fmt: skip
        if over > 2.0 * max(self.width, self.height):
            raise InputError(
                "camera.distortion",
                self.distortion,
                "must be invertible over the complete image",
                "Use weaker distortion or a narrower field of view.",
            )
        return int(np.ceil(over)) + 2

    @cached_property
    def _source_pixels(self) -> tuple[Array, Array]:
        """Undistorted image coordinates x, y that each pixel of the image shows.

        Both arrays are (height, width), pixels.
        """
        x, y = self.tangents
        assert self.cx is not None
        assert self.cy is not None
        return self.fx * x + self.cx, self.fy * y + self.cy

    def _with_border(self, view: View) -> View:
        """Return the view extended by the border that distortion requires."""
        b = self._border
        return View(
            view.position, view.axes, view.fx, view.fy, view.cx + b, view.cy + b,
            view.width + 2 * b, view.height + 2 * b,
        )  # fmt: skip

    def _distort(self, image: NDArray[Any], how: int) -> NDArray[Any]:
        if self._border == 0:
            return image
        x, y = ((s + self._border).astype(np.float32) for s in self._source_pixels)
        return np.asarray(cv2.remap(image, x, y, how, borderMode=cv2.BORDER_REPLICATE))

    def _blur_motion(
        self, image: NDArray[np.float32], view: View, rate: Array
    ) -> NDArray[np.float32]:
        """Average an image over the rotation of the camera during the exposure.

        `rate` is the angular velocity (3,), sensor axes, rad/s. The image is returned unchanged if
        motion blur is disabled or the rotation moves no pixel by 0.05 pixels or more.

        A rotation moves pixels by the homography K R K^-1, independent of range. The translation of
        the lander during an exposure is far below a pixel and is neglected.
        """
        turn = rate * self.exposure
        reach = np.hypot(view.width, view.height) * 0.5
        travel = np.hypot(turn[0], turn[1]) * max(view.fx, view.fy) + abs(turn[2]) * reach
        if not self.motion_blur or travel < 0.05:
            return image
        steps = int(min(max(4, np.ceil(2.0 * travel)), _MAX_BLUR_STEPS))
        k = view.pinhole.matrix
        inverse = np.linalg.inv(k)
        total = np.zeros_like(image)
        for part in (np.arange(steps) + 0.5) / steps - 0.5:
            # From a pixel at this instant to the same direction in the rendered image.
            rotation = quat_to_matrix(quat_from_rotation_vector(turn * part))
            total += cv2.warpPerspective(
                image, k @ rotation @ inverse, (view.width, view.height),
                flags=cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP, borderMode=cv2.BORDER_REPLICATE,
            )  # fmt: skip
        total /= np.float32(steps)
        return total

    def _detect(
        self, radiance: NDArray[np.float32], rng: np.random.Generator
    ) -> NDArray[np.unsignedinteger[Any]]:
        electrons = radiance * np.float32(self.sensitivity * self.exposure)
        if self.vignetting > 0.0:
            electrons *= illumination_falloff(self.model, self.vignetting)
        if self.stray_light > 0.0:
            veil = self.stray_light * float(electrons.mean(dtype=np.float64))
            electrons = electrons * np.float32(1.0 - self.stray_light) + np.float32(veil)
        if self.hot_pixels > 0.0:
            electrons = electrons + (self.exposure * self.dark_current).astype(np.float32)
        return counts_from_electrons(
            electrons, rng, shot_noise=self.shot_noise, read_noise=self.read_noise,
            full_well=self.full_well, gain=self.gain, bits=self.bits,
        )  # fmt: skip


def _check_pose(state: State) -> None:
    """Raise InputError unless a state has a finite position and a unit quaternion."""
    check_finite_position(state.position)
    if not is_rotation(state.attitude):
        raise InputError(
            "camera.attitude", np.asarray(state.attitude).tolist(), "must be a unit quaternion"
        )


def _propagate(state: State, time: float) -> State:
    """Extrapolate a state by a short `time` (s) at constant velocity and angular rate."""
    turn = quat_from_rotation_vector(time * np.asarray(state.rate))
    return replace(
        state, position=state.position + time * np.asarray(state.velocity),
        attitude=quat_multiply(state.attitude, turn),
    )  # fmt: skip


def _supersample(world: World, view: View, side: int) -> NDArray[np.float32]:
    """Render a view; average the radiance factor over `side` x `side` rays per pixel."""
    from lunarsim.sensors.rendering import render_world  # noqa: PLC0415  (loads OpenGL)

    if side == 1:
        return render_world(world, view).radiance
    fine = View(
        view.position, view.axes, side * view.fx, side * view.fy,
        side * (view.cx + 0.5) - 0.5, side * (view.cy + 0.5) - 0.5,
        side * view.width, side * view.height,
    )  # fmt: skip
    drawn = render_world(world, fine).radiance
    parts = drawn.reshape(view.height, side, view.width, side)
    return np.asarray(parts.mean((1, 3), dtype=np.float32))

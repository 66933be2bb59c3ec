"""Settings of the camera as a part of a lander, and its calibration."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import ClassVar, Literal

import numpy as np

from lunarsim.errors import InputError
from lunarsim.messages.measurements import CameraImage
from lunarsim.models.instruments import CameraInstrument
from lunarsim.parts.quantity import quantity
from lunarsim.sensors.auto_exposure_camera import AutoExposureCamera
from lunarsim.sensors.camera import Camera
from lunarsim.sensors.exposure_control import ExposureControl


@dataclass(frozen=True)
class FramingCamera:
    """Settings of a framing camera on a gimbal, with optional automatic exposure."""

    width: int = quantity(640, ge=1, le=8192, help="width of the image in pixels")
    height: int = quantity(480, ge=1, le=8192, help="height of the image in pixels")
    field_of_view: float = quantity(60.0, "deg", gt=0, lt=170, help="horizontal field of view")
    distortion: tuple[float, float, float, float, float] = quantity(
        (0.0, 0.0, 0.0, 0.0, 0.0), help="Brown-Conrady coefficients k1, k2, p1, p2, k3"
    )
    exposure: float = quantity(
        2e-3,
        "s",
        gt=0,
        le=100,
        help="exposure time; with automatic exposure, only that of the first image",
    )
    sensitivity: float = quantity(
        5e7,
        "e-/s",
        gt=0,
        le=1e15,
        help="electrons per second in a pixel that views terrain with a radiance factor I/F of 1",
    )
    blur_sigma: float = quantity(
        0.6, "px", ge=0, le=20, help="standard deviation of the point spread function; 0: no blur"
    )
    motion_blur: bool = quantity(True, help="whether rotation of the lander blurs the image")
    shot_noise: bool = quantity(True, help="whether photon shot noise is simulated")
    read_noise: float = quantity(
        12.0, "e-", ge=0, le=1e6, help="read noise of the detector, 1 sigma"
    )
    full_well: float = quantity(
        20_000.0, "e-", ge=1, le=1e9, help="number of electrons that saturates a pixel"
    )
    bits: int = quantity(8, ge=1, le=16, help="number of bits of the analog-to-digital converter")
    gain: float = quantity(
        1.0, gt=0, le=100, help="amplifier gain; at 1, a pixel at full well gives the maximum count"
    )
    vignetting: float = quantity(
        0.0,
        ge=0,
        le=10,
        help="exponent of the cosine law by which light decreases towards the image edges; 0: no "
        "decrease; 4: natural vignetting",
    )
    stray_light: float = quantity(
        0.0, ge=0, le=0.5, help="fraction of the light that is spread uniformly over the image"
    )
    hot_pixels: float = quantity(
        0.0, ge=0, le=0.1, help="fraction of pixels with high dark current"
    )
    hot_current: float = quantity(
        2e5, "e-/s", ge=0, le=1e12, help="mean dark current of hot pixels"
    )
    shutter: Literal["global", "rolling"] = quantity(
        "global",
        help="shutter type: global (exposes all image lines at once) or rolling (one line after "
        "another)",
    )
    line_time: float = quantity(
        2e-5,
        "s",
        ge=0,
        le=1e-2,
        help="time between the exposures of two neighbouring image lines with a rolling shutter",
    )
    antialias: int = quantity(
        1,
        ge=1,
        le=4,
        help="number of rays along each side of a pixel, which are averaged against aliasing; 1: "
        "one ray per pixel",
    )
    exposure_control: Literal["fixed", "auto"] = quantity(
        "fixed",
        help="exposure mode: fixed (exposure_s) or auto (from the histogram of the previous image)",
    )
    exposure_level: float = quantity(
        0.8,
        gt=0,
        lt=1,
        help="desired 99.5th percentile of the pixel counts with automatic exposure, as a fraction "
        "of the maximum count",
    )
    exposure_min: float = quantity(
        1e-5, "s", gt=0, le=10, help="minimum exposure time with automatic exposure"
    )
    exposure_max: float = quantity(
        0.05, "s", gt=0, le=10, help="maximum exposure time with automatic exposure"
    )
    gimbal_limit: float = quantity(
        180.0,
        "deg",
        gt=0,
        le=180,
        help="maximum angle between the boresight and body -z to which the gimbal can turn",
    )

    measurement_type: ClassVar[type] = CameraImage
    is_tasked: ClassVar[bool] = True
    needs_sunlight: ClassVar[bool] = True

    def __post_init__(self) -> None:
        if self.exposure_min > self.exposure_max:
            raise InputError(
                "exposure_min", self.exposure_min,
                f"must be at most exposure_max_s, which is {self.exposure_max:g} s",
            )  # fmt: skip
        try:
            self.camera()
        except InputError as error:
            raise error.with_field(error.field.removeprefix("camera.")) from None

    def camera(self) -> Camera:
        """Return the camera with these settings, without automatic exposure."""
        return Camera.with_field_of_view(
            self.width, self.height, float(np.rad2deg(self.field_of_view)),
            distortion=self.distortion, exposure=self.exposure, sensitivity=self.sensitivity,
            blur_sigma=self.blur_sigma, motion_blur=self.motion_blur, shot_noise=self.shot_noise,
            read_noise=self.read_noise, full_well=self.full_well, bits=self.bits,
            gain=self.gain, vignetting=self.vignetting, stray_light=self.stray_light,
            hot_pixels=self.hot_pixels, hot_current=self.hot_current, shutter=self.shutter,
            line_time=self.line_time, antialias=self.antialias,
        )  # fmt: skip

    def build(self, rng: np.random.Generator, step: float) -> Camera | AutoExposureCamera:
        """Return the camera of one flight; its hot pixels come from `rng`.

        With automatic exposure it is an `AutoExposureCamera`. `step`, the integration step, is not
        used.
        """
        camera = self.camera()
        if self.hot_pixels > 0.0:
            camera = replace(camera, detector_seed=int(rng.integers(2**31)))
        if self.exposure_control == "fixed":
            return camera
        control = ExposureControl(
            bright_end_target=self.exposure_level, shortest=self.exposure_min,
            longest=self.exposure_max,
        )  # fmt: skip
        return AutoExposureCamera(camera, control)

    def calibration(self) -> CameraInstrument:
        """Return the calibration of the camera for the onboard computer.

        It consists of the gimbal limit, the blur, the angle of a pixel, and the field of view along
        the narrower side. Each image carries its focal length, distortion and mounting.
        """
        camera = self.camera()
        half = 0.5 * min(self.width / camera.fx, self.height / camera.fy)
        return CameraInstrument(self.gimbal_limit, self.blur_sigma, 1.0 / camera.fx, half)

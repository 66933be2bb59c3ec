"""A camera with automatic or commanded exposure."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from lunarsim.messages.measurements import CameraImage
from lunarsim.sensors.camera import Camera
from lunarsim.sensors.exposure_control import ExposureControl
from lunarsim.typing import Array
from lunarsim.vehicle.state import State
from lunarsim.world import World


class AutoExposureCamera:
    """Camera with a variable exposure time: automatic until a command fixes it.

    With automatic exposure, the time of the next image is computed from the histogram of each
    image. The gain changes only by command.

    Parameters
    ----------
    camera
        Camera with the exposure time of its first image.
    control
        Settings of automatic exposure; None: the time changes only by command.
    """

    def __init__(self, camera: Camera, control: ExposureControl | None) -> None:
        self.camera = camera
        self.control = control

    def command(self, exposure: float, gain: float | None = None) -> None:
        """Set exposure time (s) and gain to fixed values, and end automatic exposure.

        If `gain` is None, the gain remains unchanged.

        Raises
        ------
        InputError
            If a value is not positive; the camera remains unchanged.
        """
        gain = self.camera.gain if gain is None else gain
        self.camera = replace(self.camera, exposure=exposure, gain=gain)
        self.control = None

    def measure(
        self,
        world: World,
        state: State,
        time: float,
        rng: np.random.Generator,
        mount: Array | None = None,
    ) -> CameraImage:
        """Take an image; with automatic exposure, set the exposure time of the next one.

        `state` is the true state at `time`, the middle of the exposure, s; `mount` (3, 3) is the
        rotation, sensor to body. `rng` is the source of the noise.
        """
        image = self.camera.measure(world, state, time, rng, mount)
        if self.control is not None:
            exposure = self.control.next_exposure(
                image.counts, self.camera.bits, self.camera.exposure
            )
            self.camera = replace(self.camera, exposure=exposure)
        return image

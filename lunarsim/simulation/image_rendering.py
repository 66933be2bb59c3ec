"""Render one camera image of a scenario's terrain, for commands and figures."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from lunarsim.atomic_files import atomic_write
from lunarsim.errors import InputError, check_output
from lunarsim.frames import matrix_to_quat, sensor_axes
from lunarsim.rng import RandomStreams, flight_seed
from lunarsim.scenario import Scenario
from lunarsim.sensors.camera import Camera
from lunarsim.sensors.framing_camera import FramingCamera
from lunarsim.sensors.rendered_image import RenderedImage
from lunarsim.sensors.rendering import render_world
from lunarsim.simulation.worlds import build_world
from lunarsim.vehicle import State
from lunarsim.world import World

# Maximum altitude of the camera above the terrain, m.
_MAX_ALTITUDE_M = 1e6


def camera_pointing_state(
    camera: Camera, world: World, target: tuple[float, float], altitude: float,
    off_nadir: float, heading: float,
) -> State:  # fmt: skip
    """Return the state of a lander whose camera points at the terrain at `target`.

    Parameters
    ----------
    camera, world
        Camera on the lander, and world that the camera sees.
    target
        East and north coordinate of the image centre, m.
    altitude
        Height of the camera above the terrain at the target, m.
    off_nadir
        Angle of the boresight from nadir, rad.
    heading
        Azimuth of the top of the image, rad.

    Raises
    ------
    InputError
        If the elevation of the target is unknown, or an argument is out of range.
    """
    terrain_height = float(world.terrain.elevation(target))
    if not np.isfinite(terrain_height):
        raise InputError(
            "target.position_m", np.asarray(target).tolist(), "must be a point with known elevation"
        )
    if not 0.0 < altitude < _MAX_ALTITUDE_M:
        raise InputError("--altitude", altitude, f"must be above 0 and below {_MAX_ALTITUDE_M:g} m")
    if not np.isfinite(heading):
        raise InputError("--heading", float(np.rad2deg(heading)), "must be finite")
    if not 0.0 <= off_nadir < np.deg2rad(85.0):
        raise InputError(
            "--off-nadir", float(np.rad2deg(off_nadir)), "must be 0 or more and below 85 deg"
        )
    forward = np.array([np.sin(heading), np.cos(heading), 0.0])
    boresight = np.sin(off_nadir) * forward - np.array([0.0, 0.0, np.cos(off_nadir)])
    if off_nadir < 1e-6:
        right = np.array([forward[1], -forward[0], 0.0])
        axes = np.column_stack((right, -forward, boresight))
    else:
        axes = sensor_axes(boresight)
    position = np.array([*target, terrain_height]) - boresight * altitude / np.cos(off_nadir)
    attitude = matrix_to_quat(axes @ camera.mount.T)
    return State(position, np.zeros(3), attitude, np.zeros(3), 1.0)


def auto_exposure(camera: Camera, world: World, state: State) -> float:
    """Return the exposure time (s) at which 99.5 % of pixels stay below 0.9 full well.

    A gain above 1 reduces this level in proportion. `state` is the state of the lander that carries
    the camera. If the image is dark, the result is the exposure time of `camera`.
    """
    radiance = render_world(world, camera.view(state)).radiance
    bright = float(np.percentile(radiance, 99.5))
    if bright <= 0.0:
        return camera.exposure
    return 0.9 * camera.full_well / (camera.sensitivity * bright * max(camera.gain, 1.0))


def first_camera(scenario: Scenario) -> Camera:
    """Return the first camera of a scenario, or a default camera if it has none."""
    parts = [part.make() for part in scenario.sensors.values()]
    found = next((part for part in parts if isinstance(part, FramingCamera)), FramingCamera())
    return found.camera()


@dataclass(frozen=True)
class SceneImage:
    """Rendered camera image of a scenario's target area.

    Attributes
    ----------
    counts
        Detector counts (height, width), row 0 at the top.
    truth
        Radiance, range, normal and identity of every pixel; None unless requested.
    description
        Resolution, altitude, Sun, number of rocks, exposure and pixel size in one sentence.
    """

    counts: NDArray[np.unsignedinteger[Any]]
    truth: RenderedImage | None
    description: str

    def save(self, path: str | Path) -> Path:
        """Write the image as a PNG file and return its path.

        Raises
        ------
        InputError
            If `path` has another suffix or cannot be written.
        """
        check_output("path", Path(path), ".png")
        atomic_write(Path(path), self._write_png)
        return Path(path)

    def save_truth(self, path: Path) -> None:
        """Write radiance, range, normal and identity of every pixel to an NPZ file.

        The image must have been rendered with ``truth=True``.
        """
        atomic_write(path, self._write_truth)

    def _repr_png_(self) -> bytes:
        """Return the image as PNG data, which a notebook shows."""
        return cv2.imencode(".png", self.counts)[1].tobytes()

    def _write_png(self, path: Path) -> None:
        """Write the image to a PNG file."""
        path.write_bytes(self._repr_png_())

    def _write_truth(self, path: Path) -> None:
        """Write radiance, range, normal and identity to an NPZ file."""
        t = self.truth
        assert t is not None
        assert t.range is not None
        assert t.normal is not None
        assert t.identity is not None
        with path.open("wb") as file:
            np.savez_compressed(
                file, radiance=t.radiance, range=t.range, normal=t.normal, identity=t.identity
            )


def render(
    scenario: Scenario,
    *,
    altitude: float = 100.0,
    sun_elevation_deg: float | None = None,
    sun_azimuth_deg: float | None = None,
    off_nadir_deg: float = 0.0,
    heading_deg: float = 0.0,
    exposure: float | None = None,
    ideal: bool = False,
    truth: bool = False,
    seed: int = 1,
    flight: int = 0,
) -> SceneImage:
    """Render the target area of a scenario with the scenario's first camera.

    Parameters
    ----------
    scenario
        Terrain, Sun and camera; a scenario without a camera uses a standard one.
    altitude
        Height of the camera above the terrain at the target, m.
    sun_elevation_deg, sun_azimuth_deg
        Direction of the Sun (azimuth clockwise from north), deg; None: the scenario's.
    off_nadir_deg
        Angle of the boresight from nadir, deg; the target stays at the image centre.
    heading_deg
        Azimuth of the top of the image, deg.
    exposure
        Exposure time, s; None: automatic.
    ideal
        Whether to omit blur, noise and distortion; counts then have 16 bits.
    truth
        Whether to keep radiance, range, normal and identity of every pixel.
    seed, flight
        Root seed and index of the flight whose world is rendered.

    Raises
    ------
    InputError
        If a value cannot be used.
    RenderingError
        If OpenGL is missing; the message names the package to install.
    """
    changes = {"elevation_deg": sun_elevation_deg, "azimuth_deg": sun_azimuth_deg}
    given: Any = {name: value for name, value in changes.items() if value is not None}
    scenario = scenario.changed(sun=given)
    camera = first_camera(scenario)
    if ideal:
        camera = replace(
            camera, distortion=(0.0,) * 5, blur_sigma=0.0, motion_blur=False, shot_noise=False,
            read_noise=0.0, bits=16, vignetting=0.0, stray_light=0.0, hot_pixels=0.0,
            shutter="global",
        )  # fmt: skip
    streams = RandomStreams(flight_seed(seed, flight))
    world = build_world(scenario, streams)
    state = camera_pointing_state(
        camera, world, scenario.target.position_m, altitude,
        np.deg2rad(off_nadir_deg), np.deg2rad(heading_deg),
    )  # fmt: skip
    camera = replace(camera, exposure=exposure or auto_exposure(camera, world, state))
    photo = camera.expose(world, state, 0.0, streams.get("camera"), truth=truth)
    sun = scenario.sun
    description = (
        f"{camera.width} x {camera.height} pixels from {altitude:g} m; Sun elevation "
        f"{sun.elevation_deg:g} deg, azimuth {sun.azimuth_deg:g} deg; "
        f"{len(world.terrain.rocks)} rocks; exposure {1e3 * camera.exposure:.3g} ms; "
        f"{altitude / np.cos(np.deg2rad(off_nadir_deg)) / camera.fx:.3g} m per pixel"
    )
    return SceneImage(photo.counts, photo.truth, description)

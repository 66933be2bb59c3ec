"""Render a film of a recorded flight: chase view, hazard map and instruments."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path

import cv2
import numpy as np

from lunarsim.atomic_files import atomic_write
from lunarsim.errors import InputError, check_output
from lunarsim.models.lander import Lander
from lunarsim.scenario import Scenario
from lunarsim.simulation.flight import Flight
from lunarsim.simulation.worlds import rebuild_world
from lunarsim.view.chase_view import ChaseView, Moment
from lunarsim.view.colours import SITE, hazard_map_image, p_safe_colours
from lunarsim.view.drawing import BACKGROUND, Image, draw_gauges, draw_text
from lunarsim.view.moments import FlightMoments
from lunarsim.view.series import altitude_of, tilt_of
from lunarsim.view.video import write_gif, write_mp4
from lunarsim.world import World

# Size of the chase view, and width of the panel beside it, pixels.
WIDTH, HEIGHT, PANEL = 640, 480, 260
# Focal length of the chase camera, pixels.
_FOCAL = 620.0
# Frames per second by suffix; a GIF has half the size.
FRAME_RATES = {".mp4": 20.0, ".gif": 10.0}
# Share of the film that shows the end of the flight as a still image.
END_SHARE = 0.05
# Names of the phases in the trajectory.
_PHASES = ("approach", "vertical descent", "abort", "braking", "hover")


def film_suffix(field: str, path: Path) -> str:
    """Return the suffix of a film; raise InputError if films cannot have it."""
    suffix = path.suffix.lower()
    if suffix not in FRAME_RATES:
        raise InputError(field, str(path), "must be a file name that ends in .mp4 or .gif")
    return suffix


def frame_count(path: Path, seconds: float) -> int:
    """Return the number of frames of a film of this duration, s."""
    return max(round(seconds * FRAME_RATES[film_suffix("path", path)]), 2)


def frame_times(count: int, duration: float) -> np.ndarray:
    """Return the time in the flight of each frame (count,), s.

    Time runs evenly from 0 to the end of the flight at 95 % of the film, and then stands still.
    """
    last = max(round((1.0 - END_SHARE) * (count - 1)), 1)
    return np.minimum(np.arange(count) / last, 1.0) * duration


def save_film(
    flight: Flight,
    path: str | Path,
    *,
    seconds: float = 20.0,
    world: World | None = None,
    progress: Callable[[int], object] = lambda _: None,
) -> Path:
    """Write a film of a flight, and return its path.

    The same flight gives the same frames.

    Parameters
    ----------
    flight
        Record of the flight.
    path
        File to write, ``.mp4`` or ``.gif``; an error leaves no partial file.
    seconds
        Duration of the film, s. The flight is shown faster or slower to fit.
    world
        World of the flight; omitted: generated again from the flight's scenario and seed.
    progress
        Function that is called with 1 after each frame.

    Raises
    ------
    InputError
        If the file has another suffix or cannot be written, the duration is not between 1 and
        600 s, or the world cannot be generated again.
    RenderingError
        If OpenGL is missing.
    """
    path = Path(path)
    suffix = film_suffix("path", path)
    check_output("path", path, suffix)
    if not 1.0 <= seconds <= 600.0:
        raise InputError("seconds", seconds, "must be between 1 and 600 s")
    renderer = FilmRenderer(flight, rebuild_world(flight) if world is None else world)
    times = frame_times(frame_count(path, seconds), renderer.moments.duration)

    def frames() -> Iterator[Image]:
        for time in times:
            frame = renderer.frame(float(time))
            if suffix == ".gif":
                size = frame.shape[1] // 2, frame.shape[0] // 2
                frame = np.asarray(cv2.resize(frame, size, interpolation=cv2.INTER_AREA))
            yield frame
            progress(1)

    write = write_gif if suffix == ".gif" else write_mp4
    atomic_write(path, lambda part: write(frames(), part, FRAME_RATES[suffix]))
    return path


class FilmRenderer:
    """Frames of the film of one flight.

    Parameters
    ----------
    flight
        Record of the flight.
    world
        World of the flight.
    """

    def __init__(self, flight: Flight, world: World) -> None:
        self.flight, self.world = flight, world
        self.lander: Lander = Scenario.world_from_toml(flight.scenario).true_lander()
        self.moments = FlightMoments(flight)
        first = self.moments.at(0.0)
        self.chase = ChaseView(world, self.lander, first, (WIDTH, HEIGHT), _FOCAL)
        views = [self.chase.camera(self.moments.at(s * self.moments.duration))
                 for s in (0.0, 0.5, 1.0)]  # fmt: skip
        self.chase.set_exposure(views)
        record = flight.maps.get(flight.decision_mapper, next(iter(flight.maps.values()), None))
        self._map, self._map_start = record, 0.0
        if record is not None:
            self._map_start = 0.0 if flight.first_map is None else flight.first_map.time
            self._map_image = hazard_map_image(record.hazard_map)

    def frame(self, time: float) -> Image:
        """Return the RGB frame (480, 900, 3) at a time of the flight, s."""
        moment = self.moments.at(time)
        chase = self.chase.draw(moment)
        draw_text(chase, self._caption(time), (10, 22), 0.5)
        if time >= self.moments.duration:
            draw_text(chase, str(self.flight).splitlines()[0], (10, 46), 0.6)
        panel = np.vstack((self.map_panel(time), self.instruments(time, moment)))
        return np.hstack((chase, panel))

    def _caption(self, time: float) -> str:
        """Return time and phase of the flight in words."""
        phase = int(self.flight.trajectory["phase"][self.moments.row(time)])
        return f"t = {time:.1f} s, {_PHASES[phase]}"

    def map_panel(self, time: float) -> Image:
        """Return the image (260, 260, 3) of the hazard map with site and lander.

        A record has only the last map. It is shown, with its time, from the first update of any map
        on.
        """
        image = np.full((PANEL, PANEL, 3), BACKGROUND, np.uint8)
        if self._map is None or time < self._map_start:
            draw_text(image, "no hazard map", (8, PANEL - 10))
            return image
        grid = self._map.hazard_map.grid
        scale = PANEL / max(grid.rows, grid.cols)
        width, height = max(round(scale * grid.cols), 1), max(round(scale * grid.rows), 1)
        method = cv2.INTER_AREA if scale < 1.0 else cv2.INTER_NEAREST
        image[:height, :width] = cv2.resize(self._map_image, (width, height), interpolation=method)
        row = self.moments.row(time)
        west, _, _, north = grid.extent

        def pixel(point: np.ndarray) -> tuple[int, int]:
            at = np.array([point[0] - west, north - point[1]]) / grid.posting * scale
            x, y = np.clip(np.floor(at), -1e4, 1e4).astype(int)
            return int(x), int(y)

        radius = max(round(self.lander.leg_radius / grid.posting * scale), 3)
        for colour, line in ((BACKGROUND, 3), (SITE, 1)):
            cv2.circle(
                image, pixel(self.moments.local_sites[row]), radius, colour, line, cv2.LINE_AA
            )
        lander = self.moments.at(time).position + self.moments.local_errors[row]
        cv2.drawMarker(image, pixel(lander), (255, 255, 255), cv2.MARKER_CROSS, 11, 1, cv2.LINE_AA)
        last = "last map" if self._map.time is None else f"map of {self._map.time:.1f} s"
        draw_text(image, last, (8, PANEL - 10))
        _draw_colour_bar(image)
        return image

    def instruments(self, time: float, moment: Moment) -> Image:
        """Return the image (220, 260, 3) of instruments that show the true state."""
        lander, speed = self.lander, moment.velocity
        tilt = float(tilt_of(moment.attitude))
        left = moment.mass - lander.dry_mass
        height = float(altitude_of(self.world, moment.position, moment.site)) - lander.com_height
        away = float(np.hypot(*(moment.position - moment.site)[:2]))
        rows = [
            ("time", f"{time:.1f} s", time / max(self.moments.duration, 1e-9)),
            ("altitude", f"{height:.1f} m", None),
            ("distance to site", f"{away:.1f} m", None),
            ("descent rate", f"{-speed[2]:.1f} m/s", None),
            ("horizontal speed", f"{np.hypot(speed[0], speed[1]):.1f} m/s", None),
            ("tilt", f"{tilt:.1f} deg", tilt / 90.0),
            ("thrust", f"{moment.thrust:.0f} N", moment.thrust / lander.thrust_max),
            ("propellant", f"{left:.0f} kg", left / lander.propellant_mass),
        ]
        return draw_gauges(rows, PANEL, HEIGHT - PANEL, 140)


def _draw_colour_bar(image: Image) -> None:
    """Draw the colours of `p_safe` from 0 to 1 in the lower right corner of an image."""
    bar = np.tile(p_safe_colours(np.linspace(0.0, 1.0, 60)), (8, 1, 1))
    image[-18:-10, -76:-16] = bar
    draw_text(image, "p_safe", (PANEL - 132, PANEL - 10))
    draw_text(image, "1", (PANEL - 12, PANEL - 10))

"""Report of a landing site: what `lunarsim site info` prints and writes.

Errors name the options of the command.
"""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from lunarsim.atomic_files import atomic_write_text
from lunarsim.errors import InputError
from lunarsim.models.site import LandingSite, parse_time, time_text
from lunarsim.rng import RandomStreams, flight_seed
from lunarsim.scenario import Scenario
from lunarsim.simulation.worlds import build_world
from lunarsim.world.ephemeris import MOON_RADIUS_M
from lunarsim.world.horizon import Horizon, height_function, smooth_horizon, terrain_horizon
from lunarsim.world.illumination import Illumination, Window
from lunarsim.world.terrain import Heightfield

# Maximum number of intervals of one type that are printed.
_MAX_INTERVALS_PRINTED = 8


def scenario_place(scenario: Scenario) -> LandingSite:
    """Return the site of a scenario, which must have a date."""
    if scenario.site is None or scenario.site.time is None:
        raise InputError(
            "site.time", None, "is required by this command", "Add a table [site] with a time.",
            show_value=False,
        )  # fmt: skip
    found: LandingSite = scenario.site.make()
    return found


def given_place(at_deg: tuple[float, float], time: str) -> LandingSite:
    """Return the site of a latitude and longitude, deg, and of a date."""
    parse_time("--time", time)
    latitude, longitude = (float(angle) for angle in np.deg2rad(at_deg))
    try:
        return LandingSite(latitude, longitude, time)
    except InputError as error:
        raise error.with_field("--at") from None


class RasterOptions(NamedTuple):
    """Options of an elevation raster, as for `load_surroundings`."""

    path: Path
    posting: float | None
    pixel: tuple[float, float] | None
    nodata: tuple[float, ...]


def raster_horizon(
    raster: RasterOptions, place: LandingSite, height: float, max_range: float
) -> Horizon:
    """Return the horizon of a site from a raster.

    `height` is that of the observer above the terrain, m, and `max_range` that of the terrain, m.
    """
    from lunarsim.world.terrain.dtm import load_surroundings  # noqa: PLC0415  (loads rasterio)

    latitude, longitude = (float(v) for v in np.rad2deg([place.latitude, place.longitude]))
    try:
        field = load_surroundings(
            raster.path, latitude, longitude, max_range=max_range, posting=raster.posting,
            pixel=raster.pixel, nodata=raster.nodata or None,
        )  # fmt: skip
        return _horizon_at_origin(field, height, max_range)
    except InputError as error:
        names = {
            "terrain.dtm_posting_m": "--posting", "pixel": "--pixel", "horizon.position": "--dtm",
            "terrain.path": "--dtm",
        }  # fmt: skip
        remedy = error.remedy.replace("terrain.dtm_posting_m", "--posting")
        if "terrain.dtm_nodata" in remedy:
            remedy = "Give it with --nodata, or another value if these heights are real."
        name = names.get(error.field, error.field)
        raise InputError(name, error.value, error.problem, remedy, error.show_value) from None


def _horizon_at_origin(field: Heightfield, height: float, max_range: float) -> Horizon:
    return terrain_horizon(
        field, height=height, radius=MOON_RADIUS_M, posting=field.grid.posting, max_range=max_range
    )


def scenario_horizon(
    scenario: Scenario | None, height: float, max_range: float, seeds: tuple[int, int]
) -> Horizon:
    """Return the horizon at the target of a scenario; of a smooth sphere without one.

    Parameters
    ----------
    scenario
        Scenario with the terrain; None: a smooth sphere.
    height, max_range
        Height of the observer above the terrain and maximum distance of terrain, m.
    seeds
        Seed and flight of random terrain.
    """
    if scenario is None:
        return smooth_horizon(height, MOON_RADIUS_M)
    world = build_world(scenario, RandomStreams(flight_seed(*seeds)))
    relief, far = world.terrain.relief, world.far_terrain
    return terrain_horizon(
        height_function(relief) if far is None else far.elevation,
        scenario.target.position_m, height=height,
        radius=MOON_RADIUS_M if world.moon is None else world.moon.radius,
        posting=relief.grid.posting, max_range=max_range,
    )  # fmt: skip


@dataclass(frozen=True)
class SiteReport:
    """Sun, Earth, intervals and landing windows of a site.

    Attributes
    ----------
    place
        Site with a date.
    light
        Sun and Earth above the horizon of the site, from the date on.
    windows
        Landing windows; None: no range of Sun elevations was given.
    """

    place: LandingSite
    light: Illumination
    windows: list[Window] | None

    @classmethod
    def of(
        cls, place: LandingSite, horizon: Horizon, days: float, step_hours: float,
        sun_elevation_deg: tuple[float, float] | None,
    ) -> SiteReport:  # fmt: skip
        """Return the report of a site with a date.

        Parameters
        ----------
        place, horizon
            Site and its terrain horizon.
        days, step_hours
            Length of the period, days, and time between samples, h.
        sun_elevation_deg
            Range of elevations of the Sun for a landing, deg; None: no landing windows.
        """
        assert place.date is not None
        try:
            light = Illumination.over(
                place.latitude, place.longitude, horizon, place.date, days, step_hours
            )
        except InputError as error:
            raise error.with_field("--days") from None
        if sun_elevation_deg is None:
            return cls(place, light, None)
        low, high = (float(angle) for angle in np.deg2rad(sun_elevation_deg))
        return cls(place, light, light.landing_windows(low, high))

    @property
    def place_text(self) -> str:
        """Latitude and longitude in words."""
        latitude, longitude = np.rad2deg([self.place.latitude, self.place.longitude])
        return f"latitude {latitude:.4f} deg, longitude {longitude:.4f} deg east"

    def rows(self) -> Iterator[tuple[str, str]]:
        """Yield name and value of each row of the printed table."""
        light, sky, horizon = self.light, self.light.sky, self.light.horizon
        yield "site", f"{self.place_text} (MOON_ME)"
        known = "smooth sphere"
        if horizon.reach.any():
            near, far = 1e-3 * horizon.reach.min(), 1e-3 * horizon.reach.max()
            known = f"terrain known to {near:.1f} to {far:.1f} km"
        yield "horizon", f"{_range_text(horizon.elevation)}, {known}"
        yield "time", time_text(sky.time[0])
        for name, azimuth, elevation, edge, diameter in (
            ("Sun", sky.sun_azimuth, sky.sun_elevation, light.sun_horizon, sky.sun_diameter),
            ("Earth", sky.earth_azimuth, sky.earth_elevation, light.earth_horizon,
             sky.earth_diameter),
        ):  # fmt: skip
            az, el, low, wide = np.rad2deg([azimuth[0], elevation[0], edge[0], diameter[0]])
            yield (
                name,
                (
                    f"azimuth {az:.2f} deg, elevation {el:.2f} deg, horizon there {low:.2f} deg, "
                    f"diameter {wide:.3f} deg"
                ),
            )
        lit = 100.0 * sky.earth_phase[0]
        yield "earthshine", f"{sky.earthshine[0]:.3g} of sunlight, {lit:.1f} % of the Earth lit"
        yield "period", f"{time_text(sky.time[0])} to {time_text(sky.time[-1])}"
        yield "Sun elevation", _range_text(sky.sun_elevation)
        yield "Earth elevation", _range_text(sky.earth_elevation)
        for name, hours in (
            ("sunlight", light.illuminated_hours), ("Earth in view", light.earth_hours),
        ):  # fmt: skip
            share = 100.0 * hours / light.hours
            yield name, f"{hours:.1f} h of {light.hours:.1f} h ({share:.1f} %)"

    def interval_lines(self) -> Iterator[str]:
        """Yield lines with the intervals of sunlight, Earth in view, and landing."""
        named = [
            ("sunrise to sunset", self.light.sunlit()),
            ("Earth in view", self.light.earth_in_view()),
        ]
        if self.windows is not None:
            named.append(("landing window", self.windows))
        for name, intervals in named:
            if not intervals:
                yield f"{name}: none"
            for one in intervals[:_MAX_INTERVALS_PRINTED]:
                start = "before " * one.starts_before + time_text(one.start)
                end = "after " * one.ends_after + time_text(one.end)
                lit = f", Sun {100 * one.sun_visible:.0f} % visible"
                yield (
                    f"{name}: {start} to {end}, {one.hours:.1f} h"
                    + lit * (intervals is self.windows)
                )
            if len(intervals) > _MAX_INTERVALS_PRINTED:
                yield f"{name}: {len(intervals) - _MAX_INTERVALS_PRINTED} more; --json lists all"

    def write_csv(self, path: Path) -> None:
        """Write all samples to a CSV file."""
        light, sky = self.light, self.light.sky
        angles = {
            "sun_azimuth_deg": sky.sun_azimuth, "sun_elevation_deg": sky.sun_elevation,
            "sun_horizon_deg": light.sun_horizon, "earth_azimuth_deg": sky.earth_azimuth,
            "earth_elevation_deg": sky.earth_elevation, "earth_horizon_deg": light.earth_horizon,
        }  # fmt: skip
        shares = {
            "sun_visible": light.sun_visible, "earth_phase": sky.earth_phase,
            "earthshine": sky.earthshine,
        }  # fmt: skip
        lines = [",".join(["time_utc", *angles, *shares])]
        for k, time in enumerate(sky.time):
            cells = [f"{np.rad2deg(values[k]):.4f}" for values in angles.values()]
            cells += [f"{values[k]:.6g}" for values in shares.values()]
            lines.append(",".join([time_text(time), *cells]))
        atomic_write_text(path, "\n".join(lines) + "\n")

    def write_json(self, path: Path) -> None:
        """Write directions at the date, hours, intervals and windows to a JSON file."""
        light, sky = self.light, self.light.sky
        directions = {
            f"{name}_deg": float(np.rad2deg(getattr(sky, name)[0]))
            for name in (
                "sun_azimuth", "sun_elevation", "sun_diameter", "earth_azimuth", "earth_elevation",
                "earth_diameter",
            )
        }  # fmt: skip
        results = {
            "latitude_deg": float(np.rad2deg(self.place.latitude)),
            "longitude_deg": float(np.rad2deg(self.place.longitude)),
            "time": time_text(sky.time[0]), **directions,
            "earth_phase": float(sky.earth_phase[0]), "earthshine": float(sky.earthshine[0]),
            "period_hours": light.hours, "illuminated_hours": light.illuminated_hours,
            "earth_hours": light.earth_hours, "sunlit": _listed(light.sunlit()),
            "earth_in_view": _listed(light.earth_in_view()),
            "landing_windows": None if self.windows is None else _listed(self.windows),
        }  # fmt: skip
        atomic_write_text(path, json.dumps(results, indent=1, allow_nan=False) + "\n")


def _range_text(angles: Any) -> str:
    """Return minimum and maximum of angles, rad, as text in deg."""
    low, high = np.rad2deg([angles.min(), angles.max()])
    return f"{low:.2f} to {high:.2f} deg"


def _listed(intervals: list[Window]) -> list[dict[str, Any]]:
    """Return intervals as tables for JSON."""
    return [
        {
            "start": time_text(one.start), "end": time_text(one.end), "hours": one.hours,
            "starts_before": one.starts_before, "ends_after": one.ends_after,
            "sun_visible": one.sun_visible,
        }
        for one in intervals
    ]  # fmt: skip

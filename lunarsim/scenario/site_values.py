"""Complete the tables of a scenario with the values that follow from [site].

With a date, Sun and Earth have the directions of the ephemeris; with [moon], its latitude is that
of the site.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import replace
from functools import lru_cache
from typing import Any

import numpy as np

from lunarsim.errors import InputError
from lunarsim.models.site import LandingSite

# Keys of [sun] that must not contradict the date, as opposed to the earthshine, which may be off.
DIRECTIONS = ("azimuth_deg", "elevation_deg", "earth_azimuth_deg", "earth_elevation_deg")
# Values that agree to this angle, deg, are equal: a record may come from another ephemeris.
_TOLERANCE_DEG = 0.01


@lru_cache(maxsize=256)
def sun_values(site: LandingSite) -> Mapping[str, float]:
    """Return the values of keys of [sun] that follow from site and date.

    Without a date there are none.
    """
    from lunarsim.world.ephemeris import sky_at  # noqa: PLC0415  (after all scenario modules)

    if site.date is None:
        return {}
    sky = sky_at(site.latitude, site.longitude, np.array([site.date]))
    angles = sky.sun_azimuth, sky.sun_elevation, sky.earth_azimuth, sky.earth_elevation
    values = {
        key: round(float(np.rad2deg(angle[0])), 6)
        for key, angle in zip(DIRECTIONS, angles, strict=True)
    }
    return values | {"earthshine": round(float(sky.earthshine[0]), 9)}


def with_site_values(data: Mapping[str, Any], site: LandingSite) -> dict[str, Any]:
    """Return the tables of a scenario, completed with what follows from its site.

    Raises
    ------
    InputError
        If a direction of Sun or Earth, or the latitude of [moon], contradicts the site.
    """
    out = dict(data)
    for table, key, value in _site_values(data, site):
        given = out.get(table, {})
        if not isinstance(given, Mapping):
            continue  # refused by the check of the table
        if key not in given:
            out[table] = {**given, key: value}
        elif key != "earthshine" and not _agrees(key, given[key], value):
            cause = "site.latitude_deg" if table == "moon" else "site.time"
            either = "" if table == "moon" else f", or delete {cause}"
            raise InputError(
                f"{table}.{key}", given[key],
                f"must be omitted, because {cause} gives {value:.6g} deg", f"Delete it{either}.",
            )  # fmt: skip
    return out


def without_site_values(
    data: Mapping[str, Any], site: LandingSite | None, changes: Mapping[str, Any]
) -> dict[str, Any]:
    """Return the tables of a scenario without what follows from its site.

    After a change, the values are found again for the changed site. A change of the date replaces
    the directions of Sun and Earth, and a change of one of these directions removes the date: the
    other directions then stay as they are.

    Parameters
    ----------
    data
        All tables of the scenario.
    site
        Site of the scenario; None: it has none.
    changes
        Changes by table.
    """
    out = dict(data)
    sun, new_site = (_as_table(changes.get(name)) for name in ("sun", "site"))
    removed = []
    if new_site.get("time") is not None:
        removed += [("sun", key) for key in DIRECTIONS]
        if (site is None or site.time is None) and data["sun"]["earthshine"] == 0.0:
            removed.append(("sun", "earthshine"))
    elif site is not None and any(key in sun for key in DIRECTIONS):
        out["site"] = {key: value for key, value in data["site"].items() if key != "time"}
        site = replace(site, time=None)
    if "latitude_deg" in new_site and "moon" in data:
        removed.append(("moon", "latitude_deg"))
    if site is not None:
        removed += [
            (table, key)
            for table, key, value in _site_values(data, site)
            if _agrees(key, data[table][key], value)
        ]
    for table, key in removed:
        out[table] = {name: value for name, value in out[table].items() if name != key}
    return out


def _as_table(change: Any) -> Mapping[str, Any]:
    """Return the change of a table; a table without keys if the change is no table."""
    return change if isinstance(change, Mapping) else {}


def _site_values(data: Mapping[str, Any], site: LandingSite) -> Iterator[tuple[str, str, float]]:
    """Yield table, key and value of what follows from the site of a scenario."""
    for key, value in sun_values(site).items():
        yield "sun", key, value
    if "moon" in data:
        yield "moon", "latitude_deg", round(float(np.rad2deg(site.latitude)), 9)


def _agrees(key: str, given: Any, value: float) -> bool:
    """Return whether the given value of a key is that of the site, or no number."""
    if isinstance(given, bool) or not isinstance(given, int | float):
        return True  # refused by the check of the table
    if key == "earthshine":
        return bool(abs(given - value) <= 1e-9)
    return bool(abs((given - value + 180.0) % 360.0 - 180.0) <= _TOLERANCE_DEG)

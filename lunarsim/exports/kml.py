"""Path and sites of a flight as KML, for Google Earth and other programs."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from xml.etree import ElementTree as ET

import numpy as np

from lunarsim.atomic_files import atomic_write_text
from lunarsim.errors import InputError
from lunarsim.exports.ccsds import object_name
from lunarsim.exports.formats import ExportOptions
from lunarsim.exports.frames_and_times import ExportFrame, moon_frame
from lunarsim.exports.states import states_of
from lunarsim.simulation import Flight
from lunarsim.typing import Array
from lunarsim.world.ephemeris import MOON_RADIUS_M


def write_kml(flight: Flight, out: Path, options: ExportOptions) -> None:
    """Write path, start, target, chosen sites and touchdown of a flight as KML.

    Coordinates are planetocentric longitude and latitude, deg, in the frame MOON_ME, and the
    altitude above a sphere of 1,737,400 m.

    Raises
    ------
    InputError
        If the scenario has no coordinates of the site, or the state is unknown.
    """
    frame = moon_frame(flight, options.longitude)
    if frame is None or frame.moon is None:
        raise InputError(
            "--format", "kml", "needs the place of the site, but the scenario has no table [site]",
            "Fly with site.latitude_deg and site.longitude_deg.", show_value=False,
        )  # fmt: skip
    path = states_of(flight, options.state).position
    # Google Earth shows the Moon instead of the Earth with this hint.
    root = ET.Element("kml", xmlns="http://www.opengis.net/kml/2.2", hint="target=moon")
    document = ET.SubElement(root, "Document")
    ET.SubElement(document, "name").text = object_name(flight)
    ET.SubElement(document, "description").text = _description(frame, options.state)
    _add_place(document, "path", "LineString", geographic(frame, path))
    for name, position in _points(flight, path):
        _add_place(document, name, "Point", geographic(frame, position[None]))
    ET.indent(root)
    text = ET.tostring(root, encoding="unicode")
    atomic_write_text(out, f'<?xml version="1.0" encoding="UTF-8"?>\n{text}\n')


def _description(frame: ExportFrame, state: str) -> str:
    """Return sentences on body, coordinates and state."""
    kind = "True path" if state == "true" else "Path estimated by navigation"
    return (
        f"The body is the Moon, not the Earth: select the Moon in Google Earth. {kind} of a "
        "simulated lander, centre of mass. Planetocentric longitude and latitude (deg, MOON_ME), "
        f"altitude (m) above a sphere of {MOON_RADIUS_M:.0f} m. {frame.comments[1]}"
    )


def _points(flight: Flight, path: Array) -> Iterator[tuple[str, Array]]:
    """Yield name and position (3,), site frame, of each point of a flight."""
    yield "start", path[0]
    yield "planned target", flight.target
    for decision in flight.decisions:
        # The error of the map belongs to all sites that were chosen on it.
        yield f"site chosen at {decision['time']:.1f} s", decision["to"] - flight.map_error
    if flight.outcome.touchdown is not None:
        yield "touchdown", flight.outcome.touchdown.position


def _add_place(document: ET.Element, name: str, kind: str, coordinates: Array) -> None:
    """Add a placemark; coordinates (n, 3) are longitude, latitude (deg), altitude (m)."""
    mark = ET.SubElement(document, "Placemark")
    ET.SubElement(mark, "name").text = name
    shape = ET.SubElement(mark, kind)
    ET.SubElement(shape, "altitudeMode").text = "absolute"
    ET.SubElement(shape, "coordinates").text = " ".join(
        f"{longitude:.10f},{latitude:.10f},{altitude:.4f}"
        for longitude, latitude, altitude in coordinates
    )


def geographic(frame: ExportFrame, positions: Array) -> Array:
    """Convert positions (n, 3), m, of the site frame.

    The result has longitude from -180 to 180 and latitude, deg, and altitude, m (n, 3).
    """
    x, y, z = frame.positions(positions).T
    across = np.hypot(x, y)
    angles = np.rad2deg([np.arctan2(y, x), np.arctan2(z, across)])
    return np.column_stack((*angles, np.hypot(across, z) - MOON_RADIUS_M))

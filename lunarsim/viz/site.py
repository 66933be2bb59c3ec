"""Draw Sun and Earth above the terrain horizon of a site over a period."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.dates import AutoDateLocator, ConciseDateFormatter
from matplotlib.figure import Figure

from lunarsim.typing import Array
from lunarsim.viz.style import COLOURS, escape_dollars, new_figure, save
from lunarsim.world.illumination import Illumination, Window

_SUN, _EARTH, _TERRAIN, _WINDOW = COLOURS[4], COLOURS[0], "#666666", COLOURS[2]


def draw_site(
    found: Illumination, windows: Sequence[Window], title: str, path: Path | None = None
) -> Figure:
    """Draw elevations over time, and the horizon over azimuth.

    Parameters
    ----------
    found
        Sun and Earth above the horizon of the site.
    windows
        Landing windows, which are shaded.
    title
        Title of the figure.
    path
        PNG file to write; None: none.
    """
    figure = new_figure(10.0, 8.0)
    sun, earth, around = figure.subplots(3, 1)
    sky = found.sky
    _draw_elevation(sun, found, sky.sun_elevation, found.sun_horizon, ("Sun", _SUN))
    _draw_elevation(earth, found, sky.earth_elevation, found.earth_horizon, ("Earth", _EARTH))
    for axes in (sun, earth):
        for k, one in enumerate(windows):
            label = "landing window" if k == 0 else None
            axes.axvspan(one.start, one.end, color=_WINDOW, alpha=0.25, lw=0, label=label)
        _put_legend_above(axes)
    earth.set_xlabel("Time (UTC)")
    _draw_horizon(around, found)
    figure.suptitle(escape_dollars(title))
    if path is not None:
        save(figure, path)
    return figure


def _draw_elevation(
    axes: Any, found: Illumination, elevation: Array, edge: Array, name: tuple[str, str]
) -> None:
    """Draw the elevation of the Sun or the Earth, and that of the horizon, over time.

    `name` is the name of the body and its colour.
    """
    time = found.sky.time
    axes.plot(time, np.rad2deg(elevation), color=name[1], label=name[0])
    axes.plot(time, np.rad2deg(edge), color=_TERRAIN, lw=0.8, label="terrain at its azimuth")
    above = elevation > edge
    axes.fill_between(
        time, np.rad2deg(edge), np.rad2deg(elevation), where=above, color=name[1], alpha=0.2
    )
    axes.set_ylabel(f"{name[0]} elevation (deg)")
    axes.set_xlim(time[0], time[-1])
    locator = AutoDateLocator()
    axes.xaxis.set_major_locator(locator)
    axes.xaxis.set_major_formatter(ConciseDateFormatter(locator))


def _draw_horizon(axes: Any, found: Illumination) -> None:
    """Draw the terrain horizon over azimuth, with the places of Sun and Earth."""
    sky, horizon = found.sky, found.horizon
    azimuth = np.rad2deg(np.append(horizon.azimuth, 2.0 * np.pi))
    edge = np.rad2deg(np.append(horizon.elevation, horizon.elevation[0]))
    low, high = edge.min() - 1.0, edge.max() + 2.0
    axes.fill_between(azimuth, low, edge, color=_TERRAIN, alpha=0.5, label="terrain")
    for name, colour, az, el in (
        ("Sun", _SUN, sky.sun_azimuth, sky.sun_elevation),
        ("Earth", _EARTH, sky.earth_azimuth, sky.earth_elevation),
    ):
        axes.plot(np.rad2deg(az), np.rad2deg(el), ".", ms=3, color=colour, label=name)
    axes.set_xlim(0.0, 360.0)
    axes.set_ylim(low, high)
    axes.set_xticks(np.arange(0, 361, 45))
    axes.set_xlabel("Azimuth, clockwise from north (deg)")
    axes.set_ylabel("Elevation (deg)")
    _put_legend_above(axes)


def _put_legend_above(axes: Any) -> None:
    axes.legend(loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=3, frameon=False)

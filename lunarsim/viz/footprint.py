"""The figure of a touchdown: the ground under the lander, and what of it broke a limit."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from matplotlib.patches import Circle, Polygon
from matplotlib.path import Path as Outline
from numpy.typing import NDArray

from lunarsim.grid import Grid
from lunarsim.models.lander import Lander
from lunarsim.scenario import Scenario
from lunarsim.simulation.flight import Flight
from lunarsim.vehicle.touchdown import Touchdown
from lunarsim.viz.style import COLOURS, end_of, hillshade, map_axes, new_figure, save, show
from lunarsim.world import World

Array = NDArray[np.float64]

# Side of a cell, m, and how far the ground is shown, in radii of the legs.
_POSTING = 0.04
_REACH = 2.2
_BROKEN = COLOURS[1]


def draw_footprint(flight: Flight, world: World, path: Path | None = None) -> Figure:
    """Draw the ground at touchdown as it lies above the pads, and the figures against the limits.

    The plane is the one of the two that three pads can stand on through which ground reaches
    farthest, as the verdict's roughness counts it.

    Parameters
    ----------
    flight, world
        The record, with a touchdown, and the world that it was flown in.
    path
        PNG file to write.
    """
    touchdown = flight.verdict.touchdown
    assert touchdown is not None
    lander = Scenario.world_of(flight.scenario).vehicle.make()
    middle = touchdown.position[:2]
    grid = Grid.centred(middle, 2.0 * _REACH * lander.leg_radius, _POSTING)
    ground = world.terrain.raster(grid).astype(np.float64)
    pads = _pads(lander, touchdown)
    heights = _under(grid, ground, pads, 0.5 * lander.pad_diameter)
    above = _above(grid, ground, heights, pads)

    figure = new_figure(11, 5.6)
    left, right = figure.subplots(1, 2, width_ratios=[1.25, 1.0])
    show(left, hillshade(ground, _POSTING), grid, cmap="gray", vmin=0.2, vmax=1.0)
    most = 2.0 * lander.belly_clearance
    drawn = show(left, above, grid, cmap="PuOr_r", vmin=-most, vmax=most, alpha=0.7)
    figure.colorbar(drawn, ax=left, label="ground above the worst plane of three pads (m)",
                    location="bottom", shrink=0.8, aspect=30)  # fmt: skip
    left.add_patch(Polygon(pads, fill=False, ec="black", lw=1.4))
    for pad in pads:
        left.add_patch(Circle(pad, 0.5 * lander.pad_diameter, fc="white", ec="black", lw=1.2))
    touches = _touching(left, grid, above, pads, lander.belly_clearance)
    left.plot(*middle, "+", color="black", ms=9)
    told = "; red: it touches the belly" if touches else ""
    map_axes(left, f"ground under the lander, true frame{told}")
    _limits(right, touchdown, lander)
    figure.suptitle(end_of(flight))
    if path is not None:
        save(figure, path)
    return figure


def _pads(lander: Lander, touchdown: Touchdown) -> Array:
    """Return the pads' centres over the ground (legs, 2), east and north, m."""
    ahead, left = lander.pads[:, 0], lander.pads[:, 1]
    c, s = np.cos(touchdown.heading), np.sin(touchdown.heading)
    return np.asarray(
        touchdown.position[:2] + np.column_stack((ahead * s - left * c, ahead * c + left * s))
    )


def _under(grid: Grid, ground: Array, pads: Array, radius: float) -> Array:
    """Return the highest ground under each pad (legs,), m."""
    x, y = np.meshgrid(grid.x, grid.y)
    found = [ground[np.hypot(x - px, y - py) <= radius + 0.5 * _POSTING] for px, py in pads]
    return np.array([np.nanmax(heights, initial=np.nanmin(ground)) for heights in found])


def _above(grid: Grid, ground: Array, heights: Array, pads: Array) -> Array:
    """Return ground above the worst plane that three pads can stand on (rows, cols), m.

    Of four legs those planes share the diagonal whose pads stand higher; the worst is the one that
    ground inside the legs' polygon reaches farthest through.
    """
    x, y = np.meshgrid(grid.x, grid.y)
    inside = _inside(grid, pads)
    found = []
    for three in _stances(heights):
        sides = np.column_stack((pads[three], np.ones(3)))
        a, b, c = np.linalg.solve(sides, heights[three])
        found.append(ground - (a * x + b * y + c))
    highest = [np.nanmax(above[inside], initial=-np.inf) for above in found]
    return np.asarray(found[int(np.argmax(highest))])


def _stances(heights: Array) -> list[list[int]]:
    """Return the pads of each plane that the lander can stand on."""
    if len(heights) == 3:
        return [[0, 1, 2]]
    first = heights[0] + heights[2] >= heights[1] + heights[3]
    a, b, others = (0, 2, (1, 3)) if first else (1, 3, (0, 2))
    return [[a, b, other] for other in others]


def _inside(grid: Grid, pads: Array) -> Any:
    """Tell which cells (rows, cols) lie in the legs' polygon."""
    x, y = np.meshgrid(grid.x, grid.y)
    cells = np.column_stack((x.ravel(), y.ravel()))
    return Outline(pads).contains_points(cells).reshape(grid.shape)


def _touching(axes: Any, grid: Grid, above: Array, pads: Array, clearance: float) -> bool:
    """Mark ground within the legs' polygon that is higher than the belly; tell if there is any."""
    high = _inside(grid, pads) & (above > clearance)
    if high.any():
        axes.contourf(grid.x, grid.y, high.astype(float), levels=[0.5, 1.5], colors="#C00000")
    return bool(high.any())


def _limits(axes: Any, touchdown: Touchdown, lander: Lander) -> None:
    """Draw each figure as a share of its limit, with both in words."""
    rows = [
        ("slope", np.rad2deg(touchdown.slope), np.rad2deg(lander.slope_limit), "deg"),
        ("roughness", touchdown.roughness, lander.roughness_limit, "m"),
        ("belly", touchdown.roughness, lander.belly_clearance, "m, clearance"),
        ("speed down", touchdown.vertical_speed, lander.vertical_speed_limit, "m/s"),
        ("speed aside", touchdown.horizontal_speed, lander.horizontal_speed_limit, "m/s"),
        ("tilt", np.rad2deg(touchdown.tilt), np.rad2deg(lander.tilt_limit), "deg"),
        ("rate", np.rad2deg(touchdown.rate), np.rad2deg(lander.rate_limit), "deg/s"),
        ("tipping", 1.0 - touchdown.tip_margin, 1.0, "of the energy that tips it"),
    ]
    share = np.array([value / limit for _, value, limit, _ in rows])
    colours = [_BROKEN if s > 1.0 else COLOURS[0] for s in share]
    place = np.arange(len(rows))
    axes.barh(place, np.clip(share, 0.0, 2.0), height=0.45, color=colours)
    for i, (_, value, limit, unit) in enumerate(rows):
        axes.text(0.03, i - 0.25, f"{value:.3g} of {limit:.3g} {unit}", va="bottom", fontsize=7)
    axes.axvline(1.0, color="black", lw=1.2, label="limit")
    axes.set_yticks(place, [name for name, *_ in rows])
    axes.set_ylim(len(rows) - 0.5, -0.7)
    axes.set_xlim(0.0, 2.0)
    axes.set_xlabel("share of the limit (cut at 2)")
    axes.legend(loc="lower right")

"""Draw the figure of a touchdown: terrain under the lander, and limit violations."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from matplotlib.patches import Circle, Polygon
from matplotlib.path import Path as Outline

from lunarsim.core.touchdown import LIMITS, TouchdownLimit
from lunarsim.grid import Grid
from lunarsim.models.lander import Lander
from lunarsim.parts.quantity import quantity_of
from lunarsim.scenario import Scenario
from lunarsim.simulation.flight import Flight
from lunarsim.typing import Array
from lunarsim.vehicle.touchdown import Touchdown
from lunarsim.viz.style import COLOURS, flight_title, hillshade, map_axes, new_figure, save, show
from lunarsim.world import World

# Cell size, m, and half side of the figure in radii of the legs.
_POSTING = 0.04
_HALF_SIDE_IN_LEG_RADII = 2.2
_VIOLATION_COLOUR = COLOURS[1]


def draw_footprint(flight: Flight, world: World, path: Path | None = None) -> Figure:
    """Draw terrain at touchdown relative to the pads, and metrics over their limits.

    Heights refer to a plane through three pads that the lander can stand on. Of the two candidate
    planes, the one with the highest terrain above it is used, as for the touchdown roughness. The
    figure is returned.

    Parameters
    ----------
    flight, world
        Record with a touchdown, and the world of the flight.
    path
        PNG file to write; None: no file.
    """
    touchdown = flight.outcome.touchdown
    assert touchdown is not None
    lander = Scenario.world_from_toml(flight.scenario).true_lander()
    middle = touchdown.position[:2]
    grid = Grid.centred(middle, 2.0 * _HALF_SIDE_IN_LEG_RADII * lander.leg_radius, _POSTING)
    elevation = world.terrain.raster(grid).astype(np.float64)
    pads = _pads(lander, touchdown)
    heights = _pad_elevations(grid, elevation, pads, 0.5 * lander.pad_diameter)
    above = _height_above_pads(grid, elevation, heights, pads)

    figure = new_figure(11, 5.6)
    left, right = figure.subplots(1, 2, width_ratios=[1.25, 1.0])
    show(left, hillshade(elevation, _POSTING), grid, cmap="gray", vmin=0.2, vmax=1.0)
    most = 2.0 * lander.belly_clearance
    drawn = show(left, above, grid, cmap="PuOr_r", vmin=-most, vmax=most, alpha=0.7)
    figure.colorbar(drawn, ax=left, label="Terrain above the worst three-pad plane (m)",
                    location="bottom", shrink=0.8, aspect=30)  # fmt: skip
    left.add_patch(Polygon(pads, fill=False, ec="black", lw=1.4))
    for pad in pads:
        left.add_patch(Circle(pad, 0.5 * lander.pad_diameter, fc="white", ec="black", lw=1.2))
    touches = _mark_belly_contact(left, grid, above, pads, lander.belly_clearance)
    left.plot(*middle, "+", color="black", ms=9)
    remark = "; red: touches the belly" if touches else ""
    map_axes(left, f"Terrain under the lander, true frame{remark}")
    _draw_limits(right, touchdown, lander)
    figure.suptitle(flight_title(flight))
    if path is not None:
        save(figure, path)
    return figure


def _pads(lander: Lander, touchdown: Touchdown) -> Array:
    """Return the pad centres of a lander at touchdown (legs, 2), east and north, m."""
    ahead, left = lander.pads[:, 0], lander.pads[:, 1]
    c, s = np.cos(touchdown.heading), np.sin(touchdown.heading)
    return np.asarray(
        touchdown.position[:2] + np.column_stack((ahead * s - left * c, ahead * c + left * s))
    )


def _pad_elevations(grid: Grid, elevation: Array, pads: Array, radius: float) -> Array:
    """Return the maximum terrain elevation under each pad (legs,), m.

    `pads` (legs, 2) are the centres of the pads, `radius` is their radius, m.
    """
    x, y = np.meshgrid(grid.x, grid.y)
    found = [elevation[np.hypot(x - px, y - py) <= radius + 0.5 * _POSTING] for px, py in pads]
    return np.array([np.nanmax(heights, initial=np.nanmin(elevation)) for heights in found])


def _height_above_pads(grid: Grid, elevation: Array, heights: Array, pads: Array) -> Array:
    """Return terrain above the worst plane through three pads (rows, cols), m.

    `heights` (legs,) are the terrain heights under the pads, `pads` (legs, 2) their centres. With
    four legs, both candidate planes contain the diagonal with the higher pads. The worst plane is
    the one with the highest terrain above it within the polygon of the legs.
    """
    x, y = np.meshgrid(grid.x, grid.y)
    inside = _cells_between_pads(grid, pads)
    found = []
    for three in _support_triangles(heights):
        sides = np.column_stack((pads[three], np.ones(3)))
        a, b, c = np.linalg.solve(sides, heights[three])
        found.append(elevation - (a * x + b * y + c))
    highest = [np.nanmax(above[inside], initial=-np.inf) for above in found]
    return np.asarray(found[int(np.argmax(highest))])


def _support_triangles(heights: Array) -> list[list[int]]:
    """Return the indices of three pads for each plane that the lander can stand on.

    `heights` (legs,) are the terrain heights under the pads, m.
    """
    if len(heights) == 3:
        return [[0, 1, 2]]
    first = heights[0] + heights[2] >= heights[1] + heights[3]
    a, b, others = (0, 2, (1, 3)) if first else (1, 3, (0, 2))
    return [[a, b, other] for other in others]


def _cells_between_pads(grid: Grid, pads: Array) -> Any:
    """Return which cells (rows, cols) lie in the polygon of the pads (legs, 2)."""
    x, y = np.meshgrid(grid.x, grid.y)
    cells = np.column_stack((x.ravel(), y.ravel()))
    return Outline(pads).contains_points(cells).reshape(grid.shape)


def _mark_belly_contact(axes: Any, grid: Grid, above: Array, pads: Array, clearance: float) -> bool:
    """Mark terrain between the legs that touches the belly; return if there is any.

    `above` (rows, cols) is the terrain above the plane of the pads, `clearance` the belly's height,
    m.
    """
    high = _cells_between_pads(grid, pads) & (above > clearance)
    if high.any():
        axes.contourf(grid.x, grid.y, high.astype(float), levels=[0.5, 1.5], colors="#C00000")
    return bool(high.any())


def _limit_row(
    limit: TouchdownLimit, touchdown: Touchdown, lander: Lander
) -> tuple[str, float, float, str]:
    """Return label, value and maximum of a limit in the unit of its key, and the unit."""
    about = quantity_of(type(lander).__dataclass_fields__[limit.limit].metadata)
    assert about is not None
    unit = about.unit
    scale = np.rad2deg(1.0) if unit.startswith("deg") else 1.0
    value, maximum = getattr(touchdown, limit.value), getattr(lander, limit.limit)
    return limit.label, scale * value, scale * maximum, unit


def _draw_limits(axes: Any, touchdown: Touchdown, lander: Lander) -> None:
    """Draw each touchdown metric as a fraction of its limit, with both values as text."""
    rows = [_limit_row(limit, touchdown, lander) for limit in LIMITS]
    rows.append(("Tipping energy", 1.0 - touchdown.tip_margin, 1.0, "(normalised)"))
    share = np.array([value / limit for _, value, limit, _ in rows])
    colours = [_VIOLATION_COLOUR if s > 1.0 else COLOURS[0] for s in share]
    place = np.arange(len(rows))
    axes.barh(place, np.clip(share, 0.0, 2.0), height=0.45, color=colours)
    for i, (_, value, limit, unit) in enumerate(rows):
        axes.text(0.03, i - 0.25, f"{value:.3g} of {limit:.3g} {unit}", va="bottom", fontsize=7)
    axes.axvline(1.0, color="black", lw=1.2, label="limit")
    axes.set_yticks(place, [name for name, *_ in rows])
    axes.set_ylim(len(rows) - 0.5, -0.7)
    axes.set_xlim(0.0, 2.0)
    axes.set_xlabel("Value / limit (clipped at 2)")
    axes.legend(loc="lower right")

"""Draw the figures of one flight: descent, maps and touchdown."""

from __future__ import annotations

from pathlib import Path

from lunarsim.models.lander import Lander
from lunarsim.simulation.flight import Flight
from lunarsim.viz.descent import draw_descent
from lunarsim.viz.footprint import draw_footprint
from lunarsim.viz.maps import draw_maps
from lunarsim.viz.window import map_figure_bounds
from lunarsim.world import World
from lunarsim.world.truth import Truth


def truth_shown(flight: Flight, world: World, lander: Lander) -> Truth:
    """Return the exact safety of the part of the world that ``maps.png`` shows."""
    return Truth.of(world, lander, bounds=map_figure_bounds(flight, world))


def draw_flight(flight: Flight, world: World, truth: Truth, folder: str | Path) -> None:
    """Write ``descent.png``, ``maps.png`` and ``touchdown.png`` of a flight into `folder`.

    A flight without a touchdown has no ``touchdown.png``.

    Parameters
    ----------
    flight
        Record of the flight.
    world
        World of the flight, for instance from `lunarsim.evaluation.worlds.world_of`.
    truth
        Exact safety of the world, or of the part that `truth_shown` returns.
    folder
        Folder of the figures.
    """
    draw_descent(flight, Path(folder) / "descent.png")
    draw_maps(flight, world, truth, Path(folder) / "maps.png")
    if flight.verdict.touchdown is not None:
        draw_footprint(flight, world, Path(folder) / "touchdown.png")

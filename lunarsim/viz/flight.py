"""Figures of one flight: the descent, the maps it was decided on, and where it came down."""

from __future__ import annotations

from pathlib import Path

from lunarsim.simulation.flight import Flight
from lunarsim.viz.descent import draw_descent
from lunarsim.viz.footprint import draw_footprint
from lunarsim.viz.maps import draw_maps
from lunarsim.world import World
from lunarsim.world.truth import Truth


def draw_flight(flight: Flight, world: World, truth: Truth, folder: str | Path) -> None:
    """Write ``descent.png``, ``maps.png`` and ``touchdown.png`` of a finished flight into `folder`.

    A flight that touched nothing has no ``touchdown.png``.

    Parameters
    ----------
    flight
        As flown or as loaded.
    world, truth
        That it was flown in: see `lunarsim.evaluation.worlds.world_of`.
    folder
        Where pictures go.
    """
    draw_descent(flight, Path(folder) / "descent.png")
    draw_maps(flight, world, truth, Path(folder) / "maps.png")
    if flight.verdict.touchdown is not None:
        draw_footprint(flight, world, Path(folder) / "touchdown.png")

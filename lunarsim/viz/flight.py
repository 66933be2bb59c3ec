"""Draw the figures of one flight: descent, maps and touchdown."""

from __future__ import annotations

import base64
import io
from dataclasses import dataclass
from pathlib import Path

from matplotlib.figure import Figure

from lunarsim.scenario import Scenario
from lunarsim.simulation.flight import Flight
from lunarsim.simulation.worlds import rebuild_world
from lunarsim.viz.descent import draw_descent
from lunarsim.viz.footprint import draw_footprint
from lunarsim.viz.maps import draw_maps
from lunarsim.viz.style import save
from lunarsim.world import World
from lunarsim.world.truth import TerrainTruth


@dataclass(frozen=True)
class FlightFigures:
    """Three figures of one flight: descent, maps and touchdown; notebooks show them.

    Attributes
    ----------
    descent
        Profile, speeds, tilt, thrust, propellant and events.
    maps
        True safety, the hazard map that the policy used, and what was measured.
    touchdown
        Footprint on the terrain; None if the flight ended without contact.
    """

    descent: Figure
    maps: Figure
    touchdown: Figure | None

    def save(self, folder: str | Path) -> Path:
        """Write ``descent.png``, ``maps.png``, ``touchdown.png``; return the folder."""
        for name, figure in self._named():
            save(figure, Path(folder) / f"{name}.png")
        return Path(folder)

    def _repr_html_(self) -> str:
        images = []
        for name, figure in self._named():
            buffer = io.BytesIO()
            figure.savefig(buffer, format="png", dpi=100)
            data = base64.b64encode(buffer.getvalue()).decode("ascii")
            images.append(f'<img alt="{name}" src="data:image/png;base64,{data}">')
        return "\n".join(images)

    def _named(self) -> list[tuple[str, Figure]]:
        figures = {"descent": self.descent, "maps": self.maps, "touchdown": self.touchdown}
        return [(name, figure) for name, figure in figures.items() if figure is not None]


def plot_flight(
    flight: Flight, world: World | None = None, truth: TerrainTruth | None = None
) -> FlightFigures:
    """Plot the descent, the maps and the touchdown of a finished flight.

    Parameters
    ----------
    flight
        Record of the flight.
    world
        World of the flight; omitted: generated again from the flight's scenario and seed.
    truth
        Exact safety of the world; omitted: computed.

    Raises
    ------
    InputError
        If the world cannot be generated again, for instance because its raster file is missing.
    """
    if world is None:
        world = rebuild_world(flight)
    if truth is None:
        lander = Scenario.world_from_toml(flight.scenario).true_lander()
        truth = TerrainTruth.of(world, lander)
    landed = flight.outcome.touchdown is not None
    return FlightFigures(
        draw_descent(flight),
        draw_maps(flight, world, truth),
        draw_footprint(flight, world) if landed else None,
    )


def draw_flight(flight: Flight, world: World, truth: TerrainTruth, folder: str | Path) -> None:
    """Write the figures of a flight as PNG files to a folder.

    The figures show descent, maps and touchdown, as from `plot_flight`.
    """
    plot_flight(flight, world, truth).save(folder)

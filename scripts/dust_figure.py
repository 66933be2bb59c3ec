"""Draw the terrain without and with dust: `dust_figure.py docs/images/dust.png`."""

from dataclasses import replace
from pathlib import Path

import click
import cv2
import numpy as np

from lunarsim import Scenario
from lunarsim.frames import sensor_axes
from lunarsim.rng import RandomStreams, flight_seed
from lunarsim.sensors.camera import Camera
from lunarsim.simulation.worlds import build_world
from lunarsim.vehicle import State

HEIGHTS_M, THRUSTS_N = (20.0, 16.0, 12.0), (0.0, 13_000.0)


@click.command()
@click.argument("out", type=click.Path(path_type=Path))
def main(out: Path) -> None:
    """Write the figure to the PNG file OUT."""
    terrain = {"size_m": 150.0, "posting_m": 0.1, "rms_slope_deg": 2.0}
    scenario = Scenario.from_dict({"terrain": terrain, "rocks": {"cover": 0.03}, "dust": {}})
    world = build_world(scenario, RandomStreams(flight_seed(1, 0)))
    mount = sensor_axes(np.array([0.6, 0.0, -0.8]))
    camera = replace(Camera.with_field_of_view(320, 240, 60.0, exposure=3.5e-3), mount=mount)
    below, upright = float(world.terrain.elevation((0.0, 0.0))), np.array([0.0, 0.0, 0.0, 1.0])

    def image(height: float, thrust: float) -> np.ndarray:
        position = np.array([0.0, 0.0, below + height])
        state = State(position, np.zeros(3), upright, np.zeros(3), 7000.0, thrust)
        return camera.measure(world, state, 0.0, np.random.default_rng(1)).counts

    rows = [np.hstack([image(height, thrust) for height in HEIGHTS_M]) for thrust in THRUSTS_N]
    cv2.imwrite(str(out), np.vstack(rows))


if __name__ == "__main__":
    main()

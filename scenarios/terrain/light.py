"""Render one terrain with the plain light and with all effects of `[sun]`.

python scenarios/terrain/light.py --out docs/images
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import click
import numpy as np
from numpy.typing import NDArray

from lunarsim import RandomStreams, Scenario, build_world, flight_seed
from lunarsim.sensors.camera import Camera
from lunarsim.sensors.rendering import renderer_of
from lunarsim.simulation.image_rendering import camera_pointing_state
from lunarsim.viz.style import new_figure, save
from lunarsim.world.light import FULL_EARTH_IRRADIANCE_RATIO, SUN_DIAMETER_RAD, Light

SCENARIOS = Path(__file__).parents[1]
# Effects in the order in which they are added.
STEPS = {
    "plain": {},
    "the Sun's disc": {"diameter": SUN_DIAMETER_RAD},
    "and scattered light, Earthshine": {"scattered_light": True,
    "earthshine": FULL_EARTH_IRRADIANCE_RATIO},
    "and Hapke, mottles, boulders": {
        "photometry": "hapke", "albedo_variation": 0.05, "boulder_albedo": 1.3,
        "boulder_albedo_variation": 0.15,
    },
}  # fmt: skip
ROWS = ((3.0, 25.0, 2.5), (20.0, 60.0, 2.5))


def render_image(world, light: Light, altitude: float) -> NDArray[np.float32]:
    """Render a terrain from 30 deg off nadir as I/F (240, 320), four rays per pixel.

    I/F is the radiance factor. `altitude` is the height above the terrain, m.
    """
    camera = Camera.with_field_of_view(640, 480, 50.0)
    state = camera_pointing_state(camera, world, (10.0, -15.0), altitude, np.radians(30.0), 0.0)
    drawn = renderer_of(world.terrain).render(camera.view(state), light).radiance
    return drawn.reshape(240, 2, 320, 2).mean((1, 3))


@click.command()
@click.option(
    "--scenario", default="highland", show_default=True, help="Scenario whose terrain is rendered."
)
@click.option("--seed", default=1, show_default=True, help="Random seed of rocks and albedo.")
@click.option("--out", type=click.Path(path_type=Path, file_okay=False), required=True,
              help="Folder for the image.")  # fmt: skip
def main(scenario: str, seed: int, out: Path) -> None:
    """Render one terrain with an increasing number of light effects."""
    world = build_world(
        Scenario.load(SCENARIOS / f"{scenario}.toml"), RandomStreams(flight_seed(seed, 0))
    )
    figure = new_figure(3.3 * len(STEPS), 5.4)
    axes = figure.subplots(len(ROWS), len(STEPS))
    for row, (elevation, altitude, power) in zip(axes, ROWS, strict=True):
        light = Light(np.radians(250.0), np.radians(elevation), albedo_seed=seed)
        for ax, (name, more) in zip(row, STEPS.items(), strict=True):
            light = replace(light, **more)
            image = render_image(world, light, altitude)
            # The shadows are stretched to make their content visible.
            bright = np.percentile(image, 99.0)
            ax.imshow(np.clip(image / bright, 0.0, 1.0) ** (1.0 / power), cmap="gray", vmin=0.0,
                      vmax=1.0)  # fmt: skip
            ax.axis("off")
            ax.set_title(f"{name}, {elevation:g} deg", fontsize=9)
    save(figure, out / "light.png")


if __name__ == "__main__":
    main()

"""Render images of the shipped terrains, and plot the size law of measured rocks.

python scenarios/terrain/gallery.py                     # writes docs/images/gallery/
python scenarios/terrain/gallery.py --out out/gallery --only mare
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click
import numpy as np

from lunarsim import InputError, Scenario
from lunarsim.rocks.size_distribution import golombek_number
from lunarsim.simulation.image_rendering import render

SCENARIOS = Path(__file__).parents[1]
DATA = SCENARIOS / "data"
GALLERY = SCENARIOS.parent / "docs" / "images" / "gallery"
_ROCKS: dict[str, Any] = {"cover": 0.03, "min_diameter_m": 0.2, "shape": "mixed"}
# The default Sun azimuth is west.
SCENES: dict[str, tuple[dict[str, Any], dict[str, Any]]] = {
    "mare": (
        {"terrain": {"preset": "mare", "size_m": 300.0}, "rocks": _ROCKS | {"cover": 0.01}},
        {"altitude": 150.0, "sun_elevation_deg": 15.0},
    ),
    "highland": (
        {"terrain": {"preset": "highland", "size_m": 300.0}, "rocks": _ROCKS},
        {"altitude": 60.0, "off_nadir_deg": 50.0, "sun_elevation_deg": 30.0},
    ),
    "shackleton": (
        {
            "terrain": {
                "kind": "dtm",
                "path": str(DATA / "moon_shackleton_ridge_lola_40m.tif"),
                "dtm_posting_m": 40.0,
                "posting_m": 10.0,
                "preset": "polar",
                "detail": True,
                "crater_min_diameter_m": 40.0,
            },
            "rocks": {"cover": 0.0},
        },
        {"altitude": 8000.0, "sun_elevation_deg": 3.0},
    ),
    "apollo15": (
        {
            "terrain": {
                "kind": "dtm",
                "path": str(DATA / "moon_apollo15_nac_dtm_2m.tif"),
                "dtm_posting_m": 2.0,
                "height_step_m": 0.192,
                "preset": "mare",
                "detail": True,
                "crater_min_diameter_m": 1.0,
            },
            "rocks": _ROCKS | {"cover": 0.01, "min_diameter_m": 0.4},
        },
        {"altitude": 350.0, "sun_elevation_deg": 12.0},
    ),
    "hirise": (
        {
            "terrain": {
                "kind": "dtm",
                "path": str(DATA / "hirise_dteec_010228_1490_crop.tif"),
                "relief_scale": 0.35,
                "detail": False,
            },
            "rocks": _ROCKS | {"cover": 0.05},
        },
        {"altitude": 55.0, "sun_elevation_deg": 25.0},
    ),
    "boulders": (
        {
            "terrain": {"preset": "highland", "size_m": 60.0, "posting_m": 0.1,
                        "rms_slope_deg": 4.0, "crater_density": 0.0},
            "rocks": {"cover": 0.15, "min_diameter_m": 0.1, "max_diameter_m": 2.0,
                      "shape": "mixed"},
        },
        {"altitude": 10.0, "off_nadir_deg": 35.0, "sun_elevation_deg": 20.0},
    ),
}  # fmt: skip


def draw_rock_law(out: Path) -> str:
    """Plot measured rocks with Golombek's size law and its fitted cover.

    The data are 12,627 rocks that a shadow detector found in a HiRISE image of 3289 x 6824 m. Small
    rocks cast shadows of too few pixels and are missed, so the fit uses only 1.5 to 4 m. The figure
    is written to folder `out`; returns a summary.
    """
    from scipy.optimize import minimize_scalar

    from lunarsim.viz.style import new_figure, save

    diameter = np.loadtxt(
        DATA / "hirise_ESP_046282_diameters.csv.gz", delimiter=",", skiprows=1, usecols=0
    )
    area = 3289.0 * 6824.0
    sizes = np.sort(diameter)[::-1]
    number = np.arange(1, sizes.size + 1) / area
    low, high = 1.5, 4.0
    bins = np.linspace(low, high, 11)
    counts, _ = np.histogram(sizes, bins)

    def misfit(log_k: float) -> float:
        expected = -np.diff(golombek_number(bins, float(np.exp(log_k)))) * area
        return float(np.sum(expected - counts * np.log(expected)))  # Poisson likelihood

    k = float(np.exp(minimize_scalar(misfit, bounds=(-9.0, -1.5), method="bounded").x))
    figure = new_figure(6.4, 4.6)
    ax = figure.subplots()
    d = np.geomspace(0.4, 8.0, 200)
    ax.loglog(sizes, number, ".", ms=3, color="0.35", label="12,627 rocks measured by HiRISE")
    ax.loglog(d, golombek_number(d, k), label=f"Golombek, k = {k:.4f} (fitted, 1.5 to 4 m)")
    for other, style in ((0.01, ":"), (0.05, "--"), (0.1, "-.")):
        ax.loglog(d, golombek_number(d, other), style, color="0.6", label=f"Golombek, k = {other}")
    ax.axvspan(low, high, color="0.93", zorder=0)
    ax.set(
        xlabel="Diameter (m)", ylabel="Rocks of this diameter or more (1/m$^2$)",
        xlim=(0.4, 8.0), ylim=(0.5 / area, 3.0),
    )  # fmt: skip
    ticks = [0.5, 1.0, 2.0, 4.0, 8.0]
    ax.set_xticks(ticks, [f"{t:g}" for t in ticks])
    ax.minorticks_off()
    ax.legend()
    save(figure, out / "rock_sizes.png")
    found = int(np.sum(counts))
    return f"rock_sizes.png: cover k = {k:.4f} from {found} rocks of {low} to {high} m"


def draw_shadow_crops(out: Path) -> str:
    """Plot rendered shadows pixel by pixel with the computed positions of their tips.

    The shapes are a cube, a hemisphere and a half ellipsoid, each 2 m wide, on a horizontal plane
    with the Sun in the west. The figure is written to folder `out`; returns a summary.
    """
    from lunarsim import Grid, Heightfield, Terrain
    from lunarsim.frames import sensor_axes
    from lunarsim.models.pinhole import View
    from lunarsim.rocks.field import RockField
    from lunarsim.rocks.shapes import CUBE, ELLIPSOID
    from lunarsim.sensors.rendering import Renderer
    from lunarsim.viz.style import new_figure, save
    from lunarsim.world.light import Light

    shapes = {"cube": (CUBE, 2.0), "half sphere": (ELLIPSOID, 1.0), "ellipsoid": (ELLIPSOID, 0.6)}
    suns = (5.0, 10.0, 20.0, 45.0)
    viewpoints = (
        ("600 m, straight down", 600.0, 0.0),
        ("100 m, straight down", 100.0, 0.0),
        ("100 m, 45 deg off nadir", 100.0, 45.0),
        ("30 m, 45 deg off nadir", 30.0, 45.0),
    )
    grid = Grid.centred((0.0, 0.0), 200.0, 1.0)
    plane = Heightfield(grid, np.zeros(grid.shape, np.float32))
    figure = new_figure(15.0, 12.0)
    axes = figure.subplots(len(shapes) * len(viewpoints), len(suns))
    for i, (name, (shape, height)) in enumerate(shapes.items()):
        one = [np.array([v]) for v in (0.0, 0.0, 0.0, 1.0, 1.0, height, 0.0)]
        renderer = Renderer(Terrain(plane, RockField(*one, np.array([shape]))))
        for j, (title, distance, tilt) in enumerate(viewpoints):
            boresight = np.array([0.0, np.sin(np.radians(tilt)), -np.cos(np.radians(tilt))])
            for k, elevation in enumerate(suns):
                rise = height / np.tan(np.radians(elevation))
                tip = 1.0 + rise if shape == CUBE else float(np.hypot(1.0, rise))
                width = int(np.clip(1.25 * (tip + 2.5) * 554.0 / distance, 24, 640))
                high = int(np.clip(4.5 * 554.0 / distance, 10, 120))
                target = np.array([0.5 * tip, 0.0, 0.0])
                view = View(target - distance * boresight, sensor_axes(boresight), 554.0, 554.0,
                            0.5 * (width - 1), 0.5 * (high - 1), width, high)  # fmt: skip
                image = renderer.render(view, Light(1.5 * np.pi, np.radians(elevation)))
                point = (np.array([tip, 0.0, 0.0]) - view.position) @ view.axes
                ax = axes[len(viewpoints) * i + j, k]
                ax.imshow(image.radiance, cmap="gray", interpolation="nearest", vmin=0.0,
                          vmax=1.5 * float(image.radiance[0, -1]))  # fmt: skip
                ax.axvline(554.0 * point[0] / point[2] + view.cx, color="#D55E00", lw=0.9)
                ax.set_xticks([])
                ax.set_yticks([])
                if i == j == 0:
                    ax.set_title(f"Sun {elevation:g} deg")
                if k == 0:
                    ax.set_ylabel(f"{name}\n{title}", fontsize=7, rotation=0, ha="right",
                                  va="center")  # fmt: skip
    figure.suptitle("Rendered shadows; orange: position of the tip in closed form")
    save(figure, out / "shadows.png")
    return "shadows.png: 48 crops"


@click.command(context_settings={"help_option_names": ["-h", "--help"]})
@click.option(
    "--out", type=click.Path(path_type=Path), default=GALLERY,
    show_default="docs/images/gallery", help="Folder for the images.",
)  # fmt: skip
@click.option(
    "--only",
    type=click.Choice([*SCENES, "rocks", "shadows"]),
    help="Name of a single image to render. Default: all images.",
)
def main(out: Path, only: str | None) -> None:
    """Render the terrain gallery of the documentation."""
    out.mkdir(parents=True, exist_ok=True)
    try:
        for name, (tables, how) in SCENES.items():
            if only in {None, name}:
                scenario = Scenario.from_dict({"name": name} | tables)
                image = render(scenario, **how)
                click.echo(f"{image.save(out / f'{name}.png')}: {image.description}")
        if only in {None, "rocks"}:
            click.echo(draw_rock_law(out))
        if only in {None, "shadows"}:
            click.echo(draw_shadow_crops(out))
    except InputError as error:
        raise click.UsageError(str(error)) from None


if __name__ == "__main__":
    main()

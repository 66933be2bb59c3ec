"""Compare generated detail with the measured relief by structure functions.

    python scenarios/terrain/structure.py --scenario scenarios/apollo15.toml --out out/terrain

First differences over a lag (the structure function) are dominated by large slopes. Second
differences, z(x - lag) - 2 z(x) + z(x + lag), do not depend on a constant slope; they measure the
roughness at that scale. Divided by the lag they are constant if the terrain is self-similar, as
terrain covered by craters in equilibrium is.
"""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import click
import numpy as np
from rich.table import Table

from lunarsim import Heightfield, Scenario, load_terrain
from lunarsim.console import plain_console
from lunarsim.viz.style import COLOURS, new_figure, save
from lunarsim.world.terrain_models.measured import RasterTerrain

LAGS = (0.25, 0.5, 1.0, 1.5, 2.0, 3.0, 4.0, 6.0, 8.0, 12.0, 16.0, 24.0, 32.0)


def rms_differences(
    relief: Heightfield, distance: float, box: tuple[float, ...]
) -> tuple[float, float]:
    """Return the RMS first and second difference of elevations over a distance, m.

    `distance` is horizontal, m; the result is NaN if it is not a multiple of the grid spacing.
    `box` is the west, east, south and north limit of the used area, m.
    """
    grid = relief.grid
    step = round(distance / grid.posting)
    if step < 1 or abs(step * grid.posting - distance) > 1e-6:
        return float("nan"), float("nan")
    west, east, south, north = box
    inside = np.ix_((grid.y >= south) & (grid.y <= north), (grid.x >= west) & (grid.x <= east))
    z = relief.z[inside].astype(np.float64)
    first = [z[:, step:] - z[:, :-step], z[step:] - z[:-step]]
    second = [
        z[:, 2 * step :] - 2.0 * z[:, step:-step] + z[:, : -2 * step],
        z[2 * step :] - 2.0 * z[step:-step] + z[: -2 * step],
    ]
    one, two = (
        float(np.sqrt(np.nanmean(np.concatenate([d.ravel() for d in both]) ** 2)))
        for both in (first, second)
    )
    return one, two


def relief_versions(raster: RasterTerrain) -> dict[str, Heightfield]:
    """Return a measured relief by name: as stored, refined, and with generated detail."""
    filed = load_terrain(raster.path, posting=raster.dtm_posting, window=raster.dtm_window)
    return {
        "as filed": filed.scaled(raster.relief_scale),
        "refined": replace(raster, detail=False).relief(),
        "with detail": replace(raster, detail=True).relief(),
    }


def draw(rows: dict[str, np.ndarray], posting: float, path: Path) -> None:
    """Plot RMS first and second differences divided by the lag.

    `rows` holds the differences (lags, 2), m, by name of the relief; `posting` is the grid spacing
    of the measured raster, m; `path` is the output file.
    """
    figure = new_figure(9.6, 4.2)
    panels = figure.subplots(1, 2)
    titles = ("first differences / lag", "second differences / lag")
    for panel, which, title in zip(panels, range(2), titles, strict=True):
        for (name, values), colour in zip(rows.items(), COLOURS, strict=False):
            panel.plot(
                LAGS, values[:, which] / np.array(LAGS), "o-", ms=3, color=colour, label=name
            )
        panel.axvline(posting, color="#999999", lw=1)
        panel.set_xscale("log")
        panel.set_ylim(bottom=0.0)
        panel.set_xlabel("Lag (m); line: measured posting")
        panel.set_ylabel("RMS / lag")
        panel.set_title(title)
        panel.grid(alpha=0.3)
    panels[0].legend()
    save(figure, path)


@click.command()
@click.option("--scenario", type=click.Path(path_type=Path, exists=True, dir_okay=False),
              default=Path(__file__).parents[1] / "apollo15.toml", show_default="apollo15.toml",
              help="Scenario to analyse (TOML file); its terrain must be measured.")  # fmt: skip
@click.option("--box", nargs=4, type=float, default=(-256.0, 24.0, -256.0, 256.0),
              show_default=True,
              help="West, east, south and north limits of the analysed area (m).")  # fmt: skip
@click.option("--json", "json_file", type=click.Path(path_type=Path, dir_okay=False), default=None,
              help="JSON file for all results. Default: none.")  # fmt: skip
@click.option("--out", type=click.Path(path_type=Path, file_okay=False), default=None,
              help="Folder for the figure. Default: no figure.")  # fmt: skip
def main(scenario: Path, box: tuple[float, ...], json_file: Path | None, out: Path | None) -> None:
    """Print the roughness of measured terrain with and without detail."""
    raster = Scenario.load(scenario).terrain.make()
    if not isinstance(raster, RasterTerrain):
        raise click.BadParameter(f"{scenario}: terrain.kind must be 'dtm'", param_hint="--scenario")
    found = relief_versions(raster)
    rows = {n: np.array([rms_differences(r, lag, box) for lag in LAGS]) for n, r in found.items()}
    # Rounding to height steps adds the variance of each value in a difference.
    step = (raster.height_step or 0.0) * raster.relief_scale
    noise = step**2 / 12.0 * np.array([2.0, 6.0])
    rows["as filed, less rounding"] = np.sqrt(np.maximum(rows["as filed"] ** 2 - noise, 0.0))
    table = Table(title=f"{scenario.stem}: RMS difference / lag")
    table.add_column("lag (m)", justify="right")
    for order in ("first", "second"):
        for name in rows:
            table.add_column(f"{order}, {name}", justify="right")
    for n, lag in enumerate(LAGS):
        cells = [f"{v[n, k] / lag:.4f}" for k in range(2) for v in rows.values()]
        table.add_row(f"{lag:g}", *(c if c != "nan" else "" for c in cells))
    plain_console(150).print(table)
    if json_file is not None:
        json_file.parent.mkdir(parents=True, exist_ok=True)
        plain = {name: v.tolist() for name, v in rows.items()}
        json_file.write_text(json.dumps({"lag": LAGS} | plain, indent=1), encoding="utf-8")
    if out is not None:
        draw(rows, found["as filed"].grid.posting, out / f"structure_{scenario.stem}.png")


if __name__ == "__main__":
    main()

"""Measured terrain: a digital terrain model, refined, with rocks."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

from lunarsim.errors import InputError
from lunarsim.parts.quantity import quantity
from lunarsim.rng import RandomStreams
from lunarsim.rocks.population import RockPopulation
from lunarsim.world.terrain import Heightfield, Terrain, add_detail
from lunarsim.world.terrain_models.interface import MAX_POSTS_PER_SIDE, add_rocks
from lunarsim.world.terrain_models.roughness import ReliefRoughness

# One number or several.
Numbers = float | tuple[float, ...]


@dataclass(frozen=True)
class RasterTerrain(ReliefRoughness):
    """A digital terrain model with added roughness between its posts; rocks are drawn.

    Attributes
    ----------
    path
        GeoTIFF, PDS image or another raster.
    dtm_posting
        Distance between posts of a raster without georeferencing, or posting to resample a
        georeferenced raster to, m.
    dtm_unit, dtm_nodata
        Unit of the heights, overriding the file's; values that mark posts without a height, in
        addition to those declared by the file.
    height_step
        Quantization step of the elevations, m.
    mirrored_to
        Side of the square to which the raster is extended by mirroring it at its edges, for
        sensors that see beyond it, m.
    detail
        Whether roughness and craters are added between the posts. Without them the spline
        through the posts is smoother than real terrain.
    """

    path: Path | None = quantity(None, help="raster file, relative to the scenario file")
    dtm_posting: float | None = quantity(
        None, "m", gt=0, help="distance between posts, for a raster without georeferencing"
    )
    dtm_window: tuple[int, int, int, int] | None = quantity(
        None, help="first and last row, first and last column, in the order of the file"
    )
    dtm_unit: str | None = quantity(
        None, help="unit of the heights, overrides the file's: m, km, ft, us-ft"
    )
    dtm_nodata: Numbers | None = quantity(
        None, help="values that mark posts without a height; [] for none"
    )
    height_step: float | None = quantity(
        None, "m", gt=0, help="quantization step of the elevations, to be smoothed; omitted: none"
    )
    relief_scale: float = quantity(
        1.0, ge=0, help="factor on heights, c of Eq. 20 of the Gaussian DEM paper"
    )
    mirrored_to: float | None = quantity(
        None, "m", gt=0, help="side of the square to extend the raster to, by mirroring"
    )
    posting: float = quantity(0.25, "m", gt=0, help="distance between posts of the refined relief")
    detail: bool = quantity(True, help="whether roughness and craters are added between the posts")

    def __post_init__(self) -> None:
        if self.path is None:
            raise InputError("path", None, "must name a raster file")

    def check_files(self) -> None:
        """Refuse a raster that cannot be read or does not suit these settings."""
        _load_measured(self)

    def posts(self) -> tuple[int, float]:
        """Return the numbers of posts to read and of the relief, from the file's header."""
        from lunarsim.world.terrain.dtm import read_size  # noqa: PLC0415  (rasterio loads slowly)

        assert self.path is not None
        size = read_size(self.path, posting=self.dtm_posting, window=self.dtm_window)
        min_side = self.mirrored_to or 0.0
        cols, rows = (max(side, min_side) / self.posting for side in size[1:])
        return size.posts, cols * rows

    def build(self, rocks: RockPopulation, streams: RandomStreams) -> Terrain:
        """Return the terrain of one flight."""
        return add_rocks(self.relief(), rocks, streams)

    def relief(self) -> Heightfield:
        """Return the relief without rocks."""
        return _cached_relief(self)


def _load_measured(model: RasterTerrain) -> Heightfield:
    """Return the raster's elevations, dequantized, scaled and mirrored."""
    from lunarsim.world.terrain.dtm import load_terrain  # noqa: PLC0415  (rasterio loads slowly)

    assert model.path is not None
    measured = load_terrain(
        model.path, posting=model.dtm_posting, window=model.dtm_window, unit=model.dtm_unit,
        nodata=model.dtm_nodata,
    )  # fmt: skip
    if model.height_step is not None:
        measured = measured.dequantised(model.height_step)
    measured = measured.scaled(model.relief_scale)
    if model.mirrored_to is not None:
        _check_posts(model, model.mirrored_to)
        measured = measured.mirrored(model.mirrored_to)
    west, east, south, north = measured.bounds
    _check_posts(model, max(east - west, north - south))
    return measured


def _check_posts(model: RasterTerrain, side: float) -> None:
    """Refuse a posting too fine for a square of the given side, m."""
    if side / model.posting > MAX_POSTS_PER_SIDE:
        raise InputError(
            "terrain.posting_m", model.posting,
            f"must be at least {side / MAX_POSTS_PER_SIDE:.3g} m",
            f"At most {MAX_POSTS_PER_SIDE} posts are allowed along the {side:.0f} m of the raster.",
        )  # fmt: skip


@lru_cache(maxsize=4)
def _cached_relief(model: RasterTerrain) -> Heightfield:
    measured = _load_measured(model)
    fine = measured.refined(model.posting)
    if not model.detail:
        return fine
    # The measurement already contains the craters that its posts resolve.
    largest = 2.0 * measured.grid.posting
    return add_detail(measured, model.procedural(fine.grid, largest))

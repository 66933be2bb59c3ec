"""Measured terrain: a digital terrain model, refined, with rocks."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

from lunarsim.errors import InputError
from lunarsim.parts.quantity import quantity
from lunarsim.rng import RandomStreams
from lunarsim.rocks.population import RockPopulation
from lunarsim.world.terrain import AlbedoMap, Heightfield, Terrain, add_detail
from lunarsim.world.terrain_models.interface import MAX_POSTS_PER_SIDE, add_rocks
from lunarsim.world.terrain_models.roughness import ReliefRoughness

# One number or several.
Numbers = float | tuple[float, ...]
# West, east, south and north edge, m.
Bounds = tuple[float, float, float, float]


@dataclass(frozen=True)
class RasterTerrain(ReliefRoughness):
    """Settings of measured terrain: an elevation raster, refined, with random rocks.

    Roughness and craters are added between the raster's grid points ("posts").

    Attributes
    ----------
    path
        GeoTIFF, PDS image or another raster.
    dtm_posting
        Grid spacing of a raster without georeferencing, or spacing to which a georeferenced raster
        is resampled, m.
    dtm_unit, dtm_nodata
        Unit of the heights, which replaces the file's; raster values that mean "no height", in
        addition to those stated by the file.
    height_step
        Quantization step of the elevations, m.
    albedo_path, albedo_posting
        Orthoimage or albedo map of the terrain, and its pixel size if it has no georeferencing, m.
    mirrored_size
        Side of the square to which the raster is extended by mirroring at its edges, for sensors
        that see beyond the raster, m.
    detail
        Whether roughness and craters are added between the grid points. Without them the spline
        through the points is smoother than real terrain.
    """

    path: Path | None = quantity(
        None, help="file of the elevation raster, relative to the scenario file"
    )
    dtm_posting: float | None = quantity(
        None,
        "m",
        gt=0,
        help="grid spacing of the elevation raster if the file has no georeferencing; if the file "
        "has it but no square grid: spacing to which the raster is resampled; omitted: as in the "
        "file",
    )
    dtm_window: tuple[int, int, int, int] | None = quantity(
        None,
        help="part of the raster to read: first row, end row, first column, end column; the "
        "end row and the end column are not included; omitted: all",
    )
    dtm_unit: str | None = quantity(
        None,
        help="unit of the raster's heights: m, km, ft or us-ft; omitted: unit stated in the file",
    )
    dtm_nodata: Numbers | None = quantity(
        None,
        help="raster values that mark missing heights, in addition to those stated in the file; "
        "[]: none; omitted: none, but a raster is rejected if some of its heights are outliers, "
        "such as -9999, that can be such marks",
    )
    height_step: float | None = quantity(
        None,
        "m",
        gt=0,
        help="quantization step of the raster's heights; smoothing changes each height by at most "
        "half a step to remove the steps; omitted: no smoothing",
    )
    relief_scale: float = quantity(
        1.0, ge=0, help="factor by which the raster's heights are multiplied"
    )
    mirrored_size: float | None = quantity(
        None,
        "m",
        gt=0,
        help="side of the square to which the raster is extended by mirroring at its edges; "
        "omitted: no extension",
    )
    albedo_path: Path | None = quantity(
        None,
        help="orthoimage or albedo map that gives the relative albedo of the terrain in images: "
        "raster file, relative to the scenario file; omitted: uniform albedo",
    )
    albedo_posting: float | None = quantity(
        None,
        "m",
        gt=0,
        help="pixel size of the image at albedo_path if it or the raster has no georeferencing; it "
        "then lies north up, with its centre at the centre of the raster",
    )
    posting: float = quantity(
        0.25, "m", gt=0, help="grid spacing of the relief that is interpolated from the raster"
    )
    detail: bool = quantity(
        True, help="whether roughness and craters are added between the raster's grid points"
    )

    def __post_init__(self) -> None:
        if self.path is None:
            raise InputError("path", None, "is required", "Name a raster file.", show_value=False)

    def check_files(self) -> None:
        """Raise InputError if the raster is unreadable or does not fit these settings."""
        measured, edges = _load_measured(self)
        _load_albedo(self, edges, measured.bounds)

    def posts(self) -> tuple[int, float]:
        """Return the numbers of grid points of the raster and of the refined relief.

        Only the header of the file is read.
        """
        from lunarsim.world.terrain.dtm import read_size  # noqa: PLC0415  (rasterio loads slowly)

        assert self.path is not None
        size = read_size(self.path, posting=self.dtm_posting, window=self.dtm_window)
        min_side = self.mirrored_size or 0.0
        cols, rows = (max(side, min_side) / self.posting for side in size[1:])
        return size.posts, cols * rows

    def mean_elevation(self) -> float:
        """Return the mean height in the raster, m: that of the origin of the site frame."""
        from lunarsim.world.terrain.dtm import mean_elevation  # noqa: PLC0415  (loads slowly)

        assert self.path is not None
        return mean_elevation(
            self.path, posting=self.dtm_posting, window=self.dtm_window, unit=self.dtm_unit,
            nodata=self.dtm_nodata,
        )  # fmt: skip

    def build(self, rocks: RockPopulation, streams: RandomStreams) -> Terrain:
        """Return the relief with random rocks of one flight.

        `rocks` is the population to sample from, `streams` are the flight's random streams.
        """
        relief, albedo = _cached_surface(self)
        return add_rocks(relief, rocks, streams, albedo=albedo)

    def frame(self) -> tuple[Any, Any]:
        """Return the frame of the raster and its coordinate reference system."""
        from lunarsim.world.terrain.dtm import read_frame  # noqa: PLC0415  (loads rasterio)

        assert self.path is not None
        return read_frame(self.path, posting=self.dtm_posting, window=self.dtm_window)

    def relief(self) -> Heightfield:
        """Return the relief without rocks."""
        return _cached_surface(self)[0]


def _load_measured(model: RasterTerrain) -> tuple[Heightfield, Bounds]:
    """Load the elevations of the raster of `model`; dequantize, scale and mirror them.

    The second value are the edges before mirroring.
    """
    from lunarsim.world.terrain.dtm import load_terrain  # noqa: PLC0415  (rasterio loads slowly)

    assert model.path is not None
    measured = load_terrain(
        model.path, posting=model.dtm_posting, window=model.dtm_window, unit=model.dtm_unit,
        nodata=model.dtm_nodata,
    )  # fmt: skip
    if model.height_step is not None:
        measured = measured.dequantised(model.height_step)
    measured = measured.scaled(model.relief_scale)
    edges = measured.bounds
    if model.mirrored_size is not None:
        _check_posts(model, model.mirrored_size)
        measured = measured.mirrored(model.mirrored_size)
    west, east, south, north = measured.bounds
    _check_posts(model, max(east - west, north - south))
    return measured, edges


def _load_albedo(model: RasterTerrain, measured: Bounds, complete: Bounds) -> AlbedoMap | None:
    """Load the relative albedo of the terrain of `model`; None if it has no image.

    `measured` and `complete` are the edges (m) of the terrain before and after mirroring.
    """
    if model.albedo_path is None:
        return None
    # rasterio loads slowly
    from lunarsim.world.terrain.albedo_image import Placement, load_albedo_map  # noqa: PLC0415
    from lunarsim.world.terrain.dtm import read_frame  # noqa: PLC0415

    assert model.path is not None
    frame = read_frame(model.path, posting=model.dtm_posting, window=model.dtm_window)
    placement = Placement(*frame, measured, complete)
    return load_albedo_map(model.albedo_path, model.albedo_posting, placement)


def _check_posts(model: RasterTerrain, side: float) -> None:
    """Raise InputError if a square of `side` metres has too many grid points.

    At most 20,000 points with the spacing of `model` are allowed along a side.
    """
    if side / model.posting > MAX_POSTS_PER_SIDE:
        raise InputError(
            "terrain.posting_m", model.posting,
            f"must be at least {side / MAX_POSTS_PER_SIDE:.3g} m",
            f"At most {MAX_POSTS_PER_SIDE} points are allowed along the {side:.0f} m raster.",
        )  # fmt: skip


@lru_cache(maxsize=4)
def _cached_surface(model: RasterTerrain) -> tuple[Heightfield, AlbedoMap | None]:
    """Return the relief of a raster and its relative albedo, if it has an image."""
    measured, edges = _load_measured(model)
    albedo = _load_albedo(model, edges, measured.bounds)
    fine = measured.refined(model.posting)
    if not model.detail:
        return fine, albedo
    # The measurement already contains the craters that its grid resolves.
    largest = 2.0 * measured.grid.posting
    return add_detail(measured, model.procedural_relief(fine.grid, largest)), albedo

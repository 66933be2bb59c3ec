"""Measured ground: a digital terrain model, refined, with rocks."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

from lunarsim.errors import InputError
from lunarsim.parts.quantity import quantity
from lunarsim.rng import Streams
from lunarsim.rocks.population import RockPopulation
from lunarsim.world.grounds.contract import MOST_POSTS, strewn
from lunarsim.world.grounds.roughness import Roughness
from lunarsim.world.terrain import Heightfield, Terrain, add_detail

# One number or several.
Numbers = float | tuple[float, ...]


@dataclass(frozen=True)
class MeasuredGround(Roughness):
    """A digital terrain model, with roughness between its posts; rocks are drawn.

    Attributes
    ----------
    path
        GeoTIFF, PDS image or another raster.
    dtm_posting
        Distance between posts of a raster without a coordinate reference, or wanted posting of one
        that is resampled, m.
    dtm_window
        First and last row and column that are used.
    dtm_unit, dtm_nodata
        Unit of the heights, in place of the file's; numbers that mark posts without a height,
        besides those that the file declares.
    height_step
        Step between elevations of a coarsely rounded raster, m.
    relief_scale
        c of Eq. 20 of the Gaussian DEM paper.
    mirrored_to
        Side of the square to which the raster is carried on, mirrored at its edges: for sensors
        that see farther than it reaches, m.
    posting
        Of the refined relief, m.
    detail
        Whether roughness and craters are added between the posts: a spline through them alone is
        smoother than any ground.
    """

    path: Path | None = quantity(None, help="raster, relative to the scenario file")
    dtm_posting: float | None = quantity(
        None, "m", gt=0, help="distance between posts, for a raster without a frame"
    )
    dtm_window: tuple[int, int, int, int] | None = quantity(
        None, help="first and last row, first and last column, in the order of the file"
    )
    dtm_unit: str | None = quantity(
        None, help="unit of the heights, overrides the file's: m, km, ft, us-ft"
    )
    dtm_nodata: Numbers | None = quantity(
        None, help="numbers that mark posts without a height; [] for none"
    )
    height_step: float | None = quantity(
        None, "m", gt=0, help="for a raster whose elevations come in steps: smooth within them"
    )
    relief_scale: float = quantity(1.0, ge=0, help="c of Eq. 20 of the Gaussian DEM paper")
    mirrored_to: float | None = quantity(
        None, "m", gt=0, help="carry it on, mirrored at its edges, to a square of this side"
    )
    posting: float = quantity(0.25, "m", gt=0, help="of the refined relief")
    detail: bool = quantity(True, help="add roughness and craters between the posts")

    def __post_init__(self) -> None:
        if self.path is None:
            raise InputError("path", None, "the raster to load")

    def check_files(self) -> None:
        """Refuse a raster that cannot be read, or that these settings do not fit."""
        _measured(self)

    def posts(self) -> tuple[int, float]:
        """Return the numbers of posts that are read and of the relief, from the file's header."""
        from lunarsim.world.terrain.dtm import read_size  # noqa: PLC0415  (rasterio loads slowly)

        assert self.path is not None
        size = read_size(self.path, posting=self.dtm_posting, window=self.dtm_window)
        least = self.mirrored_to or 0.0
        cols, rows = (max(side, least) / self.posting for side in size[1:])
        return size.posts, cols * rows

    def build(self, rocks: RockPopulation, streams: Streams) -> Terrain:
        """Return the terrain of one flight."""
        return strewn(self.relief(), rocks, streams)

    def relief(self) -> Heightfield:
        """Return the relief without rocks."""
        return _relief(self)


def _measured(ground: MeasuredGround) -> Heightfield:
    """Return what the raster holds, scaled."""
    from lunarsim.world.terrain.dtm import load_dtm  # noqa: PLC0415  (rasterio loads slowly)

    assert ground.path is not None
    measured = load_dtm(
        ground.path, posting=ground.dtm_posting, window=ground.dtm_window, unit=ground.dtm_unit,
        nodata=ground.dtm_nodata,
    )  # fmt: skip
    if ground.height_step is not None:
        measured = measured.dequantised(ground.height_step)
    measured = measured.scaled(ground.relief_scale)
    if ground.mirrored_to is not None:
        _check_posts(ground, ground.mirrored_to)
        measured = measured.mirrored(ground.mirrored_to)
    west, east, south, north = measured.bounds
    _check_posts(ground, max(east - west, north - south))
    return measured


def _check_posts(ground: MeasuredGround, side: float) -> None:
    """Refuse a posting too fine for a square of some side, m."""
    if side / ground.posting > MOST_POSTS:
        raise InputError(
            "terrain.posting_m", ground.posting, f"at least {side / MOST_POSTS:.3g} m: at most "
            f"{MOST_POSTS} posts along the {side:.0f} m of the raster",
        )  # fmt: skip


@lru_cache(maxsize=4)
def _relief(ground: MeasuredGround) -> Heightfield:
    measured = _measured(ground)
    fine = measured.refined(ground.posting)
    if not ground.detail:
        return fine
    # Craters that the posts could show are in the measurement already.
    largest = 2.0 * measured.grid.posting
    return add_detail(measured, ground.procedural(fine.grid, largest))

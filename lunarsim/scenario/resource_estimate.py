"""Estimate memory and time of a flight; refuse scenarios that need too much."""

from __future__ import annotations

import contextlib
from typing import Any, NamedTuple

import numpy as np

from lunarsim.errors import InputError
from lunarsim.grid import format_bytes
from lunarsim.rocks.size_distribution import golombek_number

# Maximum peak memory of one process, bytes. Scenarios that need more are refused.
MAX_MEMORY_BYTES = 16 * 2**30
# Memory of the process, libraries and kernels, bytes; measured on a flight over 60 m of terrain.
_PROCESS_BYTES = 4e8
# Peak memory and time per post to generate fractal terrain with craters, measured with 2000 and
# 4000 posts along a side on one core.
_BYTES_PER_POST, _SECONDS_PER_POST = 144.0, 4.7e-7
# Peak memory per post of a spline through a raster without added detail.
_BYTES_PER_SPLINE_POST = 48.0
# Memory and time to read a post of a file, measured with 2000 posts per side, posting in degrees.
_BYTES_PER_POST_READ, _SECONDS_PER_POST_READ = 32.0, 2e-7
# Memory per height of the far terrain.
_BYTES_PER_POST_KEPT = 8.0
# Memory and time to place a rock, measured with 200,000 rocks on 60 m of terrain.
_BYTES_PER_ROCK, _SECONDS_PER_ROCK = 400.0, 5e-6
# Memory of a map cell (all layers and mapper state), and of an image pixel (all processing steps).
_BYTES_PER_CELL, _BYTES_PER_PIXEL = 100.0, 60.0

_REMEDIES = {
    "size_m": "Use a smaller value, or a larger posting_m or detail_m.",
    "posting_m": "Use a larger value, or a part of the raster (terrain.dtm_window).",
    "terrain.path": "Use a part of the raster (terrain.dtm_window).",
    "far_terrain.path": "Use a smaller raster.",
    "min_diameter_m": "Use a larger value, or a smaller cover.",
    "sizes_m": "Use smaller values or fewer levels.",
    "width": "Use a smaller value, or a smaller height.",
}


class ResourceEstimate(NamedTuple):
    """Estimated peak memory (bytes) by the scenario key that determines it.

    `memory` does not include the process itself, its libraries and kernels; `total` does.
    `terrain_time` is the estimated time to generate the terrain, s.
    """

    memory: dict[str, float]
    terrain_time: float

    @property
    def total(self) -> float:
        """Estimated peak memory of one process, bytes."""
        return _PROCESS_BYTES + sum(self.memory.values())

    def __str__(self) -> str:
        return (
            f"about {self.total / 2**30:.1f} GiB of memory per process, "
            f"{self.terrain_time:.1f} s to generate the terrain"
        )


def estimate(scenario: Any) -> ResourceEstimate:
    """Estimate peak memory of a flight of a scenario and the time to generate terrain.

    Only the headers of raster files are read. A raster that cannot be opened is not counted;
    loading the terrain reports it.
    """
    terrain = scenario.terrain.make()
    posts, read, area = 0.0, 0.0, 0.0
    memory: dict[str, float] = {}
    if hasattr(terrain, "posts"):
        with contextlib.suppress(InputError):
            read, posts = terrain.posts()
        area = posts * terrain.posting**2
        memory["terrain.path"] = _BYTES_PER_POST_READ * read
        detailed = getattr(terrain, "detail", True)
        per_post = _BYTES_PER_POST if detailed else _BYTES_PER_SPLINE_POST
        memory["terrain.posting_m"] = per_post * posts
    elif hasattr(terrain, "size") and hasattr(terrain, "posting"):
        finest = getattr(terrain, "detail_posting", None) or terrain.posting
        posts, area = (terrain.size / finest) ** 2, terrain.size**2
        memory["terrain.size_m"] = _BYTES_PER_POST * posts
    drawn_rocks = scenario.rocks.make()
    ends = np.array([drawn_rocks.min_diameter, drawn_rocks.max_diameter])
    density = -np.diff(golombek_number(ends, drawn_rocks.cover))[0] if drawn_rocks.cover else 0.0
    rocks = float(area * drawn_rocks.disc_area_ratio * density)
    memory["rocks.min_diameter_m"] = _BYTES_PER_ROCK * rocks
    if scenario.far_terrain is not None:
        around = scenario.far_terrain.make()
        levels = [(s / p) ** 2 for s, p in zip(around.sizes, around.postings, strict=True)]
        # Levels are generated one at a time; all are kept.
        drawn = _BYTES_PER_POST * max(levels, default=0.0)
        memory["far_terrain.sizes_m"] = drawn + _BYTES_PER_POST_KEPT * sum(levels)
        with contextlib.suppress(InputError):
            memory["far_terrain.path"] = _BYTES_PER_POST_READ * around.posts_read()
    for name, part in scenario.mappers.items():
        table = part.table.model_dump()
        if table.get("size_m") and table.get("posting_m"):
            cells = (table["size_m"] / table["posting_m"]) ** 2
            memory[f"mappers.{name}.size_m"] = _BYTES_PER_CELL * cells
    for name, part in scenario.sensors.items():
        table = part.table.model_dump()
        if "width" in table and "height" in table:
            pixels = table["width"] * table["height"]
            memory[f"sensors.{name}.width"] = _BYTES_PER_PIXEL * pixels
    time = _SECONDS_PER_POST * posts + _SECONDS_PER_POST_READ * read + _SECONDS_PER_ROCK * rocks
    return ResourceEstimate(memory, time)


def check_memory(scenario: Any) -> None:
    """Check that a scenario needs at most `MAX_MEMORY_BYTES` of memory.

    Raises
    ------
    InputError
        If the scenario needs more; the error names the key with the maximum memory.
    """
    found = estimate(scenario)
    if found.total > MAX_MEMORY_BYTES:
        key = max(found.memory, key=lambda one: found.memory[one])
        table, _, last = key.rpartition(".")
        value = getattr(_table(scenario, table), last)
        remedy = _REMEDIES.get(key) or _REMEDIES[last]
        raise InputError(
            key, value,
            f"needs too much memory: a flight would use {format_bytes(found.total)}, but the "
            "limit is "
            f"{format_bytes(MAX_MEMORY_BYTES)}",
            remedy,
        )  # fmt: skip


def _table(scenario: Any, name: str) -> Any:
    """Return the scenario table with a name such as ``terrain`` or ``mappers.dem``."""
    of, _, part = name.partition(".")
    found = getattr(scenario, of)
    return found[part] if part else found

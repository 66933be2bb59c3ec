"""Memory and time that a flight of a scenario takes, before anything large is made."""

from __future__ import annotations

import contextlib
from typing import Any, NamedTuple

import numpy as np

from lunarsim.errors import InputError
from lunarsim.grid import bytes_in_words
from lunarsim.rocks.laws import golombek_number

# Memory of one process at the peak. A scenario that needs more is refused.
MAX_MEMORY_BYTES = 16 * 2**30
# The process with its libraries and kernels, measured on a flight over 60 m of terrain.
_PROCESS_BYTES = 4e8
# Peak memory and time to make fractal relief with craters, measured with 2000 and 4000 posts along
# a side on one core.
_BYTES_PER_POST, _SECONDS_PER_POST = 144.0, 4.7e-7
# Peak memory of a spline through a raster without that.
_BYTES_PER_SPLINE_POST = 48.0
# Memory and time to read a post of a file, measured with 2000 posts along a side in degrees.
_BYTES_PER_POST_READ, _SECONDS_PER_POST_READ = 32.0, 2e-7
# Heights of the surroundings.
_BYTES_PER_POST_KEPT = 8.0
# Memory and time to place a rock, measured with 200,000 rocks on 60 m of terrain.
_BYTES_PER_ROCK, _SECONDS_PER_ROCK = 400.0, 5e-6
# Layers of a map with what its mapper keeps; an image with its intermediate results.
_BYTES_PER_CELL, _BYTES_PER_PIXEL = 100.0, 60.0

_REMEDIES = {
    "size_m": "Use a smaller value, or a larger posting_m or detail_m",
    "posting_m": "Use a larger value, or a part of the raster: terrain.dtm_window",
    "terrain.path": "Use a part of the raster: terrain.dtm_window",
    "surroundings.path": "Use a smaller raster",
    "min_diameter_m": "Use a larger value, or a smaller cover",
    "sizes_m": "Use smaller values or fewer levels",
    "width": "Use a smaller value, or a smaller height",
}


class Estimate(NamedTuple):
    """Memory at the peak by the key that sets it (bytes), and time to make the terrain (s)."""

    memory: dict[str, float]
    terrain_time: float

    @property
    def total(self) -> float:
        """Memory of a process at the peak, bytes."""
        return _PROCESS_BYTES + sum(self.memory.values())

    def __str__(self) -> str:
        return (
            f"about {self.total / 2**30:.1f} GiB of memory for each process, and "
            f"{self.terrain_time:.1f} s to make the terrain"
        )


def estimate(scenario: Any) -> Estimate:
    """Return what a flight of a scenario takes; of a raster, its header is read.

    A raster that cannot be opened is not counted: it is refused where it is loaded.
    """
    ground = scenario.terrain.make()
    posts, read, area = 0.0, 0.0, 0.0
    memory: dict[str, float] = {}
    if hasattr(ground, "posts"):
        with contextlib.suppress(InputError):
            read, posts = ground.posts()
        area = posts * ground.posting**2
        memory["terrain.path"] = _BYTES_PER_POST_READ * read
        detailed = getattr(ground, "detail", True)
        per_post = _BYTES_PER_POST if detailed else _BYTES_PER_SPLINE_POST
        memory["terrain.posting_m"] = per_post * posts
    elif hasattr(ground, "size") and hasattr(ground, "posting"):
        finest = getattr(ground, "detail_posting", None) or ground.posting
        posts, area = (ground.size / finest) ** 2, ground.size**2
        memory["terrain.size_m"] = _BYTES_PER_POST * posts
    drawn_rocks = scenario.rocks.make()
    ends = np.array([drawn_rocks.min_diameter, drawn_rocks.max_diameter])
    density = -np.diff(golombek_number(ends, drawn_rocks.cover))[0] if drawn_rocks.cover else 0.0
    rocks = float(area * drawn_rocks.share * density)
    memory["rocks.min_diameter_m"] = _BYTES_PER_ROCK * rocks
    if scenario.surroundings is not None:
        around = scenario.surroundings.make()
        levels = [(s / p) ** 2 for s, p in zip(around.sizes, around.postings, strict=True)]
        # One level at a time is drawn; all are kept.
        drawn = _BYTES_PER_POST * max(levels, default=0.0)
        memory["surroundings.sizes_m"] = drawn + _BYTES_PER_POST_KEPT * sum(levels)
        with contextlib.suppress(InputError):
            memory["surroundings.path"] = _BYTES_PER_POST_READ * around.posts_read()
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
    return Estimate(memory, time)


def check_memory(scenario: Any) -> None:
    """Refuse a scenario that needs more memory than `MAX_MEMORY_BYTES`.

    Raises
    ------
    InputError
        Naming the key that takes the most.
    """
    found = estimate(scenario)
    if found.total > MAX_MEMORY_BYTES:
        key = max(found.memory, key=lambda one: found.memory[one])
        table, _, last = key.rpartition(".")
        value = getattr(_table(scenario, table), last)
        remedy = _REMEDIES.get(key) or _REMEDIES[last]
        raise InputError(
            key, value,
            f"too large: a flight takes {bytes_in_words(found.total)} of memory, and "
            f"{bytes_in_words(MAX_MEMORY_BYTES)} is the limit. {remedy}",
        )  # fmt: skip


def _table(scenario: Any, name: str) -> Any:
    """Return a table such as ``terrain`` or ``mappers.dem``."""
    of, _, part = name.partition(".")
    found = getattr(scenario, of)
    return found[part] if part else found

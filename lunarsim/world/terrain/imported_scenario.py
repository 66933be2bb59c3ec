"""Scenario file over imported terrain, and its description."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np

from lunarsim.atomic_files import atomic_write_text
from lunarsim.world.terrain.terrain_import import LandingArea

# Grid spacing of the relief of the scenario: about this many points per side, but not finer than
# the default of measured terrain, m.
_RELIEF_POINTS, _MIN_POSTING_M = 4_000, 0.25


def area_description(area: LandingArea) -> Iterator[tuple[str, str]]:
    """Yield name and value of each property of an imported area."""
    n = len(area.heights)
    low, high = np.nanmin(area.heights), np.nanmax(area.heights)
    yield "source", f"{area.source}, {area.reference}, {area.source_posting:.4g} m between posts"
    if area.latitude is not None:
        yield "centre", f"latitude {area.latitude:.6f} deg, longitude {area.longitude:.6f} deg"
        yield "body", ", ".join(f"{key} = {value:.10g}" for key, value in area.body.items())
    yield "area", f"{n} x {n} posts, {area.posting:.4g} m apart, north up, azimuthal equidistant"
    yield "elevation", f"{low:.2f} to {high:.2f} m"
    yield "voids", _voids(area)
    yield "precision", _precision(area)
    yield (
        "roughness",
        (
            f"continued between the posts: RMS slope at 1 m {np.degrees(area.rms_slope):.2f} deg, "
            f"Hurst exponent {area.hurst:.2f} (from slopes over 1 to 8 posts)"
        ),
    )


def write_scenario(area: LandingArea, source: Path, out: Path) -> Path:
    """Write a scenario over an imported area; return the path of its raster.

    The raster has the name of the scenario file and the suffix ``.tif``. Existing files are
    replaced.
    """
    raster = out.with_suffix(".tif")
    area.write(raster)
    side = (len(area.heights) - 1) * area.posting
    posting = max(side / _RELIEF_POINTS, _MIN_POSTING_M)
    lines = [f"# Terrain of {source.name}"]
    lines += [f"# {name}: {value}" for name, value in area_description(area)]
    lines += [f"name = {_text(out.stem)}", 'description = "Imported terrain"', ""]
    if area.latitude is not None:
        longitude = (area.longitude + 180.0) % 360.0 - 180.0 if area.longitude is not None else 0.0
        lines += [
            "[site]", f"latitude_deg = {area.latitude:.9f}", f"longitude_deg = {longitude:.9f}",
            '# time = "2027-03-01T12:00Z"   # gives the directions of Sun and Earth', "",
        ]  # fmt: skip
    lines += ["[terrain]", 'kind = "dtm"', f"path = {_text(raster.name)}"]
    if area.latitude is None:
        lines.append(f"dtm_posting_m = {area.posting:.9g}")
    lines += [
        f"posting_m = {posting:.6g}", "detail = true             # relief between the posts",
        f"hurst = {area.hurst:.4f}", f"rms_slope_deg = {np.degrees(area.rms_slope):.4f}",
        "", "[rocks]", "cover = 0.02              # an assumption: heights do not show rocks", "",
    ]  # fmt: skip
    atomic_write_text(out, "\n".join(lines))
    return raster


def _voids(area: LandingArea) -> str:
    """Return a sentence about filled and remaining voids."""
    if area.largest_void == 0:
        return "none"
    return (
        f"{area.filled} posts filled by weighted distances, largest void {area.largest_void} "
        f"posts, {100.0 * area.missing:.3g} % of the area without a height"
    )


def _precision(area: LandingArea) -> str:
    """Return a sentence about the quantization of the heights."""
    if area.step is None:
        return "no quantization step"
    slope = np.degrees(np.arctan(area.step / area.source_posting))
    return (
        f"heights are multiples of {area.step:.4g} m; a step between two posts is {slope:.2g} deg"
    )


def _text(text: str) -> str:
    """Return a TOML string."""
    escaped = text.replace("\\", "\\\\").replace('"', '\\"')
    return f'"{escaped}"'

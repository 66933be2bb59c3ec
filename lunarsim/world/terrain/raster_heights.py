"""Read the heights of a raster in metres, and find missing heights."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from rasterio.io import DatasetReader
from rasterio.windows import Window

from lunarsim.errors import InputError, suggestion
from lunarsim.grid import format_bytes
from lunarsim.typing import Array, BoolArray
from lunarsim.world.terrain.raster_label import (
    declared_units,
    has_downward_heights,
    has_hexadecimal_no_data,
    special_values,
)

# Metres per unit, by the unit names used in files; `metres_in` normalizes a name first.
_METRES = {
    "m": 1.0, "metre": 1.0, "meter": 1.0,
    "km": 1000.0, "kilometre": 1000.0, "kilometer": 1000.0,
    "dm": 0.1, "decimetre": 0.1, "decimeter": 0.1,
    "cm": 0.01, "centimetre": 0.01, "centimeter": 0.01,
    "mm": 0.001, "millimetre": 0.001, "millimeter": 0.001,
    "ft": 0.3048, "foot": 0.3048, "feet": 0.3048, "international foot": 0.3048,
    "international feet": 0.3048, "foot international": 0.3048, "ift": 0.3048,
    "us survey foot": 1200 / 3937, "us survey feet": 1200 / 3937, "survey foot": 1200 / 3937,
    "survey feet": 1200 / 3937, "us foot": 1200 / 3937, "us feet": 1200 / 3937,
    "us ft": 1200 / 3937, "foot us": 1200 / 3937, "feet us": 1200 / 3937, "ftus": 1200 / 3937,
    "usft": 1200 / 3937, "foot us survey": 1200 / 3937, "ft us": 1200 / 3937,
    "yd": 0.9144, "yard": 0.9144, "in": 0.0254, "inch": 0.0254, "inches": 0.0254,
}  # fmt: skip
# Words in labels for a missing unit.
_NO_UNIT = {"", "n/a", "none", "null"}

# Float rasters from PDS mark missing heights by very large negative numbers, often undeclared.
_MISSING_BELOW = -1e30
# Limit of heights, which may be radii of the body, m.
_MAX_HEIGHT_M = 1e7
# Limit of the range of heights within one raster, m; no known body exceeds it.
_MAX_RELIEF_M = 1e5
# Values that programs customarily write for missing heights.
_CUSTOMARY_MARKERS = (
    -999, -9999, -99999, -999999, -32767, -32768, -(2**31), 9999, 99999, 32767, 65535, 2**31 - 1,
)  # fmt: skip
# The sorted heights of natural terrain have no large gaps. A minimum or maximum that is separated
# from all other heights is treated as an undeclared no-data value. Minimum gap for a customary
# marker, m:
_MIN_MARKER_GAP_M = 50.0
# Minimum gap for other values (0, for instance), m; the gap must also exceed the range of all
# other heights.
_MIN_OUTLIER_GAP_M = 500.0

# Maximum number of undeclared no-data values to find at each end, plus one.
_EXTREMES_PER_END = 8

# Posts read at a time, about 40 MB with their masks.
_POSTS_PER_BLOCK = 2_000_000


def metres_in(unit: str) -> float | None:
    """Return the length in metres of a unit given by name; None for unknown names."""
    words = " ".join(re.sub(r"[-_.()\s]+", " ", unit.lower().strip("\"' ")).split())
    return _METRES.get(words, _METRES.get(words.removesuffix("s")))


def check_count(field_name: str, value: object, rows: int, cols: int, remedy: str) -> None:
    """Raise InputError if a raster has over 400 million points (3 GB of memory).

    `field_name`, `value` and `remedy` are the fields of the error message.
    """
    max_posts = 400_000_000
    if rows * cols > max_posts:
        raise InputError(
            field_name, value,
            f"needs {rows} x {cols} grid points ({format_bytes(8.0 * rows * cols)}), but at most "
            f"{max_posts} points are read", remedy,
        )  # fmt: skip


@dataclass(frozen=True)
class HeightScale:
    """Conversion of a raster's raw values to heights in metres.

    height = (raw value * scale + offset) * metres

    Attributes
    ----------
    scale, offset
        Scale and offset stated by the file.
    unit
        Name of the unit; "m" if the file states none.
    metres
        Length of the unit, m.
    """

    scale: float
    offset: float
    unit: str
    metres: float

    @classmethod
    def of(cls, source: DatasetReader, unit: str | None) -> HeightScale:
        """Return the conversion that an open raster file states.

        `unit`, if given, replaces the unit stated by the file. An InputError is raised for an
        unknown unit, contradictory units, a scale that is not usable, and depths instead of
        heights.
        """
        scale, offset = float(source.scales[0]), float(source.offsets[0])
        if not (np.isfinite(scale) and np.isfinite(offset) and scale != 0.0):
            raise InputError(
                "terrain.path", source.name,
                f"must have a finite scale other than 0 and a finite offset, not {scale:g} and "
                f"{offset:g}",
            )  # fmt: skip
        if has_downward_heights(source):
            raise InputError(
                "terrain.path", source.name, "must have heights that increase upwards, not depths",
                "Change their sign: `gdal_calc.py -A FILE --calc=-A --outfile out.tif`.",
            )  # fmt: skip
        if unit is not None:
            metres = metres_in(unit)
            if metres is None:
                raise InputError(
                    "terrain.dtm_unit", unit, "must be a unit of length", suggestion(unit, _METRES)
                )
            return cls(scale, offset, unit, metres)
        names = [name for name in declared_units(source) if name.lower() not in _NO_UNIT]
        lengths = {name: metres_in(name) for name in names}
        for name, length in lengths.items():
            if length is None:
                raise InputError(
                    "terrain.path", source.name, f"has heights in an unknown unit {name!r}",
                    'Set terrain.dtm_unit ("m", "km", "ft", "us-ft").',
                )  # fmt: skip
        known_lengths = [length for length in lengths.values() if length is not None]
        if known_lengths and max(known_lengths) > (1.0 + 1e-9) * min(known_lengths):
            raise InputError(
                "terrain.path", source.name, f"states several units of height: "
                f"{', '.join(lengths)}", "Set terrain.dtm_unit to the right one.",
            )  # fmt: skip
        return cls(scale, offset, names[0] if names else "m", (known_lengths or [1.0])[0])

    def metres_of(self, numbers: Array | float) -> Array:
        """Convert raw values of the raster to heights in metres."""
        return np.asarray((np.asarray(numbers) * self.scale + self.offset) * self.metres)


@dataclass
class HeightStatistics:
    """Counts and extreme heights of a raster, accumulated block by block.

    Attributes
    ----------
    posts, known
        Number of grid points, and of grid points with a height.
    lowest, highest
        The eight lowest and the eight highest heights, m, with their counts; the extreme first.
    mean
        Mean height, m; 0 if there is none.
    """

    posts: int = 0
    known: int = 0
    mean: float = 0.0
    lowest: list[tuple[float, int]] = field(default_factory=list)
    highest: list[tuple[float, int]] = field(default_factory=list)

    def add(self, z: Array) -> None:
        """Include a block of heights `z`, m, with NaN where missing."""
        heights = z[np.isfinite(z)]
        self.posts += z.size
        self.known += heights.size
        if heights.size:
            self.mean += heights.size / self.known * (float(heights.mean()) - self.mean)
        self.lowest = _lowest_values(heights, self.lowest)
        negative = [(-value, count) for value, count in self.highest]
        self.highest = [(-value, count) for value, count in _lowest_values(-heights, negative)]

    @property
    def z_range(self) -> tuple[float, float]:
        """Minimum and maximum height, m; NaN if there is none."""
        return (self.lowest[0][0], self.highest[0][0]) if self.known else (np.nan, np.nan)


def _lowest_values(heights: Array, before: list[tuple[float, int]]) -> list[tuple[float, int]]:
    counts = dict(before)
    if len(before) == _EXTREMES_PER_END:
        heights = heights[heights <= before[-1][0]]
    for _ in range(_EXTREMES_PER_END):
        if heights.size == 0:
            break
        low = float(heights.min())
        above = heights[heights > low]
        counts[low] = counts.get(low, 0) + heights.size - above.size
        heights = above
    return sorted(counts.items())[:_EXTREMES_PER_END]


@dataclass(frozen=True)
class RasterHeights:
    """Reader of the heights of an open raster file.

    Attributes
    ----------
    source
        Open raster file.
    scale
        Conversion of raw values to metres.
    no_data
        Raw values that mean "no height", given by the user; None: values that resemble such a
        marker are found automatically and refused.
    """

    source: DatasetReader
    scale: HeightScale
    no_data: Sequence[float] | None

    def blocks(self, window: Window) -> Iterator[tuple[int, Array]]:
        """Yield the heights of a window block by block, with the block's first row.

        The row is relative to the window; the heights (rows, cols), m, are NaN where missing.
        """
        source = self.source
        masked = not has_hexadecimal_no_data(source)
        special = [*special_values(source), *(self.no_data or ())]
        step = max(1, _POSTS_PER_BLOCK // int(window.width))
        for top in range(0, int(window.height), step):
            rows = min(step, int(window.height) - top)
            part = Window(window.col_off, window.row_off + top, window.width, rows)
            raw = source.read(1, window=part, masked=masked)
            numbers = np.ma.getdata(raw)
            missing = np.ma.getmaskarray(raw) | ~(numbers > _MISSING_BELOW) | np.isinf(numbers)
            for value in special:
                missing |= _equal(numbers, value)
            with np.errstate(over="ignore", invalid="ignore"):  # masked, or refused by `check`
                z = self.scale.metres_of(numbers.astype(np.float64))
            z[missing] = np.nan
            yield top, z

    def extremes(self, window: Window) -> HeightStatistics:
        """Return height statistics of a window, without loading it into memory.

        Raises
        ------
        InputError
            If the window has implausible heights or an undeclared no-data value.
        """
        found = HeightStatistics()
        for _, z in self.blocks(window):
            found.add(z)
        self.check(found)
        return found

    def read(self, window: Window) -> Array:
        """Return the heights of a window (rows, cols), m; NaN where missing.

        Raises
        ------
        InputError
            If the window has too many points, no heights, implausible heights or an undeclared
            no-data value.
        """
        rows, cols = int(window.height), int(window.width)
        check_count("terrain.path", self.source.name, rows, cols, "Set terrain.dtm_window.")
        z, found = np.empty((rows, cols)), HeightStatistics()
        for top, block in self.blocks(window):
            found.add(block)
            z[top : top + len(block)] = block
        self.check(found)
        if not found.known:
            raise InputError(
                "terrain.path",
                self.source.name,
                "must contain elevations, but all its values mean 'no height'",
            )
        return z

    def check(self, statistics: HeightStatistics) -> None:
        """Raise InputError for undeclared no-data values and implausible heights.

        `statistics` are those of the heights to check; without a known height there is no error.
        Undeclared no-data values are searched for only if the user gave no values.
        """
        if not statistics.known:
            return
        low, high = statistics.z_range
        if self.no_data is None:
            self._check_marker(statistics.lowest, high, "below")
            self._check_marker(statistics.highest, low, "above")
        if max(-low, high) > _MAX_HEIGHT_M or high - low > _MAX_RELIEF_M:
            raise InputError(
                "terrain.path", self.source.name,
                f"has heights from {low:.6g} to {high:.6g} m, which no known body has",
                "Set terrain.dtm_nodata to the value that marks missing heights.",
            )  # fmt: skip

    def _check_marker(self, extreme: list[tuple[float, int]], opposite: float, side: str) -> None:
        """Raise InputError for extreme values that resemble a no-data marker.

        `extreme` are the extreme heights at one end (m) with their counts, `opposite` is the
        extreme height at the other end, and `side` is "below" or "above". A value resembles a
        marker if a large gap separates it from all other heights.
        """
        customary = self.scale.metres_of(np.array(_CUSTOMARY_MARKERS, dtype=np.float64))
        zero = self.scale.metres_of(0.0)
        for number, ((value, _), (following, _)) in enumerate(pairwise(extreme), start=1):
            gap, rest = abs(following - value), abs(opposite - following)
            limit = max(rest, _MIN_OUTLIER_GAP_M)
            if value in customary:
                limit = _MIN_MARKER_GAP_M
            elif value == zero and rest > 0.0:
                limit = max(rest, _MIN_MARKER_GAP_M)
            if gap > limit:
                self._refuse_markers(extreme[:number], gap, side)

    def _refuse_markers(self, found: list[tuple[float, int]], gap: float, side: str) -> None:
        numbers = [(z / self.scale.metres - self.scale.offset) / self.scale.scale for z, _ in found]
        if np.dtype(self.source.dtypes[0]).kind in "iu":
            numbers = [float(round(number)) for number in numbers]
        shown = [repr(float(number)).removesuffix(".0") for number in numbers]
        declared = f"[{', '.join(shown)}]" if len(numbers) > 1 else shown[0]
        count = sum(number for _, number in found)
        direction = "higher" if side == "below" else "lower"
        raise InputError(
            "terrain.path", self.source.name,
            f"has the value {' or '.join(shown)} at {count} point{'s' * (count > 1)}, and all "
            f"other heights are at least {gap:.6g} m {direction}",
            f"Set terrain.dtm_nodata = {declared}, or [] if these heights are real.",
        )  # fmt: skip


def _equal(numbers: NDArray[np.generic], value: float) -> BoolArray:
    """Return which numbers equal `value` after rounding it to their number type."""
    if numbers.dtype.kind == "f":
        with np.errstate(over="ignore"):
            value = float(numbers.dtype.type(value))
    return np.asarray(numbers == value)

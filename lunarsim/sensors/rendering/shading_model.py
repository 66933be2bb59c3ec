"""What of a light shaders are compiled for: the law of reflection and what shines besides."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from lunarsim.world.light import Light

Array = NDArray[np.float64]

# Strips of the Sun's disc in which its share is sounded, places in each, and those of the search
# before.
_STRIPS, _STEPS, _SEARCHES = 5, 5, 16
# Half the range of the field of mottles, standard deviations.
MOTTLE_RANGE = 4.0


@dataclass(frozen=True)
class ShadingModel:
    """Definitions for the shaders of one kind of light.

    Attributes
    ----------
    defines
        As the shaders take them; none for a point Sun over ground of one brightness.
    """

    defines: tuple[str, ...] = ()

    @classmethod
    def of(cls, light: Light) -> ShadingModel:
        """Return the definitions for a light; its directions are not in them, but the Earth's."""
        found = list(_hapke(light))
        if light.diameter > 0.0:
            found.append("SOFT")
        if light.scattered:
            found += ["GLOW", f"BOUNCE {_number(light.diffuse_albedo)}"]
        if light.earthshine > 0.0 and light.earth[2] > 0.0:
            found.append("EARTH " + ", ".join(map(_number, light.earthshine * light.earth)))
        if light.mottle > 0.0:
            found.append(f"MOTTLE {_number(2.0 * MOTTLE_RANGE * light.mottle)}")
        if light.boulder_mottle > 0.0 or light.boulder_albedo != 1.0:
            found.append("BOULDERS")
        return cls(tuple(found))

    def with_wide_penumbrae(self) -> ShadingModel:
        """Return the model for pictures in which penumbrae are wider than a texel."""
        more = (
            "WIDE", f"SEARCHES {_SEARCHES}", f"STRIPS {_STRIPS}", f"STEPS {_STEPS}",
            "SEARCH_PLACES " + _list(spiral(_SEARCHES)),
            "EVEN_PLACES " + _list(strips(_STRIPS, _STEPS)),
        )  # fmt: skip
        return replace(self, defines=(*self.defines, *more))

    @property
    def fine(self) -> bool:
        """Whether more shines than a Sun that is a point, on ground of one brightness."""
        names = {line.split()[0] for line in self.defines}
        return bool(names & {"SOFT", "GLOW", "EARTH", "MOTTLE", "BOULDERS"})

    def sources(self) -> tuple[str, ...]:
        """Return the files that say how a point is lit, in order."""
        files = ["light"]
        if any(line.startswith("HAPKE") for line in self.defines):
            files.append("hapke")
        if "SOFT" in self.defines:
            files.append("sun_disc")
        return (*files, "fine_radiance" if self.fine else "radiance")


def spiral(count: int) -> Array:
    """Return places (count, 2) spread evenly over the unit disc, along Vogel's spiral."""
    radius = np.sqrt((np.arange(count) + 0.5) / count)
    angle = np.pi * (3.0 - np.sqrt(5.0)) * np.arange(count)
    return np.asarray(radius[:, None] * np.column_stack((np.cos(angle), np.sin(angle))))


def strips(count: int, steps: int) -> Array:
    """Return places (count * steps, 2) on the unit disc, in strips of the same area along x.

    Each stands for the same area. Neighbouring strips are staggered, so that a straight edge across
    them passes one place at a time.
    """
    y = np.linspace(-1.0, 1.0, 4001)
    below = 0.5 + (y * np.sqrt(1.0 - y**2) + np.arcsin(y)) / np.pi
    middle = np.interp((np.arange(count) + 0.5) / count, below, y)
    # The middle strip first: neighbours are then far apart in the order.
    order = (2 * np.arange(count)) % count if count % 2 else np.arange(count)
    part = (np.arange(steps) + (order[:, None] + 0.5) / count) / steps
    x = np.sqrt(1.0 - middle[:, None] ** 2) * (2.0 * part - 1.0)
    return np.column_stack((x.ravel(), np.repeat(middle, steps)))


def _hapke(light: Light) -> Iterable[str]:
    if light.photometry != "hapke":
        return ()
    law = light.hapke()
    values = {
        "W": law.w, "B": law.b, "C": law.c, "SURGE": law.surge, "WIDTH": law.surge_width,
        "TAN": float(np.tan(law.roughness)),
    }  # fmt: skip
    return ("HAPKE", *(f"HAPKE_{name} {_number(value)}" for name, value in values.items()))


def _number(value: float) -> str:
    """Return a number as GLSL takes it."""
    return f"({float(value):.9e})"


def _list(places: Array) -> str:
    return ", ".join(f"vec2({x:.6f}, {y:.6f})" for x, y in places)

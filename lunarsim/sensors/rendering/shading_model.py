"""Light properties that shaders are compiled for."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np

from lunarsim.typing import Array
from lunarsim.world.light import Light

# Strips of the Sun's disc that are sampled, samples per strip, and samples of the blocker search.
_STRIPS, _STEPS, _SEARCHES = 5, 5, 16
# Half the range of the albedo field, standard deviations.
ALBEDO_FIELD_RANGE = 4.0


@dataclass(frozen=True)
class ShadingModel:
    """Preprocessor definitions of the shaders for one kind of light.

    Attributes
    ----------
    defines
        Lines of definitions; empty for a point Sun over terrain of uniform albedo.
    """

    defines: tuple[str, ...] = ()

    @classmethod
    def of(cls, light: Light, *, has_albedo_map: bool) -> ShadingModel:
        """Return the shader definitions for a light, and for terrain with an albedo map.

        They include the direction of the Earth, but not that of the Sun.
        """
        found = list(_hapke(light))
        if light.diameter > 0.0:
            found.append("SOFT")
        if light.scattered_light:
            found += ["GLOW", f"BOUNCE {_glsl_number(light.diffuse_albedo)}"]
        if light.earthshine > 0.0 and light.earth[2] > 0.0:
            found.append("EARTH " + ", ".join(map(_glsl_number, light.earthshine * light.earth)))
        if light.albedo_variation > 0.0:
            found.append(
                f"MOTTLE {_glsl_number(2.0 * ALBEDO_FIELD_RANGE * light.albedo_variation)}"
            )
        if has_albedo_map:
            found.append("ALBEDO_MAP")
        if light.boulder_albedo_variation > 0.0 or light.boulder_albedo != 1.0:
            found.append("BOULDERS")
        return cls(tuple(found))

    def with_wide_penumbrae(self) -> ShadingModel:
        """Return a copy for images in which penumbrae are wider than a texel."""
        more = (
            "WIDE", f"SEARCHES {_SEARCHES}", f"STRIPS {_STRIPS}", f"STEPS {_STEPS}",
            "SEARCH_PLACES " + _list(spiral(_SEARCHES)),
            "EVEN_PLACES " + _list(strips(_STRIPS, _STEPS)),
        )  # fmt: skip
        return replace(self, defines=(*self.defines, *more))

    @property
    def needs_fine_shading(self) -> bool:
        """Whether the light is more than a point Sun over terrain of uniform albedo.

        That is a Sun disc, scattered light, earthshine, or albedo that varies.
        """
        names = {line.split()[0] for line in self.defines}
        return bool(names & {"SOFT", "GLOW", "EARTH", "MOTTLE", "ALBEDO_MAP", "BOULDERS"})

    def sources(self) -> tuple[str, ...]:
        """Return the shader files that compute the radiance of a point, in order."""
        files = ["light"]
        if any(line.startswith("HAPKE") for line in self.defines):
            files.append("hapke")
        if "SOFT" in self.defines:
            files.append("sun_disc")
        return (*files, "fine_radiance" if self.needs_fine_shading else "radiance")


def spiral(count: int) -> Array:
    """Return points (count, 2) uniform over the unit disc, on Vogel's spiral."""
    radius = np.sqrt((np.arange(count) + 0.5) / count)
    angle = np.pi * (3.0 - np.sqrt(5.0)) * np.arange(count)
    return np.asarray(radius[:, None] * np.column_stack((np.cos(angle), np.sin(angle))))


def strips(count: int, steps: int) -> Array:
    """Return points (count * steps, 2) on the unit disc, in `count` strips along x.

    Each strip has `steps` points, and each point represents the same area. Neighbouring strips are
    staggered, so that a straight edge across them passes one point at a time.
    """
    y = np.linspace(-1.0, 1.0, 4001)
    below = 0.5 + (y * np.sqrt(1.0 - y**2) + np.arcsin(y)) / np.pi
    middle = np.interp((np.arange(count) + 0.5) / count, below, y)
    # Starting with the middle strip, neighbours are far apart in the order.
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
    return ("HAPKE", *(f"HAPKE_{name} {_glsl_number(value)}" for name, value in values.items()))


def _glsl_number(value: float) -> str:
    """Return a number as a GLSL literal."""
    return f"({float(value):.9e})"


def _list(places: Array) -> str:
    return ", ".join(f"vec2({x:.6f}, {y:.6f})" for x, y in places)

"""Mixture of rock shapes whose fractions are estimated from the shadows.

The length of a shadow depends on the height of the rock and on the slope of the terrain, its width
on that of the rock. The radius that belongs to a patch thus depends on the unknown shape and
slope. Each patch is evaluated under every hypothesis, a shape and a spread of slopes. The weight
of a hypothesis is its fraction in the population times the agreement of length and width under it.
The radius is the mean of the mixture; its variance includes the differences between hypotheses.
The fractions are estimated from the patches (expectation maximisation), starting with twice the
fraction for the shape that the mission expects.
"""

from __future__ import annotations

from copy import copy
from dataclasses import dataclass, fields
from typing import Any

import numpy as np

from lunarsim.onboard.perception.shadow_model import (
    ShadowModel,
    ShadowPatch,
    faceted_shadowless_fraction,
    tabulated_elevation,
)
from lunarsim.rocks.field import RockModel
from lunarsim.typing import Array

# Shapes of rocks: low and rounded; rounded or faceted and half as high as wide (the mean of lunar
# rocks is 0.54: Demidov and Basilevsky 2014); the same nearly as high as wide; embedded cubes;
# cubes on the surface. Shadows of the third are 0.6 to 0.75 as long and as wide as those of a cube
# of the same radius, so the radius would be a third too small if the rock were taken for a cube.
LOW_POWER = RockModel("ellipsoid", height_ratio=(0.4, 0.05), burial=(0.0, 0.0))
SHAPES = (
    LOW_POWER,
    RockModel("mixed", height_ratio=(0.5, 0.1), burial=(0.0, 0.0)),
    RockModel("mixed", height_ratio=(0.8, 0.1), burial=(0.0, 0.0)),
    RockModel("cube", burial=(0.2, 0.5)),
    RockModel("cube", burial=(0.0, 0.0)),
)
# Half spheres are included only where the mission expects them. Their shadows have the same ratio
# of length to width as embedded cubes of two thirds of their radius, so only the expectation
# separates the two.
HALF_SPHERE = RockModel("hemisphere", burial=(0.0, 0.0))
# Spreads of the terrain slope, tangents.
SLOPES = np.array([0.0, 0.06, 0.15])
# Number of patches that the prior is worth.
_PRIOR_WEIGHT = 30.0
# Factor by which the weight of earlier images decreases with each image, because they were
# evaluated with less accurate fractions.
_MEMORY = 0.8
# Minimum fraction, since unobserved shapes may still appear.
_MIN_SHARE = 0.01
# Minimum q of patches that carry information about shapes.
_MIN_Q = 4.0
_MIN_LENGTH = 0.05
# Fields of a patch that are averaged over shapes.
_AVERAGED = ("along", "across", "length", "width", "skew", "area")
# Shapes below this weight are ignored for the largest rock that a patch may be the shadow of;
# number of standard deviations added to its radius.
_MIN_WEIGHT = 0.03
_LARGEST_SIGMAS = 2.0


@dataclass(frozen=True)
class RadiusEstimate:
    """Radii of rocks, estimated from dark patches under all shape hypotheses.

    Attributes
    ----------
    radius, sigma
        Radius of the rocks and its standard deviation (n,), m.
    largest
        Longest half axis of the largest rock that may cast the shadow, under any hypothesis that is
        not improbable (n,), m.
    unit
        Expected patch of a rock of radius 1, mean over the hypotheses (n,).
    weight
        Probabilities of the hypotheses (n, hypotheses).
    """

    radius: Array
    sigma: Array
    largest: Array
    unit: ShadowPatch
    weight: Array


class ShapeMixture:
    """Model of dark patches of rocks of unknown shape on terrain of unknown slope.

    The fractions of shapes and slopes are estimated from observed patches. The other attributes are
    those of `ShadowModel`, averaged over the estimated population.

    Parameters
    ----------
    elevation
        Sun elevation, rad, from 2 to 80 degrees.
    expected_shape
        Shape that the mission expects; None: no expectation.

    Attributes
    ----------
    models
        Shadow model of each shape.
    """

    def __init__(self, elevation: float, expected_shape: str | None = None) -> None:
        if expected_shape is not None:
            RockModel(expected_shape)  # type: ignore[arg-type]  # raises for an unknown shape
        self.elevation = elevation
        shapes = (*SHAPES, HALF_SPHERE) if expected_shape == HALF_SPHERE.shape else SHAPES
        self.models = tuple(ShadowModel(elevation, shape) for shape in shapes)
        self.slopes = SLOPES
        cubes = np.array([shape.shape == "cube" for shape in shapes])
        # Low rocks use the mean height, because most of them are round.
        heights = [max(shape.height_ratio, RockModel.height_ratio) for shape in shapes]
        bare = [faceted_shadowless_fraction(round(elevation, 3), height) for height in heights]
        self._shadowless = np.where(cubes, 0.0, bare)
        share = np.ones(len(shapes))
        if expected_shape is not None:
            share[cubes == (expected_shape == "cube")] = 2.0
        start = np.repeat(share / share.sum(), len(SLOPES)) / len(SLOPES)
        self._prior = _PRIOR_WEIGHT * start
        self._observed_weight = np.zeros_like(self._prior)

    @classmethod
    def known(cls, model: ShadowModel) -> ShapeMixture:
        """Return a mixture of one shape on horizontal terrain, from its shadow model."""
        one = cls.__new__(cls)
        one.elevation, one.models = model.elevation, (model,)
        one.slopes, one._prior, one._observed_weight = np.zeros(1), np.ones(1), np.zeros(1)
        one._shadowless = np.array([model.shadowless_fraction])
        return one

    def under(self, elevation: float) -> ShapeMixture:
        """Return the current population under another Sun elevation (rad).

        The elevation is rounded to the steps of `tabulated_elevation`.
        """
        near = tabulated_elevation(elevation, self.elevation)
        if near == self.elevation:
            return self
        other = copy(self)
        other.elevation = near
        other.models = tuple(model.under(near) for model in self.models)
        return other

    @property
    def hypothesis_fractions(self) -> Array:
        """Estimated fraction of rocks under each hypothesis about shape and slope.

        Shape (shapes * slopes,), slopes varying fastest.
        """
        count = self._prior + self._observed_weight
        share = np.maximum(count / count.sum(), _MIN_SHARE)
        return np.asarray(share / share.sum())

    @property
    def shape_fractions(self) -> Array:
        """Estimated fraction of rocks of each shape (shapes,)."""
        return np.asarray(self.hypothesis_fractions.reshape(len(self.models), -1).sum(1))

    @property
    def slope(self) -> float:
        """Estimated root mean square of the terrain slope, tangent."""
        return float(
            np.sqrt(self.hypothesis_fractions.reshape(len(self.models), -1).sum(0) @ self.slopes**2)
        )

    @property
    def shadowless_fraction(self) -> float:
        """Fraction of the rocks that have no dark area at this Sun elevation.

        Such rocks cannot be observed, so their shapes cannot either: all rocks except cubes are
        taken as faceted.
        """
        return float(self.shape_fractions @ self._shadowless)

    def _mean(self, name: str) -> float:
        """Return the mean of an attribute of `ShadowModel` over the shapes."""
        return float(self.shape_fractions @ np.array([getattr(m, name) for m in self.models]))

    @property
    def height(self) -> float:
        """Mean height of the rocks above the terrain, in radii."""
        return self._mean("height")

    @property
    def radius_sigma(self) -> float:
        """Standard deviation of a radius that more observations do not reduce, in radii.

        It is due to the unknown shape of a rock, a mean over the shapes.
        """
        return self._mean("radius_sigma")

    @property
    def centre_sigma(self) -> float:
        """Standard deviation of a centre that more observations do not reduce, in radii.

        It is per axis and due to the unknown shape of a rock, a mean over the shapes.
        """
        return self._mean("centre_sigma")

    @property
    def outline(self) -> tuple[float, float]:
        """Mean and standard deviation of the distance from centre to outline, in radii."""
        mean, sigma = np.array([m.outline for m in self.models]).T
        middle = float(self.shape_fractions @ mean)
        return middle, float(np.sqrt(self.shape_fractions @ (sigma**2 + (mean - middle) ** 2)))

    def probability_longer_than(self, half_axis: float, radius: Array, sigma: Array) -> Array:
        """Return the probability that rocks exceed a half axis, averaged over shapes (n,).

        `half_axis` is the limit of the longer half axis, m; `radius` and `sigma` (n,) are the radii
        of the rocks and their standard deviations, m.
        """
        of_shape = [m.probability_longer_than(half_axis, radius, sigma) for m in self.models]
        return np.asarray(self.shape_fractions @ np.stack(of_shape))

    def patch(self, azimuth: Any, depression: Any) -> ShadowPatch:
        """Return the mean dark patches of the population seen from given directions (...).

        `azimuth` is that of the camera from the rock minus that of the Sun, and `depression` that
        of the line of sight (...), rad. The patches are for rocks of radius 1.
        """
        units = [m.patch(azimuth, depression) for m in self.models]
        return _mean_patch(units, self.shape_fractions)

    def visible_q(self, radius: Any, azimuth: Any, depression: Any, pixel: Any) -> Array:
        """Return q, the square root of the number of dark pixels of a rock's patch (...).

        `radius` is that of the rocks, m, and `pixel` the size of a pixel across the line of sight
        at the rock, m. `azimuth` is that of the camera from the rock minus that of the Sun, and
        `depression` that of the line of sight, rad. All are (...); the patch is the mean over the
        shapes.
        """
        # Terrain above the camera is not visible.
        area = self.patch(azimuth, depression).area * np.sin(np.maximum(depression, 0.0))
        return np.asarray(np.asarray(radius) * np.sqrt(area) / pixel)

    def estimate_radius(
        self,
        length: Array,
        width: Array,
        azimuth: Array,
        depression: Array,
        along_px: Array,
        across_px: Array,
        end_sigma: float,
    ) -> RadiusEstimate:
        """Estimate the radii of rocks from length and width of their dark patches.

        Parameters
        ----------
        length, width
            Size of the patches (n,), m.
        azimuth, depression
            Azimuth of the camera from the rock minus that of the Sun, and depression of the line of
            sight (n,), rad.
        along_px, across_px
            Size of a pixel on the terrain along the Sun and across (n,), m.
        end_sigma
            Standard deviation of the position of an end of a patch, pixels.
        """
        units = [m.patch(azimuth, depression) for m in self.models]
        # A slope lengthens the shadow on the terrain, and its image at a grazing angle.
        lean = 1.0 / np.tan(self.elevation) + np.abs(np.cos(azimuth)) / np.tan(
            np.maximum(depression, 0.1)
        )
        radii, variances, fits = [], [], []
        for unit in units:
            ends = end_sigma * np.sqrt(2.0)
            for slope in self.slopes:
                r, v, fit = _radius_of_patch(
                    length, width, unit, ends * along_px, ends * across_px, slope * lean
                )
                radii.append(r)
                variances.append(v)
                fits.append(fit)
        log = np.stack(fits, -1) + np.log(self.hypothesis_fractions)
        weight = np.exp(log - log.max(-1, keepdims=True))
        weight /= weight.sum(-1, keepdims=True)
        r, v = np.stack(radii, -1), np.stack(variances, -1)
        radius = (weight * r).sum(-1)
        variance = (weight * (v + (r - radius[:, None]) ** 2)).sum(-1)
        shape_weight = weight.reshape(len(length), len(units), len(self.slopes)).sum(-1)
        largest = self._largest(r + _LARGEST_SIGMAS * np.sqrt(v), weight, shape_weight)
        return RadiusEstimate(
            radius, np.sqrt(variance), largest, _mean_patch(units, shape_weight), weight
        )

    def _largest(self, radius: Array, weight: Array, shape_weight: Array) -> Array:
        """Return the longest half axis of rocks under any probable hypothesis (n,), m.

        `radius` (n, hypotheses) is the upper limit of the radius under each, m; `weight` (n,
        hypotheses) and `shape_weight` (n, shapes) are the probabilities of hypotheses and shapes.
        The threshold applies to the total weight of a shape, so that it does not depend on the
        number of slopes.
        """
        slopes = len(self.slopes)
        longest = np.repeat([m.elongation for m in self.models], slopes)
        # Slopes of a possible shape count only if they are not improbable themselves.
        possible = np.repeat(shape_weight > _MIN_WEIGHT, slopes, axis=-1)
        possible &= weight > _MIN_WEIGHT / slopes
        return np.asarray((longest * np.where(possible, radius, 0.0)).max(-1))

    def update_fractions(self, weight: Array, q: Array) -> None:
        """Update the fractions of shapes and slopes with the patches of one image.

        `weight` (n, hypotheses) are the probabilities of the hypotheses for each patch, and `q`
        (n,) is the square root of its number of dark pixels; small patches are ignored.
        """
        self._observed_weight = _MEMORY * self._observed_weight + weight[q >= _MIN_Q].sum(0)


def _radius_of_patch(
    length: Array,
    width: Array,
    unit_patch: ShadowPatch,
    along_sigma: Array,
    across_sigma: Array,
    slope_elongation: Array,
) -> tuple[Array, Array, Array]:
    """Return radius, its variance and log likelihood for patches under one hypothesis.

    All are (n,); `length` and `width` (n,), m, are the measured sizes, and `unit_patch` is the
    expected patch for a radius of 1. Length and width each give a radius, with a variance from
    pixel noise (`along_sigma`, `across_sigma`, m), the spread of shapes and, for the length, the
    relative elongation by slopes. The result is their mean weighted by inverse variance; the
    likelihood grows with their agreement.
    """
    l0, w0 = np.maximum(unit_patch.length, _MIN_LENGTH), np.maximum(unit_patch.width, _MIN_LENGTH)
    by_length, by_width = length / l0, width / w0
    var_length = (along_sigma**2 + (by_length * unit_patch.length_sigma) ** 2) / l0**2
    var_length += (by_length * slope_elongation) ** 2
    var_width = (across_sigma**2 + (by_width * unit_patch.width_sigma) ** 2) / w0**2
    total = var_length + var_width
    radius = (var_width * by_length + var_length * by_width) / total
    fit = -0.5 * (by_length - by_width) ** 2 / total - 0.5 * np.log(total)
    # Densities refer to metres, and the prior of the radius is uniform in its logarithm.
    fit -= np.log(l0 * w0 * np.maximum(radius, 1e-3))
    return radius, var_length * var_width / total, fit


def _mean_patch(unit_patches: list[ShadowPatch], fractions: Array) -> ShadowPatch:
    """Return the mean of expected patches over shapes, weighted by fractions.

    `unit_patches` are the patches for rocks of radius 1, one per shape; `fractions` is (shapes,) or
    (n, shapes). The standard deviations include the differences between shapes.
    """
    stack = {
        f.name: np.stack([getattr(u, f.name) for u in unit_patches], -1)
        for f in fields(ShadowPatch)
    }
    mean = {k: (fractions * stack[k]).sum(-1) for k in _AVERAGED}
    sigma = {
        f"{k}_sigma": np.sqrt(
            (fractions * (stack[f"{k}_sigma"] ** 2 + (stack[k] - mean[k][..., None]) ** 2)).sum(-1)
        )
        for k in ("along", "across", "length", "width")
    }
    return ShadowPatch(**mean, **sigma)

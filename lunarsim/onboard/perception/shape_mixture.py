"""Rocks of shapes that are not known: a mixture whose shares the shadows themselves tell.

The length of a shadow is that of the rock's height and of how the ground falls away, its width that
of the rock. What radius a patch stands for thus depends on the shape of the rock and on the slope
of the ground, and neither is known. Here each patch is read under every hypothesis, a shape and a
spread of slopes; a hypothesis counts by its share in the population times how well length and width
agree under it, and the radius is that of the mixture, with what the hypotheses differ by in its
variance. The shares follow from what is seen (expectation maximisation), from a start that gives
the told shape twice the share of another.
"""

from __future__ import annotations

from copy import copy
from dataclasses import dataclass, fields
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lunarsim.onboard.perception.shadow_model import (
    ShadowModel,
    ShadowPatch,
    faceted_shadowless_fraction,
    near_elevation,
)
from lunarsim.rocks.field import RockModel

Array = NDArray[np.float64]

# Shapes that rocks may have: low and rounded, rounded or faceted and half as high as wide (the mean
# of lunar rocks is 0.54: Demidov and Basilevsky 2014), the same nearly as high as wide, cubes sunk
# in and cubes that lie on top. Shadows of the third are 0.6 to 0.75 as long and as wide as those of
# a cube of the same radius: read as a cube it would be a third too small.
LOW = RockModel("ellipsoid", height_ratio=(0.4, 0.05), burial=(0.0, 0.0))
SHAPES = (
    LOW,
    RockModel("mixed", height_ratio=(0.5, 0.1), burial=(0.0, 0.0)),
    RockModel("mixed", height_ratio=(0.8, 0.1), burial=(0.0, 0.0)),
    RockModel("cube", burial=(0.2, 0.5)),
    RockModel("cube", burial=(0.0, 0.0)),
)
# And half spheres, where the mission expects them: their shadows are as long over as wide as those
# of cubes sunk in, of two thirds of their radius, and only what is expected tells the two apart.
HALF_SPHERE = RockModel("hemisphere", burial=(0.0, 0.0))
# Spreads of the ground's slope, tangents.
SLOPES = np.array([0.0, 0.06, 0.15])
# The start counts as much as so many patches.
_PRIOR_WEIGHT = 30.0
# What earlier pictures said, read under shares that were less well known, counts by this factor
# less with each picture.
_MEMORY = 0.8
# No share falls below this: what has not been seen yet may come.
_MIN_SHARE = 0.01
# Patches of fewer pixels across say nothing of shapes.
_MIN_Q = 4.0
_MIN_LENGTH = 0.05
# What of a patch is averaged over shapes.
_AVERAGED = ("along", "side", "length", "width", "skew", "area")
# A shape of less weight, over all slopes together, is left out of the largest rock that a patch may
# be the shadow of, which is so many standard deviations larger than it seems.
_MIN_WEIGHT = 0.03
_LARGEST_SIGMAS = 2.0


@dataclass(frozen=True)
class RadiusEstimate:
    """Patches read under all hypotheses.

    Attributes
    ----------
    radius, sigma
        Of the rocks (n,), m.
    largest
        Longest half axis of the largest rocks that they may be the shadows of, under any hypothesis
        that is not improbable (n,), m.
    unit
        Patch of a rock of radius 1, mean over the hypotheses of each patch (n,).
    weight
        Of the hypotheses (n, hypotheses).
    """

    radius: Array
    sigma: Array
    largest: Array
    unit: ShadowPatch
    weight: Array


class ShapeMixture:
    """Dark patches of rocks whose shapes, and the ground's slopes, are inferred.

    Parameters
    ----------
    elevation
        Of the Sun, rad, from 2 to 80 degrees.
    told
        Shape that the mission expects; None: it expects none.

    Attributes
    ----------
    models
        Of each shape.

    The rest as in `ShadowModel`, for the population as it is known.
    """

    def __init__(self, elevation: float, expected_shape: str | None = None) -> None:
        if expected_shape is not None:
            RockModel(expected_shape)  # type: ignore[arg-type]  # refuses a shape that there is not
        self.elevation = elevation
        shapes = (*SHAPES, HALF_SPHERE) if expected_shape == HALF_SPHERE.shape else SHAPES
        self.models = tuple(ShadowModel(elevation, shape) for shape in shapes)
        self.slopes = SLOPES
        cubes = np.array([shape.shape == "cube" for shape in shapes])
        # Low ones are taken to be as high as rocks are in the mean: most of them are round.
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
        """Return the mixture of one shape on level ground."""
        one = cls.__new__(cls)
        one.elevation, one.models = model.elevation, (model,)
        one.slopes, one._prior, one._observed_weight = np.zeros(1), np.ones(1), np.zeros(1)
        one._shadowless = np.array([model.shadowless_fraction])
        return one

    def under(self, elevation: float) -> ShapeMixture:
        """Return the population as it is known, its shadows under a Sun of another elevation (rad).

        Elevations are taken in steps from this one's, see `near_elevation`.
        """
        near = near_elevation(elevation, self.elevation)
        if near == self.elevation:
            return self
        other = copy(self)
        other.elevation = near
        other.models = tuple(model.under(near) for model in self.models)
        return other

    @property
    def shares(self) -> Array:
        """Of the hypotheses in the population (shapes * slopes,), slopes varying fastest."""
        count = self._prior + self._observed_weight
        share = np.maximum(count / count.sum(), _MIN_SHARE)
        return np.asarray(share / share.sum())

    @property
    def shape_shares(self) -> Array:
        """Of the shapes (shapes,)."""
        return np.asarray(self.shares.reshape(len(self.models), -1).sum(1))

    @property
    def slope(self) -> float:
        """Spread of the ground's slope as the shadows tell it, tangent."""
        return float(np.sqrt(self.shares.reshape(len(self.models), -1).sum(0) @ self.slopes**2))

    @property
    def bare(self) -> float:
        """Share of the rocks that show nothing dark under this Sun.

        They do not tell of themselves, so all but cubes are taken to be faceted.
        """
        return float(self.shape_shares @ self._shadowless)

    def _mean(self, name: str) -> float:
        return float(self.shape_shares @ np.array([getattr(m, name) for m in self.models]))

    @property
    def height(self) -> float:
        """Mean height above the ground, in radii."""
        return self._mean("height")

    @property
    def radius_sigma(self) -> float:
        """What stays unknown of a radius however often a rock is seen, in radii."""
        return self._mean("radius_sigma")

    @property
    def centre_sigma(self) -> float:
        """What stays unknown of a centre, an axis, however often a rock is seen, in radii."""
        return self._mean("centre_sigma")

    @property
    def outline(self) -> tuple[float, float]:
        """Mean and standard deviation of the distance from centre to outline, in radii."""
        mean, sigma = np.array([m.outline for m in self.models]).T
        middle = float(self.shape_shares @ mean)
        return middle, float(np.sqrt(self.shape_shares @ (sigma**2 + (mean - middle) ** 2)))

    def probability_longer_than(self, half_axis: float, radius: Array, sigma: Array) -> Array:
        """Return the probability that rocks are so long, over the shapes' shares (n,).

        See `ShadowModel.as_long_as`.
        """
        of_shape = [m.probability_longer_than(half_axis, radius, sigma) for m in self.models]
        return np.asarray(self.shape_shares @ np.stack(of_shape))

    def patch(self, azimuth: Any, depression: Any) -> ShadowPatch:
        """Return the mean patches of the population seen from given directions (...).

        See `ShadowModel.patch`.
        """
        units = [m.patch(azimuth, depression) for m in self.models]
        return _mean_patch(units, self.shape_shares)

    def visible_pixels(self, radius: Any, azimuth: Any, depression: Any, pixel: Any) -> Array:
        """Return q (...), see `ShadowModel.visible_pixels`."""
        # Of ground above the camera nothing is seen.
        area = self.patch(azimuth, depression).area * np.sin(np.maximum(depression, 0.0))
        return np.asarray(np.asarray(radius) * np.sqrt(area) / pixel)

    def read(
        self,
        length: Array,
        width: Array,
        azimuth: Array,
        depression: Array,
        along_px: Array,
        across_px: Array,
        pixel: float,
    ) -> RadiusEstimate:
        """Return what radii patches stand for.

        Parameters
        ----------
        length, width
            Of the patches (n,), m.
        azimuth, depression
            See `ShadowModel.patch` (n,), rad.
        along_px, across_px
            Size of a pixel there (n,), m.
        pixel
            Standard deviation of an end of a patch, pixels.
        """
        units = [m.patch(azimuth, depression) for m in self.models]
        # A slope stretches the shadow on the ground, and what is seen of it at a grazing angle.
        lean = 1.0 / np.tan(self.elevation) + np.abs(np.cos(azimuth)) / np.tan(
            np.maximum(depression, 0.1)
        )
        radii, variances, fits = [], [], []
        for unit in units:
            ends = pixel * np.sqrt(2.0)
            for slope in self.slopes:
                r, v, fit = _radius_of_patch(
                    length, width, unit, ends * along_px, ends * across_px, slope * lean
                )
                radii.append(r)
                variances.append(v)
                fits.append(fit)
        log = np.stack(fits, -1) + np.log(self.shares)
        weight = np.exp(log - log.max(-1, keepdims=True))
        weight /= weight.sum(-1, keepdims=True)
        r, v = np.stack(radii, -1), np.stack(variances, -1)
        radius = (weight * r).sum(-1)
        variance = (weight * (v + (r - radius[:, None]) ** 2)).sum(-1)
        of_shape = weight.reshape(len(length), len(units), len(self.slopes)).sum(-1)
        largest = self._largest(r + _LARGEST_SIGMAS * np.sqrt(v), weight, of_shape)
        return RadiusEstimate(
            radius, np.sqrt(variance), largest, _mean_patch(units, of_shape), weight
        )

    def _largest(self, radius: Array, weight: Array, of_shape: Array) -> Array:
        """Return the longest half axis under any hypothesis that is not improbable (n,), m.

        `radius` (n, hypotheses) is the largest under each. That a shape is likely does not hang on
        into how many slopes its weight is divided.
        """
        slopes = len(self.slopes)
        longest = np.repeat([m.elongation for m in self.models], slopes)
        # Of a possible shape those slopes count that are not improbable themselves.
        possible = np.repeat(of_shape > _MIN_WEIGHT, slopes, axis=-1)
        possible &= weight > _MIN_WEIGHT / slopes
        return np.asarray((longest * np.where(possible, radius, 0.0)).max(-1))

    def learn(self, weight: Array, q: Array) -> None:
        """Take in what patches (n, hypotheses) of q pixels (n,) say of the population."""
        self._observed_weight = _MEMORY * self._observed_weight + weight[q >= _MIN_Q].sum(0)


def _radius_of_patch(
    length: Array, width: Array, unit: ShadowPatch, along: Array, across: Array, stretch: Array
) -> tuple[Array, Array, Array]:
    """Return radius, its variance and the logarithm of the likelihood of patches (n,).

    Length and width each give a radius, with a variance from the pixels (standard deviations
    `along` and `across`, m), the spread of shapes and the share by which slopes stretch the length;
    they are averaged by their variances, and are the likelier the better they agree.
    """
    l0, w0 = np.maximum(unit.length, _MIN_LENGTH), np.maximum(unit.width, _MIN_LENGTH)
    by_length, by_width = length / l0, width / w0
    var_length = (along**2 + (by_length * unit.length_sigma) ** 2) / l0**2
    var_length += (by_length * stretch) ** 2
    var_width = (across**2 + (by_width * unit.width_sigma) ** 2) / w0**2
    total = var_length + var_width
    radius = (var_width * by_length + var_length * by_width) / total
    fit = -0.5 * (by_length - by_width) ** 2 / total - 0.5 * np.log(total)
    # The same patch in units of another shape: densities are of metres, radii even in their log.
    fit -= np.log(l0 * w0 * np.maximum(radius, 1e-3))
    return radius, var_length * var_width / total, fit


def _mean_patch(units: list[ShadowPatch], share: Array) -> ShadowPatch:
    """Return the mean patch over shapes, their shares (shapes,) or (n, shapes)."""
    stack = {f.name: np.stack([getattr(u, f.name) for u in units], -1) for f in fields(ShadowPatch)}
    mean = {k: (share * stack[k]).sum(-1) for k in _AVERAGED}
    sigma = {
        f"{k}_sigma": np.sqrt(
            (share * (stack[f"{k}_sigma"] ** 2 + (stack[k] - mean[k][..., None]) ** 2)).sum(-1)
        )
        for k in ("along", "side", "length", "width")
    }
    return ShadowPatch(**mean, **sigma)

"""What stands out on a map, and how well scanned ground fits it at a place."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from lunarsim.errors import InputError
from lunarsim.messages.prior_map import PriorMap
from lunarsim.onboard.navigation import _place_kernels as k
from lunarsim.onboard.navigation.features import above_plane

Array = NDArray[np.float64]
IntArray = NDArray[np.int64]

# Up to such posts rocks and small craters stand out, m; a scan covers many of them.
_FINE = 1.0
# Places that stand for all of a map, to tell how well ground fits where it does not belong.
_SAMPLE = 2048


@dataclass(frozen=True)
class FeatureSettings:
    """How places are judged.

    Attributes
    ----------
    width
        What is wider is no feature, m; at least 4 posts either way, and at most 8: where posts are
        wide they tell by swells, which what was swept covers.
    changed
        Probability that the map shows another ground than there is under a tile.
    outlier
        Share of posts that do not agree though the tile does: shadows of rocks, single changes.
    model_sigma
        What else sets a scan's mean over a post's square apart from the post, m.
    alike
        Over such a length posts agree or fail as one, m: a rock hides the ground behind it.

    Raises
    ------
    InputError
        If one is out of range.
    """

    width: float = 50.0
    changed: float = 0.2
    outlier: float = 0.05
    model_sigma: float = 0.03
    alike: float = 0.7

    def __post_init__(self) -> None:
        for name in ("changed", "outlier"):
            if not 0.0 < getattr(self, name) < 1.0:
                raise InputError(f"features.{name}", getattr(self, name), "between 0 and 1")
        for name in ("width", "model_sigma", "alike"):
            if not 0.0 < getattr(self, name) < np.inf:
                raise InputError(f"features.{name}", getattr(self, name), "a positive number")


@dataclass(frozen=True)
class Tile:
    """Scanned posts that are compared as one.

    Attributes
    ----------
    height
        Above the plane around (r, c), m.
    weight
        1 where a post is compared, else 0 (r, c).
    variance
        Of a residual (r, c), m^2.
    """

    height: Array
    weight: Array
    variance: Array


@dataclass(frozen=True)
class _Density:
    """How common heights above the planes around are on a map.

    Attributes
    ----------
    height
        Ascending (n,), m.
    rare
        Logarithm of one over their density (n,), in 1 / m.
    """

    height: Array
    rare: Array

    @classmethod
    def of(cls, values: Array, sigma: float) -> _Density:
        """Return the density of heights (m,) that err by `sigma`."""
        width = 0.2 * sigma
        top = float(np.abs(values).max()) if len(values) else sigma
        top = min(top + 4.0 * sigma, 2000.0 * width)
        edges = np.arange(-top, top + width, width)
        count, _ = np.histogram(np.clip(values, -top, top), edges)
        density = ndimage.gaussian_filter1d(count / (max(len(values), 1) * width), 1.5)
        # What the map shows nowhere may still be somewhere.
        density += 1e-3 / (2.0 * top)
        return cls(0.5 * (edges[1:] + edges[:-1]), -np.log(density))

    def rarity(self, height: Array) -> Array:
        """Return the logarithm of one over the density of heights, in 1 / m."""
        return np.asarray(np.interp(height, self.height, self.rare))


class MapFeatures:
    """A map as scanned ground is compared with it.

    How likely is what the map shows at a place if the tile lies there, against what the map shows
    anywhere? Noise agrees with flat ground everywhere, so only features tell; and since features
    come in clusters, a tile's likelihood is taken relative to its mean over places all over the
    map: on average over those it tells nothing.

    Parameters
    ----------
    prior
        The map.
    settings
        How places are judged.

    Attributes
    ----------
    shown, kept
        Heights above the planes around, m, and 1 where there are any, else 0 (rows, cols).
    reach
        Planes are fitted to so many posts either way.
    together
        So many posts agree or fail as one.
    """

    def __init__(self, prior: PriorMap, settings: FeatureSettings | None = None) -> None:
        self.prior = prior
        self.settings = settings or FeatureSettings()
        posting = prior.grid.posting
        half = 0.5 * self.settings.width / posting
        self.reach = 4 if posting <= _FINE else int(np.clip(round(half), 4, 8))
        self.together = max(1.0, (self.settings.alike / posting) ** 2, prior.together)
        shown, kept = above_plane(prior.elevation, np.isfinite(prior.elevation), self.reach)
        self.shown = np.ascontiguousarray(shown, np.float32)
        self.kept = np.ascontiguousarray(kept, np.float32)
        self._density = _Density.of(shown[kept], prior.sigma)
        self._rarity = np.ascontiguousarray(self._density.rarity(shown), np.float32)
        row, col = np.nonzero(kept)
        some = slice(None, None, max(1, len(row) // _SAMPLE))
        self._places = row[some], col[some]

    @property
    def variance(self) -> float:
        """Of the residual of a post that a scan covers evenly, m^2."""
        return self.prior.sigma**2 + self.settings.model_sigma**2

    def likelihood(self, tile: Tile, row: IntArray, col: IntArray) -> tuple[Array, Array]:
        """Return log-likelihood ratios of a tile at places (n,), and the share compared (n,).

        A place is the row and column of the map's post under the tile's first.
        """
        total = float(tile.weight.sum())
        if total == 0.0 or len(row) == 0:
            return np.zeros(len(row)), np.zeros(len(row))
        s = self.settings
        level = np.log((1.0 - s.outlier) / np.sqrt(2.0 * np.pi * tile.variance))
        height, weight, sharp, density = (
            np.ascontiguousarray(part, np.float32)
            for part in (tile.height, tile.weight, 0.5 / tile.variance, level)
        )
        ratio, covered = k.evidence(
            self.shown, self._rarity, self.kept, height, weight, sharp, density,
            np.float32(np.log(s.outlier)), np.ascontiguousarray(row), np.ascontiguousarray(col),
        )  # fmt: skip
        return ratio / self.together, covered / total

    def usual(self, tile: Tile) -> float | None:
        """Return the logarithm of a tile's mean likelihood ratio over the map; None off it."""
        middle = np.array(tile.height.shape) // 2
        ratio, share = self.likelihood(
            tile, self._places[0] - middle[0], self._places[1] - middle[1]
        )
        if not (share > 0.5).any():
            return None
        scaled = ratio[share > 0.5] / share[share > 0.5]
        best = scaled.max()
        return float(best + np.log(np.mean(np.exp(scaled - best))))

    def exact(self, tile: Tile) -> float:
        """Return the log-likelihood ratio of a tile where it fits exactly."""
        fits = self._density.rarity(tile.height) - 0.5 * np.log(2.0 * np.pi * tile.variance)
        return float((tile.weight * fits).sum()) / self.together

    def factor(self, ratio: Array, share: Array, usual: float, places: float) -> Array:
        """Return the logarithm of what a tile multiplies the probability of places by (n,).

        What the map does not know tells nothing; ground that may have changed speaks against a
        place no more than that allows; and no tile tells more than one place from as many as there
        are.

        Parameters
        ----------
        ratio, share
            See `likelihood`.
        usual
            See there.
        places
            How many there are.
        """
        changed = self.settings.changed
        top = max(usual, float(ratio.max(initial=-np.inf)) - float(np.log(places)))
        return np.asarray(np.logaddexp(ratio - share * top + np.log1p(-changed), np.log(changed)))

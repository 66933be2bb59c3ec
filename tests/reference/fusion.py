"""The fused map's probabilities by enumeration, slices and quadrature.

The fused map is ``p = pi exp(-Lambda) prod(1 - r q)`` (docs/explanation/fused-map.md). Each
function evaluates one of its quantities from what the quantity means, by another method than the
package: hypotheses are enumerated where the package has closed forms or a grid, distributions are
integrated where the package has tables, and cells and shifts are visited one by one.
"""

from __future__ import annotations

import math
from itertools import pairwise, product
from statistics import median

import numpy as np
from scipy.optimize import brentq
from scipy.special import beta
from scipy.stats import lognorm, norm, poisson

# A rock shows in samples by a residual height of half its own height within 0.35 m.
VISIBLE_SHARE, SEARCH_DISTANCE_M = 0.5, 0.35


def area_above(height, level, height_ratio):
    """Return the area over which a half ellipsoid is higher than a level, m^2.

    At the relative distance u from its axis it has the height ``height sqrt(1 - u^2)``. The area is
    counted in 2,000 rings of equal area.
    """
    radius = height / (2.0 * height_ratio)
    squares = (np.arange(2000) + 0.5) / 2000.0  # u^2
    return math.pi * radius**2 * float(np.mean(height * np.sqrt(1.0 - squares) > level))


def no_sample_on(area, density):
    """Return the probability that none of a Poisson number of samples falls on an area."""
    return float(poisson.pmf(0, density * area))


# --- undetected rocks ----------------------------------------------------------------------------


def rock_slices(diameter, cover, cuts):
    """Return diameters and numbers per square metre of thin slices of the Golombek distribution.

    Rocks of D or more cover the share ``cover exp(-q D)``. A slice has the number of discs that
    cover what it adds. Slices grow by 0.1 % and end at `cuts`, which leaves an error of 1e-6 of
    their numbers.
    """
    q = 1.79 + 0.152 / cover
    edges = diameter * 1.001 ** np.arange(math.ceil(math.log1p(40.0 / (q * diameter)) / 0.0009995))
    edges = np.union1d(edges, [cut for cut in cuts if cut > diameter])
    middle = np.sqrt(edges[1:] * edges[:-1])
    covered = cover * (np.exp(-q * edges[:-1]) - np.exp(-q * edges[1:]))
    return middle, covered / (0.25 * math.pi * middle**2)


def remaining_ratio(height, diameters, ratios, cover, height_ratio):
    """Return the mean ratio of the rocks above a height: slice by slice, each with its class.

    A class is not missed more often than a smaller one. Rocks below the smallest class are not
    observed: their ratio is at least 1.
    """
    middle, number = rock_slices(max(height, 0.005) / height_ratio, cover, diameters)
    total = 0.0
    for d, n in zip(middle, number, strict=True):
        larger = [r for low, r in zip([*diameters[1:], math.inf], ratios, strict=True) if low > d]
        ratio = max(larger)
        total += n * (max(1.0, ratio) if d < diameters[0] else ratio)
    return total / float(number.sum())


def remaining_rocks(height, diameters, ratios, cover, height_ratio, unseen):
    """Return the rocks above a height that remain; `unseen` gives those before.

    Ratios up to 1 thin all rocks out. The excess over 1 counts for the unseen rocks of each class
    (those between its own minimum height and that of the next class), and grows with size.
    """
    capped = [min(r, 1.0) for r in ratios]
    total = unseen(height) * remaining_ratio(height, diameters, capped, cover, height_ratio)
    for k, diameter in enumerate(diameters):
        own = unseen(max(height, diameter * height_ratio))
        if k + 1 < len(diameters):
            own -= unseen(max(height, diameters[k + 1] * height_ratio))
        total += max(*(r - 1.0 for r in ratios[: k + 1]), 0.0) * own
    return total


# --- samples about tracked rocks -----------------------------------------------------------------


def highest_sample(residuals, x0, y0, posting, place, reach):
    """Return the highest residual of a cell whose centre is within reach of a place; 0 if none."""
    rows, cols = np.indices(residuals.shape)
    distance = np.hypot(x0 + cols * posting - place[0], y0 + rows * posting - place[1])
    near = residuals[(distance <= reach) & np.isfinite(residuals)]
    return float(near.max()) if near.size else 0.0


def highest_nearby(residuals, posting):
    """Return the highest residual within 0.35 m of each cell; -1e6 without a sample."""
    rows, cols = np.indices(residuals.shape)
    out = np.full(residuals.shape, -1e6)
    for row, col in np.ndindex(*residuals.shape):
        near = residuals[
            (np.hypot(rows - row, cols - col) * posting <= SEARCH_DISTANCE_M)
            & np.isfinite(residuals)
        ]
        if near.size:
            out[row, col] = near.max()
    return out


def likelihood(rise, is_rock, height, density, height_ratio, nearby):
    """Return the probability of a rise, or of none, at a rock or at any other place.

    A rise comes from the rock or by chance; both causes are enumerated. A track is at its rock with
    0.8, and half of the samples count as independent. The chance is the share of places with such a
    rise, kept 0.001 away from 0 and 1.
    """
    chance = np.clip(np.mean(nearby >= VISIBLE_SHARE * height), 1e-3, 1.0 - 1e-3)
    area = area_above(height, VISIBLE_SHARE * height, height_ratio)
    shows = 0.8 * (1.0 - no_sample_on(area, 0.5 * density)) if is_rock else 0.0
    total = 0.0
    for by_rock, by_chance in product((True, False), repeat=2):
        if (by_rock or by_chance) == rise:
            total += (shows if by_rock else 1.0 - shows) * (chance if by_chance else 1.0 - chance)
    return total


def existence_without_rise(there, radius, radius_sigma, density, common):
    """Return the probability of a rock after samples without a rise: Bayes over three causes.

    Either no rock is there, or both sensors miss it for a common reason, or no sample fell on the
    part above half its height, which is taken for a rock smaller by one sigma.
    """
    size = max(radius - radius_sigma, 0.1)
    area = area_above(size, VISIBLE_SHARE * size, 0.5)
    causes = {
        "none": 1.0 - there,
        "common": there * common,
        "missed": there * (1.0 - common) * no_sample_on(area, density),
    }
    return 1.0 - causes["none"] / sum(causes.values())


def existence(place, sigma, radius, variance, there, cells, rise, density, limit, posting, common):
    """Return the probability of one rock given the rises (rows, cols) of the cells about it.

    `cells` has the centre of each cell, by row and column. A rise of half the
    limit changes nothing.
    """
    spread = math.sqrt(variance)
    reach = radius + 2.0 * math.hypot(sigma, spread) + posting
    near = [at for at, centre in cells.items() if math.dist(centre, place) <= reach]
    heights = [rise[row][col] for row, col in near]
    if max(heights) - min(heights) >= 0.5 * limit:
        return there
    least = min(density[row][col] for row, col in near)
    return existence_without_rise(there, radius, spread, least, common)


def track_precision(tracks, residuals, x0, y0, posting, density, height_ratio):
    """Return the share of rocks among the others of each track, over that expected, at most 1.

    Tracks are (x, y, height, is_large). All assignments of the other tracks to rocks and hollows
    are enumerated. The share has the prior Beta(4, 1), so that an assignment with k rocks of n has
    the weight B(4 + k, 1 + n - k), exactly.
    """
    nearby = highest_nearby(residuals, posting)
    pairs = {}
    for k, (x, y, height, is_large) in enumerate(tracks):
        row, col = round((y - y0) / posting), round((x - x0) / posting)
        if is_large and 0 <= row < nearby.shape[0] and 0 <= col < nearby.shape[1]:
            rise = nearby[row, col] >= VISIBLE_SHARE * height
            args = height, density[row, col], height_ratio, nearby
            pairs[k] = [likelihood(rise, is_rock, *args) for is_rock in (False, True)]
    out = []
    for own in range(len(tracks)):
        others = [pair for k, pair in pairs.items() if k != own]
        total = mean = 0.0
        for kinds in product((0, 1), repeat=len(others)):
            rocks, hollows = sum(kinds), len(kinds) - sum(kinds)
            weight = math.prod(pair[kind] for pair, kind in zip(others, kinds, strict=True))
            total += weight * beta(4 + rocks, 1 + hollows)
            mean += weight * beta(5 + rocks, 1 + hollows)
        out.append(min(mean / total / 0.8, 1.0))
    return out


def common_shift(rocks, residuals, x0, y0, posting, density, height_ratio):
    """Return east, north and sigma per axis of the one shift of rocks (x, y, height, sigma).

    The posterior of every shift by complete cells: the normal prior of both axes, and for each rock
    the likelihood of what its cell shows, over that of any place.
    """
    nearby = highest_nearby(residuals, posting)
    last = np.array(nearby.shape) - 1
    prior = median(sigma for *_, sigma in rocks)
    most = round(min(3.0 * prior, 4.0) / posting)
    ratios = [
        {
            rise: likelihood(rise, True, h, density, height_ratio, nearby)
            / likelihood(rise, False, h, density, height_ratio, nearby)
            for rise in (True, False)
        }
        for _, _, h, _ in rocks
    ]
    shifts, weights = [], []
    for north, east in product(range(-most, most + 1), repeat=2):
        shift = posting * np.array([east, north])
        weight = float(np.prod(norm.pdf(shift, scale=max(prior, 0.1))))
        for (x, y, height, _), ratio in zip(rocks, ratios, strict=True):
            cell = np.array([round((y - y0) / posting), round((x - x0) / posting)])
            row, col = np.clip(cell + [north, east], 0, last)
            weight *= ratio[bool(nearby[row, col] >= VISIBLE_SHARE * height)]
        shifts.append(shift)
        weights.append(weight)
    mean = np.average(shifts, axis=0, weights=weights)
    covariance = np.cov(np.transpose(shifts), aweights=weights, ddof=0)
    return mean[0], mean[1], max(math.sqrt(0.5 * np.trace(covariance)), 0.1)


def height_scale(rocks, height_ratio):
    """Return height over radius of rocks, and its relative standard deviation.

    Rocks are (radius, existence, highest sample, density of samples). The highest of n samples on a
    half ellipsoid has a median, which is found by a root search. The median over the rocks, with
    half the weight of the prior per rock, updates a normal prior of the logarithm: 1.2 times the
    expected ratio, 20 %. The result is at least the expected ratio.
    """
    logs = []
    for radius, there, top, density in rocks:
        samples = density * math.pi * radius**2
        if there > 0.5 and top > 0.0 and samples >= 1.5:
            # No sample is higher than the share h of the rock with probability 1/2.
            share = brentq(
                lambda h, n=samples: no_sample_on(1.0 - h * h, n) - 0.5, 0.0, 1.0, xtol=1e-14
            )
            logs.append(math.log(top / (radius * share)))
    expected = math.log(2.0 * height_ratio)
    mean, precision = expected + math.log(1.2), 1.0 / 0.2**2
    if logs:
        own = 0.5 * len(logs) / 0.2**2
        mean = (precision * mean + own * median(logs)) / (precision + own)
        mean, precision = max(mean, expected), precision + own
    return math.exp(mean), 1.0 / math.sqrt(precision)


def hazard_probability(mean, spread, there, top, density, limit, height_ratio, common):
    """Return the probability that a rock is there and too high, given samples below `top`.

    Its height is log-normal, and integrated by adaptive quadrature. The odds of a high rock over a
    low or absent one change by the ratio of the likelihoods of no sample above `top`; a share
    `common` of the high rocks shows in no sample for another reason.
    """
    height = lognorm(spread, scale=mean)

    def unseen(h):
        # The part of a half ellipsoid above `top` has the area pi (h^2 - top^2) / (2 ratio)^2.
        area = math.pi * max(h * h - top * top, 0.0) / (2.0 * height_ratio) ** 2
        return math.exp(-0.5 * density * area)

    low, high = mean * math.exp(-9.0 * spread), mean * math.exp(9.0 * spread)
    edges = [low, *sorted(e for e in {limit, top, mean} if low < e < high), high]
    prior, missed = {True: 0.0, False: 0.0}, {True: 0.0, False: 0.0}
    for a, b in pairwise(edges):
        prior[a >= limit] += height.cdf(b) - height.cdf(a)
        missed[a >= limit] += height.expect(unseen, lb=a, ub=b)
    if prior[True] == 0.0:
        return 0.0
    harmless = there * prior[False] + 1.0 - there
    if harmless < 1e-12:
        return 1.0
    ratio = (missed[True] / prior[True]) / ((there * missed[False] + 1.0 - there) / harmless)
    odds = there * prior[True] / harmless * (common + (1.0 - common) * ratio)
    return odds / (1.0 + odds)


# --- the fused probability -----------------------------------------------------------------------


def reach_probability(distance, sigma, mean, spread):
    """Return the probability that a rock reaches a site: q of the formula.

    Its position has the standard deviation `sigma` per axis and its reach (with the lander's
    radius) a normal distribution, m. Positions are summed in steps of 0.06 sigma.
    """
    steps = np.linspace(-6.0, 6.0, 201)
    weight = norm.pdf(steps)
    weight /= weight.sum()
    away = np.hypot(distance + sigma * steps[:, None], sigma * steps)  # (east, north)
    inside = norm.sf((away - mean) / spread)
    return float(weight @ inside @ weight)


def no_hazard(rocks):
    """Return the probability that no rock is a hazard under the lander; rocks are (r, q).

    All combinations of hazards and of their reaching the site are enumerated.
    """
    total = 0.0
    for hazards in product((True, False), repeat=len(rocks)):
        weight = math.prod(r if h else 1.0 - r for h, (r, _) in zip(hazards, rocks, strict=True))
        for reaching in product((True, False), repeat=len(rocks)):
            if not any(h and q for h, q in zip(hazards, reaching, strict=True)):
                total += weight * math.prod(
                    q if there else 1.0 - q for there, (_, q) in zip(reaching, rocks, strict=True)
                )
    return total


def flat_terrain(slope, roughness, undetected, missed, clear, prior):
    """Return the probability by the formula for flat terrain.

    `slope` and `roughness` are shares of their limits, `undetected` the expected rocks from
    samples, `missed` the probability that the camera misses one, and `clear` that no tracked rock
    matters.
    """
    level = np.interp(slope, [0.8, 1.0], [1.0, 0.0]) * np.interp(roughness, [0.3, 1.0], [1.0, 0.0])
    none = max(no_sample_on(10.0, undetected), 1.0 - missed)
    return float(prior * level * none * clear)


def unobserved_safety_prior(cells, posting, footprint, expected):
    """Return the probability of terrain without elevations, from measured cells.

    Cells are (p, probability of no undetected rock). The result is a logarithmic opinion pool: safe
    and unsafe get the weighted geometric means of the probabilities of measured terrain (one vote
    per footprint of the lander) and of the mission (one vote). The mission expects undetected rocks
    as often as they are on measured terrain.
    """
    if not cells or expected == 0.0:
        return expected
    votes = len(cells) * min(posting**2 / (math.pi * footprint**2), 1.0)
    share = votes / (votes + 1.0)
    none = max(sum(n for _, n in cells if not math.isnan(n)) / len(cells), 1e-3)
    measured, mission = sum(p for p, _ in cells) / len(cells), expected * none**share
    measured, mission = (min(max(p, 1e-12), expected) for p in (measured, mission))
    safe = measured**share * mission ** (1.0 - share)
    unsafe = (1.0 - measured) ** share * (1.0 - mission) ** (1.0 - share)
    return safe / (safe + unsafe)

"""Plain fusion: loops over cells, sizes and rocks."""

from __future__ import annotations

import math


def law(diameter: float, cover: float) -> float:
    """Rocks of a diameter or more on a square metre, summed over thin slices of the cover."""
    q = 1.79 + 0.152 / cover
    total, step = 0.0, 0.002
    d = diameter
    while q * (d - diameter) < 25.0:
        middle = d + 0.5 * step
        slice_cover = cover * (math.exp(-q * d) - math.exp(-q * (d + step)))
        total += slice_cover / (0.25 * math.pi * middle * middle)
        d += step
    return total


def left(height: float, diameters: list, ratios: list, cover: float, height_ratio: float) -> float:
    """Share of the rocks above a height that is left at one place."""
    d = max(height, 0.005) / height_ratio
    # No class is missed more rarely than a larger one; what is not looked for is not thinned.
    worst = [max(ratios[k:]) for k in range(len(ratios))]
    edges = [*diameters, math.inf]
    whole = law(d, cover)
    share = 0.0
    if d < diameters[0]:
        share += max(1.0, worst[0]) * (whole - law(diameters[0], cover)) / whole
    for k in range(len(diameters)):
        low, high = max(d, edges[k]), edges[k + 1]
        if high <= d:
            continue
        above = 0.0 if math.isinf(high) else law(high, cover)
        share += worst[k] * (law(low, cover) - above) / whole
    return share


def existence(
    place, sigma, radius, variance, there, cells, rise, density, limit, posting, common
) -> float:
    """Probability that one rock is one that matters; cells are (x, y) by (row, col)."""
    spread = math.sqrt(variance)
    reach = radius + 2.0 * math.hypot(sigma, spread) + posting
    heights, thin = [], []
    for (row, col), (x, y) in cells.items():
        if math.hypot(x - place[0], y - place[1]) <= reach:
            heights.append(rise[row][col])
            thin.append(density[row][col])
    if max(heights) - min(heights) >= 0.5 * limit:
        return there
    area = 0.75 * math.pi * max(radius - spread, 0.1) ** 2
    missed = common + (1.0 - common) * math.exp(-min(thin) * area)
    odds = missed * there / (1.0 - there)
    return odds / (1.0 + odds)


def left_by_size(
    height: float, diameters: list, ratios: list, cover: float, height_ratio: float, unseen
) -> float:
    """Rocks above a height that are left at one place; `unseen` gives those before."""
    fewer = [min(r, 1.0) for r in ratios]
    total = unseen(height) * left(height, diameters, fewer, cover, height_ratio)
    before = 0.0
    for k, diameter in enumerate(diameters):
        on_top = max(max(r - 1.0, 0.0) for r in ratios[: k + 1])
        total += (on_top - before) * unseen(max(height, diameter * height_ratio))
        before = on_top
    return total


def highest(rises, x0: float, y0: float, posting: float, place, reach: float) -> float:
    """Highest rise of a cell whose middle lies within reach of a place; 0 if there is none."""
    found = [
        z
        for row, line in enumerate(rises)
        for col, z in enumerate(line)
        if not math.isnan(z)
        and math.hypot(x0 + col * posting - place[0], y0 + row * posting - place[1]) <= reach
    ]
    return max(found) if found else 0.0


def scale(rocks: list, height_ratio: float) -> tuple:
    """Height over radius and what it errs by; rocks are (radius, existence, top, density)."""
    logs = []
    for radius, there, top, density in rocks:
        samples = density * math.pi * radius * radius
        if there > 0.5 and top > 0.0 and samples >= 1.5:
            logs.append(math.log(top / radius / math.sqrt(1.0 - math.log(2.0) / samples)))
    told = math.log(2.0 * height_ratio)
    usual = told + math.log(1.2)
    if not logs:
        return math.exp(usual), 0.2
    logs.sort()
    half = len(logs) // 2
    middle = logs[half] if len(logs) % 2 else 0.5 * (logs[half - 1] + logs[half])
    weight = 0.5 * len(logs)
    found = max((weight * middle + usual) / (weight + 1.0), told)
    return math.exp(found), 0.2 / math.sqrt(weight + 1.0)


def hazard(
    mean: float, spread: float, there: float, top: float, density: float, limit: float,
    height_ratio: float, common: float,
) -> float:  # fmt: skip
    """Probability that a rock is there and too high: its height log-normal, by thin slices."""
    per_square = 0.5 * density * math.pi / (2.0 * height_ratio) ** 2
    high = low = high_missed = low_missed = 0.0
    n = 20000
    for k in range(n):
        z = -9.0 + 18.0 * (k + 0.5) / n
        h = mean * math.exp(spread * z)
        weight = math.exp(-0.5 * z * z) * 18.0 / n / math.sqrt(2.0 * math.pi)
        missed = math.exp(-per_square * max(h * h - top * top, 0.0))
        if h > limit:
            high += weight
            high_missed += weight * missed
        else:
            low += weight
            low_missed += weight * missed
    harmless = there * low + 1.0 - there
    if high == 0.0:
        return 0.0
    ratio = high_missed / high / ((there * low_missed + 1.0 - there) / harmless)
    odds = there * high / harmless * (common + (1.0 - common) * ratio)
    return odds / (1.0 + odds)


def shift(rocks: list, rises, x0: float, y0: float, posting: float, density: float) -> tuple:
    """East, north and deviation of the one shift of rocks (x, y, height, sigma), half spheres."""
    rows, cols = len(rises), len(rises[0])
    top = [
        [
            max(
                (
                    rises[r][c]
                    for r in range(rows)
                    for c in range(cols)
                    if math.hypot(r - row, c - col) * posting <= 0.35
                    and not math.isnan(rises[r][c])
                ),
                default=-1e6,
            )
            for col in range(cols)
        ]
        for row in range(rows)
    ]
    every = [z for line in top for z in line]
    sigmas = sorted(rock[3] for rock in rocks)
    half = len(sigmas) // 2
    common = sigmas[half] if len(sigmas) % 2 else 0.5 * (sigmas[half - 1] + sigmas[half])
    most = round(min(3.0 * common, 4.0) / posting)
    total, east, north, squares = 0.0, 0.0, 0.0, 0.0
    weights = []
    for down in range(-most, most + 1):
        for right in range(-most, most + 1):
            log = -0.5 * (down * down + right * right) * (posting / max(common, 0.1)) ** 2
            for x, y, height, _ in rocks:
                row, col = round((y - y0) / posting), round((x - x0) / posting)
                row = min(max(row + down, 0), rows - 1)
                col = min(max(col + right, 0), cols - 1)
                chance = sum(z >= 0.5 * height for z in every) / len(every)
                chance = min(max(chance, 1e-3), 1.0 - 1e-3)
                seen = 0.8 * (1.0 - math.exp(-0.5 * density * 0.75 * math.pi * height * height))
                if top[row][col] >= 0.5 * height:
                    log += math.log((seen + (1.0 - seen) * chance) / chance)
                else:
                    log += math.log(1.0 - seen)
            weights.append((log, right * posting, down * posting))
    highest_log = max(w[0] for w in weights)
    for log, right, down in weights:
        total += math.exp(log - highest_log)
        east += math.exp(log - highest_log) * right
        north += math.exp(log - highest_log) * down
    east, north = east / total, north / total
    for log, right, down in weights:
        squares += math.exp(log - highest_log) * ((right - east) ** 2 + (down - north) ** 2)
    return east, north, max(math.sqrt(0.5 * squares / total), 0.1)


def level_ground(
    slope: float, rough: float, unseen: float, missed: float, clear: float, prior: float
) -> float:
    """Probability of one site: shares of the limits, unseen rocks by samples, and by an eye."""
    level = 1.0
    for share, well in ((slope, 0.8), (rough, 0.3)):
        if share >= 1.0:
            return 0.0
        if share > well:
            level *= (1.0 - share) / (1.0 - well)
    return prior * level * max(math.exp(-10.0 * unseen), 1.0 - missed) * clear


def unobserved_safety_prior(
    cells: list, posting: float, footprint: float, expected: float
) -> float:
    """Probability of ground that was not measured; of what was (p, none stands unseen) a cell."""
    if not cells or expected == 0.0:
        return expected
    sites = total = unseen = 0.0
    for p, none_unseen in cells:
        sites += min(posting * posting / (math.pi * footprint * footprint), 1.0)
        total += p
        unseen += 0.0 if math.isnan(none_unseen) else none_unseen
    told = max(unseen / len(cells), 1e-3)
    odds = 0.0
    for weight, p in (
        (sites, total / len(cells)),
        (1.0, expected * math.exp(math.log(told) * sites / (sites + 1.0))),
    ):
        within = min(max(p, 1e-12), expected)
        odds += weight * math.log(within / (1.0 - within))
    return 1.0 / (1.0 + math.exp(-odds / (sites + 1.0)))


def genuine(tracks: list, rises, x0: float, y0: float, posting: float, density, ratio: float):
    """Share of rocks among the others of each track (x, y, height, tells), over that expected."""
    rows, cols = len(rises), len(rises[0])

    def near(row: int, col: int) -> float:
        return max(
            (
                rises[r][c]
                for r in range(rows)
                for c in range(cols)
                if math.hypot(r - row, c - col) * posting <= 0.35 and not math.isnan(rises[r][c])
            ),
            default=-1e6,
        )

    every = [near(r, c) for r in range(rows) for c in range(cols)]
    if_rock, if_not = {}, {}
    for k, (x, y, height, tells) in enumerate(tracks):
        row, col = round((y - y0) / posting), round((x - x0) / posting)
        if not tells or not (0 <= row < rows and 0 <= col < cols):
            continue
        chance = sum(z >= 0.5 * height for z in every) / len(every)
        chance = min(max(chance, 1e-3), 1.0 - 1e-3)
        area = 0.75 * math.pi * (height / (2.0 * ratio)) ** 2
        shows = 0.8 * (1.0 - math.exp(-0.5 * density[row][col] * area))
        if near(row, col) >= 0.5 * height:
            if_rock[k], if_not[k] = shows + (1.0 - shows) * chance, chance
        else:
            if_rock[k], if_not[k] = (1.0 - shows) * (1.0 - chance), 1.0 - chance
    found = []
    for own in range(len(tracks)):
        total = mean = 0.0
        for n in range(4000):
            s = (n + 0.5) / 4000.0
            weight = s**3
            for k, likely in if_rock.items():
                if k != own:
                    weight *= s * likely + (1.0 - s) * if_not[k]
            total += weight
            mean += s * weight
        found.append(min(mean / total / 0.8, 1.0))
    return found

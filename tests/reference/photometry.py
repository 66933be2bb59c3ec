"""Hapke's law written term by term from the equations, one geometry at a time."""

from __future__ import annotations

import math

import numpy as np


def lunar_if(i, e, psi, *, w, b, c, surge, width, theta):
    """Return I/F at incidence, emission and azimuth between them, rad."""
    g = math.acos(
        max(-1.0, min(1.0, math.cos(i) * math.cos(e) + math.sin(i) * math.sin(e) * math.cos(psi)))
    )
    mu0e, mue, s = roughness(i, e, psi, theta)
    p = 0.5 * (1 + c) * henyey_greenstein(g, b) + 0.5 * (1 - c) * henyey_greenstein(math.pi - g, b)
    opposition = surge / (1.0 + math.tan(0.5 * g) / width)
    multiple = chandrasekhar(mu0e, w) * chandrasekhar(mue, w) - 1.0
    r = w / (4.0 * math.pi) * mu0e / (mu0e + mue) * (p * (1.0 + opposition) + multiple) * s
    return math.pi * r


def henyey_greenstein(g, b):
    """Return the one-lobed phase function, phase angle g."""
    return (1.0 - b * b) / (1.0 - 2.0 * b * math.cos(g) + b * b) ** 1.5


def chandrasekhar(x, w):
    """Return Hapke's (2002) H function."""
    gamma = math.sqrt(1.0 - w)
    r0 = (1.0 - gamma) / (1.0 + gamma)
    return 1.0 / (1.0 - w * x * (r0 + 0.5 * (1.0 - 2.0 * r0 * x) * math.log((1.0 + x) / x)))


def roughness(i, e, psi, theta):
    """Return effective cosines and shadowing: Hapke (1984), Eqs. 46 to 51."""
    tan, cot = math.tan(theta), 1.0 / math.tan(theta)
    chi = 1.0 / math.sqrt(1.0 + math.pi * tan * tan)

    def e1(x):
        return math.exp(-2.0 / math.pi * cot / math.tan(x))

    def e2(x):
        return math.exp(-1.0 / math.pi * (cot / math.tan(x)) ** 2)

    def eta(x):
        return chi * (math.cos(x) + math.sin(x) * tan * e2(x) / (2.0 - e1(x)))

    f = math.exp(-2.0 * math.tan(0.5 * psi))
    half = math.sin(0.5 * psi) ** 2
    if i <= e:
        below = 2.0 - e1(e) - psi / math.pi * e1(i)
        mu0e = math.cos(i) + math.sin(i) * tan * (math.cos(psi) * e2(e) + half * e2(i)) / below
        mue = math.cos(e) + math.sin(e) * tan * (e2(e) - half * e2(i)) / below
        other = math.cos(i) / eta(i)
    else:
        below = 2.0 - e1(i) - psi / math.pi * e1(e)
        mu0e = math.cos(i) + math.sin(i) * tan * (e2(i) - half * e2(e)) / below
        mue = math.cos(e) + math.sin(e) * tan * (math.cos(psi) * e2(i) + half * e2(e)) / below
        other = math.cos(e) / eta(e)
    mu0e, mue = chi * mu0e, chi * mue
    s = mue / eta(e) * math.cos(i) / eta(i) * chi / (1.0 - f + f * chi * other)
    return mu0e, mue, s


def scattered_light(terrain, place, sun, albedo, seed, rays=6000):
    """Return I/F of a shaded place of Lambert ground by the lit ground about it: one bounce."""
    x, y = place
    step = 0.2
    rise = [
        float(terrain.elevation([x + a, y + b]) - terrain.elevation([x - a, y - b])) / (2 * step)
        for a, b in ((step, 0.0), (0.0, step))
    ]
    n = np.array([-rise[0], -rise[1], 1.0])
    point = np.array([x, y, float(terrain.elevation([x, y]))])
    return scattered_on(terrain, point, n / np.linalg.norm(n), sun, albedo, seed, rays)


def scattered_on(terrain, point, normal, sun, albedo, seed, rays=6000):
    """Return the same of a point with a normal.

    Rays are spread over its sky by the cosine law; each brings the I/F of the place that it meets,
    if that one sees the Sun.
    """
    rng = np.random.default_rng(seed)
    t = np.cross(normal, [0.3, 1.0, 0.2])
    t /= np.linalg.norm(t)
    u, v = rng.random((2, rays))
    r, a = np.sqrt(u), 2.0 * np.pi * v
    axes = np.array([t, np.cross(normal, t), normal])
    ways = np.column_stack((r * np.cos(a), r * np.sin(a), np.sqrt(1.0 - u))) @ axes
    start = point + 1e-2 * normal
    hits = terrain.cast(start, ways)
    met = np.isfinite(hits.range)
    points = start + hits.range[met, None] * ways[met] + 1e-2 * hits.normal[met]
    free = np.isnan(terrain.cast(points, np.broadcast_to(sun, points.shape).copy()).range)
    shine = albedo * np.maximum(hits.normal[met] @ sun, 0.0) * free
    return albedo * float(shine.sum()) / rays

"""Hapke's law written term by term from the equations, one geometry at a time."""

from __future__ import annotations

import math


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

"""Probability that a rock covers a point (shadow EKF paper, Eqs. 16-22)."""

from __future__ import annotations

from typing import Literal, get_args

import numpy as np
from numpy.typing import ArrayLike
from scipy.special import ndtr

from lunarsim.errors import InputError
from lunarsim.onboard.hazards.shadows import _probability_kernels as kernels
from lunarsim.typing import Array

Form = Literal["rice", "gaussian"]

_RAYLEIGH_MEAN = np.sqrt(0.5 * np.pi)
_RAYLEIGH_VARIANCE = 2.0 - 0.5 * np.pi


def checked_form(form: str) -> Form:
    """Check the name of a model for `cover_probability` ("rice" or "gaussian").

    The name is returned.

    Raises
    ------
    InputError
        If the form is unknown.
    """
    for known in get_args(Form):
        if form == known:
            return known  # type: ignore[no-any-return]
    raise InputError("cover_model", form, f"must be {' or '.join(map(repr, get_args(Form)))}")


def cover_probability(
    distance: ArrayLike,
    location_sigma: ArrayLike,
    radius: ArrayLike,
    radius_sigma: ArrayLike,
    form: Form = "rice",
) -> Array:
    """Return the probability that points lie within the outlines of rocks.

    For each of n rocks, m points are given by their distances.

    Parameters
    ----------
    distance
        Distance from the estimated centre (n, m), m.
    location_sigma
        Standard deviation of the centre per axis (n,), m.
    radius, radius_sigma
        Estimated radius and its standard deviation (n,), m.
    form
        "rice": the distance to the true centre has a Rice distribution, the radius a normal one;
        exact for a round rock with equal errors per axis. "gaussian": Eqs. 17-21 of the paper: the
        error of the centre, a Rayleigh variable, is replaced by a normal one with its mean and
        variance and added to the radius, as if the rock were always displaced towards the point;
        truncated at 0.

    Returns
    -------
    p
        Probability (n, m).

    Raises
    ------
    InputError
        If the form is unknown.
    """
    form = checked_form(form)
    d = np.asarray(distance, dtype=np.float64)
    sigma, mean, spread = (
        np.maximum(np.atleast_1d(np.asarray(v, dtype=np.float64)), least)
        for v, least in ((location_sigma, 1e-4), (radius, 0.0), (radius_sigma, 1e-4))
    )
    if form == "rice":
        return np.asarray(
            kernels.rice_profiles(d, sigma, mean, spread, kernels._NODE, kernels._WEIGHT)
        )
    mu = (mean + _RAYLEIGH_MEAN * sigma)[:, None]
    s = np.sqrt(spread**2 + _RAYLEIGH_VARIANCE * sigma**2)[:, None]
    below = ndtr(-mu / s)
    return np.asarray(1.0 - (ndtr((d - mu) / s) - below) / (1.0 - below))

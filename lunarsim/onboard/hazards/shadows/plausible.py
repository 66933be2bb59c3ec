"""Whether as many rocks were found as ground like this should have."""

from __future__ import annotations

from scipy.special import pdtr

# Fewer than this share of those that should have been found, and fewer than chance explains, are
# too few.
_MIN_FOUND_FRACTION, _MAX_CHANCE = 0.25, 1e-6


def too_few(found: int, expected: float) -> bool:
    """Tell whether far fewer rocks were found than should have been.

    Either the ground has fewer, or they do not show.

    Parameters
    ----------
    found, expected
        Numbers of rocks.
    """
    return bool(found < _MIN_FOUND_FRACTION * expected and pdtr(found, expected) < _MAX_CHANCE)

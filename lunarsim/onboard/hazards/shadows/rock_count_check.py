"""Test whether the number of rocks found is plausible."""

from __future__ import annotations

from scipy.special import pdtr

# The number is too low if it is below this fraction of the expected number and its probability is
# below this value.
_MIN_FOUND_FRACTION, _MAX_CHANCE = 0.25, 1e-6


def is_rock_count_too_low(found: int, expected: float) -> bool:
    """Return whether far fewer rocks were found than expected.

    Either the terrain has fewer rocks, or they are not detected.

    Parameters
    ----------
    found, expected
        Number of rocks found, and number expected from the size distribution and detection rates.
    """
    return bool(found < _MIN_FOUND_FRACTION * expected and pdtr(found, expected) < _MAX_CHANCE)

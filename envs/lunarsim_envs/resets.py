"""Check reset masks and seeds of vector environments."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import gymnasium
import numpy as np
from numpy.typing import NDArray


def reset_mask(given: Any, lanes: int) -> NDArray[np.bool_]:
    """Return ``options["reset_mask"]`` (lanes,); None selects all lanes.

    Raises
    ------
    ValueError
        If it is not a boolean array with at least one true value.
    """
    if given is None:
        return np.ones(lanes, np.bool_)
    mask = np.asarray(given)
    if mask.shape != (lanes,) or mask.dtype != np.bool_ or not mask.any():
        raise ValueError(
            f"options['reset_mask']: must be {lanes} booleans with at least one true, "
            f"got {given!r}."
        )
    return mask


def check_all_reset(was_reset: NDArray[np.bool_], mask: NDArray[np.bool_]) -> None:
    """Check that all lanes outside the mask (n,) have been reset before.

    Raises
    ------
    gymnasium.error.ResetNeeded
        If a lane outside the mask has never been reset.
    """
    if not (was_reset | mask).all():
        lanes = np.flatnonzero(~(was_reset | mask)).tolist()
        raise gymnasium.error.ResetNeeded(
            f"options['reset_mask']: omits lanes that were never reset, {lanes}. Reset all first."
        )


def lane_seeds(
    seed: int | Sequence[int | None] | None, mask: NDArray[np.bool_]
) -> list[int | None]:
    """Return the seed of each lane of a mask: ``seed + i`` or ``seed[i]`` for lane i.

    Raises
    ------
    ValueError
        If a sequence has not one seed per lane, or a seed is negative or not an integer.
    """
    lanes = np.flatnonzero(mask)
    if seed is None:
        return [None] * len(lanes)
    if isinstance(seed, (int, np.integer)):
        if seed < 0:
            raise ValueError(f"seed: must be 0 or more, got {seed!r}.")
        return [int(seed) + int(lane) for lane in lanes]
    if not isinstance(seed, (Sequence, np.ndarray)) or isinstance(seed, (str, bytes)):
        raise ValueError(f"seed: must be an integer, one integer per lane or None, got {seed!r}.")
    if len(seed) != len(mask):
        raise ValueError(f"seed: must have length {len(mask)}, got length {len(seed)}.")
    each = [seed[int(lane)] for lane in lanes]
    if not all(one is None or (isinstance(one, (int, np.integer)) and one >= 0) for one in each):
        raise ValueError(f"seed: must contain integers of 0 or more, or None, got {seed!r}.")
    return [None if one is None else int(one) for one in each]

"""Check reset masks and seeds of vector environments."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import gymnasium
import numpy as np

from lunarsim.typing import BoolArray


def reset_mask(option: Any, lanes: int) -> BoolArray:
    """Check ``options["reset_mask"]``, which selects the environments to reset.

    Returns the mask (n,), where n is the number of environments (`lanes`); None selects all. If the
    option is not an array of n booleans with at least one true value, a ValueError is raised.
    """
    if option is None:
        return np.ones(lanes, np.bool_)
    mask = np.asarray(option)
    if mask.shape != (lanes,) or mask.dtype != np.bool_:
        raise ValueError(
            f"options['reset_mask']: must be {lanes} booleans, got shape {mask.shape} and type "
            f"{mask.dtype}."
        )
    if not mask.any():
        raise ValueError("options['reset_mask']: must be True for at least one environment.")
    return mask


def check_all_reset(was_reset: BoolArray, mask: BoolArray) -> None:
    """Raise `ResetNeeded` if an environment outside a reset mask (n,) was never reset.

    `was_reset` (n,) marks environments that have been reset before.
    """
    if not (was_reset | mask).all():
        lanes = np.flatnonzero(~(was_reset | mask)).tolist()
        raise gymnasium.error.ResetNeeded(
            f"options['reset_mask']: must include environments {lanes}, which were never reset."
        )


def lane_seeds(seed: int | Sequence[int | None] | None, mask: BoolArray) -> list[int | None]:
    """Return the seeds of the environments that a mask (n,) selects.

    Environment i gets ``seed + i``, or ``seed[i]`` if `seed` is a sequence; None is no seed. If a
    sequence does not have length n, or a seed is negative or not an integer, a ValueError is
    raised.
    """
    lanes = np.flatnonzero(mask)
    if seed is None:
        return [None] * len(lanes)
    if isinstance(seed, (int, np.integer)):
        if seed < 0:
            raise ValueError(f"seed: must be 0 or more, got {seed!r}.")
        return [int(seed) + int(lane) for lane in lanes]
    if not isinstance(seed, (Sequence, np.ndarray)) or isinstance(seed, (str, bytes)):
        raise ValueError(
            f"seed: must be an integer, a list with one integer per environment, or None, "
            f"got {seed!r}."
        )
    if len(seed) != len(mask):
        raise ValueError(
            f"seed: must have {len(mask)} values, one per environment, got {len(seed)} values."
        )
    each = [seed[int(lane)] for lane in lanes]
    for lane, one in zip(lanes, each, strict=True):
        if one is not None and not (isinstance(one, (int, np.integer)) and one >= 0):
            raise ValueError(
                f"seed[{lane}]: must be an integer of 0 or more, or None, got {one!r}."
            )
    return [None if one is None else int(one) for one in each]

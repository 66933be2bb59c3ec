"""Which lanes of a batch begin anew, and from which seeds."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import gymnasium
import numpy as np
from numpy.typing import NDArray


def reset_mask(given: Any, lanes: int) -> NDArray[np.bool_]:
    """Return ``options["reset_mask"]`` of a batch (lanes,); all where none is given.

    Raises
    ------
    ValueError
        If it is something else, or true of none.
    """
    if given is None:
        return np.ones(lanes, np.bool_)
    mask = np.asarray(given)
    if mask.shape != (lanes,) or mask.dtype != np.bool_ or not mask.any():
        raise ValueError(
            f"options['reset_mask'] = {given!r}: must be {lanes} of true and false, "
            "at least one true"
        )
    return mask


def check_begun(begun: NDArray[np.bool_], mask: NDArray[np.bool_]) -> None:
    """Refuse to begin some lanes of a batch (n,) while others have never begun.

    Raises
    ------
    gymnasium.error.ResetNeeded
        If there are any that have not, beside those of the mask.
    """
    if not (begun | mask).all():
        lanes = np.flatnonzero(~(begun | mask)).tolist()
        raise gymnasium.error.ResetNeeded(
            f"options['reset_mask'] leaves out lanes that never began, {lanes}: first reset all"
        )


def lane_seeds(
    seed: int | Sequence[int | None] | None, mask: NDArray[np.bool_]
) -> list[int | None]:
    """Return the seed of each lane of a mask (n,): that of lane i is `seed` + i, or ``seed[i]``.

    Raises
    ------
    ValueError
        If there is not one for each lane of the batch, or one is below 0.
    """
    lanes = np.flatnonzero(mask)
    if seed is None:
        return [None] * len(lanes)
    if isinstance(seed, (int, np.integer)):
        if seed < 0:
            raise ValueError(f"seed = {seed!r}: must be 0 or more")
        return [int(seed) + int(lane) for lane in lanes]
    if not isinstance(seed, (Sequence, np.ndarray)) or isinstance(seed, (str, bytes)):
        raise ValueError(f"seed = {seed!r}: must be a whole number, one for each lane, or None")
    if len(seed) != len(mask):
        raise ValueError(f"seed of length {len(seed)}: must be one for each of {len(mask)}")
    each = [seed[int(lane)] for lane in lanes]
    if not all(one is None or (isinstance(one, (int, np.integer)) and one >= 0) for one in each):
        raise ValueError(f"seed = {seed!r}: must be whole numbers, 0 or more, or None")
    return [None if one is None else int(one) for one in each]

"""Derive random seeds: a sequence per flight, and a named stream per component.

The stream of a component depends only on the root seed, the flight index and the component's name.
New components or another order of calls therefore do not change other streams.
"""

from __future__ import annotations

import zlib

import numpy as np


def flight_seed(root: int, flight: int) -> np.random.SeedSequence:
    """Return the seed sequence of flight `flight` of a campaign with root seed `root`.

    Examples
    --------
    >>> flight_seed(1, 7).spawn_key
    (7,)
    """
    return np.random.SeedSequence(root, spawn_key=(flight,))


def calibration_seed(root: int, flight: int) -> np.random.SeedSequence:
    """Return the seed sequence of a calibration flight; no campaign uses it.

    Calibrations are therefore never evaluated on flights that they were fitted to, whatever the
    root seeds.
    """
    return np.random.SeedSequence(root, spawn_key=(zlib.crc32(b"calibration"), flight))


def design_seed(root: int) -> np.random.SeedSequence:
    """Return the seed sequence of a design of experiments; no flight uses it."""
    return np.random.SeedSequence(root, spawn_key=(zlib.crc32(b"design"), 0))


class RandomStreams:
    """Independent random generators of one flight, one per component.

    Parameters
    ----------
    seed
        Seed sequence of the flight, or an integer.
    """

    def __init__(self, seed: np.random.SeedSequence | int) -> None:
        self.seed = (
            seed if isinstance(seed, np.random.SeedSequence) else np.random.SeedSequence(seed)
        )

    def get(self, component: str) -> np.random.Generator:
        """Return a fresh generator for `component`; the same name gives the same stream.

        Examples
        --------
        >>> first, again = RandomStreams(flight_seed(1, 0)), RandomStreams(flight_seed(1, 0))
        >>> float(first.get("rocks").random()) == float(again.get("rocks").random())
        True
        """
        key = (*self.seed.spawn_key, zlib.crc32(component.encode()))
        return np.random.default_rng(np.random.SeedSequence(self.seed.entropy, spawn_key=key))

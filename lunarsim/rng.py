"""Seeds: one root, one sequence a flight, one stream a component, by name.

The stream of a component depends on the root seed, the flight's index and the component's name
alone, so a new component or another order of calls changes no other stream.
"""

from __future__ import annotations

import zlib

import numpy as np


def flight_seed(root: int, flight: int) -> np.random.SeedSequence:
    """Return the seed sequence of flight number `flight` of the campaign seeded by `root`.

    Examples
    --------
    >>> flight_seed(1, 7).spawn_key
    (7,)
    """
    return np.random.SeedSequence(root, spawn_key=(flight,))


def calibration_seed(root: int, flight: int) -> np.random.SeedSequence:
    """Return the seed sequence of flight `flight` of a calibration; no campaign flies it.

    A calibration is so never judged on what it was fitted to, whatever the root seeds of both.
    """
    return np.random.SeedSequence(root, spawn_key=(zlib.crc32(b"calibration"), flight))


def design_seed(root: int) -> np.random.SeedSequence:
    """Return the seed sequence of a campaign's design of experiments; no flight has it."""
    return np.random.SeedSequence(root, spawn_key=(zlib.crc32(b"design"), 0))


class Streams:
    """Random generators of one flight, one a component.

    Parameters
    ----------
    seed
        The flight's seed sequence, or an integer.
    """

    def __init__(self, seed: np.random.SeedSequence | int) -> None:
        self.seed = (
            seed if isinstance(seed, np.random.SeedSequence) else np.random.SeedSequence(seed)
        )

    def get(self, component: str) -> np.random.Generator:
        """Return a fresh generator for `component`; the same name gives the same stream.

        Examples
        --------
        >>> first, again = Streams(flight_seed(1, 0)), Streams(flight_seed(1, 0))
        >>> float(first.get("rocks").random()) == float(again.get("rocks").random())
        True
        """
        key = (*self.seed.spawn_key, zlib.crc32(component.encode()))
        return np.random.default_rng(np.random.SeedSequence(self.seed.entropy, spawn_key=key))

"""Derive random seeds: a sequence per flight, and a named stream per component.

The stream of a component depends only on the root seed, the flight index and the component's name.
New components or another order of calls therefore do not change other streams. Names of components
are part of the results: they stay as they are if a scenario key is renamed.
"""

from __future__ import annotations

import zlib

import numpy as np


def flight_seed(root: int, flight: int) -> np.random.SeedSequence:
    """Return the seed sequence of one flight of a campaign.

    `root` is the root seed of the campaign, `flight` the index of the flight.

    Examples
    --------
    >>> flight_seed(1, 7).spawn_key
    (7,)
    """
    return np.random.SeedSequence(root, spawn_key=(flight,))


def calibration_seed(root: int, flight: int) -> np.random.SeedSequence:
    """Return the seed sequence of a calibration flight, which no campaign uses.

    `root` is the root seed, `flight` the index of the flight.

    Calibrations are therefore never evaluated on flights that they were fitted to, whatever the
    root seeds.
    """
    return np.random.SeedSequence(root, spawn_key=(zlib.crc32(b"calibration"), flight))


# Splits of the worlds of environments. No world of one split is a world of another.
SPLITS = ("train", "validation", "test")


def world_seed(root: int, world: int, split: str = "train") -> np.random.SeedSequence:
    """Return the seed sequence of a world of a pool.

    `root` is the root seed, `world` the number of the world, and `split` one of `SPLITS`. World k
    of the split "train" is that of flight k of a campaign.
    """
    own = () if split == "train" else (zlib.crc32(split.encode()),)
    return np.random.SeedSequence(root, spawn_key=(*own, world))


def design_seed(root: int) -> np.random.SeedSequence:
    """Return the seed sequence of a design of experiments, which no flight uses.

    `root` is the root seed of the campaign.
    """
    return np.random.SeedSequence(root, spawn_key=(zlib.crc32(b"design"), 0))


class RandomStreams:
    """Source of independent random generators of one flight, one per component.

    Parameters
    ----------
    seed
        Seed sequence of the flight, or an integer.

    Examples
    --------
    >>> streams = RandomStreams(flight_seed(1, 0))
    >>> streams.get("rocks").random() == streams.get("start").random()
    False
    """

    def __init__(self, seed: np.random.SeedSequence | int) -> None:
        self.seed = (
            seed if isinstance(seed, np.random.SeedSequence) else np.random.SeedSequence(seed)
        )

    def get(self, component: str) -> np.random.Generator:
        """Return a new random generator for a component, seeded by the component's name.

        The same name gives the same random numbers.

        Examples
        --------
        >>> first, again = RandomStreams(flight_seed(1, 0)), RandomStreams(flight_seed(1, 0))
        >>> float(first.get("rocks").random()) == float(again.get("rocks").random())
        True
        """
        key = (*self.seed.spawn_key, zlib.crc32(component.encode()))
        return np.random.default_rng(np.random.SeedSequence(self.seed.entropy, spawn_key=key))

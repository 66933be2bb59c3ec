"""Options that redraw random numbers, to see which tests depend on one particular draw.

``--fresh-noise N``: the noise of every image is another draw. A processor that rounds differently
has this effect: one pixel whose brightness differs in its last bit shifts the random numbers of all
pixels after it. Every test must pass with it.

``--fresh-draw N``: every generator draws other numbers, so worlds and measurements differ too.
Tests marked `statistical` must pass with it, but for the chance of failure in `tests/chance.py`;
tests that need one particular world may fail.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

_default_rng = np.random.default_rng


def pytest_addoption(parser: pytest.Parser) -> None:
    """Add the options."""
    for name, text in (
        ("--fresh-noise", "Number of another draw of the noise of all images; 0: the usual one."),
        ("--fresh-draw", "Number of another draw of all random numbers; 0: the usual one."),
    ):
        parser.addoption(name, type=int, default=0, metavar="N", help=text)


def pytest_configure(config: pytest.Config) -> None:
    """Replace the generators of this process."""
    if number := config.getoption("--fresh-noise"):
        _redraw_noise(number)
    if number := config.getoption("--fresh-draw"):
        _redraw_all(number)


def _redraw_noise(number: int) -> None:
    from lunarsim.sensors import camera

    usual = camera.counted

    def counted(electrons: Any, rng: np.random.Generator, **settings: Any) -> Any:
        return usual(electrons, _default_rng([rng.integers(2**32), number]), **settings)

    camera.counted = counted


def _redraw_all(number: int) -> None:
    def default_rng(seed: Any = None) -> np.random.Generator:
        if isinstance(seed, np.random.SeedSequence):
            entropy = [*np.atleast_1d(seed.entropy), number]
            seed = np.random.SeedSequence(entropy, spawn_key=seed.spawn_key)
        elif seed is not None and not isinstance(
            seed, (np.random.Generator, np.random.BitGenerator)
        ):
            seed = np.random.SeedSequence([*np.atleast_1d(seed), number])
        return _default_rng(seed)

    np.random.default_rng = default_rng

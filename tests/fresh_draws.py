"""The option ``--fresh-draw N``: every generator of the run draws other numbers.

Worlds, noise and test data then differ from those of an ordinary run, as they do in part on a
processor that rounds differently. A test of a statistical property must hold on every draw but for
the chance of failure that it states; a test that pins the values of one draw fails.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

_default_rng = np.random.default_rng


def pytest_addoption(parser: pytest.Parser) -> None:
    """Add the option."""
    parser.addoption(
        "--fresh-draw", type=int, default=0, metavar="N",
        help="Number of another draw of all random numbers; 0: the usual one.",
    )  # fmt: skip


def pytest_configure(config: pytest.Config) -> None:
    """Let all generators of this process depend on the number of the draw."""
    number = config.getoption("--fresh-draw")
    if not number:
        return

    def default_rng(seed: Any = None) -> np.random.Generator:
        if isinstance(seed, np.random.SeedSequence):
            seed = np.random.SeedSequence(
                [*np.atleast_1d(seed.entropy), number], spawn_key=seed.spawn_key
            )
        elif seed is not None and not isinstance(
            seed, (np.random.Generator, np.random.BitGenerator)
        ):
            seed = np.random.SeedSequence([*np.atleast_1d(seed), number])
        return _default_rng(seed)

    np.random.default_rng = default_rng
